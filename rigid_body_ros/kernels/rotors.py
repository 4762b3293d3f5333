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

"""Integrate the torque on the rotors to get their momentum, in twice the working precision."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import four, intervals
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import inlined, njit, WRITTEN
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    is_zero,
    Polynomial,
    scale,
    two_sum,
    Vector,
)

#: The momentum of the rotors, N m s, and its low-order part.
Rotor = tuple[Vector, Vector]


@inlined
def after(before: Rotor, torque: Polynomial, passed_ns: int, span_ns: int) -> Rotor:
    """Return the rotor momentum `passed_ns` nanoseconds after the torque on the rotors changes."""
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
        high, low = after(before, torque, times_ns[k] - begin_ns, span_ns)
        intervals.store_coefficient(result, k, 0, high)
        intervals.store_coefficient(result, k, 1, low)
