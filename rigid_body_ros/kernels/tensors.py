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
Compute the constants of many tensors.

This module is a hundred times faster than `tensor`, and its results are bit-identical to those of
`tensor`. The module computes every number together with an error bound. If the numbers within this
bound do not all round to the same double, the kernel reports that the result is uncertain, and the
caller has to compute the constants of the body with `tensor`.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import body_layout, principal_axes
from rigid_body_ros.kernels.double_double import DoubleDouble, two_sum
from rigid_body_ros.kernels.jit import internal, njit, WRITTEN
from rigid_body_ros.kernels.lanes import fma
from rigid_body_ros.kernels.triple_double import (
    add_product,
    add_scaled,
    ERROR,
    multiply,
    normalized,
    reciprocal,
    store,
    TripleDouble,
)

#: Products of three entries can neither overflow nor underflow if the largest entry is between
#: _SMALL and _LARGE, and every other entry is zero or at least _LEAST times the largest one.
_SMALL, _LARGE = 2.0 ** -100, 2.0 ** 100
_LEAST = 2.0 ** -100
_ZERO = (0.0, 0.0, 0.0)


class BodyWorkspace(NamedTuple):
    """Work arrays for computing the constants of a body."""

    cofactors: Annotated[Floats, '3 3 4', WRITTEN]
    right: Annotated[Floats, '3 12 2', WRITTEN]
    axes: principal_axes.AxesWorkspace


def workspace() -> BodyWorkspace:
    """Return uninitialized work arrays."""
    return BodyWorkspace(np.empty((3, 3, 4)), np.empty((3, 12, 2)),
                         principal_axes.workspace())


@njit
def fill_constants(tensors: Annotated[Floats, 'n 3 3'], damping: Annotated[Floats, 'n 3 3'],
                   constants: Annotated[Floats, f'n {body_layout.SIZE}', WRITTEN],
                   certain: Annotated[NDArray[np.bool_], 'n', WRITTEN],
                   work: BodyWorkspace) -> None:
    """
    Compute the constants of several bodies.

    Parameters
    ----------
    tensors, damping : float64 (n, 3, 3)
        The inertia tensors, kg m^2, and the damping tensors, N m s/rad. They must be symmetric.
    constants : float64 (n, body_layout.SIZE)
        The output. The caller sets it to zero beforehand.
    certain : bool (n,)
        The second output. An element is True if the inertia tensor is positive definite, and if
        the constants are certain to be bit-identical to those that `tensor` computes.
    work : BodyWorkspace
        Work arrays, which the kernel overwrites.

    """
    for row in range(len(tensors)):
        certain[row] = (_in_range(tensors[row], damping[row])
                        and _fill_principal(tensors[row], constants[row], work.axes)
                        and constants[row, body_layout.MOMENTS] > 0.0
                        and _fill_coefficients(tensors[row], damping[row], work.cofactors,
                                               work.right, constants[row]))


@internal
def _in_range(tensor: Floats, damping: Floats) -> bool:
    largest = max(abs(tensor[0, 0]), abs(tensor[1, 1]), abs(tensor[2, 2]))
    if not _SMALL <= largest <= _LARGE:
        return False
    for a in range(3):
        for b in range(3):
            entry, drag = abs(tensor[a, b]), abs(damping[a, b])
            if not (entry == 0.0 or _LEAST * largest <= entry <= largest):
                return False
            if not (drag == 0.0 or _SMALL <= drag <= _LARGE):
                return False
    return True


@internal
def _fill_principal(tensor: Floats, constants: Floats, work: principal_axes.AxesWorkspace) -> bool:
    if _is_diagonal(tensor):
        _sort_diagonal(tensor, constants)
        return True
    return principal_axes.fill_principal(tensor, constants, work)


@internal
def _is_diagonal(tensor: Floats) -> bool:
    return _is_alone(tensor, 0) and _is_alone(tensor, 1)


@internal
def _is_alone(tensor: Floats, row: int) -> bool:
    # Return whether the body axis with index `row` is a principal axis.
    return tensor[row, (row + 1) % 3] == 0.0 and tensor[row, (row + 2) % 3] == 0.0


@internal
def _sort_diagonal(tensor: Floats, constants: Floats) -> None:
    # Store the moments of a diagonal tensor and the right-handed principal axes, in the same order
    # and with the same signs as `tensor.principal`.
    first, second, third = 0, 1, 2
    if tensor[second, second] < tensor[first, first]:
        first, second = second, first
    if tensor[third, third] < tensor[second, second]:
        second, third = third, second
    if tensor[second, second] < tensor[first, first]:
        first, second = second, first
    for place, a in enumerate((first, second, third)):
        constants[body_layout.MOMENTS + place] = tensor[a, a]
        constants[body_layout.AXES + 4 * place + a] = 1.0
    if (second - first) % 3 != 1:
        constants[body_layout.AXES + 8 + third] = -1.0


@internal
def _fill_coefficients(tensor: Floats, damping: Floats, cofactors: Floats, right: Floats,
                       constants: Floats) -> bool:
    # Solve Euler's equations by Cramer's rule, as `tensor.euler_coefficients` does.
    columns = _fill_right_hand_sides(tensor, damping, right)
    if _is_diagonal(tensor):
        return _store_all_quotients(columns, right, tensor, constants)
    certain, determinant, size = True, _ZERO, 0.0
    _fill_cofactors(tensor, cofactors)
    for b in range(3):
        determinant = add_scaled(determinant, _cofactor(cofactors, 0, b), tensor[0, b])
        size += abs(tensor[0, b]) * cofactors[0, b, 3]
    determinant = normalized(determinant)
    if determinant[0] <= ERROR * size:
        return False
    inverse = reciprocal(determinant)
    for row in range(3):
        if _is_alone(tensor, row):
            certain &= _store_quotients(row, columns, right, tensor[row, row], constants)
        else:
            certain &= _store_row(row, columns, cofactors, right, inverse, size, constants)
    return certain


@internal
def _fill_right_hand_sides(j: Floats, damping: Floats, right: Floats) -> int:
    # Fill in the high-order and low-order parts of the right-hand sides. The columns are those of
    # the gyroscopic terms (w2 w3, w3 w1, w1 w2, w1^2, w2^2, w3^2), then those of the torque, then
    # those of the damping. Return the number of columns, which is 12, or 9 without damping.
    for a in range(3):
        for column in range(12):
            right[a, column, 0] = right[a, column, 1] = 0.0
    columns = 9
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        right[a, a, 0], right[a, a, 1] = two_sum(j[b, b], -j[c, c])
        right[a, b, 0], right[a, c, 0] = j[a, b], -j[a, c]
        right[a, 3 + b, 0], right[a, 3 + c, 0] = -j[b, c], j[b, c]
        right[a, 6 + a, 0] = 1.0
        for column in range(3):
            right[a, 9 + column, 0] = damping[a, column]
            if damping[a, column] != 0.0:
                columns = 12
    return columns


@internal
def _fill_cofactors(j: Floats, cofactors: Floats) -> None:
    # Fill in the three parts of each cofactor, and the sum of the absolute values of its terms.
    for a in range(3):
        for b in range(a, 3):
            c, d, e, f = (a + 1) % 3, (a + 2) % 3, (b + 1) % 3, (b + 2) % 3
            total = add_product(add_product(_ZERO, j[c, e], j[d, f]), -j[c, f], j[d, e])
            high, middle, low = normalized(total)
            size = abs(j[c, e] * j[d, f]) + abs(j[c, f] * j[d, e])
            for m, n in ((a, b), (b, a)):
                cofactors[m, n, 0], cofactors[m, n, 1] = high, middle
                cofactors[m, n, 2], cofactors[m, n, 3] = low, size


@internal
def _cofactor(cofactors: Floats, a: int, b: int) -> TripleDouble:
    return cofactors[a, b, 0], cofactors[a, b, 1], cofactors[a, b, 2]


@internal
def _places(column: int) -> tuple[int, int]:
    # Return where to store the high-order and low-order parts of the solution for a column.
    if column < 9:
        return body_layout.EQUATIONS + 4 * column, body_layout.LOST_EQUATIONS + 4 * column
    return body_layout.DAMPING + 4 * (column - 9), body_layout.LOST_DAMPING + 4 * (column - 9)


@internal
def _store_row(row: int, columns: int, cofactors: Floats, right: Floats, inverse: TripleDouble,
               determinant_size: float, constants: Floats) -> bool:
    certain = True
    for column in range(columns):
        total, size = _ZERO, 0.0
        for k in range(3):
            for part in range(2):
                if right[k, column, part] != 0.0:
                    total = add_scaled(total, _cofactor(cofactors, row, k),
                                       right[k, column, part])
                    size += cofactors[row, k, 3] * abs(right[k, column, part])
        number = multiply(normalized(total), inverse)
        error = ERROR * inverse[0] * (size + abs(number[0]) * determinant_size)
        high_at, low_at = _places(column)
        certain &= store(number, error, constants, high_at + row, low_at + row)
    return certain


@internal
def _store_all_quotients(columns: int, right: Floats, tensor: Floats, constants: Floats) -> bool:
    certain = True
    for row in range(3):
        certain &= _store_quotients(row, columns, right, tensor[row, row], constants)
    return certain


@internal
def _store_quotients(row: int, columns: int, right: Floats, moment: float,
                     constants: Floats) -> bool:
    # When a double is divided by a double, the remainder is also a double. Quotients of two
    # doubles are therefore always certain.
    certain = True
    for column in range(columns):
        dividend = right[row, column, 0], right[row, column, 1]
        high_at, low_at = _places(column)
        if dividend[1] != 0.0:
            number, error = _quotient(dividend, moment)
            certain &= store(number, error, constants, high_at + row, low_at + row)
        elif dividend[0] != 0.0:
            high = dividend[0] / moment
            constants[high_at + row] = high
            constants[low_at + row] = fma(-high, moment, dividend[0]) / moment + 0.0
    return certain


@internal
def _quotient(dividend: DoubleDouble, divisor: float) -> tuple[TripleDouble, float]:
    # Use long division. Because the remainders are exact, the quotient is exact too if the
    # division terminates.
    first = dividend[0] / divisor
    rest, lost = two_sum(fma(-first, divisor, dividend[0]), dividend[1])
    second = rest / divisor
    rest, lost = two_sum(fma(-second, divisor, rest), lost)
    third = rest / divisor
    error = 2.0 * abs(fma(-third, divisor, rest) + lost) / divisor
    return normalized((first, second, third)), error
