"""
Taylor-series step of Euler's equations and the attitude quaternion.

With body rates w, attitude q (x, y, z, w; body to space), inertia J and body torque tau,

    J dw/dt = (J w) x w + tau,     dq/dt = q (w, 0) / 2.

The coefficients of the solution in powers of time follow from Cauchy products (Jorba and Zou,
"A software package for the numerical integration of ODEs by means of high-order Taylor
methods", 2005). A torque fixed in space is the series of v = R(q)^T tau, where dv/dt = v x w.
There is no singular case: spheres, symmetric tops and the separatrix are like any other motion.

Two things keep the result at rounding level. (J w) x w is formed as ((J - mu 1) w) x w, which is
the same for any mu: with mu the middle moment nothing cancels in a thin rod or a near-sphere.
And only the increment is summed, then added to the state with the rounding error carried along
(Kahan; Neumaier's form).

A state is an array of 14: w (3), q (4), and the carries of both (7).
"""

from __future__ import annotations

import math

import numpy as np

from rigid_body_ros._jit import njit
from rigid_body_ros.so3 import Floats

STATE = 14
MAX_ORDER = 40
#: Columns of the coefficient table: w, q, (J - mu) w, and up to four torque vectors.
_COLUMNS = 22
#: Angle of a full step, rad. Work per angle, order squared over angle, is flat from 0.3 to 0.6.
STEP_ANGLE = 0.5


def workspace() -> Floats:
    """Return an uninitialised table of series coefficients for `step`."""
    return np.empty((MAX_ORDER + 1, _COLUMNS))


@njit
def speed(state: Floats) -> float:
    """Return |w|, rad/s."""
    return math.sqrt(state[0] * state[0] + state[1] * state[1] + state[2] * state[2])


@njit
def step_seconds(state: Floats, acceleration: float) -> float:
    """Return the time, s, in which the body turns by STEP_ANGLE, or infinity at rest."""
    w = speed(state)
    rate = w + math.sqrt(w * w + 2.0 * STEP_ANGLE * acceleration)
    return 2.0 * STEP_ANGLE / rate if rate > 0.0 else math.inf


@njit
def acceleration_bound(polynomial: Floats, in_space: bool, matrices: Floats) -> float:
    """Return a bound on |J^-1 tau|, rad/s^2, over the span of a torque polynomial."""
    bound = 0.0
    for k in range(polynomial.shape[0]):
        x, y, z = polynomial[k, 0], polynomial[k, 1], polynomial[k, 2]
        squares = 0.0
        if in_space:  # it may come to lie along any body axis
            for i in range(3):
                for j in range(3):
                    squares += matrices[0, i, j] * matrices[0, i, j] * (x * x + y * y + z * z)
        else:
            for i in range(3):
                part = matrices[0, i, 0] * x + matrices[0, i, 1] * y + matrices[0, i, 2] * z
                squares += part * part
        bound += math.sqrt(squares)
    return bound


@njit
def step(state: Floats, seconds: float, matrices: Floats, torque: Floats, in_space: bool,
         acceleration: float, tolerance: float, series: Floats) -> None:
    """
    Advance a state in place by one step.

    Parameters
    ----------
    state : float64 (14,)
    seconds : float
        Length of the step; no more than about `step_seconds`.
    matrices : float64 (2, 3, 3)
        The inverse of J, and J - mu 1.
    torque : float64 (degree + 1, 3)
        N m; coefficients of a polynomial in the fraction of the step, 0 to 1.
    in_space : bool
        Whether the torque is given in space axes.
    acceleration : float
        A bound on |J^-1 torque|, rad/s^2.
    tolerance : float
        Attitude error per radian turned.
    series : float64 (MAX_ORDER + 1, 22)
        Workspace.

    """
    order = _expand(state, seconds, matrices, torque, in_space, acceleration, tolerance, series)
    _add_increment(state, series, order)
    _restore_norm(state)


@njit
def _expand(state: Floats, seconds: float, matrices: Floats, torque: Floats, in_space: bool,
            acceleration: float, tolerance: float, series: Floats) -> int:
    # Fill the table with the terms w_k h^k, q_k h^k ... and return the order that was needed.
    for i in range(7):
        series[0, i] = state[i]
    _shifted_momentum(series, 0, matrices)
    degree = torque.shape[0] - 1
    if in_space:
        for i in range(degree + 1):
            _to_body(state, torque, i, series)
    w = speed(state)
    angle = w * seconds + 0.5 * acceleration * seconds * seconds
    enough_q = tolerance * angle
    enough_w = enough_q * (w + acceleration * seconds)
    # A body at rest under a torque ~ t^degree has non-zero terms only at every (degree + 2)nd
    # order, so that fewer small terms in succession prove nothing.
    small = 0
    for k in range(MAX_ORDER):
        _next_term(series, k, seconds / (k + 1), matrices, torque, in_space)
        if _below(series, k + 1, enough_w, enough_q):
            small += 1
            if small == degree + 2:
                return k + 1
        else:
            small = 0
    return MAX_ORDER


@njit
def _next_term(series: Floats, k: int, factor: float, matrices: Floats, torque: Floats,
               in_space: bool) -> None:
    # Term k + 1 of w, q, (J - mu) w and the turning torque vectors, from the terms up to k.
    degree = torque.shape[0] - 1
    tx = ty = tz = 0.0
    if in_space:
        for i in range(min(degree, k) + 1):
            tx += series[k - i, 10 + 3 * i]
            ty += series[k - i, 11 + 3 * i]
            tz += series[k - i, 12 + 3 * i]
            _next_in_body(series, k, factor, 10 + 3 * i)
        for i in range(k + 1, degree + 1):
            _next_in_body(series, k, factor, 10 + 3 * i)
    elif k <= degree:
        tx, ty, tz = torque[k, 0], torque[k, 1], torque[k, 2]
    qx = qy = qz = qw = 0.0
    for j in range(k + 1):
        wx, wy, wz = series[k - j, 0], series[k - j, 1], series[k - j, 2]
        x, y, z, w = series[j, 3], series[j, 4], series[j, 5], series[j, 6]
        hx, hy, hz = series[j, 7], series[j, 8], series[j, 9]
        tx += hy * wz - hz * wy
        ty += hz * wx - hx * wz
        tz += hx * wy - hy * wx
        qx += w * wx + y * wz - z * wy
        qy += w * wy + z * wx - x * wz
        qz += w * wz + x * wy - y * wx
        qw -= x * wx + y * wy + z * wz
    for i in range(3):
        series[k + 1, i] = factor * (matrices[0, i, 0] * tx + matrices[0, i, 1] * ty
                                     + matrices[0, i, 2] * tz)
    series[k + 1, 3], series[k + 1, 4] = 0.5 * factor * qx, 0.5 * factor * qy
    series[k + 1, 5], series[k + 1, 6] = 0.5 * factor * qz, 0.5 * factor * qw
    _shifted_momentum(series, k + 1, matrices)


@njit
def _shifted_momentum(series: Floats, k: int, matrices: Floats) -> None:
    for i in range(3):
        series[k, 7 + i] = (matrices[1, i, 0] * series[k, 0] + matrices[1, i, 1] * series[k, 1]
                            + matrices[1, i, 2] * series[k, 2])


@njit
def _next_in_body(series: Floats, k: int, factor: float, column: int) -> None:
    # dv/dt = v x w for a vector v that is fixed in space, in body components.
    x = y = z = 0.0
    for j in range(k + 1):
        vx, vy, vz = series[j, column], series[j, column + 1], series[j, column + 2]
        wx, wy, wz = series[k - j, 0], series[k - j, 1], series[k - j, 2]
        x += vy * wz - vz * wy
        y += vz * wx - vx * wz
        z += vx * wy - vy * wx
    series[k + 1, column] = factor * x
    series[k + 1, column + 1] = factor * y
    series[k + 1, column + 2] = factor * z


@njit
def _to_body(state: Floats, torque: Floats, i: int, series: Floats) -> None:
    # R(q)^T v = v - w t + u x t with t = 2 u x v, u the vector part of q.
    ux, uy, uz, w = state[3], state[4], state[5], state[6]
    vx, vy, vz = torque[i, 0], torque[i, 1], torque[i, 2]
    tx, ty, tz = 2.0 * (uy * vz - uz * vy), 2.0 * (uz * vx - ux * vz), 2.0 * (ux * vy - uy * vx)
    series[0, 10 + 3 * i] = vx - w * tx + (uy * tz - uz * ty)
    series[0, 11 + 3 * i] = vy - w * ty + (uz * tx - ux * tz)
    series[0, 12 + 3 * i] = vz - w * tz + (ux * ty - uy * tx)


@njit
def _below(series: Floats, k: int, enough_w: float, enough_q: float) -> bool:
    for i in range(3):
        if abs(series[k, i]) > enough_w:
            return False
    for i in range(3, 7):
        if abs(series[k, i]) > enough_q:
            return False
    return True


@njit
def _add_increment(state: Floats, series: Floats, order: int) -> None:
    for i in range(7):
        increment = 0.0
        for k in range(order, 0, -1):  # the small terms first
            increment += series[k, i]
        _add(state, i, increment)


@njit
def _add(state: Floats, i: int, increment: float) -> None:
    # Knuth's two-sum: what rounding takes from the sum goes into the carry.
    increment += state[7 + i]
    total = state[i] + increment
    added = total - state[i]
    state[7 + i] = (state[i] - (total - added)) + (increment - added)
    state[i] = total


@njit
def _restore_norm(state: Floats) -> None:
    excess = -1.0
    for i in range(3, 7):
        excess += state[i] * (state[i] + 2.0 * state[7 + i])
    root = math.sqrt(1.0 + excess)
    factor = -excess / (root * (1.0 + root))  # 1 / root - 1
    for i in range(3, 7):
        _add(state, i, factor * state[i])
