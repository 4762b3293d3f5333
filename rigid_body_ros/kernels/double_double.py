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
Double-double arithmetic for the compiled kernels.

A double-double number is the sum of two doubles, which gives it about 32 digits. The algorithms
come from Hida, Li and Bailey, "Algorithms for quad-double precision floating point arithmetic",
2001, and use fused multiply-add.
"""

from __future__ import annotations

import math

from rigid_body_ros.kernels import elementary_tables as tables
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.lanes import fma

#: A number as two parts: the high-order part is the number rounded to a double, and the low-order
#: part is the remainder.
DoubleDouble = tuple[float, float]

PI = tables.PI


@internal
def quick_two_sum(a: float, b: float) -> DoubleDouble:
    """Return the exact sum of two doubles for which |a| >= |b| or a = 0."""
    total = a + b
    return total, b - (total - a)


@internal
def two_sum(a: float, b: float) -> DoubleDouble:
    """Return the exact sum of two doubles."""
    total = a + b
    b_rounded = total - a
    return total, (a - (total - b_rounded)) + (b - b_rounded)


@internal
def two_product(a: float, b: float) -> DoubleDouble:
    """Return the exact product of two doubles."""
    product = a * b
    return product, fma(a, b, -product)


@internal
def add(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return a + b."""
    high, low = two_sum(a[0], b[0])
    more, rest = two_sum(a[1], b[1])
    high, low = quick_two_sum(high, low + more)
    return quick_two_sum(high, low + rest)


@internal
def subtract(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return a - b."""
    return add(a, (-b[0], -b[1]))


@internal
def negative(a: DoubleDouble) -> DoubleDouble:
    """Return -a."""
    return -a[0], -a[1]


@internal
def multiply(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return a b."""
    high, low = two_product(a[0], b[0])
    return quick_two_sum(high, low + fma(a[0], b[1], a[1] * b[0]))


@internal
def divide(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """Return a / b."""
    first = a[0] / b[0]
    rest = subtract(a, multiply((first, 0.0), b))
    second = rest[0] / b[0]
    rest = subtract(rest, multiply((second, 0.0), b))
    high, low = quick_two_sum(first, second)
    return add((high, low), (rest[0] / b[0], 0.0))


@internal
def sqrt(a: DoubleDouble) -> DoubleDouble:
    """Return the square root of a number by Karp's trick, or zero if the number is negative."""
    if a[0] <= 0.0:
        return 0.0, 0.0
    high = math.sqrt(a[0])
    rest = subtract(a, two_product(high, high))
    return quick_two_sum(high, rest[0] / (2.0 * high))


@internal
def from_int(number: int) -> DoubleDouble:
    """Convert a 64-bit integer to a double-double number."""
    return two_sum(float(number >> 32) * 4294967296.0, float(number & 0xFFFFFFFF))


@internal
def seconds(span_ns: int) -> DoubleDouble:
    """Convert a time span from nanoseconds to seconds."""
    return divide(from_int(span_ns), (1e9, 0.0))
