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
Constants of the elementary functions, computed in integer arithmetic at import.

During the computation, a number is an integer multiple of a power of two. The tables store each
number as a sum of two doubles, both correctly rounded. Python's integers are exact, so the tables
are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate
import math

import numpy as np
from numpy.typing import NDArray

Pair = tuple[float, float]

#: Number of steps in half a turn in the table of sines, and from 0 to 1 in the table of
#: arctangents.
STEPS = 128
#: Number of bits of each of `TURN_PARTS`. The product of a part and half of the bits of a double
#: is exact.
PART_BITS = 24
#: Number of parts. For the largest double, the last bit of the last part contributes 2^-200 of a
#: step.
_PARTS = 52
#: The number 1 in the units of the tables, and in the units of `TURN_PARTS`.
_ONE, _FINE = 1 << 200, 1 << PART_BITS * (_PARTS + 2)


def _split(value: int) -> Pair:
    """Return value / _ONE as a double and its low-order part."""
    high = value / _ONE  # Python rounds the quotient of integers correctly
    above, below = high.as_integer_ratio()
    return high, (value - above * _ONE // below) / _ONE


def _thrice(value: int) -> tuple[float, float, float]:
    high, low = _split(value)
    rest = sum(part.as_integer_ratio()[0] * _ONE // part.as_integer_ratio()[1]
               for part in (high, low))
    return high, low, (value - rest) / _ONE


def _inverse_tangent(above: int, below: int, one: int, sign: int) -> int:
    """
    Return arctan(above / below) if sign is -1, or artanh(above / below) if sign is 1.

    The result is the sum of the power series, as a multiple of 1 / `one`.
    """
    power, total, odd = one * above // below, 0, 1
    while power:
        total += power // odd
        power, odd = sign * power * above * above // (below * below), odd + 2
        if power == -1:  # Python rounds quotients down, so a negative power never becomes zero
            break
    return total


def _sine(angle: int) -> int:
    """Return the sine of an angle up to pi / 2; angle and sine are in units of 1 / _ONE."""
    power, total, order = angle, 0, 2
    while abs(power) > 1:
        total += power
        power = -power * angle * angle // (_ONE * _ONE * order * (order + 1))
        order += 2
    return total


def _half_turn(one: int) -> int:
    """Return pi as a multiple of 1 / `one`, by Machin's formula."""
    return 16 * _inverse_tangent(1, 5, one, -1) - 4 * _inverse_tangent(1, 239, one, -1)


def _sines() -> list[Pair]:
    """Return sin(k pi / STEPS) for k from 0 to 2 STEPS - 1, exactly symmetric."""
    quarter = [_split(_sine(_PI * k // STEPS)) for k in range(STEPS // 2)]
    half = [*quarter, (1.0, 0.0), *quarter[:0:-1]]
    return half + [(-high, -low) for high, low in half]


def _arctangents() -> list[Pair]:
    # With s = 1 / STEPS, atan((k + 1) s) - atan(k s) = atan(s / (1 + k (k + 1) s^2)).
    increments = (_inverse_tangent(STEPS, STEPS * STEPS + k * (k + 1), _ONE, -1)
                  for k in range(STEPS))
    return [_split(angle) for angle in accumulate(increments, initial=0)]


def _turn_parts() -> list[float]:
    """Return STEPS / pi in parts of PART_BITS bits each; the first is the integer part."""
    rest, parts = _FINE * _FINE * STEPS // _half_turn(_FINE), []
    for _ in range(_PARTS):
        parts.append(float(rest // _FINE))
        rest = rest % _FINE << PART_BITS
    return parts


def _inverses(divisors: Iterable[int]) -> NDArray[np.float64]:
    return np.array([_split(_ONE // divisor) for divisor in divisors])


_PI = _half_turn(_ONE)
_LN_2 = 2 * _inverse_tangent(1, 3, _ONE, 1)
_LN_10 = 3 * _LN_2 + 2 * _inverse_tangent(1, 9, _ONE, 1)

PI = _split(_PI)
#: pi / STEPS as a sum of three doubles.
STEP = _thrice(_PI // STEPS)
LN_2 = _split(_LN_2)
LOG10_2, LOG10_E = _split(_LN_2 * _ONE // _LN_10), _split(_ONE * _ONE // _LN_10)
#: sin(k pi / STEPS) for a whole turn, and atan(k / STEPS), both of shape (n, 2). The second column
#: is the low-order part of the first.
SINES, ARCTANGENTS = np.array(_sines()), np.array(_arctangents())
#: Coefficients of power series, in the same format. The series of sin x / x, (1 - cos x) / x^2 and
#: arctan x / x are in powers of -x^2, the series of artanh x / x is in powers of x^2, and the
#: series of (e^x - 1) / x is in powers of x. A series gives 100 bits up to a limit of |x|: half a
#: step for sine and cosine, ln 2 / 128 for e^x, 1 / 256 for arctan x, and 0.18 for artanh x.
SINE_SERIES = _inverses(math.factorial(k) for k in range(1, 18, 2))
COSINE_SERIES = _inverses(math.factorial(k) for k in range(2, 17, 2))
GROWTH_SERIES = _inverses(math.factorial(k) for k in range(1, 13))
ARCTANGENT_SERIES = _inverses(range(1, 16, 2))
LOGARITHM_SERIES = _inverses(range(1, 44, 2))
#: The parts of STEPS / pi, which is the sum of part k times 2^(-PART_BITS k).
TURN_PARTS = np.array(_turn_parts())
