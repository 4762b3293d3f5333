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

A uniform field f, space axes, exerts the torque m x R^T f on a moment m, body axes. On a circular
orbit of rate n, the gravity gradient exerts 3 n^2 r x J r, where r is the unit vector from the
planet to the body, in body axes (Hughes, "Spacecraft attitude dynamics", 1986). The acceleration
by the gravity gradient is -3 n^2 times the gyroscopic acceleration with r in place of w.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.kernels import elementary, euler_equations, four
from rigid_body_ros.kernels.double_double import DoubleDouble, two_product, two_sum
from rigid_body_ros.kernels.jit import inlined, internal, record
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    Coefficients,
    cross,
    dot,
    of,
    Quaternion,
    scale,
    to_body,
    Vector,
)

#: Largest number of uniform fields in a record. A larger number of fields is replaced by three
#: fields, one along each space axis.
MOST = 3
#: The record of the fields of a scene. For uniform fields, the record contains their number, their
#: moments and their fields. For an orbit, it contains the rate, rad/s (0 without an orbit), the
#: unit vectors from the planet to the body and along the orbit, space axes, at a time, and this
#: time, ns.
FIELDS = record([
    ('count', np.int64), ('moments', np.float64, 3 * MOST), ('fields', np.float64, 3 * MOST),
    ('mean_motion', np.float64), ('position', np.float64, 3), ('along', np.float64, 3),
    ('time_ns', np.int64)])


@inlined
def exist(fields: Any) -> bool:
    """Return whether fields, or other terms that may be None, exist in a scene."""
    if fields is None:  # noqa: SIM103 (the compiler resolves this by type)
        return False
    return True


@inlined
def act(fields: NDArray[Any] | None) -> bool:
    """Return whether fields act; with lags, even a scene without fields has a record of fields."""
    if fields is None:
        return False
    return fields[0].count > 0 or fields[0].mean_motion != 0.0


@inlined
def moment(fields: NDArray[Any], i: int) -> Vector:
    """Return the moment of a uniform field in body axes."""
    return _vector(fields[0].moments, 3 * i)


@inlined
def field(fields: NDArray[Any], i: int) -> Vector:
    """Return a uniform field in space axes."""
    return _vector(fields[0].fields, 3 * i)


@inlined
def _vector(values: Any, start: int) -> Vector:
    return of(values[start], values[start + 1], values[start + 2])


@inlined
def angle_at(fields: NDArray[Any] | None, time_ns: int) -> DoubleDouble:
    """
    Return the angle, rad, by which the orbit has turned since the time of the given position.

    After many turns, the error of a rounded angle would shift the orbit differently in each step,
    and the energy of the body would grow.
    """
    if fields is None:
        return 0.0, 0.0
    past_ns = time_ns - fields[0].time_ns
    seconds = past_ns // 1_000_000_000
    high, low = two_product(fields[0].mean_motion, float(seconds))
    return turned_on((high, low), fields[0].mean_motion,
                     (past_ns - seconds * 1_000_000_000) / 1e9)


@inlined
def turned_on(angle: DoubleDouble, rate: float, seconds: float) -> DoubleDouble:
    """Return the angle after a time, s, that is so short that the turn may be rounded."""
    high, low = two_sum(angle[0], rate * seconds)
    return high, low + angle[1]


@internal
def orbit_at(fields: NDArray[Any], angle: DoubleDouble) -> tuple[Vector, Vector]:
    """Return the unit vectors to the body and along the orbit, space axes; see `angle_at`."""
    high, low = angle
    sine, cosine = elementary.sine_cosine(high)
    sine, cosine = fma(low, cosine, sine), fma(-low, sine, cosine)
    position, along = _vector(fields[0].position, 0), _vector(fields[0].along, 0)
    return (add_scaled(scale(cosine, position), sine, along),
            add_scaled(scale(cosine, along), -sine, position))


@inlined
def rate_bound(fields: NDArray[Any] | None) -> float:
    """Return the rate, rad/s, at which the gravity gradient turns in space."""
    if fields is None:
        return 0.0
    return float(fields[0].mean_motion)


@inlined
def acceleration_bound(fields: NDArray[Any] | None, coefficients: Coefficients) -> float:
    """Return a bound on the acceleration by fields, rad/s^2, in any attitude."""
    if fields is None:
        return 0.0
    torque = norm = 0.0
    for i in range(fields[0].count):
        a, b = moment(fields, i), field(fields, i)
        torque += math.sqrt(dot(a, a) * dot(b, b))
    for column in coefficients[0][6:]:
        norm += dot(column, column)
    # The gyroscopic acceleration of a unit vector is less than 1.
    return math.sqrt(norm) * torque + 3.0 * fields[0].mean_motion * fields[0].mean_motion


@internal
def acceleration(fields: NDArray[Any], angle: DoubleDouble, q: Quaternion,
                 coefficients: Coefficients) -> Vector:
    """Return the acceleration by fields, rad/s^2, body axes; see `angle_at`."""
    # The solvers with fixed steps, which use this function, treat all tensors as full.
    full = Coefficients(coefficients.columns, coefficients.low, coefficients.main,
                        coefficients.diagonal, euler_equations.FULL)
    torque = four.broadcast(0.0)
    for i in range(fields[0].count):
        torque = add(torque, cross(moment(fields, i), to_body(q, field(fields, i))))
    total = euler_equations.acceleration_from_torque(full, torque)
    rate = fields[0].mean_motion
    if rate == 0.0:
        return total
    r = to_body(q, orbit_at(fields, angle)[0])
    return add_scaled(total, -3.0 * rate * rate, euler_equations.gyroscopic_acceleration(
        full, euler_equations.products(r, r)))
