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
Closed-form solution for the torque-free motion of a rigid body.

The solution holds for any body and any start state, and one evaluation gives the state at any
time. In principal axes, the angular momentum m is an elliptic function of time. The attitude
depends on one more angle, which is an elliptic integral of the third kind. The formulas come from
Celledoni, Fasso, Saefstroem and Zanna, "The exact computation of the free rigid body motion and
its use in splitting methods", 2008, with the corrections in Principia's `Celledoni.tex`. We have
rearranged them so that nothing cancels:

    m = (B1 cn u, -B2 sn u, B3 dn u),   u = u0 + lambda t,
    q(t) = q(0) conj(P(0)) exp(psi e3 / 2) P(t),

where P is the shortest rotation from m to axis 3. The axes are numbered so that m always stays in
the half space around axis 3. This makes axis 3 the axis of the largest moment or, on the other
side of the separatrix, the axis of the smallest moment. With G = |m|,
n = -I3 (I2 - I1) / (I1 (I3 - I2)) and C = G (I3 - I1) / (lambda I1 I3),

    psi = (G / I3) t + [C Pi(n; u) + atan2(sqrt(1 - n) sn u, cn u)] from u0 to u,
    Pi(n; u) = u + n sn^3 R_J(cn^2, dn^2, 1, 1 - n sn^2) / 3                   if n >= -1,
    Pi(n; u) = atan2(g sn u, cn u dn u) / g
               - k^2 sn^3 R_J(cn^2, dn^2, 1, 1 - k^2 sn^2 / n) / (3 n),
               g^2 = (1 - n) (1 - k^2 / n)                                     if n < -1,

with Carlson's integral R_J and the elliptic parameter k^2. The two forms of Pi are related by
DLMF 19.21.12. If n >= -1, C u and (G / I3) t add up to (G / I1) t. The half period, and the amount
by which psi grows in a half period, are computed to 32 digits, because over a long motion the
errors of these two numbers are multiplied by the number of half periods.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels import elementary, elliptic, four
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    combine,
    dot,
    KernelState,
    multiply,
    of,
    PrincipalFrame,
    Quaternion,
    scale,
    Vector,
)

#: The relative rounding error of 32-digit numbers, and the largest relative error of m_c that we
#: accept. Near the separatrix, m_c is the difference between two nearly equal 32-digit
#: numbers. If its error is larger than we accept, the Taylor series is more accurate than the
#: closed form.
_ROUNDING, _ACCEPTED = 1e-31, 1e-12
#: If Delta_1 or Delta_3 is below this value, we treat the motion as a rotation about a principal
#: axis.
_NEGLIGIBLE = 1e-70
#: If a double-double is below this value, its low-order part may be too small for a double.
_UNDERFLOW = 1e-250

NEAR_SEPARATRIX, STEADY, PERIODIC, SEPARATRIX = range(4)
_ZERO = (0.0, 0.0)
_ONE = (1.0, 0.0)

Triple = tuple[DoubleDouble, DoubleDouble, DoubleDouble]


class Motion(NamedTuple):
    """The constants that describe a torque-free motion, along canonical axes in scaled units."""

    kind: int
    start: KernelState
    #: The unit of all rates in this record, 1/s. It is a power of two.
    scale: float
    #: The unit vectors along the canonical axes, each given by its components in body axes.
    axes: tuple[Vector, Vector, Vector]
    #: The amplitudes of the components of the angular velocity, and the amplitudes of the
    #: components of the unit vector along m.
    rates: Vector
    directions: Vector
    #: The complementary parameter m_c, the characteristic n, and C.
    complement: float
    n: float
    factor: float
    #: u0, measured from the nearest zero of sn, and whether cn is negative at the start.
    phase: float
    cn_negative: bool
    #: lambda, the half period 2 K, the rate of the linear part of psi, and the amount by which the
    #: rest of psi grows in a half period, rad.
    speed: DoubleDouble
    half_period: DoubleDouble
    psi_rate: DoubleDouble
    psi_increment: DoubleDouble


class _Principal(NamedTuple):
    """The motion of a body at one time, described along its principal axes in scaled units."""

    rates: Triple
    momentum: Triple
    #: I w^2 for each axis. The sum over the axes is twice the kinetic energy.
    energies: Triple
    moments: Triple
    #: The unit vectors along the principal axes, each given by its components in body axes.
    axes: tuple[Vector, Vector, Vector]
    #: Unit of the rates, 1/s.
    scale: float
    #: 1 if the moments ascend from axis 1 to axis 3, and -1 if they descend.
    sign: float


class _Invariants(NamedTuple):
    """
    The invariants that determine the kind of a motion.

    As in the paper, Delta_k = G^2 - 2 T I_k, where G is the angular momentum and T the kinetic
    energy. Each Delta_k is computed as a sum of two terms, and only the two terms of Delta_2 can
    cancel each other.
    """

    #: |I2 - I1|, |I3 - I1| and |I3 - I2|.
    i21: DoubleDouble
    i31: DoubleDouble
    i32: DoubleDouble
    #: |Delta_1|, Delta_2, and |Delta_3|. Delta_2 is negative if the axes must be renumbered.
    delta_1: DoubleDouble
    delta_2: DoubleDouble
    delta_3: DoubleDouble


@internal
def prepare(state: KernelState, frame: PrincipalFrame) -> Motion:
    """
    Compute the constants of the torque-free motion from a start state.

    Parameters
    ----------
    state : KernelState
        The state at the start of the motion.
    frame : PrincipalFrame
        The principal moments and axes of the body.

    Returns
    -------
    Motion
        The motion, which you can evaluate with `at`. If the kind of the motion is NEAR_SEPARATRIX,
        the closed form cannot be used. Such a motion is not on the separatrix, but so close to the
        separatrix that rounding in the 32nd digit makes the closed form inaccurate.

    """
    body = _principal(state, frame)
    invariants = _invariants(body)
    if _is_steady(body.rates, invariants):
        return start_only(state, STEADY)
    if _is_near_separatrix(body, invariants, frame):
        return start_only(state, NEAR_SEPARATRIX)
    body, invariants = _renumber_axes(body, invariants)
    return _canonical(state, body, invariants)


@internal
def start_only(state: KernelState, kind: int) -> Motion:
    """
    Return a motion of kind STEADY or NEAR_SEPARATRIX.

    Motions of these two kinds need no constants besides the start state.
    """
    unit = (of(1.0, 0.0, 0.0), of(0.0, 1.0, 0.0), of(0.0, 0.0, 1.0))
    zero = of(0.0, 0.0, 0.0)
    return Motion(kind, state, 1.0, unit, zero, zero, 0.0, 0.0, 0.0, 0.0, False, _ZERO, _ZERO,
                  _ZERO, _ZERO)


@internal
def _invariants(body: _Principal) -> _Invariants:
    i, e = body.moments, body.energies
    i21, i31, i32 = dd.subtract(i[1], i[0]), dd.subtract(i[2], i[0]), dd.subtract(i[2], i[1])
    return _Invariants(i21, i31, i32,
                       dd.add(dd.multiply(e[1], i21), dd.multiply(e[2], i31)),
                       dd.subtract(dd.multiply(e[2], i32), dd.multiply(e[0], i21)),
                       dd.add(dd.multiply(e[0], i31), dd.multiply(e[1], i32)))


@internal
def _is_steady(w: Triple, invariants: _Invariants) -> bool:
    # Return whether the body turns about a principal axis.
    i21, i31, i32 = invariants.i21[0], invariants.i31[0], invariants.i32[0]
    return (i32 * w[1][0] * w[2][0] == i31 * w[2][0] * w[0][0] == i21 * w[0][0] * w[1][0] == 0
            or invariants.delta_1[0] < _NEGLIGIBLE or invariants.delta_3[0] < _NEGLIGIBLE)


@internal
def _is_near_separatrix(body: _Principal, invariants: _Invariants, frame: PrincipalFrame) -> bool:
    # Return whether rounding may have made the relative error of Delta_2 too large. Delta_2 is the
    # difference between two terms that may cancel each other.
    w, m, e = body.rates, body.momentum, body.energies
    i21, i32, delta_2 = invariants.i21[0], invariants.i32[0], invariants.delta_2[0]
    uncertain = terms = abs(e[2][0] * i32) + abs(e[0][0] * i21)
    if not _is_along_body_axes(frame):
        speed = abs(w[0][0]) + abs(w[1][0]) + abs(w[2][0])
        uncertain += speed * (abs(m[2][0] * i32) + abs(m[0][0] * i21))
    return terms < _UNDERFLOW or (
        delta_2 != 0.0 and _ROUNDING * uncertain > _ACCEPTED * abs(delta_2))


@internal
def _renumber_axes(body: _Principal, invariants: _Invariants) -> tuple[_Principal, _Invariants]:
    # Renumber the axes so that m always stays in the half space around axis 3.
    w, m, e, i, axes, scale, sign = body
    if invariants.delta_2[0] < 0.0:  # the new axes 3, -2, 1 reverse the sign of all differences
        i, e = (i[2], i[1], i[0]), (e[2], e[1], e[0])
        m, w = (m[2], dd.negative(m[1]), m[0]), (w[2], dd.negative(w[1]), w[0])
        axes, sign = (axes[2], four.negative(axes[1]), axes[0]), -1.0
        i21, i31, i32, delta_1, delta_2, delta_3 = invariants
        invariants = _Invariants(i32, i31, i21, delta_3, dd.negative(delta_2), delta_1)
    if m[2][0] < 0.0:
        m = (dd.negative(m[0]), m[1], dd.negative(m[2]))
        w = (dd.negative(w[0]), w[1], dd.negative(w[2]))
        axes = (four.negative(axes[0]), axes[1], four.negative(axes[2]))
    return _Principal(w, m, e, i, axes, scale, sign), invariants


@internal
def _canonical(state: KernelState, body: _Principal, invariants: _Invariants) -> Motion:
    i, m, sign = body.moments, body.momentum, body.sign
    _, i31, i32, delta_1, delta_2, delta_3 = invariants
    complement = dd.divide(dd.multiply(delta_2, i31), dd.multiply(delta_1, i32))
    kind = PERIODIC if complement[0] > 0.0 else SEPARATRIX
    momentum = dd.sqrt(dd.add(dd.multiply(m[0], m[0]),
                              dd.add(dd.multiply(m[1], m[1]), dd.multiply(m[2], m[2]))))
    speed = dd.sqrt(dd.divide(dd.multiply(delta_1, i32),
                              dd.multiply(dd.multiply(i[0], i[1]), i[2])))
    speed = (-sign * speed[0], -sign * speed[1])
    b = (dd.sqrt(dd.divide(dd.multiply(i[0], delta_3), i31)),
         dd.sqrt(dd.divide(dd.multiply(i[1], delta_3), i32)),
         dd.sqrt(dd.divide(dd.multiply(i[2], delta_1), i31)))
    n = dd.negative(dd.divide(dd.multiply(i[2], invariants.i21), dd.multiply(i[0], i32)))
    factor = dd.divide(dd.multiply(momentum, (sign * i31[0], sign * i31[1])),
                       dd.multiply(speed, dd.multiply(i[0], i[2])))
    half_period, psi_increment = _ZERO, _ZERO
    if kind == PERIODIC:
        half_period = _doubled(elliptic.complete(complement, _ONE, _ONE, _ONE))
        psi_increment = _psi_increment(complement, n, factor)
    cn_negative = m[0][0] < 0.0
    return Motion(
        kind, state, body.scale, body.axes,
        of(b[0][0] / i[0][0], b[1][0] / i[1][0], b[2][0] / i[2][0]),
        of(b[0][0] / momentum[0], b[1][0] / momentum[0], b[2][0] / momentum[0]),
        complement[0], n[0], factor[0],
        _phase(-m[1][0] / b[1][0], abs(m[0][0]) / b[0][0], cn_negative, complement[0]),
        cn_negative, speed, half_period,
        dd.divide(momentum, i[0] if n[0] >= -1.0 else i[2]), psi_increment)


@internal
def _psi_increment(complement: DoubleDouble, n: DoubleDouble,
                   factor: DoubleDouble) -> DoubleDouble:
    # Return the amount by which psi grows in a half period, apart from its linear part.
    p = dd.subtract(_ONE, n)
    if n[0] >= -1.0:
        integral = dd.multiply(n, elliptic.complete(complement, p, _ZERO, _ONE))
    else:
        integral = elliptic.complete(complement, p, _ONE, _ONE)
    return dd.add(_doubled(dd.multiply(factor, integral)), dd.PI)


@internal
def _phase(sine: float, cosine: float, cn_negative: bool, complement: float) -> float:
    # Compute u0 from sn and |cn| at u0. Normalize sn and cn first, because rounding has moved the
    # point (cn, sn) slightly off the unit circle.
    norm = dd.sqrt(dd.add(dd.two_product(sine, sine), dd.two_product(cosine, cosine)))[0]
    sine, cosine = (-sine / norm if cn_negative else sine / norm), cosine / norm
    return sine * elliptic.carlson_f(cosine * cosine, cosine * cosine
                                     + complement * sine * sine, 1.0)


@internal
def at(motion: Motion, span_ns: int) -> KernelState:
    """
    Return the state `span_ns` nanoseconds after the start of a motion.

    Do not call this function for a motion of kind NEAR_SEPARATRIX.
    """
    if motion.kind == STEADY:
        return _steady_rotation(motion, span_ns)
    t = dd.seconds(span_ns)
    t = (motion.scale * t[0], motion.scale * t[1])
    u = dd.add(dd.multiply(motion.speed, t), (motion.phase, 0.0))
    count = 0.0
    if motion.kind == PERIODIC:
        count = float(round(u[0] / motion.half_period[0]))
        u = dd.subtract(u, dd.multiply((count, 0.0), motion.half_period))
    psi = dd.add(dd.multiply(motion.psi_rate, t), dd.multiply((count, 0.0), motion.psi_increment))
    before, first, _ = _periodic_part(motion, motion.phase, motion.cn_negative)
    after, last, rates = _periodic_part(motion, u[0], motion.cn_negative != (count % 2.0 != 0.0))
    half = 0.5 * dd.add(_modulo_4_pi(psi), dd.two_sum(after, -before))[0]
    sine, cosine = elementary.sine_cosine(half)
    rotation = multiply(multiply(four.of(-first[0], -first[1], -first[2], first[3]),
                                 four.of(0.0, 0.0, sine, cosine)), last)
    x = combine(motion.axes, rotation)
    return _state(motion, combine(motion.axes, rates), four.of(x[0], x[1], x[2], rotation[3]))


@internal
def _periodic_part(motion: Motion, u: float,
                   cn_negative: bool) -> tuple[float, Quaternion, Vector]:
    # For |u| <= K, return the periodic part of psi, the quaternion P, and the angular velocity.
    sn, cn, dn = elliptic.jacobi(u, motion.complement)
    n, m, cube = motion.n, 1.0 - motion.complement, sn * sn * sn
    if motion.kind == SEPARATRIX:
        root = math.sqrt(-n)
        arc = elementary.arctangent(root * sn, 1.0)
        integral = (n * u + root * arc) / (1.0 - n) if n >= -1.0 else \
            (u + root * arc) / (1.0 - n)
    elif n >= -1.0:
        integral = n * cube * elliptic.carlson_j(cn * cn, dn * dn, 1.0, 1.0 - n * sn * sn) / 3.0
    else:
        g = math.sqrt((1.0 - n) * (1.0 - m / n))
        integral = elementary.arctangent(g * sn, cn * dn) / g - m * cube / (
            3.0 * n) * elliptic.carlson_j(cn * cn, dn * dn, 1.0, 1.0 - m * sn * sn / n)
    psi = motion.factor * integral + elementary.arctangent(math.sqrt(1.0 - n) * sn, cn)
    if cn_negative:
        sn, cn = -sn, -cn
    along = motion.directions
    cosine = math.sqrt(0.5 * (1.0 + along[2] * dn))
    tilt = four.of(-0.5 * along[1] * sn / cosine, -0.5 * along[0] * cn / cosine, 0.0, cosine)
    return psi, tilt, four.multiply(scale(motion.scale, motion.rates), of(cn, -sn, dn))


@internal
def _steady_rotation(motion: Motion, span_ns: int) -> KernelState:
    w, low = motion.start[0], motion.start[2]
    square = _ZERO
    for k in range(3):
        square = dd.add(square, dd.multiply((w[k], low[k]), (w[k], low[k])))
    speed = dd.sqrt(square)
    if speed[0] == 0.0:
        return motion.start
    half = 0.5 * _modulo_4_pi(dd.multiply(speed, dd.seconds(span_ns)))[0]
    sine, cosine = elementary.sine_cosine(half)
    return _state(motion, w, add(scale(sine / speed[0], w), four.of(0.0, 0.0, 0.0, cosine)))


@internal
def _state(motion: Motion, w: Vector, rotation: Quaternion) -> KernelState:
    # Return the state with the rates `w` and the attitude q R, where q is the attitude at the
    # start, and R is the rotation since the start.
    _, q, _, low = motion.start
    q = add(multiply(q, rotation), multiply(low, rotation))
    return w, add_scaled(q, -0.5 * (dot(q, q) - 1.0), q), four.broadcast(0.0), four.broadcast(0.0)


@internal
def _principal(state: KernelState, frame: PrincipalFrame) -> _Principal:
    # Scale the rates and moments to about 1. Otherwise fourth powers of the rates or products of
    # the moments might leave the range of doubles.
    w, low = state[0], state[2]
    high, low_moments, axes, low_axes = frame
    scale = _power_of_two(max(abs(w[0]), abs(w[1]), abs(w[2])))
    size = _power_of_two(high[2])
    v = ((w[0] / scale, low[0] / scale), (w[1] / scale, low[1] / scale),
         (w[2] / scale, low[2] / scale))
    i = ((high[0] / size, low_moments[0] / size), (high[1] / size, low_moments[1] / size),
         (high[2] / size, low_moments[2] / size))
    rates = (_component(v, axes[0], low_axes[0]), _component(v, axes[1], low_axes[1]),
             _component(v, axes[2], low_axes[2]))
    m = (dd.multiply(i[0], rates[0]), dd.multiply(i[1], rates[1]), dd.multiply(i[2], rates[2]))
    e = (dd.multiply(m[0], rates[0]), dd.multiply(m[1], rates[1]), dd.multiply(m[2], rates[2]))
    return _Principal(rates, m, e, i, axes, scale, 1.0)


@internal
def _power_of_two(value: float) -> float:
    # Return the largest power of two that does not exceed the value. If the value is below
    # 2^-1000, return 2^-1000, and if it is zero, return 1.
    return math.ldexp(1.0, max(math.frexp(value)[1] - 1, -1000)) if value > 0.0 else 1.0


@internal
def _component(v: Triple, axis: Vector, low: Vector) -> DoubleDouble:
    total = dd.multiply((axis[0], low[0]), v[0])
    total = dd.add(total, dd.multiply((axis[1], low[1]), v[1]))
    return dd.add(total, dd.multiply((axis[2], low[2]), v[2]))


@internal
def _is_along_body_axes(frame: PrincipalFrame) -> bool:
    # Return whether the principal axes coincide with the body axes. If they coincide, products
    # with the components of the axes are exact.
    total = 0.0
    for axis in frame[2]:
        total += abs(axis[0]) + abs(axis[1]) + abs(axis[2])
    return total == 3.0


@internal
def _modulo_4_pi(angle: DoubleDouble) -> DoubleDouble:
    # Reduce the angle by a multiple of 4 pi, because a quaternion repeats after two turns.
    turns = float(round(angle[0] / (4.0 * dd.PI[0])))
    return dd.subtract(angle, dd.multiply((4.0 * turns, 0.0), dd.PI))


@internal
def _doubled(a: DoubleDouble) -> DoubleDouble:
    return 2.0 * a[0], 2.0 * a[1]
