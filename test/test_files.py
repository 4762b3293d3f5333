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

"""Outputs are complete or unchanged, and never replace protected files."""

import errno
import os
import socket
import stat

from conftest import CONFIG, files_up_to, RECORDINGS
import pytest
from rigid_body_ros import recording, scene
from rigid_body_ros.comparison import read_measured
from rigid_body_ros.comparison.comparison import compare_recording, read_motion
from rigid_body_ros.replay import replay
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.limits import read_json
from rigid_body_ros.scene import InputError

TUMBLER = scene.load(CONFIG / 'tumbler.yaml')


def write(path, text='new'):
    with files.atomic_output(path, '.json') as part:
        part.write_text(text)


@pytest.fixture
def umask():
    """Set an unusual umask."""
    before = os.umask(0o027)
    yield
    os.umask(before)


def test_a_file_is_replaced_through_a_link(tmp_path):
    file, link = tmp_path / 'file', tmp_path / 'link'
    file.write_text('old')
    link.symlink_to(file)
    write(link)
    assert link.is_symlink()
    assert file.read_text() == 'new'
    assert set(tmp_path.iterdir()) == {file, link}


@pytest.mark.parametrize('name', ['file', 'link', 'hard link'])
def test_an_existing_file_is_kept_unless_it_may_be_overwritten(tmp_path, name):
    file = tmp_path / 'file'
    file.write_text('old')
    (tmp_path / 'link').symlink_to(file)
    (tmp_path / 'hard link').hardlink_to(file)
    message = f'{name}: output exists; choose another name, or add --overwrite'
    with files.overwriting(False):
        with pytest.raises(InputError, match=message):
            files.check((tmp_path / name, '.json'))
        with pytest.raises(InputError, match=message):
            write(tmp_path / name)
        write(tmp_path / 'new')
    assert file.read_text() == 'old'
    assert len(list(tmp_path.iterdir())) == 4
    write(tmp_path / name)
    assert (tmp_path / name).read_text() == 'new'


def without_links(*_):
    raise PermissionError(errno.EPERM, 'Operation not permitted')  # as on FAT


@pytest.mark.parametrize('link', [os.link, without_links])
def test_a_file_that_appears_after_the_last_check_is_kept(tmp_path, monkeypatch, link):
    path = tmp_path / 'file'

    def after_another(function):
        def call(*names):
            if not path.exists():
                path.write_text('old')
            return function(*names)
        return call
    monkeypatch.setattr(os, 'link', after_another(link))
    monkeypatch.setattr(os, 'replace', after_another(os.replace))
    with pytest.raises(InputError, match='file: output exists'), files.overwriting(False):
        write(path)
    assert path.read_text() == 'old'
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize('link', [os.link, without_links])
def test_an_output_that_cannot_get_its_name_leaves_no_file_of_that_name(tmp_path, monkeypatch,
                                                                        link):
    def fails(*_):
        raise OSError(errno.EIO, 'Input/output error')

    monkeypatch.setattr(os, 'link', link)
    monkeypatch.setattr(os, 'replace', fails)
    with pytest.raises(InputError, match='file: cannot write: Input/output error'), \
            files.overwriting(False):
        write(tmp_path / 'file')
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize('link', [os.link, without_links])
@pytest.mark.parametrize('overwrite', [False, True])
def test_a_complete_output_has_one_name(tmp_path, monkeypatch, link, overwrite):
    monkeypatch.setattr(os, 'link', link)
    with files.overwriting(overwrite):
        part = files.Part(tmp_path / 'file', '.json')
        part.path.write_text('new')
        part.complete()
    file, = tmp_path.iterdir()
    assert (file.read_text(), file.stat().st_nlink) == ('new', 1)


def test_on_a_full_disk_a_file_is_what_it_was(tmp_path):
    path = tmp_path / 'file'
    path.write_text('old')
    with files_up_to(512), pytest.raises(InputError,
                                         match='file: cannot write: File too large'):
        write(path, 1000 * 'x')
    assert [part.read_text() for part in tmp_path.iterdir()] == ['old']


def test_what_goes_wrong_while_writing_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), files.atomic_output(tmp_path / 'file', '.json') as part:
        part.write_text('half')
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_a_new_file_has_the_mode_of_the_umask_and_a_replaced_one_keeps_its_own(tmp_path, umask):
    path = tmp_path / 'file'
    for mode in (0o640, 0o600, 0o666):
        if path.exists():
            path.chmod(mode)
        write(path)
        assert stat.S_IMODE(path.stat().st_mode) == mode
    files.Part(tmp_path / 'folder', files.FOLDER).complete()
    assert stat.S_IMODE((tmp_path / 'folder').stat().st_mode) == 0o750


def test_a_file_that_is_replaced_stays_private_while_it_is_written(tmp_path):
    path = tmp_path / 'file'
    path.touch(0o600)
    with files.atomic_output(path, '.json') as part:
        assert stat.S_IMODE(part.stat().st_mode) == 0o600


def test_a_temporary_file_never_replaces_another(tmp_path, monkeypatch):
    # An attacker who guesses the name could place a link to somebody's file there.
    monkeypatch.setattr('secrets.token_hex', lambda size: 'guessed')
    other = tmp_path / 'other'
    other.write_text('unchanged')
    guessed = tmp_path / f'.file.guessed.{os.getpid()}.part'
    guessed.symlink_to(other)
    with pytest.raises(InputError, match='file: cannot write: File exists'):
        write(tmp_path / 'file')
    assert other.read_text() == 'unchanged'
    assert guessed.is_symlink()


@pytest.mark.parametrize('kind', ['file', 'folder'])
def test_contents_are_on_the_disk_before_the_name(tmp_path, monkeypatch, kind):
    # In this order, a crash leaves either the old file or the new one.
    done = []

    def noted(name, path_of=lambda argument: argument):
        function = getattr(os, name)

        def call(*arguments):
            done.append((name, path_of(arguments[0])))
            return function(*arguments)
        monkeypatch.setattr(os, name, call)
    noted('fsync', lambda handle: os.readlink(f'/proc/self/fd/{handle}'))
    noted('replace', str)
    part = files.Part(tmp_path / 'out', files.FOLDER if kind == 'folder' else '.json')
    inside = [part.path / 'inside'] if kind == 'folder' else []
    for path in inside or [part.path]:
        path.write_text('new')
    part.complete()
    assert done == [*(('fsync', str(path)) for path in (*inside, part.path)),
                    ('replace', str(part.path)), ('fsync', str(tmp_path))]


def test_a_device_is_refused(tmp_path):
    # Never a device in /dev: as root, broken code would replace it for the whole machine.
    device = tmp_path / 'device'
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip('only root may make a device')
    with pytest.raises(InputError, match='device: expected a regular file, found a device'):
        write(device)
    assert stat.S_ISCHR(device.stat().st_mode)
    assert list(tmp_path.iterdir()) == [device]


def test_a_pipe_is_refused_without_waiting_for_a_reader(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(InputError, match='pipe: expected a regular file, found a device, pipe'):
        write(tmp_path / 'pipe')
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / 'socket'))
    with pytest.raises(InputError, match='socket: expected a regular file'):
        write(tmp_path / 'socket')


@pytest.mark.parametrize('folder', ['', '/', '.'])
def test_a_folder_is_refused(tmp_path, folder):
    with pytest.raises(InputError, match='expected a regular file, found a folder'):
        write(folder or tmp_path)


def test_a_read_only_file_is_refused(tmp_path):
    path = tmp_path / 'file'
    path.write_text('old')
    path.chmod(0o444)
    with pytest.raises(InputError, match='file: expected a writable file, found a read-only one'):
        write(path)
    assert path.read_text() == 'old'


@pytest.mark.parametrize(('name', 'message'), [
    ('none/file', 'No such file or directory'), ('file/file', 'Not a directory'),
    (300 * 'x', 'File name too long'), ('loop', 'Too many levels of symbolic links'),
    ('/proc/file', 'No such file or directory')])
def test_a_place_where_nothing_can_be_written_is_reported_before_any_work(tmp_path, name, message):
    (tmp_path / 'file').touch()
    (tmp_path / 'loop').symlink_to('loop')
    before = set(tmp_path.iterdir())
    with pytest.raises(InputError, match=message):
        files.check((tmp_path / name, '.json'))
    assert set(tmp_path.iterdir()) == before


def test_a_name_may_be_as_long_as_names_can_be(tmp_path):
    write(tmp_path / (85 * '\u4e2d'))
    assert [path.read_text() for path in tmp_path.iterdir()] == ['new']


@pytest.mark.parametrize('name', ['motion', 'run.1', 'run.1.mcap', '2024.11.22', 'a.MCAP', '.x'])
def test_a_name_with_dots_is_a_name(tmp_path, name):
    files.check((tmp_path / name, '.mcap' if name.lower().endswith('mcap') else files.FOLDER))


@pytest.mark.parametrize('suffix', ['.csv', '.db3', '.PNG'])
@pytest.mark.parametrize('expected', ['.mcap', files.FOLDER])
def test_a_name_that_promises_another_format_is_refused(tmp_path, suffix, expected):
    with pytest.raises(InputError, match=f'expected a name ending .* found {suffix.lower()}'):
        files.check((tmp_path / f'motion{suffix}', expected))


def test_what_changes_while_a_file_is_written_is_checked_again(tmp_path):
    # The input takes the name of the output.
    source, output = tmp_path / 'source', tmp_path / 'output'
    source.write_text('input')
    with pytest.raises(InputError, match='output: would overwrite the input .*source'), \
            files.reading(source), files.atomic_output(output, '.json') as part:
        part.write_text('new')
        source.rename(output)
    assert [path.read_text() for path in tmp_path.iterdir()] == ['input']


def test_what_is_read_no_longer_may_be_replaced(tmp_path):
    path = tmp_path / 'file'
    path.write_text('old')
    with files.reading(path), pytest.raises(InputError):
        write(path)
    write(path)
    assert path.read_text() == 'new'


def test_journals_of_sqlite_are_read_with_their_file(tmp_path):
    journal = tmp_path / 'bag.db3-wal'
    journal.write_text('old')
    with files.reading(tmp_path / 'bag.db3'), \
            pytest.raises(InputError, match='overwrite the in'):
        write(journal)


def test_an_incomplete_file_gets_a_free_name(tmp_path):
    taken = tmp_path / 'out.partial.mcap'
    taken.symlink_to('missing')
    for number in (2, 3):
        part = files.Part(tmp_path / 'out.mcap', '.mcap')
        part.path.write_text(str(number))
        assert part.keep(part.path, '.mcap') == tmp_path / f'out.partial.{number}.mcap'
        assert (tmp_path / f'out.partial.{number}.mcap').read_text() == str(number)
        part.discard()
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize('use', [
    recording.read, lambda path: recording.topics(path, recording.TORQUES), read_measured,
    scene.load, lambda path: replay(path, TUMBLER), lambda path: read_motion(path, TUMBLER),
    lambda path: compare_recording(path, TUMBLER), lambda path: read_json(path, 'fit'),
    lambda path: replay(RECORDINGS / 'tumbler.mcap', TUMBLER, path),
    lambda path: recording.Writer(path).__enter__(),
    lambda path: recording.FolderWriter(path).__enter__(),
    lambda path: files.check((path, '.png')),
    lambda path: files.protected('scene', path).__enter__()])
def test_a_path_with_a_null_byte_is_one_line(tmp_path, use):
    words = r'a\\x00b.*: .*null (byte|character)|expected a name ending in'
    for suffix in ('', '.mcap', '.db3', '.mcap.zst', '.yaml'):
        with pytest.raises(InputError, match=words):
            use(tmp_path / f'a\0b{suffix}')
