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
Classical one-step methods with fixed steps, for comparing speed and accuracy.

The drive is a polynomial in the fraction of the step, as in `taylor.step`. None of the methods
compensates for rounding errors, so each one has the same rounding errors as a textbook
implementation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numpy.typing import NDArray
from rigid_body_ros.kernels import elementary, fields, four, lags
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.linear_terms import Matrix, Momentum, product
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    Coefficients,
    combine,
    cross,
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


class StageLoads(NamedTuple):
    """
    What acts during a step besides the drive.

    The variable of all polynomials is the fraction of the step.
    """

    #: The rotor momentum, N m s, body axes.
    momentum: Momentum
    #: The damping matrix J^-1 D, 1/s.
    damping: Matrix
    #: The torque in space axes, N m.
    space_torque: Polynomial
    #: The fields, or None if the scene has none (see `fields.FIELDS`). The next two attributes are
    #: the orbit angle at the beginning of the step (see `fields.angle_at`) and the length of the
    #: step, s.
    fields: NDArray[Any] | None
    field_angle: DoubleDouble
    seconds: float
    #: The torques that lag their commands, or None if the scene has none. The next attribute is
    #: the time from the beginning of the row to the beginning of the step, s.
    lags: lags.RowLags | None
    since: float


@internal
def explicit_euler(state: KernelState, seconds: float, equations: Coefficients, drive: Polynomial,
                   in_space: bool, loads: StageLoads | None) -> KernelState:
    """Return the state after one step of Euler's method (order 1), normalizing the quaternion."""
    w, q = state[0], state[1]
    a, v = _derivative(w, q, 0.0, equations, drive, in_space, loads)
    return _state(add_scaled(w, seconds, a), add_scaled(q, seconds, v))


@internal
def rk4(state: KernelState, seconds: float, equations: Coefficients, drive: Polynomial,
        in_space: bool, loads: StageLoads | None) -> KernelState:
    """
    Return the state after one step of Kutta's method (1901), normalizing the quaternion.

    The method has order 4 and is commonly known as RK4.
    """
    w, q = state[0], state[1]
    a1, v1 = _derivative(w, q, 0.0, equations, drive, in_space, loads)
    half = 0.5 * seconds
    a2, v2 = _derivative(add_scaled(w, half, a1), add_scaled(q, half, v1), 0.5, equations, drive,
                         in_space, loads)
    a3, v3 = _derivative(add_scaled(w, half, a2), add_scaled(q, half, v2), 0.5, equations, drive,
                         in_space, loads)
    a4, v4 = _derivative(add_scaled(w, seconds, a3), add_scaled(q, seconds, v3), 1.0, equations,
                         drive, in_space, loads)
    a = add(add(a1, a4), scale(2.0, add(a2, a3)))
    v = add(add(v1, v4), scale(2.0, add(v2, v3)))
    sixth = seconds / 6.0
    return _state(add_scaled(w, sixth, a), add_scaled(q, sixth, v))


@internal
def strang(state: KernelState, seconds: float, equations: Coefficients, frame: PrincipalFrame,
           drive: Polynomial, in_space: bool, loads: StageLoads | None) -> KernelState:
    """
    Return the state after one step of a splitting method (order 2).

    The method splits the step symmetrically into rotations about the principal axes, and computes
    each rotation exactly. Without torque, it therefore conserves the angular momentum in space to
    within rounding errors, and the energy error stays bounded (McLachlan 1993; Reich 1994; Touma
    and Wisdom 1994). The torque is applied as two kicks of half a step each, one before the
    rotations and one after them (Strang). Rotors and damping are ignored.
    """
    w, q = state[0], state[1]
    half = 0.5 * seconds
    w = add_scaled(w, half, _torque_acceleration(q, 0.0, equations, drive, in_space, loads))
    moments, _, axes, _ = frame
    i, j, k = moments[0], moments[1], moments[2]
    m = of(i * dot(axes[0], w), j * dot(axes[1], w), k * dot(axes[2], w))
    rotation = four.of(0.0, 0.0, 0.0, 1.0)
    m, rotation = _rotate_about_1(m, rotation, half / i)
    m, rotation = _rotate_about_2(m, rotation, half / j)
    m, rotation = _rotate_about_3(m, rotation, seconds / k)
    m, rotation = _rotate_about_2(m, rotation, half / j)
    m, rotation = _rotate_about_1(m, rotation, half / i)
    w = combine(axes, of(m[0] / i, m[1] / j, m[2] / k))
    x = combine(axes, rotation)
    q = _unit(multiply(q, four.of(x[0], x[1], x[2], rotation[3])))
    kick = _torque_acceleration(q, 1.0, equations, drive, in_space, loads)
    return _state(add_scaled(w, half, kick), q)


@internal
def _derivative(w: Vector, q: Quaternion, fraction: float, equations: Coefficients,
                drive: Polynomial, in_space: bool,
                loads: StageLoads | None) -> tuple[Vector, Quaternion]:
    columns = equations.columns
    rate = _torque_acceleration(q, fraction, equations, drive, in_space, loads)
    rate = add(rate, combine(columns[:3], four.multiply(four.yzx(w), four.zxy(w))))
    rate = add(rate, combine(columns[3:6], four.multiply(w, w)))
    if loads is not None:
        a, b, c, d, e = loads.momentum
        h = add_scaled(a, fraction, add_scaled(b, fraction, add_scaled(c, fraction, add_scaled(
            d, fraction, e))))
        rate = add(rate, combine(columns[6:], cross(h, w)))
        rate = four.subtract(rate, product(loads.damping, w))
    return rate, multiply(q, scale(0.5, w))


@internal
def _torque_acceleration(q: Quaternion, fraction: float, equations: Coefficients,
                         drive: Polynomial, in_space: bool, loads: StageLoads | None) -> Vector:
    inverse, value = equations.columns[6:], _at(drive, fraction)
    if in_space:
        value = combine(inverse, to_body(_unit(q), value))
    if loads is None:
        return value
    if not in_space:
        torque = to_body(_unit(q), _at(loads.space_torque, fraction))
        value = add(value, combine(inverse, torque))
    seconds = fraction * loads.seconds
    if loads.lags is not None:
        torque = lags.torque(loads.lags, loads.since + seconds, _unit(q))
        value = add(value, combine(inverse, torque))
    if loads.fields is not None:
        angle = fields.turned_on(loads.field_angle, loads.fields[0].mean_motion, seconds)
        value = add(value, fields.acceleration(loads.fields, angle, _unit(q), equations))
    return value


@internal
def _at(polynomial: Polynomial, fraction: float) -> Vector:
    a, b, c, d = polynomial
    return add_scaled(a, fraction, add_scaled(b, fraction, add_scaled(c, fraction, d)))


@internal
def _unit(q: Quaternion) -> Quaternion:
    return scale(1.0 / math.sqrt(dot(q, q)), q)


@internal
def _state(w: Vector, q: Quaternion) -> KernelState:
    return w, _unit(q), four.broadcast(0.0), four.broadcast(0.0)


@internal
def _rotate_about_1(m: Vector, rotation: Quaternion, step: float) -> tuple[Vector, Quaternion]:
    # If the kinetic energy is just m1^2 / (2 I1), the motion is a rotation of the body about
    # axis 1.
    sine, cosine, s, c = _sines_cosines(step * m[0])
    return (of(m[0], c * m[1] + s * m[2], c * m[2] - s * m[1]),
            multiply(rotation, four.of(sine, 0.0, 0.0, cosine)))


@internal
def _rotate_about_2(m: Vector, rotation: Quaternion, step: float) -> tuple[Vector, Quaternion]:
    sine, cosine, s, c = _sines_cosines(step * m[1])
    return (of(c * m[0] - s * m[2], m[1], c * m[2] + s * m[0]),
            multiply(rotation, four.of(0.0, sine, 0.0, cosine)))


@internal
def _rotate_about_3(m: Vector, rotation: Quaternion, step: float) -> tuple[Vector, Quaternion]:
    sine, cosine, s, c = _sines_cosines(step * m[2])
    return (of(c * m[0] + s * m[1], c * m[1] - s * m[0], m[2]),
            multiply(rotation, four.of(0.0, 0.0, sine, cosine)))


@internal
def _sines_cosines(angle: float) -> tuple[float, float, float, float]:
    sine, cosine = elementary.sine_cosine(0.5 * angle)
    return sine, cosine, 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
