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
Elliptic integrals and functions for the compiled kernels, as functions of 1 - m.

The functions take the complementary parameter m_c = 1 - m instead of m, because m rounds to 1 near
the separatrix, where m_c is 1e-12 or 1e-20. Complete integrals have 32 digits, because a long
motion multiplies their errors by the number of periods.

SciPy's functions cannot be called from kernels, and their last bits depend on the machine.
The argument of `scipy.special.ellipj` is m. Therefore the relative error of `ellipj` is 1e-8 at
m_c = 1e-9 and 2e-4 at m_c = 1e-15. The error of `jacobi` is 5e-15. SciPy's `elliprf` and `elliprj`
are as accurate as `carlson_f` and `carlson_j`: the errors of all four are up to 2e-15. R_J takes
0.5 us in SciPy and 0.3 us here.
"""

from __future__ import annotations

import math

from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels import elementary
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import inlined, internal

#: Largest number of iterations. Landen's transformation converges quadratically, and takes 13
#: iterations for m_c = 1e-300.
_MOST = 16
#: Space for one number from each iteration. Unlike a list, a tuple takes no memory from the heap.
_NONE = (0.0,)
_ROOM = _NONE * _MOST


@internal
def complete(complement: DoubleDouble, p: DoubleDouble, a: DoubleDouble,
             b: DoubleDouble) -> DoubleDouble:
    """
    Return the integral of (a cos^2 + b sin^2) / (cos^2 + p sin^2) / sqrt(cos^2 + m_c sin^2).

    The limits are 0 and pi / 2; m_c > 0 and p > 0 (Bulirsch, "Numerical calculation of elliptic
    integrals and elliptic functions III", 1969). K(m) is `complete(m_c, 1, 1, 1)`, and Pi(n, m)
    is `complete(m_c, 1 - n, 1, 1)`.
    """
    kc = dd.sqrt(complement)
    e, em = kc, (1.0, 0.0)
    p = dd.sqrt(p)
    b = dd.divide(b, p)
    for _ in range(_MOST):
        f, a = a, dd.add(a, dd.divide(b, p))
        g = dd.divide(e, p)
        b = dd.add(b, dd.multiply(f, g))
        b = (2.0 * b[0], 2.0 * b[1])
        p = dd.add(g, p)
        g, em = em, dd.add(em, kc)
        if abs(g[0] - kc[0]) <= 1e-17 * g[0]:
            break
        kc = dd.sqrt(e)
        kc = (2.0 * kc[0], 2.0 * kc[1])
        e = dd.multiply(kc, em)
    half_pi = (0.5 * dd.PI[0], 0.5 * dd.PI[1])
    top = dd.multiply(half_pi, dd.add(b, dd.multiply(a, em)))
    return dd.divide(top, dd.multiply(em, dd.add(em, p)))


@internal
def jacobi(u: float, complement: float) -> tuple[float, float, float]:
    """
    Return sn, cn and dn of u, |u| <= K, each with a small relative error.

    The method is the arithmetic-geometric mean (Bulirsch, "Numerical calculation of elliptic
    integrals and elliptic functions", 1965).
    """
    if complement == 0.0:
        tangent, secant = elementary.tanh_sech(u)
        return tangent, secant, secant
    if abs(u) < 1e-9:
        return u, 1.0, 1.0
    a, kc, count = 1.0, math.sqrt(complement), 0
    means = roots = _ROOM
    for index in range(_MOST):
        means, roots, count = _shifted(means, a), _shifted(roots, kc), index
        c = 0.5 * (a + kc)
        if abs(a - kc) <= 1e-8 * a:
            break
        kc, a = math.sqrt(a * kc), c
    sn, cn = elementary.sine_cosine(c * u)
    dn = 1.0
    a = cn / sn
    c = a * c
    for _ in range(count + 1):  # go back from the last iteration, which is first in the tuples
        a = c * a
        c = dn * c
        dn = (roots[0] + a) / (means[0] + a)
        a = c / means[0]
        means, roots = means[1:] + _NONE, roots[1:] + _NONE
    a = 1.0 / math.sqrt(c * c + 1.0)
    sn = a if sn >= 0.0 else -a
    return sn, c * sn, dn


@inlined
def _shifted(numbers: tuple[float, ...], first: float) -> tuple[float, ...]:
    # Return the numbers with a new first number in front, and without the last number.
    return (first, *numbers[:-1])


@internal
def carlson_f(x: float, y: float, z: float) -> float:
    """Return the symmetric integral R_F (B. C. Carlson, Numerical Algorithms 10, 1995)."""
    mean = (x + y + z) / 3.0
    bound = 400.0 * max(abs(mean - x), abs(mean - y), abs(mean - z))
    dx, dy, scale = mean - x, mean - y, 1.0
    while scale * bound > abs(mean):
        p, q, r = math.sqrt(x), math.sqrt(y), math.sqrt(z)
        step = p * q + q * r + r * p
        x, y, z, mean = 0.25 * (x + step), 0.25 * (y + step), 0.25 * (z + step), \
            0.25 * (mean + step)
        scale *= 0.25
    dx, dy = dx * scale / mean, dy * scale / mean
    dz = -dx - dy
    e2, e3 = dx * dy - dz * dz, dx * dy * dz
    series = 1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0 \
        - 5.0 * e2 * e2 * e2 / 208.0 + 3.0 * e3 * e3 / 104.0 + e2 * e2 * e3 / 16.0
    return series / math.sqrt(mean)


@internal
def carlson_j(x: float, y: float, z: float, p: float) -> float:
    """Return R_J for p >= x, y, z, by duplication with R_C(1, 1 + e) (Carlson 1995)."""
    mean = (x + y + z + 2.0 * p) / 5.0
    bound = 400.0 * max(abs(mean - x), abs(mean - y), abs(mean - z), abs(mean - p))
    dx, dy, dz = mean - x, mean - y, mean - z
    delta = (p - x) * (p - y) * (p - z)
    scale, total = 1.0, 0.0
    while scale * bound > abs(mean):
        a, b, c, d = math.sqrt(x), math.sqrt(y), math.sqrt(z), math.sqrt(p)
        step = a * b + b * c + c * a
        product = (d + a) * (d + b) * (d + c)
        excess = delta * scale * scale * scale / (product * product)
        total += scale / product * _carlson_c1(excess)
        x, y, z, p, mean = 0.25 * (x + step), 0.25 * (y + step), 0.25 * (z + step), \
            0.25 * (p + step), 0.25 * (mean + step)
        scale *= 0.25
    dx, dy, dz = dx * scale / mean, dy * scale / mean, dz * scale / mean
    dp = -0.5 * (dx + dy + dz)
    e2 = dx * dy + dx * dz + dy * dz - 3.0 * dp * dp
    e3 = dx * dy * dz + 2.0 * e2 * dp + 4.0 * dp * dp * dp
    e4 = (2.0 * dx * dy * dz + e2 * dp + 3.0 * dp * dp * dp) * dp
    e5 = dx * dy * dz * dp * dp
    series = 1.0 - 3.0 * e2 / 14.0 + e3 / 6.0 + 9.0 * e2 * e2 / 88.0 - 3.0 * e4 / 22.0 \
        - 9.0 * e2 * e3 / 52.0 + 3.0 * e5 / 26.0 - e2 * e2 * e2 / 16.0 + 3.0 * e3 * e3 / 40.0 \
        + 3.0 * e2 * e4 / 20.0 + 45.0 * e2 * e2 * e3 / 272.0 - 9.0 * (e3 * e4 + e2 * e5) / 68.0
    return scale * series / (mean * math.sqrt(mean)) + 6.0 * total


@internal
def _carlson_c1(e: float) -> float:
    # Return R_C(1, 1 + e) for e >= 0.
    if e < 1e-2:
        return 1.0 - e * (1 / 3 - e * (1 / 5 - e * (1 / 7 - e * (1 / 9 - e * (
            1 / 11 - e * (1 / 13 - e * (1 / 15 - e / 17)))))))
    root = math.sqrt(e)
    return elementary.arctangent(root, 1.0) / root
