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
Collect what acts on a body during the interval between one row and the next.

A row of `layout.Rows` is in force from its time until the time of the next row. Row -1 stands for
the time before the first row. If nothing acts in several consecutive intervals, these intervals
form one *coast*.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import (
    body_layout,
    euler_equations,
    fields,
    four,
    friction,
    lags,
    layout,
    linear_terms,
    short_step,
    vector,
)
from rigid_body_ros.kernels.jit import inlined, optional
from rigid_body_ros.kernels.layout import Body


class BodyTerms(NamedTuple):
    """
    Everything that acts on a body besides the torques of the rows; see `layout.Terms`.

    The tuple also contains the constants and states needed to evaluate these terms.
    """

    momentum: Floats
    motors: Floats | None
    space: Floats | None
    fields: NDArray[Any] | None
    lags: layout.Lags | None
    friction: layout.Friction | None
    constants: linear_terms.Constants
    #: The states that include the wheel momenta, or None if there is no friction.
    wheel_states: friction.WheelStates | None


class Interval(NamedTuple):
    """A time interval in which a single polynomial describes the torque."""

    #: The torque in N m, as a polynomial in a variable that is 0 at the beginning of the interval,
    #: and grows by 1 in `span` seconds.
    torque: vector.Polynomial
    #: Whether the torque is zero during the whole interval.
    is_zero: bool
    span: float
    #: The time in ns at which the row in force begins (0 before the first row), and the time at
    #: which the next row begins (NEVER_NS after the last row).
    begin_ns: int
    end_ns: int


class Drive(NamedTuple):
    """The acceleration or the torque that drives Euler's equations during an interval."""

    #: The acceleration J^-1 tau in rad/s^2 if the torque is in body axes. If the torque is in
    #: space axes, the torque itself in N m.
    polynomial: vector.Polynomial
    #: The degree of the polynomial. All coefficients of higher degree are zero.
    degree: int
    in_space: bool
    #: The time in ns at which the variable of the polynomial is 0, and the number of seconds in
    #: which the variable grows by 1.
    origin_ns: int
    span: float
    #: An upper bound on the acceleration in rad/s^2, including the acceleration due to the space
    #: torque in the loads.
    bound: float


class Loads(NamedTuple):
    """Everything that acts during an interval besides the drive."""

    #: The momentum of the rotors in N m s, as a polynomial in the variable of the drive, and the
    #: low-order part of its first coefficient.
    momentum: linear_terms.Momentum
    low_momentum: vector.Vector
    #: The matrices of the body.
    constants: linear_terms.Constants
    #: The degree of `momentum`, not counting wheels with friction. It is negative if there are
    #: neither rotors nor damping.
    linear_degree: int
    #: A torque polynomial in space axes (N m) that acts in addition to a drive in body axes, and
    #: its degree. If there is no such torque, the degree is negative.
    space_torque: vector.Polynomial
    space_degree: int
    #: The attitude-dependent torques (see `fields.FIELDS`), or None if there are no fields.
    fields: NDArray[Any] | None
    #: The torques that lag behind their commands, or None if there are no lags.
    lags: lags.RowLags | None
    #: The wheels with friction, or None if there are no such wheels.
    friction: friction.RowFriction | None


@optional
def load_terms(terms: layout.Terms, body_constants: Floats,
               progress: NDArray[Any]) -> BodyTerms:
    """Combine the terms of the rows with the constants of a body and the states of its motion."""
    return BodyTerms(terms.momentum, terms.motors, terms.space, terms.fields, terms.lags,
                     terms.friction, body_layout.linear_constants(body_constants),
                     friction.states_of(terms.friction, progress))


@optional
def wheel_states(terms: BodyTerms) -> friction.WheelStates | None:
    """Return the states that include the wheel momenta, or None if there is no friction."""
    return terms.wheel_states


@inlined
def interval(times_ns: NDArray[np.int64], torques: Floats, spans: Floats, row: int) -> Interval:
    """Return the interval in which a row is in force."""
    torque = torque_of(torques, row)
    return Interval(torque, is_zero(torque), spans[row] if row >= 0 and len(spans) else 1.0,
                    times_ns[row] if row >= 0 else 0,
                    times_ns[row + 1] if row + 1 < len(times_ns) else NEVER_NS)


@inlined
def drive(now: Interval, torques: Floats, row: int, degree: int, in_space: bool, body: Body,
          loads: Loads | None) -> Drive:
    """
    Return the drive of Euler's equations during an interval.

    If the torque is in body axes, the drive is the acceleration due to the torque. If the torque
    is in space axes, the drive is the torque itself. `torques` and `row` give the low-order parts
    of the torque.
    """
    polynomial = now.torque
    if not in_space and not now.is_zero:
        polynomial = euler_equations.acceleration_polynomial(
            body.coefficients, polynomial, low_order_parts(torques, row))
    bound = euler_equations.acceleration_bound(polynomial, in_space, body.coefficients)
    return Drive(polynomial, degree, in_space, now.begin_ns, now.span,
                 bound + _space_bound(loads, body))


@inlined
def _space_bound(loads: Loads | None, body: Body) -> float:
    if loads is None:
        return 0.0
    bound = euler_equations.acceleration_bound(loads.space_torque, True, body.coefficients)
    if loads.lags is None:
        return bound
    excess, none = vector.of(lags.torque_bound(loads.lags), 0.0, 0.0), four.broadcast(0.0)
    return bound + euler_equations.acceleration_bound(
        (excess, none, none, none), True, body.coefficients)


@inlined
def coefficient(polynomials: Floats, row: int, k: int) -> vector.Vector:
    """Load one coefficient of the polynomial of a row."""
    return vector.of(polynomials[row, k, 0], polynomials[row, k, 1], polynomials[row, k, 2])


@inlined
def store_coefficient(polynomials: Floats, row: int, k: int, value: vector.Vector) -> None:
    """Store one coefficient of the polynomial of a row."""
    polynomials[row, k, 0], polynomials[row, k, 1] = value[0], value[1]
    polynomials[row, k, 2] = value[2]


@inlined
def torque_of(torques: Floats, row: int) -> vector.Polynomial:
    """
    Return the torque of a row, or zeros before the first row.

    The result is a tuple, because allocating an array would take half as long as a short step.
    """
    none = four.broadcast(0.0)
    if row < 0:
        return none, none, none, none
    return polynomial_of(torques, row, torques.shape[1] // 2)


@inlined
def polynomial_of(polynomials: Floats, row: int, degree: int) -> vector.Polynomial:
    """Return the coefficients of the polynomial of a row, padded with zeros to degree three."""
    none = four.broadcast(0.0)
    return (coefficient(polynomials, row, 0),
            coefficient(polynomials, row, 1) if degree > 0 else none,
            coefficient(polynomials, row, 2) if degree > 1 else none,
            coefficient(polynomials, row, 3) if degree > 1 else none)


@inlined
def low_order_parts(torques: Floats, row: int) -> vector.Polynomial:
    """Return the low-order parts of the coefficients of the torque of a row."""
    none = four.broadcast(0.0)
    if row < 0 or torques.shape[1] == 1:
        return none, none, none, none
    if torques.shape[1] == 3:
        return none, coefficient(torques, row, 2), none, none
    return (none, coefficient(torques, row, 4), coefficient(torques, row, 5),
            coefficient(torques, row, 6))


@inlined
def is_zero(torque: vector.Polynomial) -> bool:
    """Return whether a torque is zero during the whole interval."""
    a, b, c, d = torque
    return (vector.is_zero(a) and vector.is_zero(b) and vector.is_zero(c)
            and vector.is_zero(d))


@optional
def loads_of(terms: BodyTerms, row: int, span: float) -> Loads:
    """Return everything that acts on the body, besides the drive, while a row is in force."""
    first, low = _momentum(terms, row)
    # Compute `zero` in a way that hides its value from the compiler. If the compiler knew the
    # value, it would inline `stepping.advance`, which makes the code slower.
    zero = vector.scale(0.0, first)
    (a, b, c, d), degree = _polynomial_or(zero, terms.motors, row)
    torque, space_degree = _polynomial_or(zero, terms.space, row)
    varies = not is_zero((a, b, c, d))
    acts = varies or terms.friction is not None or not (
        vector.is_zero(first) and linear_terms.is_zero(terms.constants.damping.matrix))
    return Loads((first, vector.scale(span, a), vector.scale(span / 2, b),
                  vector.scale(span / 3, c), vector.scale(span / 4, d)),
                 low, terms.constants, (degree + 1 if varies else 0) if acts else -1,
                 torque, -1 if is_zero(torque) else space_degree, terms.fields,
                 _row_lags(terms.lags, row),
                 _row_friction(terms.friction, row, terms.wheel_states))


@optional
def _row_lags(term: layout.Lags, row: int) -> lags.RowLags:
    return lags.RowLags(term.excess, term.time_constants, row)


@optional
def _row_friction(term: layout.Friction, row: int,
                  states: friction.WheelStates) -> friction.RowFriction:
    return friction.RowFriction(term.efforts, term.wheels, row, states)


@inlined
def _momentum(terms: BodyTerms, row: int) -> tuple[vector.Vector, vector.Vector]:
    # Return the momentum of the rotors at the beginning of a row, and its low-order part. A
    # constant momentum is stored in a single row. Before the first row, the momentum is that of
    # the first row.
    row = max(min(row, len(terms.momentum) - 1), 0)
    return coefficient(terms.momentum, row, 0), coefficient(terms.momentum, row, 1)


@inlined
def _polynomial_or(zero: vector.Vector, polynomials: Floats | None,
                   row: int) -> tuple[vector.Polynomial, int]:
    if polynomials is None:
        return (zero, zero, zero, zero), 0
    if row < 0:
        return (zero, zero, zero, zero), 0
    degree = polynomials.shape[1] - 1
    return polynomial_of(polynomials, row, degree), degree


@inlined
def acts(loads: Loads | None) -> bool:
    """Return whether anything acts on the body besides the drive."""
    if loads is None:
        return False
    return (loads.linear_degree >= 0 or loads.space_degree >= 0 or fields.act(loads.fields)
            or lags.acts(loads.lags))


@inlined
def rotors_change(loads: Loads | None) -> bool:
    """Return whether the momentum of the rotors changes during the interval."""
    if loads is None:
        return False
    return loads.linear_degree > 0 or loads.friction is not None


@inlined
def vary(terms: BodyTerms | None) -> bool:
    """Return whether anything that acts besides the drive changes from row to row."""
    if terms is None:
        return False
    return len(terms.momentum) > 1 or terms.space is not None


@inlined
def are_polynomials(terms: BodyTerms | None) -> bool:
    """Return whether every torque on the body is a polynomial in time."""
    if terms is None:
        return True
    return terms.fields is None and terms.lags is None and terms.friction is None


@inlined
def coasts(torques: Floats, terms: BodyTerms | None, row: int) -> bool:
    """Return whether nothing acts on the body from one row until the next row begins."""
    return is_zero(torque_of(torques, row)) and not acts(loads_of(terms, row, 1.0))


@optional
def during_step(terms: BodyTerms, row: int, seconds: float) -> short_step.HeldLoads:
    """
    Return everything besides the drive that acts during a step.

    The step must start at the beginning of a row, and the torques of this row must be held.
    """
    constants, momentum = terms.constants, _momentum(terms, row)
    on_rotors, torque = _held(terms.motors, row), _held(terms.space, row)
    linear, is_linear = _linear(constants, momentum, on_rotors)
    # The squared Frobenius norm of the matrix of a vector product with tau is 2 |tau|^2.
    square_torque = 0.5 * _square(on_rotors) + _square(torque)
    return short_step.HeldLoads(
        linear, is_linear, _change(on_rotors, seconds), torque,
        linear_terms.square_rate(linear.matrix),
        4.0 * linear_terms.square_rate(constants.inverse.matrix) * square_torque)


@inlined
def _linear(constants: linear_terms.Constants, momentum: tuple[vector.Vector, vector.Vector],
            on_rotors: vector.Vector | None) -> tuple[linear_terms.Linear, bool]:
    # Return the linear terms of Euler's equations, and whether there are any such terms.
    first, low = momentum
    if on_rotors is not None and not vector.is_zero(on_rotors):
        # It is safe to round the matrix here. The rounding error of the matrix differs from step
        # to step, so these errors do not add up.
        return linear_terms.rounded_at(constants, first), True
    return linear_terms.at(constants, first, low), not (
        vector.is_zero(first) and linear_terms.is_zero(constants.damping.matrix))


@optional
def _held(polynomials: Floats, row: int) -> vector.Vector:
    return coefficient(polynomials, max(row, 0), 0)


@inlined
def _square(torque: vector.Vector | None) -> float:
    if torque is None:
        return 0.0
    return vector.dot(torque, torque)


@optional
def _change(torque: vector.Vector, seconds: float) -> vector.Vector:
    return vector.scale(seconds, torque)
