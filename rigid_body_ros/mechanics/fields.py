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

"""
Torques that depend on the attitude: uniform fields and the gravity gradient.

The formulas follow Goldstein, Classical Mechanics, chapter 5 (the heavy top), and Hughes,
Spacecraft Attitude Dynamics, chapters 8 and 9 (the gravity gradient).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instant
from rigid_body_ros.engine import FIELDS, MOST_FIELDS
from rigid_body_ros.engine.elementary import sines_cosines
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody

#: The position on an orbit must be perpendicular to the orbit normal. The cosine of the angle
#: between these two vectors may be at most this value.
_SQUARE = 1e-9
#: A vector whose length differs from 1 by at most this value is used as it is, without normalising
#: it.
_ROUNDED = 4.0 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class UniformField:
    """
    A uniform field, whose torque turns a moment of the body towards the field's direction.

    A field f exerts the torque m x R^T f on a moment m, where R maps body axes to space axes. To
    model the weight of a body on a pivot, let m be the mass times the position of the centre of
    mass relative to the pivot, and let f be gravity. The inertia of the body must then be about
    the pivot. Buoyancy and the torque of a magnetic field (T) on a magnetic dipole (A m^2) have
    the same form.

    Parameters
    ----------
    moment : array, shape (3,), kg m, A m^2, ...
        The moment in body axes.
    field : array, shape (3,), m/s^2, T, ...
        The field in space axes. The units of the moment and the field must multiply to N m.
    name : str
        Name of the field in a scene. Empty if the field has no name.

    Raises
    ------
    ValueError
        The moment or the field does not consist of 3 finite numbers.

    """

    moment: ArrayLike
    field: ArrayLike
    name: str = ''

    def __post_init__(self) -> None:
        for name in ('moment', 'field'):
            object.__setattr__(self, name, _checked(getattr(self, name), f'{name} of a field'))

    def torque(self, body: RigidBody, times_ns: NDArray[np.int64], attitude: Floats) -> Floats:
        """Return the torque in body axes, N m, shape (m, 3), at m times and attitudes."""
        return np.cross(np.asarray(self.moment), so3.rotate(so3.conjugate(attitude), self._rows(
            attitude)))

    def potential_energy(self, body: RigidBody, times_ns: NDArray[np.int64],
                         attitude: Floats) -> Floats:
        """Return the potential energy -m . R^T f, in joules, shape (m,), at m attitudes."""
        turned = so3.rotate(so3.conjugate(attitude), self._rows(attitude))
        return -np.sum(turned * np.asarray(self.moment), axis=1)

    def speed(self, least: Floats, largest: Floats) -> Floats:
        """
        Return an upper bound on how much the field can increase the angular velocity, rad/s.

        The bound follows from the energy: a body with kinetic energy T and smallest moment of
        inertia I has an angular velocity of at most sqrt(2 T / I).

        Parameters
        ----------
        least, largest : array, kg m^2
            The smallest and largest principal moments of the bodies.

        """
        strength = np.linalg.norm(self.moment) * np.linalg.norm(self.field)
        return 2.0 * np.sqrt(strength / least)

    def _rows(self, attitude: Floats) -> Floats:
        return np.broadcast_to(np.asarray(self.field), (len(attitude), 3))


@dataclass(frozen=True, eq=False)
class GravityGradient:
    """
    The gravity-gradient torque on a body in a circular orbit.

    The torque is 3 n^2 r x J r, where n is the mean motion, J is the inertia, and r is the unit
    vector from the planet to the body.

    Parameters
    ----------
    mean_motion : float, rad/s
        The angular rate n of the orbit, greater than zero.
    position, normal : array, shape (3,), space axes
        `position` is the direction from the planet to the body at `time_ns`. `normal` is the orbit
        normal, about which the body revolves. Both vectors may have any nonzero length.
    time_ns : int, optional, ns
        The time at which the body is at `position`. The default is the start of the motion.

    Raises
    ------
    ValueError
        The mean motion is not positive and finite, a direction is zero or not finite, the two
        directions are not perpendicular, or the time does not fit in int64.

    """

    mean_motion: float
    position: ArrayLike = (1.0, 0.0, 0.0)
    normal: ArrayLike = (0.0, 0.0, 1.0)
    time_ns: int | None = None
    #: The direction of motion along the orbit at `time_ns`, as a unit vector in space axes.
    along: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rate = float(self.mean_motion)
        if not 0.0 < rate < np.inf:
            raise ValueError('mean motion of an orbit: expected rad/s greater than zero, '
                             f'found {self.mean_motion}')
        position, normal = (direction(getattr(self, name), f'{name} of an orbit')
                            for name in ('position', 'normal'))
        if not abs(position @ normal) <= _SQUARE:
            raise ValueError('position and normal of an orbit: expected directions at right '
                             f'angles, found a cosine of {position @ normal:.3g}')
        along = direction(np.cross(normal, position), 'direction along an orbit')
        time_ns = None if self.time_ns is None else instant(self.time_ns)
        for name, value in (('mean_motion', rate), ('position', position), ('normal', normal),
                            ('along', along), ('time_ns', time_ns)):
            object.__setattr__(self, name, value)

    def directions(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the unit vectors from the planet to the body in space axes, shape (m, 3)."""
        assert self.time_ns is not None, 'the orbit has no time'
        # Split the mean motion into two parts, such that the product of the first part and whole
        # seconds is exact. Otherwise, after many turns, the rounding error of the orbit angle
        # would exceed that of the attitude.
        mantissa, exponent = math.frexp(self.mean_motion)
        rate = math.ldexp(round(math.ldexp(mantissa, 24)), exponent - 24)
        seconds, rest_ns = np.divmod(times_ns - self.time_ns, 10 ** 9)
        sine, cosine = sines_cosines(rate * seconds)
        rest = (self.mean_motion - rate) * seconds + self.mean_motion * (rest_ns / 1e9)
        more_sine, more_cosine = sines_cosines(rest)
        return ((cosine * more_cosine - sine * more_sine)[:, None] * np.asarray(self.position)
                + (sine * more_cosine + cosine * more_sine)[:, None] * self.along)

    def torque(self, body: RigidBody, times_ns: NDArray[np.int64], attitude: Floats) -> Floats:
        """Return the torque in body axes, N m, shape (m, 3), at m times and attitudes."""
        r = so3.rotate(so3.conjugate(attitude), self.directions(times_ns))
        return 3.0 * self.mean_motion ** 2 * np.cross(r, body.angular_momentum(r))

    def potential_energy(self, body: RigidBody, times_ns: NDArray[np.int64],
                         attitude: Floats) -> Floats:
        """Return the potential energy of the rotation, 3/2 n^2 r . J r, in joules, shape (m,)."""
        r = so3.rotate(so3.conjugate(attitude), self.directions(times_ns))
        return 1.5 * self.mean_motion ** 2 * np.sum(r * body.angular_momentum(r), axis=1)

    def speed(self, least: Floats, largest: Floats) -> Floats:
        """
        Return an upper bound, rad/s, on how much the field can increase the angular velocity.

        Unlike in `UniformField.speed`, the bound follows from the energy in the orbiting frame.
        """
        return self.mean_motion * (1.0 + 3.0 * np.sqrt(largest / least))


Field = UniformField | GravityGradient


def beginning_at(fields: Sequence[Field], time_ns: int) -> tuple[Field, ...]:
    """
    Return the fields of a motion that begins at a given time.

    A gravity gradient without a `time_ns` gets the time at which the motion begins.

    Raises
    ------
    ValueError
        There is more than one gravity gradient.

    """
    orbits = [field for field in fields if isinstance(field, GravityGradient)]
    if len(orbits) > 1:
        raise ValueError(f'fields: expected at most one gravity gradient, found {len(orbits)}')
    return tuple(replace(field, time_ns=time_ns)
                 if isinstance(field, GravityGradient) and field.time_ns is None else field
                 for field in fields)


def packed(fields: Sequence[Field]) -> NDArray[Any] | None:
    """
    Pack fields into the array that the kernels read, with dtype FIELDS and shape (1,).

    If there are no fields, the result is None. A gravity gradient must have a `time_ns`.
    """
    if not fields:
        return None
    result = np.zeros(1, FIELDS)
    uniform = [field for field in fields if isinstance(field, UniformField)]
    moments = np.array([field.moment for field in uniform]).reshape(-1, 3)
    directions = np.array([field.field for field in uniform]).reshape(-1, 3)
    if len(uniform) > MOST_FIELDS:  # use one field per space axis, summed in order
        total = np.zeros((3, 3))
        for moment, direction in zip(moments, directions):
            total = total + direction[:, None] * moment
        moments, directions = total, np.eye(3)
    result['count'] = len(moments)
    result['moments'][0, :moments.size] = moments.ravel()
    result['fields'][0, :moments.size] = directions.ravel()
    for orbit in (each for each in fields if isinstance(each, GravityGradient)):
        for name in ('mean_motion', 'position', 'along', 'time_ns'):
            result[name] = getattr(orbit, name)
    result.flags.writeable = False
    return result


def _checked(values: ArrayLike, what: str) -> Floats:
    vector = np.array(values, float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f'{what}: expected 3 finite numbers, found {vector.tolist()}')
    vector.flags.writeable = False
    return vector


def direction(values: ArrayLike, what: str) -> Floats:
    """
    Return the unit vector along a vector.

    A vector whose length is 1 within rounding is returned unchanged.

    Raises
    ------
    ValueError
        The values are not 3 finite numbers, or are all zero.

    """
    vector = _checked(values, what)
    if abs(_length(vector) - 1.0) <= _ROUNDED:
        return vector
    largest = abs(vector).max()
    if not largest:
        raise ValueError(f'{what}: expected a direction, found zeros')
    vector = vector / largest  # so that squares neither overflow nor underflow
    vector = vector / _length(vector)
    vector.flags.writeable = False
    return vector


def _length(vector: Floats) -> float:
    x, y, z = vector.tolist()  # without BLAS, which sums in an order that depends on the processor
    return math.sqrt(x * x + y * y + z * z)
