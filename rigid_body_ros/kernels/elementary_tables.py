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
Tables of constants for the elementary functions, computed at import in integer arithmetic.

The computation represents each number as an integer multiple of a power of two. Because Python's
integers are exact, the tables come out the same on every machine. The tables store each number as
the sum of two doubles, both correctly rounded.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate
import math

import numpy as np
from numpy.typing import NDArray

Pair = tuple[float, float]

#: The table of sines divides half a turn into this many steps. The table of arctangents divides
#: the interval from 0 to 1 into the same number of steps.
STEPS = 128
#: Number of bits in each element of `TURN_PARTS`. An element has so few bits that its product with
#: a number that has half as many bits as a double is exact.
PART_BITS = 24
#: Number of elements of `TURN_PARTS`. Even when the largest double is reduced, the last bit of the
#: last element contributes only 2^-200 of a step.
_PARTS = 52
#: The integer that represents the number 1 when the tables of functions are computed, and the
#: integer that represents 1 when `TURN_PARTS` is computed.
_ONE, _FINE = 1 << 200, 1 << PART_BITS * (_PARTS + 2)


def _split(value: int) -> Pair:
    """Return value / _ONE, rounded to a double, and the low-order part of this quotient."""
    high = value / _ONE  # Python divides integers with correct rounding
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

    The function sums the power series, and returns the result in units of 1 / `one`.
    """
    power, total, odd = one * above // below, 0, 1
    while power:
        total += power // odd
        power, odd = sign * power * above * above // (below * below), odd + 2
        if power == -1:  # Python rounds quotients down, so a negative power never becomes zero
            break
    return total


def _sine(angle: int) -> int:
    """
    Return the sine of an angle up to pi / 2.

    Both the angle and its sine are integers in units of 1 / _ONE.
    """
    power, total, order = angle, 0, 2
    while abs(power) > 1:
        total += power
        power = -power * angle * angle // (_ONE * _ONE * order * (order + 1))
        order += 2
    return total


def _half_turn(one: int) -> int:
    """Compute pi in units of 1 / `one` by Machin's formula."""
    return 16 * _inverse_tangent(1, 5, one, -1) - 4 * _inverse_tangent(1, 239, one, -1)


def _sines() -> list[Pair]:
    """
    Return sin(k pi / STEPS) for k from 0 to 2 STEPS - 1.

    The returned values have exactly the symmetries of the sine.
    """
    quarter = [_split(_sine(_PI * k // STEPS)) for k in range(STEPS // 2)]
    half = [*quarter, (1.0, 0.0), *quarter[:0:-1]]
    return half + [(-high, -low) for high, low in half]


def _arctangents() -> list[Pair]:
    # With s = 1 / STEPS, atan((k + 1) s) - atan(k s) = atan(s / (1 + k (k + 1) s^2)).
    increments = (_inverse_tangent(STEPS, STEPS * STEPS + k * (k + 1), _ONE, -1)
                  for k in range(STEPS))
    return [_split(angle) for angle in accumulate(increments, initial=0)]


def _turn_parts() -> list[float]:
    """Split STEPS / pi into parts of PART_BITS bits each, beginning with its integer part."""
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
#: Tables of sin(k pi / STEPS) for a whole turn, and of atan(k / STEPS). Each table has two
#: columns, and its second column contains the low-order parts.
SINES, ARCTANGENTS = np.array(_sines()), np.array(_arctangents())
#: Coefficients of power series. Each row contains a coefficient and the low-order part of this
#: coefficient. The series for sin x / x, (1 - cos x) / x^2 and arctan x / x are in powers of -x^2,
#: the series for artanh x / x is in powers of x^2, and the series for (e^x - 1) / x is in powers
#: of x. Each series is accurate to 100 bits if |x| is within its limit, which is half a step for
#: the sine and cosine, ln 2 / 128 for e^x, 1 / 256 for arctan x, and 0.18 for artanh x.
SINE_SERIES = _inverses(math.factorial(k) for k in range(1, 18, 2))
COSINE_SERIES = _inverses(math.factorial(k) for k in range(2, 17, 2))
GROWTH_SERIES = _inverses(math.factorial(k) for k in range(1, 13))
ARCTANGENT_SERIES = _inverses(range(1, 16, 2))
LOGARITHM_SERIES = _inverses(range(1, 44, 2))
#: The digits of STEPS / pi in base 2^PART_BITS. The digit at index k counts in units of
#: 2^(-PART_BITS k).
TURN_PARTS = np.array(_turn_parts())
