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
The Taylor series of torques that depend on the attitude; see `fields`.

A uniform field is fixed in space, so its body components obey v' = v x w. On a circular orbit, the
unit vectors to the body, r, and along the orbit, s, turn in space at the rate n: r' = r x w + n s
and s' = s x w - n r. These equations do not contain the attitude, so the series need no products
with the attitude.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import euler_equations, fields, four
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.euler_equations import Products
from rigid_body_ros.kernels.jit import inlined, internal, optional
from rigid_body_ros.kernels.linear_terms import add_product, from_columns, times_cross
from rigid_body_ros.kernels.series_table import (
    load_permuted,
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    store_permuted,
    turned,
)
from rigid_body_ros.kernels.vector import (
    add_scaled,
    Coefficients,
    cross,
    dot,
    KernelState,
    scale,
    to_body,
    Vector,
)

#: Size of the vectors of one order. The vectors are the uniform fields, the unit vector to the
#: body and the unit vector along the orbit, each in its three permutations.
_ORDER = PERMUTED * (fields.MOST + 2)
#: The vectors of all orders are followed by a matrix for each uniform field.
_MATRICES = _ORDER * (MAX_ORDER + 1)
WORKSPACE = _MATRICES + PERMUTED * fields.MOST
#: The two sums of products whose difference is a vector product.
Turn = tuple[Vector, Vector]


class StepFields(NamedTuple):
    """The fields of a step, and the series of their vectors."""

    #: Array of `fields.FIELDS`, shape (1,).
    fields: NDArray[Any]
    #: Angle of the orbit at the beginning of the step; see `fields.angle_at`.
    angle: DoubleDouble
    #: The terms of the vectors, and the matrices.
    vectors: Floats


@optional
def prepared(found: NDArray[Any], work: Floats, coefficients: Coefficients) -> Floats:
    """
    Store the matrix J^-1 [m]x of each uniform field, which all steps need.

    Parameters
    ----------
    found : array of fields.FIELDS, shape (1,), or None
        The fields of the scene.
    work : float64 (WORKSPACE,)
        The array in which to store the matrices.
    coefficients : Coefficients
        The coefficients of Euler's equations.

    Returns
    -------
    array or None
        The workspace; None without fields.

    """
    a, b, c = coefficients[0][6:]
    inverse = from_columns(a, b, c)
    for i in range(found[0].count):
        x, y, z = times_cross(inverse, fields.moment(found, i))
        four.store(work, _MATRICES + PERMUTED * i, x)
        four.store(work, _MATRICES + PERMUTED * i + 4, y)
        four.store(work, _MATRICES + PERMUTED * i + 8, z)
    return work


@optional
def of_step(found: NDArray[Any], angle: DoubleDouble, work: Floats) -> StepFields:
    """Return the fields of a step, with series not yet filled; None without fields."""
    return StepFields(found, angle, work)


@inlined
def begin(step: StepFields | None, state: KernelState, coefficients: Coefficients) -> float:
    """
    Store the vectors at the beginning of a step.

    Parameters
    ----------
    step : StepFields or None
        The fields. The function fills their vectors.
    state : KernelState
        The state at the beginning of the step.
    coefficients : Coefficients
        The coefficients of Euler's equations.

    Returns
    -------
    float
        The size of the acceleration that the fields cause at the beginning of the step, rad/s^2.

    """
    if step is None:
        return 0.0
    found, angle, vectors = step
    q, total = state[1], four.broadcast(0.0)
    for i in range(found[0].count):
        store_permuted(vectors, PERMUTED * i, to_body(q, fields.field(found, i)))
        total = _add_uniform(total, step, 0, i, 1.0, coefficients)
    if found[0].mean_motion != 0.0:
        position, along = fields.orbit_at(found, angle)
        place = PERMUTED * found[0].count
        store_permuted(vectors, place, to_body(q, position))
        store_permuted(vectors, place + PERMUTED, to_body(q, along))
        total = _add_gradient(total, step, 0, 1.0, coefficients)
    return math.sqrt(dot(total, total))


@optional
def vectors_of(step: StepFields) -> Floats:
    """Return the terms of the vectors; None without fields."""
    return step.vectors


@optional
def no_turn(vectors: Floats) -> Turn:
    """Return zeros, to which `add_turn` adds; None without fields."""
    zero = four.zero(four.load(vectors, 0))
    return zero, zero


@optional
def add_turn(turn: Turn, vectors: Floats, k: int, yzx: Vector, zxy: Vector) -> Turn:
    """
    Add the term of order k of the first vector times a vector that is given in two permutations.

    Inside the loop over the products of the rates, this addition costs nothing, because the
    processor waits for the latest sum anyway. A separate loop would take as long as the loop over
    the products.
    """
    _, v_yzx, v_zxy = load_permuted(vectors, _ORDER * k)
    return four.fma(v_yzx, zxy, turn[0]), four.fma(v_zxy, yzx, turn[1])


@inlined
def store_turn(turn: Turn | None, vectors: Floats, k: int) -> None:
    """Store the term of order k + 1 of the first vector, as `series_table.turned` returns it."""
    if turn is None:
        return
    _store(vectors, 0, k, scale(float(RECIPROCALS[k]), four.subtract(turn[0], turn[1])))


@inlined
def add_acceleration(u: Vector, step: StepFields | None, table: Floats, k: int, seconds: float,
                     coefficients: Coefficients) -> Vector:
    """
    Return a vector plus seconds^2 times the term of order k of the acceleration.

    Parameters
    ----------
    u : Vector
        The sum of other terms, radians per step.
    step : StepFields or None
        The fields. The function stores the terms of order k + 1 of all vectors except the first,
        whose terms `store_turn` stores.
    table : array
        The terms of the step up to order k; see `series_table`.
    k : int
        The order.
    seconds : float
        Length of the step.
    coefficients : Coefficients
        The coefficients of Euler's equations.

    """
    if step is None:
        return u
    found, vectors = step.fields, step.vectors
    square, rate = seconds * seconds, found[0].mean_motion
    for i in range(found[0].count):
        u = _add_uniform(u, step, k, i, square, coefficients)
        if i > 0:
            _store(vectors, PERMUTED * i, k, turned(vectors, PERMUTED * i, _ORDER, table, k))
    if rate != 0.0:
        u = _add_gradient(u, step, k, square, coefficients)
        _expand_orbit(vectors, found[0].count, rate * seconds, table, k)
    return u


@inlined
def _add_uniform(u: Vector, step: StepFields, k: int, i: int, square: float,
                 coefficients: Coefficients) -> Vector:
    # Add the acceleration by a uniform field, times the square of the step.
    vectors, row, place = step.vectors, _ORDER * k + PERMUTED * i, _MATRICES + PERMUTED * i
    if coefficients.form == euler_equations.THIN:  # see `acceleration_from_torque`
        torque = cross(fields.moment(step.fields, i), four.load(vectors, row))
        return add_scaled(u, square, euler_equations.acceleration_from_torque(
            coefficients, torque))
    v, yzx, zxy = load_permuted(vectors, row)
    matrix = (four.load(vectors, place), four.load(vectors, place + 4),
              four.load(vectors, place + 8))
    return add_scaled(u, square, add_product(four.broadcast(0.0), matrix, v, yzx, zxy))


@inlined
def _add_gradient(u: Vector, step: StepFields, k: int, square: float,
                  coefficients: Coefficients) -> Vector:
    # Add the acceleration by the gravity gradient, times the square of the step.
    found, vectors = step.fields, step.vectors
    rate = found[0].mean_motion
    gradient = euler_equations.gyroscopic_acceleration(
        coefficients, _squares(vectors, PERMUTED * found[0].count, k))
    return add_scaled(u, -3.0 * (rate * rate) * square, gradient)


@internal
def _squares(vectors: Floats, place: int, k: int) -> Products:
    # Return the term of order k of the products of the components of the vector at a place.
    one = other = four.broadcast(0.0)
    for j in range(k + 1):
        r, yzx, _ = load_permuted(vectors, _ORDER * j + place)
        s, _, zxy = load_permuted(vectors, _ORDER * (k - j) + place)
        one, other = four.fma(yzx, zxy, one), four.fma(r, s, other)
    return one, other


@internal
def _expand_orbit(vectors: Floats, count: int, angle: float, table: Floats, k: int) -> None:
    # Store the terms of order k + 1 of the position, which follows `count` uniform fields, and of
    # the direction along the orbit. `angle` is the angle by which the orbit turns in a step.
    place, place_along = PERMUTED * count, PERMUTED * (count + 1)
    position, along = (four.load(vectors, _ORDER * k + place),
                       four.load(vectors, _ORDER * k + place_along))
    factor = angle * float(RECIPROCALS[k])
    turn = four.load(vectors, _ORDER * (k + 1)) if count == 0 else \
        turned(vectors, place, _ORDER, table, k)
    _store(vectors, place, k, add_scaled(turn, factor, along))
    _store(vectors, place_along, k, add_scaled(
        turned(vectors, place_along, _ORDER, table, k), -factor, position))


@inlined
def _store(vectors: Floats, place: int, k: int, value: Vector) -> None:
    store_permuted(vectors, _ORDER * (k + 1) + place, value)


@inlined
def lowest_order(step: StepFields | None) -> int:
    """Return a bound on how many consecutive terms may be zero by chance; see `taylor.step`."""
    if step is None:
        return 0
    return 0 if step.fields[0].mean_motion == 0.0 else 1
