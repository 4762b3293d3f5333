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

"""Motions under fields, and by how much motions magnify errors."""

import numpy as np
from rigid_body_ros import GravityGradient, Problem, RigidBody, State, UniformField
from rigid_body_ros.mechanics import so3
from terms import SECOND

#: Change of the start, rad, with which `magnification` measures the sensitivity. The motions stay
#: close even if it is magnified by 1e9, and rounding is at most a ten-thousandth of it.
_CHANGE = 1e-11


def magnification(run, start, times_ns):
    """
    Return by how much a motion magnifies a change of its start, at least 1, by time, shape (m,).

    Each coordinate of the start is changed by 1e-11 in both directions. The coordinates are a
    rotation about each body axis, rad, and each component of the angular velocity, relative to the
    largest rate of the motion. The differences of the changed motions, divided by the differences
    of their starts, form a 6 by 6 matrix for each time. The result is its largest singular value.

    Parameters
    ----------
    run : callable
        Returns the motion from a start at times, ns.
    start : State
        The start that is changed.
    times_ns : array of int, shape (m,)
        The times of the result.

    """
    speed = np.linalg.norm(run(start, times_ns).angular_velocity, axis=1).max()
    columns = []
    for change in _CHANGE * np.eye(6):
        one, other = (run(_moved(start, sign * change, speed), times_ns) for sign in (1.0, -1.0))
        turned = so3.log(so3.multiply(so3.conjugate(other.attitude), one.attitude))
        rates = (one.angular_velocity - other.angular_velocity) / speed
        columns.append(np.hstack([turned, rates]) / (2.0 * _CHANGE))
    return np.maximum(1.0, np.linalg.norm(np.stack(columns, axis=-1), 2, axis=(1, 2)))


def _moved(start, change, speed):
    return State(start.time_ns, so3.multiply(start.attitude, so3.exp(change[:3])),
                 start.angular_velocity + speed * change[3:], start.rotor_momentum)


def under_one_field(name, seed):
    """Return the problem of a top: asymmetric, Lagrange's, or with rotors."""
    random = np.random.default_rng(seed)
    attitude, rates = random.normal(size=4), random.normal(size=3)
    if name == 'Lagrange':
        return Problem(RigidBody.from_moments(0.2, 0.2, 0.1),
                       State(0, attitude, 0.5 * rates + [0.0, 0.0, 10.0]),
                       fields=[UniformField((0.0, 0.0, 0.3), (0.0, 0.0, -9.81))])
    given = [UniformField((0.1, -0.2, 0.3), (0.4, -0.2, -2.5))]
    rotors = (0.0, 0.0, 0.0)
    if name == 'gyrostat':  # with two fields of one direction
        given.append(UniformField((0.3, -0.1, 0.2), (0.8, -0.4, -5.0)))
        rotors = (0.2, 0.4, -0.3)
    return Problem(RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05),
                   State(0, attitude, rates, rotors), fields=given)


def in_orbit(rotors, seed):
    """Return the problem of a satellite with rotors."""
    random = np.random.default_rng(seed)
    return Problem(RigidBody.from_moments(10.0, 12.0, 6.0, 0.2, -0.1, 0.3),
                   State(0, random.normal(size=4), 1e-3 * random.normal(size=3), rotors),
                   fields=[GravityGradient(1.1e-3, (1.0, 2.0, 3.0), (3.0, 0.0, -1.0))])


def turns(problem, count):
    """Return 2001 times, ns, over about this many turns of the body."""
    speed = np.linalg.norm(problem.start.angular_velocity)
    at = np.linspace(0, 100.0 / speed * SECOND, 500).astype(np.int64)
    speed = np.linalg.norm(problem.propagate(at=at).angular_velocity, axis=1).mean()
    return np.linspace(0, 2.0 * np.pi * count / speed * SECOND, 2001).astype(np.int64)
