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
Exact torque-free motion: any body, any start, any time in one evaluation.

In principal axes 1, 2, 3 the angular momentum m is an elliptic function of time; the attitude
needs one angle more, an integral of the third kind. Formulas as in Celledoni, Fasso, Saefstroem
and Zanna, "The exact computation of the free rigid body motion and its use in splitting
methods", 2008, with the corrections of Principia's `Celledoni.tex`, brought to a form in which
nothing cancels:

    m = (B1 cn u, -B2 sn u, B3 dn u),   u = u0 + lambda t,
    q(t) = q(0) conj(P(0)) exp(psi e3 / 2) P(t),

where P turns m to axis 3 the shortest way. The axes are named such that m stays in the half
space around axis 3: that of the largest moment, or, beyond the separatrix, that of the smallest.
With G = |m|, n = -I3 (I2 - I1) / (I1 (I3 - I2)) and C = G (I3 - I1) / (lambda I1 I3),

    psi = (G / I3) t + [C Pi(n; u) + atan2(sqrt(1 - n) sn u, cn u)] from u0 to u,
    Pi(n; u) = u + n sn^3 R_J(cn^2, dn^2, 1, 1 - n sn^2) / 3                   where n >= -1,
    Pi(n; u) = atan2(g sn u, cn u dn u) / g
               - m sn^3 R_J(cn^2, dn^2, 1, 1 - m sn^2 / n) / (3 n),
               g^2 = (1 - n) (1 - m / n)                                       where n < -1,

with Carlson's symmetric integrals (DLMF 19.21.12 leads from one line to the other). In the first
case C u and (G / I3) t together make (G / I1) t.

What grows with time is the number of half periods and the angle in each. These constants are
worked out with 32 digits, so that the error does not grow with time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels import elementary, elliptic, four
from rigid_body_ros.kernels.double_double import Double
from rigid_body_ros.kernels.jit import part
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    combine,
    dot,
    Frame,
    multiply,
    of,
    Quaternion,
    scale,
    State,
    Vector,
)

#: What rounding does to numbers of 32 digits, and how much of m_c, which near the separatrix is a
#: difference of such numbers, may be in doubt: a step by step solution would be further off.
_ROUNDING, _DOUBT = 1e-31, 1e-12
#: Of the energy, the part of the other two axes, below which a body turns about one.
_NOTHING = 1e-70
#: The second half of 32 digits leaves the range of doubles below.
_UNDERFLOW = 1e-250

LOST, STEADY, PERIODIC, SEPARATRIX = range(4)
_ZERO = (0.0, 0.0)
_ONE = (1.0, 0.0)

Doubles = tuple[Double, Double, Double]


class Motion(NamedTuple):
    """A torque-free motion: what does not change with time. Canonical axes, scaled units."""

    kind: int
    start: State
    #: Of all rates here, 1/s: a power of two.
    scale: float
    #: The canonical axes in body components, as rows.
    axes: tuple[Vector, Vector, Vector]
    #: Amplitudes of the angular velocity, and of the unit vector along m.
    rates: Vector
    directions: Vector
    complement: float
    n: float
    factor: float
    phase: float
    odd: bool
    #: lambda; 2 K; the linear part of psi; what each half period adds: rad, and rad over time.
    speed: Double
    half_period: Double
    drift: Double
    gain: Double


@part
def prepare(state: State, frame: Frame) -> Motion:
    """
    Return the torque-free motion from a state on.

    Parameters
    ----------
    state : State
        From which `at` counts the time.
    frame : Frame
        Principal moments and axes of the body.

    Returns
    -------
    Motion
        Of kind LOST where the form has lost its digits: so near the separatrix, but not on it,
        that rounding in the 32nd digit shows.

    """
    w, m, i, scale = _principal(state, frame)
    d21, d31, d32 = (dd.subtract(i[1], i[0]), dd.subtract(i[2], i[0]), dd.subtract(i[2], i[1]))
    if d32[0] * w[1][0] * w[2][0] == d31[0] * w[2][0] * w[0][0] == d21[0] * w[0][0] * w[1][0] == 0:
        return unchanging(state, STEADY)
    e = (dd.multiply(m[0], w[0]), dd.multiply(m[1], w[1]), dd.multiply(m[2], w[2]))
    first = dd.add(dd.multiply(e[1], d21), dd.multiply(e[2], d31))
    second = dd.subtract(dd.multiply(e[2], d32), dd.multiply(e[0], d21))
    third = dd.add(dd.multiply(e[0], d31), dd.multiply(e[1], d32))
    speed = abs(w[0][0]) + abs(w[1][0]) + abs(w[2][0])
    unsure = near = abs(e[2][0] * d32[0]) + abs(e[0][0] * d21[0])
    if not _along_body_axes(frame):
        unsure += speed * (abs(m[2][0] * d32[0]) + abs(m[0][0] * d21[0]))
    if first[0] < _NOTHING or third[0] < _NOTHING:
        return unchanging(state, STEADY)
    if near < _UNDERFLOW or (second[0] != 0.0 and _ROUNDING * unsure > _DOUBT * abs(second[0])):
        return unchanging(state, LOST)
    rows = frame[2]
    if second[0] < 0.0:  # axes 3, -2, 1; all differences change their signs
        i, m = (i[2], i[1], i[0]), (m[2], dd.negative(m[1]), m[0])
        rows = (rows[2], four.negative(rows[1]), rows[0])
        d21, d31, d32 = d32, d31, d21
        first, second, third = third, dd.negative(second), first
        sign = -1.0
    else:
        sign = 1.0
    if m[2][0] < 0.0:
        m = (dd.negative(m[0]), m[1], dd.negative(m[2]))
        rows = (four.negative(rows[0]), rows[1], four.negative(rows[2]))
    return _canonical(state, scale, i, m, rows, d21, d31, d32, first, second, third, sign)


@part
def _canonical(state: State, scale: float, i: Doubles, m: Doubles,
               rows: tuple[Vector, Vector, Vector], d21: Double, d31: Double, d32: Double,
               first: Double, second: Double, third: Double, sign: float) -> Motion:
    # The differences, and their combinations with the energy, are taken as positive; `sign` is
    # that of the moments along the canonical axes.
    complement = dd.divide(dd.multiply(second, d31), dd.multiply(first, d32))
    kind = PERIODIC if complement[0] > 0.0 else SEPARATRIX
    momentum = dd.root(dd.add(dd.multiply(m[0], m[0]),
                              dd.add(dd.multiply(m[1], m[1]), dd.multiply(m[2], m[2]))))
    product = dd.multiply(dd.multiply(i[0], i[1]), i[2])
    speed = dd.root(dd.divide(dd.multiply(first, d32), product))
    speed = (-sign * speed[0], -sign * speed[1])
    b = (dd.root(dd.divide(dd.multiply(i[0], third), d31)),
         dd.root(dd.divide(dd.multiply(i[1], third), d32)),
         dd.root(dd.divide(dd.multiply(i[2], first), d31)))
    n = dd.negative(dd.divide(dd.multiply(i[2], d21), dd.multiply(i[0], d32)))
    factor = dd.divide(dd.multiply(momentum, (sign * d31[0], sign * d31[1])),
                       dd.multiply(speed, dd.multiply(i[0], i[2])))
    half_period, gain = _ZERO, _ZERO
    if kind == PERIODIC:
        half_period = _double(elliptic.complete(complement, _ONE, _ONE, _ONE))
        p = dd.subtract(_ONE, n)
        if n[0] >= -1.0:
            gain = dd.multiply(n, elliptic.complete(complement, p, _ZERO, _ONE))
        else:
            gain = elliptic.complete(complement, p, _ONE, _ONE)
        gain = dd.add(_double(dd.multiply(factor, gain)), dd.PI)
    odd = m[0][0] < 0.0
    sine, cosine = -m[1][0] / b[1][0], abs(m[0][0]) / b[0][0]
    norm = dd.root(dd.add(dd.two_product(sine, sine), dd.two_product(cosine, cosine)))[0]
    sine, cosine = (-sine / norm if odd else sine / norm), cosine / norm
    phase = sine * elliptic.carlson_f(cosine * cosine, cosine * cosine
                                      + complement[0] * sine * sine, 1.0)
    return Motion(
        kind, state, scale, rows,
        of(b[0][0] / i[0][0], b[1][0] / i[1][0], b[2][0] / i[2][0]),
        of(b[0][0] / momentum[0], b[1][0] / momentum[0], b[2][0] / momentum[0]),
        complement[0], n[0], factor[0], phase, odd, speed, half_period,
        dd.divide(momentum, i[0] if n[0] >= -1.0 else i[2]), gain)


@part
def unchanging(state: State, kind: int) -> Motion:
    """Return a motion of kind STEADY or LOST: it says no more than its start."""
    unit = (of(1.0, 0.0, 0.0), of(0.0, 1.0, 0.0), of(0.0, 0.0, 1.0))
    none = of(0.0, 0.0, 0.0)
    return Motion(kind, state, 1.0, unit, none, none, 0.0, 0.0, 0.0, 0.0, False, _ZERO, _ZERO,
                  _ZERO, _ZERO)


@part
def at(motion: Motion, span_ns: int) -> State:
    """Return the state a number of nanoseconds after the start; the motion must not be LOST."""
    if motion.kind == STEADY:
        return _turned(motion, span_ns)
    t = dd.seconds(span_ns)
    t = (motion.scale * t[0], motion.scale * t[1])
    u = dd.add(dd.multiply(motion.speed, t), (motion.phase, 0.0))
    count = 0.0
    if motion.kind == PERIODIC:
        count = float(round(u[0] / motion.half_period[0]))
        u = dd.subtract(u, dd.multiply((count, 0.0), motion.half_period))
    psi = dd.add(dd.multiply(motion.drift, t), dd.multiply((count, 0.0), motion.gain))
    before, first, _ = _reduced(motion, motion.phase, motion.odd)
    after, last, rates = _reduced(motion, u[0], motion.odd != (count % 2.0 != 0.0))
    half = 0.5 * dd.add(_modulo(psi), dd.two_sum(after, -before))[0]
    sine, cosine = elementary.sine_cosine(half)
    turn = multiply(multiply(four.of(-first[0], -first[1], -first[2], first[3]),
                             four.of(0.0, 0.0, sine, cosine)), last)
    x = combine(motion.axes, turn)
    return _state(motion, combine(motion.axes, rates), four.of(x[0], x[1], x[2], turn[3]))


@part
def _reduced(motion: Motion, u: float, odd: bool) -> tuple[float, Quaternion, Vector]:
    # The periodic part of psi, P, and the angular velocity, for |u| <= K.
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
    if odd:
        sn, cn = -sn, -cn
    along = motion.directions
    cosine = math.sqrt(0.5 * (1.0 + along[2] * dn))
    tilt = four.of(-0.5 * along[1] * sn / cosine, -0.5 * along[0] * cn / cosine, 0.0, cosine)
    return psi, tilt, four.multiply(scale(motion.scale, motion.rates), of(cn, -sn, dn))


@part
def _turned(motion: Motion, span_ns: int) -> State:
    w, low = motion.start[0], motion.start[2]
    square = _ZERO
    for k in range(3):
        square = dd.add(square, dd.multiply((w[k], low[k]), (w[k], low[k])))
    speed = dd.root(square)
    if speed[0] == 0.0:
        return motion.start
    half = 0.5 * _modulo(dd.multiply(speed, dd.seconds(span_ns)))[0]
    sine, cosine = elementary.sine_cosine(half)
    return _state(motion, w, add(scale(sine / speed[0], w), four.of(0.0, 0.0, 0.0, cosine)))


@part
def _state(motion: Motion, w: Vector, turn: Quaternion) -> State:
    _, q, _, low = motion.start
    q = add(multiply(q, turn), multiply(low, turn))
    return w, add_scaled(q, -0.5 * (dot(q, q) - 1.0), q), four.every(0.0), four.every(0.0)


@part
def _principal(state: State, frame: Frame) -> tuple[Doubles, Doubles, Doubles, float]:
    # Angular velocity, angular momentum and moments along the principal axes, all about 1, and
    # the scale of the rates: neither fourth powers nor products of moments leave the range then.
    w, low = state[0], state[2]
    high, low_moments, axes, rest = frame
    scale = _power_of_two(max(abs(w[0]), abs(w[1]), abs(w[2])))
    size = _power_of_two(high[2])
    v = ((w[0] / scale, low[0] / scale), (w[1] / scale, low[1] / scale),
         (w[2] / scale, low[2] / scale))
    moments = ((high[0] / size, low_moments[0] / size), (high[1] / size, low_moments[1] / size),
               (high[2] / size, low_moments[2] / size))
    rates = (_along(v, axes[0], rest[0]), _along(v, axes[1], rest[1]), _along(v, axes[2], rest[2]))
    return rates, (dd.multiply(moments[0], rates[0]), dd.multiply(moments[1], rates[1]),
                   dd.multiply(moments[2], rates[2])), moments, scale


@part
def _power_of_two(value: float) -> float:
    # No larger than a value, and at least half of it; within the range where nothing is lost.
    return math.ldexp(1.0, max(math.frexp(value)[1] - 1, -1000)) if value > 0.0 else 1.0


@part
def _along(v: Doubles, axis: Vector, rest: Vector) -> Double:
    total = dd.multiply((axis[0], rest[0]), v[0])
    total = dd.add(total, dd.multiply((axis[1], rest[1]), v[1]))
    return dd.add(total, dd.multiply((axis[2], rest[2]), v[2]))


@part
def _along_body_axes(frame: Frame) -> bool:
    # Products with noughts and ones are exact.
    total = 0.0
    for axis in frame[2]:
        total += abs(axis[0]) + abs(axis[1]) + abs(axis[2])
    return total == 3.0


@part
def _modulo(angle: Double) -> Double:
    # 4 pi is the period of a quaternion.
    turns = float(round(angle[0] / (4.0 * dd.PI[0])))
    return dd.subtract(angle, dd.multiply((4.0 * turns, 0.0), dd.PI))


@part
def _double(a: Double) -> Double:
    return 2.0 * a[0], 2.0 * a[1]
