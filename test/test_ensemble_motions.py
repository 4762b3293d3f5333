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

"""The motions of an ensemble: the states of `propagate`, with the same bytes however it runs."""

import shutil

from conftest import at_night
import numpy as np
from pyarrow import parquet
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.ensemble import motions
from test_ensemble import (
    arguments,
    contents,
    error_of,
    inputs,
    kill,
    run,
    small_blocks,
    TIMES,
    TORQUES,
)
import zarr

inputs, small_blocks = inputs, small_blocks  # fixtures, used by their names
HZ = 7
SECOND = 10 ** 9


@pytest.fixture
def small_chunks(monkeypatch, small_blocks):
    monkeypatch.setattr(motions, '_RUNS', 5)


def motion_of(path):
    return zarr.open_group(path / 'motion.zarr', mode='r')['motion'][:]


@pytest.mark.slow
def test_every_state_has_the_bits_of_propagate(inputs):
    run(inputs, 'out', 60, '--times', HZ)
    rows = parquet.read_table(inputs / 'out' / 'runs.parquet').to_pylist()
    group = zarr.open_group(inputs / 'out' / 'motion.zarr', mode='r')
    stamps = np.round(TIMES * 1e9).astype(np.int64)
    start_ns = 1
    at = start_ns + np.round(group['time'][:] * 1e9).astype(np.int64)
    assert [*at] == [*(start_ns + round(k * SECOND / HZ) for k in range(14)), stamps[-1]]
    for row in (rows[k] for k in np.random.default_rng(2).permutation(60)[:20]):
        body = RigidBody.from_moments(*(row[f'inertia.i{entry}'] for entry in (
            'xx', 'yy', 'zz', 'xy', 'xz', 'yz')))
        start = State(start_ns, [row[f'initial_attitude.{axis}'] for axis in 'xyzw'],
                      [row[f'initial_angular_velocity.{axis}'] for axis in 'xyz'])
        log = TorqueLog(stamps + round(row['clock_offset'] * 1e9), row['torque_gain'] * TORQUES)
        motion = propagate(body, start, log, at=at)
        found = group['motion'][row['run']]
        assert np.array_equal(found[:, :4], motion.attitude)
        assert np.array_equal(found[:, 4:], motion.angular_velocity)
        assert found[-1].tolist() == [row[name] for name in group['component'][:]]


@pytest.mark.slow
def test_xarray_opens_the_motions_with_their_coordinates(inputs):
    xarray = pytest.importorskip('xarray', reason='xarray is not installed')
    run(inputs, 'out', 5, '--times', 4)
    found = xarray.open_zarr(inputs / 'out' / 'motion.zarr')
    assert found.motion.dims == ('run', 'time', 'component')
    assert found.time.values.tolist() == [*np.arange(8) / 4, 1.949999999]
    assert (found.time.units, found.component.unit) == ('s', [''] * 4 + ['rad/s'] * 3)
    ends = found.motion.isel(time=-1)
    table = parquet.read_table(inputs / 'out' / 'runs.parquet')
    for name in found.component.values.tolist():
        assert ends.sel(component=name).values.tolist() == table[name].to_pylist()


@pytest.mark.nightly
@pytest.mark.usefixtures('small_chunks')
def test_workers_extension_and_lost_files_give_the_same_bytes(inputs):
    run(inputs, 'one', 58, '--times', HZ, '--workers', 1)
    run(inputs, 'two', 58, '--times', HZ, '--workers', 2)
    run(inputs, 'extended', 23, '--times', HZ)
    run(inputs, 'extended', 58, '--times', HZ)
    expected = contents(inputs / 'one')
    assert 'motion.zarr/motion/11.0.0' in expected
    assert contents(inputs / 'two') == contents(inputs / 'extended') == expected
    next((inputs / 'two' / 'blocks').iterdir()).unlink()
    (inputs / 'extended' / 'motion.zarr' / 'motion' / '3.0.0').unlink()
    (inputs / 'one' / 'motion.zarr' / '.zmetadata').unlink()  # killed while creating the group
    part = f'0.0.{"0f" * 16}.partial'  # killed while writing a chunk
    (inputs / 'two' / 'motion.zarr' / 'motion' / part).write_text('half')
    for name in ('one', 'two', 'extended'):
        run(inputs, name, 58, '--times', HZ)
        assert contents(inputs / name) == expected


@pytest.mark.slow
@pytest.mark.usefixtures('small_chunks')
def test_failed_runs_are_nan_and_no_chunk_is_missing(inputs):
    (inputs / 'vary.yaml').write_text('inertia.izz: {normal: 0.1}\n')
    run(inputs, 'out', 58, '--times', HZ)
    found, table = motion_of(inputs / 'out'), parquet.read_table(inputs / 'out' / 'runs.parquet')
    failed = np.array([status == 'failed' for status in table['status'].to_pylist()])
    assert 0 < failed.sum() < 58
    assert len([*(inputs / 'out' / 'motion.zarr' / 'motion').glob('*.0.0')]) == 12
    assert np.isnan(found[failed]).all()
    assert np.isfinite(found[~failed]).all()


@pytest.mark.slow
@pytest.mark.parametrize(('runs', 'more', 'message'), [
    (10, (), "expected the times of its runs, 7.0, found 'final'"),
    (10, ('--times', 8), 'expected the times of its runs, 7.0, found 8.0'),
])
def test_other_times_are_another_ensemble(inputs, capsys, runs, more, message):
    run(inputs, 'out', 10, '--times', HZ)
    expected = contents(inputs / 'out')
    capsys.readouterr()
    assert message in error_of(capsys, inputs, 'out', runs, *more)
    assert contents(inputs / 'out') == expected


@pytest.mark.parametrize('text', ['0', '-1', 'nan', 'inf', 'often'])
def test_impossible_times(inputs, capsys, text):
    with pytest.raises(SystemExit) as ended:
        main.attitude_ensemble([*arguments(inputs, 'out', 3), f'--times={text}'])
    assert ended.value.code == 2
    assert '--times: expected final or a number from' in capsys.readouterr().err


def test_too_many_times(inputs, capsys):
    line = error_of(capsys, inputs, 'out', 3, '--times', '1e9')
    assert '--times: expected at most 2097152 states in a run, found 1e+09 Hz over 1.95 s' in line
    assert not (inputs / 'out').exists()


@pytest.mark.parametrize(('end_ns', 'rate', 'expected'), [
    (SECOND, 2.0, [0, SECOND // 2, SECOND]), (SECOND, 0.3, [0, SECOND]), (0, 5.0, [0]),
    (SECOND, 3.0, [0, 333333333, 666666667, SECOND]),
    (1_100_000_001, 10.0, [*range(0, 12 * SECOND // 10, SECOND // 10), 1_100_000_001]),
])
def test_times_start_at_the_start_and_include_the_end(end_ns, rate, expected):
    assert motions.times_of(5, 5 + end_ns, rate).tolist() == [5 + time for time in expected]


@pytest.mark.slow
@pytest.mark.usefixtures('small_chunks')
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


@pytest.mark.nightly
@pytest.mark.parametrize('kills', [1, *at_night(3)])
def test_kills_and_resumes_give_the_same_bytes(inputs, kills):
    run(inputs, 'whole', 4000, '--times', HZ)
    kill(inputs, arguments(inputs, 'killed', 4000, '--times', HZ), kills)
    run(inputs, 'killed', 4000, '--times', HZ)
    assert contents(inputs / 'killed') == contents(inputs / 'whole')
