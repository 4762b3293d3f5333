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
The Taylor series of torques that depend on the attitude, see `fields`.

A uniform field is fixed in space, so its body components obey v' = v x w. On a circular orbit the
unit vectors to the body, r, and along the orbit, s, turn at the rate n in space: r' = r x w + n s
and s' = s x w - n r. All are linear, so the series need no products of the attitude.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import euler_equations, fields, four
from rigid_body_ros.kernels.euler_equations import Products
from rigid_body_ros.kernels.jit import inlined, internal, optional, scratch
from rigid_body_ros.kernels.series_table import (
    load_permuted,
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    store_permuted,
    turned,
)
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    Coefficients,
    cross,
    dot,
    KernelState,
    to_body,
    Vector,
)

#: Layout of the vectors of one order: the uniform fields, the unit vector to the body and that
#: along the orbit, each in its three permutations.
_POSITION, _ALONG = PERMUTED * fields.MOST, PERMUTED * (fields.MOST + 1)
_ORDER = PERMUTED * (fields.MOST + 2)
_WORKSPACE = _ORDER * (MAX_ORDER + 1)


class StepFields(NamedTuple):
    """The fields of a step, and the series of their vectors."""

    #: Of fields.FIELDS, shape (1,).
    fields: NDArray[Any]
    #: Time of the beginning of the step, see `fields.seconds_at`.
    seconds: float
    #: The terms of the vectors.
    vectors: Floats


@optional
def of_step(found: NDArray[Any], seconds: float) -> StepFields:
    """Return the fields of a step, with series that are not yet filled; None without fields."""
    return StepFields(found, seconds, scratch(_WORKSPACE))


@inlined
def begin(step: StepFields | None, state: KernelState, coefficients: Coefficients) -> float:
    """
    Store the vectors at the beginning of a step.

    Parameters
    ----------
    step : StepFields or None
        Its vectors are changed.
    state : KernelState
        At the beginning.
    coefficients : Coefficients
        Of Euler's equations.

    Returns
    -------
    float
        The acceleration by the fields there, rad/s^2.

    """
    if step is None:
        return 0.0
    found, seconds, vectors = step
    q = state[1]
    for i in range(found[0].count):
        store_permuted(vectors, PERMUTED * i, to_body(q, fields.field(found, i)))
    if found[0].mean_motion != 0.0:
        position, along = fields.orbit_at(found, seconds)
        store_permuted(vectors, _POSITION, to_body(q, position))
        store_permuted(vectors, _ALONG, to_body(q, along))
    total = fields.acceleration(found, seconds, q, coefficients)
    return math.sqrt(dot(total, total))


@inlined
def add_acceleration(u: Vector, step: StepFields | None, table: Floats, k: int, seconds: float,
                     coefficients: Coefficients, form: int) -> Vector:
    """
    Return the sum of a vector and the term of order k of the acceleration.

    Parameters
    ----------
    u : Vector
        The sum of other terms, radians per step.
    step : StepFields or None
        The terms of order k + 1 are added to its vectors.
    table : array
        The terms of the step up to order k, see `series_table`.
    k : int
        The order.
    seconds : float
        Length of the step.
    coefficients, form : Coefficients, int
        Of Euler's equations, and the form of the inertia tensor.

    """
    if step is None:
        return u
    found, _, vectors = step
    torque = four.broadcast(0.0)
    for i in range(found[0].count):
        torque = add(torque, cross(fields.moment(found, i),
                                   four.load(vectors, _ORDER * k + PERMUTED * i)))
        _store(vectors, PERMUTED * i, k, turned(vectors, PERMUTED * i, _ORDER, table, k))
    square, rate = seconds * seconds, found[0].mean_motion
    u = add_scaled(u, square, euler_equations.acceleration_from_torque(
        coefficients, form, torque))
    if rate != 0.0:
        gradient = euler_equations.gyroscopic_acceleration(
            coefficients, form, _squares(vectors, k))
        u = add_scaled(u, -3.0 * (rate * rate) * square, gradient)
        _expand_orbit(vectors, rate * seconds, table, k)
    return u


@internal
def _squares(vectors: Floats, k: int) -> Products:
    # Return the term of order k of the products of the components of r.
    one = other = four.broadcast(0.0)
    for j in range(k + 1):
        r, yzx, _ = load_permuted(vectors, _ORDER * j + _POSITION)
        s, _, zxy = load_permuted(vectors, _ORDER * (k - j) + _POSITION)
        one, other = four.fma(yzx, zxy, one), four.fma(r, s, other)
    return one, other


@internal
def _expand_orbit(vectors: Floats, angle: float, table: Floats, k: int) -> None:
    # The angle is that by which the orbit turns in a step.
    position, along = (four.load(vectors, _ORDER * k + _POSITION),
                       four.load(vectors, _ORDER * k + _ALONG))
    factor = angle * float(RECIPROCALS[k])
    _store(vectors, _POSITION, k, add_scaled(
        turned(vectors, _POSITION, _ORDER, table, k), factor, along))
    _store(vectors, _ALONG, k, add_scaled(
        turned(vectors, _ALONG, _ORDER, table, k), -factor, position))


@inlined
def _store(vectors: Floats, place: int, k: int, value: Vector) -> None:
    store_permuted(vectors, _ORDER * (k + 1) + place, value)
