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
Arithmetic with about 32 digits for the compiled kernels: a number is a sum of two doubles.

Algorithms as in Hida, Li and Bailey, "Algorithms for quad-double precision floating point
arithmetic", 2001, with fused products.
"""

from __future__ import annotations

import math

from rigid_body_ros.kernels import elementary_tables as tables
from rigid_body_ros.kernels.jit import fma, part

#: The larger part, and what is missing in it.
Double = tuple[float, float]

PI = tables.PI


@part
def quick_sum(a: float, b: float) -> Double:
    """Return the exact sum of two doubles, the first not the smaller one unless zero."""
    total = a + b
    return total, b - (total - a)


@part
def two_sum(a: float, b: float) -> Double:
    """Return the exact sum of two doubles."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@part
def two_product(a: float, b: float) -> Double:
    """Return the exact product of two doubles."""
    product = a * b
    return product, fma(a, b, -product)


@part
def add(a: Double, b: Double) -> Double:
    """Return a + b."""
    high, low = two_sum(a[0], b[0])
    more, rest = two_sum(a[1], b[1])
    high, low = quick_sum(high, low + more)
    return quick_sum(high, low + rest)


@part
def subtract(a: Double, b: Double) -> Double:
    """Return a - b."""
    return add(a, (-b[0], -b[1]))


@part
def negative(a: Double) -> Double:
    """Return -a."""
    return -a[0], -a[1]


@part
def multiply(a: Double, b: Double) -> Double:
    """Return a b."""
    high, low = two_product(a[0], b[0])
    return quick_sum(high, low + fma(a[0], b[1], a[1] * b[0]))


@part
def divide(a: Double, b: Double) -> Double:
    """Return a / b."""
    first = a[0] / b[0]
    rest = subtract(a, multiply((first, 0.0), b))
    second = rest[0] / b[0]
    rest = subtract(rest, multiply((second, 0.0), b))
    high, low = quick_sum(first, second)
    return add((high, low), (rest[0] / b[0], 0.0))


@part
def root(a: Double) -> Double:
    """Return the square root of a number that is not negative (Karp's trick)."""
    if a[0] <= 0.0:
        return 0.0, 0.0
    high = math.sqrt(a[0])
    rest = subtract(a, two_product(high, high))
    return quick_sum(high, rest[0] / (2.0 * high))


@part
def whole(number: int) -> Double:
    """Return an integer of 64 bits."""
    return two_sum(float(number >> 32) * 4294967296.0, float(number & 0xFFFFFFFF))


@part
def seconds(span_ns: int) -> Double:
    """Return a number of nanoseconds in seconds."""
    return divide(whole(span_ns), (1e9, 0.0))
