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
Elementary functions for the compiled kernels, with bit-identical results on every machine.

The math functions of C libraries can differ in the last bit from one machine to the next. The
functions here avoid this by using only operations whose results are fully specified by IEEE 754:
+ - * /, square root and fused multiply-add.

Functions are evaluated in two phases, as in CORE-MATH (Sibidanov, Zimmermann and Glondu, "The
CORE-MATH project", 2022). A quick evaluation with about 65 bits is enough to round the result
correctly for nearly all arguments. The remaining arguments go through a careful evaluation whose
error is below 1e-31 (Ziv, "Fast evaluation of elementary mathematical functions with correctly
rounded last bit", 1991). Even then the last bit may be wrong, but only if the true value lies
within this error of the midpoint between two doubles. We expect this for about one argument in
10^15.

To shorten the series, we subtract the nearest multiple of pi / 128 from an angle, and the nearest
multiple of 1 / 128 from a ratio. The function values at these multiples come from tables (Gal and
Bachelis, "An accurate elementary mathematical library for the IEEE floating point standard",
1991).
"""

from __future__ import annotations

import math

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels.double_double import (
    add,
    divide,
    DoubleDouble,
    multiply,
    negative,
    PI,
    quick_two_sum,
    subtract,
    two_product,
    two_sum,
)
from rigid_body_ros.kernels.elementary_tables import (
    ARCTANGENT_SERIES,
    ARCTANGENTS,
    COSINE_SERIES,
    GROWTH_SERIES,
    LN_2,
    LOG10_2,
    LOG10_E,
    LOGARITHM_SERIES,
    PART_BITS,
    SINE_SERIES,
    SINES,
    STEP,
    STEPS,
    TURN_PARTS,
)
from rigid_body_ros.kernels.jit import inlined, internal
from rigid_body_ros.kernels.lanes import fma

#: Bounds on the relative errors of the quick evaluations of sines and polar angles.
_SINE_ERROR, _ANGLE_ERROR = 2.0 ** -65, 2.0 ** -66
#: The sine of an angle below _TINY_ANGLE rounds to the angle itself, and the cosine rounds to 1.
#: The arctangent of a ratio below _TINY_RATIO rounds to the ratio itself.
_TINY_ANGLE, _TINY_RATIO = 2.0 ** -27, 2.0 ** -60
#: Reducing an angle larger than this takes more bits of pi than `STEP` provides.
_LARGE_ANGLE = 2.0 ** 20
#: How many elements of `TURN_PARTS` we use to reduce an angle. All further elements together would
#: contribute less than 2^-179 of a step.
_PARTS = 11
#: A number between _SMALL and _LARGE can be squared and multiplied by 2^-60 without coming close
#: to the limits of the range of doubles.
_SMALL, _LARGE = 2.0 ** -400, 2.0 ** 400
_SCALE = 2.0 ** 600
_STEPS_OF_RADIAN = STEPS / math.pi
_HALF_PI = 0.5 * PI[0], 0.5 * PI[1]
_ONE, _TWO = (1.0, 0.0), (2.0, 0.0)


@internal
def sine_cosine(angle: float) -> tuple[float, float]:
    """Return the correctly rounded sine and cosine, or two NaNs if the angle is not finite."""
    if abs(angle) < _TINY_ANGLE:
        return angle, 1.0
    sine, cosine = sine_cosine_pairs(angle)
    if not (_rounds_uniquely(sine, _SINE_ERROR) and _rounds_uniquely(cosine, _SINE_ERROR)):
        sine, cosine = _careful_sine_cosine(angle)
    return sine[0], cosine[0]


@internal
def sine_cosine_pairs(angle: float) -> tuple[DoubleDouble, DoubleDouble]:
    """Return the sine and cosine as double-doubles that are accurate to 65 bits."""
    if abs(angle) < 0.5 * STEP[0]:
        return _of_small_angle(angle)
    count, rest = _reduce(angle) if abs(angle) < _LARGE_ANGLE else _reduce_large(angle)
    sine, cosine = _of_step(count), _of_step(count + STEPS // 2)
    return (_sine_of_sum(sine, cosine, rest),
            _sine_of_sum(cosine, negative(sine), rest))


@internal
def arctangent(y: float, x: float) -> float:
    """
    Return the correctly rounded polar angle of the point (x, y) in rad.

    Zeros, infinities and signs are handled as in C's atan2.
    """
    if y != y or x != x:
        return y + x
    a, b, leftward = abs(y), abs(x), math.copysign(1.0, x) < 0.0
    if a == math.inf or b == math.inf:
        a, b = (1.0 if a == math.inf else 0.0), (1.0 if b == math.inf else 0.0)
    a, b, steep = min(a, b), max(a, b), a > b
    if a <= _TINY_RATIO * b or b == 0.0:
        return math.copysign(
            _HALF_PI[0] if steep else PI[0] if leftward else _ratio(a, b), y)
    scale = scale_of(b)
    a, b = scale * a, scale * b
    angle = _to_half_plane(_quick_arctangent((a, 0.0), (b, 0.0)), steep, leftward)
    if not _rounds_uniquely(angle, _ANGLE_ERROR):
        angle = _to_half_plane(_careful_arctangent((a, 0.0), (b, 0.0)), steep, leftward)
    return math.copysign(angle[0], y)


@internal
def arctangent_pair(y: DoubleDouble, x: DoubleDouble) -> DoubleDouble:
    """Return the polar angle of (x, y) in rad, to 65 bits, ignoring the signs of zeros."""
    a, b = (negative(y) if y[0] < 0.0 else y), (negative(x) if x[0] < 0.0 else x)
    steep = a[0] > b[0]
    if steep:
        a, b = b, a
    angle = _quick_arctangent(a, b) if b[0] > 0.0 else (0.0, 0.0)
    angle = _to_half_plane(angle, steep, x[0] < 0.0)
    return negative(angle) if y[0] < 0.0 else angle


@internal
def log10(x: float) -> float:
    """Return the correctly rounded decimal logarithm of a positive normal number."""
    fraction, exponent = math.frexp(x)
    if fraction < 0.7:
        fraction, exponent = 2.0 * fraction, exponent - 1
    # ln x = 2 artanh((x - 1) / (x + 1)), where x - 1 is exact.
    ratio = divide((fraction - 1.0, 0.0), two_sum(fraction, 1.0))
    series = _polynomial(LOGARITHM_SERIES, multiply(ratio, ratio))
    natural = multiply((2.0 * ratio[0], 2.0 * ratio[1]), series)
    return add(multiply((float(exponent), 0.0), LOG10_2), multiply(LOG10_E, natural))[0]


@internal
def exponential(x: float) -> float:
    """
    Return e^x, correctly rounded.

    For |x| > 709, where e^x nears the limits of normal doubles, the function returns infinity if x
    is positive, and zero if x is negative. If x is NaN, the function returns NaN.
    """
    if not abs(x) <= 709.0:
        return 0.0 if x < 0.0 else x * math.inf
    total = add(_ONE, expm1(abs(x)))
    return divide(_ONE, total)[0] if x < 0.0 else total[0]


@internal
def tanh_sech(x: float) -> tuple[float, float]:
    """
    Return the hyperbolic tangent and secant, correctly rounded.

    If the secant is below 1e-270, it may be off by one unit in the last place. For |x| > 709,
    where the secant would fall below the range of normal doubles, the returned secant is zero.
    """
    if abs(x) < _TINY_ANGLE:
        return x, 1.0
    if abs(x) > 709.0:
        return math.copysign(1.0, x), 0.0
    growth = expm1(abs(x))
    inverse = divide(_ONE, add(_ONE, growth))
    above = add(growth, multiply(growth, inverse))  # e^x - e^-x without cancellation
    below = add(add(_ONE, growth), inverse)
    return math.copysign(divide(above, below)[0], x), divide(_TWO, below)[0]


@internal
def scale_of(size: float) -> float:
    """
    Return a power of two by which to scale numbers of the given size before squaring them.

    With this scale, the squares do not lose any digits to overflow or underflow.
    """
    return _SCALE if size < _SMALL else 1.0 / _SCALE if size > _LARGE else 1.0


@inlined
def _rounds_uniquely(value: DoubleDouble, error: float) -> bool:
    # Return whether every number within the given relative error of the value rounds to the same
    # double.
    high, low = value
    margin = error * abs(high)
    return high + (low - margin) == high + (low + margin)


@internal
def _polynomial(coefficients: Floats, x: DoubleDouble) -> DoubleDouble:
    total = (0.0, 0.0)
    for k in range(len(coefficients) - 1, -1, -1):
        total = add(multiply(total, x), (float(coefficients[k, 0]), float(coefficients[k, 1])))
    return total


@inlined
def _reduce(angle: float) -> tuple[int, DoubleDouble]:
    # Return the index of the step nearest to the angle, and the difference between the angle and
    # this step. The fma subtracts `steps` times STEP[0] from the angle without rounding, because
    # only an angle of just a few steps has bits below the last bit of STEP[0].
    count = round(angle * _STEPS_OF_RADIAN)
    steps = float(count)
    product, rest = two_product(steps, STEP[1])
    high, low = two_sum(fma(-steps, STEP[0], angle), -product)
    return count, quick_two_sum(high, low - fma(steps, STEP[2], rest))


@internal
def _reduce_large(angle: float) -> tuple[int, DoubleDouble]:
    # Do the same as `_reduce` for an angle of any size, with a result that is accurate to 100 bits
    # (Payne and Hanek, "Radian reduction for trigonometric functions", 1983). The returned index
    # is exact, up to a multiple of a whole turn.
    if not abs(angle) < math.inf:
        return 0, (math.nan, math.nan)
    fraction, exponent = math.frexp(abs(angle))
    upper = math.floor(fraction * 2.0 ** 27)
    lower = (fraction * 2.0 ** 27 - upper) * 2.0 ** 26
    exponent -= 53
    first = max(0, (exponent - 8) // PART_BITS + 1)  # earlier parts contribute only whole turns
    a = b = c = d = 0.0
    for k in range(first, first + _PARTS):
        for half, place in ((float(upper), exponent + 26), (lower, exponent)):
            steps = math.ldexp(half * float(TURN_PARTS[k]), place - PART_BITS * k)
            steps -= 2.0 * STEPS * float(np.floor(steps / (2.0 * STEPS)))
            a, steps = two_sum(a, steps)
            b, steps = two_sum(b, steps)
            c, steps = two_sum(c, steps)
            d += steps
    count = round(a)
    c, d = two_sum(c, d)
    b, c = two_sum(b, c)
    high, b = two_sum(a - float(count), b)
    b, c = two_sum(b, c)
    rest = multiply(quick_two_sum(high, b), (STEP[0], STEP[1]))
    return (-count, negative(rest)) if angle < 0.0 else (count, rest)


@inlined
def _of_step(count: int) -> DoubleDouble:
    row = count & (2 * STEPS - 1)
    return float(SINES[row, 0]), float(SINES[row, 1])


@inlined
def _of_small_angle(x: float) -> tuple[DoubleDouble, DoubleDouble]:
    square, more = two_product(x, x)
    high, low = quick_two_sum(1.0, -0.5 * square)
    return (quick_two_sum(x, x * square * fma(square, fma(square, fma(
                square, 1 / 362880, -1 / 5040), 1 / 120), -1 / 6)),
            quick_two_sum(high, low + fma(square * square, fma(square, fma(
                square, 1 / 40320, -1 / 720), 1 / 24), -0.5 * more)))


@inlined
def _sine_of_sum(sine: DoubleDouble, cosine: DoubleDouble, rest: DoubleDouble) -> DoubleDouble:
    # Return the sine of a tabulated angle plus a remainder of at most half a step.
    x, low = rest
    square, more = two_product(x, x)
    half = 0.5 * square
    odd = fma(-half, low, x * square * fma(square, fma(square, fma(
        square, 1 / 362880, -1 / 5040), 1 / 120), -1 / 6))
    even = fma(square * square, fma(square, fma(square, 1 / 40320, -1 / 720), 1 / 24),
               -fma(x, low, 0.5 * more))
    first, first_rest = two_product(cosine[0], x)
    second, second_rest = two_product(sine[0], -half)
    high, high_rest = quick_two_sum(sine[0], first)
    high, second = two_sum(high, second)
    small = fma(cosine[0], low, fma(cosine[1], x, sine[1] + first_rest + second_rest))
    small = fma(cosine[0], odd, fma(sine[0], even, small))
    return quick_two_sum(high, small + (high_rest + second))


@internal
def _careful_sine_cosine(angle: float) -> tuple[DoubleDouble, DoubleDouble]:
    count, rest = _reduce_large(angle)
    minus_square = negative(multiply(rest, rest))
    odd = multiply(rest, _polynomial(SINE_SERIES, minus_square))
    even = multiply(minus_square, _polynomial(COSINE_SERIES, minus_square))
    sine, cosine = _of_step(count), _of_step(count + STEPS // 2)
    return (add(sine, add(multiply(cosine, odd), multiply(sine, even))),
            add(cosine, subtract(multiply(cosine, even), multiply(sine, odd))))


@internal
def _ratio(a: float, b: float) -> float:
    # Return the arctangent of a tiny ratio, which rounds to the ratio itself. If the ratio lies
    # halfway between two subnormal doubles, return the lower one, because an arctangent is always
    # slightly less than its ratio.
    if a == 0.0:
        return 0.0
    ratio = a / b
    if ratio < 2.0 ** -1022:
        fraction, exponent = math.frexp(b)
        above = fma(math.ldexp(ratio, 1000), fraction, -math.ldexp(a, 1000 - exponent))
        if above == math.ldexp(fraction, -75):
            return ratio - 2.0 ** -1074
    return ratio


@inlined
def _to_half_plane(angle: DoubleDouble, steep: bool, leftward: bool) -> DoubleDouble:
    # Return the polar angle (from 0 to pi), given the angle to the nearest axis (from 0 to
    # pi / 4).
    if steep:
        return add(_HALF_PI, angle if leftward else negative(angle))
    return subtract(PI, angle) if leftward else angle


@inlined
def _nearest_ratio(a: float, b: float) -> int:
    return round(a / b * STEPS)


@inlined
def _quick_arctangent(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    # Return the arctangent of a / b, for a / b from 0 to 1. Look up the arctangent of the nearest
    # tabulated ratio, and add the arctangent of (a - b ratio) / (b + a ratio). The numerator of
    # this fraction is computed without rounding.
    row = _nearest_ratio(a[0], b[0])
    ratio = float(row) / STEPS
    above, above_rest = fma(-ratio, b[0], a[0]), fma(-ratio, b[1], a[1])
    product, product_rest = two_product(ratio, a[0])
    below, below_rest = quick_two_sum(b[0], product)
    below_rest += fma(ratio, a[1], b[1] + product_rest)
    inverse = 1.0 / below
    x = above * inverse
    low = fma(-x, below_rest, fma(-x, below, above) + above_rest) * inverse
    square = x * x
    odd = x * square * fma(square, fma(square, fma(square, 1 / 9, -1 / 7), 1 / 5), -1 / 3)
    high, rest = quick_two_sum(float(ARCTANGENTS[row, 0]), x)
    return quick_two_sum(high, odd + (low + (float(ARCTANGENTS[row, 1]) + rest)))


@internal
def _careful_arctangent(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    row = _nearest_ratio(a[0], b[0])
    ratio = (float(row) / STEPS, 0.0)
    x = divide(subtract(a, multiply(ratio, b)), add(b, multiply(ratio, a)))
    series = _polynomial(ARCTANGENT_SERIES, negative(multiply(x, x)))
    return add((float(ARCTANGENTS[row, 0]), float(ARCTANGENTS[row, 1])), multiply(x, series))


@internal
def expm1(x: float) -> DoubleDouble:
    """Return exp(x) - 1 for x from 0 to 709, as a double-double that is accurate to 65 bits."""
    # Split off a power of 2, and divide the rest of x by 64. Sum the series of exp - 1, which we
    # call the growth, at this small argument. Then square 1 + growth six times to undo the
    # division.
    power = float(round(x / LN_2[0]))
    rest = subtract(subtract((x, 0.0), two_product(power, LN_2[0])),
                    two_product(power, LN_2[1]))
    rest = (rest[0] / 64.0, rest[1] / 64.0)
    growth = multiply(rest, _polynomial(GROWTH_SERIES, rest))
    for _ in range(6):
        growth = multiply(growth, add(growth, _TWO))
    scale = math.ldexp(1.0, int(power))
    return add((scale * growth[0], scale * growth[1]), two_sum(scale, -1.0))
