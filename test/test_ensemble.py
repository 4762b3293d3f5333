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

"""The command `attitude_ensemble` writes the same bytes however the runs are computed."""

import json
import os
import shutil
import sys

from conftest import nearest_rank, program, ROOT, SECOND
import numpy as np
from pyarrow import parquet
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.commands import main
from rigid_body_ros.ensemble import folder, motions
import zarr

SCENE = """/**:
  ros__parameters:
    inertia: {ixx: 0.045, iyy: 0.12, izz: 0.14, ixy: 0.002}
    initial_angular_velocity: {x: 0.15, y: 0.6, z: -0.1}
    start_time: 1
"""
VARY = """inertia: {relative: 0.05}
initial_attitude: {tilt: 0.02}
initial_angular_velocity.z: {normal: 0.1, relative: true}
torque_gain: {normal: 0.03}
clock_offset: {normal: 0.001}
"""
COMMAND = program('attitude_ensemble')
ENVIRONMENT = {**os.environ, 'PYTHONPATH': os.pathsep.join([str(ROOT), *sys.path])}
TIMES = np.arange(40) / 20.0
TORQUES = np.round(0.01 * np.sin(np.arange(120.0)).reshape(40, 3), 9)


HZ = 7


@pytest.fixture(autouse=True)
def undrawn(monkeypatch):
    """Draw no pictures, which take longer than the runs; `test_ensemble_results` draws them."""
    monkeypatch.setattr('rigid_body_ros.commands.ensemble._draw', lambda *given: None)


@pytest.fixture
def inputs(tmp_path):
    return write_inputs(tmp_path)


def write_inputs(path):
    (path / 'scene.yaml').write_text(SCENE)
    (path / 'vary.yaml').write_text(VARY)
    rows = [','.join(map(repr, row)) for row in np.column_stack([TIMES, TORQUES]).tolist()]
    (path / 'in.csv').write_text('\n'.join(['time,tx,ty,tz', *rows]) + '\n')
    return path


def arguments(inputs, output, runs, *more):
    return ['--scene', str(inputs / 'scene.yaml'), '--vary', str(inputs / 'vary.yaml'),
            '--recording', str(inputs / 'in.csv'), '--runs', str(runs),
            '-o', str(inputs / output), *map(str, more)]


def run(*given):
    assert main.attitude_ensemble(arguments(*given)) == 0


def contents(path):
    names = ('runs.parquet', 'summary.json', 'identity.json')
    return {str(found.relative_to(path)): found.read_bytes()
            for found in (*(path / name for name in names), *(path / 'motion.zarr').rglob('*'))
            if found.is_file() or found.name in names}


def without_recording(given, inputs):
    return [one for one in given if one not in ('--recording', str(inputs / 'in.csv'))]


def rows_of(path):
    return parquet.read_table(path / 'runs.parquet')


def numbers(row, prefix, axes='xyz'):
    return [row[f'{prefix}{axis}'] for axis in axes]


@pytest.mark.slow
def test_every_state_of_a_run_has_the_bits_of_propagate(inputs):
    run(inputs, 'out', 60, '--times', HZ)
    rows = rows_of(inputs / 'out').to_pylist()
    assert [row['run'] for row in rows] == [*range(60)]
    group = zarr.open_group(inputs / 'out' / 'motion.zarr', mode='r')
    stamps = np.round(TIMES * 1e9).astype(np.int64)
    start_ns = 1
    at = start_ns + np.round(group['time'][:] * 1e9).astype(np.int64)
    assert [*at] == [*(start_ns + round(k * SECOND / HZ) for k in range(14)), stamps[-1]]
    for row in (rows[k] for k in np.random.default_rng(2).permutation(60)[:20]):
        body = RigidBody.from_moments(*numbers(
            row, 'inertia.i', ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')))
        start = State(start_ns, numbers(row, 'initial_attitude.', 'xyzw'),
                      numbers(row, 'initial_angular_velocity.'))
        log = TorqueLog(stamps + round(row['clock_offset'] * 1e9), row['torque_gain'] * TORQUES)
        motion = propagate(body, start, log, at=at)
        found = group['motion'][row['run']]
        assert np.array_equal(found[:, :4], motion.attitude)
        assert np.array_equal(found[:, 4:], motion.angular_velocity)
        assert found[-1].tolist() == [row[name] for name in group['component'][:]]


@pytest.mark.slow
def test_units_and_summary(inputs, capsys):
    (inputs / 'vary.yaml').write_text('initial_angular_velocity.z: {normal: 1.0e-3}\n'
                                      'torque_gain: {normal: 1.0e-9}\n'
                                      'clock_offset: {normal: 1.0e-9}\n')
    run(inputs, 'out', 300, '--seed', 5)
    units = {field.name: (field.metadata or {}).get(b'unit')
             for field in rows_of(inputs / 'out').schema}
    assert (units['inertia.ixx'], units['initial_angular_velocity.z'], units['clock_offset']) == (
        b'kg m^2', b'rad/s', b's')
    assert 'torque_bias.x' not in units
    found = json.loads((inputs / 'out' / 'summary.json').read_text())
    angles = rows_of(inputs / 'out')['angle_from_nominal'].to_numpy()
    assert (found['seed'], found['runs'], found['failed']) == (5, 300, 0)
    for k in (5, 50, 99, 100):
        assert [found['angle_from_nominal_rad'][f'p{k}']] == nearest_rank(angles, [k])
    # Only one parameter explains the spread.
    correlation = found['rank_correlation']
    assert correlation.pop('initial_angular_velocity.z') > 0.99
    assert {*correlation} == {'torque_gain', 'clock_offset'}
    assert max(map(abs, correlation.values())) < 0.3
    assert 'depends on' in capsys.readouterr().out


@pytest.fixture
def small_blocks(monkeypatch):
    make_blocks_small(monkeypatch)


def make_blocks_small(monkeypatch):
    monkeypatch.setattr(folder, 'BLOCKS', 4)
    monkeypatch.setattr(folder, 'LONGEST', 7)
    monkeypatch.setattr(folder, 'GROUP', 16)
    monkeypatch.setattr(motions, '_RUNS', 5)


@pytest.mark.slow
@pytest.mark.usefixtures('small_blocks')
def test_workers_extension_and_lost_files_give_the_same_bytes(inputs):
    run(inputs, 'one', 58, '--times', HZ, '--workers', 1)
    run(inputs, 'two', 58, '--times', HZ, '--workers', 2)
    run(inputs, 'extended', 23, '--times', HZ)
    run(inputs, 'extended', 58, '--times', HZ)
    expected = contents(inputs / 'one')
    assert 'motion.zarr/motion/11.0.0' in expected
    assert parquet.read_metadata(inputs / 'one' / 'runs.parquet').num_row_groups == 4
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
@pytest.mark.usefixtures('small_blocks')
def test_nothing_but_its_own_blocks_is_removed(inputs):
    run(inputs, 'out', 20)
    expected, blocks = contents(inputs / 'out'), inputs / 'out' / 'blocks'
    before = {path.name for path in blocks.iterdir()}
    ours = ('.000000000-000000005-0123456789abcdef.parquet.0123456789abcdef.77.part',
            '000000003-000000009.parquet')  # of a dead process, and of an earlier version
    others = 'mine.parquet', '1-2.parquet', '000000000-000000005.parquet.bak', '.hidden'
    for name in (*ours, *others):
        (blocks / name).write_text('precious')
    (inputs / 'out' / 'notes.txt').write_text('precious')
    run(inputs, 'out', 20)
    assert {path.name for path in blocks.iterdir()} == {*before, *others}
    assert {(blocks / name).read_text() for name in others} == {'precious'}
    assert (inputs / 'out' / 'notes.txt').read_text() == 'precious'
    assert contents(inputs / 'out') == expected


def count(blocks):
    return len([*blocks.glob('0*.parquet')])


@pytest.mark.slow
@pytest.mark.usefixtures('small_blocks')
def test_failed_runs_are_rows_and_their_motions_are_nan(inputs, capsys):
    (inputs / 'vary.yaml').write_text('inertia.izz: {normal: 0.1}\n')
    run(inputs, 'out', 58, '--times', HZ)
    rows = rows_of(inputs / 'out').to_pylist()
    failed = np.array([row['status'] == 'failed' for row in rows])
    assert 10 < failed.sum() < 58
    assert all(row['attitude.x'] is None and row['message'] for row in rows
               if row['status'] == 'failed')
    path = inputs / 'out' / 'motion.zarr'
    found = zarr.open_group(path, mode='r')['motion'][:]
    assert len([*(path / 'motion').glob('*.0.0')]) == 12
    assert np.isnan(found[failed]).all()
    assert np.isfinite(found[~failed]).all()
    summary = json.loads((inputs / 'out' / 'summary.json').read_text())
    assert summary['failed'] == sum(summary['failures'].values()) == failed.sum()
    assert 'inertia: not physical, principal moments ... kg m^2: the largest exceeds the sum of ' \
        'the other two by ... % (limit 3 %)' in summary['failures']
    assert 'failed' in capsys.readouterr().out


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


@pytest.mark.slow
@pytest.mark.parametrize(('change', 'message'), [
    (lambda inputs: ('--seed', 7), 'expected the seed of its runs, 0, found 7'),
    (lambda inputs: ('--until', 1), 'expected the end_ns of its runs'),
    (lambda inputs: edit(inputs / 'scene.yaml', '0.045', '0.046'), 'expected the scene'),
    (lambda inputs: edit(inputs / 'vary.yaml', '0.03', '0.04'), 'expected the vary'),
    (lambda inputs: edit(inputs / 'in.csv', repr(TORQUES[0, 1].item()), '0.1'),
     'expected the recording'),
    (lambda inputs: ('--runs', 5), 'expected at least the 10 runs'),
    (lambda inputs: edit(inputs / 'out' / 'identity.json', '{', '['), 'cannot read the ensemble'),
    (lambda inputs: ('--times', 8), "expected the times of its runs, 'final', found 8.0"),
], ids=['seed', 'until', 'scene', 'vary', 'recording', 'fewer', 'damaged', 'times'])
def test_another_ensemble_is_refused(made, refusal, change, message):
    before = contents(made / 'out')
    more = change(made) or ()
    runs, more = (more[1], ()) if '--runs' in more else (10, more)
    line = refusal('attitude_ensemble', *arguments(made, 'out', runs, *more))
    assert line.startswith(f'attitude_ensemble: error: {made / "out"}')
    assert message in line
    if not message.startswith('cannot read'):
        assert contents(made / 'out') == before


@pytest.fixture
def made(tmp_path, made_once):
    """Return a copy of the inputs and of the results of ten runs."""
    return shutil.copytree(made_once, tmp_path / 'made')


@pytest.fixture(scope='module')
def made_once(tmp_path_factory):
    inputs = write_inputs(tmp_path_factory.mktemp('made'))
    run(inputs, 'out', 10)
    return inputs


def edit(path, old, new):
    path.write_text(path.read_text().replace(old, new, 1))


@pytest.mark.parametrize(('change', 'more', 'message'), [
    (lambda inputs: edit(inputs / 'vary.yaml', 'torque_gain', 'torque_gian'), (),
     'vary.yaml: torque_gian: unknown key; did you mean torque_gain?'),
    (lambda inputs: edit(inputs / 'vary.yaml', '0.001', '0.001, relative: true'), (),
     'vary.yaml: clock_offset: relative: expected a nominal value other than 0'),
    (lambda inputs: (inputs / 'vary.yaml').unlink(), (), 'vary.yaml: cannot read the dispersions'),
    (lambda inputs: (inputs / 'out').write_text('precious'), (), 'out: expected a new folder'),
    (lambda inputs: (inputs / 'in.csv').unlink(), (), 'in.csv'),
    (lambda inputs: None, ('--times', '1e9'), '--times: expected at most 2097152 states in a run, '
     'found 1e+09 Hz over 1.95 s'),
], ids=['key', 'relative', 'vary', 'file', 'recording', 'times'])
def test_bad_input_is_one_line(inputs, refusal, change, more, message):
    change(inputs)
    assert message in refusal('attitude_ensemble', *arguments(inputs, 'out', 10, *more))
    assert not (inputs / 'out').is_dir()


def test_without_a_recording_a_motion_needs_an_end(inputs, refusal):
    given = without_recording(arguments(inputs, 'out', 3), inputs)
    assert '--until: expected the end of the motion, or a --recording' in refusal(
        'attitude_ensemble', *given)


@pytest.mark.parametrize('more', ['--runs=0', '--workers=0', '--seed=-1', '--times=0',
                                  '--times=often'])
def test_impossible_numbers(inputs, capsys, more):
    with pytest.raises(SystemExit) as ended:
        main.attitude_ensemble([*arguments(inputs, 'out', 3), more])
    assert ended.value.code == 2
    option, _ = more.split('=')
    expected = 'final or a number from' if option == '--times' else 'an integer'
    assert f'{option}: expected {expected}' in capsys.readouterr().err


@pytest.mark.parametrize(('end_ns', 'rate', 'expected'), [
    (SECOND, 0.3, [0, SECOND]), (0, 5.0, [0]),
    (SECOND, 3.0, [0, 333333333, 666666667, SECOND]),
    (1_100_000_001, 10.0, [*range(0, 12 * SECOND // 10, SECOND // 10), 1_100_000_001]),
])
def test_times_start_at_the_start_and_include_the_end(end_ns, rate, expected):
    assert motions.times_of(5, 5 + end_ns, rate).tolist() == [5 + time for time in expected]
