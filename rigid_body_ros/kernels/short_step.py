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
A short step of Euler's equations and the attitude quaternion, of order 3 to 5.

If torque samples are close together, a step needs only a few terms of the Taylor series, and the
loops in `taylor.step` then take longer than the arithmetic. This module writes the terms out
without loops. For the attitude, it integrates the rotation vector instead of the quaternion:

    d theta / dt = w + theta x w / 2 + theta x (theta x w) / 12 + ...

(Bortz, "A new mathematical formulation for strapdown inertial navigation", 1971.)
"""

from __future__ import annotations

from typing import NamedTuple

from rigid_body_ros.kernels import four, lanes, linear_terms
from rigid_body_ros.kernels.euler_equations import (
    acceleration_from_torque,
    add_jacobian,
    add_symmetric_products,
    gyroscopic_acceleration,
    Products,
    products,
    symmetric_products,
)
from rigid_body_ros.kernels.jit import inlined, optional
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.linear_terms import add_product, Matrix, multiple, product
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    advance,
    Coefficients,
    cross,
    dot,
    KernelState,
    Quaternion,
    scale,
    to_body,
    total,
    Vector,
)

#: Bounds on the local error of a step that turns by one radian, at order 3, 4 and 5. The bounds
#: are far above the actual error of a step, because an error in w goes on to cause attitude
#: errors, which add up and grow with the square of the time.
_ERROR_3 = 0.5
_ERROR_4 = 0.2
_ERROR_5 = 0.1
#: Powers of the error bounds, written as products because Python's ** would call the pow function
#: of the C library.
_SQUARE_3, _SQUARE_5 = _ERROR_3 * _ERROR_3, _ERROR_5 * _ERROR_5
_FOURTH_4 = (_ERROR_4 * _ERROR_4) * (_ERROR_4 * _ERROR_4)
#: The error bounds hold if the squared size of the step is below this value, rad^4. The kernels
#: never consider a larger step accurate.
_LARGEST = 1e-4


class HeldLoads(NamedTuple):
    """What acts during a step besides the torque in body axes. All torques are held."""

    #: The matrix A of the linear terms, 1/s.
    linear: linear_terms.Linear
    #: Whether there are any rotors or any damping.
    is_linear: bool
    #: How much the rotor momentum changes during the step, N m s. None if the momentum is
    #: constant.
    rotor_change: Vector | None
    #: The torque in space axes, N m. None if no step in the scene has such a torque.
    space_torque: Vector | None
    #: `linear_terms.square_rate` of the matrix, 1/s^2, and the square of an upper bound on the
    #: remaining accelerations, rad^2/s^4.
    square_rate: float
    square_acceleration: float


class _Acting(NamedTuple):
    """What acts during a step. A part that the step does not have is None."""

    #: The angular velocity at the start of the step, in radians per step.
    u0: Vector
    #: See `_jacobian`. None if there are neither rotors nor damping.
    jacobian: Matrix | None
    #: See `HeldLoads`.
    rotor_change: Vector | None
    space_torque: Vector | None


@inlined
def is_accurate(state: KernelState, seconds: float, torque_acceleration: Vector,
                tolerance: float, loads: HeldLoads | None) -> bool:
    """
    Return whether a single short step meets the tolerance.

    The torque in body axes must be held during the step.

    Parameters
    ----------
    state : KernelState
        The state at the start of the step. Only its angular velocity is used.
    seconds : float
        The length of the step, s.
    torque_acceleration : Vector
        The acceleration J^-1 tau, rad/s^2, body axes.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned.
    loads : HeldLoads or None
        What acts besides the torque, or None if the scene has no other terms.

    Returns
    -------
    bool

    """
    size, error_bound = _size_and_bound(state, seconds, torque_acceleration, tolerance, loads)
    return lanes.both(size < _LARGEST, _SQUARE_5 * (size * (size * size)) <= error_bound)


@inlined
def _size_and_bound(state: KernelState, seconds: float, torque_acceleration: Vector,
                    tolerance: float,
                    loads: HeldLoads | None) -> tuple[float, float]:
    # Return the squared size of a step, rad^4, and the squared error bound, rad^2. The function
    # returns squares, because taking square roots would add noticeably to the time of a short
    # step.
    factor = seconds * seconds
    square = dot(state[0], state[0])
    torque_part = factor * dot(torque_acceleration, torque_acceleration)
    error_bound = tolerance * tolerance * factor * fma(0.25, torque_part, square)
    if loads is not None:
        square += loads.square_rate
        torque_part = fma(factor, loads.square_acceleration, torque_part)
    return factor * fma(factor, square * square, torque_part), error_bound


@inlined
def step(state: KernelState, seconds: float, coefficients: Coefficients,
         torque_acceleration: Vector, tolerance: float,
         loads: HeldLoads | None) -> KernelState:
    """
    Return the state after one step of order 3, 4 or 5, as the tolerance requires.

    Parameters
    ----------
    state : KernelState
        The state at the start of the step.
    seconds : float
        The length of the step, s.
    coefficients : Coefficients
        The coefficients of Euler's equations.
    torque_acceleration : Vector
        The acceleration J^-1 tau, rad/s^2, body axes.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned.
    loads : HeldLoads or None
        What acts besides the torque, or None if the scene has no other terms.

    Returns
    -------
    KernelState

    """
    sizes = _size_and_bound(state, seconds, torque_acceleration, tolerance, loads)
    if loads is None:
        return _step(state, seconds, coefficients, torque_acceleration, sizes, None, None,
                     None)
    return _step_with(state, seconds, coefficients, torque_acceleration, sizes, loads,
                      loads.rotor_change, loads.space_torque)


@inlined
def _step_with(state: KernelState, seconds: float, coefficients: Coefficients,
               torque_acceleration: Vector, sizes: tuple[float, float], loads: HeldLoads,
               rotor_change: Vector | None, space_torque: Vector | None) -> KernelState:
    # Decide only once which terms to compute. A branch at every order would take longer than the
    # terms that it skips.
    if rotor_change is None:  # noqa: SIM102 (the compiler resolves each by type)
        if space_torque is None:
            return _step(state, seconds, coefficients, torque_acceleration, sizes,
                         loads.linear, None, None)
    if space_torque is not None and total(four.absolute(space_torque)) != 0.0:
        if loads.is_linear:
            return _step(state, seconds, coefficients, torque_acceleration, sizes,
                         loads.linear, rotor_change, space_torque)
        return _step(state, seconds, coefficients, torque_acceleration, sizes, None, None,
                     space_torque)
    if loads.is_linear:
        return _step(state, seconds, coefficients, torque_acceleration, sizes,
                     loads.linear, rotor_change, None)
    return _step(state, seconds, coefficients, torque_acceleration, sizes, None, None, None)


@inlined
def _step(state: KernelState, seconds: float, coefficients: Coefficients,
          torque_acceleration: Vector, sizes: tuple[float, float],
          linear: linear_terms.Linear | None, rotor_change: Vector | None,
          space_torque: Vector | None) -> KernelState:
    size, error_bound = sizes
    w = state[0]
    # w0 = w, w1, w2 ... are the terms of w in rad/s, and u0, u1, u2 ... are the same terms in
    # radians per step. t0, t1, t2 ... are the terms of the space torque in body axes, times the
    # step. Constant factors are multiplied into operands that are known early, so that no later
    # term has to wait for such a multiplication.
    u0 = scale(seconds, w)
    if linear is not None:
        torque_acceleration = add(torque_acceleration, product(linear.low, w))
    w1 = add_scaled(gyroscopic_acceleration(coefficients, products(u0, w)), seconds,
                    torque_acceleration)
    acting = _Acting(u0, _jacobian(linear, seconds, coefficients, w), rotor_change, space_torque)
    if linear is not None:
        w1 = add(w1, product(linear.matrix, u0))
    t0 = four.broadcast(0.0)
    if space_torque is not None:
        t0 = scale(seconds, to_body(state[1], space_torque))
        w1 = add(w1, acceleration_from_torque(coefficients, t0))
    u1, t1 = scale(seconds, w1), cross(t0, u0)
    w2 = _add_loads(_half_change(w1, coefficients, acting), 1 / 2, t1, u0, coefficients, acting)
    u2, t2 = scale(seconds, w2), scale(1 / 2, add(cross(t1, u0), cross(t0, u1)))
    w3 = _term(products(scale(1 / 3, u1), w1), 1 / 3, w2, t2, u1, coefficients, acting)
    a = cross(u0, u1)
    delta_omega = add(add(w1, w2), w3)
    rotation = add_scaled(add_scaled(scale(1 / 2, u1), 1 / 3, u2), 1 / 12, a)
    fourth = _SQUARE_3 * (size * size) > error_bound
    if lanes.some(fourth):
        t3 = scale(1 / 3, add(cross(t2, u0), add(cross(t1, u1), cross(t0, u2))))
        w4 = _term(symmetric_products(scale(1 / 4, u1), w2), 1 / 4, w3, t3, u2, coefficients,
                   acting)
        u3, b = scale(seconds, w3), cross(u0, u2)
        delta_omega = four.choose(fourth, add(delta_omega, w4), delta_omega)
        rotation = four.choose(
            fourth, add(rotation, add_scaled(scale(1 / 4, u3), 1 / 12, b)), rotation)
        fifth = lanes.both(fourth, _FOURTH_4 * (
            size * ((size * size) * (size * size))) > error_bound * error_bound)
        if lanes.some(fifth):
            t4 = scale(1 / 4, add(add(cross(t3, u0), cross(t2, u1)),
                                  add(cross(t1, u2), cross(t0, u3))))
            sums = add_symmetric_products(products(scale(1 / 5, u2), w2), scale(1 / 5, u1), w3)
            w5 = _term(sums, 1 / 5, w4, t4, u3, coefficients, acting)
            delta_omega = four.choose(fifth, add(delta_omega, w5), delta_omega)
            rotation = four.choose(fifth, add(rotation, add_scaled(
                _order_5_rotation(u0, u1, u2, u3, a, b), 1 / 5 * seconds, w4)), rotation)
    return advance(state, delta_omega, _delta_q(add(u0, rotation)))


@optional
def _jacobian(linear: linear_terms.Linear, seconds: float, coefficients: Coefficients,
              w: Vector) -> Matrix:
    # Return how the acceleration changes with w at the start of the step, times the step. The
    # products of w0 and the latest term are linear in the latest term, so the matrix of the linear
    # terms can include them.
    return multiple(seconds, add_jacobian(linear.matrix, coefficients, w))


@inlined
def _half_change(w1: Vector, coefficients: Coefficients, acting: _Acting) -> Vector:
    # Return the part of w2 that w1 causes.
    if acting.jacobian is None:
        return gyroscopic_acceleration(coefficients,
                                       symmetric_products(scale(1 / 2, acting.u0), w1))
    return product(multiple(1 / 2, acting.jacobian), w1)


@inlined
def _term(sums: Products, factor: float, latest: Vector, torque: Vector, u: Vector,
          coefficients: Coefficients, acting: _Acting) -> Vector:
    # Return the term of w that follows the latest one, from the sum of the products of the terms
    # between w0 and the latest one. The factor is the reciprocal of the order. The loads act
    # through a term of the space torque, `torque`, and a term of the angular velocity, `u`.
    if acting.jacobian is None:
        sums = add_symmetric_products(sums, scale(factor, acting.u0), latest)
    w = gyroscopic_acceleration(coefficients, sums)
    if acting.jacobian is not None:
        # Leave out the low-order part of the matrix, which does not matter in the small terms of
        # higher order.
        w = add_product(w, multiple(factor, acting.jacobian), latest, four.yzx(latest),
                        four.zxy(latest))
    return _add_loads(w, factor, torque, u, coefficients, acting)


@inlined
def _add_loads(w: Vector, factor: float, torque: Vector, u: Vector, coefficients: Coefficients,
               acting: _Acting) -> Vector:
    # Add what the space torque and the change of the rotor momentum contribute to a term.
    if acting.space_torque is not None:
        w = add_scaled(w, factor, acceleration_from_torque(coefficients, torque))
    if acting.rotor_change is not None:
        w = add(w, acceleration_from_torque(
            coefficients, cross(acting.rotor_change, scale(factor, u))))
    return w


@inlined
def _order_5_rotation(u0: Vector, u1: Vector, u2: Vector, u3: Vector, u0_x_u1: Vector,
                      u0_x_u2: Vector) -> Vector:
    # Return the order-5 term of the rotation vector, without the contribution of w4.
    inner = add_scaled(scale(3 / 40, u3), 1 / 360, u0_x_u2)
    return add(cross(u0, add_scaled(inner, -1 / 720, cross(u0, u0_x_u1))),
               scale(1 / 60, cross(u1, add_scaled(u2, -1 / 4, u0_x_u1))))


@inlined
def _delta_q(rotation: Vector) -> Quaternion:
    # Return q - 1, where q is the quaternion of a small rotation given by its rotation vector.
    half = scale(0.5, rotation)
    square = dot(half, half)
    sinc = fma(-square, fma(-square, fma(-square, 1 / 5040, 1 / 120), 1 / 6), 1.0)
    x = scale(sinc, half)
    return four.of(x[0], x[1], x[2],
                   -square * fma(-square, fma(-square, 1 / 720, 1 / 24), 1 / 2))
