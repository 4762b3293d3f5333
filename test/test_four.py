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

"""Operations on four doubles at a time give each result the bits that it has alone."""

from fractions import Fraction

import numpy as np
import pytest
from rigid_body_ros.kernels import four, vector
from rigid_body_ros.mechanics import so3

A, B, C = np.random.default_rng(4).normal(size=(3, 4))


def applied(operation):
    """Return the result of an operation on A, B and C."""
    out = np.empty(4)
    four.store(out, 0, operation(four.load(A, 0), four.load(B, 0), four.load(C, 0)))
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
def test_each_of_the_four_is_worked_out_alone(operation, expected):
    np.testing.assert_array_equal(applied(operation), expected)


@pytest.mark.parametrize(('turned', 'unit'), [
    (four.times_i, (1, 0, 0, 0)), (four.times_j, (0, 1, 0, 0)), (four.times_k, (0, 0, 1, 0))],
    ids=['i', 'j', 'k'])
def test_a_quaternion_is_turned_by_the_units(turned, unit):
    np.testing.assert_array_equal(applied(lambda a, b, c: turned(a)), so3.multiply(A, unit))


def test_products_of_vectors_and_quaternions_are_those_of_arrays():
    np.testing.assert_allclose(applied(lambda a, b, c: vector.multiply(a, b)),
                               so3.multiply(A, B), rtol=0, atol=1e-15)
    *product, rest = applied(lambda a, b, c: vector.cross(a, b))
    np.testing.assert_allclose(product, np.cross(A[:3], B[:3]), rtol=0, atol=1e-15)
    assert abs(rest) < 1e-16
    np.testing.assert_allclose(applied(lambda a, b, c: four.broadcast(vector.dot(a, b))),
                               np.full(4, A @ B), rtol=0, atol=1e-15)
