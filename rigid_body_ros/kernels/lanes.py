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
Lanes hold one number for each of several bodies, side by side in a SIMD register.

If the arguments of a step have lanes, its result has lanes too, so the same source code can step
several bodies at once. Each lane rounds exactly as a single double does, so the result for each
body is bit-identical to the result of computing this body alone. Only compiled kernels have lanes.
In plain Python, the functions in this module operate on single numbers.
"""

from __future__ import annotations

from fractions import Fraction
import math
import operator

from rigid_body_ros.common.arrays import Floats

#: Number of bodies that are stepped at once. In compiled kernels, this number depends on the
#: processor level.
LANES = 1


def fma(a: float, b: float, c: float) -> float:
    """Return a b + c with a single rounding."""
    if not (math.isfinite(a) and math.isfinite(b) and math.isfinite(c)):
        return a * b + c
    return float(Fraction(a) * Fraction(b) + Fraction(c))


def load(values: Floats, row: int) -> float:
    """Return the number in the given row of an array of shape (n, LANES)."""
    return float(values[row, 0])


def store(values: Floats, row: int, number: float) -> None:
    """Write a number to the given row of an array of shape (n, LANES)."""
    values[row] = number


def align_stack() -> None:
    """Align the stack of a compiled function for SIMD registers (no effect in plain Python)."""


def where(condition: bool, one: float, other: float) -> float:
    """Return `one` if the condition holds, otherwise `other`."""
    return one if condition else other


def truncated(number: float) -> float:
    """Return a number without its fractional part."""
    return float(math.trunc(number))


def zero(like: float) -> float:
    """Return 0.0, with lanes if the argument has lanes."""
    return 0.0


def no_count(like: float) -> int:
    """Return 0 as the initial value of a count, with lanes if the argument has lanes."""
    return 0


def counted(condition: bool, count: int) -> int:
    """Return 0 if the condition holds, otherwise the count plus one."""
    return 0 if condition else count + 1


every = some = bool
both = operator.and_
