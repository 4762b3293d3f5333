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
Vectors and quaternions for the compiled kernels, each held as four doubles in a register.

For the register operations, see `four`. The fourth component of a vector is zero. Quaternions
follow the conventions of `mechanics.so3`, which provides the same operations for arrays.
"""

from __future__ import annotations

from typing import NamedTuple

from rigid_body_ros.kernels import four
from rigid_body_ros.kernels.four import Four
from rigid_body_ros.kernels.jit import inlined, internal

Vector = Four
Quaternion = Four
#: The state of a body inside the kernels: the angular velocity (rad/s, body axes), the attitude,
#: and the low-order parts of the angular velocity and the attitude, which compensated summation
#: carries along.
KernelState = tuple[Vector, Quaternion, Vector, Quaternion]
#: The coefficients of a cubic polynomial, such as a torque, N m, as a function of the fraction of
#: a time span.
Polynomial = tuple[Vector, Vector, Vector, Vector]
Columns = tuple[Vector, Vector, Vector, Vector, Vector, Vector, Vector, Vector, Vector]
#: The principal moments (kg m^2) and their low-order parts, then the principal axes and their
#: low-order parts, as `tensor.principal` returns them.
PrincipalFrame = tuple[Vector, Vector, tuple[Vector, Vector, Vector],
                       tuple[Vector, Vector, Vector]]


class Coefficients(NamedTuple):
    """The coefficients of dw/dt, which is linear in the products of w and in the torque."""

    #: The columns that `tensor.euler_coefficients` returns, and their low-order parts.
    columns: Columns
    low: Columns
    #: The diagonal of the matrix formed by the first three columns, and the diagonal of the matrix
    #: formed by the last three columns.
    main: Vector
    diagonal: Vector
    #: The form of the inertia tensor: `euler_equations.DIAGONAL`, FULL or THIN.
    form: int


add = four.add


@inlined
def of(x: float, y: float, z: float) -> Vector:
    """Return the vector with components x, y and z."""
    return four.of(x, y, z, 0.0)


@inlined
def is_zero(a: Vector) -> bool:
    """Return whether all components are zero."""
    return a[0] == 0.0 and a[1] == 0.0 and a[2] == 0.0


@inlined
def scale(factor: float, a: Four) -> Four:
    """Multiply a vector or a quaternion by a factor."""
    return four.multiply(four.broadcast(factor), a)


@inlined
def add_scaled(a: Four, factor: float, b: Four) -> Four:
    """Return a + factor b."""
    return four.fma(four.broadcast(factor), b, a)


@inlined
def dot(a: Four, b: Four) -> float:
    """Return the dot product of two vectors or quaternions."""
    return total(four.multiply(a, b))


@inlined
def total(a: Four) -> float:
    """Return the sum of the four components."""
    return (a[0] + a[2]) + (a[1] + a[3])


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product of two vectors."""
    return four.fma(four.yzx(a), four.zxy(b), four.negative(
        four.multiply(four.zxy(a), four.yzx(b))))


@inlined
def combine(axes: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    """Return the vector whose components along the axes are the components of `a`."""
    return add_scaled(add_scaled(scale(a[2], axes[2]), a[1], axes[1]), a[0], axes[0])


@inlined
def combine_compensated(axes: tuple[Vector, Vector, Vector],
                        low_axes: tuple[Vector, Vector, Vector],
                        a: Vector) -> tuple[Vector, Vector]:
    """
    Return the result of `combine` and its low-order part.

    The axes are given by their high-order and low-order parts.

    The result is as accurate as if it were computed with twice the precision of a double (Ogita,
    Rump and Oishi, "Accurate sum and dot product", 2005).
    """
    x, y, z = four.broadcast(a[0]), four.broadcast(a[1]), four.broadcast(a[2])
    i, j, k = four.multiply(x, axes[0]), four.multiply(y, axes[1]), four.multiply(z, axes[2])
    rest = add(four.fma(x, axes[0], four.negative(i)), add(
        four.fma(y, axes[1], four.negative(j)), four.fma(z, axes[2], four.negative(k))))
    rest = add(rest, combine(low_axes, a))
    first, lost = two_sum(i, j)
    both, more = two_sum(first, k)
    return both, add(add(lost, more), rest)


@inlined
def two_sum(a: Four, b: Four) -> tuple[Four, Four]:
    """Return the sum and its exact rounding error (Knuth)."""
    new = add(a, b)
    b_rounded = four.subtract(new, a)
    return new, add(four.subtract(a, four.subtract(new, b_rounded)), four.subtract(b, b_rounded))


@internal
def shifted(polynomial: Polynomial, offset: float, ratio: float) -> Polynomial:
    """Return the polynomial p(offset + ratio s), given p(s), by Horner's rule (a Taylor shift)."""
    a, b, c, d = polynomial
    a = add_scaled(a, offset, add_scaled(b, offset, add_scaled(c, offset, d)))
    b = add_scaled(b, offset, add_scaled(scale(2.0, c), 3.0 * offset, d))
    c = add_scaled(c, 3.0 * offset, d)
    square = ratio * ratio
    return a, scale(ratio, b), scale(square, c), scale(square * ratio, d)


@inlined
def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the Hamilton product p q."""
    return add_scaled(add_scaled(add_scaled(scale(
        q[3], p), q[2], four.times_k(p)), q[1], four.times_j(p)), q[0], four.times_i(p))


@inlined
def to_body(q: Quaternion, vector: Vector) -> Vector:
    """Return the components in body axes of a vector given in space axes."""
    # R^T v = v - w t + u x t with t = 2 u x v, where u is the vector part of q.
    u = of(q[0], q[1], q[2])
    t = scale(2.0, cross(u, vector))
    return add(add_scaled(vector, -q[3], t), cross(u, t))


@inlined
def accumulate(total: Four, carry: Four, increment: Four) -> tuple[Four, Four]:
    """
    Return the sum total + increment + carry and its rounding error (Kahan).

    The rounding error is exact if the increment is smaller than the total. Otherwise, the returned
    rounding error is off by at most the rounding error of the increment.
    """
    increment = four.add(increment, carry)
    new = four.add(total, increment)
    return new, four.subtract(increment, four.subtract(new, total))


@inlined
def advance(state: KernelState, delta_omega: Vector, delta_q: Quaternion) -> KernelState:
    """Advance a state to w + delta_omega and q (1 + delta_q), and correct the norm of q."""
    w, q, low_w, low_q = state
    excess = dot(q, add_scaled(low_q, 0.5, q)) - 0.5
    change = add_scaled(multiply(q, delta_q), -excess, q)
    w, low_w = accumulate(w, low_w, delta_omega)
    q, low_q = accumulate(q, low_q, change)
    return w, q, low_w, low_q
