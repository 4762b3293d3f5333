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

"""Four doubles at a time: each is what it would be alone, to the last bit."""

from fractions import Fraction
import math

import numba
import numpy as np
import pytest
from rigid_body_ros.kernels import four, lanes, vector
from rigid_body_ros.mechanics import so3

A, B, C = np.random.default_rng(4).normal(size=(3, 4))


def applied(operation):
    """Return what a kernel makes of A, B and C."""
    compiled = numba.njit(error_model='numpy')(operation)

    @numba.njit(error_model='numpy')
    def kernel(a, b, c, out):
        four.store(out, 0, compiled(four.load(a, 0), four.load(b, 0), four.load(c, 0)))
    out = np.empty(4)
    kernel(A, B, C, out)
    return out


@pytest.mark.parametrize(('operation', 'expected'), [
    (lambda a, b, c: four.add(a, b), A + B),
    (lambda a, b, c: four.subtract(a, b), A - B),
    (lambda a, b, c: four.multiply(a, b), A * B),
    (lambda a, b, c: four.negative(a), -A),
    (lambda a, b, c: four.absolute(a), np.abs(A)),
    (lambda a, b, c: four.broadcast(a[2]), np.full(4, A[2])),
    (lambda a, b, c: four.of(c[3], b[2], a[1], c[0]), [C[3], B[2], A[1], C[0]]),
    (lambda a, b, c: four.fma(a, b, c),
     [float(Fraction(x) * Fraction(y) + Fraction(z)) for x, y, z in zip(A, B, C)]),
    (lambda a, b, c: four.yzx(a), A[[1, 2, 0, 3]]),
    (lambda a, b, c: four.zxy(a), A[[2, 0, 1, 3]]),
], ids=['add', 'subtract', 'multiply', 'negative', 'absolute', 'broadcast', 'of', 'fma', 'yzx',
        'zxy'])
@pytest.mark.slow
def test_each_of_the_four_is_worked_out_alone(operation, expected):
    np.testing.assert_array_equal(applied(operation), expected)


@pytest.mark.slow
@pytest.mark.parametrize(('turned', 'unit'), [
    (four.times_i, (1, 0, 0, 0)), (four.times_j, (0, 1, 0, 0)), (four.times_k, (0, 0, 1, 0))],
    ids=['i', 'j', 'k'])
def test_a_quaternion_is_turned_by_the_units(turned, unit):
    np.testing.assert_array_equal(applied(lambda a, b, c: turned(a)), so3.multiply(A, unit))


@pytest.mark.slow
def test_products_of_vectors_and_quaternions_are_those_of_arrays():
    np.testing.assert_allclose(applied(lambda a, b, c: vector.multiply(a, b)),
                               so3.multiply(A, B), rtol=0, atol=1e-15)
    *product, rest = applied(lambda a, b, c: vector.cross(a, b))
    np.testing.assert_allclose(product, np.cross(A[:3], B[:3]), rtol=0, atol=1e-15)
    assert abs(rest) < 1e-16
    np.testing.assert_allclose(applied(lambda a, b, c: four.broadcast(vector.dot(a, b))),
                               np.full(4, A @ B), rtol=0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize('operation', [
    lambda a, b, c: four.add(a, b), lambda a, b, c: four.subtract(a, b),
    lambda a, b, c: four.multiply(a, b), lambda a, b, c: four.negative(a),
    lambda a, b, c: four.absolute(a), lambda a, b, c: four.fma(a, b, c),
    lambda a, b, c: four.times_i(a), lambda a, b, c: four.times_j(a),
    lambda a, b, c: four.times_k(a), lambda a, b, c: vector.multiply(a, b),
    lambda a, b, c: vector.cross(a, b), lambda a, b, c: vector.to_body(a, b),
    lambda a, b, c: vector.scale(2.5, a),
    lambda a, b, c: four.broadcast(lanes.fma(a[0], b[1], 3.0) / b[2]),
    lambda a, b, c: four.of(-a[1], 1.0, math.sqrt(b[0] * b[0]), a[2] - b[3]),
    lambda a, b, c: four.choose(a[0] > b[0], four.zero(a), c),
    lambda a, b, c: four.choose(lanes.both(a[0] <= b[0], a[1] < c[1]), b, c)])
def test_each_lane_is_worked_out_alone(operation):
    compiled = numba.njit(error_model='numpy')(operation)

    @numba.njit(error_model='numpy')
    def kernel(values, out):
        four.store(out, 0, compiled(four.load(values, 0), four.load(values, 4),
                                    four.load(values, 8)))
    values = np.random.default_rng(5).normal(size=(12, lanes.LANES))
    found, expected = np.empty((4, lanes.LANES)), np.empty((lanes.LANES, 4))
    kernel(values, found)
    for column, row in zip(values.T.copy(), expected):
        kernel(column, row)
    np.testing.assert_array_equal(found, expected.T)


@pytest.mark.slow
def test_a_condition_holds_in_every_lane_or_in_some():
    @numba.njit(error_model='numpy')
    def kernel(values):
        numbers = lanes.load(values, 0)
        return [lanes.every(numbers > bound) for bound in (-1.0, 0.0, 9.0)] + [
            lanes.some(numbers > bound) for bound in (-1.0, 0.0, 9.0)]
    assert kernel(np.arange(float(lanes.LANES))[None]) == [True, False, False, True, True, False]
