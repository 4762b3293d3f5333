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
Triple-double arithmetic, in which three doubles represent a number, for the compiled kernels.

Such a number is the sum of its three doubles and has about 47 digits. Even after many operations,
this is enough for the result to round to the same double-double number as the exact result would.
The only exceptions are results that are very close to a tie, and `store` detects them.

The algorithms are those of `double_double`, extended by one part.
"""

from __future__ import annotations

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels.double_double import two_product, two_sum
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.lanes import fma

#: The three parts of a number, in descending order of magnitude.
TripleDouble = tuple[float, float, float]

#: Bound on the error of a sum of up to ten products, relative to the sum of their absolute values.
#: The bound holds as long as nothing underflows. The actual relative error is less than 2^-148.
ERROR = 2.0 ** -145
#: A number slightly larger than 1. The excess is larger than the rounding error of a double.
_ABOVE_ONE = 1.0 + 2.0 ** -40


@internal
def normalized(a: TripleDouble) -> TripleDouble:
    """
    Return the same number, represented by three parts that do not overlap.

    The first part is the number rounded to a double.
    """
    middle, low = two_sum(a[1], a[2])
    high, middle = two_sum(a[0], middle)
    middle, low = two_sum(middle, low)
    high, rest = two_sum(high, middle)
    middle, low = two_sum(rest, low)
    return high, middle, low


@internal
def add_product(total: TripleDouble, a: float, b: float) -> TripleDouble:
    """Return total + a b, without normalizing the result."""
    product, error = two_product(a, b)
    high, one = two_sum(total[0], product)
    middle, two = two_sum(total[1], one)
    middle, three = two_sum(middle, error)
    return high, middle, total[2] + (two + three)


@internal
def add_scaled(total: TripleDouble, a: TripleDouble, factor: float) -> TripleDouble:
    """Return total + factor a, without normalizing the result."""
    high, middle, low = add_product(total, a[0], factor)
    product, error = two_product(a[1], factor)
    middle, one = two_sum(middle, product)
    return high, middle, low + (one + fma(a[2], factor, error))


@internal
def multiply(a: TripleDouble, b: TripleDouble) -> TripleDouble:
    """Return the product a b."""
    high, rest = two_product(a[0], b[0])
    one, one_error = two_product(a[0], b[1])
    two, two_error = two_product(a[1], b[0])
    middle, left = two_sum(one, two)
    middle, more = two_sum(middle, rest)
    low = fma(a[0], b[2], fma(a[1], b[1], a[2] * b[0]))
    return normalized((high, middle, low + ((left + more) + (one_error + two_error))))


@internal
def reciprocal(a: TripleDouble) -> TripleDouble:
    """Return 1 / a, computed by long division."""
    first = 1.0 / a[0]
    rest = normalized(add_scaled((1.0, 0.0, 0.0), a, -first))
    second = rest[0] / a[0]
    rest = normalized(add_scaled(rest, a, -second))
    return normalized((first, second, rest[0] / a[0]))


@internal
def store(number: TripleDouble, error: float, into: Floats, high_at: int, low_at: int) -> bool:
    """
    Round a number to a double, round the remainder to another double, and store both.

    Parameters
    ----------
    number : TripleDouble
        The number, which must be normalized.
    error : float
        A bound on the error of the number, or 0 if the number is exact.
    into : float64 (n,)
        The array in which to store the two doubles. A zero is stored as 0.0, not as -0.0.
    high_at, low_at : int
        The indices at which to store the two doubles.

    Returns
    -------
    bool
        Whether every number within the error bound rounds to the same two doubles.

    """
    high, middle, low = number
    if error > 0.0:
        error += abs(low) * 2.0 ** -51  # allow for the rounding error of low + error
    rest, other = middle + (low - error), middle + (low + error)
    into[high_at], into[low_at] = high + 0.0, rest + 0.0
    return rest == other and high + _ABOVE_ONE * rest == high
