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
Elliptic integrals and functions for the compiled kernels.

The functions take the complementary parameter m_c = 1 - m instead of m. Near the separatrix, m_c
may be as small as 1e-12 or 1e-20. If we rounded m to a double, few or none of the digits of m_c
would survive. Complete integrals are computed to 32 digits, because over a long motion their
errors are multiplied by the number of periods.

We do not use SciPy's functions, because kernels cannot call them, and because the last bits of
their results depend on the machine. In addition, `scipy.special.ellipj` takes m as its argument,
so its relative error is 1e-8 at m_c = 1e-9, and 2e-4 at m_c = 1e-15. The relative error of
`jacobi` is 5e-15. SciPy's `elliprf` and `elliprj` are as accurate as `carlson_f` and `carlson_j`,
with errors of up to 2e-15. Computing R_J takes 0.5 us in SciPy and 0.3 us here.
"""

from __future__ import annotations

import math

from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels import elementary
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import inlined, internal

#: Maximum number of iterations. Landen's transformation converges quadratically, so that even
#: m_c = 1e-300 takes only 13 iterations.
_MOST = 16
#: A tuple with room for one number per iteration. A list would be allocated on the heap.
_NONE = (0.0,)
_ROOM = _NONE * _MOST


@internal
def complete(complement: DoubleDouble, p: DoubleDouble, a: DoubleDouble,
             b: DoubleDouble) -> DoubleDouble:
    """
    Return the integral of (a cos^2 + b sin^2) / (cos^2 + p sin^2) / sqrt(cos^2 + m_c sin^2).

    The integral runs from 0 to pi / 2, and both m_c and p must be positive. The algorithm is that
    of Bulirsch, "Numerical calculation of elliptic integrals and elliptic functions III", 1969. To
    compute K(m), call `complete(m_c, 1, 1, 1)`. To compute Pi(n, m), call
    `complete(m_c, 1 - n, 1, 1)`.
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
    Return sn, cn and dn of u for |u| <= K, each with a small relative error.

    The functions are computed by the arithmetic-geometric mean, as in Bulirsch, "Numerical
    calculation of elliptic integrals and elliptic functions", 1965.
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
    for _ in range(count + 1):  # backwards: the tuples begin with the last iteration
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
    # Put a new number in front of the others, and drop the last one.
    return (first, *numbers[:-1])


@internal
def carlson_f(x: float, y: float, z: float) -> float:
    """Return the symmetric integral R_F, as in B. C. Carlson, Numerical Algorithms 10, 1995."""
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
    """
    Return the symmetric integral R_J, computed by Carlson's duplication algorithm (1995).

    The argument p must not be smaller than x, y or z. The algorithm also uses the integral
    R_C(1, 1 + e).
    """
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
