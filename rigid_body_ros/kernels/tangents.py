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

    J dd/dt = (J d) x w + (J w + h) x d - D d + S t
              + dtau + (dJ w) x w - dJ dw/dt + dh x w - dD w
    dt/dt = t x w + d

where S t is how the torque changes with the attitude: tau x t for a torque tau that is fixed in
space, m x (f x t) for a uniform field, and 3 n^2 ((r x t) x J r + r x J (r x t)) for the gravity
gradient. The first line is linear in the tangent, and its coefficients are the series of the
motion. So a step extends the series of the motion by those of the tangents, up to the same order.
Each lane holds a tangent of its own.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.kernels import elementary, fields, four, lags, lanes, taylor
from rigid_body_ros.kernels.euler_equations import (
    acceleration_from_torque,
    DIAGONAL,
    gyroscopic_acceleration,
)
from rigid_body_ros.kernels.jit import inlined, internal, WRITTEN
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.series_table import (
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    row_of,
    TORQUES,
    U,
)
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    Coefficients,
    cross,
    KernelState,
    of,
    scale,
    to_body,
    Vector,
)

#: The rows of a tangent: the derivatives of the angular velocity and of the attitude.
RATE, ROTATION, SIZE = 0, 3, 6
#: The rows of the derivatives of constants: dJ (xx, yy, zz, xy, xz, yz), dh, the columns of dD,
#: the part of dtau that acts during the whole motion, and the moments of the uniform fields.
INERTIA, MOMENTUM, DAMPING, TORQUE, MOMENTS = 0, 6, 9, 18, 21
CONSTANTS = MOMENTS + 3 * fields.MOST
#: The rows of the terms of one order: d and t, as in a tangent, and dJ w. All are multiplied by
#: the length of the step, except t.
_MOMENTUM, _ORDER = SIZE, SIZE + 3
#: Number of rows of the workspace, without those of the forcing; and how many of these there are
#: for each vector.
WORKSPACE, OF_VECTOR = _ORDER * (MAX_ORDER + 1), 3 * (MAX_ORDER + 1)
#: The terms of one order of J^-1 S: its columns, and the products of the components of the unit
#: vector to the body.
_COLUMNS, _PRODUCTS, _STIFFNESS = 0, 12, 20
STIFFNESS = _STIFFNESS * MAX_ORDER
#: Terms below this size, relative to the tangent, do not matter.
_ROUNDING = 1e-17


class Forcing(NamedTuple):
    """
    Torques dtau that change with time, of the last t groups; they are zero for the others.

    In each of n rows, dtau is the sum of solutions of linear equations. A solution is the first of
    consecutive vectors v_j, which obey dv_j/dt = a_j v_j + b_j v_j+1, and is the last vector of
    its own if b_j is zero. A polynomial has a_j = 0, and decaying torques have a_j < 0. In body
    axes, a vector that is fixed in space also obeys dv/dt = v x w.
    """

    #: float64 (3 v n t, LANES): the v vectors when each row begins, in their own axes, N m.
    vectors: Annotated[Floats, 'q L']
    #: float64 (6 n t, LANES): when each row begins, d changes by J^-1 times these impulses, N m s,
    #: in body axes and in space axes. The array is empty if all are zero.
    impulses: Annotated[Floats, 'j L']
    #: float64 (v, 3): a_j, b_j, and 1 if the vector is fixed in space.
    links: Annotated[Floats, 'v 3']


class Seeds(NamedTuple):
    """The derivatives of constants and of torques, in groups of as many as there are lanes."""

    #: float64 (CONSTANTS g, LANES): the derivatives of constants, for each of g groups.
    constants: Annotated[Floats, f'{CONSTANTS}g L']
    #: bool (g,): whether any derivative of a constant is not zero.
    have_constants: Annotated[NDArray[np.bool_], 'g']
    forcing: Forcing


class Tangents(NamedTuple):
    """The tangents of a motion, in groups of as many as there are lanes."""

    #: float64 (SIZE g, LANES): the tangents at the latest time, for each of g groups.
    latest: Floats
    seeds: Seeds
    #: float64 (WORKSPACE + OF_VECTOR v, LANES) and float64 (STIFFNESS,)
    work: Floats
    stiffness: Floats
    #: The number of rows, and the row in force.
    rows: int
    row: int


class RequestedTangents(NamedTuple):
    """The requested times, and the arrays that receive the results."""

    #: int64 (m,): the requested times, ns, in ascending order.
    times_ns: Annotated[Ints, 'm']
    #: float64 (m, 6 g, LANES): the tangents.
    tangents: Annotated[Floats, f'm {SIZE}g L', WRITTEN]
    #: float64 (7 m,): the attitudes and the angular velocities; see `motion_layout`.
    motion: Annotated[Floats, '7m', WRITTEN]


class SeriesStep(NamedTuple):
    """A step of the series."""

    #: The table that `taylor.step` fills, and the order up to which it does.
    table: Floats
    order: int
    #: The length of the step, and the time from the beginning of the row to that of the step, s.
    seconds: float
    since: float


@inlined
def least_order(tangents: Tangents | None, size: float | None) -> int | None:
    """
    Return the order from which on linear terms contribute less than rounding errors.

    The series of a body at rest ends at once, but rotors and fields turn its tangents. In a step,
    they do so by `size`, rad.
    """
    if tangents is None:
        return None
    order, term = 0, 1.0
    if size is None:
        return order
    while term > _ROUNDING and order < MAX_ORDER and size > 0.0:
        order += 1
        term *= size / order
    return order


@inlined
def follow(tangents: Tangents | None, state: KernelState, step: SeriesStep,
           coefficients: Coefficients, drive: taylor.SeriesDrive,
           loads: taylor.SeriesLoads | None) -> None:
    """
    Advance the tangents by a step.

    Parameters
    ----------
    tangents : Tangents or None
        None does nothing.
    state : KernelState
        The state at the beginning of the step.
    step : SeriesStep
        The step.
    coefficients : Coefficients
        The coefficients of Euler's equations.
    drive, loads
        What acts during the step. There must be no friction.

    """
    if tangents is None:
        return
    is_stiff = drive.in_space
    if loads is not None:
        is_stiff = is_stiff or loads.space_degree >= 0 or loads.fields is not None
    if is_stiff:
        for k in range(step.order):
            terms = tangents.stiffness[_STIFFNESS * k:_STIFFNESS * (k + 1)]
            _expand_stiffness(terms, step.table, k, coefficients, drive, loads)
    forcing, groups = tangents.seeds.forcing, len(tangents.seeds.have_constants)
    size = 3 * len(forcing.links) * tangents.rows
    for i in range(groups):
        end = len(forcing.vectors) - size * (groups - i - 1)
        vectors = forcing.vectors[max(end - size, 0):max(end, 0)]
        has_forcing = len(vectors) > 0 and tangents.row >= 0
        if has_forcing:
            _begin_forcing(vectors, tangents, step.since, state)
        _extend(tangents, i, has_forcing, is_stiff, step, coefficients, loads)


@inlined
def enter(tangents: Tangents, row: int, state: KernelState, coefficients: Coefficients) -> None:
    """Add the impulses of a row, which begins at the given state."""
    impulses = tangents.seeds.forcing.impulses
    groups = len(tangents.seeds.have_constants)
    size = 6 * tangents.rows
    for i in range(groups):
        end = len(impulses) - size * (groups - i - 1)
        if end > 0:
            place = end - size + 6 * row
            change = acceleration_from_torque(coefficients, add(
                _load(impulses, place), _to_body(state, _load(impulses, place + 3))))
            _store(tangents.latest, SIZE * i + RATE, add(_load(tangents.latest, SIZE * i + RATE),
                                                         change))


@inlined
def _to_body(state: KernelState, vector: Vector) -> Vector:
    # Return a vector with lanes in body axes.
    x, y, z = (to_body(state[1], of(1.0, 0.0, 0.0)), to_body(state[1], of(0.0, 1.0, 0.0)),
               to_body(state[1], of(0.0, 0.0, 1.0)))
    a, b, c = vector[0], vector[1], vector[2]
    return of(fma(x[0], a, fma(y[0], b, z[0] * c)), fma(x[1], a, fma(y[1], b, z[1] * c)),
              fma(x[2], a, fma(y[2], b, z[2] * c)))


@internal
def _begin_forcing(vectors: Floats, tangents: Tangents, since: float, state: KernelState) -> None:
    # Store the vectors of the row in force at the beginning of a step, in body axes.
    links = tangents.seeds.forcing.links
    start = 3 * len(links) * tangents.row
    for j in range(len(links)):
        total, factor, last = _load(vectors, start + 3 * j), 1.0, j
        while links[last, 1] != 0.0:
            last += 1
            factor *= links[last - 1, 1] * since / (last - j)
            total = add_scaled(total, factor, _load(vectors, start + 3 * last))
        if links[j, 0] != 0.0:
            total = scale(elementary.exponential(links[j, 0] * since), total)
        if links[j, 2] != 0.0:
            total = _to_body(state, total)
        _store(tangents.work, WORKSPACE + 3 * j, total)


@internal
def _extend(tangents: Tangents, group: int, has_forcing: bool, is_stiff: bool, step: SeriesStep,
            coefficients: Coefficients, loads: taylor.SeriesLoads | None) -> None:
    # Advance the tangents of a group.
    work, seeds = tangents.work, tangents.seeds
    table, order, seconds, _ = step
    latest = tangents.latest[SIZE * group:SIZE * group + SIZE]
    constants = seeds.constants[CONSTANTS * group:CONSTANTS * group + CONSTANTS]
    for k in range(3):
        lanes.store(work, RATE + k, seconds * lanes.load(latest, RATE + k))
        lanes.store(work, ROTATION + k, lanes.load(latest, ROTATION + k))
    for k in range(order):
        mixed, squares, turn = _products(work, table, k, coefficients.form)
        torque = of(lanes.zero(mixed[0]), 0.0, 0.0)
        if has_forcing:
            torque = scale(seconds * seconds, _expand_forcing(tangents, table, k, seconds))
        if seeds.have_constants[group]:
            torque = add(torque, _of_constants(constants, work, table, k, seconds))
            torque = add(torque, _of_fields(constants, tangents, k, seconds, loads))
        rate = add(gyroscopic_acceleration(coefficients, (mixed, squares)),
                   acceleration_from_torque(coefficients, torque))
        if is_stiff:
            rate = add_scaled(rate, seconds * seconds, _stiff(work, tangents.stiffness, k))
        rate = _with_linear_terms(rate, work, k, loads)
        reciprocal = float(RECIPROCALS[k])
        _store(work, _ORDER * (k + 1) + RATE, scale(reciprocal, rate))
        _store(work, _ORDER * (k + 1) + ROTATION,
               scale(reciprocal, add(turn, _load(work, _ORDER * k + RATE))))
    for row in range(SIZE):
        total = lanes.load(work, _ORDER * order + row)
        for k in range(order - 1, -1, -1):  # the small terms first
            total = total + lanes.load(work, _ORDER * k + row)
        lanes.store(latest, row, total if row >= ROTATION else 1.0 / seconds * total)


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
        a, b, c = _rows(work, place)
        yz, zx, xy = fma(y, c, fma(z, b, yz)), fma(z, a, fma(x, c, zx)), fma(x, b, fma(y, a, xy))
        if form != DIAGONAL:
            xx, yy, zz = fma(2.0 * x, a, xx), fma(2.0 * y, b, yy), fma(2.0 * z, c, zz)
        a, b, c = _rows(work, place + 3)
        p, q, r = fma(z, b, fma(-y, c, p)), fma(x, c, fma(-z, a, q)), fma(y, a, fma(-x, b, r))
    return of(yz, zx, xy), of(xx, yy, zz), of(p, q, r)


@internal
def _expand_forcing(tangents: Tangents, table: Floats, k: int, seconds: float) -> Vector:
    # Return the order-k term of dtau, and store the next terms of its vectors.
    work, links = tangents.work, tangents.seeds.forcing.links
    size = 3 * len(links)
    total = of(lanes.zero(lanes.load(work, 0)), 0.0, 0.0)
    for j in range(len(links)):
        place = WORKSPACE + size * k + 3 * j
        term, is_first = _load(work, place), True
        if j > 0:
            is_first = links[j - 1, 1] == 0.0
        if is_first:
            total = add(total, term)
        more = scale(seconds * links[j, 0], term)
        if links[j, 1] != 0.0:
            more = add_scaled(more, seconds * links[j, 1], _load(work, place + 3))
        if links[j, 2] != 0.0:
            for i in range(k + 1):
                more = add(more, _cross(_load(work, WORKSPACE + size * i + 3 * j),
                                        four.load(table, row_of(table, k - i) + U)))
        _store(work, place + size, scale(float(RECIPROCALS[k]), more))
    return total


@internal
def _stiff(work: Floats, stiffness: Floats, k: int) -> Vector:
    # Return the order-k term of J^-1 S t.
    none = lanes.zero(lanes.load(work, 0))
    p = q = r = none
    for j in range(k + 1):
        row, place = _STIFFNESS * (k - j), _ORDER * j + ROTATION
        a, b, c = _rows(work, place)
        p = fma(stiffness[row], a, fma(stiffness[row + 4], b, fma(stiffness[row + 8], c, p)))
        q = fma(stiffness[row + 1], a, fma(stiffness[row + 5], b, fma(stiffness[row + 9], c, q)))
        r = fma(stiffness[row + 2], a, fma(stiffness[row + 6], b, fma(stiffness[row + 10], c, r)))
    return of(p, q, r)


@internal
def _expand_stiffness(into: Floats, table: Floats, k: int, coefficients: Coefficients,
                      drive: taylor.SeriesDrive, loads: taylor.SeriesLoads | None) -> None:
    # Store the order-k term of J^-1 S.
    degree, torque = drive.degree if drive.in_space else -1, four.broadcast(0.0)
    if loads is not None:
        degree = max(degree, loads.space_degree)
    for i in range(min(degree, k) + 1):
        torque = add(torque, four.load(table, row_of(table, k - i) + TORQUES + PERMUTED * i))
    if loads is not None:
        torque = add(torque, lags.space_term(loads.lags, k))
    for i in range(3):
        axis = of(1.0 if i == 0 else 0.0, 1.0 if i == 1 else 0.0, 1.0 if i == 2 else 0.0)
        column = cross(torque, axis)
        if loads is not None:
            column = add(column, fields.uniform_slope(loads.fields, k, axis))
        four.store(into, _COLUMNS + 4 * i, acceleration_from_torque(coefficients, column))
    if loads is not None:
        _add_gradient(into, loads.fields, k, coefficients)


@inlined
def _add_gradient(into: Floats, step: fields.StepFields | None, k: int,
                  coefficients: Coefficients) -> None:
    # Add the gravity gradient to the order-k term of J^-1 S. See `fields.add_acceleration`.
    if step is None:
        return
    rate = step.fields[0].mean_motion
    if rate == 0.0:
        return
    mixed, squares = fields.position_products(step, k)
    four.store(into, _PRODUCTS, mixed)
    four.store(into, _PRODUCTS + 4, squares)
    yz, zx, xy = mixed[0], mixed[1], mixed[2]
    xx, yy, zz = squares[0], squares[1], squares[2]
    slopes = ((of(zz - yy, -xy, zx), of(0.0, 2.0 * yz, -2.0 * yz)),
              (of(xy, xx - zz, -yz), of(-2.0 * zx, 0.0, 2.0 * zx)),
              (of(-zx, yz, yy - xx), of(2.0 * xy, -2.0 * xy, 0.0)))
    place = _COLUMNS
    for slope in slopes:
        four.store(into, place, add_scaled(
            four.load(into, place), -3.0 * rate * rate,
            gyroscopic_acceleration(coefficients, slope)))
        place += 4


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
def _of_fields(constants: Floats, tangents: Tangents, k: int, seconds: float,
               loads: taylor.SeriesLoads | None) -> Vector:
    # Return the order-k term of what the derivatives of constants contribute through fields.
    total = of(lanes.zero(lanes.load(tangents.work, 0)), 0.0, 0.0)
    if loads is None:
        return total
    if loads.fields is None:
        return total
    for i in range(loads.fields.fields[0].count):
        total = add(total, _cross(_load(constants, MOMENTS + 3 * i),
                                  fields.uniform_term(loads.fields, k, i)))
    rate = loads.fields.fields[0].mean_motion
    if rate != 0.0:
        total = add_scaled(total, 3.0 * rate * rate, _gradient(constants, tangents.stiffness, k))
    return scale(seconds * seconds, total)


@inlined
def _gradient(constants: Floats, stiffness: Floats, k: int) -> Vector:
    # Return the order-k term of r x dJ r.
    place = _STIFFNESS * k + _PRODUCTS
    mixed, squares = four.load(stiffness, place), four.load(stiffness, place + 4)
    a, b, c = _rows(constants, INERTIA)
    d, e, f = _rows(constants, INERTIA + 3)
    yz, zx, xy = mixed[0], mixed[1], mixed[2]
    xx, yy, zz = squares[0], squares[1], squares[2]
    return of(fma(xy, e, fma(yy - zz, f, fma(yz, c - b, -(zx * d)))),
              fma(zx, a - c, fma(yz, d, fma(zz - xx, e, -(xy * f)))),
              fma(xx - yy, d, fma(xy, b - a, fma(zx, f, -(yz * e)))))


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
