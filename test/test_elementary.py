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

"""Elementary functions are correctly rounded."""

from itertools import product
import math
import os

import mpmath
from mpmath import mpf
import numpy as np
import pytest
from rigid_body_ros.engine import elementary as arrays
from rigid_body_ros.kernels import elementary

pytestmark = pytest.mark.usefixtures('fifty_digits')

#: Number of arguments for each function; 10 million take five minutes.
EXAMPLES = int(os.environ.get('FUZZ_EXAMPLES', '20000'))
RANDOM = np.random.default_rng(754)
ULP = np.finfo(float).eps
EXTENDED = np.finfo(np.longdouble).eps < ULP  # not on ARM or Windows
SPECIAL = (0.0, 1.0, 5e-324, 1e308, math.inf)


def angles(count):
    """Return angles of every size, and close to multiples of pi / 2 and pi / 128."""
    part = count // 4
    steps = RANDOM.integers(1, 2 ** 26, count - 3 * part) * RANDOM.choice(
        [1, 64], count - 3 * part)
    signs = RANDOM.choice([-1.0, 1.0], count)
    return signs * np.concatenate([
        10.0 ** RANDOM.uniform(-9, 1, part), RANDOM.uniform(0.0, 1e7, part),
        10.0 ** RANDOM.uniform(6, 308.25, part), steps * (math.pi / 128)])


def points(count):
    """Return points in every direction, close to the axes and far from them."""
    near = RANDOM.normal(size=(2, count // 2))
    return np.concatenate([near, RANDOM.normal(size=(2, count - count // 2))
                           * 10.0 ** RANDOM.uniform(-140, 140, (2, count - count // 2))], axis=1)


def not_nearest(found, extended, exact, *arguments):
    """
    Return how many results are not the doubles nearest to the true values.

    A result that agrees with the C library's long double, if it has one, counts as right, unless
    the last 4 of the 11 extra bits leave the rounding open. All other results are compared with
    mpmath.
    """
    doubtful = np.ones(found.shape, bool)
    if EXTENDED:
        right = extended(*(values.astype(np.longdouble) for values in arguments))
        rest = np.abs((right - found) / np.spacing(np.abs(found))).astype(float)
        doubtful = ~(rest < 0.5 - 2.0 ** -7) | (np.frexp(found)[0] == 0.5)
    return sum(float(exact(*(mpf(float(values[row])) for values in arguments))) != found[row]
               for row in np.flatnonzero(doubtful))


def in_blocks(function, count):
    """Return the sum of a function over blocks that add up to the count, to bound the memory."""
    return sum(function(min(100_000, count - done)) for done in range(0, count, 100_000))


def test_sine_and_cosine_are_correctly_rounded():
    def wrong(count):
        given = angles(count)
        sines, cosines = arrays.sines_cosines(given)
        return (not_nearest(sines, np.sin, mpmath.sin, given)
                + not_nearest(cosines, np.cos, mpmath.cos, given))
    assert in_blocks(wrong, EXAMPLES) == 0


def test_arctangent_is_correctly_rounded():
    def wrong(count):
        y, x = points(count)
        return not_nearest(arrays.arctangents(y, x), np.arctan2, mpmath.atan2, y, x)
    assert in_blocks(wrong, EXAMPLES) == 0


def test_sines_of_the_hardest_angles_are_right():
    # The double that is closest to a multiple of pi / 2, and the largest double.
    nearest = 6381956970095103.0 * 2.0 ** 797
    sines, cosines = arrays.sines_cosines([nearest, np.finfo(float).max])
    np.testing.assert_array_equal(cosines[0], -4.68716592425462761112e-19)
    np.testing.assert_array_equal(sines, [1.0, 0.004961954789184062])


@pytest.mark.slow
def test_logarithm_is_correctly_rounded():
    logarithm = elementary.log10
    exact = [10.0 ** k for k in range(23)]
    assert [logarithm(x) for x in exact] == [*range(23)]
    for x in [*(10.0 ** RANDOM.uniform(0, 15, 200)), *RANDOM.uniform(0.5, 2.0, 200),
              *(10.0 ** RANDOM.uniform(-307, 308, 100))]:
        assert logarithm(x) == float(mpmath.log10(mpf(x)))


@pytest.mark.slow
def test_hyperbolic_tangent_and_secant_are_correctly_rounded():
    tanh_sech = elementary.tanh_sech
    for x in [*RANDOM.uniform(-25, 25, 200), *(10.0 ** RANDOM.uniform(-9, 2.78, 200))]:
        assert tanh_sech(x) == (float(mpmath.tanh(mpf(x))), float(mpmath.sech(mpf(x))))
    assert [tanh_sech(x) for x in (-0.0, 1e-300, 800.0, -math.inf)] == [
        (0.0, 1.0), (1e-300, 1.0), (1.0, 0.0), (-1.0, 0.0)]


@pytest.mark.slow
def test_exponentials_are_correctly_rounded():
    given = [*RANDOM.uniform(-1, 1, 500), *RANDOM.uniform(-709, 709, 500),
             *(10.0 ** RANDOM.uniform(-300, 0, 200)), 0.0, -0.0, 709.0, -708.0]
    assert np.array_equal(arrays.exponentials([given]),
                          [[float(mpmath.exp(mpf(x))) for x in given]])
    ends = arrays.exponentials([710.0, math.inf, -710.0, -math.inf, math.nan])
    np.testing.assert_array_equal(ends, [math.inf, math.inf, 0.0, 0.0, math.nan])


@pytest.mark.slow
def test_careful_evaluations_have_a_hundred_bits_and_quick_ones_their_bounds():
    cases = [(angle, mpmath.sin(angle), mpmath.cos(angle)) for angle in angles(120).tolist()]
    for function, error in ((elementary._careful_sine_cosine, 1e-31),
                            (elementary.sine_cosine_pairs, elementary._SINE_ERROR)):
        for angle, *exact in cases:
            for pair, right in zip(function(angle), exact):
                assert abs(mpmath.fsum(pair) / right - 1) < error
    for function, error in ((elementary._careful_arctangent, 1e-31),
                            (elementary._quick_arctangent, elementary._ANGLE_ERROR)):
        for ratio in [*RANDOM.uniform(0, 1, 100), *(10.0 ** RANDOM.uniform(-9, 0, 40))]:
            found = mpmath.fsum(function((ratio, 0.0), (1.0, 0.0)))
            assert abs(found / mpmath.atan(ratio) - 1) < error


def test_sines_are_odd_nan_at_infinity_and_those_of_tiny_angles_are_the_angles():
    given = angles(500)
    np.testing.assert_array_equal(arrays.sines_cosines(-given)[0],
                                  -arrays.sines_cosines(given)[0])
    np.testing.assert_array_equal(arrays.arctangents(-given, 1.0),
                                  -arrays.arctangents(given, 1.0))
    assert np.isnan(arrays.sines_cosines([-math.inf, math.inf, math.nan])).all()
    tiny = np.array([0.0, -0.0, 5e-324, -1e-310, 1e-200, 2.0 ** -28])
    sines, cosines = arrays.sines_cosines(tiny)
    np.testing.assert_array_equal(sines, tiny)
    np.testing.assert_array_equal(np.signbit(sines), np.signbit(tiny))
    np.testing.assert_array_equal(cosines, np.ones(6))


def test_arctangents_of_zeros_and_infinities_are_those_of_c():
    values = [*SPECIAL, *(-x for x in SPECIAL), math.nan]
    y, x = np.array([*product(values, repeat=2)]).T
    expected = np.array([math.atan2(*pair) for pair in zip(y, x)])
    found = arrays.arctangents(y, x)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.signbit(found[found == 0]), np.signbit(expected[found == 0]))


def test_a_subnormal_arctangent_rounds_down_half_way_between_doubles():
    # The ratios are 1.5, 2.5 and 3.5 times the smallest double; the arctangents are slightly less.
    least = 5e-324
    np.testing.assert_array_equal(
        arrays.arctangents([3 * least, 5 * least, -7 * least, 3 * least],
                           [2.0, 2.0, 2.0, 1.9]),
        [least, 2 * least, -3 * least, 2 * least])
