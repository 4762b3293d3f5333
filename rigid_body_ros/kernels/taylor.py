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
Taylor-series step of Euler's equations and the attitude quaternion.

With body rates w, attitude q (x, y, z, w; body to space), inertia J and body torque tau,

    J dw/dt = (J w) x w + tau,     dq/dt = q (w, 0) / 2.

The coefficients of the solution in powers of time follow from Cauchy products (Jorba and Zou,
"A software package for the numerical integration of ODEs by means of high-order Taylor
methods", 2005). A torque fixed in space is the series of v = R(q)^T tau, where dv/dt = v x w.
There is no singular case: spheres, symmetric tops and the separatrix are like any other motion.

Time is counted in steps: u = w h is the angular velocity in radians a step. The attitude is the
series of the rotation since the beginning of the step, which starts at 1 whatever q is. Only
increments are summed, and added to the state with the rounding error carried along.

Where samples are close, a step needs few terms, and a loop costs more than they do: `short_step`
has the terms written out.
"""

from __future__ import annotations

import math

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import elementary, four
from rigid_body_ros.kernels.jit import fma, inlined, part
from rigid_body_ros.kernels.vector import (
    accumulate,
    add,
    add_scaled,
    Coefficients,
    combine,
    combine_exactly,
    cross,
    dot,
    multiply,
    Polynomial,
    Quaternion,
    scale,
    State,
    to_body,
    total,
    Vector,
)

#: The terms of an order: u, itself and turned round, and the rotation.
Term = tuple[Vector, Vector, Vector, Quaternion]
#: Products y z, z x, x y and x x, y y, z z of a vector, or their Cauchy sums.
Products = tuple[Vector, Vector]

#: Of the inertia tensor: diagonal, full, and full with moments of which one is so small that
#: J^-1 tau may cancel by more than a digit.
DIAGONAL, FULL, THIN = range(3)
#: Ratio of the largest moment to the smallest beyond which it is THIN: a loss of 16 eps is a tenth
#: of what rounding makes of a motion otherwise.
THIN_FROM = 16.0
MAX_ORDER = 40
#: What the table holds of each term: u, itself and turned round; the rotation since the beginning;
#: up to four torques, themselves and turned round.
_U, _U_YZX, _U_ZXY, _R, _TORQUES = range(0, 20, 4)
_TERM = _TORQUES + 4 * 3 * 4
#: Size of the table.
WORKSPACE = _TERM * (MAX_ORDER + 1)
#: Bounds on the local error of the short step of order 3, 4 and 5, for a turn of one radian: far
#: above the error itself, because errors of w add up to errors of attitude that grow with the
#: square of the time.
_ERROR_3 = 0.5
_ERROR_4 = 0.2
_ERROR_5 = 0.1
#: Powers of these as products, because Python's ** goes to the pow of the C library.
_SQUARE_3, _SQUARE_5 = _ERROR_3 * _ERROR_3, _ERROR_5 * _ERROR_5
_FOURTH_4 = (_ERROR_4 * _ERROR_4) * (_ERROR_4 * _ERROR_4)
#: Fourth power of the angle, rad^4, up to which the short step is right and one step suffices.
_LARGEST = 1e-4


@part
def step_angle(tolerance: float) -> float:
    """
    Return the angle of a full step, rad.

    Work per angle, the order squared over the angle, has a flat minimum: about 0.5 rad at the
    tightest tolerance, where shorter steps also round less, and above 1 rad at loose ones,
    where what a step costs besides its terms counts for more.
    """
    return 0.5 + 0.09 * elementary.logarithm_10(tolerance / 1e-15)


@inlined
def step_seconds(square: float, acceleration: float, angle: float) -> float:
    """Return the time, s, in which a body of |w|^2 turns by an angle, or infinity at rest."""
    rate = math.sqrt(square) + math.sqrt(fma(2.0 * angle, acceleration, square))
    return 2.0 * angle / rate if rate > 0.0 else math.inf


@inlined
def acceleration_bound(drive: Polynomial, in_space: bool, coefficients: Coefficients) -> float:
    """Return a bound on |J^-1 tau|, rad/s^2, over the span of a drive as `step` takes it."""
    if not in_space:
        bound = 0.0
        for vector in drive:
            bound += math.sqrt(dot(vector, vector))
        return bound
    norm = size = 0.0  # a torque in space may come to lie along any body axis
    for column in coefficients[0][6:]:
        norm += dot(column, column)
    for vector in drive:
        size += math.sqrt(dot(vector, vector))
    return math.sqrt(norm) * size


@inlined
def response(coefficients: Coefficients, form: int, torque: Vector) -> Vector:
    """
    Return the angular acceleration J^-1 tau, rad/s^2.

    For a thin rod it may be a difference of terms a million times its size, so it is summed in
    twice the working precision.
    """
    columns, low, _, along = coefficients
    if form == DIAGONAL:
        return four.multiply(along, torque)
    if form == FULL:
        return combine(columns[6:], torque)
    total, rest = combine_exactly(columns[6:], low[6:], torque)
    return add(total, rest)


@inlined
def responses(coefficients: Coefficients, form: int, torque: Polynomial,
              rests: Polynomial) -> Polynomial:
    """Return J^-1 tau, rad/s^2, of a torque in body axes and what rounding took from it."""
    a, b, c, d = torque
    if form != THIN:
        return (response(coefficients, form, a), response(coefficients, form, b),
                response(coefficients, form, c), response(coefficients, form, d))
    columns, low = coefficients[0][6:], coefficients[1][6:]
    return (response(coefficients, form, a), _response(columns, low, b, rests[1]),
            _response(columns, low, c, rests[2]), _response(columns, low, d, rests[3]))


@inlined
def _response(columns: tuple[Vector, Vector, Vector], low: tuple[Vector, Vector, Vector],
              torque: Vector, lost: Vector) -> Vector:
    total, rest = combine_exactly(columns, low, torque)
    return add(total, add(rest, combine(columns, lost)))


@inlined
def is_short(state: State, seconds: float, push: Vector, tolerance: float) -> bool:
    """
    Return whether `short_step` is good enough, for a torque held in body axes.

    Parameters
    ----------
    state : State
        Where the step begins. Only its rates count.
    seconds : float
        Length of the step.
    push : Vector
        J^-1 tau, rad/s^2.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned.

    """
    size, enough = _squares(state, seconds, push, tolerance)
    return size < _LARGEST and _SQUARE_5 * (size * (size * size)) <= enough


@inlined
def _squares(state: State, seconds: float, push: Vector, tolerance: float) -> tuple[float, float]:
    # The square of the size of a step, rad^4, and of the error allowed, rad^2, which come without
    # the roots that a short step would notice.
    factor = seconds * seconds
    square, gain = dot(state[0], state[0]), factor * dot(push, push)
    return (factor * fma(factor, square * square, gain),
            tolerance * tolerance * factor * fma(0.25, gain, square))


@inlined
def short_step(state: State, seconds: float, coefficients: Coefficients, form: int,
               push: Vector, tolerance: float) -> State:
    """
    Return the state after one step, by terms to order 5, or fewer where they do.

    The rotation vector is integrated instead of the quaternion:
    d theta / dt = w + theta x w / 2 + theta x (theta x w) / 12 + ... (Bortz, "A new mathematical
    formulation for strapdown inertial navigation", 1971). Parameters as for `step` and
    `is_short`.
    """
    size, enough = _squares(state, seconds, push, tolerance)
    w = state[0]
    # The terms of w, rad/s, and the same in radians a step. Factors go to what is known early,
    # so that the next term need not wait for them.
    u0 = scale(seconds, w)
    w1 = add_scaled(_rate(coefficients, form, _products(u0, w)), seconds, push)
    w2 = _rate(coefficients, form, _twice(scale(1 / 2, u0), w1))
    u1, u2 = scale(seconds, w1), scale(seconds, w2)
    w3 = _rate(coefficients, form, _plus_twice(
        _products(scale(1 / 3, u1), w1), scale(1 / 3, u0), w2))
    a = cross(u0, u1)
    rise = add(add(w1, w2), w3)
    turn = add_scaled(add_scaled(scale(1 / 2, u1), 1 / 3, u2), 1 / 12, a)
    if _SQUARE_3 * (size * size) > enough:
        w4 = _rate(coefficients, form, _plus_twice(
            _twice(scale(1 / 4, u1), w2), scale(1 / 4, u0), w3))
        u3, b = scale(seconds, w3), cross(u0, u2)
        rise = add(rise, w4)
        turn = add(turn, add_scaled(scale(1 / 4, u3), 1 / 12, b))
        if _FOURTH_4 * (size * ((size * size) * (size * size))) > enough * enough:
            w5 = _rate(coefficients, form, _plus_twice(_plus_twice(
                _products(scale(1 / 5, u2), w2), scale(1 / 5, u1), w3), scale(1 / 5, u0), w4))
            rise = add(rise, w5)
            inner = add_scaled(scale(3 / 40, u3), 1 / 360, b)
            small = add(cross(u0, add_scaled(inner, -1 / 720, cross(u0, a))),
                        scale(1 / 60, cross(u1, add_scaled(u2, -1 / 4, a))))
            turn = add(turn, add_scaled(small, 1 / 5 * seconds, w4))
    return _advance(state, rise, _half_turn(add(u0, turn)))


@inlined
def _half_turn(turn: Vector) -> Quaternion:
    # The quaternion of a small rotation vector, less 1.
    half = scale(0.5, turn)
    square = dot(half, half)
    sinc = fma(-square, fma(-square, fma(-square, 1 / 5040, 1 / 120), 1 / 6), 1.0)
    x = scale(sinc, half)
    return four.of(x[0], x[1], x[2],
                   -square * fma(-square, fma(-square, 1 / 720, 1 / 24), 1 / 2))


@inlined
def step(state: State, seconds: float, coefficients: Coefficients, form: int,
         drive: Polynomial, degree: int, in_space: bool, acceleration: float, tolerance: float,
         table: Floats) -> State:
    """
    Return the state after one step.

    Parameters
    ----------
    state : State
        Where the step begins.
    seconds : float
        Length of the step; no more than about `step_seconds`.
    coefficients : Coefficients
        Of Euler's equations, as `tensor.euler_coefficients` has them.
    form : int
        Of the inertia tensor: DIAGONAL, FULL or THIN.
    drive : Polynomial
        In the fraction of the step, 0 to 1: J^-1 tau, rad/s^2, of a torque in body axes, or the
        torque, N m, in space axes.
    degree : int
        Of the polynomial: the coefficients beyond are zero.
    in_space : bool
        Whether it is a torque in space axes.
    acceleration : float
        A bound on |J^-1 tau|, rad/s^2.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned.
    table : float64 (WORKSPACE,)
        Workspace.

    """
    angle = seconds * fma(0.5 * acceleration, seconds, math.sqrt(dot(state[0], state[0])))
    enough = tolerance * angle
    order = _expand(state, seconds, coefficients, form, drive, degree, in_space, enough,
                    table)
    rise = turn = four.every(0.0)
    for k in range(order, 0, -1):  # the small terms first
        rise = add(rise, four.load(table, _TERM * k + _U))
        turn = add(turn, four.load(table, _TERM * k + _R))
    excess = fma(0.5, dot(turn, turn), turn[3])
    norm = math.sqrt(1.0 + 2.0 * excess)  # the series cut off is not of unit length
    rest = four.of(0.0, 0.0, 0.0, -2.0 * excess / (1.0 + norm))
    return _advance(state, scale(1.0 / seconds, rise), scale(1.0 / norm, add(turn, rest)))


@inlined
def _expand(state: State, seconds: float, coefficients: Coefficients, form: int,
            drive: Polynomial, degree: int, in_space: bool, enough: float, table: Floats) -> int:
    # Fill the table with the terms of u and of the rotation, and return the order needed.
    first = latest = _keep(table, 0, scale(seconds, state[0]), four.of(0.0, 0.0, 0.0, 1.0))
    if in_space:
        for i in range(degree + 1):
            _keep_turned(table, _TORQUES + 12 * i, to_body(state[1], drive[i]))
    # A body at rest under a torque ~ t^degree has non-zero terms only at every (degree + 2)nd
    # order, so that fewer small terms in succession prove nothing.
    small = 0
    for k in range(MAX_ORDER):
        products, rotation = _cauchy(table, k, first, latest, form)
        u = _rate(coefficients, form, products)
        if in_space:
            push = response(coefficients, form, _torque_term(table, k, degree))
            u = add_scaled(u, seconds * seconds, push)
        elif k <= degree:
            u = add_scaled(u, seconds * seconds, drive[k])
        u = scale(1.0 / (k + 1), u)
        factor = 0.5 / (k + 1)
        turn = scale(factor, rotation)
        latest = _keep(table, k + 1, u, turn)
        # Errors of w are held lower: those of attitude that they lead to add up.
        if total(add_scaled(four.absolute(turn), 4.0, four.absolute(u))) > enough:
            small = 0
        else:
            small += 1
            if small == degree + 2:
                return k + 1
    return MAX_ORDER


@inlined
def _keep(table: Floats, k: int, u: Vector, turn: Quaternion) -> Term:
    row = _TERM * k
    _keep_turned(table, row + _U, u)
    four.store(table, row + _R, turn)
    return u, four.yzx(u), four.zxy(u), turn


@inlined
def _keep_turned(table: Floats, row: int, vector: Vector) -> None:
    four.store(table, row, vector)
    four.store(table, row + 4, four.yzx(vector))
    four.store(table, row + 8, four.zxy(vector))


@inlined
def _kept(table: Floats, row: int) -> Term:
    return (four.load(table, row + _U), four.load(table, row + _U_YZX),
            four.load(table, row + _U_ZXY), four.load(table, row + _R))


@inlined
def _cauchy(table: Floats, k: int, first: Term, latest: Term,
            form: int) -> tuple[Products, Quaternion]:
    # The terms of order k of the products of u, and of the rotation times (u, 0). What has the
    # latest term comes last, and not from memory, so that the rest need not wait for it.
    sums = (four.every(0.0), four.every(0.0), four.every(0.0), four.every(0.0), four.every(0.0))
    row = _TERM * k
    for j in range(_TERM, row, _TERM):
        sums = _add_term(sums, _kept(table, row - j), _kept(table, j), form)
    if k > 0:
        sums = _add_term(sums, first, latest, form)
    products, squares, x, y, z = _add_term(sums, latest, first, form)
    return (products, squares), add(add(four.times_i(x), four.times_j(y)), four.times_k(z))


@inlined
def _add_term(sums: tuple[Vector, Vector, Quaternion, Quaternion, Quaternion], one: Term,
              other: Term,
              form: int) -> tuple[Vector, Vector, Quaternion, Quaternion, Quaternion]:
    products, squares, x, y, z = sums
    u, yzx, _, _ = one
    v, _, zxy, turn = other
    products = four.fma(yzx, zxy, products)
    if form != DIAGONAL:
        squares = four.fma(u, v, squares)
    return (products, squares, add_scaled(x, u[0], turn), add_scaled(y, u[1], turn),
            add_scaled(z, u[2], turn))


@inlined
def _torque_term(table: Floats, k: int, degree: int) -> Vector:
    # The term of order k, in body axes, of a torque in space axes.
    term = four.every(0.0)
    for i in range(degree + 1):
        if i <= k:
            term = add(term, four.load(table, _TERM * (k - i) + _TORQUES + 12 * i))
        _turn_torque(table, k, _TORQUES + 12 * i)
    return term


@part
def _turn_torque(table: Floats, k: int, kind: int) -> None:
    # dv/dt = v x w for a vector v that is fixed in space, in body components.
    one = other = four.every(0.0)
    for j in range(k + 1):
        row, i = _TERM * j + kind, _TERM * (k - j)
        one = four.fma(four.load(table, row + 4), four.load(table, i + _U_ZXY), one)
        other = four.fma(four.load(table, row + 8), four.load(table, i + _U_YZX), other)
    _keep_turned(table, _TERM * (k + 1) + kind,
                 scale(1.0 / (k + 1), four.subtract(one, other)))


@inlined
def _advance(state: State, rise: Vector, turn: Quaternion) -> State:
    # Add the rise of w, and turn q by 1 + `turn`; the norm's error so far is taken out.
    w, q, low_w, low_q = state
    excess = dot(q, add_scaled(low_q, 0.5, q)) - 0.5
    change = add_scaled(multiply(q, turn), -excess, q)
    w, low_w = accumulate(w, low_w, rise)
    q, low_q = accumulate(q, low_q, change)
    return w, q, low_w, low_q


@inlined
def _rate(coefficients: Coefficients, form: int, products: Products) -> Vector:
    # Euler's equations without torque.
    columns, low, main, _ = coefficients
    mixed, squares = products
    if form == DIAGONAL:  # what rounding took averages to zero over a period
        return four.multiply(main, mixed)
    rest = add(combine(low[:3], mixed), combine(low[3:6], squares))
    return _add_combined(_add_combined(rest, columns[3:6], squares), columns[:3], mixed)


@inlined
def _add_combined(rest: Vector, columns: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    # Each sum is rounded once: the energy of a long run drifts by what more would take.
    rest = add_scaled(rest, a[2], columns[2])
    return add_scaled(add_scaled(rest, a[1], columns[1]), a[0], columns[0])


@inlined
def _products(a: Vector, b: Vector) -> Products:
    return four.multiply(four.yzx(a), four.zxy(b)), four.multiply(a, b)


@inlined
def _twice(a: Vector, b: Vector) -> Products:
    # a times b and b times a.
    return (four.fma(four.yzx(a), four.zxy(b), four.multiply(four.zxy(a), four.yzx(b))),
            scale(2.0, four.multiply(a, b)))


@inlined
def _plus_twice(p: Products, a: Vector, b: Vector) -> Products:
    return (four.fma(four.yzx(a), four.zxy(b), four.fma(four.zxy(a), four.yzx(b), p[0])),
            four.fma(scale(2.0, a), b, p[1]))
