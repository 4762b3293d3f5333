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

"""Named wheels: what they conserve, friction, largest speeds, commands, and scenes."""

from dataclasses import replace
import json
import re

from conftest import ROOT
import numpy as np
from numpy.testing import assert_array_equal
from parts import BODY, DAMPED, FREE, LIMITED, SLOWED, SMALLER, START
import pytest
from rigid_body_ros import (
    BodyLog,
    EffortLog,
    messages,
    Problem,
    propagate,
    Propagator,
    RigidBody,
    so3,
    State,
    TorqueLog,
    Wheel,
)
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.live.epoch import Epoch
from rigid_body_ros.live.events import IMPOSSIBLE, RejectedError
from rigid_body_ros.live.inputs import Inputs, Torque
from rigid_body_ros.live.run import Run
from rigid_body_ros.propagation.sources import BODY as SOURCE
from rigid_body_ros.propagation.sources import COMMANDS
from rigid_body_ros.replay.check import drift
from rigid_body_ros.scene import Scene
from terms import numbers, problem_of

SECOND = 10 ** 9
TRUTH = json.loads((ROOT / 'test' / 'truth_limits.json').read_text())
#: Spans that are shorter, s, are those of a wheel that touches its limit within rounding.
TOUCH = 1e-6


def commands(rng, count=40):
    """Return efforts at irregular stamps, some before the start; a third of them are missing."""
    stamps = np.sort(rng.integers(-SECOND // 4, 3 * SECOND, count))
    efforts = rng.normal(0.0, 0.4, (count, 4))
    efforts[rng.random(efforts.shape) < 0.3] = np.nan
    return EffortLog(stamps, efforts)


@pytest.mark.parametrize('wheels', [FREE, LIMITED, SLOWED])
def test_momentum_in_space_is_constant_with_wheels_alone(wheels):
    motion = propagate(BODY, START, at=np.arange(0, 100 * SECOND, 10 ** 9), wheels=wheels,
                       efforts=EffortLog(np.arange(100) * SECOND, 0.3 * np.random.default_rng(
                           1).normal(size=(100, 4))))
    assert bool(motion.at_limit) == (wheels is not FREE)
    momentum = motion.angular_momentum_space
    largest = np.linalg.norm(motion.rotor_momentum, axis=1).max()
    assert np.abs(momentum - momentum[0]).max() < 4e-15 * largest
    by_hand = BODY.angular_momentum(motion.angular_velocity) + 0.05 * motion.wheel_speeds @ \
        np.array([wheel.axis for wheel in FREE])
    assert np.abs(so3.rotate(motion.attitude, by_hand) - momentum[0]).max() < 1e-14 * largest


def test_a_little_friction_gives_almost_the_motion_without():
    efforts, at = commands(np.random.default_rng(11)), np.arange(0, 4 * SECOND, SECOND // 7)
    without, little = (propagate(BODY, START, at=at, efforts=efforts, wheels=[
        replace(wheel, friction=friction) for wheel in LIMITED]) for friction in (0.0, 1e-18))
    assert abs(little.attitude - without.attitude).max() < 2e-15
    assert abs(little.wheel_speeds - without.wheel_speeds).max() < 1e-13


@pytest.mark.parametrize('friction', [50.0, 5e4])
def test_friction_far_faster_than_a_step_stops_the_wheels(friction):
    # Time constants of 1 ms and 1 us, and commands every 100 ms.
    wheels = [replace(wheel, friction=friction, max_speed=0.0) for wheel in SLOWED]
    stamps = np.arange(2) * SECOND // 100
    efforts = EffortLog(stamps, 0.3 * np.random.default_rng(12).normal(size=(2, 4)))
    at = np.array([0, SECOND // 100, SECOND // 50])
    motion = propagate(BODY, START, at=at, wheels=wheels, efforts=efforts)
    assert abs(motion.wheel_speeds[1:]).max() < 0.3 / friction * 2.0 + 0.05 / friction
    momentum = motion.angular_momentum_space
    assert abs(momentum - momentum[0]).max() < 1e-14 * np.linalg.norm(motion.rotor_momentum[0])
    # The wheels rotate with the body, as if they were locked.
    whole = so3.rotate(so3.conjugate(motion.attitude[1:]), momentum[1:])
    assert motion.angular_velocity[1:] == pytest.approx(
        np.linalg.solve(BODY.inertia, whole.T).T, abs=1.0 / friction)


def test_commands_are_clipped_held_and_kept():
    efforts = EffortLog([SECOND, 0, SECOND, 2 * SECOND],
                        [[0.2, np.nan, np.nan, np.nan], [0.1, -0.2, 5.0, np.nan],
                         [np.nan, 0.1, np.nan, np.nan], [np.nan] * 4])
    assert efforts.times_ns.tolist() == [0, SECOND]
    motion = propagate(BODY, START, at=[0, SECOND - 1, SECOND, 3 * SECOND], wheels=FREE,
                       efforts=efforts)
    assert motion.wheel_efforts.tolist() == [
        [0.1, -0.2, 0.3, 0.0]] * 2 + [[0.2, 0.1, 0.3, 0.0]] * 2
    propagator = Propagator(BODY, START, wheels=FREE, history=2.0)
    assert propagator.apply_efforts(SECOND, {'a': 7.0, 'b': 0.1})
    assert propagator.apply_efforts(SECOND, {'a': 0.2})  # replaces the command with the same stamp
    assert propagator.apply_efforts(0, {'a': 0.1, 'b': -0.2, 'c': 5.0})
    assert np.array_equal(propagator.at(3 * SECOND).wheel_speeds, motion.wheel_speeds[-1])
    assert propagator.at(3 * SECOND).wheel_efforts.tolist() == [0.2, 0.1, 0.3, 0.0]
    assert propagator.commands_since(SECOND // 2) == [
        (0, {'a': 0.1, 'b': -0.2, 'c': 5.0}), (SECOND, {'a': 0.2, 'b': 0.1})]
    assert propagator.commands_since(SECOND) == [(0, {'c': 5.0}), (SECOND, {'a': 0.2, 'b': 0.1})]


def test_all_commands_time_out_after_the_last_of_them():
    efforts = EffortLog([0, SECOND], [[0.1, 0.2, 0.0, 0.0], [0.3, np.nan, np.nan, np.nan]])
    motion = propagate(BODY, START, at=[SECOND + SECOND // 2 - 1, SECOND + SECOND // 2],
                       wheels=FREE, efforts=efforts, torque_timeout=0.5)
    assert motion.wheel_efforts.tolist() == [[0.3, 0.2, 0.0, 0.0], [0.0] * 4]


def test_a_state_of_public_numbers_restarts_to_rounding():
    efforts, start = EffortLog([0], [[0.1, 0.2, -0.3, 0.0]]), replace(
        START, rotor_momentum=(0.2, -0.1, 0.4))
    propagator = Propagator(BODY, start, wheels=FREE)
    propagator.apply_efforts(0, dict(zip('abcd', efforts.efforts[0])))
    middle, end = propagator.at(SECOND), propagator.at(2 * SECOND)
    copy = State(SECOND, middle.attitude, middle.angular_velocity, middle.rotor_momentum,
                 middle.wheel_speeds)
    found = propagate(BODY, copy, at=[2 * SECOND], wheels=FREE, efforts=efforts)
    assert abs(found.attitude[0] - end.attitude).max() < 1e-15
    assert abs(found.wheel_speeds[0] - end.wheel_speeds).max() < 1e-13
    assert abs(found.rotor_momentum[0] - end.rotor_momentum).max() < 1e-14
    # Without named wheels, the rotors keep their momentum relative to the body.
    held = propagate(BODY, middle, at=[2 * SECOND])
    assert np.array_equal(held.rotor_momentum[0], middle.rotor_momentum)


SCENE = {'inertia.ixx': 2.0, 'inertia.iyy': 3.0, 'inertia.izz': 4.0,
         'initial_angular_velocity.x': 0.3, 'initial_rotor_momentum.y': 0.2,
         'wheel_names': ['rw_x', 'rw_yz'], 'rw_x.axis.x': 2.0, 'rw_x.inertia': 0.05,
         'rw_x.initial_speed': 30.0, 'rw_yz.axis.y': 1.0, 'rw_yz.axis.z': 1.0,
         'rw_yz.inertia': 0.1, 'rw_yz.max_torque': 0.2, 'rw_yz.max_speed': 100.0}


def test_a_scene_names_wheels():
    scene = Scene.from_values(SCENE)
    wheels = [Wheel('rw_x', (1, 0, 0), 0.05, 30.0),
              Wheel('rw_yz', (0, 1, 1), 0.1, max_torque=0.2, max_speed=100.0)]
    at = np.arange(0, 5 * SECOND, SECOND)
    expected = propagate(scene.body, scene.start, at=at, wheels=wheels)
    assert_array_equal(numbers(scene.problem().propagate(at=at)), numbers(expected))
    assert scene.has_rotors


@pytest.mark.parametrize(('values', 'message'), [
    ({'wheels': True}, 'wheel_names: expected none with wheels: true, found rw_x, rw_yz'),
    ({'rw_x.axis.x': 0.0}, 'rw_x.axis: expected rw_x.axis.x, .y or .z other than 0, found zeros'),
    ({'rw_x.friction': -0.1}, 'rw_x.friction: expected a finite number not less than 0'),
    ({'rw_x.inertia': None}, 'rw_x.inertia: expected a number (kg m^2), found none'),
    ({'rw_x.inertia': 1.9}, 'wheels: expected axial inertia that the body can have, found'),
    ({'other.max_speed': 1.0}, "other.max_speed: expected 'other' among the names in "
                               'wheel_names, found rw_x, rw_yz'),
    ({'rw_x.max_sped': 1.0}, 'rw_x.max_sped: unknown key; did you mean rw_x.max_speed?'),
    ({'wheel_names': ['rw_x'] * 2}, "wheel_names: expected each name once, found 'rw_x' twice"),
    ({'wheel_names': ['inertia']}, 'wheel_names: expected a name with which no other parameter'),
    ({'fields': ['rw_x']}, 'wheel_names: expected a name with which no other parameter begins, '),
    ({'orbit.mean_motion': 0.1}, 'orbit.mean_motion: expected 0 with wheel_names, because'),
])
def test_mistakes_in_a_scene_are_reported_in_one_line(values, message):
    with pytest.raises(InputError, match=f'^{re.escape(message)}') as error:
        Scene.from_values({**SCENE, **values})
    assert '\n' not in str(error.value)


def test_commands_with_one_stamp_replace_each_other_wheel_by_wheel():
    scene = Scene.from_values(SCENE)
    epoch = Epoch(scene, scene.start)
    replaced = [epoch.apply(Torque(SECOND, np.array(efforts), 'body', COMMANDS)) for efforts in (
        (0.1, np.nan), (np.nan, 0.1), (0.2, np.nan), (0.2, 0.1))]
    assert replaced == [False, False, True, True]


def test_an_inertia_that_the_wheels_do_not_leave_is_rejected_as_one():
    inputs = Inputs(Scene.from_values({**SCENE, 'inertia_topic': True}), None)
    with pytest.raises(RejectedError, match='^wheels: expected axial inertia that the') as error:
        inputs.torque(messages.inertia(SECOND, '', (0.05, 0.07, 0.07, 0.0, 0.0, 0.0)), SOURCE)
    assert error.value.cause == IMPOSSIBLE


@pytest.mark.parametrize(('other', 'speed'), [(0.0, 7.0), (1e-9, 7.0), (-1.5, 30.0)])
def test_the_marker_of_the_first_epoch_is_the_start_of_the_scene(other, speed):
    # Rotors without a name also turn. If they cancel the momentum of the wheels, the marker does
    # not contain the speeds of the wheels.
    scene = Scene.from_values({**SCENE, 'initial_rotor_momentum.x': other,
                               'initial_rotor_momentum.y': 0.0})
    start = Run(scene, None, None).initial(SECOND)
    marker = messages.WRENCH.decode(messages.epoch_marker(start))
    found = messages.epoch_start(marker.stamp_ns, marker.frame_id)
    # The marker is read later, when the scene has the speeds of another epoch.
    later = Scene.from_values({**scene.values, 'rw_x.initial_speed': speed})
    motion, expected = (run.problem(begin).propagate(at=[2 * SECOND]) for run, begin in (
        (later, found), (scene, replace(scene.start, time_ns=SECOND))))
    np.testing.assert_allclose(motion.rotor_momentum, expected.rotor_momentum, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.attitude, expected.attitude, rtol=0, atol=1e-15)
    assert other or np.array_equal(numbers(motion), numbers(expected))


@pytest.mark.parametrize(('wheels', 'frame'), [
    (FREE, None), (FREE, 'space'), (LIMITED, 'body'), (SLOWED, 'space')])
def test_the_check_of_a_motion_knows_its_wheels(wheels, frame):
    log = frame and TorqueLog([0, SECOND], [[0.1, 0.2, 0.3], [0.0, 0.1, 0.0]], frame)
    efforts = EffortLog([0, SECOND, 2 * SECOND], [[0.3, 0.1, 0.0, -0.3], [0.5] * 4, [-0.1] * 4])
    problem = Problem(BODY, START, log, wheels=wheels, efforts=efforts)
    motion = problem.propagate(at=np.arange(0, 10 * SECOND, SECOND // 10))
    assert float(re.search(r'[\d.]+e[-+]\d+', drift(problem, motion).finding)[0]) < 1e-9


@pytest.mark.parametrize(('keep', 'timeout'), [('rate', 0.03), ('momentum', 0.0)])
def test_rotors_that_do_what_the_wheels_do_move_a_changing_body_alike(keep, timeout):
    changes = BodyLog([-SECOND, SECOND, 2 * SECOND], [SMALLER, BODY, DAMPED], keep)
    problem = Problem(DAMPED, START, wheels=FREE, changes=changes, torque_timeout=timeout,
                      efforts=commands(np.random.default_rng(13), 100))
    at = np.arange(0, 4 * SECOND, 12_345_678)
    motion, other = problem.propagate(at=at), problem.carried().propagate(at=at)
    assert np.array_equal(other.attitude, motion.attitude)
    assert np.array_equal(other.angular_velocity, motion.angular_velocity)


# Largest speeds


def true_spans(values):
    """Return wheel, begin and end, ns, of the spans in which a wheel is not free."""
    begins, spans = {}, []
    for time, wheel, _, mode in values['events_t_ns_wheel_before_after']:
        if mode != 'free':
            begins.setdefault(wheel, time)
        elif wheel in begins:
            spans.append((wheel, begins.pop(wheel), time))
    return spans + [(wheel, begin, f"{values['end_ns']}") for wheel, begin in begins.items()]


def elapsed(time, time_ns, fraction):
    """Return the difference between a time with many digits and a time in two parts, s."""
    whole, _, digits = time.partition('.')
    return abs(int(whole) - time_ns + float(f'0.{digits or 0}') - fraction) * 1e-9


@pytest.mark.parametrize('name', TRUTH)
def test_motions_to_the_largest_speed_and_their_times_there_agree_with_fifty_digits(name):
    values = TRUTH[name]
    problem, rows = problem_of(values), values['rows_t_ns_attitude_rates_speeds']
    times_ns = [row[0] for row in rows]
    motion = problem.propagate(at=times_ns)
    attitude, rates, speeds = (np.array([row[k] for row in rows], float) for k in (1, 2, 3))
    phase = np.cumsum(np.linalg.norm(rates, axis=1) * np.diff([0, *times_ns]) * 1e-9)
    attitude *= np.sign(np.sum(attitude * motion.attitude, axis=1, keepdims=True))
    bound = 1e-15 * (10.0 + phase)
    assert (so3.angle_between(attitude, motion.attitude) <= bound).all()
    size = 1.0 + np.linalg.norm(rates, axis=1)
    assert (abs(rates - motion.angular_velocity).max(axis=1) <= 2.0 * bound * size).all()
    assert (abs(speeds - motion.wheel_speeds) <= 2e-15 * (10.0 + abs(speeds)) * (
        10.0 + phase[:, None])).all()
    names = problem.named_wheels.names
    found = [span for span in problem.propagate(at=[values['end_ns']]).at_limit
             if span.seconds > TOUCH]
    expected = sorted(true_spans(values), key=lambda span: float(span[1]))
    assert [span.wheel for span in found] == [names[wheel] for wheel, _, _ in expected]
    for span, (_, begin, end) in zip(found, expected):
        assert elapsed(begin, span.begin_ns, span.begin_fraction) <= 1e-12
        # A wheel leaves the speed of `grazing` with hardly any acceleration.
        assert elapsed(end, span.end_ns, span.end_fraction) <= (
            1e-11 if name == 'grazing' else 1e-12)


def random_problem(seed, friction=False):
    """Return a body with one to four limited wheels, commands at irregular times, and a torque."""
    random = np.random.default_rng((58, seed))
    count = int(random.integers(1, 5))
    moments = 0.1 * random.uniform(1.0, 1.9, 3)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    wheels = [Wheel(f'w{k}', random.normal(size=3), 0.002 * random.uniform(0.5, 2.0),
                    random.uniform(-70.0, 70.0), 1e-4 * friction * random.random(),
                    max_speed=50.0) for k in range(count)]
    stamps = np.sort(random.integers(0, 5 * SECOND, 6))
    torque = TorqueLog(np.arange(5) * SECOND, 0.05 * random.normal(size=(5, 3)))
    return Problem(RigidBody(turn * moments @ turn.T), State(0, (0, 0, 0, 1),
                                                             random.normal(size=3)),
                   torque if random.random() < 0.5 else None, wheels=wheels,
                   efforts=EffortLog(stamps, 0.05 * random.normal(size=(6, count))))


def check(problem, at):
    """Check that motors do what they may at all times; return how often wheels are held."""
    motion = problem.propagate(at=at)
    speeds, efforts = motion.wheel_speeds, motion.wheel_efforts
    commands = motion._parts[0].wheels.efforts(at)
    drives = commands * speeds > 0.0
    beyond, below = abs(speeds) > 50.0 * (1.0 + 1e-11), abs(speeds) < 50.0 * (1.0 - 1e-11)
    assert (efforts[drives & beyond] == 0.0).all()
    assert (efforts[below | ~drives] == commands[below | ~drives]).all()
    assert (abs(efforts) <= abs(commands)).all()
    assert (efforts * commands >= 0.0).all()
    return int((drives & ~beyond & ~below & (efforts != 0.0)).sum())


@pytest.mark.parametrize('friction', [False, True])
def test_no_motor_drives_a_wheel_beyond_its_limit(friction):
    at = np.linspace(0, 8 * SECOND, 400).astype(np.int64)
    assert sum(check(random_problem(seed, friction), at) for seed in range(15)) > 200


@pytest.mark.nightly
def test_no_event_is_missed_in_a_hundred_thousand_motions():
    at = np.linspace(0, 8 * SECOND, 100).astype(np.int64)
    for seed in range(100_000):
        check(random_problem(seed, seed % 2 > 0), at)


def test_a_motor_at_the_limit_gives_what_friction_takes():
    wheel = Wheel('w', (0, 0, 1), 1e-3, friction=1e-3, max_speed=5.0)
    motion = Problem(RigidBody(np.eye(3) * 1e9), State(), wheels=[wheel],
                     efforts=EffortLog([0], [[1.0]])).propagate(at=[SECOND])
    assert motion.wheel_efforts[0, 0] == pytest.approx(5e-3, rel=1e-9)
    assert motion.wheel_speeds[0, 0] == pytest.approx(5.0, rel=1e-15)


def test_rotors_with_the_mean_efforts_keep_the_momentum_of_the_wheels():
    problem = problem_of(TRUTH['four_skewed'])
    carried = problem.carried()
    at = problem.efforts.times_ns[1:]
    expected, found = problem.propagate(at=at), carried.propagate(at=at)
    assert expected.at_limit
    # The rotors of the carrier have the axial momenta of the wheels.
    wheels = problem.named_wheels
    momentum = expected.rotor_momentum + wheels.of_body(expected.angular_velocity)
    np.testing.assert_allclose(found.rotor_momentum, momentum, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.attitude, expected.attitude, atol=1e-4)
