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

"""Named wheels: exact to rounding, with the same bits in any order of arrival."""

from dataclasses import replace
from itertools import product
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from rigid_body_ros import (
    BodyLog,
    EffortLog,
    GravityGradient,
    messages,
    Problem,
    propagate,
    propagate_many,
    Propagator,
    RigidBodies,
    RigidBody,
    so3,
    State,
    States,
    TorqueLog,
    UniformField,
    Wheel,
)
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.ensemble.dispersions import Dispersion
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.live.checkpoint import Checkpoint
from rigid_body_ros.live.epoch import Epoch
from rigid_body_ros.live.events import IMPOSSIBLE, RejectedError
from rigid_body_ros.live.inputs import Inputs, Torque
from rigid_body_ros.live.run import Run
from rigid_body_ros.propagation import Integration
from rigid_body_ros.propagation.sensitivity import last_digit_effect
from rigid_body_ros.propagation.sources import BODY as SOURCE
from rigid_body_ros.propagation.sources import COMMANDS
from rigid_body_ros.replay.check import drift
from rigid_body_ros.scene import Scene
import terms

SECOND = 10 ** 9
BODY = RigidBody([[2.0, 0.1, -0.2], [0.1, 3.0, 0.05], [-0.2, 0.05, 4.0]])
SMALLER = RigidBody.from_moments(1.5, 2.2, 2.6, 0.05, -0.1)
DAMPED = RigidBody(BODY.inertia, damping=np.diag([0.01, 0.02, 0.03]))
START = State(0, (0.1, -0.3, 0.2, 0.9), (0.3, 0.5, -0.2))
#: Four wheels in a pyramid.
PYRAMID = [Wheel(name, axis, 0.05, speed, max_torque=0.3) for name, axis, speed in (
    ('a', (1, 1, 1), 0.0), ('b', (-1, 1, 1), 40.0), ('c', (-1, -1, 1), -3.0),
    ('d', (1, -1, 1), 9.0))]
LIMITED = [replace(wheel, max_speed=10.0) for wheel in PYRAMID]
#: The same with friction, except that one of them turns without.
SLOWED = [replace(wheel, friction=friction)
          for wheel, friction in zip(LIMITED, (0.02, 0.05, 0.0, 0.01))]


def same(one, other):
    """Return whether two motions have the same bits."""
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in (
        'attitude', 'angular_velocity', 'rotor_momentum', 'wheel_speeds'))


def commands(rng, count=40, wheels=4):
    """Return efforts at irregular stamps, some before the start; a third of them are missing."""
    stamps = np.sort(rng.integers(-SECOND // 4, 3 * SECOND, count))
    efforts = rng.normal(0.0, 0.4, (count, wheels))
    efforts[rng.random(efforts.shape) < 0.3] = np.nan
    return EffortLog(stamps, efforts)


def arrivals(log, wheels=PYRAMID):
    """Return the calls that apply a log."""
    return [('apply_efforts', int(stamp), {wheel.name: effort for wheel, effort in zip(
        wheels, row) if effort == effort}) for stamp, row in zip(log.times_ns, log.efforts)]


@pytest.mark.parametrize('name', ['wheels_spin_up', 'wheels_friction'])
def test_motions_agree_with_fifty_digits(name, fifty_digits):
    body, start, values = terms.reference(name)
    rows, logs = values['efforts_t_ns_each'], [
        TorqueLog([row[0] for row in source['t_ns_x_y_z']],
                  [row[1:] for row in source['t_ns_x_y_z']], source['frame'])
        for source in values.get('sources', ())]
    terms.assert_agrees(Problem(
        body, start, logs, wheels=[Wheel(**wheel) for wheel in values['wheels']],
        efforts=EffortLog([row[0] for row in rows], [row[1:] for row in rows])), values)


@pytest.mark.slow
@pytest.mark.parametrize(('solver', 'wheels'), [
    *product(['auto', 'taylor', 'rk4', 'explicit_euler'], [PYRAMID]),
    *product(['auto', 'taylor'], [LIMITED, SLOWED])])
@pytest.mark.parametrize('keep', ['rate', 'momentum'])
def test_any_order_of_arrival_gives_the_same_bits(keep, solver, wheels):
    rng = np.random.default_rng(38)
    efforts, options = commands(rng), {
        'solver': solver, 'max_step': None if solver in ('auto', 'taylor') else 0.01,
        'fields': [UniformField((0.0, 0.1, -0.4), (0.0, 0.0, -9.81))], 'torque_timeout': 0.12}
    stamps = np.arange(20) * 150_000_000
    logs = [TorqueLog(stamps, rng.normal(size=(20, 3))),
            TorqueLog(stamps[::3] + 12_345, rng.normal(size=(7, 3)), frame='space')]
    changes = BodyLog([stamps[7], int(efforts.times_ns[21]), 2_345_678_901],
                      [SMALLER, DAMPED, BODY], keep)
    start = replace(START, rotor_momentum=(0.2, -0.1, 0.4))
    at = np.sort(np.concatenate([rng.integers(0, 3 * SECOND, 40), changes.times_ns,
                                 efforts.times_ns[efforts.times_ns >= 0]]))
    expected = propagate(BODY, start, logs, at=at, wheels=wheels, efforts=efforts,
                         changes=changes, **options)
    events = [('apply', int(stamp), torque, 'space' if in_space else 'body', source)
              for source, log in enumerate(logs)
              for stamp, torque, in_space in zip(log.times_ns, log.torques, log.in_space)]
    events += arrivals(efforts)
    events += [('apply_body', int(stamp), body, keep)
               for stamp, body in zip(changes.times_ns, changes.bodies)]
    for _ in range(3):
        propagator = Propagator(BODY, start, history=10.0, wheels=wheels, **options)
        for number in rng.permutation(len(events)):
            name, *values = events[number]
            assert getattr(propagator, name)(*values)
            if not number % 7:
                propagator.at(int(rng.integers(0, 3 * SECOND)))  # a prediction changes no bit
        for row, time_ns in enumerate(at.tolist()):
            state = propagator.at(time_ns)
            assert np.array_equal(state.attitude, expected.attitude[row])
            assert np.array_equal(state.angular_velocity, expected.angular_velocity[row])
            assert np.array_equal(state.rotor_momentum, expected.rotor_momentum[row])
            assert np.array_equal(state.wheel_speeds, expected.wheel_speeds[row])


@pytest.mark.parametrize('wheels', [PYRAMID, SLOWED])
def test_momentum_in_space_is_constant_with_wheels_alone(wheels):
    motion = propagate(BODY, START, at=np.arange(0, 100 * SECOND, 10 ** 8), wheels=wheels,
                       efforts=EffortLog(np.arange(100) * SECOND, 0.3 * np.random.default_rng(
                           1).normal(size=(100, 4))))
    momentum = motion.angular_momentum_space
    largest = np.linalg.norm(motion.rotor_momentum, axis=1).max()
    assert np.abs(momentum - momentum[0]).max() < 4e-15 * largest
    by_hand = BODY.angular_momentum(motion.angular_velocity) + 0.05 * motion.wheel_speeds @ \
        np.array([wheel.axis for wheel in PYRAMID])
    assert np.abs(so3.rotate(motion.attitude, by_hand) - momentum[0]).max() < 1e-14 * largest


def energy(body, wheels, motion):
    """Return the kinetic energy of a body with its wheels, J, shape (m,)."""
    inertia = np.array([wheel.inertia for wheel in wheels])
    turns = motion.angular_velocity @ np.array([wheel.axis for wheel in wheels]).T
    whole = motion.wheel_speeds + turns
    return motion.kinetic_energy + 0.5 * (whole ** 2 - turns ** 2) @ inertia


def test_friction_takes_energy_until_the_wheels_turn_with_the_body():
    at = np.arange(0, 300 * SECOND, SECOND // 10)
    wheels = [replace(wheel, friction=0.02) for wheel in PYRAMID]
    motion = propagate(BODY, START, at=at, wheels=wheels)
    change = np.diff(energy(BODY, wheels, motion))
    assert (change < 1e-14).all()
    assert change[:100].max() < -1e-4
    loss = 0.02 * (motion.wheel_speeds[:-1] ** 2 + motion.wheel_speeds[1:] ** 2).sum(axis=1) / 2
    assert change[:100] == pytest.approx(-0.1 * loss[:100], rel=1e-2)
    # At the end, the wheels hardly turn relative to the body.
    assert abs(motion.wheel_speeds[-1]).max() < 0.1
    momentum = motion.angular_momentum_space
    assert abs(momentum - momentum[0]).max() < 4e-15 * np.linalg.norm(momentum[0])


def test_a_wheel_along_the_axis_of_rotation_slows_as_an_exponential():
    wheel = Wheel('w', (0, 0, 1), 0.1, 50.0, friction=0.03)
    body = RigidBody(np.diag([2.0, 3.0, 4.0]))
    at = np.arange(0, 30 * SECOND, SECOND)
    motion = propagate(body, State(), at=at, wheels=[wheel], efforts=EffortLog([0], [[0.3]]))
    rate = 0.03 * (1.0 / 0.1 + 1.0 / 3.9)
    last = 0.3 / 0.03  # where friction balances the motor
    expected = last + (50.0 - last) * np.exp(-rate * at * 1e-9)
    np.testing.assert_allclose(motion.wheel_speeds[:, 0], expected, rtol=2e-15)
    np.testing.assert_allclose(motion.angular_velocity[:, 2], 0.1 * (50.0 - expected) / 4.0,
                               rtol=2e-14, atol=1e-15)


def test_no_friction_changes_no_bit_and_a_little_is_close():
    efforts, at = commands(np.random.default_rng(11)), np.arange(0, 4 * SECOND, SECOND // 7)
    without = propagate(BODY, START, at=at, wheels=LIMITED, efforts=efforts)
    none = [replace(wheel, friction=0.0) for wheel in SLOWED]
    assert same(propagate(BODY, START, at=at, wheels=none, efforts=efforts), without)
    little = [replace(wheel, friction=1e-18) for wheel in LIMITED]
    found = propagate(BODY, START, at=at, wheels=little, efforts=efforts)
    assert abs(found.attitude - without.attitude).max() < 2e-15
    assert abs(found.wheel_speeds - without.wheel_speeds).max() < 1e-13


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
    motion = propagate(BODY, START, at=[0, SECOND - 1, SECOND, 3 * SECOND], wheels=PYRAMID,
                       efforts=efforts)
    assert motion.wheel_efforts.tolist() == [
        [0.1, -0.2, 0.3, 0.0]] * 2 + [[0.2, 0.1, 0.3, 0.0]] * 2
    propagator = Propagator(BODY, START, wheels=PYRAMID, history=2.0)
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
                       wheels=PYRAMID, efforts=efforts, torque_timeout=0.5)
    assert motion.wheel_efforts.tolist() == [[0.3, 0.2, 0.0, 0.0], [0.0] * 4]


@pytest.mark.parametrize('wheels', [PYRAMID, LIMITED, SLOWED])
@pytest.mark.parametrize('timeout', [0.0, 0.1])
def test_a_motion_in_pieces_has_the_same_bits(wheels, timeout):
    rng = np.random.default_rng(3)
    stamps = np.arange(40) * 100_000_000
    log, efforts = TorqueLog(stamps, rng.normal(size=(40, 3))), commands(rng)
    changes = BodyLog([stamps[11], stamps[20], 2_345_678_901], [SMALLER, DAMPED, BODY], 'momentum')
    at = np.arange(0, 4 * SECOND, 12_345_678)
    options = {'wheels': wheels, 'changes': changes, 'torque_timeout': timeout}
    whole = Integration(Problem(BODY, START, log, efforts=efforts, **options))
    expected = whole.advance(at)
    run, found = None, []
    for begin, end in zip([0, 13, 20, 27], [13, 20, 27, None]):
        until_ns = None if end is None else int(stamps[end])
        problem = Problem(BODY, START, log.between(stamps[begin], until_ns or 4 * SECOND),
                          efforts=efforts.between(int(stamps[begin]), until_ns or 4 * SECOND),
                          **options)
        if run is None:
            run = Integration(problem)
        else:
            run.extend(problem)
        inside = (at >= stamps[begin]) & (at < (until_ns or 2 ** 62))
        found.append(run.advance(at[inside], until_ns))
    for name in ('attitude', 'angular_velocity', 'rotor_momentum', 'wheel_speeds'):
        assert np.array_equal(np.concatenate([getattr(part, name) for part in found]),
                              getattr(expected, name))


@pytest.mark.parametrize('wheels', [PYRAMID, LIMITED, SLOWED])
def test_a_state_restarts_with_the_same_bits(wheels):
    rng = np.random.default_rng(5)
    efforts = commands(rng)
    at = np.sort(rng.integers(2 * SECOND, 4 * SECOND, 30))
    start = replace(START, rotor_momentum=(0.2, -0.1, 0.4))
    whole = propagate(BODY, start, at=at, wheels=wheels, efforts=efforts)
    propagator = Propagator(BODY, start, wheels=wheels, history=10.0)
    for name, *values in arrivals(efforts):
        getattr(propagator, name)(*values)
    for time_ns in (1_700_000_000, int(efforts.times_ns[20])):
        middle = propagator.at(time_ns)
        inside = at >= time_ns
        assert same(propagate(BODY, middle, at=at[inside], wheels=wheels, efforts=efforts),
                    propagate(BODY, start, at=at[inside], wheels=wheels, efforts=efforts))
    assert same(propagate(BODY, start, at=at, wheels=wheels, efforts=efforts), whole)


def test_a_state_of_public_numbers_restarts_to_rounding():
    efforts, start = EffortLog([0], [[0.1, 0.2, -0.3, 0.0]]), replace(
        START, rotor_momentum=(0.2, -0.1, 0.4))
    propagator = Propagator(BODY, start, wheels=PYRAMID)
    propagator.apply_efforts(0, dict(zip('abcd', efforts.efforts[0])))
    middle, end = propagator.at(SECOND), propagator.at(2 * SECOND)
    copy = State(SECOND, middle.attitude, middle.angular_velocity, middle.rotor_momentum,
                 middle.wheel_speeds)
    found = propagate(BODY, copy, at=[2 * SECOND], wheels=PYRAMID, efforts=efforts)
    assert abs(found.attitude[0] - end.attitude).max() < 1e-15
    assert abs(found.wheel_speeds[0] - end.wheel_speeds).max() < 1e-13
    assert abs(found.rotor_momentum[0] - end.rotor_momentum).max() < 1e-14
    # Without named wheels, the rotors keep their momentum relative to the body.
    held = propagate(BODY, middle, at=[2 * SECOND])
    assert np.array_equal(held.rotor_momentum[0], middle.rotor_momentum)
    assert np.array_equal(Propagator(BODY, middle).at(2 * SECOND).attitude, held.attitude[0])


def test_wheels_of_a_heavy_body_turn_it_as_ideal_motors_do():
    # A wheel with negligible inertia acts like a motor that pushes against space.
    wheel = Wheel('w', (1, 2, 2), 1e-12)
    torque = np.array([0.1, 0.2, 0.2])
    motion = propagate(BODY, START, at=[10 * SECOND], wheels=[wheel],
                       efforts=EffortLog([0], [[0.3]]))
    ideal = propagate(BODY, START, at=[10 * SECOND], wheels=TorqueLog([0], [torque]))
    assert abs(motion.attitude - ideal.attitude).max() < 1e-10
    assert motion.wheel_speeds[0, 0] == pytest.approx(0.3 * 10.0 / 1e-12, rel=1e-10)


def test_without_efforts_the_axial_momentum_of_each_wheel_is_constant():
    motion = propagate(BODY, START, at=np.arange(0, 50 * SECOND, SECOND), wheels=PYRAMID)
    for k, wheel in enumerate(PYRAMID):
        axial = motion.wheel_speeds[:, k] + motion.angular_velocity @ wheel.axis
        assert abs(axial - axial[0]).max() < 1e-14 * 40.0


@pytest.mark.parametrize(('make', 'message'), [
    (lambda: Wheel('', (1, 0, 0), 1.0), "name of a wheel: expected a text, found ''"),
    (lambda: Wheel('w', (0, 0, 0), 1.0), "axis of wheel 'w': expected a direction, found zeros"),
    (lambda: Wheel('w', (1, 0, 0), 0.0), "inertia of wheel 'w': expected kg m^2 greater than"),
    (lambda: Wheel('w', (1, 0, 0), 1.0, max_speed=-1.0), "max_speed of wheel 'w': expected zero"),
    (lambda: Wheel('w', (1, 0, 0), 1.0, friction=-0.1), "friction of wheel 'w': expected zero"),
    (lambda: Problem(BODY, START, wheels=[Wheel(f'w{k}', (1, 0, 0), 0.01, friction=0.1)
                                          for k in range(9)]),
     'wheels: expected at most 8 if one of them has friction or a max_speed, found 9'),
    (lambda: propagate(BODY, START, at=[0], wheels=[Wheel('w', (1, 0, 0), 0.01, friction=2e7)]),
     'wheels: expected friction whose quotients by the moments of inertia are at most 1e+09 1/s'),
    (lambda: Problem(BODY, START, wheels=SLOWED, solver='rk4', max_step=0.01),
     "solver 'rk4' handles neither friction nor max_speed of wheels, which auto and taylor do"),
    (lambda: Propagator(BODY, START, wheels=SLOWED, solver='explicit_euler', max_step=0.01),
     "solver 'explicit_euler' handles neither friction nor max_speed of wheels, "),
    (lambda: Problem(BODY, START, wheels=SLOWED).carried(),
     'wheels: expected none with friction, which only a propagation computes, found a, b, d'),
    (lambda: EffortLog([0], [[np.inf]]), 'effort 0 at 0 ns: expected finite numbers, or NaN'),
    (lambda: EffortLog([0], [1.0]), 'efforts: expected shape (1, wheels), found (1,)'),
    (lambda: Problem(BODY, START, wheels=PYRAMID, efforts=EffortLog([0], [[1.0]])),
     'efforts: expected those of 4 named wheels, found those of 1'),
    (lambda: Problem(BODY, START, efforts=EffortLog([0], [[1.0]])),
     'efforts: expected those of 0 named wheels, found those of 1'),
    (lambda: Problem(BODY, START, wheels=[PYRAMID[0]] * 2), 'wheels: expected each name once, '),
    (lambda: propagate(BODY, START, at=[0], wheels=[Wheel('w', (1, 0, 0), 2.5)]),
     'wheels: expected axial inertia that the body can have, found that the rest is impossible: '),
    (lambda: propagate(BODY, replace(START, wheel_speeds=(1.0, 2.0)), at=[0], wheels=PYRAMID),
     'start: expected the speeds of 4 wheels, found 2'),
    (lambda: Problem(BODY, START, wheels=PYRAMID, solver='exact'),
     "solver 'exact' handles neither rotors nor damping, found rotors"),
    (lambda: Propagator(BODY, START, wheels=PYRAMID, fields=[GravityGradient(0.1)]),
     'fields: expected no gravity gradient with wheels that have names, '),
    (lambda: Propagator(BODY, START).apply_efforts(0, {'a': 1.0}),
     'efforts: expected named wheels, found none'),
    (lambda: Propagator(BODY, START, wheels=PYRAMID).apply_efforts(0, {'e': 1.0}),
     "efforts: expected names of wheels (a, b, c, d), found 'e'"),
    (lambda: Propagator(BODY, START, wheels=PYRAMID).apply_efforts(0, {'a': np.nan}),
     "effort of wheel 'a': expected a finite number, found nan"),
])
def test_mistakes_are_reported(make, message):
    with pytest.raises(ValueError, match=f'^{re.escape(message)}'):
        make()


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
    assert same(scene.problem().propagate(at=at), expected)
    epoch = Epoch(scene, scene.start)
    assert np.array_equal(epoch.at(at[-1], np.inf).wheel_speeds, expected.wheel_speeds[-1])
    assert scene.has_rotors


@pytest.mark.parametrize(('values', 'message'), [
    ({'wheels': True}, 'wheel_names: expected none with wheels: true, found rw_x, rw_yz'),
    ({'rw_x.axis.x': 0.0}, 'rw_x.axis: expected rw_x.axis.x, .y or .z other than 0, found zeros'),
    ({'rw_x.friction': -0.1}, 'rw_x.friction: expected a finite number not less than 0'),
    ({'rw_x.friction': 0.1, 'solver': 'rk4', 'max_step': 0.1},
     "solver 'rk4' handles neither friction nor max_speed of wheels"),
    ({'rw_x.inertia': 0.0}, 'rw_x.inertia: expected a finite number greater than 0'),
    ({'rw_x.inertia': None}, 'rw_x.inertia: expected a number (kg m^2), found none'),
    ({'rw_x.inertia': 1.9}, 'wheels: expected axial inertia that the body can have, found'),
    ({'other.max_speed': 1.0}, "other.max_speed: expected 'other' among the names in "
                               'wheel_names, found rw_x, rw_yz'),
    ({'rw_x.max_sped': 1.0}, 'rw_x.max_sped: unknown key; did you mean rw_x.max_speed?'),
    ({'wheel_names': ['rw_x'] * 2}, "wheel_names: expected each name once, found 'rw_x' twice"),
    ({'wheel_names': ['inertia']}, 'wheel_names: expected a name with which no other parameter'),
    ({'fields': ['rw_x']}, 'wheel_names: expected a name with which no other parameter begins, '),
    ({'orbit.mean_motion': 0.1}, 'orbit.mean_motion: expected 0 with wheel_names, because'),
    ({'solver': 'exact'}, "solver 'exact' handles neither rotors nor damping, found rotors"),
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


def test_a_checkpoint_keeps_the_speeds_of_the_wheels(tmp_path):
    scene = Scene.from_values(SCENE)
    state = Epoch(scene, scene.start).at(3 * SECOND, np.inf)
    Checkpoint(str(tmp_path / 'state.json'), scene, '/node').save_last(state)
    found = Checkpoint(str(tmp_path / 'state.json'), scene, '/node').start
    assert np.array_equal(found.wheel_speeds, state.wheel_speeds)
    assert np.array_equal(found.rotor_momentum, state.rotor_momentum)
    end = Epoch(scene, found).at(4 * SECOND, np.inf)
    expected = Epoch(scene, scene.start).at(4 * SECOND, np.inf)
    assert abs(end.attitude - expected.attitude).max() < 1e-15
    assert abs(end.wheel_speeds - expected.wheel_speeds).max() < 1e-13


@pytest.mark.parametrize(('other', 'speed'), [(0.0, 7.0), (0.2, 7.0), (1e-9, 7.0), (-1.5, 30.0)])
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
    np.testing.assert_allclose(motion.rotor_momentum, expected.rotor_momentum, atol=1e-15)
    np.testing.assert_allclose(motion.attitude, expected.attitude, atol=1e-15)
    assert other or same(motion, expected)


@pytest.mark.parametrize('log', [
    None, TorqueLog([0, SECOND], [[0.1, 0.2, 0.3], [0.0, 0.1, 0.0]]),
    TorqueLog([0, SECOND], [[0.1, 0.2, 0.3], [0.0, 0.1, 0.0]], frame='space')])
@pytest.mark.parametrize('wheels', [PYRAMID, LIMITED, SLOWED])
def test_the_check_of_a_motion_knows_its_wheels(log, wheels):
    efforts = EffortLog([0, SECOND, 2 * SECOND], [[0.3, 0.1, 0.0, -0.3], [0.5] * 4, [-0.1] * 4])
    problem = Problem(BODY, START, log, wheels=wheels, efforts=efforts)
    at = np.arange(0, 10 * SECOND, SECOND // 10)
    motion = problem.propagate(at=at)
    assert float(re.search(r'[\d.]+e[-+]\d+', drift(problem, motion).finding)[0]) < 1e-9
    if problem.is_coupled:
        return
    other = problem.carried().propagate(at=at)
    assert np.array_equal(other.attitude, motion.attitude)
    assert np.array_equal(other.angular_velocity, motion.angular_velocity)


@pytest.mark.parametrize('timeout', [0.0, 0.03])
@pytest.mark.parametrize('keep', ['rate', 'momentum'])
def test_rotors_that_do_what_the_wheels_do_move_a_changing_body_alike(keep, timeout):
    changes = BodyLog([-SECOND, SECOND, 2 * SECOND], [SMALLER, BODY, DAMPED], keep)
    problem = Problem(DAMPED, START, wheels=PYRAMID, changes=changes, torque_timeout=timeout,
                      efforts=commands(np.random.default_rng(13), 100))
    at = np.arange(0, 4 * SECOND, 12_345_678)
    motion, other = problem.propagate(at=at), problem.carried().propagate(at=at)
    assert np.array_equal(other.attitude, motion.attitude)
    assert np.array_equal(other.angular_velocity, motion.angular_velocity)


@pytest.mark.slow
def test_an_ensemble_of_a_scene_with_wheels_has_their_motions(tmp_path):
    lines = [f'    {name}: {value}' for name, value in SCENE.items()]
    (tmp_path / 'scene.yaml').write_text('/**:\n  ros__parameters:\n' + '\n'.join(lines))
    (tmp_path / 'vary.yaml').write_text('initial_angular_velocity.x: {uniform: [0.2, 0.4]}')
    assert main.attitude_ensemble([
        '--scene', str(tmp_path / 'scene.yaml'), '--vary', str(tmp_path / 'vary.yaml'), '--runs',
        '3', '--until', '2', '-o', str(tmp_path / 'runs')]) == 0
    row = pq.read_table(tmp_path / 'runs' / 'runs.parquet').to_pylist()[1]
    problem = Scene.from_values(
        {**SCENE, 'initial_angular_velocity.x': row['initial_angular_velocity.x']}).problem()
    found = [row[f'attitude.{name}'] for name in 'xyzw']
    assert found == problem.propagate(at=[2 * SECOND]).attitude[0].tolist()


def test_the_speeds_of_wheels_at_the_start_are_kept_where_the_start_varies():
    start = replace(START, wheel_speeds=(50.0, -20.0, 0.0, 70.0))
    problem = Problem(BODY, start, wheels=PYRAMID)
    runs = Ensemble(problem, SECOND, (Dispersion('inertia.ixx', 'normal', (0.0,)),), 1).rows(0, 1)
    assert [runs[f'attitude.{axis}'][0] for axis in 'xyzw'] == problem.propagate(
        at=[SECOND]).attitude[0].tolist()
    assert last_digit_effect(problem, [SECOND]) < 1e-13


def test_many_motions_refuse_wheels_with_names():
    with pytest.raises(ValueError, match='found named wheels, which only propagate computes'):
        propagate_many(RigidBodies([BODY.inertia]), States(), at=[SECOND], wheels=PYRAMID)
