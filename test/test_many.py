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

"""Replay many recordings in one call, and torques from text files."""

from contextlib import suppress
import os
import re
import shutil
import signal
import subprocess
import sys
import time

from conftest import at_night, CONFIG, NAME, program, RECORDINGS, ROOT
import numpy as np
import pytest
from rigid_body_ros import messages, recording
from rigid_body_ros.commands import main
from rigid_body_ros.replay.many import outputs_in
from rigid_body_ros.scene import InputError

SCENE = ['--scene', str(CONFIG / 'tumbler.yaml')]
TEXT = '1.5,0,0,0\n2.5,0.1,0,0\n'


@pytest.mark.slow
def test_a_bad_recording_does_not_keep_others_from_their_motion(tmp_path):
    (tmp_path / 'bad.mcap').write_bytes(b'nothing')
    (tmp_path / 'out' / 'kept.mcap').mkdir(parents=True)
    for name in ('two.csv', 'kept.csv', 'a.1.csv', 'a.2.csv'):
        (tmp_path / name).write_text(TEXT)
    names = [str(tmp_path / name) for name in (
        'bad.mcap', 'two.csv', 'kept.csv', 'a.1.csv', 'a.2.csv')]
    # The worker processes import the script that `ros2 run` starts again.
    text = re.search('SCRIPT = """(.*?)"""', (ROOT / 'setup.py').read_text(), re.S)[1]
    (tmp_path / 'script').write_text(text.format(package=NAME, command='attitude_replay'))
    result = subprocess.run([sys.executable, tmp_path / 'script', *names, *SCENE, '-o',
                             tmp_path / 'out', '--overwrite'], capture_output=True, text=True)
    bad, two, kept, *_, last = result.stdout.splitlines()
    assert f'{names[0]}: expected an MCAP file' in bad
    assert '2 torques, 1 s -> ' in two
    assert 'kept.mcap: expected a regular file, found a folder' in kept
    assert last == '3 of 5 written'
    assert (result.returncode, result.stderr) == (
        2, f'attitude_replay: error: 2 of 5 recordings failed: {names[0]}, {names[2]}\n')
    assert sorted(path.name for path in (tmp_path / 'out').iterdir()) == [
        'a.1.mcap', 'a.2.mcap', 'kept.mcap', 'two.mcap']
    alone = tmp_path / 'alone.mcap'
    assert main.attitude_replay([names[1], *SCENE, '-o', str(alone)]) == 0
    found, expected = (recording.read(path, '/attitude', messages.QUATERNION).values
                       for path in (tmp_path / 'out' / 'two.mcap', alone))
    np.testing.assert_array_equal(found, expected)


NAMES = ': expected recordings with different names, found {} and {}'


@pytest.mark.parametrize(('arguments', 'expected'), [
    *((['x.csv', 'y.csv', 'z.csv', '-o', 'out', option, output],
       f'{option}: expected one recording, found 3')
      for option, output in (('--plot', 'm.png'), ('--report', 'm.html'))),
    *(([*paths, '-o', 'out'], f'out/x.mcap{NAMES.format(*paths)}') for paths in (
        ['a/x.mcap', 'b/x.mcap'], ['a/x.mcap', 'a/x.csv'], ['x.mcap', 'x.mcap'],
        ['a/x', 'b/x/'])),
    (['x.csv', 'y.csv'], '-o: expected a folder for several recordings, found none'),
    (['x.csv', 'y.csv', '-o', 'motion.mcap'], 'motion.mcap: expected a folder for several '
     'recordings, found a name ending in .mcap'),
    (['a.csv', 'b.csv', '-o', 'out', '--overwrite'], 'b.mcap: would overwrite the input')])
def test_a_wrong_output_is_refused(tmp_path, monkeypatch, refusal, arguments, expected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'out').mkdir()
    (tmp_path / 'a.csv').write_text(TEXT)
    (tmp_path / 'b.csv').write_text(TEXT)
    os.link('a.csv', 'out/b.mcap')  # an input by another name
    assert expected in refusal('attitude_replay', *arguments, *SCENE)
    assert (tmp_path / 'a.csv').read_text() == TEXT
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a.csv', 'b.csv', 'out']


@pytest.fixture
def two_long_ones(tmp_path):
    """Start to replay two recordings, which takes long; yield the process once both run."""
    names = []
    for name in 'ab':
        names.append(str(tmp_path / f'{name}.mcap'))
        shutil.copy(RECORDINGS / 'tumbler.mcap', names[-1])
    command = [*program('attitude_replay'), *names, *SCENE, '-o', str(tmp_path / 'out'),
               '--rate', '1000', '--until', '86400']
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               start_new_session=True)
    try:
        for _ in range(600):
            if len(list((tmp_path / 'out').glob('.*.part'))) == min(2, os.cpu_count()):
                break
            time.sleep(0.1)
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


# Ctrl-C signals all processes of a terminal; `timeout` signals its child, and then all as well.
@pytest.mark.slow
@pytest.mark.parametrize('number', [signal.SIGINT, *at_night(signal.SIGTERM)])
@pytest.mark.parametrize('send', [[os.killpg], *at_night([os.kill],
                                                         [os.kill, os.killpg, os.kill])],
                         ids=['all', 'one', 'repeated'])
def test_a_signal_ends_all_of_them(tmp_path, two_long_ones, number, send):
    for to in send:
        to(two_long_ones.pid, number)
        time.sleep(0.03)
    _, words = two_long_ones.communicate(timeout=30)
    assert two_long_ones.returncode == 128 + number
    partial = sorted(path.name for path in (tmp_path / 'out').glob('*.partial.mcap'))
    kept = f'what was written so far is in {tmp_path / "out"}: {", ".join(partial)}' \
        if partial else 'no partial output was left'
    assert words.splitlines() == [f'attitude_replay: interrupted; {kept}']
    assert not list((tmp_path / 'out').glob('[ab].mcap'))
    assert not list((tmp_path / 'out').glob('.*.part'))


@pytest.mark.slow
def test_a_process_that_is_killed_is_told(tmp_path, two_long_ones):
    for name in 'ab':
        part, *_ = [*(tmp_path / 'out').glob(f'.{name}.*.part')]
        os.kill(int(part.suffixes[-2][1:]), signal.SIGKILL)
        time.sleep(3.0)  # with one processor, the other run begins now
    out, words = two_long_ones.communicate(timeout=30)
    assert two_long_ones.returncode == 2
    first, second = tmp_path / 'a.mcap', tmp_path / 'b.mcap'
    assert out.splitlines() == [*(
        f'{name}  failed: {name}: worker process killed (signal 9)' for name in (first, second)),
        '0 of 2 written']
    assert words == f'attitude_replay: error: 2 of 2 recordings failed: {first}, {second}\n'


@pytest.mark.parametrize(('path', 'name'), [
    ('run.1.mcap', 'run.1'), ('x.mcap.zstd', 'x'), ('x_0.db3.zstd', 'x_0'), ('a.CSV', 'a'),
    ('bag', 'bag'), ('bags/run.1/', 'run.1'), ('bags/run.1/.', 'run.1'),
    ('2024.11.22', '2024.11.22'), ('.mcap', '.mcap')])
def test_a_motion_has_the_name_of_its_recording(path, name):
    assert outputs_in('out', [path]) == [f'out/{name}.mcap']


@pytest.mark.parametrize(('text', 'message'), [
    ('1,2,3\n', r"line 1: expected time \(s\), tx, ty, tz \(N m\), found '1,2,3'"),
    ('1,0,0,0\n2,0,0,x\n', "line 2: expected .* found '2,0,0,x'"),
    ('-1,0,0,0\n', 'line 1: expected a time from 0'),
    ('1e30,0,0,0\n', 'line 1: expected a time from 0'),
    ('nan,0,0,0\n', 'line 1: expected time'), ('\0', 'expected')])
def test_a_wrong_line_is_named(tmp_path, text, message):
    path = tmp_path / 'torque.csv'
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        recording.torque_log(path, recording.read(path), 'base_link', 'world')
