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

The second half of the module computes the Taylor series of these torques. A uniform field is fixed
in space, so its body components obey v' = v x w. On the orbit, r and the unit vector s along the
orbit turn in space at the rate n, so they obey r' = r x w + n s and s' = s x w - n r. None of
these equations involves the attitude, so we never have to multiply by the series of the attitude.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import elementary, euler_equations, four
from rigid_body_ros.kernels.double_double import DoubleDouble, two_product, two_sum
from rigid_body_ros.kernels.euler_equations import Products
from rigid_body_ros.kernels.jit import inlined, internal, optional, record
from rigid_body_ros.kernels.lanes import fma
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
    add,
    add_scaled,
    Coefficients,
    cross,
    dot,
    KernelState,
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
#: Number of doubles per order of the series. These doubles hold the uniform fields, the unit
#: vector to the body and the unit vector along the orbit, each in three permutations.
_ORDER = PERMUTED * (MOST + 2)
#: Where the matrices begin in the workspace, after the vectors of all orders. There is one matrix
#: for each uniform field.
_MATRICES = _ORDER * (MAX_ORDER + 1)
WORKSPACE = _MATRICES + PERMUTED * MOST
#: Two sums of products. The difference between the two sums is a vector product.
Turn = tuple[Vector, Vector]


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


class StepFields(NamedTuple):
    """The fields that act during a step, and the series of their vectors."""

    #: Array of `FIELDS`, shape (1,).
    fields: NDArray[Any]
    #: The angle by which the orbit has turned at the beginning of the step; see `angle_at`.
    angle: DoubleDouble
    #: Workspace that holds the terms of the vectors, and the matrices of the uniform fields.
    vectors: Floats


@optional
def prepared(fields: NDArray[Any], work: Floats, coefficients: Coefficients) -> Floats:
    """
    Compute the matrix J^-1 [m]x of each uniform field once, for use in all steps.

    Parameters
    ----------
    fields : array of FIELDS, shape (1,), or None
        The fields of the scene.
    work : float64 (WORKSPACE,)
        The workspace in which to store the matrices.
    coefficients : Coefficients
        The coefficients of Euler's equations.

    Returns
    -------
    array or None
        The workspace, or None if the scene has no fields.

    """
    a, b, c = coefficients[0][6:]
    inverse = from_columns(a, b, c)
    for i in range(fields[0].count):
        x, y, z = times_cross(inverse, moment(fields, i))
        four.store(work, _MATRICES + PERMUTED * i, x)
        four.store(work, _MATRICES + PERMUTED * i + 4, y)
        four.store(work, _MATRICES + PERMUTED * i + 8, z)
    return work


@optional
def of_step(fields: NDArray[Any], angle: DoubleDouble, work: Floats) -> StepFields:
    """
    Return the fields that act during a step, or None if there are no fields.

    The series of the returned fields do not contain any terms yet.
    """
    return StepFields(fields, angle, work)


@inlined
def begin(step: StepFields | None, state: KernelState, coefficients: Coefficients) -> float:
    """
    Begin the series of the field vectors with their values at the beginning of a step.

    Parameters
    ----------
    step : StepFields or None
        The fields. The function stores the vectors in `step.vectors`.
    state : KernelState
        The state at the beginning of the step.
    coefficients : Coefficients
        The coefficients of Euler's equations.

    Returns
    -------
    float
        The magnitude of the acceleration due to the fields at the beginning of the step, rad/s^2.

    """
    if step is None:
        return 0.0
    fields, angle, vectors = step
    q, total = state[1], four.broadcast(0.0)
    for i in range(fields[0].count):
        store_permuted(vectors, PERMUTED * i, to_body(q, field(fields, i)))
        total = _add_uniform(total, step, 0, i, 1.0, coefficients)
    if fields[0].mean_motion != 0.0:
        position, along = orbit_at(fields, angle)
        place = PERMUTED * fields[0].count
        store_permuted(vectors, place, to_body(q, position))
        store_permuted(vectors, place + PERMUTED, to_body(q, along))
        total = _add_gradient(total, step, 0, 1.0, coefficients)
    return math.sqrt(dot(total, total))


@optional
def vectors_of(step: StepFields) -> Floats:
    """Return the workspace that holds the terms of the vectors, or None if there are no fields."""
    return step.vectors


@optional
def no_turn(vectors: Floats) -> Turn:
    """Return zeros to which `add_turn` can add products, or None if there are no fields."""
    zero = four.zero(four.load(vectors, 0))
    return zero, zero


@optional
def add_turn(turn: Turn, vectors: Floats, k: int, yzx: Vector, zxy: Vector) -> Turn:
    """
    Multiply the order-k term of the first field vector by another vector.

    The function adds the products to `turn`, and returns the sums.

    The other vector is given in two permutations, `yzx` and `zxy`. This function is called inside
    the loop that multiplies the series of the rates. There the call costs no time, because the
    processor would otherwise be waiting for the latest sum. A separate loop would take as long as
    the loop over the rates.
    """
    _, v_yzx, v_zxy = load_permuted(vectors, _ORDER * k)
    return four.fma(v_yzx, zxy, turn[0]), four.fma(v_zxy, yzx, turn[1])


@inlined
def store_turn(turn: Turn | None, vectors: Floats, k: int) -> None:
    """Compute the order-(k + 1) term of the first field vector from `turn`, and store the term."""
    if turn is None:
        return
    _store(vectors, 0, k, scale(float(RECIPROCALS[k]), four.subtract(turn[0], turn[1])))


@inlined
def add_acceleration(u: Vector, step: StepFields | None, table: Floats, k: int, seconds: float,
                     coefficients: Coefficients) -> Vector:
    """
    Return a vector plus seconds^2 times the order-k term of the acceleration due to the fields.

    The function also computes the order-(k + 1) terms of all field vectors but the first.
    `store_turn` computes the terms of the first field vector.

    Parameters
    ----------
    u : Vector
        The vector to which the function adds, in radians per step. This vector contains the terms
        of the acceleration that have already been added.
    step : StepFields or None
        The fields. The function stores the new terms in `step.vectors`.
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
    fields, vectors = step.fields, step.vectors
    square, rate = seconds * seconds, fields[0].mean_motion
    for i in range(fields[0].count):
        u = _add_uniform(u, step, k, i, square, coefficients)
        if i > 0:
            _store(vectors, PERMUTED * i, k, turned(vectors, PERMUTED * i, _ORDER, table, k))
    if rate != 0.0:
        u = _add_gradient(u, step, k, square, coefficients)
        _expand_orbit(vectors, fields[0].count, rate * seconds, table, k)
    return u


@inlined
def _add_uniform(u: Vector, step: StepFields, k: int, i: int, square: float,
                 coefficients: Coefficients) -> Vector:
    # Add the acceleration due to a uniform field, multiplied by the square of the step.
    vectors, row, place = step.vectors, _ORDER * k + PERMUTED * i, _MATRICES + PERMUTED * i
    if coefficients.form == euler_equations.THIN:  # see `acceleration_from_torque`
        torque = cross(moment(step.fields, i), four.load(vectors, row))
        return add_scaled(u, square, euler_equations.acceleration_from_torque(
            coefficients, torque))
    v, yzx, zxy = load_permuted(vectors, row)
    matrix = (four.load(vectors, place), four.load(vectors, place + 4),
              four.load(vectors, place + 8))
    return add_scaled(u, square, add_product(four.broadcast(0.0), matrix, v, yzx, zxy))


@inlined
def _add_gradient(u: Vector, step: StepFields, k: int, square: float,
                  coefficients: Coefficients) -> Vector:
    # Add the acceleration due to the gravity gradient, multiplied by the square of the step.
    fields, vectors = step.fields, step.vectors
    rate = fields[0].mean_motion
    gradient = euler_equations.gyroscopic_acceleration(
        coefficients, _squares(vectors, PERMUTED * fields[0].count, k))
    return add_scaled(u, -3.0 * (rate * rate) * square, gradient)


@internal
def _squares(vectors: Floats, place: int, k: int) -> Products:
    # Return the order-k terms of the products of the components of a vector with each other. The
    # terms of the vector are stored at `place`.
    mixed = squares = four.broadcast(0.0)
    for j in range(k + 1):
        r, yzx, _ = load_permuted(vectors, _ORDER * j + place)
        s, _, zxy = load_permuted(vectors, _ORDER * (k - j) + place)
        mixed, squares = four.fma(yzx, zxy, mixed), four.fma(r, s, squares)
    return mixed, squares


@internal
def _expand_orbit(vectors: Floats, count: int, angle: float, table: Floats, k: int) -> None:
    # Store the order-(k + 1) terms of the unit vector to the body and of the unit vector along the
    # orbit. In the workspace, these two vectors come after the `count` uniform fields. The orbit
    # turns by `angle` in a step.
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
def uniform_term(step: StepFields, k: int, i: int) -> Vector:
    """Return the order-k term of a uniform field, in body axes."""
    return four.load(step.vectors, _ORDER * k + PERMUTED * i)


@inlined
def uniform_slope(step: StepFields | None, k: int, turn: Vector) -> Vector:
    """Return the order-k term of how the torque of the uniform fields changes with a rotation."""
    total = four.broadcast(0.0)
    if step is None:
        return total
    for i in range(step.fields[0].count):
        total = add(total, cross(moment(step.fields, i),
                                 cross(uniform_term(step, k, i), turn)))
    return total


@inlined
def position_products(step: StepFields, k: int) -> Products:
    """Return the order-k terms of the products of the components of the position."""
    return _squares(step.vectors, PERMUTED * step.fields[0].count, k)


@inlined
def _store(vectors: Floats, place: int, k: int, value: Vector) -> None:
    store_permuted(vectors, _ORDER * (k + 1) + place, value)


@inlined
def lowest_order(step: StepFields | None) -> int:
    """
    Return an upper bound on how many consecutive terms may be zero by coincidence.

    `taylor.step` uses this bound so that it does not mistake such zeros for convergence.
    """
    if step is None:
        return 0
    return 0 if step.fields[0].mean_motion == 0.0 else 1
