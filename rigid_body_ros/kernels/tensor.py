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
Constants of an inertia tensor, computed beyond double precision and then rounded once.

The constants have to be this accurate because, over a long run, the effect of an error in a
constant grows in proportion to the angle turned. For a thin rod, the error is also amplified by
the ratio of the moments, because (J w) x w may be a difference of two terms that are a million
times larger than the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats

#: Number of decimal digits with which the principal axes are computed. The result needs 32 digits,
#: twice as many as a double has. The other 32 digits allow for cancellation.
_DIGITS = 64
_SWEEPS = 20
#: An off-diagonal entry needs no rotation if it is at most this fraction of the smaller of the two
#: diagonal entries in its row and its column.
_NEGLIGIBLE = Decimal(1).scaleb(10 - _DIGITS)


def euler_coefficients(tensor: NDArray[Any]) -> Floats:
    """
    Return the coefficients of Euler's equations, solved for the acceleration.

    The acceleration dw/dt is linear in the products (w2 w3, w3 w1, w1 w2, w1^2, w2^2, w3^2) and in
    the torque (tau1, tau2, tau3). In (J w) x w, the coefficients are simply products of inertia
    and differences of moments. For a diagonal tensor, the first three products have the
    coefficients (I2 - I3) / I1 and so on.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        The symmetric tensor about the centre of mass, in body axes. Its entries are doubles, or
        Fractions that are sums of doubles.

    Returns
    -------
    array, shape (2, 3, 9)
        The correctly rounded coefficients, followed by their low-order parts. Without the
        low-order parts, the energy of a body with a full tensor would drift.

    Raises
    ------
    OverflowError
        A coefficient is too large for a double.
    ZeroDivisionError
        The tensor is singular.

    """
    j, unit = _integers(tensor)
    return _solved(j, [
        [j[1][1] - j[2][2], j[0][1], -j[0][2], 0, -j[1][2], j[1][2], unit, 0, 0],
        [-j[0][1], j[2][2] - j[0][0], j[1][2], j[0][2], 0, -j[0][2], 0, unit, 0],
        [j[0][2], -j[1][2], j[0][0] - j[1][1], -j[0][1], j[0][1], 0, 0, 0, unit],
    ])


def damping_coefficients(tensor: Floats, damping: Floats) -> Floats:
    """
    Return the correctly rounded matrix J^-1 D and its low-order part.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        See `euler_coefficients`.
    damping : array, shape (3, 3), N m s/rad
        The damping tensor D, body axes.

    Returns
    -------
    array, shape (2, 3, 3), 1/s

    """
    entries, _ = _integers(np.concatenate([tensor, damping]))
    return _solved(entries[:3], entries[3:])


def _integers(entries: NDArray[Any]) -> tuple[list[list[int]], int]:
    # Multiply all entries by their common denominator. Return the resulting integers and the
    # denominator. The conversion is possible because every double is an integer divided by a power
    # of two. Computing with integers is much faster than with Fractions, because Python reduces
    # every Fraction to lowest terms. Python also rounds quotients of integers correctly.
    ratios = [[entry.as_integer_ratio() for entry in row] for row in entries.tolist()]
    common = max(below for row in ratios for _, below in row)
    return [[above * (common // below) for above, below in row] for row in ratios], common


def _solved(tensor: list[list[int]], right: list[list[int]]) -> Floats:
    # Solve for several columns of right-hand sides by Cramer's rule. Return the solutions and
    # their low-order parts. Like the tensor itself, the matrix of its cofactors is symmetric.
    cofactors = [_cross(tensor[a - 2], tensor[a - 1]) for a in range(3)]
    determinant = _dot(tensor[0], cofactors[0])
    exact = [[_dot(row, column) for column in zip(*right)] for row in cofactors]
    high = [[entry / determinant for entry in row] for row in exact]
    low = [[_rounding_error(entry, determinant, value) for entry, value in zip(*rows)]
           for rows in zip(exact, high)]
    return np.array([high, low])


def _dot(a: Sequence[int], b: Sequence[int]) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[int], b: list[int]) -> list[int]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _rounding_error(dividend: int, divisor: int, quotient: float) -> float:
    above, below = quotient.as_integer_ratio()
    return (dividend * below - above * divisor) / (divisor * below)


def principal(tensor: Floats) -> tuple[Floats, Floats]:
    """
    Compute the principal moments and axes by Jacobi rotations.

    Each number in the result is represented by the sum of two doubles.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        The symmetric tensor about the centre of mass, in body axes.

    Returns
    -------
    moments : array, shape (2, 3), kg m^2
        The moments in ascending order, followed by their low-order parts.
    axes : array, shape (2, 3, 3)
        The principal axes as columns, in body axes, followed by their low-order parts. The axes
        are right-handed.

    """
    with localcontext() as context:
        context.prec = _DIGITS
        matrix = [[Decimal(float(entry)) for entry in row] for row in tensor]
        axes = [[Decimal(int(a == b)) for b in range(3)] for a in range(3)]
        for _ in range(_SWEEPS):
            for p, q in ((0, 1), (0, 2), (1, 2)):
                _rotate(matrix, axes, p, q)
        order = sorted(range(3), key=lambda a: matrix[a][a])
        if order not in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):  # an odd permutation
            for row in axes:
                row[order[2]] = -row[order[2]]
        return (_split([matrix[a][a] for a in order]),
                _split([[row[a] for a in order] for row in axes]))


def _rotate(matrix: list[list[Decimal]], axes: list[list[Decimal]], p: int, q: int) -> None:
    # Apply one Jacobi rotation; see Golub and Van Loan, Matrix Computations, section 8.5.2.
    least = min(abs(matrix[p][p]), abs(matrix[q][q]))
    if abs(matrix[p][q]) <= _NEGLIGIBLE * least:
        return
    half = (matrix[q][q] - matrix[p][p]) / (2 * matrix[p][q])
    tangent = (1 if half >= 0 else -1) / (abs(half) + (half * half + 1).sqrt())
    cosine = 1 / (tangent * tangent + 1).sqrt()
    sine = tangent * cosine
    for rows in (matrix, axes):
        for row in rows:
            row[p], row[q] = cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]
    for a in range(3):
        up, uq = matrix[p][a], matrix[q][a]
        matrix[p][a], matrix[q][a] = cosine * up - sine * uq, sine * up + cosine * uq


def _split(values: list[Decimal] | list[list[Decimal]]) -> Floats:
    exact = np.array(values, dtype=object)
    high = exact.astype(float)
    rest = exact - np.vectorize(Decimal, otypes=[object])(high)
    return np.stack([high, rest.astype(float)])
