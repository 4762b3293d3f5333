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

"""Torques that depend on the attitude: accuracy, closed forms, conservation, and equal bits."""

import os
import re
import subprocess
import sys

from conftest import chord, EPOCH_NS
import fields
from mpmath import mp
import numpy as np
import pytest
from rigid_body_ros import (
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
)
from rigid_body_ros.mechanics import so3
import terms
from terms import SECOND
from test_steppers import LADDERS
from test_terms import assert_order, relative
import truth

FULL = RigidBody([[1.1, 0.15, -0.2], [0.15, 2.0, 0.05], [-0.2, 0.05, 2.7]])
START = State(0, (0.1, -0.3, 0.2, 0.9), (0.5, -0.7, 0.9))
ROTORS = (0.2, 0.4, -0.3)
WEIGHT = UniformField((0.1, -0.2, 0.3), (0.4, -0.2, -2.5))
DIPOLE = UniformField((-0.3, 0.4, 0.1), (1.5, 0.5, 0.25))
ORBIT = GravityGradient(0.4, (1.0, 2.0, 3.0), (3.0, 0.0, -1.0))
FIELDS = [WEIGHT, ORBIT, DIPOLE]


# Fifty digits


def limits_of(scene, start, times_ns):
    """Return the bound on errors, rad or relative, at times after a start, shape (m,)."""
    return terms.bound_at(times_ns, lambda at: scene.propagate(at, start), start.time_ns, 5001)


@pytest.mark.parametrize('name', terms.NAMES_OF_FIELDS)
def test_every_motion_is_the_one_of_fifty_digits(name, fifty_digits):
    """
    Compare errors with 1e-15 (10 + phase), for the pendulum times `fields.magnification`.

    The pendulum passes near its upper balance point, and magnifies a change of its start by up to
    1.7e9. `test_no_second_of_the_pendulum_loses_more_than_it_magnifies` tests it more strictly.
    The other motions need no such factor.
    """
    scene = terms.Reference(name, terms.TRUTH_OF_FIELDS)
    motion = scene.propagate(scene.times_ns)
    limits = scene.bound
    if name == 'pendulum_swing':
        factors = fields.magnification(lambda start, at: scene.propagate(at, start), scene.start,
                                       scene.times_ns)
        assert 1e8 < factors.max() < 1e10
        limits = limits * factors
    attitude = [truth.chord(*pair) for pair in zip(scene.truth('q'), motion.attitude)]
    assert np.all(attitude <= limits)
    for found, key in ((motion.angular_velocity, 'w'),
                       (motion.angular_momentum_space, 'L_space')):
        assert np.all(relative(truth.exact(found), scene.truth(key)) <= limits)


@pytest.mark.slow
def test_no_second_of_the_pendulum_loses_more_than_it_magnifies(fifty_digits):
    # From each row of the truth to the next, a second later; the factor is 1 to 1e3.
    scene = terms.Reference('pendulum_swing', terms.TRUTH_OF_FIELDS)
    attitudes, rates = scene.truth('q'), scene.truth('w')
    speed = np.linalg.norm(rates.astype(float), axis=1).max()
    for row, (begin_ns, end_ns) in enumerate(zip(scene.times_ns, scene.times_ns[1:])):
        start, at = State(begin_ns, attitudes[row].astype(float), rates[row].astype(float)), \
            np.array([end_ns])
        limit = limits_of(scene, start, at) * fields.magnification(
            lambda start, at: scene.propagate(at, start), start, at)
        motion = scene.propagate(at, start)
        assert truth.chord(attitudes[row + 1], motion.attitude[0]) <= limit
        apart = (motion.angular_velocity[0] - rates[row + 1]).astype(float)
        assert np.linalg.norm(apart) <= limit * speed


# Closed forms


def about_x(angle):
    return np.sin(angle / 2), 0.0, 0.0, np.cos(angle / 2)


@pytest.mark.parametrize(('angle', 'rate', 'near_the_top'), [
    (0.3, 0.1, False), (2.5, -0.5, True), (1.0, -3.0, False), (0.2, 20.0, False),
    (0.2, -20.0, False), (-2.0, 2.0, False), (3.0, 1e-3, True)])
def test_a_plane_pendulum_swings_and_goes_round(angle, rate, near_the_top, fifty_digits):
    # Two of these motions come near the top, where they magnify a change of their start.
    body = RigidBody([[1.5, 0.0, 0.0], [0.0, 2.0, 0.3], [0.0, 0.3, 2.5]])
    problem = Problem(body, State(0, about_x(angle), (rate, 0.0, 0.0)),
                      fields=[UniformField((0.0, 0.1, -0.3), (0.0, 3.0, -9.0))])
    times_ns = np.array([1, 7, 20, 60]) * SECOND
    limits = fields.bound(problem, times_ns)
    if near_the_top:
        limits = limits * fields.magnification(
            lambda start, at: problem.replaced(start=start).propagate(at=at), problem.start,
            times_ns, coordinates=(0, 3))
    expected = fields.plane_pendulum(problem, times_ns)
    for error in fields.errors(problem.propagate(at=times_ns), expected):
        assert np.all(error <= limits)


@pytest.mark.slow
@pytest.mark.parametrize(('moment', 'attitude', 'rates'), [
    (0.3, (0.3, 0.0, 0.0, 0.9), (0.5, 0.0, 20.0)),
    (0.3, (0.3, 0.2, -0.5, 0.9), (-1.5, 0.3, 12.0)),
    (-0.3, (0.3, 0.2, -0.5, 0.9), (-1.5, 0.3, 2.0)),
    (0.02, (0.3, 0.1, 0.2, -0.9), (2.0, 3.0, -3.0))])
def test_lagrange_top_nods_and_precesses(moment, attitude, rates):
    # The second top precesses back and forth, and the third hangs.
    problem = Problem(RigidBody.from_moments(0.2, 0.2, 0.1), State(0, attitude, rates),
                      fields=[UniformField((0.0, 0.0, moment), (0.0, 0.0, -9.81))])
    times_ns = np.array([1, 3, 10]) * SECOND
    with mp.workdps(25):
        expected = fields.lagrange_top(problem, times_ns)
        for error in fields.errors(problem.propagate(at=times_ns), expected):
            assert np.all(error <= fields.bound(problem, times_ns))


#: Moments, kg m^2, about the directions away from the planet (yaw), along the orbit (roll) and
#: across it (pitch), for a satellite that is stable about all three.
YAW, ROLL, PITCH = 6.0, 10.0, 13.0


def libration(name, rate):
    """
    Return the angular rate, rad/s, and the amplitudes about the three directions of a libration.

    They hold for small angles (Hughes, chapter 9). The angle about the first direction is minus a
    sine; the angles about the others are cosines.
    """
    if name == 'pitch':
        return rate * np.sqrt(3.0 * (ROLL - YAW) / PITCH), np.array([0.0, 0.0, 1.0])
    k1, k3 = (PITCH - YAW) / ROLL, (PITCH - ROLL) / YAW
    squares = np.sort(np.roots([1.0, -(1.0 + 3.0 * k1 + k1 * k3), 4.0 * k1 * k3]))
    ratio = np.sqrt(squares[('slow', 'fast').index(name)])
    yaw = ratio * (1.0 - k3) / (k3 - ratio ** 2)
    return rate * ratio, np.array([yaw, 1.0, 0.0]) / max(1.0, abs(yaw))


@pytest.mark.parametrize(('name', 'order'), [('pitch', 3), ('slow', 2), ('fast', 2)])
def test_small_librations_have_the_three_frequencies_of_an_orbit(name, order):
    rate = 1.1e-3
    orbit = GravityGradient(rate, (1.0, 2.0, 3.0), (3.0, 0.0, -1.0), 0)
    frequency, amplitudes = libration(name, rate)
    times_ns = np.linspace(0.0, 6.0 * np.pi / frequency * SECOND, 100).astype(np.int64)
    phase = frequency * times_ns / SECOND
    angles = amplitudes * np.array([-np.sin(phase), np.cos(phase), np.cos(phase)]).T
    frame = so3.from_matrix(np.array([orbit.position, orbit.along, orbit.normal]).T)
    of_orbit = so3.multiply(frame, so3.exp(np.outer(rate * times_ns / SECOND, [0.0, 0.0, 1.0])))
    x, y, _ = angles[0]
    rates = np.array([-rate * y - frequency * amplitudes[0], rate * x, 0.0])
    sizes, errors = np.array([0.04, 0.02, 0.01, 0.005]), []
    for size in sizes:
        start = State(0, so3.multiply(frame, so3.exp(size * angles[0])),
                      size * rates + [0.0, 0.0, rate])
        motion = propagate(RigidBody.from_moments(YAW, ROLL, PITCH), start, at=times_ns,
                           fields=[orbit])
        found = so3.log(so3.multiply(so3.conjugate(of_orbit), motion.attitude))
        errors.append(abs(found - size * angles).max())
    assert abs(np.polyfit(np.log(sizes), np.log(errors), 1)[0] - order) < 0.1
    assert errors[-1] < 0.1 * sizes[-1]


@pytest.mark.parametrize('margin', [0.95, 0.999, 1.001, 1.05])
def test_a_sleeping_top_is_stable_above_its_limit(margin):
    # I3^2 w3^2 > 4 I1 m g l (Goldstein, section 5.7). A small tilt x + i y obeys
    # I1 z'' - i I3 w3 z' - m g l z = 0.
    across, along, weight = 0.2, 0.1, 0.3 * 9.81
    spin = np.sqrt(margin * 4.0 * across * weight) / along
    root = np.emath.sqrt((along * spin) ** 2 - 4.0 * across * weight)
    one, other = (along * spin + np.array([root, -root])) / (2.0 * across)
    end = 8.0 * 2.0 * across / abs(root)
    times_ns = np.linspace(0.0, end * SECOND, 400).astype(np.int64)
    tilt = 1e-9
    motion = propagate(RigidBody.from_moments(across, across, along),
                       State(0, so3.exp([0.0, tilt, 0.0]), (0.0, 0.0, spin)), at=times_ns,
                       fields=[UniformField((0.0, 0.0, 0.3), (0.0, 0.0, -9.81))])
    axis = so3.rotate(motion.attitude, np.broadcast_to([0.0, 0.0, 1.0], (400, 3)))
    found, t = axis[:, 0] + 1j * axis[:, 1], times_ns / SECOND
    expected = tilt * (other * np.exp(1j * one * t) - one * np.exp(1j * other * t)) / (other - one)
    assert abs(found - expected).max() < 1e-5 * abs(expected).max()
    stable = abs(found).max() < 1.001 * tilt / np.sqrt(abs(1.0 - 1.0 / margin))
    assert stable == (margin > 1.0)


# What is conserved


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('name', ['asymmetric top', 'Lagrange', 'Kovalevskaya', 'gyrostat'])
def test_energy_and_momentum_about_the_field_do_not_drift_over_ten_thousand_turns(name, seed):
    problem = fields.under_one_field(name, seed)
    motion = problem.propagate(at=fields.turns(problem, 10_000))
    assert fields.energy(problem, motion).drift() < 1e-13
    assert fields.momentum_along(problem, motion).drift() < 1e-13


@pytest.mark.parametrize('seed', range(4))
def test_kovalevskaya_integral_is_constant(seed):
    problem = fields.under_one_field('Kovalevskaya', seed)
    at = fields.turns(problem, 1000)
    assert fields.kovalevskaya_integral(problem, problem.propagate(at=at)).drift() < 5e-14
    # It is not conserved for a moment out of the plane of the equal moments of inertia.
    other = problem.replaced(fields=[UniformField((0.3, 0.4, 0.1), (0.0, 0.0, -9.81))])
    assert fields.kovalevskaya_integral(other, other.propagate(at=at)).drift() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('name', ['satellite', 'satellite with a wheel'])
def test_jacobi_integral_does_not_drift_over_ten_thousand_turns(name, seed):
    problem = fields.in_orbit(name, seed)
    motion = problem.propagate(at=fields.turns(problem, 10_000)[::50])
    assert fields.jacobi_integral(problem, motion).drift() < 1e-13


# Solvers of fixed step


def with_fields(at, body=FULL, start=START, log=None, **options):
    """Return a motion under fields and a torque in body axes."""
    log = log or TorqueLog([0, SECOND], [[0.3, -0.2, 0.1], [-0.1, 0.4, 0.2]])
    return propagate(body, start, log, at=at, fields=FIELDS, **options)


@pytest.mark.parametrize('solver', LADDERS)
def test_the_order_with_fields_is_the_one_promised(solver):
    order, steps = LADDERS[solver]
    assert_order(order, solver, steps, lambda **options: with_fields([5 * SECOND], **options))


@pytest.mark.parametrize('solver', ['rk4', 'explicit_euler'])
def test_the_order_with_fields_and_all_other_terms_is_the_one_promised(solver):
    order, steps = LADDERS[solver]
    body = RigidBody(FULL.inertia, np.diag([0.3, 0.2, 0.1]))
    start = State(0, START.attitude, START.angular_velocity, ROTORS)
    logs = [TorqueLog([0], [[0.3, -0.2, 0.1]]), TorqueLog([0], [[-0.1, 0.2, 0.3]], 'space')]
    assert_order(order, solver, steps, lambda **options: with_fields(
        [5 * SECOND], body, start, logs, wheels=TorqueLog([0], [[0.02, 0.01, -0.03]]), **options))


# The same bits


def scene(seed, rotors=True):
    """Return the body, start, logs, motor torques and times of a motion under all torques."""
    random = np.random.default_rng(seed)
    stamps = np.arange(40) * SECOND // 20
    logs = [TorqueLog(stamps, 0.3 * random.normal(size=(40, 3))),
            TorqueLog(stamps[::3] + 12_345, 0.3 * random.normal(size=(14, 3)), 'space')]
    wheels = TorqueLog(stamps[::2] + 777, 0.1 * random.normal(size=(20, 3)))
    start = State(0, random.normal(size=4), random.normal(size=3), rotors * np.array(ROTORS))
    body = RigidBody(FULL.inertia, np.diag([0.01, 0.02, 0.03]) if rotors else None)
    at = np.concatenate([random.integers(0, 3 * SECOND, 30), stamps[1::10]])
    return body, start, logs, wheels if rotors else TorqueLog([], []), at


#: Solvers, whether they accept rotors, and their longest step, s.
ALL_SOLVERS = [('auto', True, None), ('taylor', True, 0.04), ('rk4', True, 0.01),
               ('explicit_euler', True, 0.01), ('strang', False, 0.01)]


@pytest.mark.slow
@pytest.mark.parametrize(('solver', 'rotors', 'max_step'), ALL_SOLVERS)
@pytest.mark.parametrize('timeout', [0.0, 0.07])
def test_any_order_of_arrival_gives_the_bits_of_the_whole_log(solver, rotors, max_step, timeout):
    random = np.random.default_rng(36)
    body, start, logs, wheels, at = scene(1, rotors)
    options = {'solver': solver, 'max_step': max_step, 'torque_timeout': timeout,
               'fields': FIELDS}
    whole = propagate(body, start, logs, at=at, wheels=wheels, **options)
    samples = terms.arrivals(logs, wheels)
    for _ in range(3):
        propagator = Propagator(body, start, history=10.0, **options)
        for number in random.permutation(len(samples)).tolist():
            assert terms.apply(propagator, samples[number])
            if number % 5 == 0:
                propagator.at(int(random.integers(0, 3 * SECOND)))  # changes no bit
        found = [propagator.at(time_ns) for time_ns in at.tolist()]
        np.testing.assert_array_equal(terms.numbers(whole), [
            np.hstack([state.attitude, state.angular_velocity, state.rotor_momentum])
            for state in found])


@pytest.mark.parametrize(('solver', 'rotors', 'max_step'), ALL_SOLVERS)
def test_a_state_restarts_with_the_same_bits(solver, rotors, max_step):
    body, start, logs, wheels, _ = scene(2, rotors)
    options = {'solver': solver, 'max_step': max_step, 'torque_timeout': 0.07}
    problem = Problem(body, start, logs, wheels=wheels, fields=FIELDS, **options)
    propagator = Propagator(body, start, history=10.0, fields=FIELDS, **options)
    for sample in terms.arrivals(logs, wheels):
        terms.apply(propagator, sample)
    middle = propagator.at(1_234_567_891)
    at = np.arange(13, 30) * SECOND // 10
    whole = problem.propagate(at=at)
    # The orbit of the problem keeps the time of the first start; otherwise it would start again.
    for rest in (problem.replaced(start=middle), problem.between(middle, 3 * SECOND),
                 Problem(body, middle, logs, wheels=wheels, fields=problem.fields, **options)):
        np.testing.assert_array_equal(terms.numbers(rest.propagate(at=at)), terms.numbers(whole))
    anew = Problem(body, middle, logs, wheels=wheels, fields=FIELDS, **options)
    assert chord(anew.propagate(at=at).attitude, whole.attitude).max() > 1e-3


def assert_each(found, at, problems):
    """Assert that motions computed together have the same bits as when computed alone."""
    for number, problem in enumerate(problems):
        alone = problem.propagate(at=at)
        np.testing.assert_array_equal(found.attitude[number], alone.attitude)
        np.testing.assert_array_equal(found.angular_velocity[number], alone.angular_velocity)


@pytest.mark.slow
@pytest.mark.parametrize('own', [False, True], ids=['fields of all', 'fields of each'])
@pytest.mark.parametrize('logs', ['no log', 'one log', 'two logs', 'a log of each'])
@pytest.mark.parametrize(('solver', 'rotors', 'max_step'), ALL_SOLVERS)
def test_many_motions_have_the_bits_of_single_ones(solver, rotors, max_step, logs, own):
    # Nine motions, more than share a step without fields, with two different start times.
    scenes = [scene(seed, rotors and seed % 3 > 0) for seed in range(9)]
    bodies, starts = [one[0] for one in scenes], [
        State(-SECOND // 3 * (seed % 2), one[1].attitude, one[1].angular_velocity,
              one[1].rotor_momentum) for seed, one in enumerate(scenes)]
    given = {'no log': [[]] * 9, 'one log': [scenes[1][2][:1]] * 9,
             'two logs': [scenes[1][2]] * 9, 'a log of each': [one[2][:1] for one in scenes]}[logs]
    wheels, at = scenes[1][3], scenes[1][4]
    of_each = [FIELDS] * 9
    if own:
        of_each = [[UniformField((0.1, -0.02 * k, 0.3), (0.4, -0.2, -2.5)), DIPOLE,
                    GravityGradient(0.4 + 0.01 * k)][k % 2:] for k in range(9)]
    options = {'solver': solver, 'max_step': max_step}
    found = propagate_many(
        RigidBodies([body.inertia for body in bodies], [body.damping for body in bodies]),
        States(np.array([start.time_ns for start in starts]),
               [start.attitude for start in starts],
               [start.angular_velocity for start in starts],
               [start.rotor_momentum for start in starts]),
        given, at=at, wheels=wheels, fields=of_each if own else FIELDS, **options)
    assert_each(found, at, [
        Problem(body, start, log, wheels=wheels, fields=fields_of, **options)
        for body, start, log, fields_of in zip(bodies, starts, given, of_each)])


def test_gains_of_a_log_leave_the_fields_as_they_are():
    gains = np.array([0.0, 0.5, 1.7])
    log, at = scene(3)[2][0], np.arange(1, 4) * SECOND
    found = propagate_many(RigidBodies([FULL.inertia] * 3),
                           States(0, [START.attitude] * 3, [START.angular_velocity] * 3),
                           log, at=at, fields=FIELDS, torque_gains=gains)
    assert_each(found, at, [Problem(FULL, START, log.with_torques(gain * log.torques),
                                    fields=FIELDS) for gain in gains])


@pytest.mark.slow
def test_directions_and_sums_have_the_same_bits_on_every_processor():
    # The order of operations in BLAS, and its use of fused products, depend on the processor.
    script = """
import numpy as np
from rigid_body_ros import GravityGradient, Problem, RigidBody, State, UniformField
random = np.random.default_rng(1)
for _ in range(300):
    a, b = random.normal(size=(2, 3))
    orbit = GravityGradient(1.0, a, np.cross(a, b))
    many = [UniformField(*random.normal(size=(2, 3))) for _ in range(5)]
    problem = Problem(RigidBody(np.eye(3)), State(), fields=[orbit, *many])
    at = np.arange(5)
    attitude = np.eye(4)[[3] * 5]
    print(problem._fields.tobytes().hex(), problem.torque(at, attitude).tobytes().hex(),
          *(one.potential_energy(problem.body, at, attitude).tobytes().hex()
            for one in problem.fields))
"""
    outputs = {subprocess.run([sys.executable, '-c', script], check=True, capture_output=True,
                              env={**os.environ, 'OPENBLAS_CORETYPE': name}).stdout
               for name in ('Prescott', 'Nehalem', 'Haswell')}
    assert len(outputs) == 1


# The physics of several fields, and of none


FINE = np.arange(501) * SECOND // 50


def assert_close(one, other):
    """Assert that two problems have the same motion, up to rounding as the motion magnifies it."""
    motion, found = (problem.propagate(at=FINE) for problem in (one, other))
    limits = terms.bound(motion) * fields.magnification(
        lambda start, at: one.replaced(start=start).propagate(at=at), one.start, FINE)
    speed = np.linalg.norm(motion.angular_velocity, axis=1).max()
    apart = np.linalg.norm(motion.angular_velocity - found.angular_velocity, axis=1)
    assert np.all(chord(motion.attitude, found.attitude) <= limits)
    assert np.all(apart <= limits * speed)


def under(given, solver='auto', body=FULL):
    """Return the problem of a body under fields; a fixed-step solver takes steps of 0.1 s."""
    return Problem(body, START, fields=given, solver=solver,
                   max_step=0.1 if solver in LADDERS else None)


@pytest.mark.parametrize('solver', ['taylor', *LADDERS])
@pytest.mark.parametrize('orbit', [[], [ORBIT]])
def test_more_than_three_uniform_fields_add_up(solver, orbit):
    # Divide two fields into parts, exactly, because the fractions are powers of two.
    parts = [UniformField(np.multiply(one.moment, share), one.field)
             for one in (WEIGHT, DIPOLE) for share in (0.5, 0.25, 0.25)]
    taken = UniformField(-0.5 * np.asarray(DIPOLE.moment), DIPOLE.field)
    two = under([*orbit, WEIGHT, DIPOLE], solver)
    for several in (parts, parts[::-1], [*parts[:4], DIPOLE, taken]):
        assert_close(two, under([*several, *orbit], solver))


def test_fields_along_the_axes_are_those_of_any_direction():
    # m x R^T f is linear in the matrix f m^T, which has nine entries.
    matrix = np.outer(WEIGHT.field, WEIGHT.moment) + np.outer(DIPOLE.field, DIPOLE.moment)
    axes, two = np.eye(3), under([WEIGHT, DIPOLE])
    assert_close(two, under([UniformField(row, axis) for row, axis in zip(matrix, axes)]))
    assert_close(two, under([UniformField(matrix[i, j] * axes[j], axes[i])
                             for i in range(3) for j in range(3)]))


@pytest.mark.parametrize('nothing', [
    [UniformField((0.0, 0.0, 0.0), (0.0, 0.0, -9.81))],
    [UniformField((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))],
    [UniformField((0.1, 0.2, 0.3), (1.0, 2.0, 3.0)),
     UniformField((-0.1, -0.2, -0.3), (1.0, 2.0, 3.0))]],
    ids=['no moment', 'no field', 'opposite moments'])
@pytest.mark.parametrize('solver', ['auto', 'taylor', *LADDERS])
def test_fields_without_torque_leave_the_free_motion(solver, nothing):
    assert_close(under([], solver), under(nothing, solver))


def test_a_sphere_feels_no_gravity_gradient():
    body = RigidBody(2.0 * np.eye(3))
    assert_close(under([], body=body), under([ORBIT], body=body))


#: The coefficients of a finite difference of order eight.
WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


@pytest.mark.parametrize('given', [WEIGHT, GravityGradient(
    ORBIT.mean_motion, ORBIT.position, ORBIT.normal, 0)], ids=['uniform', 'gradient'])
def test_a_torque_is_the_slope_of_its_potential(given):
    at, attitude = np.full(9, SECOND), START.attitude
    torque = given.torque(FULL, at[:1], attitude[None])[0]
    slopes = [WEIGHTS @ given.potential_energy(FULL, at, so3.multiply(
        attitude, so3.exp(0.01 * np.outer(np.arange(-4, 5), axis)))) / 0.01 for axis in np.eye(3)]
    assert np.linalg.norm(torque + slopes) < 1e-12 * np.linalg.norm(torque)


@pytest.mark.parametrize('given', [[WEIGHT], [ORBIT], FIELDS],
                         ids=['uniform', 'gradient', 'all'])
def test_the_momentum_changes_at_the_rate_of_the_torque(given):
    # Compare d(R J w)/dt with the torque that the problem returns.
    problem = Problem(FULL, START, fields=given)
    motion = problem.propagate(at=SECOND + SECOND // 100 * np.arange(-4, 5))
    rate = WEIGHTS @ motion.angular_momentum_space * 100
    torque = so3.rotate(motion.attitude[4], problem.torque(
        motion.times_ns[4:5], motion.attitude[4:5])[0])
    assert np.linalg.norm(rate - torque) < 1e-11 * np.linalg.norm(torque)


# The time of an orbit


@pytest.mark.parametrize('solver', ['taylor', 'rk4'])
def test_an_orbit_without_a_time_begins_with_the_motion(solver):
    options = {'solver': solver, 'max_step': 0.05}
    bits = []
    for shift in (0, 5 * SECOND, EPOCH_NS):
        start = State(shift, START.attitude, START.angular_velocity)
        for time_ns in (None, shift):
            orbit = GravityGradient(ORBIT.mean_motion, ORBIT.position, ORBIT.normal, time_ns)
            problem = Problem(FULL, start, fields=[orbit], **options)
            assert problem.fields[0].time_ns == shift
            bits.append(terms.numbers(problem.propagate(at=FINE + shift)))
    for other in bits[1:]:
        np.testing.assert_array_equal(other, bits[0])


def test_an_orbit_made_of_the_directions_of_another_is_the_same():
    random = np.random.default_rng(4)
    for position, other in random.normal(size=(200, 2, 3)):
        one = GravityGradient(0.4, position, np.cross(position, other), 0)
        again = GravityGradient(0.4, one.position, one.normal, 0)
        for name in ('position', 'normal', 'along'):
            found, expected = getattr(again, name), getattr(one, name)
            np.testing.assert_array_equal(found, expected)
            assert abs(float(np.linalg.norm(found)) - 1.0) < 1e-15
        # `Problem` copies an orbit to give it a time.
        without = Problem(FULL, START, fields=[GravityGradient(0.4, position, one.normal)])
        assert without._fields.tobytes() == Problem(FULL, START, fields=[one])._fields.tobytes()


@pytest.mark.parametrize('time_ns', [-7 * SECOND, 7 * SECOND, 123_456_789])
def test_an_orbit_with_a_time_has_its_position_then(time_ns):
    # The same orbit, given where it is at the start.
    angle = -ORBIT.mean_motion * time_ns / SECOND
    position = np.cos(angle) * np.asarray(ORBIT.position) + np.sin(angle) * ORBIT.along
    there = GravityGradient(ORBIT.mean_motion, position, ORBIT.normal)
    timed = GravityGradient(ORBIT.mean_motion, ORBIT.position, ORBIT.normal, time_ns)
    assert_close(under([there]), under([timed]))


def test_the_body_goes_round_the_planet_about_the_normal():
    orbit = GravityGradient(np.pi / 2.0, (2.0, 0.0, 0.0), (0.0, 0.0, 3.0), 0)
    np.testing.assert_allclose(orbit.directions(np.array([0, SECOND, 2 * SECOND])),
                               [[1, 0, 0], [0, 1, 0], [-1, 0, 0]], atol=1e-15)
    # A rod tilted slightly ahead of the vertical is pulled back, about minus the normal.
    rod = RigidBody.from_moments(1.0, 10.0, 10.0)
    ahead = so3.exp([[0.0, 0.0, 0.1]])
    torque = Problem(rod, State(0, ahead[0]), fields=[orbit]).torque(np.array([0]), ahead)[0]
    expected = -3.0 * (np.pi / 2.0) ** 2 * 9.0 * np.sin(0.1) * np.cos(0.1)
    np.testing.assert_allclose(torque, [0.0, 0.0, expected], atol=1e-13)


@pytest.mark.parametrize('rate', [1.1e-3, 7.3, 1e-200])
def test_directions_after_many_turns_are_as_exact_as_before(rate, fifty_digits):
    orbit = GravityGradient(rate, (1.0, 2.0, 3.0), (3.0, 0.0, -1.0), -SECOND // 3)
    times_ns = np.array([-10 ** 17 - 1, -1, 0, 123_456_789, 10 ** 13 + 1, 10 ** 17 + 7])
    for time_ns, found in zip(times_ns.tolist(), orbit.directions(times_ns)):
        angle = mp.mpf(rate) * (time_ns - orbit.time_ns) / SECOND
        expected = (mp.cos(angle) * truth.exact(orbit.position)
                    + mp.sin(angle) * truth.exact(orbit.along))
        assert np.linalg.norm((expected - found).astype(float)) < 1e-15 * max(1.0, rate)


def test_a_weight_above_the_pivot_falls():
    problem = Problem(FULL, State(0), fields=[UniformField((0.0, 0.0, 2.0), (0.0, 0.0, -9.0))])
    tilted = so3.exp([[0.1, 0.0, 0.0]])
    torque = problem.torque(np.array([0]), tilted)[0]
    np.testing.assert_allclose(torque, [18.0 * np.sin(0.1), 0.0, 0.0], rtol=1e-15, atol=1e-15)
    energy = problem.fields[0].potential_energy(FULL, np.array([0]), tilted)
    np.testing.assert_allclose(energy, [18.0 * np.cos(0.1)], rtol=1e-15)


# What is rejected


THREE = 'expected 3 finite numbers, found'
WRONG = [
    (lambda: UniformField((0.0, np.nan, 0.0), (0, 0, 1)),
     rf'moment of a field: {THREE} \[0.0, nan, 0.0\]'),
    (lambda: UniformField((0.0, 1.0), (0, 0, 1)), rf'moment of a field: {THREE} \[0.0, 1.0\]'),
    (lambda: UniformField((0, 0, 1), (0.0, np.inf, 0.0)),
     rf'field of a field: {THREE} \[0.0, inf, 0.0\]'),
    (lambda: UniformField((0, 0, 1), 9.81), rf'field of a field: {THREE} 9.81'),
    (lambda: GravityGradient(0.0),
     'mean motion of an orbit: expected rad/s greater than zero, found 0.0'),
    (lambda: GravityGradient(-1e-3),
     'mean motion of an orbit: expected rad/s greater than zero, found -0.001'),
    (lambda: GravityGradient(np.nan),
     'mean motion of an orbit: expected rad/s greater than zero, found nan'),
    (lambda: GravityGradient(np.inf),
     'mean motion of an orbit: expected rad/s greater than zero, found inf'),
    (lambda: GravityGradient(1.0, (0, 0, 0)),
     'position of an orbit: expected a direction, found zeros'),
    (lambda: GravityGradient(1.0, (1, 0, 0), (0, 0, 0)),
     'normal of an orbit: expected a direction, found zeros'),
    (lambda: GravityGradient(1.0, (1, np.inf, 0)),
     rf'position of an orbit: {THREE} \[1.0, inf, 0.0\]'),
    (lambda: GravityGradient(1.0, (1, 0, 0), (0, 1)),
     rf'normal of an orbit: {THREE} \[0.0, 1.0\]'),
    (lambda: GravityGradient(1.0, (1, 0, 0), (1, 0, 1)),
     'position and normal of an orbit: expected directions at right angles, found a cosine of '
     '0.707'),
    (lambda: GravityGradient(1.0, (1, 0, 0), (-1e-8, 0, 1)),
     'position and normal of an orbit: expected directions at right angles, found a cosine of '
     '-1e-08'),
    (lambda: GravityGradient(1.0, time_ns=2 ** 63), r'.*9223372036854775808.*'),
]


@pytest.mark.parametrize(('make', 'message'), WRONG)
def test_an_impossible_field_is_rejected(make, message):
    with pytest.raises(ValueError, match=f'^{message}$'):
        make()


def test_directions_of_any_length_are_accepted():
    for size in (5e-324, 1e-200, 1.0, 1e200, 1.7e308):
        orbit = GravityGradient(1.0, (size, 0.0, 0.0), (0.0, size, 0.0))
        np.testing.assert_array_equal(orbit.along, [0.0, 0.0, -1.0])
    # Directions with ten digits, as a user writes them, are at right angles.
    GravityGradient(1.0, (0.6, 0.8, 0.0), (-0.8, 0.6, 5e-10))


BOTH_ORBITS = [ORBIT, WEIGHT, GravityGradient(1.0)]
ONE_BODY, ONE_START = RigidBodies([FULL.inertia]), States(0, [START.attitude], [(0.0, 0.0, 1.0)])


@pytest.mark.parametrize('run', [
    lambda **options: propagate(FULL, START, at=[1], **options),
    lambda **options: Problem(FULL, START, **options),
    lambda **options: Propagator(FULL, START, **options),
    lambda **options: propagate_many(ONE_BODY, ONE_START, at=[1], **options)])
def test_what_a_motion_does_not_take_is_rejected(run):
    two = '^fields: expected at most one gravity gradient, found 2$'
    with pytest.raises(ValueError, match=two):
        run(fields=BOTH_ORBITS)
    closed = "^solver 'exact' handles torque-free motion only, found fields$"
    with pytest.raises(ValueError, match=closed):
        run(fields=[UniformField((0, 0, 0), (0, 0, 1))], solver='exact')


def test_replaced_fields_are_checked():
    problem = Problem(FULL, START, solver='exact')
    with pytest.raises(ValueError, match="^solver 'exact' handles torque-free motion only"):
        problem.replaced(fields=[WEIGHT])
    with pytest.raises(ValueError, match='^fields: expected at most one gravity gradient'):
        Problem(FULL, START).replaced(fields=BOTH_ORBITS)
    assert Problem(FULL, START, fields=FIELDS).replaced(fields=()).fields == ()


@pytest.mark.parametrize(('given', 'message'), [
    ([[WEIGHT]], 'fields: expected 2, one for each body, found 1'),
    ([[WEIGHT], []], 'fields: expected fields for each run or for none, found 1 runs without')])
def test_many_motions_reject_fields_that_some_lack(given, message):
    bodies = RigidBodies([FULL.inertia] * 2)
    starts = States(0, [START.attitude] * 2, [START.angular_velocity] * 2)
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        propagate_many(bodies, starts, at=[1], fields=given)
