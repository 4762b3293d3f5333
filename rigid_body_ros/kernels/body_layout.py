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
Layout of the array of 128 doubles that holds the constants of a body.

The array consists of 32 vectors of three components, each padded with a zero to four doubles. The
vectors come in four groups: the nine columns of coefficients of Euler's equations, the principal
moments, the three principal axes, and the three columns of J^-1 D. Each group is followed by the
low-order parts of its vectors.
"""

from __future__ import annotations

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import four
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.linear_terms import Constants, from_columns, Linear, Matrix
from rigid_body_ros.kernels.vector import Coefficients, Columns, of, PrincipalFrame, Vector

#: The index in the array at which each group of vectors begins. Every vector takes up four
#: doubles.
EQUATIONS, LOST_EQUATIONS, MOMENTS, LOST_MOMENTS, AXES, LOST_AXES = 0, 36, 72, 76, 80, 92
DAMPING, LOST_DAMPING = 104, 116
SIZE = 128
#: The slice of the array that contains the low-order parts of J^-1. The columns of J^-1 are the
#: last three columns of coefficients of Euler's equations.
LOST_INVERSE = slice(LOST_EQUATIONS + 24, MOMENTS)


def pack(coefficients: Floats, moments: Floats, axes: Floats, damping: Floats) -> Floats:
    """
    Pack the constants of a body into one array of shape (SIZE,).

    Parameters
    ----------
    coefficients : array, shape (2, 3, 9)
        The coefficients of Euler's equations, as returned by `tensor.euler_coefficients`.
    moments, axes : array, shape (2, 3), (2, 3, 3)
        The principal moments and axes, as returned by `tensor.principal`.
    damping : array, shape (2, 3, 3), 1/s
        The matrix J^-1 D, as returned by `tensor.damping_coefficients`.

    """
    vectors = np.concatenate([coefficients[0].T, coefficients[1].T, moments,
                              axes[0].T, axes[1].T, damping[0].T, damping[1].T])
    return np.pad(vectors, [(0, 0), (0, 1)]).ravel()


@internal
def coefficients(constants: Floats, form: int) -> Coefficients:
    """Return the coefficients of Euler's equations for an inertia tensor of the given form."""
    columns = _columns(constants, EQUATIONS)
    return Coefficients(columns, _columns(constants, LOST_EQUATIONS),
                        of(columns[0][0], columns[1][1], columns[2][2]),
                        of(columns[6][0], columns[7][1], columns[8][2]), form)


@internal
def principal_frame(constants: Floats) -> PrincipalFrame:
    """Return the principal moments and axes of the body."""
    return (four.load(constants, MOMENTS), four.load(constants, LOST_MOMENTS),
            _three(constants, AXES), _three(constants, LOST_AXES))


@internal
def linear_constants(constants: Floats) -> Constants:
    """Return J^-1 and J^-1 D, the matrices in the terms of Euler's equations linear in w."""
    return Constants(
        Linear(_matrix(constants, EQUATIONS + 24), _matrix(constants, LOST_EQUATIONS + 24)),
        Linear(_matrix(constants, DAMPING), _matrix(constants, LOST_DAMPING)))


@internal
def _matrix(constants: Floats, start: int) -> Matrix:
    a, b, c = _three(constants, start)
    return from_columns(a, b, c)


@internal
def _columns(constants: Floats, start: int) -> Columns:
    a, b, c = _three(constants, start)
    d, e, f = _three(constants, start + 12)
    g, h, i = _three(constants, start + 24)
    return a, b, c, d, e, f, g, h, i


@internal
def _three(constants: Floats, start: int) -> tuple[Vector, Vector, Vector]:
    return (four.load(constants, start), four.load(constants, start + 4),
            four.load(constants, start + 8))
