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

"""A Butcher tableau that is inconsistent, or does not have its stated order, cannot be built."""

from fractions import Fraction

import pytest
from rigid_body_ros.kernels.steppers import CLASSICAL
from rigid_body_ros.kernels.tableau import Tableau

HALF, THIRD = Fraction(1, 2), Fraction(1, 3)
#: Methods of orders 1 to 4 (Hairer, Norsett and Wanner, section II.1): Euler, Heun's two, Kutta's
#: 3/8 rule.
METHODS = [
    (1, (0,), ((),), (1,)),
    (2, (0, 1), ((), (1,)), (HALF, HALF)),
    (3, (0, THIRD, 2 * THIRD), ((), (THIRD,), (0, 2 * THIRD)), (HALF / 2, 0, 3 * HALF / 2)),
    (4, (0, THIRD, 2 * THIRD, 1), ((), (THIRD,), (-THIRD, 1), (1, -1, 1)),
     (Fraction(1, 8), Fraction(3, 8), Fraction(3, 8), Fraction(1, 8))),
]


@pytest.mark.parametrize(('order', 'nodes', 'matrix', 'weights'), METHODS)
def test_a_method_has_its_order_and_no_higher_one(order, nodes, matrix, weights):
    assert Tableau(order, nodes, matrix, weights).order == order
    if order < 4:
        with pytest.raises(ValueError, match=f'for order {order + 1}, found'):
            Tableau(order + 1, nodes, matrix, weights)


@pytest.mark.parametrize(('field', 'value', 'message'), [
    ('nodes', (0, HALF, THIRD, 1), r'row 2 to add up to its node 1/3, found 1/2'),
    ('matrix', ((), (HALF,), (0, HALF), (0, 1, 0)), r'for order 4, found'),
    ('weights', (THIRD, THIRD, THIRD, THIRD), r'sum b = 1 for order 1, found 4/3'),
    ('weights', (HALF, HALF), r'expected 4 weights and rows of 0 to 3 numbers, found 2'),
    ('matrix', ((), (HALF,), (0, HALF, 0), (0, 0, 1)), r'rows of 0 to 3 numbers')])
def test_a_wrong_coefficient_is_rejected(field, value, message):
    values = {'order': 4, 'nodes': CLASSICAL.nodes, 'matrix': CLASSICAL.matrix,
              'weights': CLASSICAL.weights, field: value}
    with pytest.raises(ValueError, match=message):
        Tableau(**values)
