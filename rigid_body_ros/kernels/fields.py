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
Attitude-dependent torques: uniform fields and the gravity gradient.

A uniform field f, given in space axes, exerts the torque m x R^T f on a moment m, given in body
axes. On a circular orbit with rate n, the gravity gradient exerts the torque 3 n^2 r x J r
(Hughes, "Spacecraft attitude dynamics", 1986). Here r is the unit vector from the planet to the
body, in body axes. To compute the acceleration due to the gravity gradient, we replace w by r in
the gyroscopic acceleration, and multiply the result by -3 n^2.
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

#: Maximum number of uniform fields in a record. If a scene has more, they are replaced by three
#: equivalent fields, one along each space axis.
MOST = 3
#: Record that describes all fields of a scene. It begins with the number of uniform fields, their
#: moments, and the fields themselves. The rest describes the orbit: the rate in rad/s (0 if there
#: is no orbit), the unit vectors from the planet to the body and along the orbit, in space axes,
#: and the time in ns at which the orbit has these unit vectors.
FIELDS = record([
    ('count', np.int64), ('moments', np.float64, 3 * MOST), ('fields', np.float64, 3 * MOST),
    ('mean_motion', np.float64), ('position', np.float64, 3), ('along', np.float64, 3),
    ('time_ns', np.int64)])


@inlined
def exist(fields: Any) -> bool:
    """
    Return whether a scene contains fields.

    You can also pass any other kind of term that is None if the scene does not contain it.
    """
    if fields is None:  # noqa: SIM103 (the compiler resolves this by type)
        return False
    return True


@inlined
def act(fields: NDArray[Any] | None) -> bool:
    """Return whether any field acts on the body."""
    # A scene with lags always has a record of fields, even if the scene contains no fields.
    if fields is None:
        return False
    return fields[0].count > 0 or fields[0].mean_motion != 0.0


@inlined
def moment(fields: NDArray[Any], i: int) -> Vector:
    """Return the moment of the body, in body axes, on which the uniform field `i` acts."""
    return _vector(fields[0].moments, 3 * i)


@inlined
def field(fields: NDArray[Any], i: int) -> Vector:
    """Return the uniform field `i` in space axes."""
    return _vector(fields[0].fields, 3 * i)


@inlined
def _vector(values: Any, start: int) -> Vector:
    return of(values[start], values[start + 1], values[start + 2])


@inlined
def angle_at(fields: NDArray[Any] | None, time_ns: int) -> DoubleDouble:
    """
    Return the angle in rad by which the orbit has turned since the time stored in `fields`.

    The angle is a double-double. If the angle were rounded to a double, the rounding error after
    many turns would shift the orbit by a different amount in each step, and the energy of the body
    would grow.
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
    """
    Return the orbit angle after `seconds` more seconds.

    The time must be so short that the additional turn can be rounded to a double.
    """
    high, low = two_sum(angle[0], rate * seconds)
    return high, low + angle[1]


@internal
def orbit_at(fields: NDArray[Any], angle: DoubleDouble) -> tuple[Vector, Vector]:
    """
    Return the unit vector to the body and the unit vector along the orbit, in space axes.

    The angle is the orbit angle, as returned by `angle_at`.
    """
    high, low = angle
    sine, cosine = elementary.sine_cosine(high)
    sine, cosine = fma(low, cosine, sine), fma(-low, sine, cosine)
    position, along = _vector(fields[0].position, 0), _vector(fields[0].along, 0)
    return (add_scaled(scale(cosine, position), sine, along),
            add_scaled(scale(cosine, along), -sine, position))


@inlined
def rate_bound(fields: NDArray[Any] | None) -> float:
    """Return the rate in rad/s at which the gravity gradient turns in space."""
    if fields is None:
        return 0.0
    return float(fields[0].mean_motion)


@inlined
def acceleration_bound(fields: NDArray[Any] | None, coefficients: Coefficients) -> float:
    """Return an upper bound in rad/s^2 on the acceleration due to the fields in any attitude."""
    if fields is None:
        return 0.0
    torque = norm = 0.0
    for i in range(fields[0].count):
        a, b = moment(fields, i), field(fields, i)
        torque += math.sqrt(dot(a, a) * dot(b, b))
    for column in coefficients[0][6:]:
        norm += dot(column, column)
    # With a unit vector as the angular velocity, the gyroscopic acceleration is less than 1.
    return math.sqrt(norm) * torque + 3.0 * fields[0].mean_motion * fields[0].mean_motion


@internal
def acceleration(fields: NDArray[Any], angle: DoubleDouble, q: Quaternion,
                 coefficients: Coefficients) -> Vector:
    """
    Return the acceleration due to the fields in rad/s^2, in body axes.

    The angle is the orbit angle, as returned by `angle_at`.
    """
    # Only the fixed-step solvers use this function, and they treat every tensor as full.
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
