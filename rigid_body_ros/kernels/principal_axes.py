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
Principal moments and axes of many tensors, with the bits of `tensor.principal`.

Jacobi rotations in doubles give moments m_i and axes v_i. The exact axes are the sums of v_k x_ki
with x_ii = 1, where x solves

    sum over k of (r_jk + (m_k - m_i - d_i) g_jk) x_ki = 0  for each j,

the moments are m_i + d_i, r_jk = v_j . (J v_k - m_k v_k), and g_jk = v_j . v_k. All residuals are
as small as rounding errors, so doubles suffice for their products, and only what is linear in them
needs more. This is the refinement of Ogita and Aishima, "Iterative refinement for symmetric
eigenvalue decomposition", 2018, carried on until it converges.
"""

from __future__ import annotations

import math

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import body_layout
from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.triple_double import (
    add_product,
    add_scaled,
    normalized,
    store,
    TripleDouble,
)

#: Bound on the error of a residual, relative to the sum of the absolute entries of the tensor.
#: The error is less than 2^-148 of it.
_ERROR = 2.0 ** -145
#: Bound on the relative error of a product of residuals.
_SECOND_ORDER = 2.0 ** -46
#: Difference of moments, relative to the same sum, below which axes cannot be certain.
_CLOSE = 2.0 ** -30
#: More than the relative error of a rotation in doubles.
_ROUNDING = 2.0 ** -49
_SWEEPS, _ITERATIONS = 10, 4
_AMBIGUOUS = math.inf
_ZERO = (0.0, 0.0, 0.0)


@internal
def fill_principal(tensor: Floats, size: float, matrix: Floats, axes: Floats, residuals: Floats,
                   products: Floats, constants: Floats) -> bool:
    """
    Compute the principal moments and axes of a tensor that is not diagonal.

    Parameters
    ----------
    tensor : float64 (3, 3), kg m^2
        Symmetric.
    size : float, kg m^2
        Sum of the absolute values of its entries.
    matrix, axes : float64 (3, 3)
        Working memory.
    residuals, products : float64 (3, 3, 2)
        Working memory.
    constants : float64 (body_layout.SIZE,)
        Output: the moments and axes.

    Returns
    -------
    bool
        Whether all bits are certain to be those of `tensor.principal`.

    """
    if not _diagonalized(tensor, size, matrix, axes):
        return False
    first, second, third = _ascending(matrix)
    gap = min(matrix[second, second] - matrix[first, first],
              matrix[third, third] - matrix[second, second])
    if gap <= _CLOSE * size:
        return False
    x_bound = _fill_residuals(tensor, matrix, axes, residuals, products, gap)
    lost = _SECOND_ORDER * x_bound * x_bound
    axis_error = _ERROR * size / gap + lost
    moment_error = _ERROR * size + lost * (matrix[third, third] - matrix[first, first])
    lone = _lone_axis(tensor)
    odd = (second - first) % 3 != 1
    certain = True
    for place, i in enumerate((first, second, third)):
        exact = i == lone
        sign = -1.0 if odd and place == 2 else 1.0
        moment, x, y, length = _refined(i, matrix, residuals, products)
        certain &= store(moment, 0.0 if exact else moment_error, constants,
                         body_layout.MOMENTS + place, body_layout.LOST_MOMENTS + place)
        for k in range(3):
            a, b, c = _component(axes, k, i, x, y, length)
            certain &= store((sign * a, sign * b, sign * c),
                             0.0 if exact or k == lone else axis_error, constants,
                             body_layout.AXES + 4 * place + k,
                             body_layout.LOST_AXES + 4 * place + k)
    return certain


@internal
def _lone_axis(tensor: Floats) -> int:
    # Return the body axis that is a principal axis, whose moment and components are exact; or -1.
    for k in range(3):
        if tensor[k, (k + 1) % 3] == 0.0 and tensor[k, (k + 2) % 3] == 0.0:
            return k
    return -1


@internal
def _ascending(matrix: Floats) -> tuple[int, int, int]:
    # Return the order of the moments.
    first, second, third = 0, 1, 2
    if matrix[second, second] < matrix[first, first]:
        first, second = second, first
    if matrix[third, third] < matrix[second, second]:
        second, third = third, second
    if matrix[second, second] < matrix[first, first]:
        first, second = second, first
    return first, second, third


@internal
def _diagonalized(tensor: Floats, size: float, matrix: Floats, axes: Floats) -> bool:
    # Fill a nearly diagonal matrix, and the axes as columns, by Jacobi rotations in doubles.
    # Return whether these are, but for rounding errors, the rotations of `tensor.principal`.
    for a in range(3):
        for b in range(3):
            matrix[a, b], axes[a, b] = tensor[a, b], 1.0 if a == b else 0.0
    error = 0.0
    for _ in range(_SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            error = _rotated(matrix, axes, p, q, size, error)
        if error == _AMBIGUOUS:
            return False
        if abs(matrix[0, 1]) + abs(matrix[0, 2]) + abs(matrix[1, 2]) <= 2.0 ** -58 * size:
            return True
    return False


@internal
def _rotated(matrix: Floats, axes: Floats, p: int, q: int, size: float, error: float) -> float:
    # Rotate, given a bound on the error of the matrix, and return that bound after the rotation:
    # infinity if the sign of the rotation, and so that of an axis, depends on the error.
    difference = matrix[q, q] - matrix[p, p]
    if abs(difference) < 64.0 * error:
        return _AMBIGUOUS
    if matrix[p, q] == 0.0:
        return error
    half = difference / (2.0 * matrix[p, q])
    tangent = (1.0 if half >= 0.0 else -1.0) / (abs(half) + math.sqrt(half * half + 1.0))
    cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    a = 3 - p - q
    angle_error = 2.0 * error / (abs(difference) + abs(2.0 * matrix[p, q]))
    third = abs(matrix[a, p]) + abs(matrix[a, q])
    matrix[p, p] -= tangent * matrix[p, q]
    matrix[q, q] += tangent * matrix[p, q]
    matrix[p, q] = matrix[q, p] = 0.0
    matrix[a, p], matrix[a, q] = (cosine * matrix[a, p] - sine * matrix[a, q],
                                  sine * matrix[a, p] + cosine * matrix[a, q])
    matrix[p, a], matrix[q, a] = matrix[a, p], matrix[a, q]
    for k in range(3):
        axes[k, p], axes[k, q] = (cosine * axes[k, p] - sine * axes[k, q],
                                  sine * axes[k, p] + cosine * axes[k, q])
    return error + 2.0 * angle_error * third + _ROUNDING * size


@internal
def _fill_residuals(tensor: Floats, matrix: Floats, axes: Floats, residuals: Floats,
                    products: Floats, gap: float) -> float:
    # Fill r and g - 1 with their low-order parts; return a bound on the size of x.
    bound = 0.0
    for k in range(3):
        moment = matrix[k, k]
        a, b, c = (_rest(tensor, moment, axes, 0, k), _rest(tensor, moment, axes, 1, k),
                   _rest(tensor, moment, axes, 2, k))
        for j in range(3):
            total = add_scaled(_ZERO, a, axes[0, j])
            total = add_scaled(add_scaled(total, b, axes[1, j]), c, axes[2, j])
            residuals[j, k, 0], residuals[j, k, 1], _ = normalized(total)
            total = add_product((-1.0 if j == k else 0.0, 0.0, 0.0), axes[0, j], axes[0, k])
            total = add_product(add_product(total, axes[1, j], axes[1, k]), axes[2, j], axes[2, k])
            products[j, k, 0], products[j, k, 1], _ = normalized(total)
            bound += abs(residuals[j, k, 0]) / gap + abs(products[j, k, 0])
    return bound


@internal
def _rest(tensor: Floats, moment: float, axes: Floats, row: int, k: int) -> TripleDouble:
    # Return a component of J v - m v.
    total = add_product(_ZERO, tensor[row, 0], axes[0, k])
    total = add_product(total, tensor[row, 1], axes[1, k])
    total = add_product(total, tensor[row, 2], axes[2, k])
    return normalized(add_product(total, -moment, axes[row, k]))


@internal
def _refined(i: int, matrix: Floats, r: Floats, g: Floats) \
        -> tuple[TripleDouble, DoubleDouble, DoubleDouble, DoubleDouble]:
    # Return a moment; the components of its axis along the next two; and the length of v_i in the
    # axis of unit length, less 1.
    p, q = (i + 1) % 3, (i + 2) % 3
    to_p, to_q = matrix[p, p] - matrix[i, i], matrix[q, q] - matrix[i, i]
    d = x = y = 0.0
    in_i = in_p = in_q = 0.0  # the sums over products of residuals
    for _ in range(_ITERATIONS):
        in_i = ((r[i, p, 0] + (to_p - d) * g[i, p, 0]) * x
                + (r[i, q, 0] + (to_q - d) * g[i, q, 0]) * y - d * g[i, i, 0])
        d = r[i, i, 0] + in_i
        in_p = ((r[p, p, 0] + (to_p - d) * g[p, p, 0] - d) * x
                + (r[p, q, 0] + (to_q - d) * g[p, q, 0]) * y - d * g[p, i, 0])
        in_q = ((r[q, p, 0] + (to_p - d) * g[q, p, 0]) * x
                + (r[q, q, 0] + (to_q - d) * g[q, q, 0] - d) * y - d * g[q, i, 0])
        x, y = -(r[p, i, 0] + in_p) / to_p, -(r[q, i, 0] + in_q) / to_q
    high, low = dd.add((r[i, i, 0], r[i, i, 1]), (in_i, 0.0))
    along_p = dd.divide(dd.add((r[p, i, 0], r[p, i, 1]), (in_p, 0.0)),
                        dd.two_sum(matrix[i, i], -matrix[p, p]))
    along_q = dd.divide(dd.add((r[q, i, 0], r[q, i, 1]), (in_q, 0.0)),
                        dd.two_sum(matrix[i, i], -matrix[q, q]))
    squares = (2.0 * (g[i, p, 0] * x + g[i, q, 0] * y + g[p, q, 0] * x * y)
               + (1.0 + g[p, p, 0]) * x * x + (1.0 + g[q, q, 0]) * y * y)
    more, rest = dd.add((g[i, i, 0], g[i, i, 1]), (squares, 0.0))  # the square of the length, - 1
    length = dd.add((-0.5 * more, -0.5 * rest),
                    (more * more * (0.375 + more * (-0.3125 + more * 0.2734375)), 0.0))
    return normalized((matrix[i, i], high, low)), along_p, along_q, length


@internal
def _component(axes: Floats, k: int, i: int, x: DoubleDouble, y: DoubleDouble,
               length: DoubleDouble) -> TripleDouble:
    # Return a component of the axis of unit length.
    p, q = (i + 1) % 3, (i + 2) % 3
    x, y = dd.add(x, (x[0] * length[0], 0.0)), dd.add(y, (y[0] * length[0], 0.0))
    total = add_scaled((axes[k, i], 0.0, 0.0), (length[0], length[1], 0.0), axes[k, i])
    total = add_scaled(total, (x[0], x[1], 0.0), axes[k, p])
    return normalized(add_scaled(total, (y[0], y[1], 0.0), axes[k, q]))
