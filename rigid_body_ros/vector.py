"""
Vectors and quaternions for the compiled kernels: tuples of three and four floats.

A tuple lives in registers, where a small array would be memory to manage. Quaternions are stored
and composed as in `so3`, which is for arrays.
"""

from __future__ import annotations

from rigid_body_ros._jit import fma, inlined

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
#: Angular velocity and attitude, and what rounding took from them.
State = tuple[Vector, Quaternion, Vector, Quaternion]
#: Torque, N m: coefficients of a cubic in the fraction of a span of time.
Polynomial = tuple[Vector, Vector, Vector, Vector]
Nine = tuple[float, float, float, float, float, float, float, float, float]
#: Euler's equations by rows, and what rounding took: as `tensor.euler_coefficients` has them.
Coefficients = tuple[tuple[Nine, Nine, Nine], tuple[Nine, Nine, Nine]]
#: Principal moments and axes, and what rounding took from both, as `tensor.principal` does.
Frame = tuple[Vector, Vector, tuple[Vector, Vector, Vector], tuple[Vector, Vector, Vector]]


@inlined
def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def scale(factor: float, a: Vector) -> Vector:
    """Return factor a."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def add_scaled(a: Vector, factor: float, b: Vector) -> Vector:
    """Return a + factor b."""
    return fma(factor, b[0], a[0]), fma(factor, b[1], a[1]), fma(factor, b[2], a[2])


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return (fma(a[1], b[2], -a[2] * b[1]), fma(a[2], b[0], -a[0] * b[2]),
            fma(a[0], b[1], -a[1] * b[0]))


@inlined
def combine(axes: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    """Return the vector that has components a along the axes."""
    return add_scaled(add_scaled(scale(a[2], axes[2]), a[1], axes[1]), a[0], axes[0])


@inlined
def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return Hamilton's product p q."""
    return (fma(p[3], q[0], fma(p[1], q[2], fma(p[0], q[3], -p[2] * q[1]))),
            fma(p[3], q[1], fma(p[2], q[0], fma(p[1], q[3], -p[0] * q[2]))),
            fma(p[3], q[2], fma(p[0], q[1], fma(p[2], q[3], -p[1] * q[0]))),
            fma(p[3], q[3], -fma(p[0], q[0], fma(p[1], q[1], p[2] * q[2]))))


@inlined
def to_body(q: Quaternion, vector: Vector) -> Vector:
    """Return the body components of a space vector."""
    # R^T v = v - w t + u x t with t = 2 u x v, u the vector part of q.
    u = (q[0], q[1], q[2])
    t = scale(2.0, cross(u, vector))
    return add(add_scaled(vector, -q[3], t), cross(u, t))


@inlined
def accumulate(total: float, carry: float, increment: float) -> tuple[float, float]:
    """
    Return total + increment, and what rounding took from it.

    Kahan's form: exact where the increment is the smaller, and where it is not, no worse than
    the rounding of the increment itself.
    """
    increment += carry
    new = total + increment
    return new, increment - (new - total)
