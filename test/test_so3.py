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

"""The functions of `so3` obey the laws of rotations."""

import numpy as np
import pytest
from rigid_body_ros.mechanics import so3
from scipy.spatial.transform import Rotation

EPS = np.finfo(float).eps
RANDOM = np.random.default_rng(7)
Q = so3.normalize(RANDOM.normal(size=(3, 200, 4)))
V = RANDOM.normal(size=(200, 3))


def test_quarter_turn_about_z_takes_body_x_to_space_y():
    yaw = so3.exp([0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(so3.rotate(yaw, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], rtol=0, atol=EPS)
    np.testing.assert_allclose(yaw, [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], rtol=0, atol=EPS)


def test_product_is_a_group_with_the_action_on_vectors():
    p, q, r = Q
    unit = [0.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(so3.multiply(so3.multiply(p, q), r),
                               so3.multiply(p, so3.multiply(q, r)), rtol=0, atol=8 * EPS)
    np.testing.assert_array_equal(so3.multiply(p, unit), p)
    np.testing.assert_allclose(so3.multiply(p, so3.conjugate(p)) - unit, 0.0, rtol=0, atol=8 * EPS)
    np.testing.assert_allclose(so3.rotate(so3.multiply(p, q), V), so3.rotate(p, so3.rotate(q, V)),
                               rtol=0, atol=32 * EPS)


def test_convention_is_scipys():
    np.testing.assert_allclose(so3.matrix(Q[0]), Rotation.from_quat(Q[0]).as_matrix(),
                               rtol=0, atol=8 * EPS)


@pytest.mark.parametrize('half_turn', [(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)])
def test_a_matrix_gives_its_quaternion_back(half_turn):
    # Also close to each axis, where three of the four elements lose their digits.
    for q in [*Q[0][:50], *so3.normalize(half_turn + 1e-9 * Q[1][:50])]:
        assert so3.angle_between(so3.from_matrix(so3.matrix(q)), q) < 4 * EPS


@pytest.mark.parametrize('size', [0.0, 1e-300, 1e-160, 1e-12, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-9])
def test_log_undoes_exp_at_every_size_of_angle(size):
    vectors = size * V / np.linalg.norm(V, axis=1, keepdims=True)
    np.testing.assert_allclose(so3.log(so3.exp(vectors)), vectors, rtol=8 * EPS,
                               atol=8 * EPS * size)


def test_log_is_the_shortest_of_the_vectors_of_a_rotation():
    np.testing.assert_array_equal(so3.log(-Q[0]), so3.log(Q[0]))
    np.testing.assert_allclose(so3.log(Q[0]), Rotation.from_quat(Q[0]).as_rotvec(), rtol=0,
                               atol=8 * EPS)
    assert np.linalg.norm(so3.log(Q[0]), axis=1).max() <= np.pi


def test_the_difference_turns_one_attitude_into_the_other():
    p, q, _ = Q
    turned = so3.multiply(p, so3.exp(so3.difference(p, q)))
    assert so3.angle_between(turned, q).max() < 16 * EPS


def test_exp_goes_on_beyond_a_turn():
    np.testing.assert_allclose(so3.exp([2.0 * np.pi, 0.0, 0.0]), [0.0, 0.0, 0.0, -1.0],
                               rtol=0, atol=2 * EPS)


def test_exp_of_many_turns_has_unit_norm():
    assert abs(np.linalg.norm(so3.exp([1e6, 2e6, -3e5])) - 1.0) < 4 * EPS


def test_normalize_takes_quaternions_of_any_size():
    for size in (1e-300, 1e-160, 1.0, 1e200):
        np.testing.assert_allclose(so3.normalize(size * Q[0]), Q[0], rtol=0, atol=2 * EPS)


@pytest.mark.parametrize('angle', [0.0, 1e-17, 1e-9, 1e-3, 1.0, np.pi - 1e-9, np.pi])
def test_angle_between_resolves_every_angle(angle):
    turned = so3.multiply(Q[0], so3.exp([angle, 0.0, 0.0]))
    np.testing.assert_allclose(so3.angle_between(Q[0], turned), angle, rtol=0, atol=8 * EPS)
    np.testing.assert_allclose(so3.angle_between(Q[0], -turned), angle, rtol=0, atol=8 * EPS)


def cross_matrix(a):
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def test_matlab_computes_the_matrices_of_its_manual():
    # The examples of quat2dcm, which returns R^T, and of quat2rotm, which returns R.
    transposed = so3.matrix(so3.normalize([0.5, 0.3, 0.1, 1.0])).T
    np.testing.assert_allclose(transposed, [
        [0.8519, 0.3704, -0.3704], [0.0741, 0.6148, 0.7852], [0.5185, -0.6963, 0.4963]], atol=5e-5)
    np.testing.assert_allclose(so3.matrix(so3.normalize([0.7071, 0.0, 0.0, 0.7071])), [
        [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], atol=5e-5)


def test_jpl_and_basilisk_compute_the_transposed_matrix():
    # Equation 62 of Trawny and Roumeliotis, and MRP2C in Basilisk's rigidBodyKinematics.c.
    for *v, w in Q[0] * np.copysign(1.0, Q[0][:, 3:]):
        v = np.array(v)
        jpl = (2 * w ** 2 - 1) * np.eye(3) - 2 * w * cross_matrix(v) + 2 * np.outer(v, v)
        sigma = v / (1 + w)
        s, square = cross_matrix(sigma), sigma @ sigma
        basilisk = np.eye(3) + (8 * s @ s - 4 * (1 - square) * s) / (1 + square) ** 2
        expected = so3.matrix([*v, w]).T
        np.testing.assert_allclose(jpl, expected, rtol=0, atol=8 * EPS)
        np.testing.assert_allclose(basilisk, expected, rtol=0, atol=16 * EPS)
        np.testing.assert_allclose(Rotation.from_mrp(sigma).as_quat(), [*v, w], rtol=0,
                                   atol=8 * EPS)
