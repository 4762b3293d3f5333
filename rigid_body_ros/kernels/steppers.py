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
Classical one-step methods of fixed step, for the trade of speed against accuracy.

The drive is a polynomial in the fraction of the step, as for `taylor.step`. None carries rounding
errors along: what they lose is what a program loses that uses them.
"""

from __future__ import annotations

import math

from rigid_body_ros.kernels import elementary, four
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    Coefficients,
    combine,
    dot,
    KernelState,
    multiply,
    of,
    Polynomial,
    PrincipalFrame,
    Quaternion,
    scale,
    to_body,
    Vector,
)


@internal
def explicit_euler(state: KernelState, seconds: float, equations: Coefficients, drive: Polynomial,
                   in_space: bool) -> KernelState:
    """Return the state after a step of Euler's method, order 1; conserves the norm of q only."""
    w, q = state[0], state[1]
    a, v = _derivative(w, q, 0.0, equations, drive, in_space)
    return _state(add_scaled(w, seconds, a), add_scaled(q, seconds, v))


@internal
def rk4(state: KernelState, seconds: float, equations: Coefficients, drive: Polynomial,
        in_space: bool) -> KernelState:
    """
    Return the state after a step of the classical Runge-Kutta method, order 4.

    Conserves the norm of q only, which is restored after the step.
    """
    w, q = state[0], state[1]
    half = 0.5 * seconds
    a1, v1 = _derivative(w, q, 0.0, equations, drive, in_space)
    a2, v2 = _derivative(add_scaled(w, half, a1), add_scaled(q, half, v1), 0.5, equations, drive,
                         in_space)
    a3, v3 = _derivative(add_scaled(w, half, a2), add_scaled(q, half, v2), 0.5, equations, drive,
                         in_space)
    a4, v4 = _derivative(add_scaled(w, seconds, a3), add_scaled(q, seconds, v3), 1.0, equations,
                         drive, in_space)
    a = add(add(a1, a4), scale(2.0, add(a2, a3)))
    v = add(add(v1, v4), scale(2.0, add(v2, v3)))
    return _state(add_scaled(w, seconds / 6.0, a), add_scaled(q, seconds / 6.0, v))


@internal
def strang(state: KernelState, seconds: float, equations: Coefficients, frame: PrincipalFrame,
           drive: Polynomial, in_space: bool) -> KernelState:
    """
    Return the state after a symmetric splitting into rotations about principal axes, order 2.

    Each rotation is exact, so that without torque the angular momentum in space is conserved to
    rounding and the energy error stays bounded (McLachlan 1993; Reich 1994; Touma and Wisdom
    1994). A torque kicks before and after (Strang).
    """
    w, q = state[0], state[1]
    half = 0.5 * seconds
    w = add_scaled(w, half, _push(q, 0.0, equations, drive, in_space))
    moments, _, axes, _ = frame
    i, j, k = moments[0], moments[1], moments[2]
    m = of(i * dot(axes[0], w), j * dot(axes[1], w), k * dot(axes[2], w))
    turn = four.of(0.0, 0.0, 0.0, 1.0)
    m, turn = _about_1(m, turn, half / i)
    m, turn = _about_2(m, turn, half / j)
    m, turn = _about_3(m, turn, seconds / k)
    m, turn = _about_2(m, turn, half / j)
    m, turn = _about_1(m, turn, half / i)
    w = combine(axes, of(m[0] / i, m[1] / j, m[2] / k))
    x = combine(axes, turn)
    q = _unit(multiply(q, four.of(x[0], x[1], x[2], turn[3])))
    return _state(add_scaled(w, half, _push(q, 1.0, equations, drive, in_space)), q)


@internal
def _derivative(w: Vector, q: Quaternion, fraction: float, equations: Coefficients,
                drive: Polynomial, in_space: bool) -> tuple[Vector, Quaternion]:
    columns = equations[0]
    rate = _push(q, fraction, equations, drive, in_space)
    rate = add(rate, combine(columns[:3], four.multiply(four.yzx(w), four.zxy(w))))
    rate = add(rate, combine(columns[3:6], four.multiply(w, w)))
    return rate, multiply(q, scale(0.5, w))


@internal
def _push(q: Quaternion, fraction: float, equations: Coefficients, drive: Polynomial,
          in_space: bool) -> Vector:
    # The angular acceleration by the torque.
    value = add_scaled(drive[0], fraction, add_scaled(drive[1], fraction, add_scaled(
        drive[2], fraction, drive[3])))
    return combine(equations[0][6:], to_body(_unit(q), value)) if in_space else value


@internal
def _unit(q: Quaternion) -> Quaternion:
    return scale(1.0 / math.sqrt(dot(q, q)), q)


@internal
def _state(w: Vector, q: Quaternion) -> KernelState:
    return w, _unit(q), four.broadcast(0.0), four.broadcast(0.0)


@internal
def _about_1(m: Vector, turn: Quaternion, step: float) -> tuple[Vector, Quaternion]:
    # The flow of the energy m1^2 / 2 I1: a rotation of the body about that axis.
    sine, cosine, s, c = _half_and_full(step * m[0])
    return (of(m[0], c * m[1] + s * m[2], c * m[2] - s * m[1]),
            multiply(turn, four.of(sine, 0.0, 0.0, cosine)))


@internal
def _about_2(m: Vector, turn: Quaternion, step: float) -> tuple[Vector, Quaternion]:
    sine, cosine, s, c = _half_and_full(step * m[1])
    return (of(c * m[0] - s * m[2], m[1], c * m[2] + s * m[0]),
            multiply(turn, four.of(0.0, sine, 0.0, cosine)))


@internal
def _about_3(m: Vector, turn: Quaternion, step: float) -> tuple[Vector, Quaternion]:
    sine, cosine, s, c = _half_and_full(step * m[2])
    return (of(c * m[0] + s * m[1], c * m[1] - s * m[0], m[2]),
            multiply(turn, four.of(0.0, 0.0, sine, cosine)))


@internal
def _half_and_full(angle: float) -> tuple[float, float, float, float]:
    sine, cosine = elementary.sine_cosine(0.5 * angle)
    return sine, cosine, 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
