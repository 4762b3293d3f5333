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

Where samples are close, a step needs few terms, and a loop costs more than they do: `_short`
has the terms written out.
"""

from __future__ import annotations

import math

import numpy as np

from rigid_body_ros._jit import fma, inlined, part
from rigid_body_ros.so3 import Floats
from rigid_body_ros.vector import (
    Coefficients,
    Nine,
    Polynomial,
    Quaternion,
    State,
    Vector,
    accumulate,
    add,
    add_scaled,
    cross,
    dot,
    multiply,
    scale,
    to_body,
)

#: Products y z, z x, x y, x x, y y, z z of a vector, or their Cauchy sums.
Products = tuple[float, float, float, float, float, float]

MAX_ORDER = 40
#: Rows of the table of coefficients: u, the rotation since the beginning, up to four torques.
ROWS = 19
#: Bounds on the local error of the short step of order 3 and 5, for a turn of one radian: far
#: above the error itself, because errors of w add up to errors of attitude that grow with the
#: square of the time.
_ERROR_3 = 0.5
_ERROR_5 = 0.1
#: Square of the angle, rad^2, up to which the short step is right and one step suffices.
_LARGEST = 0.01


@part
def step_angle(tolerance: float) -> float:
    """
    Return the angle of a full step, rad.

    Work per angle, the order squared over the angle, has a flat minimum: about 0.5 rad at the
    tightest tolerance, where shorter steps also round less, and above 1 rad at loose ones,
    where what a step costs besides its terms counts for more.
    """
    return 0.5 + 0.09 * math.log10(tolerance / 1e-15)


@inlined
def step_seconds(w: float, acceleration: float, angle: float) -> float:
    """Return the time, s, in which a body at |w| turns by an angle, or infinity at rest."""
    rate = w + math.sqrt(w * w + 2.0 * angle * acceleration)
    return 2.0 * angle / rate if rate > 0.0 else math.inf


@inlined
def acceleration_bound(torque: Polynomial, in_space: bool, coefficients: Coefficients) -> float:
    """Return a bound on |J^-1 tau|, rad/s^2, over the span of a torque polynomial."""
    if not in_space:
        bound = 0.0
        for vector in torque:
            part = response(coefficients, vector)
            bound += math.sqrt(dot(part, part))
        return bound
    norm = size = 0.0  # a torque in space may come to lie along any body axis
    for row in coefficients[0]:
        inverse = (row[6], row[7], row[8])
        norm += dot(inverse, inverse)
    for vector in torque:
        size += math.sqrt(dot(vector, vector))
    return math.sqrt(norm) * size


@inlined
def response(coefficients: Coefficients, torque: Vector) -> Vector:
    """Return the angular acceleration J^-1 tau, rad/s^2."""
    a, b, c = coefficients[0]
    return (dot((a[6], a[7], a[8]), torque), dot((b[6], b[7], b[8]), torque),
            dot((c[6], c[7], c[8]), torque))


@inlined
def is_short(state: State, seconds: float, acceleration: float, tolerance: float) -> bool:
    """
    Return whether `short_step` is good enough, for a torque held in body axes.

    Parameters
    ----------
    state : State
    seconds : float
        Length of the step.
    acceleration : float
        |J^-1 tau|, rad/s^2.
    tolerance : float
        Attitude error per radian turned.

    """
    square = dot(state[0], state[0])
    size = seconds * seconds * (square + acceleration)
    enough = tolerance * _angle(square, acceleration, seconds)
    return size < _LARGEST and _ERROR_5 * size * size * size <= enough


@inlined
def _angle(square: float, acceleration: float, seconds: float) -> float:
    return seconds * fma(0.5 * acceleration, seconds, math.sqrt(square))


@inlined
def short_step(state: State, seconds: float, coefficients: Coefficients, diagonal: bool,
               push: Vector, acceleration: float, tolerance: float) -> State:
    """
    Return the state after one step, by terms to order 5, or 3 where they do.

    The rotation vector is integrated instead of the quaternion:
    d theta / dt = w + theta x w / 2 + theta x (theta x w) / 12 + ... (Bortz, "A new mathematical
    formulation for strapdown inertial navigation", 1971). Parameters as for `step`, but `push`
    is J^-1 tau, rad/s^2.
    """
    square = dot(state[0], state[0])
    size = seconds * seconds * (square + acceleration)
    fine = _ERROR_3 * size * size > tolerance * _angle(square, acceleration, seconds)
    u0 = scale(seconds, state[0])
    u1 = add_scaled(_rate(coefficients, diagonal, _square(u0)), seconds * seconds, push)
    u2 = scale(1 / 2, _rate(coefficients, diagonal, _twice(u0, u1)))
    u3 = scale(1 / 3, _rate(coefficients, diagonal, _plus_square(_twice(u0, u2), u1)))
    a = cross(u0, u1)
    rise = add(u1, add(u2, u3))
    turn = add_scaled(add_scaled(scale(1 / 2, u1), 1 / 3, u2), 1 / 12, a)
    if fine:
        u4 = scale(1 / 4, _rate(coefficients, diagonal, _plus_twice(_twice(u0, u3), u1, u2)))
        u5 = scale(1 / 5, _rate(coefficients, diagonal, _plus_square(
            _plus_twice(_twice(u0, u4), u1, u3), u2)))
        b = cross(u0, u2)
        rise = add(rise, add(u4, u5))
        inner = add_scaled(scale(3 / 40, u3), 1 / 360, b)
        small = add(cross(u0, add_scaled(inner, -1 / 720, cross(u0, a))),
                    scale(1 / 60, cross(u1, add_scaled(u2, -1 / 4, a))))
        small = add_scaled(small, 1 / 5, u4)
        turn = add(turn, add_scaled(add_scaled(small, 1 / 12, b), 1 / 4, u3))
    return _advance(state, scale(1.0 / seconds, rise), _half_turn(add(u0, turn)))


@inlined
def _half_turn(turn: Vector) -> Quaternion:
    # The quaternion of a small rotation vector, less 1.
    half = scale(0.5, turn)
    square = dot(half, half)
    sinc = fma(-square, fma(-square, fma(-square, 1 / 5040, 1 / 120), 1 / 6), 1.0)
    x, y, z = scale(sinc, half)
    return x, y, z, -square * fma(-square, fma(-square, 1 / 720, 1 / 24), 1 / 2)


@inlined
def step(state: State, seconds: float, coefficients: Coefficients, diagonal: bool,
         torque: Polynomial, degree: int, in_space: bool, acceleration: float, tolerance: float,
         table: Floats) -> State:
    """
    Return the state after one step.

    Parameters
    ----------
    state : State
    seconds : float
        Length of the step; no more than about `step_seconds`.
    coefficients : Coefficients
    diagonal : bool
        Whether they are those of principal axes.
    torque : Polynomial
        In the fraction of the step, 0 to 1.
    degree : int
        Of the polynomial: the coefficients beyond are zero.
    in_space : bool
        Whether the torque is given in space axes.
    acceleration : float
        A bound on |J^-1 torque|, rad/s^2.
    tolerance : float
        Attitude error per radian turned.
    table : float64 (ROWS, MAX_ORDER + 1)
        Workspace.

    """
    enough = tolerance * _angle(dot(state[0], state[0]), acceleration, seconds)
    order = _expand(state, seconds, coefficients, diagonal, torque, degree, in_space, enough,
                    table)
    x = y = z = 0.0
    p = q = r = s = 0.0
    for k in range(order, 0, -1):  # the small terms first
        x, y, z = x + table[0, k], y + table[1, k], z + table[2, k]
        p, q, r, s = p + table[3, k], q + table[4, k], r + table[5, k], s + table[6, k]
    excess = fma(0.5, fma(p, p, fma(q, q, fma(r, r, s * s))), s)
    factor = 1.0 / math.sqrt(1.0 + 2.0 * excess)  # the series cut off is not of unit length
    p, q, r = factor * p, factor * q, factor * r
    s = factor * (s - 2.0 * excess / (1.0 + 1.0 / factor))
    return _advance(state, scale(1.0 / seconds, (x, y, z)), (p, q, r, s))


@inlined
def _expand(state: State, seconds: float, coefficients: Coefficients, diagonal: bool,
            torque: Polynomial, degree: int, in_space: bool, enough: float, table: Floats) -> int:
    # Fill the table with the terms of u and of the rotation, and return the order needed.
    table[0, 0], table[1, 0], table[2, 0] = scale(seconds, state[0])
    table[3, 0] = table[4, 0] = table[5, 0] = 0.0
    table[6, 0] = 1.0
    if in_space:
        for i in range(degree + 1):
            vector = to_body(state[1], torque[i])
            table[7 + 3 * i, 0], table[8 + 3 * i, 0], table[9 + 3 * i, 0] = vector
    # A body at rest under a torque ~ t^degree has non-zero terms only at every (degree + 2)nd
    # order, so that fewer small terms in succession prove nothing.
    small = 0
    for k in range(MAX_ORDER):
        products, rotation = _cauchy(table, k, diagonal)
        u = _rate(coefficients, diagonal, products)
        if in_space or k <= degree:
            push = response(coefficients, _torque_term(table, k, torque, degree, in_space))
            u = add_scaled(u, seconds * seconds, push)
        u = scale(1.0 / (k + 1), u)
        factor = 0.5 / (k + 1)
        x, y, z, w = rotation
        x, y, z, w = factor * x, factor * y, factor * z, factor * w
        table[0, k + 1], table[1, k + 1], table[2, k + 1] = u
        table[3, k + 1], table[4, k + 1], table[5, k + 1], table[6, k + 1] = x, y, z, w
        # Errors of w are held lower: those of attitude that they lead to add up.
        if 4.0 * (abs(u[0]) + abs(u[1]) + abs(u[2])) \
                + abs(x) + abs(y) + abs(z) + abs(w) > enough:
            small = 0
        else:
            small += 1
            if small == degree + 2:
                return k + 1
    return MAX_ORDER


@inlined
def _cauchy(table: Floats, k: int, diagonal: bool) -> tuple[Products, Quaternion]:
    # The terms of order k of the products of u, and of the rotation times (u, 0).
    # Each sum is kept in two, so that one product need not wait for the other.
    yz = zx = xy = xx = yy = zz = 0.0
    p = q = r = s = 0.0
    p2 = q2 = r2 = s2 = 0.0
    last = np.uintp(k)  # an index without sign need not be looked at for being negative
    for j in range(last + np.uintp(1)):
        i = last - j
        a, b, c = table[0, i], table[1, i], table[2, i]
        d, e, f = table[0, j], table[1, j], table[2, j]
        yz, zx, xy = fma(b, f, yz), fma(c, d, zx), fma(a, e, xy)
        if not diagonal:
            xx, yy, zz = fma(a, d, xx), fma(b, e, yy), fma(c, f, zz)
        x, y, z, w = table[3, j], table[4, j], table[5, j], table[6, j]
        p, p2 = fma(w, a, p), fma(y, c, fma(-z, b, p2))
        q, q2 = fma(w, b, q), fma(z, a, fma(-x, c, q2))
        r, r2 = fma(w, c, r), fma(x, b, fma(-y, a, r2))
        s, s2 = fma(-x, a, s), fma(-y, b, fma(-z, c, s2))
    return (yz, zx, xy, xx, yy, zz), (p + p2, q + q2, r + r2, s + s2)


@inlined
def _torque_term(table: Floats, k: int, torque: Polynomial, degree: int,
                 in_space: bool) -> Vector:
    # The term of order k of the torque in body axes.
    if not in_space:
        return torque[k]
    x = y = z = 0.0
    for i in range(degree + 1):
        row = 7 + 3 * i
        if i <= k:
            x, y, z = x + table[row, k - i], y + table[row + 1, k - i], z + table[row + 2, k - i]
        _turn_torque(table, k, row)
    return x, y, z


@part
def _turn_torque(table: Floats, k: int, row: int) -> None:
    # dv/dt = v x w for a vector v that is fixed in space, in body components.
    x = y = z = 0.0
    for j in range(k + 1):
        i = k - j
        a, b, c = table[row, j], table[row + 1, j], table[row + 2, j]
        x += fma(b, table[2, i], -c * table[1, i])
        y += fma(c, table[0, i], -a * table[2, i])
        z += fma(a, table[1, i], -b * table[0, i])
    table[row, k + 1], table[row + 1, k + 1], table[row + 2, k + 1] = \
        scale(1.0 / (k + 1), (x, y, z))


@inlined
def _advance(state: State, rise: Vector, turn: Quaternion) -> State:
    # Add the rise of w, and turn q by 1 + `turn`; the norm's error so far is taken out.
    w, q, low_w, low_q = state
    excess = fma(q[0], fma(0.5, q[0], low_q[0]), fma(q[1], fma(0.5, q[1], low_q[1]), fma(
        q[2], fma(0.5, q[2], low_q[2]), fma(q[3], fma(0.5, q[3], low_q[3]), -0.5))))
    change = multiply(q, (turn[0], turn[1], turn[2], turn[3] - excess))
    w0, c0 = accumulate(w[0], low_w[0], rise[0])
    w1, c1 = accumulate(w[1], low_w[1], rise[1])
    w2, c2 = accumulate(w[2], low_w[2], rise[2])
    q0, d0 = accumulate(q[0], low_q[0], change[0])
    q1, d1 = accumulate(q[1], low_q[1], change[1])
    q2, d2 = accumulate(q[2], low_q[2], change[2])
    q3, d3 = accumulate(q[3], low_q[3], change[3])
    return (w0, w1, w2), (q0, q1, q2, q3), (c0, c1, c2), (d0, d1, d2, d3)


@inlined
def _rate(coefficients: Coefficients, diagonal: bool, products: Products) -> Vector:
    # Euler's equations without torque.
    (a, b, c), (low_a, low_b, low_c) = coefficients
    if diagonal:  # what rounding took averages to zero over a period
        return a[0] * products[0], b[1] * products[1], c[2] * products[2]
    return (_row(a, products, _row(low_a, products, 0.0)),
            _row(b, products, _row(low_b, products, 0.0)),
            _row(c, products, _row(low_c, products, 0.0)))


@inlined
def _row(a: Nine, p: Products, rest: float) -> float:
    return fma(a[0], p[0], fma(a[1], p[1], fma(a[2], p[2], fma(a[3], p[3], fma(
        a[4], p[4], fma(a[5], p[5], rest))))))


@inlined
def _square(a: Vector) -> Products:
    return a[1] * a[2], a[2] * a[0], a[0] * a[1], a[0] * a[0], a[1] * a[1], a[2] * a[2]


@inlined
def _plus_square(p: Products, a: Vector) -> Products:
    return (fma(a[1], a[2], p[0]), fma(a[2], a[0], p[1]), fma(a[0], a[1], p[2]),
            fma(a[0], a[0], p[3]), fma(a[1], a[1], p[4]), fma(a[2], a[2], p[5]))


@inlined
def _twice(a: Vector, b: Vector) -> Products:
    # a times b and b times a.
    return (fma(a[1], b[2], a[2] * b[1]), fma(a[2], b[0], a[0] * b[2]),
            fma(a[0], b[1], a[1] * b[0]), 2.0 * a[0] * b[0], 2.0 * a[1] * b[1], 2.0 * a[2] * b[2])


@inlined
def _plus_twice(p: Products, a: Vector, b: Vector) -> Products:
    return (fma(a[1], b[2], fma(a[2], b[1], p[0])), fma(a[2], b[0], fma(a[0], b[2], p[1])),
            fma(a[0], b[1], fma(a[1], b[0], p[2])), fma(2.0 * a[0], b[0], p[3]),
            fma(2.0 * a[1], b[1], p[4]), fma(2.0 * a[2], b[2], p[5]))
