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

"""Functions of whole arrays: elementary functions, the extent of times, and a decomposition."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import elementary
from rigid_body_ros.kernels.jit import internal, njit, WRITTEN


@njit
def fill_sines_cosines(angles: Annotated[Floats, 'n'], sines: Annotated[Floats, 'n', WRITTEN],
                       cosines: Annotated[Floats, 'n', WRITTEN]) -> None:
    """Compute the sines and cosines of angles with `elementary.sine_cosine`."""
    for row in range(len(angles)):
        sines[row], cosines[row] = elementary.sine_cosine(float(angles[row]))


@njit
def fill_arctangents(points: Annotated[Floats, '2 n'],
                     angles: Annotated[Floats, 'n', WRITTEN]) -> None:
    """
    Compute the polar angles of points with `elementary.arctangent`.

    The points are an array of shape (2, n), with y in the first row and x in the second.
    """
    for row in range(len(angles)):
        angles[row] = elementary.arctangent(float(points[0, row]), float(points[1, row]))


@njit
def fill_exponentials(x: Annotated[Floats, 'n'], results: Annotated[Floats, 'n', WRITTEN]) -> None:
    """Compute e^x for each x with `elementary.exponential`."""
    for row in range(len(x)):
        results[row] = elementary.exponential(float(x[row]))


@njit
def extent(times_ns: Annotated[Ints, 'n']) -> tuple[bool, int, int]:
    """Return whether the times are in ascending order, the earliest time and the latest time."""
    ascends, first, last = True, NEVER_NS, -NEVER_NS
    for k in range(len(times_ns)):
        ascends = ascends and (k == 0 or times_ns[k] >= times_ns[k - 1])
        first, last = min(first, times_ns[k]), max(last, times_ns[k])
    return ascends, first, last


@njit
def fill_triangle(columns: Annotated[Floats, 'n m', WRITTEN],
                  triangle: Annotated[Floats, 'n n', WRITTEN]) -> None:
    """
    Compute the triangular factor R of a matrix by Householder reflections.

    Parameters
    ----------
    columns : float64 (n, m)
        The transpose of the matrix, so that each row of the array is a column of the matrix. The
        kernel also uses this array as workspace and overwrites it.
    triangle : float64 (n, n)
        The output. The caller sets it to zero beforehand.

    """
    count, length = columns.shape
    for j in range(min(count, length)):
        column = columns[j]
        norm = np.sqrt(_product(column, column, j))
        if norm > 0.0:
            if column[j] > 0.0:
                norm = -norm
            pivot = column[j] - norm
            column[j] = pivot
            for k in range(j + 1, count):
                other = columns[k]
                factor = _product(column, other, j) / (norm * pivot)
                for i in range(j, length):
                    other[i] += factor * column[i]
        triangle[j, j] = norm
        for k in range(j + 1, count):
            triangle[j, k] = columns[k, j]


@internal
def _product(one: Floats, other: Floats, first: int) -> float:
    # Use four partial sums, because a processor can compute these in parallel.
    a = b = c = d = 0.0
    i = first
    while i + 3 < len(one):
        a += one[i] * other[i]
        b += one[i + 1] * other[i + 1]
        c += one[i + 2] * other[i + 2]
        d += one[i + 3] * other[i + 3]
        i += 4
    while i < len(one):
        a += one[i] * other[i]
        i += 1
    return (a + b) + (c + d)
