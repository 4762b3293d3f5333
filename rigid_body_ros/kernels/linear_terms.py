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
The terms of Euler's equations that are linear in the angular velocity: rotors and damping.

    J dw/dt = (J w + h) x w + tau - D w

Together, the rotor momentum h and the damping D contribute A w to the acceleration, where
A = J^-1 ([h]x - D). The matrix A is computed in twice the working precision. Otherwise the
rounding error of A would be the same in every step, and the energy would drift in a long run.
"""

from __future__ import annotations

from typing import NamedTuple

from rigid_body_ros.kernels import four
from rigid_body_ros.kernels.jit import inlined
from rigid_body_ros.kernels.vector import add, of, scale, total, two_sum, Vector

#: The three diagonals of a matrix: the entries (i, i + k mod 3) for k = 0, 1 and 2. Stored this
#: way, a matrix can be multiplied by a vector with three multiplications of four numbers each.
Matrix = tuple[Vector, Vector, Vector]
#: The rotor momentum, N m s, as the coefficients of a polynomial of degree 4. The variable of the
#: polynomial is the fraction of a time span.
Momentum = tuple[Vector, Vector, Vector, Vector, Vector]
#: A vector and its low-order part.
Pair = tuple[Vector, Vector]


class Linear(NamedTuple):
    """A matrix and its low-order part."""

    matrix: Matrix
    low: Matrix


class Constants(NamedTuple):
    """The matrices that belong to a body."""

    #: J^-1, 1 / (kg m^2).
    inverse: Linear
    #: J^-1 D, 1/s.
    damping: Linear


@inlined
def from_columns(a: Vector, b: Vector, c: Vector) -> Matrix:
    """Return the matrix with the columns a, b and c."""
    return of(a[0], b[1], c[2]), of(b[0], c[1], a[2]), of(c[0], a[1], b[2])


@inlined
def at(constants: Constants, momentum: Vector, low: Vector) -> Linear:
    """
    Return the matrix A for a given rotor momentum.

    Parameters
    ----------
    constants : Constants
        The matrices of the body.
    momentum, low : Vector
        The rotor momentum and its low-order part, N m s, body axes.

    Returns
    -------
    Linear
        The matrix, 1/s.

    """
    (p, q, r), (low_p, low_q, low_r) = constants.inverse
    (d, e, f), (low_d, low_e, low_f) = constants.damping
    h, low_h, minus_h, minus_low_h = momentum, low, four.negative(momentum), four.negative(low)
    yzx, low_yzx = four.yzx(h), four.yzx(low_h)
    zxy, low_zxy = four.zxy(h), four.zxy(low_h)
    x, low_x = _diagonal((q, low_q), (zxy, low_zxy), (r, low_r),
                         (four.yzx(minus_h), four.yzx(minus_low_h)), (d, low_d))
    y, low_y = _diagonal((r, low_r), (h, low_h), (p, low_p),
                         (four.zxy(minus_h), four.zxy(minus_low_h)), (e, low_e))
    z, low_z = _diagonal((p, low_p), (yzx, low_yzx), (q, low_q),
                         (minus_h, minus_low_h), (f, low_f))
    return Linear((x, y, z), (low_x, low_y, low_z))


@inlined
def _diagonal(first: Pair, second: Pair, third: Pair, fourth: Pair, last: Pair) -> Pair:
    # Return p a + q b - d and its low-order part. The arguments are p, a, q, b and d, each with
    # its own low-order part.
    (p, low_p), (a, low_a), (q, low_q), (b, low_b), (d, low_d) = first, second, third, fourth, last
    left, right = four.multiply(p, a), four.multiply(q, b)
    rest = add(four.fma(p, a, four.negative(left)), four.fma(q, b, four.negative(right)))
    rest = four.fma(low_p, a, four.fma(low_q, b, rest))
    rest = four.fma(p, low_a, four.fma(q, low_b, rest))
    both, lost = two_sum(left, right)
    diagonal, more = two_sum(both, four.negative(d))
    return diagonal, add(four.subtract(rest, low_d), add(lost, more))


@inlined
def rotor_matrix(constants: Constants, momentum: Vector) -> Matrix:
    """Return J^-1 [h]x, 1/s, without low-order parts."""
    return times_cross(constants.inverse.matrix, momentum)


@inlined
def times_cross(inverse: Matrix, momentum: Vector) -> Matrix:
    """Return the product of a matrix and [h]x, without low-order parts."""
    p, q, r = inverse
    yzx, zxy, minus = four.yzx(momentum), four.zxy(momentum), four.negative(momentum)
    return (four.fma(q, zxy, four.multiply(r, four.yzx(minus))),
            four.fma(r, momentum, four.multiply(p, four.zxy(minus))),
            four.fma(p, yzx, four.multiply(q, minus)))


@inlined
def rounded_at(constants: Constants, momentum: Vector) -> Linear:
    """
    Return the matrix that `at` returns, but without its low-order part.

    Leaving out the low-order part saves most of the time that `at` takes.
    """
    x, y, z = rotor_matrix(constants, momentum)
    d, e, f = constants.damping.matrix
    none = four.broadcast(0.0)
    return Linear((four.subtract(x, d), four.subtract(y, e), four.subtract(z, f)),
                  (none, none, none))


@inlined
def square_rate(matrix: Matrix) -> float:
    """
    Return the square, 1/s^2, of the angular rate that would limit a step as much as a matrix.

    This rate is half the Frobenius norm of the matrix. Linear terms limit the step size less than
    the products of w. With linear terms alone, the motion would be an entire function, whose
    series converges everywhere.
    """
    x, y, z = matrix
    return 0.25 * total(four.fma(x, x, four.fma(y, y, four.multiply(z, z))))


@inlined
def is_zero(matrix: Matrix) -> bool:
    """Return whether all entries are zero."""
    x, y, z = matrix  # do not add up squares, because squares of small entries would underflow
    return total(add(four.absolute(x), add(four.absolute(y), four.absolute(z)))) == 0.0


@inlined
def add_product(rest: Vector, matrix: Matrix, w: Vector, w_yzx: Vector, w_zxy: Vector) -> Vector:
    """Return `rest` plus the matrix times the vector w, given w in its three permutations."""
    x, y, z = matrix
    return add(four.fma(z, w_zxy, rest), four.fma(y, w_yzx, four.multiply(x, w)))


@inlined
def product(matrix: Matrix, w: Vector) -> Vector:
    """Return the product of a matrix and a vector."""
    return add_product(four.broadcast(0.0), matrix, w, four.yzx(w), four.zxy(w))


@inlined
def multiple(factor: float, matrix: Matrix) -> Matrix:
    """Return a matrix multiplied by a factor."""
    x, y, z = matrix
    return scale(factor, x), scale(factor, y), scale(factor, z)


@inlined
def scaled(linear: Linear, factor: float) -> Linear:
    """Return a matrix and its low-order part, both multiplied by a factor."""
    (x, y, z), (low_x, low_y, low_z) = linear
    x, low_x = _scaled_diagonal(x, low_x, factor)
    y, low_y = _scaled_diagonal(y, low_y, factor)
    z, low_z = _scaled_diagonal(z, low_z, factor)
    return Linear((x, y, z), (low_x, low_y, low_z))


@inlined
def _scaled_diagonal(diagonal: Vector, low: Vector, factor: float) -> tuple[Vector, Vector]:
    by = four.broadcast(factor)
    high = four.multiply(by, diagonal)
    return high, four.fma(by, low, four.fma(by, diagonal, four.negative(high)))
