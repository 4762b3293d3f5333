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
The torque between two changes.

A sample is in force from its stamp to the next stamp. If there is a timeout, the torque becomes
zero that long after the stamp. Sample -1 stands for the time before the first stamp. Consecutive
intervals without torque are one *coast*.
"""

from __future__ import annotations

from typing import NamedTuple

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import euler_equations, four, linear_terms, short_step, vector
from rigid_body_ros.kernels.jit import inlined, internal, optional
from rigid_body_ros.propagation import layout
from rigid_body_ros.propagation.layout import Body, Log


class Interval(NamedTuple):
    """A span of time in which one polynomial describes the torque."""

    #: N m; its variable is 0 at the stamp and 1 at the next stamp.
    torque: vector.Polynomial
    #: Whether the torque is zero throughout.
    is_zero: bool
    #: Stamps of the sample in force (0 if none is) and of the next (NEVER_NS if there is none).
    stamp_ns: int
    next_ns: int
    #: Whether the sample times out before the next.
    times_out: bool
    end_ns: int


class Drive(NamedTuple):
    """The acceleration or the torque in Euler's equations during an interval."""

    #: J^-1 tau, rad/s^2, or, in space axes, the torque, N m.
    polynomial: vector.Polynomial
    #: Coefficients of higher degree are zero.
    degree: int
    in_space: bool
    #: Time at which the variable of the polynomial is 0, and the seconds until it is 1.
    origin_ns: int
    span: float


class Extras(NamedTuple):
    """What acts during an interval besides the drive."""

    #: Momentum of the rotors, N m s, in the same fraction as the drive, and the low-order part of
    #: the first coefficient.
    momentum: linear_terms.Momentum
    low_momentum: vector.Vector
    #: Of the body.
    constants: linear_terms.Constants
    #: Degree of the momentum; negative: there are neither rotors nor damping.
    linear_degree: int
    #: Torque in space axes, N m, beside a drive in body axes, and its degree; negative: none.
    space_torque: vector.Polynomial
    space_degree: int


@internal
def sample_in_force(log: Log, time_ns: int) -> tuple[int, bool]:
    """Return the sample in force at a time, -1 for none yet, and whether it has timed out."""
    sample = -1
    while sample + 1 < len(log.stamps_ns) and log.stamps_ns[sample + 1] <= time_ns:
        sample += 1
    return sample, sample >= 0 and 0 < log.timeout_ns <= time_ns - log.stamps_ns[sample]


@inlined
def interval(torque: vector.Polynomial, stamp_ns: int, next_ns: int, idle: bool,
             timeout_ns: int) -> Interval:
    """Return the interval that begins with a sample, or, if it is idle, with its timeout."""
    zero = is_zero(torque)
    if timeout_ns > 0 and not idle and stamp_ns + timeout_ns < next_ns:
        return Interval(torque, zero, stamp_ns, next_ns, True, stamp_ns + timeout_ns)
    return Interval(torque, zero, stamp_ns, next_ns, False, next_ns)


@inlined
def span(now: Interval, degree: int) -> float:
    """Return the seconds until the fraction of a polynomial is 1."""
    if degree > 0 and now.next_ns < NEVER_NS:
        return (now.next_ns - now.stamp_ns) / 1e9
    return 1.0


@inlined
def drive(now: Interval, low: vector.Polynomial, degree: int, in_space: bool,
          body: Body) -> Drive:
    """Return the drive of an interval: the acceleration by a body torque, or a space torque."""
    polynomial = now.torque
    if not in_space and not now.is_zero:
        polynomial = euler_equations.acceleration_polynomial(
            body.coefficients, body.form, polynomial, low)
    return Drive(polynomial, degree, in_space, now.stamp_ns, span(now, degree))


@inlined
def coefficient(polynomials: Floats, index: int, k: int) -> vector.Vector:
    """Return one coefficient of a polynomial."""
    return vector.of(polynomials[index, k, 0], polynomials[index, k, 1], polynomials[index, k, 2])


@inlined
def store_coefficient(polynomials: Floats, index: int, k: int, value: vector.Vector) -> None:
    """Store one coefficient of a polynomial."""
    polynomials[index, k, 0], polynomials[index, k, 1] = value[0], value[1]
    polynomials[index, k, 2] = value[2]


@inlined
def torque_of(polynomials: Floats, index: int, idle: bool) -> vector.Polynomial:
    """
    Return the torque of a sample, or zeros if it is idle.

    It is a tuple, because to make an array takes half the time of a short step.
    """
    none = four.broadcast(0.0)
    if idle:
        return none, none, none, none
    if polynomials.shape[1] == 1:
        return coefficient(polynomials, index, 0), none, none, none
    if polynomials.shape[1] == 3:
        return coefficient(polynomials, index, 0), coefficient(polynomials, index, 1), none, none
    return (coefficient(polynomials, index, 0), coefficient(polynomials, index, 1),
            coefficient(polynomials, index, 2), coefficient(polynomials, index, 3))


@inlined
def low_order_parts(polynomials: Floats, index: int) -> vector.Polynomial:
    """Return the low-order parts of the coefficients of a sample."""
    none = four.broadcast(0.0)
    if polynomials.shape[1] == 1:
        return none, none, none, none
    if polynomials.shape[1] == 3:
        return none, coefficient(polynomials, index, 2), none, none
    return (none, coefficient(polynomials, index, 4), coefficient(polynomials, index, 5),
            coefficient(polynomials, index, 6))


@inlined
def is_zero(torque: vector.Polynomial) -> bool:
    """Return whether a torque is zero throughout."""
    a, b, c, d = torque
    return (layout.is_zero_vector(a) and layout.is_zero_vector(b) and layout.is_zero_vector(c)
            and layout.is_zero_vector(d))


@optional
def extras_of(terms: Floats, index: int, span: float,
              constants: linear_terms.Constants) -> Extras:
    """Return what acts besides the drive, from `terms` of `loop.run`."""
    if terms.ndim == 2:
        momentum, low = _row(terms, 0), _row(terms, 1)
        # If the compiler knew these zeros, it would inline `stepping.advance`, which takes longer.
        none = vector.scale(0.0, momentum)
        space, on_rotors, degree = (none, none, none, none), (none, none, none, none), 0
    else:
        degree = terms.shape[1] // 2 - 2
        space = polynomial_of(terms, index, 0, degree)
        on_rotors = polynomial_of(terms, index, degree + 1, degree)
        momentum = coefficient(terms, index, 2 * degree + 2)
        low = coefficient(terms, index, 2 * degree + 3)
    a, b, c, d = on_rotors
    varies = not is_zero(on_rotors)
    acts = varies or not (layout.is_zero_vector(momentum) and linear_terms.is_zero(
        constants.damping.matrix))
    return Extras((momentum, vector.scale(span, a), vector.scale(span / 2, b),
                   vector.scale(span / 3, c), vector.scale(span / 4, d)),
                  low, constants, (degree + 1 if varies else 0) if acts else -1,
                  space, -1 if is_zero(space) else degree)


@inlined
def _row(rows: Floats, row: int) -> vector.Vector:
    return vector.of(rows[row, 0], rows[row, 1], rows[row, 2])


@inlined
def terms_vary(terms: Floats | None) -> bool:
    """Return whether the terms differ from sample to sample."""
    if terms is None:
        return False
    return terms.ndim > 2


@inlined
def polynomial_of(terms: Floats, index: int, first: int, degree: int) -> vector.Polynomial:
    """Return the coefficients of a polynomial, the first of which is the one given."""
    none = four.broadcast(0.0)
    return (coefficient(terms, index, first),
            coefficient(terms, index, first + 1) if degree > 0 else none,
            coefficient(terms, index, first + 2) if degree > 1 else none,
            coefficient(terms, index, first + 3) if degree > 1 else none)


@inlined
def acts(extras: Extras | None) -> bool:
    """Return whether anything acts besides the drive."""
    if extras is None:
        return False
    return extras.linear_degree >= 0 or extras.space_degree >= 0


@inlined
def rotors_change(extras: Extras | None) -> bool:
    """Return whether the momentum of the rotors changes."""
    if extras is None:
        return False
    return extras.linear_degree > 0


@inlined
def coasts(polynomials: Floats, terms: Floats | None, index: int,
           constants: linear_terms.Constants | None) -> bool:
    """Return whether nothing acts from a sample to the next."""
    return (is_zero(torque_of(polynomials, index, False))
            and not acts(extras_of(terms, index, 1.0, constants)))


@optional
def during_step(terms: Floats, two_frames: bool | None, index: int, seconds: float,
                constants: linear_terms.Constants) -> short_step.Extras:
    """Return what acts besides the drive in a step from the beginning of held torques."""
    if terms.ndim == 2:
        linear = linear_terms.at(constants, _row(terms, 0), _row(terms, 1))
        return short_step.Extras(linear, True, None, None,
                                 linear_terms.square_rate(linear.matrix), 0.0)
    return _during_step(terms, _space_torque(two_frames, terms, index), index, seconds, constants)


@optional
def _space_torque(_two_frames: bool, terms: Floats, index: int) -> vector.Vector:
    return coefficient(terms, index, 0)


@inlined
def _during_step(terms: Floats, space: vector.Vector | None, index: int, seconds: float,
                 constants: linear_terms.Constants) -> short_step.Extras:
    on_rotors, momentum = coefficient(terms, index, 1), coefficient(terms, index, 2)
    is_linear = True
    if layout.is_zero_vector(on_rotors):
        linear = linear_terms.at(constants, momentum, coefficient(terms, index, 3))
        is_linear = not (layout.is_zero_vector(momentum)
                         and linear_terms.is_zero(constants.damping.matrix))
    else:  # the rounding error of the matrix changes from step to step, so it does not add up
        linear = linear_terms.rounded_at(constants, momentum)
    # Squares of Frobenius norms: that of a vector product with tau is 2 |tau|^2.
    square_torque = 0.5 * vector.dot(on_rotors, on_rotors)
    if space is not None:
        square_torque += vector.dot(space, space)
    return short_step.Extras(
        linear, is_linear, vector.scale(seconds, on_rotors), space,
        linear_terms.square_rate(linear.matrix),
        4.0 * linear_terms.square_rate(constants.inverse.matrix) * square_torque)
