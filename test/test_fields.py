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

"""Torques that depend on the attitude: known motions, conserved quantities, and directions."""

from dataclasses import replace
import re

from conftest import bound, chord, EPOCH_NS
from mpmath import mp
import numpy as np
from parts import BODY, FIELDS, START
import pytest
from rigid_body_ros import GravityGradient, Problem, RigidBody, State, UniformField
from rigid_body_ros.mechanics import so3
from rigid_body_ros.replay import check as replay_check
import terms
from terms import SECOND
from test_steppers import LADDERS
import truth

WEIGHT, ORBIT, DIPOLE = FIELDS


# What is conserved


RANDOM = np.random.default_rng(0)
THROWN = State(0, RANDOM.normal(size=4), RANDOM.normal(size=3))
ROTORS = np.array([0.2, 0.4, -0.3])
SLOW = replace(START, angular_velocity=1e-3 * START.angular_velocity)
REVOLUTION = GravityGradient(1.1e-3, (1.0, 2.0, 3.0), (3.0, 0.0, -1.0))
#: Problems with constants of motion; the fields of the gyrostat have one direction.
CONSERVATIVE = {
    'asymmetric top': Problem(BODY, THROWN, fields=[WEIGHT]),
    'Lagrange': Problem(RigidBody.from_moments(0.2, 0.2, 0.1), replace(
        THROWN, angular_velocity=0.5 * THROWN.angular_velocity + [0.0, 0.0, 10.0]), fields=[
            UniformField((0.0, 0.0, 0.3), (0.0, 0.0, -9.81))]),
    'gyrostat': Problem(BODY, replace(THROWN, rotor_momentum=ROTORS), fields=[
        WEIGHT, UniformField((0.3, -0.1, 0.2), (0.8, -0.4, -5.0))]),
    'satellite': Problem(BODY, SLOW, fields=[REVOLUTION]),
    'satellite with a wheel': Problem(BODY, replace(SLOW, rotor_momentum=2e-3 * ROTORS),
                                      fields=[REVOLUTION])}


@pytest.mark.slow
@pytest.mark.parametrize('problem', CONSERVATIVE.values(), ids=[*CONSERVATIVE])
def test_constants_of_motion_do_not_drift_over_ten_thousand_turns(problem):
    seconds = 100.0 / np.linalg.norm(problem.start.angular_velocity)
    early = problem.propagate(at=np.linspace(0, seconds * SECOND, 500).astype(np.int64))
    seconds = 2e4 * np.pi / np.linalg.norm(early.angular_velocity, axis=1).mean()
    motion = problem.propagate(at=np.linspace(0, seconds * SECOND, 2001).astype(np.int64))
    constants = drifts(problem, motion)
    assert len(constants) == (1 if isinstance(problem.fields[0], GravityGradient) else 2)
    assert max(constants) < 1e-13
    # Of another body, the energy and Jacobi's integral would not be constant.
    other = RigidBody(problem.body.inertia * np.where(np.eye(3), [1.001, 1.0, 1.0], 1.0))
    assert drifts(problem.replaced(body=other), motion)[0] > 1e-6


def drifts(problem, motion):
    """Return the relative drifts of the energy or Jacobi's integral, and of the momentum."""
    return [float(drift) for drift in re.findall(
        r'\d[.]\de[-+]\d+', replay_check.drift(problem, motion).finding)]


# The physics of several fields, and of none


FINE = np.arange(201) * SECOND // 20


def assert_close(one, other):
    """Assert that two problems have the same motion, up to rounding as the motion magnifies it."""
    motion, found = (problem.propagate(at=FINE) for problem in (one, other))
    limits = bound(motion) * terms.magnification(
        lambda start, at: one.replaced(start=start).propagate(at=at), one.start, FINE)
    speed = np.linalg.norm(motion.angular_velocity, axis=1).max()
    apart = np.linalg.norm(motion.angular_velocity - found.angular_velocity, axis=1)
    assert np.all(chord(motion.attitude, found.attitude) <= limits)
    assert np.all(apart <= limits * speed)


def under(given, solver='auto', body=BODY):
    """Return the problem of a body under fields; a fixed-step solver takes steps of 0.1 s."""
    return Problem(body, START, fields=given, solver=solver,
                   max_step=0.1 if solver in LADDERS else None)


@pytest.mark.parametrize(('solver', 'orbit'), [
    ('taylor', []), ('taylor', [ORBIT]), ('rk4', [ORBIT]), ('strang', []),
    ('explicit_euler', [ORBIT])])
def test_more_than_three_uniform_fields_add_up(solver, orbit):
    # Divide two fields into parts, exactly, because the fractions are powers of two.
    parts = [UniformField(np.multiply(one.moment, share), one.field)
             for one in (WEIGHT, DIPOLE) for share in (0.5, 0.25, 0.25)]
    taken = UniformField(-0.5 * np.asarray(DIPOLE.moment), DIPOLE.field)
    two = under([*orbit, WEIGHT, DIPOLE], solver)
    for several in (parts, parts[::-1], [*parts[:4], DIPOLE, taken]):
        assert_close(two, under([*several, *orbit], solver))


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


# The time of an orbit


@pytest.mark.parametrize('solver', ['taylor', 'rk4'])
def test_an_orbit_without_a_time_begins_with_the_motion(solver):
    options = {'solver': solver, 'max_step': 0.05}
    bits = []
    for shift in (0, 5 * SECOND, EPOCH_NS):
        start = State(shift, START.attitude, START.angular_velocity)
        for time_ns in (None, shift):
            orbit = GravityGradient(ORBIT.mean_motion, ORBIT.position, ORBIT.normal, time_ns)
            problem = Problem(BODY, start, fields=[orbit], **options)
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
        without = Problem(BODY, START, fields=[GravityGradient(0.4, position, one.normal)])
        assert without._fields.tobytes() == Problem(BODY, START, fields=[one])._fields.tobytes()


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
                               [[1, 0, 0], [0, 1, 0], [-1, 0, 0]], rtol=0, atol=1e-15)
    # A rod tilted slightly ahead of the vertical is pulled back, about minus the normal.
    rod = RigidBody.from_moments(1.0, 10.0, 10.0)
    ahead = so3.exp([[0.0, 0.0, 0.1]])
    torque = Problem(rod, State(0, ahead[0]), fields=[orbit]).torque(np.array([0]), ahead)[0]
    expected = -3.0 * (np.pi / 2.0) ** 2 * 9.0 * np.sin(0.1) * np.cos(0.1)
    np.testing.assert_allclose(torque, [0.0, 0.0, expected], rtol=0, atol=1e-13)


def test_a_small_swing_in_orbit_has_the_frequency_of_libration():
    n, (radial, along, normal), angle = 0.3, (1.0, 2.0, 2.5), 1e-5
    frequency = n * np.sqrt(3.0 * (along - radial) / normal)  # Hughes, chapter 9
    at = (np.arange(17) * 0.25e9 * np.pi / frequency).astype(np.int64)
    start = State(0, so3.exp([0.0, 0.0, angle]), (0.0, 0.0, n))
    swing = Problem(RigidBody.from_moments(radial, along, normal), start,
                    fields=[GravityGradient(n)]).propagate(at=at)
    vertical = so3.exp(np.outer(n * at / 1e9, [0.0, 0.0, 1.0]))
    np.testing.assert_allclose(so3.difference(vertical, swing.attitude)[:, 2],
                               angle * np.cos(frequency * at / 1e9), rtol=0, atol=2e-14)


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
    problem = Problem(BODY, State(0), fields=[UniformField((0.0, 0.0, 2.0), (0.0, 0.0, -9.0))])
    tilted = so3.exp([[0.1, 0.0, 0.0]])
    torque = problem.torque(np.array([0]), tilted)[0]
    np.testing.assert_allclose(torque, [18.0 * np.sin(0.1), 0.0, 0.0], rtol=1e-15, atol=1e-15)
    energy = problem.fields[0].potential_energy(BODY, np.array([0]), tilted)
    np.testing.assert_allclose(energy, [18.0 * np.cos(0.1)], rtol=1e-15)


def test_directions_of_any_length_are_accepted():
    for size in (5e-324, 1e-200, 1.0, 1e200, 1.7e308):
        orbit = GravityGradient(1.0, (size, 0.0, 0.0), (0.0, size, 0.0))
        np.testing.assert_array_equal(orbit.along, [0.0, 0.0, -1.0])
    # Directions with ten digits, as a user writes them, are at right angles.
    GravityGradient(1.0, (0.6, 0.8, 0.0), (-0.8, 0.6, 5e-10))
