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

"""Explicit Runge-Kutta methods as Butcher tableaux that are checked on construction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

_Row = Sequence[Fraction | int]


@dataclass(frozen=True)
class Tableau:
    """
    The coefficients of an explicit Runge-Kutta method, as exact fractions.

    Parameters
    ----------
    order : int
        The order of convergence, from 1 to 4.
    nodes : sequence of n numbers
        The nodes c: the time of each stage, as a fraction of the step.
    matrix : sequence of n rows
        The matrix A. Row i contains the i coefficients of the stages before stage i.
    weights : sequence of n numbers
        The weights b with which the stages contribute to the step.

    Raises
    ------
    ValueError
        The shapes do not match, a row of A does not add up to its node, or the coefficients
        violate one of the order conditions (Hairer, Norsett and Wanner, "Solving Ordinary
        Differential Equations I", section II.2).

    """

    order: int
    nodes: _Row
    matrix: Sequence[_Row]
    weights: _Row

    def __post_init__(self) -> None:
        count = len(self.nodes)
        if len(self.weights) != count or [len(row) for row in self.matrix] != [*range(count)]:
            raise ValueError(f'tableau: expected {count} weights and rows of 0 to {count - 1} '
                             f'numbers, found {len(self.weights)} and '
                             f'{[len(row) for row in self.matrix]}')
        for stage, (row, node) in enumerate(zip(self.matrix, self.nodes)):
            if sum(row) != node:
                raise ValueError(f'tableau: expected row {stage} to add up to its node {node}, '
                                 f'found {sum(row)}')
        for order, name, found, expected in self._conditions():
            if order <= self.order and found != expected:
                raise ValueError(f'tableau: expected {name} = {expected} for order {order}, '
                                 f'found {found}')

    def _conditions(self) -> list[tuple[int, str, Fraction | int, Fraction]]:
        # Return the order, the name, the value and the expected value of each order condition.
        # There is one condition for each rooted tree with up to four vertices.
        c = self.nodes
        squares = [node * node for node in c]
        inner = self._matrix_times(c)
        return [
            (1, 'sum b', self._weighted_sum([1] * len(c)), Fraction(1)),
            (2, 'sum b c', self._weighted_sum(c), Fraction(1, 2)),
            (3, 'sum b c^2', self._weighted_sum(squares), Fraction(1, 3)),
            (3, 'sum b A c', self._weighted_sum(inner), Fraction(1, 6)),
            (4, 'sum b c^3', self._weighted_sum([node ** 3 for node in c]), Fraction(1, 4)),
            (4, 'sum b c A c', self._weighted_sum([a * b for a, b in zip(c, inner)]),
             Fraction(1, 8)),
            (4, 'sum b A c^2', self._weighted_sum(self._matrix_times(squares)), Fraction(1, 12)),
            (4, 'sum b A A c', self._weighted_sum(self._matrix_times(inner)), Fraction(1, 24)),
        ]

    def _weighted_sum(self, values: _Row) -> Fraction | int:
        return sum(weight * value for weight, value in zip(self.weights, values))

    def _matrix_times(self, values: _Row) -> list[Fraction | int]:
        return [sum(entry * value for entry, value in zip(row, values)) for row in self.matrix]
