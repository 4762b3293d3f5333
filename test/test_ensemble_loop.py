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

"""Ensembles with a controller: the bits of lockstep in any order, requirements, and effects."""

from dataclasses import asdict, replace
import json
import os
import re
import shlex
import shutil

from conftest import program, ROOT, SECOND
from controllers import Pid
import numpy as np
import psutil
from pyarrow import parquet
import pytest
from rigid_body_ros import (
    BodyLog,
    EffortLog,
    messages,
    Propagator,
    read,
    recording,
    State,
    TorqueLog,
)
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.ensemble import worst
from rigid_body_ros.ensemble.controller import Controller
from rigid_body_ros.ensemble.dispersions import Dispersion
from rigid_body_ros.ensemble.requirements import Requirement
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.ensemble.summary import _explained, interval
from rigid_body_ros.mechanics import so3
from rigid_body_ros.scene import load, Scene
from scipy.stats import binomtest
from test_ensemble import contents, undrawn
from test_ensemble_folder import wait_for

undrawn = undrawn  # a fixture
STEP_NS, END_NS = SECOND // 10, 2 * SECOND
TIMES = np.array([0, 1, STEP_NS, SECOND // 3, SECOND, END_NS - 5, END_NS])
SCENE = {'inertia.ixx': 0.045, 'inertia.iyy': 0.12, 'inertia.izz': 0.14, 'inertia.ixy': 0.002,
         'initial_angular_velocity.y': 0.6, 'step': 0.1}
RATE = Dispersion('initial_angular_velocity.x', 'uniform', (-0.5, 0.5))
GAIN, NOISE = (Dispersion(key, 'normal', (0.1,)) for key in ('torque_gain', 'torque_noise'))
ACTUATOR = {'actuator.topics': ['torque'], 'actuator.delay': 0.02, 'actuator.limit.x': 0.004,
            'actuator.time_constant': 0.05}
VARY = (RATE, Dispersion('inertia', 'relative', (0.05,)),
        Dispersion('initial_attitude', 'tilt', (0.1,)))


def ensemble(name, *vary, end_ns=END_NS, times_ns=None, problem=None, **values):
    scene = Scene.from_values({**SCENE, **values})
    loop = Controller.load(f'controllers:{name}', STEP_NS, (scene.actuators or [None])[0])
    problem = problem or scene.problem()
    return Ensemble(problem, end_ns, vary, 1, None, times_ns, loop)


def by_hand(problem, law, gain, actuator):
    """Return the motion at `TIMES`, in the loop that `test_closed_loop` compares with a node."""
    propagator = Propagator(problem.body, problem.start, actuator=actuator, history=10.0,
                            **asdict(problem.options))
    for stamp_ns in range(0, END_NS, STEP_NS):
        state = propagator.at(stamp_ns)
        propagator.apply(stamp_ns, gain * np.array(law(state, stamp_ns / 1e9)))
    return [[*state.attitude, *state.angular_velocity]
            for state in map(propagator.at, TIMES.tolist())]


@pytest.mark.parametrize('values', [{}, ACTUATOR], ids=['ideal', 'actuator'])
def test_a_run_has_the_bits_of_the_loop_that_a_node_has_in_lockstep(values):
    found = ensemble('Pid', *VARY, GAIN, times_ns=TIMES, **values)
    for run, motion in zip(range(5, 8), found.rows(5, 8)['motion']):
        problem, drawn = found.replayed(run)
        expected = by_hand(problem, Pid(), drawn['torque_gain'], found.controller.actuator)
        assert motion.tolist() == expected


STAMPS = np.arange(-1, 20) * 90_000_000
TORQUES = 0.01 * np.sin(np.arange(63.0)).reshape(21, 3)
BIAS = Dispersion('torque_bias.x', 'normal', (1e-3,))
OFFSET = Dispersion('clock_offset', 'normal', (0.01,))


def everything():
    """Return a scene with everything that can act on a body, its problem, and what varies."""
    scene = Scene.from_values({
        **SCENE, 'initial_rotor_momentum.z': 0.003, 'damping.dxx': 1e-4, 'torque_timeout': 0.13,
        'wheels': True, 'inertia_topic': True, 'orbit.mean_motion': 1e-3, 'start_time': 7,
        'fields': ['pivot'], 'pivot.moment.z': -0.01, 'pivot.field.z': -9.81})
    logs = [TorqueLog(STAMPS, TORQUES, ['body', 'space'] * 10 + ['body']),
            TorqueLog(STAMPS[4:] + 7, TORQUES[4:])]
    problem = scene.problem().replaced(
        log=logs, wheels=TorqueLog(STAMPS + 3, 0.01 * TORQUES),
        changes=BodyLog([SECOND], [scene.body.with_entries(
            np.array([0.04, 0.1, 0.12, 0.0, 0.0, 0.0]))]))
    return scene, problem, (RATE, VARY[2], GAIN, replace(NOISE, bounds=(1e-3,)), BIAS, OFFSET)


def actuated(is_recorded=True):
    scene = Scene.from_values({
        **SCENE, **ACTUATOR, 'torque_topics': ['of_motors', 'of_wind'],
        'actuator.topics': ['of_motors'], 'torque_timeout': 0.13})
    logs = 2 * [TorqueLog(STAMPS[1:], TORQUES[1:])] if is_recorded else None
    return scene, scene.problem().replaced(log=logs), (
        RATE, BIAS, *([GAIN, OFFSET] if is_recorded else ()))


def unrecorded():
    return actuated(is_recorded=False)


def commanded():
    scene, random = load(ROOT / 'examples' / 'four_wheels.yaml'), np.random.default_rng(7)
    efforts = np.where(random.random((21, 4)) < 0.3, np.nan, 0.005 * random.normal(size=(21, 4)))
    start = State(0, scene.start.attitude, (0.1, 0.2, 0.3), wheel_speeds=(90.0, -50.0, 20.0, 0.0))
    problem = scene.problem(start).replaced(efforts=EffortLog(STAMPS, efforts))
    return scene, problem, (RATE, OFFSET)


@pytest.mark.slow
@pytest.mark.parametrize(('case', 'name'), [
    (everything, 'damp'), (everything, None), (actuated, 'damp'), (actuated, None),
    (unrecorded, 'damp'), (commanded, 'damp'), (commanded, None)])
def test_what_is_written_of_a_run_gives_it_again(tmp_path, case, name):
    scene, problem, vary = case()
    times_ns = problem.start.time_ns + TIMES
    found = ensemble('damp', *vary, problem=problem, end_ns=int(times_ns[-1]), times_ns=times_ns)
    found = replace(found, controller=name and replace(
        found.controller, actuator=(scene.actuators or [None])[0]))
    columns = found.rows(3, 5)
    assert columns['message'].tolist() == ['', '']
    worst.write(tmp_path / 'worst', found, scene, [3, 4])
    for run, motion in zip((3, 4), columns['motion']):
        again = read(tmp_path / 'worst' / f'{run}.mcap', tmp_path / 'worst' / f'{run}.yaml')
        assert len([*filter(None, again.actuators)]) == (
            len([*filter(None, problem.actuators)]) + bool(name and scene.actuators))
        motion_again = again.propagate(at=again.start.time_ns + TIMES)
        np.testing.assert_array_equal(motion[:, :4], motion_again.attitude)
        np.testing.assert_array_equal(motion[:, 4:], motion_again.angular_velocity)


def test_a_body_that_changes_does_not_vary():
    _, problem, _ = everything()
    for vary in (Dispersion('inertia', 'relative', (0.05,)),
                 Dispersion('damping.dxx', 'normal', (0.1,), relative=True)):
        with pytest.raises(InputError, match='expected a body that does not change, found 1'):
            ensemble('damp', vary, problem=problem)


@pytest.mark.slow
def test_runs_do_not_depend_on_those_before():
    found = ensemble('Pid', *VARY, NOISE, **ACTUATOR)
    found.check()
    whole, back = found.rows(0, 6), [found.rows(run, run + 1) for run in range(5, -1, -1)]
    for column, values in whole.items():
        assert values.tobytes() == np.concatenate(
            [one[column] for one in reversed(back)]).tobytes()


def test_nothing_that_a_controller_writes_changes_the_run():
    start = {'initial_rotor_momentum.z': 0.003}
    expected = ensemble('damp', times_ns=TIMES, **start).nominal_motion
    np.testing.assert_array_equal(
        ensemble('vandal', times_ns=TIMES, **start).nominal_motion, expected)


@pytest.mark.parametrize(('name', 'message'), [
    ('late', r'0\.2 s: controller controllers:late: ZeroDivisionError: .*'),
    ('exits', r'0 s: controller controllers:exits: SystemExit: enough'),
    ('not_a_number', r'0 s: controller controllers:not_a_number: expected a torque of three '
     r'finite numbers \(N m\), found \[nan, 0\.0, 0\.0\]'),
    ('huge', r'0 s: the body may turn by .* rad, too far to be computed \(limit 1e\+07 rad\): '
     'check the controller'),
])
def test_a_run_whose_controller_fails_says_when_and_why(name, message):
    columns = ensemble(name, RATE).rows(0, 8)
    failed = np.flatnonzero(columns['status'] == 'failed').tolist()
    assert len(failed) in range(2, 7)
    assert not (columns['initial_angular_velocity.x'] > 0.0).any()  # NaN in failed runs
    for run in failed:
        assert re.fullmatch(f'run {run}: {message}', columns['message'][run])


@pytest.mark.parametrize(('name', 'message'), [
    ('nowhere:damp', "cannot import nowhere: ModuleNotFoundError: No module named 'nowhere'"),
    ('controllers:nothing', "expected a function 'nothing' in controllers, found none"),
    ('controllers:NUMBER', 'expected a function or a class, found 7'),
    ('controllers', "expected MODULE:FUNCTION, found 'controllers'"),
    ('sys:exit', 'expected a module with a source file, found one without'),
    ('leaves:damp', 'cannot import leaves: SystemExit: 5'),
    ('controllers:two', 'expected a torque of three finite numbers (N m), found [0.0, 0.0]'),
    ('controllers:words', "found 'none at all'"),
    ('controllers:Deaf', 'expected a class with __call__, found one without'),
    ('controllers:guess', 'expected the same torque when the run is repeated, found ['),
    ('controllers:Shared', '0 s: controller controllers:Shared: expected the same torque'),
])
def test_a_bad_controller_is_one_line(tmp_path, monkeypatch, refusal, name, message):
    (tmp_path / 'leaves.py').write_text('import sys\nsys.exit(5)\n')
    monkeypatch.chdir(tmp_path)
    assert message in refusal('attitude_ensemble', *given(tmp_path, name))


def given(folder, name, *more):
    example = ROOT / 'examples' / 'damp_rates'
    return ['--scene', f'{example}.yaml', '--vary', f'{example}_vary.yaml', '--controller', name,
            '--until', '0.5', '--runs', '2', '-o', str(folder / 'out'), *more]


@pytest.mark.slow
def test_a_worker_that_dies_is_one_line(tmp_path, capsys):
    assert main.attitude_ensemble(given(tmp_path, 'controllers:killed')) == 2
    captured = capsys.readouterr()
    assert re.search('cannot compute runs . to .: worker process exited with status 3; run the '
                     'same command again to compute what is missing\n$', captured.err)
    assert captured.out == ''  # what the controller prints goes to the standard error


@pytest.mark.slow
def test_a_controller_that_does_not_return_ends_with_a_command_that_is_killed(tmp_path):
    (tmp_path / 'endless.py').write_text(
        'from multiprocessing import parent_process\nfrom pathlib import Path\n\n\n'
        'def law(state, time):\n    while parent_process():\n        Path("begun").touch()\n'
        '    return [0.0, 0.0, 0.0]\n')
    command = psutil.Popen([*program('attitude_ensemble'), *given(tmp_path, 'endless:law')],
                           cwd=tmp_path, env={**os.environ, 'PYTHONPATH': str(ROOT)})
    wait_for((tmp_path / 'begun').exists)
    children = command.children()
    assert children
    command.kill()
    command.wait()
    _, alive = psutil.wait_procs(children, timeout=20.0)
    for process in alive:
        process.kill()
    assert not alive


@pytest.mark.slow
def test_the_example_is_the_same_after_an_interruption(tmp_path, monkeypatch, capsys):
    command, = re.findall(r'^attitude_ensemble --scene examples/damp[^`]*', (
        ROOT / 'docs' / 'ensemble.md').read_text(), re.MULTILINE)
    runs, page = tmp_path / 'runs', tmp_path / 'runs.html'
    command = re.sub(r'-o \S+', f'-o {runs} --report {page} --overwrite', command)
    command = re.sub(r'--runs \d+', '--runs 7', command.replace('\\\n', ' '))
    _, *arguments = shlex.split(command)
    monkeypatch.chdir(ROOT)
    assert main.attitude_ensemble(arguments) == 0
    text, expected = capsys.readouterr().out, contents(runs)
    found = json.loads(expected['summary.json'])['requirements'][0]
    assert (found['require'], found['unit']) == ('rate < 0.05', 'rad/s')
    assert 'required         rate < 0.05 rad/s: met by ' in text
    rows = parquet.read_table(runs / 'runs.parquet').to_pylist()
    rates = [np.hypot(np.hypot(*(row[f'angular_velocity.{axis}'] for axis in 'xy')),
                      row['angular_velocity.z']) for row in rows]
    assert found['met'] == sum(rate < 0.05 for rate in rates)
    assert [one['run'] for one in found['worst']] == np.argsort(rates)[:-6:-1].tolist()
    for path in (*sorted((runs / 'blocks').iterdir())[2:4], runs / 'runs.parquet'):
        path.unlink()
    assert main.attitude_ensemble([*arguments, '--workers', '1']) == 0
    assert contents(runs) == expected
    assert 'worst run: rate &lt; 0.05' in page.read_text()
    monkeypatch.chdir(tmp_path)
    replay_the_worst(tmp_path, rows, text)


def replay_the_worst(folder, rows, text):
    """Run the first command that the example prints."""
    run, command = re.search(r'worst +run (\d+), .*: attitude_replay (.*)', text).groups()
    assert main.attitude_replay(shlex.split(command)) == 0
    for topic, axes, kind in (('attitude', 'xyzw', messages.QUATERNION),
                              ('angular_velocity', 'xyz', messages.VECTOR3)):
        last = recording.read(folder / f'run_{run}.mcap', f'/{topic}', kind).values[-1]
        assert last.tolist() == [rows[int(run)][f'{topic}.{axis}'] for axis in axes]


@pytest.mark.slow
def test_another_controller_is_refused(tmp_path, monkeypatch, refusal):
    source = tmp_path / 'its_own.py'
    shutil.copy(ROOT / 'examples' / 'damp_rates.py', source)
    monkeypatch.chdir(tmp_path)
    arguments = [one if one != '2' else '1' for one in given(tmp_path, 'its_own:damp')]
    assert main.attitude_ensemble(arguments) == 0
    source.write_text(source.read_text().replace('0.02', '0.03'))
    assert 'expected the controller of its runs' in refusal('attitude_ensemble', *arguments)


@pytest.mark.parametrize('text', ['', 'rate < nan', 'speed < 1', 'rate = 1', 'rate < 1 deg',
                                  'angle < 1 after -1 s'])
def test_what_is_no_requirement_is_one_line(tmp_path, refusal, text):
    assert "such as 'rate < 0.05' or 'angle < 1 deg after 60 s', found" in refusal(
        'attitude_ensemble', *given(tmp_path, 'controllers:damp', '--require', text))


@pytest.mark.parametrize(('met', 'runs'), [(0, 10), (3, 10), (10, 10), (970, 1000)])
def test_the_interval_is_that_of_clopper_and_pearson(met, runs):
    expected = binomtest(met, runs).proportion_ci(0.95, 'exact')
    np.testing.assert_allclose(interval(met, runs), expected, rtol=1e-9, atol=1e-12)


def test_requirements_are_read():
    assert Requirement.read('rate<=1e-3') == Requirement('rate', '<=', 1e-3, 'rad/s')
    assert str(Requirement.read(' angle > 0.5 ')) == 'angle > 0.5'
    assert Requirement.read('angle<1deg after 60s') == Requirement('angle', '<', 1, 'deg', 60)


def test_requirements_that_last_are_those_of_dense_samples():
    lasting = replace(ensemble('damp', *VARY), requirements=tuple(map(Requirement.read, (
        'rate < 34 deg/s after 0.7 s', 'angle_from_nominal <= 0.1 after 1 s',
        'rate >= 0.55 after 0 s', 'rate < 34.0 deg/s after 0.70 s'))))  # the last is the first
    rows, (_, nominal) = lasting.rows(0, 8), lasting._nominal
    at = np.arange(0, END_NS + 1, 10 ** 6)
    for run in range(8):
        motion = lasting.replayed(run)[0].propagate(at=at)
        rate = np.linalg.norm(motion.angular_velocity, axis=1)
        angle = so3.angle_between(motion.attitude, nominal.propagate(at=at).attitude)
        for requirement, excess, first in zip(
                lasting.requirements, (np.degrees(rate) - 34.0, angle - 0.1, 0.55 - rate),
                (700, 1000, 0)):
            settled, overshoot = (rows[name][run] for name in requirement.columns)
            violated = np.flatnonzero(excess > 0.0)
            assert np.isnan(settled) if excess[-1] > 0.0 else \
                0.0 <= settled - 1e-3 * violated.max(initial=0) <= 1e-3
            assert -1e-12 <= overshoot - excess[first:].max() <= 1e-4


def test_effects_count_whether_they_are_odd_or_even():
    x = np.random.default_rng(3).uniform(-1.0, 1.0, 2000)
    other = np.random.default_rng(4).normal(0.0, 1.0, 2000)
    for quantity in (np.abs(x), x ** 2, np.exp(-5.0 * np.abs(x)), np.exp(9.0 * x), 3.0 - x):
        assert _explained(x, quantity) > 0.85
        assert _explained(other, quantity) < 0.01
    assert _explained(np.sign(x), x) == pytest.approx(0.75, abs=0.02)  # only two different values
