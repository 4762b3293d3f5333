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
Euler's equations for the compiled kernels, solved for the angular acceleration.

    dw/dt = J^-1 ((J w) x w) + J^-1 tau

The first term is linear in the six products of the components of w, and the second is linear in
the torque tau. The coefficients of both terms come from `tensor.euler_coefficients`.
"""

from __future__ import annotations

import math

from rigid_body_ros.kernels import four
from rigid_body_ros.kernels.jit import inlined
from rigid_body_ros.kernels.linear_terms import from_columns, Matrix
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    Coefficients,
    combine,
    combine_compensated,
    dot,
    Polynomial,
    scale,
    Vector,
)

#: Two vectors that hold the products (y z, z x, x y) and (x x, y y, z z) of the components of two
#: vectors, or sums of such products.
Products = tuple[Vector, Vector]

#: Forms of an inertia tensor: diagonal, full, or full and thin. In a thin body, one principal
#: moment is so much smaller than the others that computing J^-1 tau may lose more than a digit to
#: cancellation.
DIAGONAL, FULL, THIN = range(3)
#: A full tensor counts as THIN if its largest moment is more than this many times its smallest
#: moment. At this ratio, cancellation causes an error of 16 eps, which is a tenth of the other
#: rounding errors of a motion.
THIN_RATIO = 16.0


@inlined
def gyroscopic_acceleration(coefficients: Coefficients, products: Products) -> Vector:
    """Return J^-1 ((J w) x w), given the products of the components of w."""
    mixed, squares = products
    if coefficients.form == DIAGONAL:  # no low-order parts: rounding errors cancel over a period
        return four.multiply(coefficients.main, mixed)
    columns, low = coefficients.columns, coefficients.low
    rest = add(combine(low[:3], mixed), combine(low[3:6], squares))
    return _add_combined(_add_combined(rest, columns[3:6], squares), columns[:3], mixed)


@inlined
def add_gyroscopic_acceleration(rest: Vector, coefficients: Coefficients,
                                products: Products) -> Vector:
    """Add `gyroscopic_acceleration` to a vector."""
    if coefficients.form == DIAGONAL:
        return four.fma(coefficients.main, products[0], rest)
    return add(rest, gyroscopic_acceleration(coefficients, products))


@inlined
def add_jacobian(matrix: Matrix, coefficients: Coefficients, w: Vector) -> Matrix:
    """Add the derivative of `gyroscopic_acceleration` with respect to w to a matrix."""
    x, y, z = matrix
    yzx, zxy = four.yzx(w), four.zxy(w)
    if coefficients.form == DIAGONAL:
        return (x, four.fma(coefficients.main, zxy, y),
                four.fma(coefficients.main, yzx, z))
    columns, twice = coefficients.columns, scale(2.0, w)
    a, b, c = from_columns(columns[0], columns[1], columns[2])
    d, e, f = from_columns(columns[3], columns[4], columns[5])
    return (four.fma(d, twice, four.fma(c, yzx, four.fma(b, zxy, x))),
            four.fma(e, four.yzx(twice), four.fma(a, zxy, four.fma(c, w, y))),
            four.fma(f, four.zxy(twice), four.fma(b, w, four.fma(a, yzx, z))))


@inlined
def _add_combined(rest: Vector, columns: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    # Round each sum only once. With more roundings, the energy would drift in a long run.
    rest = add_scaled(rest, a[2], columns[2])
    return add_scaled(add_scaled(rest, a[1], columns[1]), a[0], columns[0])


@inlined
def acceleration_from_torque(coefficients: Coefficients, torque: Vector) -> Vector:
    """
    Return J^-1 tau in rad/s^2, for a torque in body axes.

    For a thin rod, J^-1 tau may be the small difference between terms that are a million times
    larger. The function therefore computes J^-1 tau in twice the working precision.
    """
    if coefficients.form == DIAGONAL:
        return four.multiply(coefficients.diagonal, torque)
    if coefficients.form == FULL:
        return combine(coefficients.columns[6:], torque)
    total, rest = combine_compensated(coefficients.columns[6:], coefficients.low[6:], torque)
    return add(total, rest)


@inlined
def acceleration_polynomial(coefficients: Coefficients, torque: Polynomial,
                            low: Polynomial) -> Polynomial:
    """
    Return J^-1 tau in rad/s^2 as a polynomial.

    The torque in body axes is given as a polynomial and the low-order part of this polynomial.
    """
    a, b, c, d = torque
    if coefficients.form != THIN:
        return (acceleration_from_torque(coefficients, a),
                acceleration_from_torque(coefficients, b),
                acceleration_from_torque(coefficients, c),
                acceleration_from_torque(coefficients, d))
    columns, low_columns = coefficients.columns[6:], coefficients.low[6:]
    return (acceleration_from_torque(coefficients, a),
            _combine_both(columns, low_columns, b, low[1]),
            _combine_both(columns, low_columns, c, low[2]),
            _combine_both(columns, low_columns, d, low[3]))


@inlined
def _combine_both(columns: tuple[Vector, Vector, Vector],
                  low_columns: tuple[Vector, Vector, Vector], torque: Vector,
                  low: Vector) -> Vector:
    total, rest = combine_compensated(columns, low_columns, torque)
    return add(total, add(rest, combine(columns, low)))


@inlined
def acceleration_bound(drive: Polynomial, in_space: bool, coefficients: Coefficients) -> float:
    """
    Return an upper bound on |J^-1 tau| in rad/s^2 that holds for the whole span of a drive.

    `taylor.step` uses this bound.
    """
    norm = size = 0.0
    for vector in drive:
        size += math.sqrt(dot(vector, vector))
    if not in_space:
        return size
    for column in coefficients.columns[6:]:  # the torque may point along any body axis
        norm += dot(column, column)
    return math.sqrt(norm) * size


@inlined
def products(a: Vector, b: Vector) -> Products:
    """Multiply the components of two vectors in all the combinations of `Products`."""
    return four.multiply(four.yzx(a), four.zxy(b)), four.multiply(a, b)


@inlined
def symmetric_products(a: Vector, b: Vector) -> Products:
    """Return `products(a, b)` plus `products(b, a)`."""
    return (four.fma(four.yzx(a), four.zxy(b), four.multiply(four.zxy(a), four.yzx(b))),
            scale(2.0, four.multiply(a, b)))


@inlined
def add_symmetric_products(sums: Products, a: Vector, b: Vector) -> Products:
    """Add `products(a, b)` and `products(b, a)` to sums of products."""
    return (four.fma(four.yzx(a), four.zxy(b), four.fma(four.zxy(a), four.yzx(b), sums[0])),
            four.fma(scale(2.0, a), b, sums[1]))
