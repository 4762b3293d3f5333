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

"""attitude_design: intervals that a fit confirms, limits that hold, and the output."""

import json

from conftest import CONFIG, SECOND
import numpy as np
from pages import data_of
import pytest
from rigid_body_ros import (
    identify,
    Measured,
    Problem,
    propagate,
    read,
    RigidBody,
    State,
    UniformField,
    Wheel,
)
from rigid_body_ros.commands import main
from rigid_body_ros.design import search
from rigid_body_ros.design.information import CRITERIA, Instrument, Question
from rigid_body_ros.design.maneuver import Maneuvers, NO_LIMITS
from rigid_body_ros.design.search import design
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.observed import Measurements
from rigid_body_ros.scene import load

BODY = RigidBody.from_moments(0.010, 0.012, 0.020)
LIMITS = {'torque': np.array([0.1, 0.1, 0.05]), 'rate': np.array([2.0]), 'angle': np.array([0.7]),
          'torque_rate': np.array([1.0, 1.0, 0.5])}
SENSORS = [Instrument('/mocap', True, 2e-3, 50.0), Instrument('/imu', False, 5e-3, 50.0)]
WHEELS = [Wheel(f'rw_{axis}', tuple(unit), 1e-4) for axis, unit in zip('xyz', np.eye(3))]
START_NS = 1767225600 * SECOND
COMMAND = ['--scene', str(CONFIG / 'tumbler.yaml'), '--limit', 'rate=1', '--duration', '6',
           '--sensors', '/imu:0.002,/mocap:0.002']


@pytest.fixture(autouse=True)
def _short_search(monkeypatch):
    """Try two populations of the search only."""
    monkeypatch.setattr(search, '_TRIALS', 72)
    monkeypatch.setattr(search, '_OTHERS', 36)


def maneuvers_of(problem=None, limits=LIMITS, seconds=6.0):
    return Maneuvers(problem or Problem(BODY, State(0)), {**NO_LIMITS, **limits}, seconds, 20.0)


def measured(flown, seconds, random):
    """Return what the sensors measure in a flight."""
    stamps_ns = (np.arange(1, seconds * 50.0 + 0.5) * SECOND / 50).astype(np.int64)
    motion = flown.propagate(at=stamps_ns)
    attitude, rates = (one.noise * random.standard_normal((len(stamps_ns), 3)) for one in SENSORS)
    return [Measured('/mocap', stamps_ns, so3.multiply(motion.attitude, so3.exp(attitude)), None),
            Measured('/imu', stamps_ns, None, motion.angular_velocity + rates)]


@pytest.mark.slow
@pytest.mark.parametrize('problem', [
    Problem(BODY, State(0)),
    Problem(BODY, State(0), fields=[UniformField((0.001, 0.0, -0.004), (0, 0, -9.81), 'weight')]),
], ids=['free', 'pivot'])
def test_a_fit_to_a_flight_has_the_expected_intervals(problem):
    result = design(maneuvers_of(problem), Question(['inertia'], SENSORS, {}))
    fit = identify(BODY, (result.flown, Measurements(measured(
        result.flown, 6.0, np.random.default_rng(1)))), attitude_noise=2e-3, rate_noise=5e-3)
    for name, width in zip(result.expected.names, result.expected.half_widths):
        low, high = fit.estimates[name].interval_95
        assert 0.5 * (high - low) == pytest.approx(width, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(('problem', 'limits'), [
    (Problem(BODY, State(0)), LIMITS),
    (Problem(BODY, State(0), wheels=WHEELS), {'torque': np.full(3, 0.05), 'rate': np.array([1.0]),
                                              'wheel_speed': np.array([100.0])}),
    (Problem(BODY, State(0)), {'torque': np.zeros(3), 'rate': np.array([3.0])})],
    ids=['torques', 'wheels', 'spin'])
def test_the_limits_hold_at_every_instant(problem, limits):
    flown = design(maneuvers_of(problem, limits), Question(['inertia'], SENSORS, {})).flown
    times_ns = np.arange(0, 6 * SECOND, 10 ** 6 // 4)
    motion = flown.propagate(at=times_ns)
    assert np.linalg.norm(motion.angular_velocity, axis=1).max() <= limits['rate'][0]
    if 'angle' in limits:
        assert so3.angle_between(motion.attitude[:1], motion.attitude).max() <= limits['angle'][0]
    if flown.logs:
        torques = flown.logs[0].torques
        assert (np.abs(torques) <= limits['torque']).all()
        jumps = np.diff(torques, axis=0, prepend=np.zeros((1, 3)))
        assert (20.0 * np.abs(jumps) <= limits['torque_rate']).all()
    if flown.efforts:
        assert (np.abs(flown.efforts.efforts) <= limits['torque']).all()
        assert np.abs(motion.wheel_speeds).max() <= limits['wheel_speed'][0]


def test_every_maneuver_starts_and_ends_at_rest():
    maneuvers = maneuvers_of(limits={**LIMITS, 'torque_rate': np.full(3, 1e3)})
    numbers = np.random.default_rng(0).uniform(*maneuvers.bounds.T)
    for motion in (maneuvers.motion(numbers), *(motion for _, motion in maneuvers.usual())):
        assert np.abs(motion[[0, -1]]).max() < 1e-12
        rates = maneuvers.flown(motion).propagate(at=[0, 6 * SECOND]).angular_velocity
        # The torque is held, so the body follows the motion to second order in the step.
        assert np.abs(rates).max() < 5e-3


def test_wheels_turn_the_body_as_planned():
    turning = State(0, angular_velocity=(0.1, 0.2, 0.0))  # but a maneuver starts at rest
    maneuvers = maneuvers_of(Problem(BODY, turning, wheels=WHEELS), {
        'torque': np.full(3, 0.05), 'rate': np.array([1.0])})
    motion = maneuvers.motion(np.random.default_rng(0).uniform(*maneuvers.bounds.T))
    flown = maneuvers.flown(motion)
    # The momentum of the wheels after each sample is exact.
    assert np.abs(flown.propagate(at=maneuvers.times_ns).angular_velocity - motion).max() < 1e-4


@pytest.mark.slow
def test_the_search_beats_the_usual_maneuvers(monkeypatch):
    monkeypatch.setattr(search, '_TRIALS', 360)
    result = design(maneuvers_of(), Question(['inertia'], SENSORS, {}))
    assert {*result.usual} == {'doublet', 'multisine', 'chirp'}
    assert all(result.expected.widest < one.widest for one in result.usual.values())
    longer = result.others['twice as long']
    assert longer.widest < result.expected.widest


@pytest.mark.parametrize('criterion', CRITERIA)
def test_each_criterion_prefers_more_samples(criterion):
    maneuvers = maneuvers_of()
    flown = maneuvers.held(maneuvers.motion(
        np.random.default_rng(3).uniform(*maneuvers.bounds.T)), [BODY])
    costs = [Question(['inertia'], [one._replace(hz=hz) for one in SENSORS], {},
                      criterion=criterion).expected(flown, 6.0).cost(criterion)
             for hz in (25.0, 100.0)]
    assert costs[0] - costs[1] == pytest.approx(np.log(2.0), abs=0.02)


@pytest.mark.slow
def test_what_no_torque_determines_is_named(tmp_path, capsys):
    out = tmp_path / 'out.json'
    assert main.attitude_design([*COMMAND, '--limit', 'torque=0.1', '--estimate',
                                 'inertia,torque_gain', '--json', str(out)]) == 3
    text = capsys.readouterr().out
    assert 'no maneuver within these limits determines inertia.ixx' in text
    assert 'only the ratio of torque to inertia enters the motion' in text
    assert json.loads(out.read_text())['half_widths_95']['designed']['torque_gain'] is None


@pytest.mark.slow
def test_a_prior_determines_it(capsys):
    assert main.attitude_design([*COMMAND, '--limit', 'torque=0.1', '--estimate',
                                 'inertia,torque_gain', '--prior', 'torque_gain=1%']) == 0
    assert 'unknown' not in capsys.readouterr().out


@pytest.mark.slow
def test_limits_hold_for_bodies_drawn_from_a_prior():
    result = design(maneuvers_of(), Question(['inertia'], SENSORS, {'inertia': 5e-4}))
    bodies = search._bodies(BODY, result.expected)
    assert len(bodies) == 4
    for body in bodies:
        assert max(result.maneuvers.loads(result.flown.replaced(body=body), 20).values()) <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize('suffix', ['.mcap', '.csv'])
def test_a_profile_can_be_replayed(tmp_path, suffix, capsys):
    profile, motion = tmp_path / f'fly{suffix}', tmp_path / 'motion.mcap'
    page, scene = tmp_path / 'page.html', load(CONFIG / 'tumbler.yaml')
    still = tmp_path / 'still.yaml'
    still.write_text((CONFIG / 'tumbler.yaml').read_text().split('    initial_')[0]
                     + f'    start_time: {START_NS}\n')
    arguments = ['--scene', str(still), *COMMAND[2:], '--limit', 'torque=0.1', '--rate', '30',
                 '-o', str(profile), '--report', str(page)]
    assert main.attitude_design(arguments) == 0
    assert main.attitude_replay([str(profile), '--scene', str(still), '-o', str(motion)]) == 0
    problem = read(profile, still)
    log = problem.logs[0]
    assert (log.times_ns == START_NS + np.round(np.arange(181) * (1e9 / 30.0))).all()
    assert (np.abs(log.torques) <= 0.1).all()
    assert np.abs(log.torques).max() > 0.01
    final = propagate(scene.body, State(START_NS), log, at=log.times_ns[-1:])
    assert np.abs(final.angular_velocity).max() < 1e-2
    assert {'torque', 'angular velocity, body axes'} <= {
        panel['label'] for panel in data_of(page.read_text())['panels']}
    assert main.attitude_design(arguments) == 2
    assert '--overwrite' in capsys.readouterr().err


@pytest.mark.slow
def test_a_profile_of_wheels_leaves_the_body_at_rest(tmp_path, capsys):
    scene, profile = tmp_path / 'wheels.yaml', tmp_path / 'fly.mcap'
    scene.write_text('\n'.join([
        '/**:', '  ros__parameters:', '    inertia: {ixx: 0.036, iyy: 0.035, izz: 0.0065}',
        '    wheel_names: [rw_x, rw_y, rw_z]', *(
            f'    rw_{axis}: {{axis: {{{axis}: 1.0}}, inertia: 2e-5, max_torque: 0.02}}'
            for axis in 'xyz')]))
    assert main.attitude_design(['--scene', str(scene), *COMMAND[2:], '-o', str(profile)]) == 0
    problem = read(profile, scene)
    assert np.abs(problem.efforts.efforts).max() <= 0.02
    final = problem.propagate(at=problem.efforts.times_ns[-1:])
    # The sum of the impulses of each wheel is exact.
    assert np.abs(final.angular_velocity).max() < 1e-14


def test_a_spin_that_no_usual_one_replaces(capsys):
    assert main.attitude_design([*COMMAND, '--limit', 'torque=0', '--prior',
                                 'inertia.ixx=1%']) == 0
    assert 'start ' in capsys.readouterr().out


@pytest.mark.parametrize(('arguments', 'message'), [
    (['--limit', 'torque=0.1', '--limit', 'angle=1,2'], 'angle: expected 1, found 2'),
    (['--limit', 'torque=0.1', '--limit', 'torque=0.2'], 'torque: expected once, found it'),
    (['--limit', 'torque=0.1', '--limit', 'wheel_speed=4'], 'wheel_speed: expected wheel_names'),
    (['--limit', 'torque=0.1', '-o', 'fly.txt'], 'a name ending in .mcap or .csv, found fly.txt'),
    (['--limit', 'torque=0.1', '--rate', '3'], '24 samples of the torque, found 6 s at 3 Hz'),
    (['--limit', 'torque=0.1,0.1'], 'expected 1 number or 3, found 2'),
    (['--limit', 'torque=0.1,0.1,0'], 'torque=0 and a rate, found torque=0.1,0.1,0'),
    ([], 'expected a torque greater than zero about all axes, or torque=0 and a rate, found no '
     'torque'),
    (['--limit', 'torque=0', '-o', 'a.mcap'], 'expected none without torque'),
    (['--limit', 'torque=0.1', '--prior', 'weight=1'], 'prior: expected parameters'),
    (['--limit', 'torque=0.1', '--estimate', 'gyro_bias@/other'], 'expected a topic among')])
def test_a_mistake_is_one_line(arguments, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main.attitude_design([*COMMAND, *arguments]) == 2
    error, = capsys.readouterr().err.splitlines()
    assert message in error


def test_a_sensor_measures_during_the_maneuver(capsys):
    assert main.attitude_design([*COMMAND[:-1], '/imu:0.002,/mocap:0.002@0.1', '--limit',
                                 'torque=0.1']) == 2
    assert '/mocap: expected a measurement' in capsys.readouterr().err


@pytest.mark.parametrize(('option', 'value', 'message'), [
    ('--limit', 'speed=1', 'a name among torque'),
    ('--limit', 'torque=-1', 'torque: expected a number'),
    ('--limit', 'angle=40', "angle: expected at most pi rad, found '40'; degrees end in deg"),
    ('--limit', 'angle=40grad', "found '40grad'; degrees end in deg"),
    ('--sensors', '/imu', 'TOPIC:rates:RAD/S')])
def test_a_malformed_option_is_named(option, value, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main.attitude_design([*COMMAND[:4], '--duration', '6', option, value])
    assert ended.value.code == 2
    assert message in capsys.readouterr().err
