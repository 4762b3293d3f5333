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
A Taylor-series step of Euler's equations and the attitude quaternion.

With body rates w, attitude q (x, y, z, w; body to space), inertia J and body torque tau, the
equations of motion are

    J dw/dt = (J w) x w + tau,     dq/dt = q (w, 0) / 2.

Rotors and damping add a term that is linear in w; see `linear_terms`.

The solution is expanded in powers of time. Its coefficients are computed by Cauchy products (Jorba
and Zou, "A software package for the numerical integration of ODEs by means of high-order Taylor
methods", 2005). A torque that is fixed in space has the body components v = R(q)^T tau, whose
series follows from dv/dt = v x w. There are no singular cases, so spheres, symmetric tops and
motion on the separatrix need no special treatment.

Time is measured in units of the step h, so u = w h is the angular velocity in radians per step.
For the attitude, we expand the rotation since the start of the step. The first term of this series
is always the identity, 1, whatever q is. We sum only the terms after the first, and add the result
to the state by compensated summation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import (
    elementary,
    euler_equations,
    fields,
    four,
    friction,
    lags,
    lanes,
    linear_terms,
)
from rigid_body_ros.kernels.euler_equations import DIAGONAL, Products
from rigid_body_ros.kernels.jit import inlined, njit, optional
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.linear_terms import add_product, Matrix, product
from rigid_body_ros.kernels.series_table import (
    components,
    load_term,
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    rotation_of,
    row_of,
    store_permuted,
    store_term,
    Term,
    TORQUES,
    turned,
    U,
    without_fourth,
)
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    advance,
    Coefficients,
    dot,
    KernelState,
    Polynomial,
    Quaternion,
    scale,
    to_body,
    total,
    Vector,
)

#: The Cauchy sums of one order: the products (y z, z x, x y) of the components of u, the squares
#: of these components, and the rotation times each component.
_Sums = tuple[Vector, Vector, Quaternion, Quaternion, Quaternion]


class SeriesDrive(NamedTuple):
    """What drives the body during a step: a torque, or the acceleration that it causes."""

    #: A polynomial in the fraction of the step, from 0 to 1. For a torque in body axes, it is the
    #: acceleration J^-1 tau, rad/s^2. For a torque in space axes, it is the torque itself, N m.
    polynomial: Polynomial
    #: The degree of the polynomial. The coefficients of higher degrees are zero.
    degree: int
    in_space: bool
    #: Upper bound on |J^-1 tau|, rad/s^2.
    bound: float


class SeriesLoads(NamedTuple):
    """What acts during a step besides the drive."""

    #: The matrix A of the linear terms, multiplied by the step length, as a polynomial in the
    #: fraction of the step. `linear` is the coefficient of order 0, and `changes` contains the
    #: other coefficients. The degree is negative if there are no linear terms.
    linear: linear_terms.Linear
    changes: tuple[Matrix, Matrix, Matrix, Matrix]
    linear_degree: int
    #: The torque in space axes, N m, as a polynomial in the fraction of the step. The degree is
    #: negative if there is no such torque.
    space_torque: Polynomial
    space_degree: int
    #: The fields, or None if there are none.
    fields: fields.StepFields | None
    #: The torques that lag their commands, or None if there are none.
    lags: lags.StepLags | None
    #: The wheels with friction, or None if there are none.
    friction: friction.StepFriction | None


@njit
def step_angle(tolerance: float) -> float:
    """
    Return the angle by which the body turns in a full step, rad.

    The angle is chosen to make the motion cheap to compute. The cost per radian is roughly
    proportional to the square of the order, divided by the angle of a step. As a function of the
    angle, this cost has a flat minimum. For the tightest tolerance, the minimum is at about 0.5
    rad, and shorter steps also reduce the rounding error. For loose tolerances, the minimum is
    above 1 rad, because the fixed cost of a step makes up a larger share of the total.
    """
    return 0.5 + 0.09 * elementary.log10(tolerance / 1e-15)


@inlined
def step_seconds(square: float, acceleration: float, angle: float) -> float:
    """
    Return the time that a body takes to turn by `angle`, s, or infinity if it stays at rest.

    `angle` is in rad. `square` is |w|^2, rad^2/s^2, and `acceleration` is an upper bound on
    |J^-1 tau|, rad/s^2.
    """
    rate = turning_rate(square, acceleration, angle)
    return 2.0 * angle / rate if rate > 0.0 else math.inf


@inlined
def turning_rate(square: float, acceleration: float, angle: float) -> float:
    """
    Return the sum of the angular rates before and after a turn by `angle`, rad/s.

    The arguments are the same as for `step_seconds`.
    """
    return math.sqrt(square) + math.sqrt(fma(2.0 * angle, acceleration, square))


@inlined
def step(state: KernelState, seconds: float, coefficients: Coefficients,
         drive: SeriesDrive, tolerance: float, table: Floats,
         loads: SeriesLoads | None, least: int | None) -> tuple[KernelState, int]:
    """
    Return the state after one step, and the order up to which the table is filled.

    Parameters
    ----------
    state : KernelState
        The state at the start of the step.
    seconds : float
        The length of the step, at most about `step_seconds`.
    coefficients : Coefficients
        The coefficients of Euler's equations.
    drive : SeriesDrive
        The drive. It must be in body axes if the step has lanes.
    tolerance : float
        Bound on the truncation error of the attitude for each radian that the body turns.
    table : float64 (WORKSPACE,) or (WORKSPACE_OF_LANES, LANES)
        Workspace.
    loads : SeriesLoads or None
        What acts besides the drive. In most scenes this is None, and the compiler leaves out the
        code for loads.
    least : int or None
        The lowest order up to which to fill the table. None stands for 0.

    Returns
    -------
    KernelState, int

    """
    lags.begin(_lags_of(loads), state)
    acceleration = drive.bound + fields.begin(_fields_of(loads), state, coefficients)
    if loads is not None:
        acceleration += friction.begin(loads.friction, state, coefficients)
    angle = seconds * fma(0.5 * acceleration, seconds, math.sqrt(dot(state[0], state[0])))
    friction.weigh(_friction_of(loads), angle, seconds)
    error_bound = tolerance * angle
    order = _expand(state, seconds, coefficients, drive, error_bound, table, loads, least)
    delta_u = delta_q = four.zero(state[0])
    for k in range(order, 0, -1):  # the small terms first
        delta_u = add(delta_u, without_fourth(table, four.load(table, row_of(table, k) + U)))
        delta_q = add(delta_q, four.load(table, row_of(table, k) + rotation_of(table)))
    friction.end(_friction_of(loads), order, seconds)
    excess = fma(0.5, dot(delta_q, delta_q), delta_q[3])
    norm = math.sqrt(1.0 + 2.0 * excess)  # a truncated series does not have unit norm
    rest = four.of(0.0, 0.0, 0.0, -2.0 * excess / (1.0 + norm))
    return advance(state, scale(1.0 / seconds, delta_u),
                   scale(1.0 / norm, add(delta_q, rest))), order


@optional
def _fields_of(loads: SeriesLoads) -> fields.StepFields | None:
    return loads.fields


@optional
def _lags_of(loads: SeriesLoads) -> lags.StepLags | None:
    return loads.lags


@optional
def _friction_of(loads: SeriesLoads) -> friction.StepFriction | None:
    return loads.friction


@inlined
def _expand(state: KernelState, seconds: float, coefficients: Coefficients,
            drive: SeriesDrive, error_bound: float, table: Floats,
            loads: SeriesLoads | None, least: int | None) -> int:
    # Fill the table with the terms of u and of the rotation, up to the order that the error bound
    # requires, and return this order.
    polynomial, degree, in_space, _ = drive
    zero = four.zero(state[0])
    identity = add(zero, four.of(0.0, 0.0, 0.0, 1.0))
    first = latest = store_term(
        table, 0, without_fourth(table, scale(seconds, state[0])), identity)
    if in_space:
        for i in range(degree + 1):
            store_permuted(table, TORQUES + PERMUTED * i, to_body(state[1], polynomial[i]))
    if loads is not None:
        for i in range(loads.space_degree + 1):
            store_permuted(table, TORQUES + PERMUTED * i,
                           to_body(state[1], loads.space_torque[i]))
    # If a torque ~ t^degree acts on a body at rest, only every (degree + 2)-th term of the series
    # is nonzero. So the sum has converged only after degree + 2 small terms in a row.
    small, powers = lanes.no_count(error_bound), _lowest_order(degree, loads)
    past = (zero, zero, zero, zero)  # the four terms of u before the latest one
    vectors = fields.vectors_of(_fields_of(loads))
    for k in range(MAX_ORDER):
        products, rotation, turn = _cauchy(table, k, first, latest, coefficients.form, vectors)
        fields.store_turn(turn, vectors, k)
        if loads is None:
            u = euler_equations.gyroscopic_acceleration(coefficients, products)
        else:
            u = euler_equations.add_gyroscopic_acceleration(
                linear_term(k, latest, past, loads), coefficients, products)
        if in_space:
            u = _add_space_torque(u, table, k, degree, seconds, coefficients)
        elif k <= degree:
            u = add_scaled(u, seconds * seconds, polynomial[k])
        if loads is not None:
            if loads.space_degree >= 0:
                u = _add_space_torque(u, table, k, loads.space_degree, seconds, coefficients)
            u = fields.add_acceleration(u, loads.fields, table, k, seconds, coefficients)
            u = lags.add_acceleration(u, loads.lags, table, k, seconds, coefficients)
            u = friction.add_acceleration(u, loads.friction, table, k, seconds, coefficients)
            past = (latest[0], past[0], past[1], past[2])
        reciprocal = float(RECIPROCALS[k])
        u = scale(reciprocal, u)
        rotation = scale(0.5 * reciprocal, rotation)
        u = without_fourth(table, u)
        if four.has_lanes(table) and lanes.some(small >= powers + 2):  # some series have converged
            u = four.choose(small >= powers + 2, zero, u)
            rotation = four.choose(small >= powers + 2, zero, rotation)
        latest = store_term(table, k + 1, u, rotation)
        # Errors in w get a higher weight, because they cause attitude errors that keep adding up.
        size = friction.with_momenta(
            total(add_scaled(four.absolute(rotation), 4.0, four.absolute(u))),
            _friction_of(loads), k + 1)
        small = lanes.counted(size > error_bound, small)
        if lanes.every(small >= powers + 2):
            if least is None:
                return k + 1
            if k + 1 >= least:
                return k + 1
    return MAX_ORDER


@inlined
def _cauchy(table: Floats, k: int, first: Term, latest: Term, form: int,
            vectors: Floats | None) -> tuple[Products, Quaternion, fields.Turn | None]:
    # Return the order-k terms of three products: the components of u with each other, the rotation
    # times (u, 0), and the first field vector times u. The latest term is taken from registers,
    # and its products are computed last, so that the other products do not have to wait for it.
    zero = four.zero(first[0])
    sums = (zero, zero, zero, zero, zero)
    turn = fields.no_turn(vectors)
    row = row_of(table, k)
    for j in range(row_of(table, 1), row, row_of(table, 1)):
        term = load_term(table, row - j)
        sums = _add_term(sums, term, components(table, row - j, term[0]), load_term(table, j),
                         form)
        turn = fields.add_turn(turn, vectors, j // row_of(table, 1), term[1], term[2])
    if k > 0:
        sums = _add_term(sums, first, first[0], latest, form)
        turn = fields.add_turn(turn, vectors, k, first[1], first[2])
    turn = fields.add_turn(turn, vectors, 0, latest[1], latest[2])
    u = latest[0]
    x, y, z = (_add_start(table, sums[2], u[0]), _add_start(table, sums[3], u[1]),
               _add_start(table, sums[4], u[2]))
    return (_add_products((sums[0], sums[1]), latest, first, form),
            add(add(four.times_i(x), four.times_j(y)), four.times_k(z)), turn)


@inlined
def _add_term(sums: _Sums, one: Term, u: Vector, other: Term, form: int) -> _Sums:
    products, squares, x, y, z = sums
    products, squares = _add_products((products, squares), one, other, form)
    rotation = other[3]
    return (products, squares, add_scaled(x, u[0], rotation), add_scaled(y, u[1], rotation),
            add_scaled(z, u[2], rotation))


@inlined
def _add_products(sums: Products, one: Term, other: Term, form: int) -> Products:
    products, squares = sums
    u, yzx, _, _ = one
    v, _, zxy, _ = other
    products = four.fma(yzx, zxy, products)
    if form != DIAGONAL:
        squares = four.fma(u, v, squares)
    return products, squares


@inlined
def _add_start(table: Floats, total: Quaternion, factor: float) -> Quaternion:
    # Add a multiple of the rotation at the start of the step, which is the identity.
    if four.has_lanes(table):
        return four.of(total[0], total[1], total[2], total[3] + factor)
    return add_scaled(total, factor, four.of(0.0, 0.0, 0.0, 1.0))


@inlined
def linear_term(k: int, latest: Term, past: tuple[Vector, Vector, Vector, Vector],
                loads: SeriesLoads) -> Vector:
    """Return the contribution of rotors and damping to the order-k term of the acceleration."""
    u, yzx, zxy, _ = latest
    rest = four.zero(u)
    if (loads.fields is not None or loads.lags is not None) and loads.linear_degree < 0:
        return rest  # in most scenes
    if loads.linear_degree > 0:
        rest = product(loads.changes[0], past[0])
    if loads.linear_degree > 1:
        others = add(product(loads.changes[2], past[2]), product(loads.changes[3], past[3]))
        rest = add(rest, add(others, product(loads.changes[1], past[1])))
    if k < 4:  # at higher orders, the terms are too small for the low-order part to matter
        rest = add_product(rest, loads.linear.low, u, yzx, zxy)
    return add_product(rest, loads.linear.matrix, u, yzx, zxy)


@inlined
def _lowest_order(degree: int, loads: SeriesLoads | None) -> int:
    # Return an upper bound on how many consecutive terms may be zero by coincidence.
    if loads is None:
        return degree
    return max(degree, loads.space_degree, loads.linear_degree,
               fields.lowest_order(loads.fields), 0 if loads.lags is None else 1,
               0 if loads.friction is None else 1)


@inlined
def _add_space_torque(u: Vector, table: Floats, k: int, degree: int, seconds: float,
                      coefficients: Coefficients) -> Vector:
    # Add the order-k term of the acceleration due to a torque in space axes, multiplied by the
    # square of the step.
    term = four.zero(four.load(table, U))
    for i in range(degree + 1):
        if i <= k:
            term = add(term, four.load(table, row_of(table, k - i) + TORQUES + PERMUTED * i))
        place = TORQUES + PERMUTED * i
        store_permuted(table, row_of(table, k + 1) + place,
                       turned(table, place, row_of(table, 1), table, k))
    return add_scaled(u, seconds * seconds,
                      euler_equations.acceleration_from_torque(coefficients, term))
