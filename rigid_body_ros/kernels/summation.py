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
Sum the torques of several sources, and compute the rotor momentum.

The momentum is the integral of the torque on the rotors, in twice the working precision.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import four, intervals
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import inlined, njit, WRITTEN
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.layout import Samples, Sums
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    is_zero,
    of,
    Polynomial,
    scale,
    shifted,
    two_sum,
    Vector,
)

#: The momentum of the rotors, N m s, and its low-order part.
Rotor = tuple[Vector, Vector]


class _Total(NamedTuple):
    """The summed torques, N m, as polynomials in the fraction of an interval."""

    body: Polynomial
    #: Low-order parts of the coefficients of `body`.
    low: Polynomial
    space: Polynomial
    rotors: Polynomial


@njit
def sum_rows(body: Annotated[Floats, 'n|1 3'], space: Annotated[Floats, 'n|1 3'],
             on_rotors: Annotated[Floats, 'n|1 3'], momentum: Annotated[Floats, '2 3'],
             sums: Sums) -> None:
    """
    Combine held torques that all change at the same times.

    Parameters
    ----------
    body, space, on_rotors : float64 (n, 3), N m
        The total torque in body axes, in space axes and on the rotors. A total that never changes
        may have the shape (1, 3).
    momentum : float64 (2, 3), N m s
        The rotor momentum at the start, and its low-order part.
    sums : Sums
        The output. The caller sets `times_ns` to the times at which the torques change.

    """
    times_ns, rotors = sums.times_ns, _loaded(momentum)
    count = len(times_ns)
    for row in range(count):
        turning = _row(on_rotors, row)
        total = _Total(_held(four.subtract(_row(body, row), turning)), _zero(),
                       _held(_row(space, row)), _held(turning))
        sums.in_space[row] = _store(total, rotors, row, sums)
        if row + 1 < count:
            length_ns = times_ns[row + 1] - times_ns[row]
            rotors = _after(rotors, total.rotors, length_ns, length_ns)


@inlined
def _row(rows: Floats, row: int) -> Vector:
    row = min(row, len(rows) - 1)
    return of(rows[row, 0], rows[row, 1], rows[row, 2])


@inlined
def _loaded(momentum: Floats) -> Rotor:
    return _row(momentum, 0), _row(momentum, 1)


@njit
def sum_logs(samples: Samples, in_force: Annotated[Ints, 's', WRITTEN], timeout_ns: int,
             start_ns: int, marks_ns: Annotated[Ints, 'm'],
             momentum: Annotated[Floats, '2 3'], sums: Sums) -> int:
    """
    Sum the torques of several sources. The last source is the torque on the rotors.

    Parameters
    ----------
    samples : Samples
        The torques.
    in_force : int (sources,)
        For each source, the index of the first sample minus 1. The kernel overwrites the array.
    timeout_ns : int
        See `TorqueLog.segments`.
    start_ns : int
        The time at which the motion starts.
    marks_ns : int64 (m,), ns
        Additional times at which rows begin, in ascending order.
    momentum : float64 (2, 3), N m s
        See `sum_rows`.
    sums : Sums
        The output, which must have enough rows for all torque changes.

    Returns
    -------
    int
        The number of rows filled.

    """
    coefficients, stamps_ns, in_space, offsets = samples
    count, degree = len(offsets) - 1, coefficients.shape[1] // 2
    rotors = _loaded(momentum)
    at, mark, time_ns = 0, 0, start_ns
    while time_ns < NEVER_NS:
        while mark < len(marks_ns) and marks_ns[mark] <= time_ns:
            mark += 1
        next_ns = marks_ns[mark] if mark < len(marks_ns) else NEVER_NS
        for k in range(count):
            while in_force[k] + 1 < offsets[k + 1] and stamps_ns[in_force[k] + 1] <= time_ns:
                in_force[k] += 1
            next_ns = min(next_ns, _next_change(stamps_ns, in_force[k], offsets[k],
                                                offsets[k + 1], time_ns, timeout_ns))
        length_ns = next_ns - time_ns if next_ns < NEVER_NS else NEVER_NS
        if degree == 0:  # handled separately: copying zero coefficients would take half the time
            body = space = on_rotors = four.broadcast(-0.0)
            for k in range(count):
                row = in_force[k]
                if row >= offsets[k] and not 0 < timeout_ns <= time_ns - stamps_ns[row]:
                    torque = intervals.coefficient(coefficients, row, 0)
                    if in_space[row]:
                        space = add(space, torque)
                    elif k == count - 1:
                        body, on_rotors = four.subtract(body, torque), add(on_rotors, torque)
                    else:
                        body = add(body, torque)
            total = _Total(_held(body), _zero(), _held(space), _held(on_rotors))
        else:
            total = _Total(_nothing(), _nothing(), _nothing(), _nothing())
            for k in range(count):
                row = in_force[k]
                if row >= offsets[k] and not 0 < timeout_ns <= time_ns - stamps_ns[row]:
                    span_ns = stamps_ns[row + 1] - stamps_ns[row] if row + 1 < offsets[k + 1] \
                        else NEVER_NS
                    total = _add(total, _piece(coefficients, row, time_ns - stamps_ns[row],
                                               span_ns, length_ns), k == count - 1, in_space[row])
        sums.times_ns[at], sums.in_space[at] = time_ns, _store(total, rotors, at, sums)
        if next_ns < NEVER_NS:
            rotors = _after(rotors, total.rotors, length_ns, length_ns)
        at, time_ns = at + 1, next_ns
    return at


@inlined
def _nothing() -> Polynomial:
    # Start from -0, because adding a torque to -0 leaves every bit of the torque unchanged.
    nothing = four.broadcast(-0.0)
    return nothing, nothing, nothing, nothing


@inlined
def _held(torque: Vector) -> Polynomial:
    zero = four.broadcast(0.0)
    return torque, zero, zero, zero


@inlined
def _zero() -> Polynomial:
    zero = four.broadcast(0.0)
    return zero, zero, zero, zero


@inlined
def _next_change(stamps_ns: NDArray[np.int64], sample: int, first: int, stop: int, time_ns: int,
                 timeout_ns: int) -> int:
    # Return the time at which a source's torque next changes: the source's next stamp or the time
    # at which the torque times out, whichever comes first.
    next_ns = stamps_ns[sample + 1] if sample + 1 < stop else NEVER_NS
    if timeout_ns > 0 and sample >= first and stamps_ns[sample] + timeout_ns > time_ns:
        return min(next_ns, stamps_ns[sample] + timeout_ns)
    return next_ns


@inlined
def _piece(coefficients: Floats, row: int, passed_ns: int, span_ns: int,
           length_ns: int) -> tuple[Polynomial, Polynomial]:
    # Return the polynomial of a sample on the interval that begins `passed_ns` after the sample's
    # stamp and lasts `length_ns`. The low-order parts are zero unless this interval covers the
    # whole span of the sample.
    torque = intervals.torque_of(coefficients, row)
    if coefficients.shape[1] == 1 or (passed_ns == 0 and length_ns == span_ns):
        return torque, intervals.low_order_parts(coefficients, row)
    return shifted(torque, passed_ns / span_ns, length_ns / span_ns), _zero()


@inlined
def _add(total: _Total, piece: tuple[Polynomial, Polynomial], on_rotors: bool,
         in_space: bool) -> _Total:
    (body, low, space, rotors), (torque, torque_low) = total, piece
    if in_space:
        return _Total(body, low, _plus(space, torque), rotors)
    if on_rotors:
        return _Total(_minus(body, torque), _minus(low, torque_low), space, _plus(rotors, torque))
    return _Total(_plus(body, torque), _plus(low, torque_low), space, rotors)


@inlined
def _plus(p: Polynomial, q: Polynomial) -> Polynomial:
    (a, b, c, d), (e, f, g, h) = p, q
    return add(a, e), add(b, f), add(c, g), add(d, h)


@inlined
def _minus(p: Polynomial, q: Polynomial) -> Polynomial:
    (a, b, c, d), (e, f, g, h) = p, q
    return four.subtract(a, e), four.subtract(b, f), four.subtract(c, g), four.subtract(d, h)


@inlined
def _store(total: _Total, rotors: Rotor, row: int, sums: Sums) -> bool:
    # Store the total in a row. If the only torque is in space axes, store it in `sums.torques`
    # rather than in `sums.space`, and return True.
    (body, low, space, on_rotors), degree = total, sums.torques.shape[1] // 2
    only_space = intervals.is_zero(body) and not intervals.is_zero(space)
    if only_space:
        body, low, space = space, _zero(), _zero()
    _store_vectors(sums.torques, row, 0, degree + 1, body)
    _store_vectors(sums.torques, row, degree + 1, degree, (low[1], low[2], low[3], low[0]))
    _store_vectors(sums.space, row, 0, degree + 1, space)
    _store_vectors(sums.motors, row, 0, degree + 1, on_rotors)
    intervals.store_coefficient(sums.momentum, row, 0, rotors[0])
    intervals.store_coefficient(sums.momentum, row, 1, rotors[1])
    return only_space


@inlined
def _store_vectors(rows: Floats, row: int, first: int, count: int, vectors: Polynomial) -> None:
    # Store the first of four vectors.
    a, b, c, d = vectors
    for k, vector in enumerate((a, b, c, d)):
        if k < count:
            intervals.store_coefficient(rows, row, first + k, vector)


@inlined
def _after(before: Rotor, torque: Polynomial, passed_ns: int, span_ns: int) -> Rotor:
    # Return the rotor momentum `passed_ns` nanoseconds after the torque on the rotors changes.
    (a, b, c, d), fraction = torque, passed_ns / span_ns
    mean = add_scaled(a, fraction, add_scaled(scale(1 / 2, b), fraction, add_scaled(
        scale(1 / 3, c), fraction, scale(1 / 4, d))))
    if is_zero(mean):
        return before
    (h, low), (high_seconds, low_seconds) = before, _seconds(passed_ns)
    factor = four.broadcast(high_seconds)
    change = four.multiply(factor, mean)
    rest = four.fma(factor, mean, four.negative(change))
    h, lost = two_sum(h, change)
    low = add(add(lost, low), add_scaled(rest, low_seconds, mean))
    new = add(h, low)
    return new, four.subtract(low, four.subtract(new, h))


@inlined
def _seconds(span_ns: int) -> DoubleDouble:
    # Convert nanoseconds to seconds. `double_double.seconds` would give more digits than we need
    # here, and would take several times as long.
    rounded = float(span_ns)
    high = rounded / 1e9
    return high, (fma(-high, 1e9, rounded) + float(span_ns - int(rounded))) / 1e9


@njit
def momentum_at(row_times_ns: Annotated[Ints, 'n'], momentum: Annotated[Floats, 'n 2 3'],
                motors: Annotated[Floats, 'n d+1 3'], times_ns: Annotated[Ints, 'm'],
                result: Annotated[Floats, 'm 2 3', WRITTEN]) -> None:
    """
    Compute the rotor momentum and its low-order part at the given times.

    Parameters
    ----------
    row_times_ns, momentum, motors
        See `layout.Rows` and `layout.Terms`.
    times_ns : int64 (m,), ns
        The times, in any order. None of them may be before the first row.
    result : float64 (m, 2, 3), N m s
        The output.

    """
    row, last = 0, len(row_times_ns) - 1
    for k in range(len(times_ns)):
        if not (row_times_ns[row] <= times_ns[k]
                and (row == last or times_ns[k] < row_times_ns[row + 1])):
            row = np.searchsorted(row_times_ns, times_ns[k], side='right') - 1
        begin_ns = row_times_ns[row]
        span_ns = row_times_ns[row + 1] - begin_ns if row < last else NEVER_NS
        before = intervals.coefficient(momentum, row, 0), intervals.coefficient(momentum, row, 1)
        torque = intervals.polynomial_of(motors, row, motors.shape[1] - 1)
        high, low = _after(before, torque, times_ns[k] - begin_ns, span_ns)
        intervals.store_coefficient(result, k, 0, high)
        intervals.store_coefficient(result, k, 1, low)
