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
Principal moments and axes of many tensors, bit-identical to those of `tensor.principal`.

We first compute approximate moments m_k and axes v_k by Jacobi rotations in double precision. The
exact axis i then points along the sum of v_k z_k over k, with z_i = 1, and the exact moment i is
m_i + d. The unknowns z_k and d obey

    sum over k of (r_jk + (m_k - m_i - d) g_jk) z_k = 0  for each j,
    r_jk = v_j . (J v_k - m_k v_k),  g_jk = v_j . v_k.

The numbers r_jk, g_jk for j != k, and g_kk - 1 are the residuals. They are as small as rounding
errors. Only the residuals themselves have to be computed beyond double precision. For products of
residuals, doubles are accurate enough. This is the method of Ogita and Aishima, "Iterative
refinement for symmetric eigenvalue decomposition", 2018, iterated until it converges.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import body_layout
from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels.jit import internal, njit, WRITTEN
from rigid_body_ros.kernels.triple_double import (
    add_product,
    add_scaled,
    ERROR,
    normalized,
    store,
    TripleDouble,
)

#: Bounds on the relative errors of a product of residuals and of double-double arithmetic.
_PRODUCT_ERROR, _PAIR_ERROR = 2.0 ** -48, 2.0 ** -100
#: Bound on the error of `tensor.principal`, in units of ERROR. The error is not zero, because
#: `tensor.principal` neglects off-diagonal entries below 1e-54.
_EXACT_ERROR = 2.0 ** -178 / ERROR
#: The iteration may not converge if two moments are too close together. The difference between two
#: moments must therefore exceed this fraction of the sum of the absolute values of all tensor
#: entries.
_CLOSE = 2.0 ** -30
#: Bound on the relative error of a Jacobi rotation in double precision.
_ROUNDING = 2.0 ** -49
_SWEEPS, _ITERATIONS = 10, 3
_AMBIGUOUS = math.inf
_ZERO = (0.0, 0.0, 0.0)


class AxesWorkspace(NamedTuple):
    """Work arrays for computing principal moments and axes."""

    #: The tensor expressed in the axes found so far, these axes as columns, and the shares that
    #: `_refine` computes.
    matrix: Annotated[Floats, '3 3', WRITTEN]
    axes: Annotated[Floats, '3 3', WRITTEN]
    shares: Annotated[Floats, '3 3', WRITTEN]
    #: See `_fill_residuals`.
    r: Annotated[Floats, '3 3 3', WRITTEN]
    g: Annotated[Floats, '3 3 3', WRITTEN]
    #: The moments, and the results of `_iterate`.
    moments: Annotated[Floats, '3', WRITTEN]
    z: Annotated[Floats, '3', WRITTEN]
    sums: Annotated[Floats, '3', WRITTEN]


def workspace() -> AxesWorkspace:
    """Return uninitialized work arrays."""
    return AxesWorkspace(*(np.empty(dimensions * (3,)) for dimensions in (2, 2, 2, 3, 3, 1, 1, 1)))


@njit
def fill_components(high: Annotated[Floats, '3 3'], low: Annotated[Floats, '3 3'],
                    vectors: Annotated[Floats, 'n 3'],
                    components: Annotated[Floats, 'n 3 2', WRITTEN]) -> None:
    """
    Compute the components of vectors along the given axes.

    Parameters
    ----------
    high, low : float64 (3, 3)
        The axes as columns, and their low-order parts.
    vectors : float64 (n, 3)
        The vectors.
    components : float64 (n, 3, 2)
        The output. Each component has a high-order part and a low-order part.

    """
    for row in range(len(vectors)):
        for axis in range(3):
            total = (0.0, 0.0)
            for k in range(3):
                total = dd.add(total, dd.multiply((high[k, axis], low[k, axis]),
                                                  (vectors[row, k], 0.0)))
            components[row, axis, 0], components[row, axis, 1] = total


@internal
def fill_principal(tensor: Floats, constants: Floats, work: AxesWorkspace) -> bool:
    """
    Compute the principal moments and axes of a tensor that is not diagonal.

    Parameters
    ----------
    tensor : float64 (3, 3), kg m^2
        The symmetric tensor.
    constants : float64 (body_layout.SIZE,)
        The output. Only the moments and the axes are written.
    work : AxesWorkspace
        Work arrays, which the function overwrites.

    Returns
    -------
    bool
        Whether the output is certain to be bit-identical to the result of `tensor.principal`.

    """
    matrix, axes, moments = work.matrix, work.axes, work.moments
    size = 0.0
    for a in range(3):
        for b in range(3):
            size += abs(tensor[a, b])
    if not _diagonalized(tensor, size, matrix, axes):
        return False
    _sort(matrix, axes, moments)
    if min(moments[1] - moments[0], moments[2] - moments[1]) <= _CLOSE * size:
        return False
    if _refined(tensor, size, work, constants):
        return True
    # If two moments are close together, the Jacobi axes are too inaccurate for a single
    # refinement. The refined axes are accurate, so refine once more, starting from them.
    for i in range(3):
        moments[i] = constants[body_layout.MOMENTS + i]
        for c in range(3):
            axes[c, i] = constants[body_layout.AXES + 4 * i + c]
    return _refined(tensor, size, work, constants)


@internal
def _diagonalized(tensor: Floats, size: float, matrix: Floats, axes: Floats) -> bool:
    # Make the matrix nearly diagonal by Jacobi rotations in double precision, and fill in the axes
    # as columns. Return whether `tensor.principal` would use the same rotations, apart from
    # rounding errors.
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
    # Apply a Jacobi rotation to a matrix whose error is at most `error`, and return the error
    # bound after the rotation. Return infinity if the error could change the sign of the rotation,
    # and therefore the sign of an axis.
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
def _sort(matrix: Floats, axes: Floats, moments: Floats) -> None:
    # Fill in the moments in ascending order, and sort the axes accordingly. If the permutation is
    # odd, reverse the last axis so that the axes stay right-handed.
    odd = False
    for i in range(3):
        moments[i] = matrix[i, i]
    for p, q in ((0, 1), (1, 2), (0, 1)):
        if moments[q] < moments[p]:
            odd = not odd
            moments[p], moments[q] = moments[q], moments[p]
            for c in range(3):
                axes[c, p], axes[c, q] = axes[c, q], axes[c, p]
    if odd:
        for c in range(3):
            axes[c, 2] = -axes[c, 2]


@internal
def _refined(tensor: Floats, size: float, work: AxesWorkspace, constants: Floats) -> bool:
    # Refine and store the moments and axes. Return whether every bit of the moments and axes is
    # certain to be correct.
    axes, shares = work.axes, work.shares
    _fill_residuals(tensor, size, work.moments, axes, work.r, work.g)
    certain = True
    for i in range(3):
        moment, error = _refine(i, work)
        certain &= store(moment, error, constants, body_layout.MOMENTS + i,
                         body_layout.LOST_MOMENTS + i)
        for c in range(3):
            total, error = (axes[c, i], 0.0, 0.0), 0.0
            for k in range(3):
                total = add_scaled(total, (shares[k, 0], shares[k, 1], 0.0), axes[c, k])
                error += shares[k, 2] * abs(axes[c, k])
            certain &= store(normalized(total), error, constants,
                             body_layout.AXES + 4 * i + c, body_layout.LOST_AXES + 4 * i + c)
    return certain


@internal
def _fill_residuals(tensor: Floats, size: float, moments: Floats, axes: Floats, r: Floats,
                    g: Floats) -> None:
    # Fill in the residuals: r_jk for all j and k, g_jk for j != k, and g_kk - 1. Each residual has
    # a high-order part, a low-order part and an error bound in units of ERROR. If a principal axis
    # is a body axis, `tensor.principal` computes this axis and its moment exactly.
    for k in range(3):
        a, a_size = _rest(tensor, moments[k], axes, 0, k)
        b, b_size = _rest(tensor, moments[k], axes, 1, k)
        c, c_size = _rest(tensor, moments[k], axes, 2, k)
        for j in range(3):
            total = add_scaled(add_scaled(_ZERO, a, axes[0, j]), b, axes[1, j])
            r[j, k, 0], r[j, k, 1], _ = normalized(add_scaled(total, c, axes[2, j]))
            r[j, k, 2] = (a_size * abs(axes[0, j]) + b_size * abs(axes[1, j])
                          + c_size * abs(axes[2, j]))
            if r[j, k, 2] > 0.0:
                r[j, k, 2] += _EXACT_ERROR * size
            total, g[j, k, 2] = _square_less_one(axes, k) if j == k else _product(axes, j, k)
            g[j, k, 0], g[j, k, 1], _ = normalized(total)
            if g[j, k, 2] > 0.0:
                g[j, k, 2] += _EXACT_ERROR


@internal
def _rest(tensor: Floats, moment: float, axes: Floats, row: int, k: int) \
        -> tuple[TripleDouble, float]:
    # Return one component of J v - m v, and the sum of the absolute values of the terms of this
    # component.
    a, b = (row + 1) % 3, (row + 2) % 3
    high, low = dd.two_sum(tensor[row, row], -moment)
    total = add_product(add_product(_ZERO, high, axes[row, k]), low, axes[row, k])
    total = add_product(total, tensor[row, a], axes[a, k])
    total = add_product(total, tensor[row, b], axes[b, k])
    return normalized(total), (abs(high * axes[row, k]) + abs(tensor[row, a] * axes[a, k])
                               + abs(tensor[row, b] * axes[b, k]))


@internal
def _square_less_one(axes: Floats, k: int) -> tuple[TripleDouble, float]:
    # Return v . v - 1, and the sum of the absolute values of its terms. The 1 is subtracted from
    # the square of the largest component x, computing x^2 - 1 as (x - 1) (x + 1).
    total, size, largest = _ZERO, 0.0, 0
    for c in range(1, 3):
        if abs(axes[c, k]) > abs(axes[largest, k]):
            largest = c
    for c in range(3):
        x = abs(axes[c, k])
        if c == largest:
            high, low = dd.two_sum(x, 1.0)
            total = add_product(add_product(total, x - 1.0, high), x - 1.0, low)
            size += abs((x - 1.0) * high)
        else:
            total = add_product(total, x, x)
            size += x * x
    return total, size


@internal
def _product(axes: Floats, j: int, k: int) -> tuple[TripleDouble, float]:
    # Return v_j . v_k, and the sum of the absolute values of its terms.
    total, size = _ZERO, 0.0
    for c in range(3):
        total = add_product(total, axes[c, j], axes[c, k])
        size += abs(axes[c, j] * axes[c, k])
    return total, size


@internal
def _refine(i: int, work: AxesWorkspace) -> tuple[TripleDouble, float]:
    # Return moment i and its error bound. Also fill in the shares, which are the coefficients of
    # the v_k in the unit vector along axis i, with 1 subtracted from the share of v_i. Each share
    # has a high-order part, a low-order part and an error bound.
    _, _, shares, r, g, moments, z, sums = work
    for k in range(3):
        z[k] = sums[k] = 0.0
    d = _iterate(i, moments, r, g, z, sums)
    for k in ((i + 1) % 3, (i + 2) % 3):
        products, size = _products(k, i, d, moments, r, g, z)
        error = ERROR * r[k, i, 2] + _PRODUCT_ERROR * size + abs(products - sums[k])
        dividend = dd.add((r[k, i, 0], r[k, i, 1]), (products, 0.0))
        divisor = dd.two_sum(moments[i], -moments[k])
        shares[k, 0], shares[k, 1] = dd.divide(dividend, divisor)
        shares[k, 2] = error / abs(divisor[0]) + _PAIR_ERROR * abs(shares[k, 0])
    _normalize(i, g, z, shares)
    products, size = _products(i, i, d, moments, r, g, z)
    high, low = dd.add((r[i, i, 0], r[i, i, 1]), (products, 0.0))
    error = ERROR * r[i, i, 2] + _PRODUCT_ERROR * size + abs(products - sums[i])
    return normalized((moments[i], high, low)), error + _PAIR_ERROR * abs(high)


@internal
def _iterate(i: int, moments: Floats, r: Floats, g: Floats, z: Floats, sums: Floats) -> float:
    # Return the correction d of moment i. Fill in `z`, with 0 instead of 1 for z_i, and fill in
    # `sums` with the sum of the products of residuals in each row.
    d = 0.0
    for _ in range(_ITERATIONS):
        for k in (i, (i + 1) % 3, (i + 2) % 3):
            sums[k], _ = _products(k, i, d, moments, r, g, z)
            if k == i:
                d = r[i, i, 0] + sums[i]
            else:
                z[k] = (r[k, i, 0] + sums[k]) / (moments[i] - moments[k])
    return d


@internal
def _products(row: int, i: int, d: float, moments: Floats, r: Floats, g: Floats, z: Floats) \
        -> tuple[float, float]:
    # Return the sum of the products of residuals in one row of the equations, and the sum of the
    # absolute values of these products.
    total = -d * (g[row, i, 0] + z[row])
    size = abs(d) * (abs(g[row, i, 0]) + abs(z[row]))
    for k in range(3):
        by_product = (moments[k] - moments[i] - d) * g[row, k, 0]
        total += (r[row, k, 0] + by_product) * z[k]
        size += (abs(r[row, k, 0]) + abs(by_product)) * abs(z[k])
    return total, size


@internal
def _normalize(i: int, g: Floats, z: Floats, shares: Floats) -> None:
    # Fill in the share of v_i, minus 1, and scale the other shares so that the axis has unit
    # length.
    squares = size = 0.0
    for k in range(3):
        more = 2.0 * g[i, k, 0] + z[k]
        for j in range(3):
            more += g[k, j, 0] * z[j]
        squares += z[k] * more
        size += abs(z[k]) * (2.0 * abs(g[i, k, 0]) + abs(z[k]))
    high, low = dd.add((g[i, i, 0], g[i, i, 1]), (squares, 0.0))  # the squared length minus 1
    series = high * high * (0.375 + high * (-0.3125 + high * 0.2734375))
    shares[i, 0], shares[i, 1] = dd.add((-0.5 * high, -0.5 * low), (series, 0.0))
    shares[i, 2] = (ERROR * g[i, i, 2] + _PRODUCT_ERROR * (size + high * high)
                    + _PAIR_ERROR * abs(high))
    for k in ((i + 1) % 3, (i + 2) % 3):
        shares[k, 0], shares[k, 1] = dd.add((shares[k, 0], shares[k, 1]),
                                            (shares[k, 0] * shares[i, 0], 0.0))
        shares[k, 2] += _PRODUCT_ERROR * abs(shares[k, 0] * shares[i, 0])
