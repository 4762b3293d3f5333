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

"""What the engine refuses, in one line that names what was found."""

from functools import partial

from conftest import EPOCH_NS, SECOND
import numpy as np
from parts import BODY, DAMPED, FIELDS
import pytest
from rigid_body_ros import (
    Actuator,
    BodyLog,
    EffortLog,
    GravityGradient,
    Problem,
    propagate,
    propagate_many,
    Propagator,
    RigidBodies,
    RigidBody,
    State,
    States,
    TorqueLog,
    UniformField,
    Wheel,
)
from scipy.spatial.transform import Rotation

SPUN = State(rotor_momentum=(0, 0, 1))
START = State(EPOCH_NS, (0.1, -0.3, 0.2, 0.9), (0.5, -0.7, 0.9))
(FIELD, *_), ORBITS = FIELDS, [GravityGradient(0.4), GravityGradient(1.0)]
LOG, MOTOR = TorqueLog([0], [[1, 0, 0]]), TorqueLog([0], [[0, 0, 1.0]])
LINEAR = TorqueLog([0], [[1, 0, 0]], interpolation='linear')
WHEEL = Wheel('a', (1, 0, 0), 0.01)
FRICTION, LAG = [Wheel('w', (1, 0, 0), 0.01, friction=0.1)], Actuator(0.1)
DIRECTIONS = 'position and normal of an orbit: expected directions at right angles, found a '
THREE, NANOSECONDS = 'expected 3 finite numbers', 'expected integer nanoseconds'
TWO = {'bodies': RigidBodies([np.eye(3)] * 2), 'starts': States(0, np.ones((2, 4))), 'at': [1]}
STEP = {'max_step': 0.1}


def live(**options):
    return Propagator(BODY, State(), **options)


#: Calls, and their impossible arguments, each with the beginning of the message.
REFUSED = {
    RigidBody: [
        ([np.eye(2)], 'inertia: expected 3 by 3 finite numbers'),
        ([np.full((3, 3), np.nan)], '.*found .*nan'),
        ([[[1, 0.1, 0], [0.2, 1, 0], [0, 0, 1]]], '.*symmetric tensor, found .*0.2'),
        ([np.diag([1.0, -2.0, 1.5])], '.*positive definite.* -2, 1, 1.5'),
        ([np.diag([1.0, 1.0, 3.0])],
         '.*not physical, .* 1, 1, 3 kg m.*other two by 50 % .limit 3 %'),
        ([np.eye(3) * 1e-310], '.*whose values and inverses fit a double'),
        ([BODY.inertia, np.eye(2)],
         r'damping: expected 3 by 3 finite numbers, found \[\[1.0, 0.0\], \[0.0, 1.0\]\]$'),
        ([BODY.inertia, np.triu(np.ones((3, 3)))], 'damping: expected a symmetric tensor, found '),
        ([BODY.inertia, np.diag([1.0, -0.5, 2.0])], 'damping: expected a tensor without negative '
         'eigenvalues, found .* with the eigenvalue -0.5 N m s/rad$'),
        ([BODY.inertia, 1e12 * np.eye(3)], r'damping: expected quotients by the moments of '
         r'inertia of at most 1e\+09 1/s, found .*e\+\d\d 1/s$')],
    RigidBody.from_point_masses: [
        ([[1.0, -1.0], np.eye(3)[:2]], '.*greater than zero'),
        ([[1.0, 0.0, 1.0], np.eye(3)], '.*greater than zero'),
        ([[], np.zeros((0, 3))], '.*greater than zero'), ([[1.0], np.eye(3)], '.*shape'),
        ([[1.0, 1.0], [[0, 0, 0], [0, 0, 1]]], '.*positive definite'),
        ([[1.0], [[1.0, 2.0, 3.0]]], '.*on one line'),
        ([[1.0, np.inf, 1.0], np.eye(3)], 'masses: expected at least one, each finite and '),
        ([[1.0, 1.0, 1.0], np.diag([1.0, np.nan, 1.0])], '.*finite numbers')],
    State: [
        ([0, (0, 0, 0, 0)], 'attitude quaternion .*expected a non-zero'),
        ([0, (0, 0, np.nan, 1)], 'attitude quaternion .*nan'),
        ([0, Rotation.from_quat(np.eye(4)[:3])], 'attitude quaternion .*expected 4 finite '),
        ([0, (0, 0, 0, 1), (0, np.inf, 0)], 'angular velocity: .*inf'),
        ([0, (0, 0, 0, 1), (0, 0, 0), (0, 1)], f'rotor momentum: {THREE}, found .*$')],
    TorqueLog: [
        ([[0, 1], [[1, 2, 3]]], r'torques: expected shape \(2, 3\), found \(1, 3\)'),
        *(([[time], [[1, 2, 3]]], f'times_ns: {NANOSECONDS}') for time in (0.5, True, 2 ** 64)),
        ([np.array([5, 2 ** 63], np.uint64), np.ones((2, 3))],
         'times_ns: expected times in int64 nanoseconds, found 9223372036854775808'),
        ([[-2 ** 62, 2 ** 62 - 1], np.ones((2, 3))], 'times_ns: .*292 years of each other'),
        ([[3], [[1, np.nan, 3]]], 'torque 0 at 3 ns: expected finite numbers, found .*nan'),
        ([[3], [[1, 2, 3]], 'base_link'], "frame: expected 'body' or 'space', found 'base_link'"),
        ([[3, 4], np.ones((2, 3)), ['body', 'x']], "frame: expected 'body' or 'space', found 'x'"),
        ([[3, 4], np.ones((2, 3)), [True]], 'frame: expected one name or 2, found 1'),
        ([[3], [[1, 2, 3]], 'body', 'spline'], "interpolation: expected .*cubic, found 'spline'"),
        ([[3, 4], np.ones((2, 3)), ['body', 'space'], 'linear'],
         '.*expected torques in one frame')],
    LOG.at: [([times], 'times_ns: expected')
             for times in ([0.5], [True], np.array([2 ** 63 + 1], np.uint64))],
    TorqueLog.from_momentum: [
        ([[0, 1], [[1, 2, 3]]], r'momenta: expected shape \(2, 3\), found \(1, 3\)$'),
        ([[3], [[1, np.inf, 3]]], 'momentum 0 at 3 ns: expected finite numbers, found .*inf.*$'),
        ([[3, 4], [[0, 0, 0], [0, 1e300, 0]]], 'momentum 0 at 3 ns: expected a finite torque up '
         r'to the next sample, found a change from \[0.0, 0.0, 0.0\] to \[0.0, 1e\+300, 0.0\] N m '
         's in 1 ns$')],
    UniformField: [
        ([(0.0, np.nan, 0.0), (0, 0, 1)], rf'moment of a field: {THREE}, found .*nan, 0.0\]$'),
        ([(0, 0, 1), 9.81], rf'field of a field: {THREE}, found 9.81$')],
    GravityGradient: [
        *(([rate], f'mean motion of an orbit: expected rad/s greater than zero, found {rate}$')
          for rate in (0.0, -0.001, np.nan, np.inf)),
        ([1.0, (0, 0, 0)], 'position of an orbit: expected a direction, found zeros$'),
        ([1.0, (1, 0, 0), (0, 1)], rf'normal of an orbit: {THREE}, found \[0.0, 1.0\]$'),
        ([1.0, (1, 0, 0), (-1e-8, 0, 1)], f'{DIRECTIONS}cosine of -1e-08$'),
        ([1.0, (1, 0, 0), (0, 0, 1), 2 ** 63], '.*9223372036854775808.*$')],
    BodyLog: [
        ([[0, 1], [BODY]], 'bodies: expected 2, one for each stamp, found 1'),
        ([[0], [BODY], 'energy'], "keep: expected 'rate' or 'momentum', found 'energy'"),
        ([[0.5], [BODY]], rf'times_ns: {NANOSECONDS} of shape \(n,\), found float64')],
    Actuator: [
        ([-1.0], r'delay of an actuator: expected seconds from 0 to 1e\+09, found -1.0'),
        ([0.0, np.nan],
         r'time_constant of an actuator: expected 0 or 1e-09 to 1e\+09 s, found nan'),
        ([0, 0, (1.0, -1.0, 0.0)], 'limit of an actuator: expected 3 finite numbers from 0 on'),
        ([0, 0, 1.0], 'limit of an actuator: expected 3 finite numbers from 0 on, found 1.0')],
    Wheel: [
        (['', (1, 0, 0), 1.0], "name of a wheel: expected a text, found ''"),
        (['w', (0, 0, 0), 1.0], "axis of wheel 'w': expected a direction, found zeros"),
        (['w', (1, 0, 0), 0.0], "inertia of wheel 'w': expected kg m\\^2 greater than"),
        (['w', (1, 0, 0), 1.0, 0, 0, 0, -1.0], "max_speed of wheel 'w': expected zero"),
        (['w', (1, 0, 0), 1.0, 0, -0.1], "friction of wheel 'w': expected zero")],
    EffortLog: [
        ([[0], [[np.inf]]], 'effort 0 at 0 ns: expected finite numbers, or NaN'),
        ([[0], [1.0]], r'efforts: expected shape \(1, wheels\), found \(1,\)')],
    partial(propagate, BODY, START, at=[EPOCH_NS]): [
        ({'at': [EPOCH_NS - 1]}, rf'at: expected no time before the start \({EPOCH_NS} ns\), '
         f'found {EPOCH_NS - 1} ns'),
        *(({'at': [time]}, f'at: {NANOSECONDS}') for time in (0.5, True)),
        ({'at': np.array([2 ** 63], np.uint64)}, f'at: .* int64 nanoseconds, found {2 ** 63}'),
        ({'at': [2 ** 63 - 1]}, f'at: expected times before {2 ** 63 - 1} ns, found '),
        ({'solver': 'euler'}, "solver: expected one of auto, taylor, exact, .* found 'euler'"),
        ({'tolerance': 1e-16}, 'tolerance: .* 1e-15 to 1, found 1e-16'),
        ({'max_step': 0.0}, 'max_step: expected seconds greater than zero, found 0'),
        ({'torque_timeout': -1.0}, r'torque_timeout: expected seconds from 0 to 1e\+09, found -1'),
        ({'torque_timeout': 1e10}, r'torque_timeout: expected seconds from 0 to 1e\+09, found 1')],
    partial(propagate, BODY, start=State(), at=[0]): [
        ({'wheels': TorqueLog([0, 5], np.ones((2, 3)), ['body', 'space'])},
         'wheels: expected torques in body axes, found torques in space axes$'),
        ({'wheels': [Wheel('w', (1, 0, 0), 0.01, friction=2e7)]}, 'wheels: expected friction '
         r'whose quotients by the moments of inertia are at most 1e\+09 1/s'),
        ({'wheels': [Wheel('w', (1, 0, 0), 2.5)]}, 'wheels: expected axial inertia that the body '
         'can have, found that the rest is impossible: '),
        ({'start': State(wheel_speeds=(1.0, 2.0)), 'wheels': [WHEEL]},
         'start: expected the speeds of 1 wheels, found 2'),
        ({'log': [LOG] * 5, 'actuator': [Actuator(0.0, k) for k in range(1, 6)]},
         '.*at most 4 different time constants, found 5'),
        ({'log': TorqueLog([0, 5], [[0, 0, 0], [0, 1, 0]]), 'solver': 'exact'}, "solver 'exact' "
         'handles torque-free motion only, found a torque of '
         r'\[0.0, 1.0, 0.0\] N m at 5 ns \(sample 1\)'),
        *(({'solver': solver, 'wheels': MOTOR, **STEP}, f"solver '{solver}' handles neither .*$")
          for solver in ('strang', 'exact'))],
    partial(Problem, BODY, State()): [
        ({'wheels': [Wheel(f'w{k}', (1, 0, 0), 0.01, friction=0.1) for k in range(9)]},
         'wheels: expected at most 8 if one of them has friction or a max_speed, found 9'),
        ({'wheels': FRICTION, 'solver': 'rk4', **STEP}, "solver 'rk4' handles neither friction "
         'nor max_speed of wheels, which auto and taylor do'),
        ({'wheels': [WHEEL] * 2}, 'wheels: expected each name once, '),
        ({'wheels': [WHEEL], 'solver': 'exact'},
         "solver 'exact' handles neither rotors nor damping, found rotors"),
        ({'wheels': [WHEEL], 'efforts': EffortLog([0], [[1.0, 2.0]])},
         'efforts: expected those of 1 named wheels, found those of 2'),
        ({'efforts': EffortLog([0], [[1.0]])},
         'efforts: expected those of 0 named wheels, found those of 1'),
        ({'log': LINEAR, 'actuator': LAG}, '.*expected commands that are held'),
        ({'log': [LOG, LOG], 'actuator': [LAG]},
         '.*expected 2, one or None for each source, found 1')],
    Problem(BODY, State(), wheels=FRICTION).carried: [
        ([], 'wheels: expected none with friction, which only a propagation computes, found w')],
    live: [
        ({'wheels': FRICTION, 'solver': 'explicit_euler', **STEP},
         "solver 'explicit_euler' handles neither friction nor max_speed of wheels, "),
        ({'wheels': [WHEEL], 'fields': ORBITS[:1]},
         'fields: expected no gravity gradient with wheels that have names, ')],
    live().apply: [
        *(([time, [1, 2, 3]], '.*expected a time in int64 nanoseconds')
          for time in (2 ** 70, np.uint64(2 ** 63))),
        ([0, [1, 2, np.inf]], 'torque at 0 ns: '),
        ([0, [1, 2, 3], 'map'], ".*'body' or 'space', found 'map'"),
        *(([0, [0, 0, 1], 'body', source], f'source: expected .*, found {source}$')
          for source in (-1, 2 ** 63 - 1))],
    live(actuator=[LAG, None]).apply: [
        ([0, (1, 0, 0), 'body', 2], '.*expected a number from 0 to 1')],
    live(solver='exact').apply: [
        ([7, [1.0, 0.0, 0.0]], "solver 'exact' handles torque-free motion only.* at 7 ns")],
    live().apply_wheels: [
        ([3, [0, 1]], rf'torque at 3 ns: {THREE}, found \[0.0, 1.0\]$')],
    live(solver='strang', **STEP).apply_wheels: [([0, [0, 0, 1]], "solver 'strang' handles .*$")],
    live().apply_efforts: [([0, {'a': 1.0}], 'efforts: expected named wheels, found none')],
    live(wheels=[WHEEL]).apply_efforts: [
        ([0, {'e': 1.0}], r"efforts: expected names of wheels \(a\), found 'e'"),
        ([0, {'a': np.nan}], "effort of wheel 'a': expected a finite number, found nan")],
    partial(propagate_many, **TWO): [
        ({'wheels': [WHEEL]}, '.*found named wheels, which only propagate computes'),
        ({'fields': [[FIELD]]}, 'fields: expected 2, one for each body, found 1$'),
        ({'fields': [[FIELD], []]},
         'fields: expected fields for each run or for none, found 1 runs without$'),
        ({'wheels': TorqueLog([0], [[0, 0, 1]], 'space')}, 'wheels: expected torques in body '),
        ({'wheels': MOTOR, 'solver': 'strang', **STEP},
         "solver 'strang' handles neither rotors nor damping, found rotors"),
        ({'starts': States(0, np.ones((2, 4)), rotor_momentum=(0, 0, 1)), 'solver': 'exact'},
         "solver 'exact' handles neither rotors nor damping, found rotors"),
        ({'starts': States(0, np.ones((3, 4)))}, 'starts: expected 2, one for each body, found 3'),
        ({'log': [None]}, 'log: expected 2, one for each body, found 1'),
        ({'torque_gains': [1.0]}, r'torque_gains: expected shape \(2,\), found \(1,\)'),
        ({'at': [-1]}, 'at: expected no time before the start'),
        ({'bodies': RigidBodies(np.zeros((0, 3, 3)))}, 'starts: expected 0')],
}


def of_call(call):
    """Return a call's name."""
    call = getattr(call, 'func', call)
    return getattr(call, '__qualname__', repr(call))


@pytest.mark.parametrize(('call', 'arguments', 'message'), [
    pytest.param(call, *row, id=f'{of_call(call)} {number}')
    for call, rows in REFUSED.items() for number, row in enumerate(rows)])
def test_impossible_arguments_are_refused(call, arguments, message):
    with pytest.raises(ValueError, match=f'^{message}'):
        call(**arguments) if isinstance(arguments, dict) else call(*arguments)


@pytest.mark.parametrize('solver', ['strang', 'exact'])
@pytest.mark.parametrize(('body', 'start', 'found'), [
    (DAMPED, SPUN, 'damping'), (BODY, SPUN, 'rotors')])
def test_a_solver_without_rotors_and_damping_refuses_them(solver, body, start, found):
    message = f'^solver {solver!r} handles neither rotors nor damping, found {found}$'
    for entry in (Problem, Propagator):
        with pytest.raises(ValueError, match=message):
            entry(body, start, solver=solver, max_step=0.1)


@pytest.mark.parametrize('run', [
    partial(Problem, BODY, State()), live, partial(propagate_many, **TWO)], ids=of_call)
def test_every_entry_refuses_two_orbits_and_fields_in_closed_form(run):
    with pytest.raises(ValueError, match='^fields: expected at most one gravity .*, found 2$'):
        run(fields=ORBITS)
    with pytest.raises(ValueError, match="^solver 'exact' handles torque-free .*, found fields$"):
        run(fields=[FIELD], solver='exact')


@pytest.mark.parametrize(('time_ns', 'error', 'message'), [
    *((time_ns, TypeError, None) for time_ns in (
        1.5, np.float64(3.0), 1767225600.5, True, np.True_, '3', None)),
    *((time_ns, ValueError, 'expected a time in int64 nanoseconds, found') for time_ns in (
        2 ** 63, -2 ** 63, np.uint64(2 ** 63 + 5)))])
def test_a_time_that_is_no_integer_or_beyond_int64_is_refused(time_ns, error, message):
    propagator = live()
    for call in (State, propagator.at, lambda time_ns: propagator.apply(time_ns, [1, 2, 3])):
        with pytest.raises(error, match=message):
            call(time_ns)


def test_a_time_as_far_from_the_start_as_no_int64_can_tell_is_refused():
    start, late = State(-2 ** 62 - 2), 2 ** 62
    propagator = Propagator(BODY, start)
    for call in (lambda: propagate(BODY, start, at=[late]), lambda: propagator.at(late),
                 lambda: propagator.apply(late, [1, 2, 3])):
        with pytest.raises(ValueError, match='within 292 years of the start'):
            call()


@pytest.mark.slow
@pytest.mark.parametrize('torque', [1e12, 1e308])
def test_a_motion_that_no_step_resolves_is_refused_not_returned(torque):
    log = TorqueLog([EPOCH_NS], [[torque, 0.0, 0.0]])
    with np.errstate(all='ignore'), pytest.raises(ValueError, match=r'faster than 1e\+09 rad/s'):
        propagate(BODY, START, log, at=[EPOCH_NS + SECOND])
    propagator = Propagator(BODY, START)
    propagator.apply(EPOCH_NS + 1, [torque, 0.0, 0.0])
    assert propagator.at(EPOCH_NS + 1).time_ns == EPOCH_NS + 1
    with np.errstate(all='ignore'), pytest.raises(ValueError, match=r'faster than 1e\+09 rad/s'):
        propagator.at(EPOCH_NS + SECOND)
