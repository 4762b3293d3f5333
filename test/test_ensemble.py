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
import signal
import subprocess
import sys
import time

from conftest import at_night, nearest_rank, ROOT
import numpy as np
from pyarrow import parquet
import pytest
from rigid_body_ros import propagate, RigidBody, scene, State, TorqueLog, UniformField
from rigid_body_ros.commands import main
from rigid_body_ros.ensemble import folder

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
COMMAND = [sys.executable, '-c', 'import sys; from rigid_body_ros.commands import main; '
           'sys.exit(main.attitude_ensemble())']
ENVIRONMENT = {**os.environ, 'PYTHONPATH': os.pathsep.join([str(ROOT), *sys.path])}
TIMES = np.arange(40) / 20.0
TORQUES = np.round(0.01 * np.sin(np.arange(120.0)).reshape(40, 3), 9)


@pytest.fixture
def inputs(tmp_path):
    (tmp_path / 'scene.yaml').write_text(SCENE)
    (tmp_path / 'vary.yaml').write_text(VARY)
    rows = [','.join(map(repr, row)) for row in np.column_stack([TIMES, TORQUES]).tolist()]
    (tmp_path / 'in.csv').write_text('\n'.join(['time,tx,ty,tz', *rows]) + '\n')
    return tmp_path


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


def error_of(capsys, *given):
    assert main.attitude_ensemble(arguments(*given)) == 2
    line, = capsys.readouterr().err.strip().splitlines()
    return line


@pytest.mark.slow
def test_every_row_has_the_bits_of_propagate(inputs):
    run(inputs, 'out', 300)
    rows = parquet.read_table(inputs / 'out' / 'runs.parquet').to_pylist()
    assert [row['run'] for row in rows] == [*range(300)]
    stamps = np.round(TIMES * 1e9).astype(np.int64)
    for row in (rows[k] for k in np.random.default_rng(1).permutation(300)[:100]):
        body = RigidBody.from_moments(*(row[f'inertia.i{entry}'] for entry in (
            'xx', 'yy', 'zz', 'xy', 'xz', 'yz')))
        start = State(1, [row[f'initial_attitude.{axis}'] for axis in 'xyzw'],
                      [row[f'initial_angular_velocity.{axis}'] for axis in 'xyz'])
        log = TorqueLog(stamps + round(row['clock_offset'] * 1e9), row['torque_gain'] * TORQUES)
        motion = propagate(body, start, log, at=stamps[-1:])
        assert [row[f'attitude.{axis}'] for axis in 'xyzw'] == motion.attitude[0].tolist()
        assert [row[f'angular_velocity.{axis}'] for axis in 'xyz'] \
            == motion.angular_velocity[0].tolist()


@pytest.mark.slow
def test_fields_vary_by_the_keys_of_the_scene(inputs):
    (inputs / 'scene.yaml').write_text(
        SCENE + '    fields: [pivot]\n    pivot: {moment: {z: -0.01}, field: {z: -9.81}}\n')
    (inputs / 'vary.yaml').write_text('pivot.moment.x: {normal: 0.002}\n'
                                      'pivot.moment.z: {normal: 0.1, relative: true}\n')
    run(inputs, 'out', 30)
    rows = parquet.read_table(inputs / 'out' / 'runs.parquet')
    units = {field.name: (field.metadata or {}).get(b'unit') for field in rows.schema}
    assert units['pivot.moment.x'] == units['pivot.moment.z'] == b'kg m or A m^2'
    assert 'pivot.moment.y' not in units
    loaded, stamps = scene.load(inputs / 'scene.yaml'), np.round(TIMES * 1e9).astype(np.int64)
    for row in rows.to_pylist():
        problem = loaded.problem().replaced(log=TorqueLog(stamps, TORQUES), fields=[UniformField(
            (row['pivot.moment.x'], 0.0, row['pivot.moment.z']), (0.0, 0.0, -9.81))])
        motion = problem.propagate(at=stamps[-1:])
        assert [row[f'attitude.{axis}'] for axis in 'xyzw'] == motion.attitude[0].tolist()
    assert np.std(rows['pivot.moment.x'].to_numpy()) > 0.001


@pytest.mark.slow
def test_units_and_summary(inputs, capsys):
    run(inputs, 'out', 300, '--seed', 5)
    schema = parquet.read_schema(inputs / 'out' / 'runs.parquet')
    units = {field.name: (field.metadata or {}).get(b'unit') for field in schema}
    assert units['inertia.ixx'] == b'kg m^2'
    assert units['initial_angular_velocity.z'] == b'rad/s'
    assert units['clock_offset'] == b's'
    assert 'torque_bias.x' not in units
    found = json.loads((inputs / 'out' / 'summary.json').read_text())
    angles = parquet.read_table(inputs / 'out' / 'runs.parquet')['angle_from_nominal'].to_numpy()
    assert (found['seed'], found['runs'], found['failed']) == (5, 300, 0)
    for k in (5, 50, 99, 100):
        assert [found['angle_from_nominal_rad'][f'p{k}']] == nearest_rank(angles, [k])
    assert set(found['rank_correlation']) > {'initial_attitude', 'torque_gain', 'inertia.ixx'}
    assert 'depends on' in capsys.readouterr().out


@pytest.mark.slow
def test_the_parameter_that_explains_the_spread_is_found(inputs):
    (inputs / 'vary.yaml').write_text('initial_angular_velocity.z: {normal: 1.0e-3}\n'
                                      'torque_gain: {normal: 1.0e-9}\n')
    run(inputs, 'out', 300)
    found = json.loads((inputs / 'out' / 'summary.json').read_text())['rank_correlation']
    assert found['initial_angular_velocity.z'] > 0.99
    assert abs(found['torque_gain']) < 0.3
    assert set(found) == {'initial_angular_velocity.z', 'torque_gain'}


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(folder, 'BLOCKS', 4)
    monkeypatch.setattr(folder, 'LONGEST', 7)
    monkeypatch.setattr(folder, 'GROUP', 16)


@pytest.mark.slow
@pytest.mark.usefixtures('small_blocks')
def test_workers_extension_and_lost_blocks_give_the_same_bytes(inputs):
    run(inputs, 'one', 60, '--workers', 1)
    run(inputs, 'two', 60, '--workers', 2)
    run(inputs, 'extended', 20)
    run(inputs, 'extended', 60)
    assert parquet.read_metadata(inputs / 'one' / 'runs.parquet').num_row_groups == 4
    expected = contents(inputs / 'one')
    assert contents(inputs / 'two') == contents(inputs / 'extended') == expected
    next((inputs / 'two' / 'blocks').iterdir()).unlink()
    (inputs / 'two' / 'runs.parquet').unlink()
    run(inputs, 'two', 60)
    assert contents(inputs / 'two') == expected


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


@pytest.mark.slow
@pytest.mark.parametrize('kills', [1, *at_night(3)])
def test_kills_and_resumes_give_the_same_bytes(inputs, kills):
    run(inputs, 'whole', 6000)
    kill(inputs, arguments(inputs, 'killed', 6000), kills)
    assert not (inputs / 'killed' / 'runs.parquet').exists()
    run(inputs, 'killed', 6000)
    assert contents(inputs / 'killed') == contents(inputs / 'whole')


@pytest.mark.slow
def test_an_interrupt_is_one_line_and_the_same_command_goes_on(inputs):
    command = [*COMMAND, *arguments(inputs, 'out', 100_000)]
    with subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and count(inputs / 'out' / 'blocks') < 2:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert error == ('attitude_ensemble: interrupted; run the same command again to continue in '
                     f'{inputs / "out"}\n')


def kill(inputs, given, times):
    """Start an ensemble in the folder 'killed' a few times; kill it after three new blocks."""
    command = [*COMMAND, *given]
    blocks, before = inputs / 'killed' / 'blocks', 0
    for _ in range(times):
        with subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None and count(blocks) < before + 3:
                time.sleep(0.01)
            process.kill()
        assert process.returncode == -signal.SIGKILL
        before = count(blocks)


def count(blocks):
    return len([*blocks.glob('0*.parquet')])


@pytest.mark.slow
def test_failed_runs_are_rows(inputs, capsys):
    (inputs / 'vary.yaml').write_text('inertia.izz: {normal: 0.1}\n')
    run(inputs, 'out', 300)
    rows = parquet.read_table(inputs / 'out' / 'runs.parquet').to_pylist()
    failed = [row for row in rows if row['status'] == 'failed']
    assert all(row['attitude.x'] is None and row['message'] for row in failed)
    found = json.loads((inputs / 'out' / 'summary.json').read_text())
    assert found['failed'] == sum(found['failures'].values()) == len(failed) > 30
    assert [*found['failures']] == [
        'inertia: not physical, principal moments ... kg m^2: the largest exceeds the sum of the '
        'other two by ... % (limit 3 %)',
        'inertia: expected a positive definite tensor, found principal moments ..., '
        '0.044946704538749195, 0.12005329546125079 kg m^2']
    assert 'failed' in capsys.readouterr().out


@pytest.mark.slow
def test_without_a_recording_the_body_turns_freely(inputs):
    (inputs / 'vary.yaml').write_text('initial_attitude: {tilt: 0.02}\n')
    given = [one for one in arguments(inputs, 'out', 3, '--until', 10)
             if one not in ('--recording', str(inputs / 'in.csv'))]
    assert main.attitude_ensemble(given) == 0
    row = parquet.read_table(inputs / 'out' / 'runs.parquet').to_pylist()[2]
    loaded = scene.load(inputs / 'scene.yaml')
    start = State(1, [row[f'initial_attitude.{axis}'] for axis in 'xyzw'],
                  loaded.start.angular_velocity)
    motion = propagate(loaded.body, start, at=[1 + 10 ** 10])
    assert [row[f'attitude.{axis}'] for axis in 'xyzw'] == motion.attitude[0].tolist()


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
    (lambda inputs: edit(inputs / 'out' / 'identity.json', None, ''), 'cannot read the ensemble'),
], ids=['seed', 'until', 'scene', 'vary', 'recording', 'fewer', 'damaged', 'empty'])
def test_another_ensemble_is_refused(inputs, capsys, change, message):
    run(inputs, 'out', 10)
    before = (inputs / 'out' / 'runs.parquet').read_bytes()
    more = change(inputs) or ()
    runs, more = (more[1], ()) if '--runs' in more else (10, more)
    capsys.readouterr()
    line = error_of(capsys, inputs, 'out', runs, *more)
    assert line.startswith(f'attitude_ensemble: error: {inputs / "out"}')
    assert message in line
    assert (inputs / 'out' / 'runs.parquet').read_bytes() == before


def edit(path, old, new):
    text = path.read_text()
    path.write_text(new if old is None else text.replace(old, new, 1))


@pytest.mark.parametrize(('change', 'message'), [
    (lambda inputs: edit(inputs / 'vary.yaml', 'torque_gain', 'torque_gian'),
     'vary.yaml: torque_gian: unknown key; did you mean torque_gain?'),
    (lambda inputs: edit(inputs / 'vary.yaml', None, 'torque_bias.x: {normal: 1, relative: true}'),
     'vary.yaml: torque_bias.x: relative: expected a nominal value other than 0'),
    (lambda inputs: (inputs / 'vary.yaml').unlink(), 'vary.yaml: cannot read the dispersions'),
    (lambda inputs: (inputs / 'out').write_text('precious'), 'out: expected a new folder'),
    (lambda inputs: [(inputs / 'out').mkdir(), (inputs / 'out' / 'mine').touch()],
     'out: expected a new folder'),
    (lambda inputs: (inputs / 'in.csv').unlink(), 'in.csv'),
], ids=['key', 'relative', 'vary', 'file', 'folder', 'recording'])
def test_bad_input_is_one_line(inputs, capsys, change, message):
    change(inputs)
    assert message in error_of(capsys, inputs, 'out', 10)


def test_no_end_of_the_motion(inputs, capsys):
    given = [one for one in arguments(inputs, 'out', 3)
             if one not in ('--recording', str(inputs / 'in.csv'))]
    assert main.attitude_ensemble(given) == 2
    assert '--until: expected the end of the motion, or a --recording' in capsys.readouterr().err


@pytest.mark.parametrize('more', [('--runs', '0'), ('--workers', '0'), ('--seed', '-1'),
                                  ('--runs', 'many')])
def test_impossible_numbers(inputs, capsys, more):
    given = arguments(inputs, 'out', 3)
    for name in more[:1]:
        if name in given:
            del given[given.index(name):given.index(name) + 2]
    with pytest.raises(SystemExit) as ended:
        main.attitude_ensemble([*given, *more])
    assert ended.value.code == 2
    assert f'{more[0]}: expected an integer' in capsys.readouterr().err
