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

"""Elliptic functions and integrals, and numbers of 32 digits, compared with mpmath."""

import mpmath
from mpmath import mpf
import numpy as np
import pytest
from rigid_body_ros.kernels import elliptic
from scipy import special

pytestmark = pytest.mark.usefixtures('fifty_digits')

RANDOM = np.random.default_rng(17)
#: Complementary parameters, from far away from the separatrix to where `free_motion` gives up.
COMPLEMENTS = [*(10.0 ** RANDOM.uniform(-24, 0, 20)), 1.0, 0.5, 1e-10, 1e-24]


def split(value):
    return float(value), float(value - mpf(float(value)))


def joined(pair):
    return mpf(pair[0]) + mpf(pair[1])


@pytest.mark.slow
def test_complete_integrals_have_thirty_digits():
    complete = elliptic.complete
    one, nought = (1.0, 0.0), (0.0, 0.0)
    for complement in COMPLEMENTS:
        m_c, n = mpf(complement), -mpf(10.0 ** RANDOM.uniform(-12, 12))
        k, third = mpmath.ellipk(1 - m_c), mpmath.ellippi(n, 1 - m_c)
        p = split(1 - n)
        assert abs(joined(complete((complement, 0.0), one, one, one)) / k - 1) < 1e-30
        assert abs(joined(complete((complement, 0.0), p, one, one)) / third - 1) < 1e-30
        if n > -1e3:  # the reference is a difference
            assert abs(joined(complete((complement, 0.0), p, nought, one))
                       / ((third - k) / n) - 1) < 1e-29


@pytest.mark.slow
def test_jacobis_functions_keep_their_digits_up_to_the_separatrix():
    # There, they are hyperbolic.
    np.testing.assert_allclose(elliptic.jacobi(3.0, 0.0), [np.tanh(3.0), *[1 / np.cosh(3.0)] * 2],
                               rtol=1e-15)
    for complement in COMPLEMENTS:
        quarter = float(mpmath.ellipk(1 - mpf(complement)))
        for u in quarter * np.array([0.0, 1e-9, 0.3, -0.7, 0.99, -1 + 1e-9, 1.0]):
            sn, cn, dn = elliptic.jacobi(u, complement)
            exact = [mpmath.ellipfun(name, mpf(u), m=1 - mpf(complement))
                     for name in ('sn', 'cn', 'dn')]
            # For each function, the effect of a rounding error of u, and one rounding error of the
            # result; relative where the result is small.
            slopes = (exact[1] * exact[2], exact[0] * exact[2],
                      (1 - mpf(complement)) * exact[0] * exact[1])
            for value, right, slope in zip((sn, cn, dn), exact, slopes):
                assert abs(value - right) < 5e-16 * (abs(u * slope) + abs(right)) + 1e-40


@pytest.mark.slow
def test_carlsons_integrals_are_scipys():
    first, third = elliptic.carlson_f, elliptic.carlson_j
    for _ in range(60):
        x = 10.0 ** RANDOM.uniform(-30, 0)
        y, p = min(1.0, x + 10.0 ** RANDOM.uniform(-30, 0)), 1.0 + 10.0 ** RANDOM.uniform(-20, 0)
        np.testing.assert_allclose(first(x, y, 1.0), special.elliprf(x, y, 1.0), rtol=2e-15)
        np.testing.assert_allclose(third(x, y, 1.0, p), special.elliprj(x, y, 1.0, p), rtol=5e-15)
        exact = mpmath.elliprj(x, y, 1, p)
        assert abs(third(x, y, 1.0, p) / exact - 1) < 2e-15
