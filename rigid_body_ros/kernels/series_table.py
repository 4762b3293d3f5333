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
The table that stores the terms of a Taylor series, order by order.

If several bodies are stepped at once, the table has a lane for each of them; see `four`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import four
from rigid_body_ros.kernels.jit import inlined, internal
from rigid_body_ros.kernels.vector import of, Quaternion, scale, Vector

#: The terms of one order: u in its three permutations xyz, yzx and zxy, and the rotation.
Term = tuple[Vector, Vector, Vector, Quaternion]

MAX_ORDER = 40
#: The offsets of the terms of one order in the table. The terms are u in its three permutations,
#: the rotation since the start of the step, and up to four coefficients of a torque fixed in
#: space, each in its three permutations.
U, _U_YZX, _U_ZXY, _ROTATION, TORQUES = range(0, 20, 4)
#: Number of doubles that a vector takes in its three permutations.
PERMUTED = 3 * 4
_TERM = TORQUES + 4 * PERMUTED
#: With lanes, the table contains only u and the rotation, and each number takes up a whole cache
#: line. There are no gaps between the terms, so no two terms compete for the same place in the
#: first-level cache.
_ROTATION_IN_LANES, _TERM_IN_LANES = 4, 8
#: Number of doubles in a table without lanes.
WORKSPACE = _TERM * (MAX_ORDER + 1)
#: Number of rows in a table with lanes.
WORKSPACE_OF_LANES = _TERM_IN_LANES * (MAX_ORDER + 1)
#: The factors 1 / (k + 1). Looking them up is faster than dividing.
RECIPROCALS = 1.0 / np.arange(1.0, MAX_ORDER + 1.0)


@inlined
def without_fourth(table: Floats, u: Vector) -> Vector:
    """Return a vector, replacing its fourth component by a constant zero if there are lanes."""
    # With lanes, the fourth component would occupy a register of its own. If this component is a
    # constant zero, the compiler drops the component and all its products.
    return of(u[0], u[1], u[2]) if four.has_lanes(table) else u


@inlined
def row_of(table: Floats, k: int) -> int:
    """Return the index at which the terms of order k begin."""
    return k * (_TERM_IN_LANES if four.has_lanes(table) else _TERM)


@inlined
def rotation_of(table: Floats) -> int:
    """Return the offset of the rotation within the terms of one order."""
    return _ROTATION_IN_LANES if four.has_lanes(table) else _ROTATION


@inlined
def store_term(table: Floats, k: int, u: Vector, rotation: Quaternion) -> Term:
    """Store the terms of order k, and return them."""
    row = row_of(table, k)
    store_permuted(table, row + U, u)
    four.store(table, row + rotation_of(table), rotation)
    return u, four.yzx(u), four.zxy(u), rotation


@inlined
def store_permuted(table: Floats, row: int, vector: Vector) -> None:
    """Store a vector in its three permutations."""
    four.store(table, row, vector)
    if not four.has_lanes(table):  # with lanes, permuting the components costs nothing
        four.store(table, row + 4, four.yzx(vector))
        four.store(table, row + 8, four.zxy(vector))


@inlined
def load_term(table: Floats, row: int) -> Term:
    """Return the terms of one order, which begin at the index `row`; see `row_of`."""
    u, yzx, zxy = load_permuted(table, row + U)
    return u, yzx, zxy, four.load(table, row + rotation_of(table))


@inlined
def components(table: Floats, row: int, u: Vector) -> Any:
    """
    Return the components of u in the term that begins at the given row of the table.

    To fill a register with copies of a number, a processor takes less time if the number is in
    memory than if it is in another register.
    """
    if four.has_lanes(table):
        return u
    return table[row + U], table[row + U + 1], table[row + U + 2]


@inlined
def load_permuted(table: Floats, row: int) -> tuple[Vector, Vector, Vector]:
    """Return a vector in its three permutations."""
    u = without_fourth(table, four.load(table, row))
    if four.has_lanes(table):
        return u, four.yzx(u), four.zxy(u)
    return u, four.load(table, row + 4), four.load(table, row + 8)


@internal
def turned(vectors: Floats, place: int, size: int, table: Floats, k: int) -> Vector:
    """
    Return the next term, of order k + 1, in the series of a vector that is fixed in space.

    The series describes the components v of the vector in body axes, which obey dv/dt = v x w. The
    terms up to order k are read from `vectors`, where they begin at `place` and are `size` doubles
    apart.
    """
    left = right = four.zero(four.load(table, U))
    for j in range(k + 1):
        _, yzx, zxy = load_permuted(vectors, size * j + place)
        _, u_yzx, u_zxy = load_permuted(table, row_of(table, k - j) + U)
        left, right = four.fma(yzx, u_zxy, left), four.fma(zxy, u_yzx, right)
    return scale(float(RECIPROCALS[k]), four.subtract(left, right))
