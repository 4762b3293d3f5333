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
How a motion changes with its start and with the parameters of a problem: its tangents.

A tangent consists of the derivative d of the angular velocity and the derivative t of the
attitude, as a rotation vector in body axes. With the derivatives dJ of the inertia tensor, dh of
the rotor momentum, dD of the damping and dtau of the torque in body axes, a tangent obeys

    J dd/dt = (J d) x w + (J w + h) x d - D d + tau_s x t
              + dtau + (dJ w) x w - dJ dw/dt + dh x w - dD w
    dt/dt = t x w + d

where tau_s is the part of the torque that is fixed in space. The first line is linear in the
tangent, and its coefficients are the series of the motion. So a step extends the series of the
motion by those of the tangents, up to the same order. Each lane holds a tangent of its own.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import four, lanes, linear_terms, taylor
from rigid_body_ros.kernels.euler_equations import (
    acceleration_from_torque,
    DIAGONAL,
    gyroscopic_acceleration,
)
from rigid_body_ros.kernels.jit import inlined, internal, optional
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.series_table import (
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    row_of,
    TORQUES,
    U,
)
from rigid_body_ros.kernels.vector import add, add_scaled, Coefficients, of, scale, Vector

#: The rows of a tangent: the derivatives of the angular velocity and of the attitude.
RATE, ROTATION, SIZE = 0, 3, 6
#: The rows of the derivatives of constants: dJ (xx, yy, zz, xy, xz, yz), dh, the columns of dD,
#: and the part of dtau that acts during the whole motion.
INERTIA, MOMENTUM, DAMPING, TORQUE, CONSTANTS = 0, 6, 9, 18, 21
#: The rows of the terms of one order: d and t, as in a tangent, and dJ w. All are multiplied by
#: the length of the step, except t.
_MOMENTUM, _ORDER = SIZE, SIZE + 3
#: Number of rows of the workspace.
WORKSPACE = _ORDER * (MAX_ORDER + 1)
#: Terms below this size, relative to the tangent, do not matter.
_ROUNDING = 1e-17
_BINOMIALS = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0], [1.0, 2.0, 1.0, 0.0],
                       [1.0, 3.0, 3.0, 1.0]])


class Tangents(NamedTuple):
    """The tangents of a motion, in groups of as many as there are lanes."""

    #: float64 (SIZE g, LANES): the tangents at the latest time, for each of g groups.
    latest: Floats
    #: float64 (CONSTANTS g, LANES): the derivatives of constants.
    constants: Floats
    #: bool (g,): whether any derivative of a constant is not zero.
    have_constants: NDArray[np.bool_]
    #: float64 (3 (d + 1) n t, LANES): the derivatives dtau in each of n rows, as polynomials of
    #: degree d in the variable of the row, for the last t groups. They are zero for the others.
    torques: Floats
    #: float64 (WORKSPACE, LANES)
    work: Floats
    #: The number of rows, the row in force, and the degree of the polynomials.
    rows: int
    row: int
    degree: int


class StepSpan(NamedTuple):
    """A step within a row: its length, s, and where it lies in the variable of the row."""

    seconds: float
    offset: float
    ratio: float


@optional
def least_order(_found: Tangents, loads: taylor.SeriesLoads | None) -> int:
    """
    Return the order from which on linear terms contribute less than rounding errors.

    The series of a body at rest ends at once, but rotors turn its tangents.
    """
    if loads is None:
        return 0
    order, term = 0, 1.0
    size = 2.0 * math.sqrt(linear_terms.square_rate(loads.linear.matrix))
    while loads.linear_degree >= 0 and term > _ROUNDING and order < MAX_ORDER:
        order += 1
        term *= size / order
    return order


@inlined
def follow(found: Tangents | None, table: Floats, order: int, span: StepSpan,
           coefficients: Coefficients, drive: taylor.SeriesDrive,
           loads: taylor.SeriesLoads | None) -> None:
    """
    Advance the tangents by a step, whose series is in a table up to the given order.

    Parameters
    ----------
    found : Tangents or None
        None does nothing.
    table, order
        The table that `taylor.step` fills, and the order up to which it does.
    span : StepSpan
        The step.
    coefficients : Coefficients
        The coefficients of Euler's equations.
    drive, loads
        What acts during the step. There must be no fields, lags or friction.

    """
    if found is None:
        return
    groups, size = len(found.have_constants), 3 * (found.degree + 1) * found.rows
    for i in range(groups):
        end = len(found.torques) - size * (groups - i - 1)
        _extend(found.latest[SIZE * i:SIZE * i + SIZE],
                found.constants[CONSTANTS * i:CONSTANTS * i + CONSTANTS],
                found.torques[max(end - size, 0):max(end, 0)], found, found.have_constants[i],
                table, order, span, coefficients, drive, loads)


@internal
def _extend(latest: Floats, constants: Floats, torques: Floats, found: Tangents,
            has_constants: bool, table: Floats, order: int, span: StepSpan,
            coefficients: Coefficients, drive: taylor.SeriesDrive,
            loads: taylor.SeriesLoads | None) -> None:
    # Advance the tangents of a group.
    work = found.work
    for k in range(3):
        lanes.store(work, RATE + k, span.seconds * lanes.load(latest, RATE + k))
        lanes.store(work, ROTATION + k, lanes.load(latest, ROTATION + k))
    space_degree = drive.degree if drive.in_space else -1
    if loads is not None:
        space_degree = max(space_degree, loads.space_degree)
    square = span.seconds * span.seconds
    for k in range(order):
        mixed, squares, turn = _products(work, table, k, coefficients.form)
        torque = scale(square, _derivative(torques, found, k, span))
        if space_degree >= 0:
            torque = add_scaled(torque, square, _turned_torque(work, table, k, space_degree))
        if has_constants:
            torque = add(torque, _of_constants(constants, work, table, k, span.seconds))
        rate = add(gyroscopic_acceleration(coefficients, (mixed, squares)),
                   acceleration_from_torque(coefficients, torque))
        rate = _with_linear_terms(rate, work, k, loads)
        reciprocal = float(RECIPROCALS[k])
        _store(work, _ORDER * (k + 1) + RATE, scale(reciprocal, rate))
        _store(work, _ORDER * (k + 1) + ROTATION,
               scale(reciprocal, add(turn, _load(work, _ORDER * k + RATE))))
    for row in range(SIZE):
        total = lanes.load(work, _ORDER * order + row)
        for k in range(order - 1, -1, -1):  # the small terms first
            total = total + lanes.load(work, _ORDER * k + row)
        lanes.store(latest, row, total if row >= ROTATION else 1.0 / span.seconds * total)


@inlined
def _load(work: Floats, row: int) -> Vector:
    return of(lanes.load(work, row), lanes.load(work, row + 1), lanes.load(work, row + 2))


@inlined
def _store(work: Floats, row: int, vector: Vector) -> None:
    lanes.store(work, row, vector[0])
    lanes.store(work, row + 1, vector[1])
    lanes.store(work, row + 2, vector[2])


@internal
def _products(work: Floats, table: Floats, k: int,
              form: int) -> tuple[Vector, Vector, Vector]:
    # Return the order-k terms of the derivatives of the products of the components of u, as in
    # `euler_equations.Products`, and those of t x u.
    none = lanes.zero(lanes.load(work, 0))
    yz = zx = xy = xx = yy = zz = p = q = r = none
    for j in range(k + 1):
        row, place = row_of(table, k - j) + U, _ORDER * j
        x, y, z = table[row], table[row + 1], table[row + 2]
        a, b, c = (lanes.load(work, place), lanes.load(work, place + 1),
                   lanes.load(work, place + 2))
        yz, zx, xy = fma(y, c, fma(z, b, yz)), fma(z, a, fma(x, c, zx)), fma(x, b, fma(y, a, xy))
        if form != DIAGONAL:
            xx, yy, zz = fma(2.0 * x, a, xx), fma(2.0 * y, b, yy), fma(2.0 * z, c, zz)
        a, b, c = (lanes.load(work, place + 3), lanes.load(work, place + 4),
                   lanes.load(work, place + 5))
        p, q, r = fma(z, b, fma(-y, c, p)), fma(x, c, fma(-z, a, q)), fma(y, a, fma(-x, b, r))
    return of(yz, zx, xy), of(xx, yy, zz), of(p, q, r)


@inlined
def _derivative(torques: Floats, found: Tangents, k: int, span: StepSpan) -> Vector:
    # Return the order-k term of dtau in the fraction of the step.
    total = of(lanes.zero(lanes.load(found.work, 0)), 0.0, 0.0)
    if len(torques) == 0 or found.row < 0 or k > found.degree:
        return total
    start = 3 * (found.degree + 1) * found.row
    for i in range(found.degree, k - 1, -1):
        total = add_scaled(scale(span.offset, total), _BINOMIALS[i, k],
                           _load(torques, start + 3 * i))
    for _ in range(k):
        total = scale(span.ratio, total)
    return total


@internal
def _turned_torque(work: Floats, table: Floats, k: int, degree: int) -> Vector:
    # Return the order-k term of tau_s x t, where the torque is a polynomial of the given degree.
    total = of(lanes.zero(lanes.load(work, 0)), 0.0, 0.0)
    for j in range(k + 1):
        torque = four.broadcast(0.0)
        for i in range(min(degree, j) + 1):
            torque = add(torque, four.load(
                table, row_of(table, j - i) + TORQUES + PERMUTED * i))
        t = _load(work, _ORDER * (k - j) + ROTATION)
        total = add(total, _cross(torque, t))
    return total


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return of(fma(a[1], b[2], -(a[2] * b[1])), fma(a[2], b[0], -(a[0] * b[2])),
              fma(a[0], b[1], -(a[1] * b[0])))


@internal
def _of_constants(constants: Floats, work: Floats, table: Floats, k: int,
                  seconds: float) -> Vector:
    # Return the order-k term of what the derivatives of constants contribute to the torque.
    row = row_of(table, k) + U
    u, more = four.load(table, row), scale(k + 1.0, four.load(table, row_of(table, k + 1) + U))
    _store(work, _ORDER * k + _MOMENTUM, _inertia_times(constants, u))
    total = four.negative(_inertia_times(constants, more))
    for j in range(k + 1):
        total = add(total, _cross(_load(work, _ORDER * j + _MOMENTUM),
                                  four.load(table, row_of(table, k - j) + U)))
    torque = _cross(_load(constants, MOMENTUM), u)
    for j in range(3):
        torque = four.subtract(torque, scale(u[j], _load(constants, DAMPING + 3 * j)))
    if k == 0:
        torque = add_scaled(torque, seconds, _load(constants, TORQUE))
    return add_scaled(total, seconds, torque)


@inlined
def _inertia_times(constants: Floats, u: Vector) -> Vector:
    xx, yy, zz = _rows(constants, INERTIA)
    xy, xz, yz = _rows(constants, INERTIA + 3)
    return of(fma(xx, u[0], fma(xy, u[1], xz * u[2])), fma(xy, u[0], fma(yy, u[1], yz * u[2])),
              fma(xz, u[0], fma(yz, u[1], zz * u[2])))


@inlined
def _rows(values: Floats, row: int) -> tuple[Any, Any, Any]:
    return lanes.load(values, row), lanes.load(values, row + 1), lanes.load(values, row + 2)


@inlined
def _with_linear_terms(rate: Vector, work: Floats, k: int,
                       loads: taylor.SeriesLoads | None) -> Vector:
    if loads is None:
        return rate
    if loads.linear_degree < 0:
        return rate
    d, none = _load(work, _ORDER * k), four.zero(rate)
    one = _load(work, _ORDER * (k - 1)) if k > 0 else none
    two = _load(work, _ORDER * (k - 2)) if k > 1 else none
    three = _load(work, _ORDER * (k - 3)) if k > 2 else none
    last = _load(work, _ORDER * (k - 4)) if k > 3 else none
    return add(rate, taylor.linear_term(k, (d, four.yzx(d), four.zxy(d), d),
                                        (one, two, three, last), loads))
