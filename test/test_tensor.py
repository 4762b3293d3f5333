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

"""Constants of a tensor, compared with 60 digits."""

import mpmath
from mpmath import mp, mpf
import numpy as np
import pytest
from rigid_body_ros.kernels import tensor
from rigid_body_ros.mechanics import so3

RANDOM = np.random.default_rng(23)
TURN = so3.matrix(so3.normalize([0.3, -0.1, 0.7, 0.4]))
ROD = np.eye(3) - (1.0 - 1e-6) * np.outer(TURN[:, 0], TURN[:, 0])
STATION = np.array([[1.02e8, -6.96e6, -5.48e6], [-6.96e6, 0.91e8, 5.9e5],
                    [-5.48e6, 5.9e5, 1.64e8]])
TENSORS = [np.diag([3.0, 1.0, 2.0]), STATION, ROD, np.eye(3) * 2.0, STATION * 1e-30,
           np.diag([1.0, 1.0 + 1e-12, 1.0]), np.eye(3) + 1e-15 * np.ones((3, 3))]


@pytest.fixture(autouse=True)
def _sixty_digits():
    with mp.workdps(60):
        yield


@pytest.mark.parametrize('inertia', TENSORS)
def test_coefficients_are_eulers_equations_rounded_once(inertia):
    found, rest = tensor.euler_coefficients(inertia)
    exact = mpmath.matrix(inertia.tolist())
    for _ in range(3):
        w, tau = RANDOM.normal(size=3), RANDOM.normal(size=3) * np.abs(inertia).max()
        x, y, z = (mpf(c) for c in w)
        h = exact * mpmath.matrix([x, y, z])
        right = mpmath.matrix([h[1] * z - h[2] * y, h[2] * x - h[0] * z, h[0] * y - h[1] * x])
        right += mpmath.matrix([mpf(c) for c in tau])
        terms = np.array([*(w[[1, 2, 0]] * w[[2, 0, 1]]), *w ** 2, *tau])
        sizes = np.abs(found * terms).sum(axis=1)
        expected = mpmath.lu_solve(exact, right)
        for row, low, value, size in zip(found, rest, expected, sizes):
            products = [y * z, z * x, x * y, x * x, y * y, z * z, *(mpf(c) for c in tau)]
            total = sum(mpf(float(a)) * b for a, b in zip(row, products))
            assert abs(total - value) <= 1.2e-16 * size
            total += sum(mpf(float(a)) * b for a, b in zip(low, products))
            assert abs(total - value) <= 1e-31 * size


def test_a_turned_rod_has_no_large_coefficients():
    # The moments differ by a factor of a million, but the gyroscopic terms do not: |w'| <= w^2.
    assert np.abs(tensor.euler_coefficients(ROD)[0, :, :6]).max() < 1.0


@pytest.mark.parametrize('inertia', TENSORS)
def test_principal_axes_have_thirty_digits(inertia):
    moments, axes = tensor.principal(inertia)
    turn = mpmath.matrix(axes[0].tolist()) + mpmath.matrix(axes[1].tolist())
    diagonal = mpmath.diag([mpf(a) + mpf(b) for a, b in moments.T])
    scale = np.abs(inertia).max()
    assert mpmath.norm(turn.T * turn - mpmath.eye(3), 1) < 1e-30
    assert mpmath.norm(turn.T * mpmath.matrix(inertia.tolist()) * turn - diagonal, 1) \
        < 1e-30 * scale
    assert abs(mpmath.det(turn) - 1) < 1e-30
    assert list(moments[0]) == sorted(moments[0])


def test_the_smallest_moment_of_a_turned_rod_is_that_of_its_entries():
    moments, _ = tensor.principal(ROD)
    exact = mpmath.eigsy(mpmath.matrix(ROD.tolist()), eigvals_only=True)
    assert abs(mpf(moments[0, 0]) / min(exact) - 1) < 1.2e-16
