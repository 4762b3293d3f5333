# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Files are whole, or what they were."""

import subprocess
import sys

from conftest import files_up_to
import pytest
from rigid_body_ros import files
from rigid_body_ros.scene import InputError


def write(path, text='new'):
    with files.whole(path) as part:
        part.write_text(text)


def test_a_file_is_replaced_through_a_link(tmp_path):
    file, link = tmp_path / 'file', tmp_path / 'link'
    file.write_text('old')
    link.symlink_to(file)
    write(link)
    assert link.is_symlink()
    assert file.read_text() == 'new'
    assert set(tmp_path.iterdir()) == {file, link}


@pytest.mark.parametrize('before', [None, 'old'])
def test_on_a_full_disk_a_file_is_what_it_was(tmp_path, before):
    path = tmp_path / 'file'
    if before:
        path.write_text(before)
    with files_up_to(512), pytest.raises(InputError,
                                         match='file: cannot write: File too large'):
        write(path, 1000 * 'x')
    assert [part.read_text() for part in tmp_path.iterdir()] == ([before] if before else [])


def test_what_goes_wrong_while_writing_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), files.whole(tmp_path / 'file') as part:
        part.write_text('half')
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_a_device_stays_one(tmp_path):
    with pytest.raises(InputError, match='/dev/full: cannot write: No space left on device'):
        write('/dev/full')
    write('/dev/null')


@pytest.mark.parametrize('folder', ['', '/'])
def test_a_folder_refuses(tmp_path, folder):
    with pytest.raises(InputError, match='cannot write: Is a directory'):
        write(folder or tmp_path)


def test_a_pipe_takes_what_is_written():
    script = ('from rigid_body_ros import files\n'
              'with files.whole("/dev/stdout") as part:\n    part.write_text("new")')
    result = subprocess.run([sys.executable, '-c', script], check=True, capture_output=True,
                            text=True)
    assert result.stdout == 'new'


def test_a_name_may_be_as_long_as_names_can_be(tmp_path):
    write(tmp_path / (85 * '\u4e2d'))
    assert [path.read_text() for path in tmp_path.iterdir()] == ['new']
