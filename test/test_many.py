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
import shutil
import signal
import subprocess
import sys
import time

from conftest import at_night, CONFIG, EPOCH_NS, NAME, RECORDINGS, ROOT, SECOND
import numpy as np
import pytest
from rigid_body_ros import messages, recording
from rigid_body_ros.commands import main
from rigid_body_ros.replay.many import outputs_in, replay_many
from rigid_body_ros.scene import InputError, load

SCENE = ['--scene', str(CONFIG / 'tumbler.yaml')]
COMMAND = [sys.executable, '-c', 'import sys; from rigid_body_ros.commands import main; '
           'sys.exit(main.attitude_replay())']


@pytest.mark.slow
def test_a_bad_recording_does_not_keep_others_from_their_motion(tmp_path, capfd):
    shutil.copy(RECORDINGS / 'tumbler.mcap', tmp_path / 'one.mcap')
    (tmp_path / 'bad.mcap').write_bytes(b'nothing')
    (tmp_path / 'two.csv').write_text('time,tx,ty,tz\n1.5,0,0,0\n2.5,0.1,0,0\n')
    names = [str(tmp_path / name) for name in ('one.mcap', 'bad.mcap', 'two.csv')]
    assert main.attitude_replay([*names, *SCENE, '-o', str(tmp_path / 'out')]) == 2
    one, bad, two, last = (captured := capfd.readouterr()).out.splitlines()
    assert one.startswith(f'{names[0]}  ')
    assert f'{names[1]}: expected an MCAP file' in bad
    assert '2 torques, 1 s -> ' in two
    assert last == '2 of 3 written'
    assert captured.err == ('attitude_replay: error: 1 of 3 recordings failed: '
                            f'{names[1]}\n')
    assert sorted(path.name for path in (tmp_path / 'out').iterdir()) == ['one.mcap', 'two.mcap']
    alone = tmp_path / 'alone.mcap'
    assert main.attitude_replay([names[0], *SCENE, '-o', str(alone)]) == 0
    found, expected = (recording.read(path, '/attitude', messages.QUATERNION).values
                       for path in (tmp_path / 'out' / 'one.mcap', alone))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(('option', 'output'), [('--plot', 'm.png'), ('--report', 'm.html')])
def test_a_picture_or_a_page_shows_one_recording(tmp_path, monkeypatch, capsys, option, output):
    monkeypatch.chdir(tmp_path)
    assert main.attitude_replay(['x.csv', 'y.csv', 'z.csv', *SCENE, '-o', 'out', option,
                                 output]) == 2
    assert capsys.readouterr().err == \
        f'attitude_replay: error: {option}: expected one recording, found 3\n'
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_an_output_does_not_replace_an_input_by_another_name(tmp_path, capsys):
    names = [tmp_path / name for name in ('a.csv', 'b.csv')]
    for name in names:
        name.write_text('1,0,0,0\n2,0.1,0,0\n')
    (tmp_path / 'out').mkdir()
    os.link(names[0], tmp_path / 'out' / 'b.mcap')
    assert main.attitude_replay([*map(str, names), *SCENE, '-o', str(tmp_path / 'out'),
                                 '--overwrite']) == 2
    assert 'b.mcap: would overwrite the input' in capsys.readouterr().err
    assert names[0].read_text() == '1,0,0,0\n2,0.1,0,0\n'


@pytest.fixture
def two_long_ones(tmp_path):
    """Start to replay two recordings, which takes long; yield the process once both run."""
    names = []
    for name in 'ab':
        names.append(str(tmp_path / f'{name}.mcap'))
        shutil.copy(RECORDINGS / 'tumbler.mcap', names[-1])
    process = subprocess.Popen([*COMMAND, *names, *SCENE, '-o', str(tmp_path / 'out'),
                                '--rate', '1000', '--until', '86400'], stderr=subprocess.PIPE,
                               stdout=subprocess.PIPE, text=True, start_new_session=True)
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
    first, second, last = out.splitlines()
    for line, name in ((first, 'a'), (second, 'b')):
        name = tmp_path / f'{name}.mcap'
        assert line == (f'{name}  failed: {name}: worker process killed (signal 9)')
    assert last == '0 of 2 written'
    assert words == ('attitude_replay: error: 2 of 2 recordings failed: '
                     f'{tmp_path / "a.mcap"}, {tmp_path / "b.mcap"}\n')


@pytest.mark.parametrize(('path', 'name'), [
    ('run.1.mcap', 'run.1'), ('run.2.mcap', 'run.2'), ('x.mcap.zstd', 'x'), ('x.mcap.zst', 'x'),
    ('x_0.db3.zstd', 'x_0'), ('x_0.db3', 'x_0'), ('a.b.csv', 'a.b'), ('a.CSV', 'a'),
    ('bag', 'bag'), ('bags/run.1/', 'run.1'), ('bags/run.1/.', 'run.1'),
    ('2024.11.22', '2024.11.22'), ('.mcap', '.mcap')])
def test_a_motion_has_the_name_of_its_recording(path, name):
    assert outputs_in('out', [path]) == [f'out/{name}.mcap']


@pytest.mark.nightly
def test_recordings_whose_names_have_dots_are_different(tmp_path):
    names = [tmp_path / name for name in ('run.1.csv', 'run.2.csv')]
    for name in names:
        name.write_text('1,0,0,0\n2,0.1,0,0\n')
    outcomes = replay_many([*map(str, names)], load(SCENE[1]), tmp_path / 'out')
    assert [outcome.error for outcome in outcomes] == ['', '']
    assert sorted(path.name for path in (tmp_path / 'out').iterdir()) == [
        'run.1.mcap', 'run.2.mcap']


@pytest.mark.slow
def test_the_script_that_ros2_run_starts_replays_several(installed, tmp_path):
    # The worker processes import the script again.
    names = [tmp_path / name for name in ('a.csv', 'b.csv')]
    for name in names:
        name.write_text('1,0,0,0\n2,0.1,0,0\n')
    script = installed / 'lib' / NAME / 'attitude_replay'
    result = subprocess.run([sys.executable, script, *names, *SCENE, '-o', tmp_path / 'out'],
                            capture_output=True, text=True, check=False,
                            env={**os.environ, 'PYTHONPATH': str(ROOT)})
    assert (result.returncode, result.stderr) == (0, '')
    assert result.stdout.splitlines()[-1] == '2 of 2 written'


@pytest.mark.parametrize('paths', [['a/x.mcap', 'b/x.mcap'], ['a/x.mcap', 'a/x.csv'],
                                   ['x.mcap', 'x.mcap'], ['a/x', 'b/x/']])
def test_two_recordings_of_one_name_are_refused(tmp_path, capsys, paths):
    assert main.attitude_replay([*paths, *SCENE, '-o', str(tmp_path / 'out')]) == 2
    line, = capsys.readouterr().err.splitlines()
    assert ('out/x.mcap: expected recordings with different names, '
            f'found {paths[0]} and {paths[1]}') in line
    assert not list(tmp_path.iterdir())


def test_several_recordings_go_to_a_folder(tmp_path, capsys):
    output = tmp_path / 'motion.mcap'
    arguments = ['x.csv', 'y.csv', *SCENE, '-o', str(output)]
    assert main.attitude_replay(arguments) == 2
    line, = capsys.readouterr().err.splitlines()
    assert ('motion.mcap: expected a folder for several recordings, found a name ending in '
            '.mcap') in line
    output.touch()
    assert main.attitude_replay(arguments) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.slow
def test_an_output_that_cannot_be_written_is_reported_beside_the_others(tmp_path):
    names = [tmp_path / name for name in ('a.csv', 'b.csv')]
    for name in names:
        name.write_text('1,0,0,0\n2,0.1,0,0\n')
    (tmp_path / 'out' / 'a.mcap').mkdir(parents=True)
    first, second = replay_many([*map(str, names)], load(SCENE[1]), tmp_path / 'out')
    assert 'a.mcap: expected a regular file, found a folder' in first.error
    assert not second.error
    assert sorted(path.name for path in (tmp_path / 'out').iterdir()) == ['a.mcap', 'b.mcap']


@pytest.mark.slow
def test_torques_as_text_are_read_to_the_nanosecond_and_the_last_bit(tmp_path):
    random = np.random.default_rng(2)
    stamps = EPOCH_NS + np.cumsum(random.integers(1, SECOND, 20_000))
    torques = random.normal(size=(len(stamps), 3))
    lines = [f'{stamp // SECOND}.{stamp % SECOND:09},{x!r},{y!r},{z!r}'
             for stamp, (x, y, z) in zip(stamps.tolist(), torques.tolist())]
    path = tmp_path / 'torque.csv'
    path.write_text('\n'.join(['t,tx,ty,tz', *lines, '']))
    found = recording.read(path)
    np.testing.assert_array_equal(found.stamps_ns, stamps)
    np.testing.assert_array_equal(found.values[:, 3:], torques)
    assert set(found.frame_ids) == {''}


@pytest.mark.parametrize(('text', 'message'), [
    ('1,2,3\n', r"line 1: expected time \(s\), tx, ty, tz \(N m\), found '1,2,3'"),
    ('1,0,0,0\n2,0,0,x\n', "line 2: expected .* found '2,0,0,x'"),
    ('-1,0,0,0\n', 'line 1: expected a time from 0'),
    ('1e30,0,0,0\n', 'line 1: expected a time from 0'),
    ('nan,0,0,0\n', 'line 1: expected time'), ('\0', 'expected'),
    (b'\xff', 'expected text in UTF-8')])
def test_a_wrong_line_is_named(tmp_path, text, message):
    path = tmp_path / 'torque.csv'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=message):
        recording.torque_log(path, recording.read(path), 'base_link', 'world')
