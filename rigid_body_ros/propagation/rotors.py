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

"""The momentum of the rotors: the integral of the torque on them, in twice the precision."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import four
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import inlined, njit
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.vector import add, add_scaled, Polynomial, scale, two_sum, Vector
from rigid_body_ros.propagation import intervals, layout

#: Momentum of the rotors, N m s, and its low-order part.
Rotor = tuple[Vector, Vector]


class Rotors(NamedTuple):
    """The momentum of the rotors; see `summation.Summed`."""

    times_ns: NDArray[np.int64]
    terms: Floats

    @classmethod
    def constant(cls, time_ns: int, momentum: Floats) -> Rotors:
        """Return a momentum, shape (2, 3), N m s, with its low-order part, from a time on."""
        terms = np.zeros((1, 4, 3))
        terms[0, 2:] = momentum
        return cls(np.array([time_ns]), terms)

    def momentum(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the momentum at times in any order, N m s, shape (m, 3)."""
        return momentum_at(self.times_ns, self.terms, times_ns)[:, 0]


@inlined
def after(before: Rotor, torque: Polynomial, passed_ns: int, span_ns: int) -> Rotor:
    """Return the momentum of the rotors some time after a change of the torque."""
    (a, b, c, d), fraction = torque, passed_ns / span_ns
    mean = add_scaled(a, fraction, add_scaled(scale(1 / 2, b), fraction, add_scaled(
        scale(1 / 3, c), fraction, scale(1 / 4, d))))
    if layout.is_zero_vector(mean):
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
    # `double_double.seconds` is exact to more digits than needed here, and takes several times
    # as long.
    rounded = float(span_ns)
    high = rounded / 1e9
    return high, (fma(-high, 1e9, rounded) + float(span_ns - int(rounded))) / 1e9


@njit
def momentum_at(summed_times_ns: NDArray[np.int64], terms: Floats,
                times_ns: NDArray[np.int64]) -> Floats:
    """
    Return the momentum of the rotors and its low-order part.

    Parameters
    ----------
    summed_times_ns, terms
        See `summation.Summed`.
    times_ns : int64 (m,), ns
        In any order, none before the first time of the sum.

    Returns
    -------
    array, shape (m, 2, 3), N m s

    """
    result, last = np.empty((len(times_ns), 2, 3)), len(summed_times_ns) - 1
    degree = terms.shape[1] // 2 - 2
    row = 0
    for k in range(len(times_ns)):
        if not (summed_times_ns[row] <= times_ns[k]
                and (row == last or times_ns[k] < summed_times_ns[row + 1])):
            row = np.searchsorted(summed_times_ns, times_ns[k], side='right') - 1
        begin_ns = summed_times_ns[row]
        span_ns = summed_times_ns[row + 1] - begin_ns if row < last else NEVER_NS
        before = (intervals.coefficient(terms, row, 2 * degree + 2),
                  intervals.coefficient(terms, row, 2 * degree + 3))
        torque = intervals.polynomial_of(terms, row, degree + 1, degree)
        high, low = after(before, torque, times_ns[k] - begin_ns, span_ns)
        intervals.store_coefficient(result, k, 0, high)
        intervals.store_coefficient(result, k, 1, low)
    return result
