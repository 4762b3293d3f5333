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

"""The folder of an ensemble: one process at a time, and only valid files with final names."""

from contextlib import contextmanager, ExitStack
import errno
import fcntl
import json
import shutil
import signal
import socket
import subprocess
import time

from conftest import at_night, files_up_to
import matplotlib.image
import numpy as np
import psutil
from pyarrow import parquet
import pytest
from rigid_body_ros.ensemble.folder import LOCK
from test_ensemble import (
    arguments,
    COMMAND,
    contents,
    count,
    ENVIRONMENT,
    HZ,
    inputs,
    make_blocks_small,
    run,
    small_blocks,
    undrawn,
    without_recording,
    write_inputs,
)

inputs, small_blocks, undrawn = inputs, small_blocks, undrawn  # fixtures, used by their names
#: A body whose motion takes days to compute, with steps for each radian, unless it is at rest.
ENDLESS_SCENE = """/**:
  ros__parameters:
    inertia: {ixx: 0.1, iyy: 0.12, izz: 0.14}
    damping: {dxx: 1.0e-15}
"""
ENDLESS = 'initial_angular_velocity.y: {uniform: [6.0, 7.0]}\n'


@contextmanager
def started(given):
    """Start a command, and kill it at the end of the context, even if it is suspended."""
    with subprocess.Popen([*COMMAND, *given], env=ENVIRONMENT, stdout=subprocess.DEVNULL,
                          stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, 'waited too long'
        time.sleep(0.005)


def everything(path):
    """Return all files in a folder, with their bytes and times."""
    return {str(found.relative_to(path)): (found.read_bytes(), found.stat().st_mtime_ns)
            for found in path.rglob('*') if found.is_file()}


def check_whole(path):
    """Check that any results in a folder have each run once; return whether it has a summary."""
    if (path / 'runs.parquet').exists():
        identity = json.loads((path / 'identity.json').read_text())
        rows = parquet.read_table(path / 'runs.parquet')
        assert rows['run'].to_pylist() == [*range(identity['runs'])]
    if (path / 'bands.png').exists():
        assert matplotlib.image.imread(path / 'bands.png').size
    if not (path / 'summary.json').exists():
        return False
    assert json.loads((path / 'summary.json').read_text())['runs'] == len(rows)
    return True


@pytest.mark.slow
def test_a_second_command_changes_nothing(inputs, refusal):
    run(inputs, 'whole', 6000)
    path = inputs / 'out'
    run(inputs, 'out', 20)
    assert check_whole(path)
    (path / 'bands.png').touch()
    with started(arguments(inputs, 'out', 6000)) as first:
        wait_for(lambda: count(path / 'blocks') > 20 or first.poll() is not None)
        first.send_signal(signal.SIGSTOP)
        before = everything(path)
        for runs in (6000, 5000, 7000):
            line = refusal('attitude_ensemble', *arguments(inputs, 'out', runs))
            assert line.startswith(f'attitude_ensemble: error: {path}: another attitude_ensemble, '
                                   f'process {first.pid} on host {socket.gethostname()}, writes '
                                   'to it since 20')
        assert everything(path) == before
        # The results of fewer runs do not outlive the beginning of more.
        for name in ('summary.json', 'bands.png', 'runs.parquet'):
            assert not (path / name).exists()
        first.send_signal(signal.SIGCONT)
        first.kill()
    run(inputs, 'out', 6000)
    assert contents(path) == contents(inputs / 'whole')


@pytest.mark.slow
def test_a_file_system_without_locks_is_reported(inputs, capsys, monkeypatch):
    def none(handle, operation):
        raise OSError(errno.ENOLCK, 'No locks available')
    monkeypatch.setattr(fcntl, 'flock', none)
    run(inputs, 'out', 5)
    assert capsys.readouterr().err == (
        f'attitude_ensemble: note: {inputs / "out"}: cannot lock it (No locks available); start '
        'no other command that writes to it\n')


@pytest.mark.parametrize('name', ['mine', 'lock'])
def test_a_folder_of_something_else_gets_no_lock(inputs, refusal, name):
    (inputs / 'out').mkdir()
    (inputs / 'out' / name).write_text('precious')
    assert 'expected a new folder' in refusal('attitude_ensemble', *arguments(inputs, 'out', 5))
    assert [path.name for path in (inputs / 'out').iterdir()] == [name]


@pytest.mark.slow
def test_a_link_in_place_of_the_lock_is_not_followed(inputs, refusal):
    run(inputs, 'out', 5)
    (inputs / 'mine').write_text('precious')
    (inputs / 'out' / LOCK).unlink()
    (inputs / 'out' / LOCK).symlink_to(inputs / 'mine')
    assert 'cannot write' in refusal('attitude_ensemble', *arguments(inputs, 'out', 5))
    assert (inputs / 'mine').read_text() == 'precious'


def flipped(path, other):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)


@pytest.fixture(scope='module')
def two(tmp_path_factory):
    """Return a folder with two ensembles of small blocks, which differ in their seed."""
    inputs = write_inputs(tmp_path_factory.mktemp('two'))
    with pytest.MonkeyPatch.context() as monkeypatch:
        make_blocks_small(monkeypatch)
        run(inputs, 'other', 20, '--seed', 1)
        run(inputs, 'out', 20)
    return inputs


@pytest.mark.slow
@pytest.mark.usefixtures('small_blocks')
@pytest.mark.parametrize('change', [
    flipped,
    lambda path, other: path.write_bytes(b''),
    lambda path, other: shutil.copy(other, path),
    lambda path, other: (path.unlink(), shutil.copy(other, path.parent)),
    lambda path, other: path.rename(path.with_name(f'{path.name[:19]}.parquet')),
    lambda path, other: shutil.copy(sorted(path.parent.iterdir())[2], path),
], ids=['bit', 'empty', 'content', 'file', 'without digest', 'other runs'])
def test_a_block_that_does_not_fit_is_computed_again(tmp_path, two, capsys, change):
    inputs = shutil.copytree(two, tmp_path / 'inputs')
    expected = contents(inputs / 'out')
    change(*(sorted((inputs / name / 'blocks').iterdir())[1] for name in ('out', 'other')))
    capsys.readouterr()
    run(inputs, 'out', 20)
    assert capsys.readouterr().err == (
        f'attitude_ensemble: note: {inputs / "out"}: ignored blocks that are damaged or from '
        'elsewhere, of the runs 5 to 9; what is missing is computed again\n')
    assert contents(inputs / 'out') == expected
    run(inputs, 'out', 20)
    assert capsys.readouterr().err == ''


@pytest.mark.slow
@pytest.mark.usefixtures('small_blocks')
@pytest.mark.parametrize('change', [
    lambda chunk, other: chunk.write_bytes(chunk.read_bytes()[:-9]),
    *at_night(lambda chunk, other: shutil.copy(other, chunk),
              lambda chunk, other: chunk.write_bytes(b'')),
], ids=['short', 'of other runs', 'empty'])
def test_a_chunk_that_does_not_fit_is_computed_again(inputs, capsys, change):
    run(inputs, 'whole', 60, '--times', HZ)
    run(inputs, 'out', 23, '--times', HZ)
    run(inputs, 'out', 58, '--times', HZ)
    expected, chunks = contents(inputs / 'whole'), inputs / 'out' / 'motion.zarr' / 'motion'
    for runs in (58, 60):  # the second command also adds runs
        change(chunks / '4.0.0', chunks / '3.0.0')  # the first chunk has runs of two blocks
        capsys.readouterr()
        run(inputs, 'out', runs, '--times', HZ)
        note, = capsys.readouterr().err.splitlines()
        assert note.startswith(f'attitude_ensemble: note: {inputs / "out"}: ignored blocks that '
                               'are damaged or from elsewhere, of the runs 20 to 2')
    assert contents(inputs / 'out') == expected


@pytest.mark.slow
@pytest.mark.parametrize(('number', 'more'), [
    (signal.SIGINT, []), *at_night((signal.SIGTERM, ['--times', '1e-3']))])
def test_a_signal_ends_endless_runs(inputs, number, more):
    (inputs / 'scene.yaml').write_text(ENDLESS_SCENE)
    (inputs / 'vary.yaml').write_text(ENDLESS)
    given = arguments(inputs, 'out', 50_000, '--until', 1e6, *more)
    with started(without_recording(given, inputs)) as process:
        wait_for(lambda: computes(process) or process.poll() is not None)
        process.send_signal(number)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert error == ('attitude_ensemble: interrupted; run the same command again to continue in '
                     f'{inputs / "out"}\n')
    assert not (inputs / 'out' / 'runs.parquet').exists()


def computes(process):
    """Return whether a process has threads that have computed for a while."""
    threads = psutil.Process(process.pid).threads()
    return sum(thread.user_time for thread in threads if thread.id != process.pid) > 1.0


@pytest.mark.nightly
@pytest.mark.parametrize('more', [[], ['--times', HZ]])
def test_commands_that_race_and_die_leave_nothing_false(inputs, more):
    began = time.monotonic()
    with started(arguments(inputs, 'whole', 3000, *more)) as process:
        process.communicate()
    seconds, random = time.monotonic() - began, np.random.default_rng(2)
    for number in range(25):
        name = f'out{number}'
        race(inputs, name, random, seconds, more)
        check_whole(inputs / name)
        run(inputs, name, 3000, *more)
        assert check_whole(inputs / name)
        assert contents(inputs / name) == contents(inputs / 'whole')
        shutil.rmtree(inputs / name)


def race(inputs, name, random, seconds, more):
    """Start commands on the same folder at random times, and kill them at random times."""
    count = int(random.integers(2, 4))
    events = [(float(when), 'start', k) for k, when in enumerate(
        random.uniform(0.0, 0.5 * seconds, count))]
    events += [(when + float(random.uniform(0.3, 1.2)) * seconds, 'kill', k)
               for when, _, k in events]
    runs, processes = random.choice([2500, 3000], count).tolist(), {}
    began = time.monotonic()
    with ExitStack() as stack:
        for when, kind, k in sorted(events):
            time.sleep(max(0.0, began + when - time.monotonic()))
            if kind == 'start':
                processes[k] = stack.enter_context(started(
                    arguments(inputs, name, runs[k], *more)))
                continue
            processes[k].kill()
            _, error = processes[k].communicate()
            lines = len(error.splitlines())
            assert (processes[k].returncode, lines) in (
                (0, 0), (2, 1), (-signal.SIGKILL, 0), (-signal.SIGKILL, 1)), error


@pytest.mark.slow
@pytest.mark.parametrize('share', [0.1, *at_night(0.0, 0.01, 0.03, 0.2, 0.3, 0.5, 0.7, 0.9)])
def test_a_write_that_fails_is_one_line_and_the_folder_is_resumed(inputs, capsys, share, refusal):
    run(inputs, 'whole', 3000, '--times', 7)
    largest = max(path.stat().st_size for path in (inputs / 'whole').rglob('*'))
    with files_up_to(round(share * largest)):
        line = refusal('attitude_ensemble', *arguments(inputs, 'out', 3000, '--times', 7))
    assert line.startswith(f'attitude_ensemble: error: {inputs / "out"}')
    assert 'File too large' in line
    assert not check_whole(inputs / 'out')
    run(inputs, 'out', 3000, '--times', 7)
    assert capsys.readouterr().err == ''
    assert contents(inputs / 'out') == contents(inputs / 'whole')


@pytest.mark.slow
def test_a_run_that_is_missing_is_found_before_the_table_has_its_name(inputs, refusal,
                                                                      monkeypatch):
    from rigid_body_ros.ensemble import driver
    monkeypatch.setattr(driver, '_divided', lambda spans, workers: spans[:-1])
    line = refusal('attitude_ensemble', *arguments(inputs, 'out', 320))
    assert 'expected each of 320 runs once, found run 310 missing or twice' in line
    assert not (inputs / 'out' / 'runs.parquet').exists()
