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

"""Mass, momentum and torque, compared with their definitions."""

import numpy as np
import pytest
from rigid_body_ros import RigidBody, State
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import rate_in_space, uniform_box
from scipy.spatial.transform import Rotation

RANDOM = np.random.default_rng(11)
MASSES, POSITIONS = RANDOM.uniform(0.5, 2.0, 6), RANDOM.normal(size=(6, 3))
BODY = RigidBody.from_point_masses(MASSES, POSITIONS)
W, A = np.array([0.3, -1.2, 0.8]), np.array([0.5, 0.1, -0.7])


def test_tensor_momentum_energy_and_moments_are_sums_over_the_masses():
    arms = POSITIONS - np.average(POSITIONS, axis=0, weights=MASSES)
    tensor = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(MASSES, arms))
    np.testing.assert_allclose(BODY.inertia, tensor, rtol=1e-14)
    np.testing.assert_array_equal(BODY.inertia, BODY.inertia.T)
    speeds = np.cross(W, arms)
    np.testing.assert_allclose(BODY.angular_momentum(W), MASSES @ np.cross(arms, speeds),
                               rtol=1e-14)
    energy = 0.5 * MASSES @ np.sum(speeds ** 2, axis=1)
    np.testing.assert_allclose(BODY.kinetic_energy(W), energy, rtol=1e-14)
    np.testing.assert_allclose(BODY.moment_about(W), 2.0 * energy / (W @ W), rtol=1e-14)


def test_products_of_inertia_are_entries_of_the_matrix():
    body = RigidBody.from_moments(2.0, 3.0, 4.0, 0.1, 0.2, 0.3)
    assert body.inertia.tolist() == [[2.0, 0.1, 0.2], [0.1, 3.0, 0.3], [0.2, 0.3, 4.0]]
    assert body.entries.tolist() == [2.0, 3.0, 4.0, 0.1, 0.2, 0.3]
    np.testing.assert_array_equal(BODY.with_entries(body.entries).inertia, body.inertia)


def test_principal_axes_diagonalise_and_are_right_handed():
    axes, moments = BODY.principal_axes, BODY.principal_moments
    np.testing.assert_allclose(axes.T @ BODY.inertia @ axes, np.diag(moments), rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.cross(axes[:, 0], axes[:, 1]), axes[:, 2], rtol=0, atol=1e-15)
    assert list(moments) == sorted(moments)


def test_principal_moments_of_a_thin_rod_keep_their_digits():
    body = RigidBody.from_moments(1.0, 1e-20, 1.0)
    assert body.principal_moments.tolist() == [1e-20, 1.0, 1.0]
    np.testing.assert_array_equal(body.principal_axes[:, 0], [0.0, 1.0, 0.0])


@pytest.mark.parametrize(('moments', 'symmetry'), [
    ((2.0, 2.0, 2.0), 'sphere'), ((2.0, 3.0, 2.0), 'symmetric top'),
    ((2.0, 2.5, 3.0), 'asymmetric top'), ((1.0, 1.0 + 1e-9, 1.0 + 2e-9), 'asymmetric top')])
def test_symmetry_is_that_of_the_moments(moments, symmetry):
    assert RigidBody.from_moments(*moments).symmetry == symmetry


def test_transport_theorem_is_the_derivative_of_the_space_components():
    # A vector with body components A + t dA, in a body that turns with constant w.
    change, h = np.array([0.2, 0.9, -0.4]), 1e-5
    ahead, behind = (so3.rotate(so3.exp(t * W), A + t * change) for t in (h, -h))
    np.testing.assert_allclose((ahead - behind) / (2 * h), rate_in_space(change, W, A), rtol=0,
                               atol=1e-9)
    np.testing.assert_allclose(rate_in_space(change, W, A) - change, np.cross(W, A), rtol=0,
                               atol=1e-16)


def test_eulers_equations_are_the_components_of_dl_dt():
    i1, i2, i3 = 1.0, 2.0, 2.5
    body = RigidBody.from_moments(i1, i2, i3)
    torque, (w1, w2, w3) = np.array([0.1, 0.2, -0.3]), W
    expected = [(torque[0] + (i2 - i3) * w2 * w3) / i1, (torque[1] + (i3 - i1) * w3 * w1) / i2,
                (torque[2] + (i1 - i2) * w1 * w2) / i3]
    np.testing.assert_allclose(body.angular_acceleration(W, torque), expected, rtol=1e-15)


def test_torque_and_acceleration_undo_each_other():
    torque = np.array([0.4, -0.1, 0.25])
    np.testing.assert_allclose(BODY.torque(W, BODY.angular_acceleration(W, torque)), torque,
                               rtol=0, atol=4e-15)


def test_the_tensors_of_a_body_cannot_be_changed():
    # The constants of a body are computed once.
    body = RigidBody(np.eye(3), damping=np.eye(3))
    for tensor in (body.inertia, body.damping):
        with pytest.raises(ValueError, match='read-only'):
            tensor[0, 0] = 2.0


def test_the_box_of_a_body_has_its_moments():
    edges = np.array([1.0, 0.6, 0.25])  # the longest has the smallest moment
    body = RigidBody(np.diag(np.sum(edges ** 2) - edges ** 2))
    np.testing.assert_allclose(uniform_box(body), edges, rtol=1e-14)


def test_a_thin_plate_is_a_body_and_rounded_digits_are_told():
    assert RigidBody.from_moments(0.1, 0.2, 0.1 + 0.2).triangle_excess == 0.0
    rounded = RigidBody.from_moments(0.0833, 0.3333, 0.4167)
    np.testing.assert_allclose(rounded.triangle_excess, 0.4167 / 0.4166 - 1.0, rtol=1e-9)


def line(random, count, offset, thickness=0.0):
    """Return masses and positions along a random line of about 1 m, somewhere in space."""
    direction = so3.normalize(random.normal(size=3))
    along = random.uniform(-1.0, 1.0, count) if count > 2 else np.array([-1.0, 0.3])
    positions = np.outer(along, direction) + thickness * random.normal(size=(count, 3))
    return random.uniform(0.1, 2.0, count), positions + offset * random.normal(size=3)


@pytest.mark.slow
@pytest.mark.parametrize('offset', [0.0, 1.0, 1e3, 1e7])
@pytest.mark.parametrize('count', [2, 3, 1000])
def test_masses_on_any_line_are_refused(count, offset):
    random = np.random.default_rng(12)
    for _ in range(20):
        masses, positions = line(random, count, offset)
        for equal in (masses, np.full(count, 0.1)):
            with pytest.raises(ValueError, match='masses .* on one line'):
                RigidBody.from_point_masses(equal, positions)


@pytest.mark.parametrize(('thickness', 'offset'), [(1e-3, 1e7), (1e-6, 1e3), (1e-6, 0.0)])
@pytest.mark.parametrize('count', [4, 100_000])
def test_a_thin_rod_of_point_masses_is_a_body(count, thickness, offset):
    masses, positions = line(np.random.default_rng(13), count, offset, thickness)
    moments = RigidBody.from_point_masses(masses, positions).principal_moments
    arms = positions - np.average(positions, axis=0, weights=masses)
    expected = np.linalg.svd(np.sqrt(masses)[:, None] * arms, compute_uv=False)[1:]
    np.testing.assert_allclose(moments[0], expected @ expected, rtol=0.05)


@pytest.mark.parametrize('attitude', [so3.normalize([0.1, -0.3, 0.2, 0.9]), (0.0, 0.0, 0.6, -0.8)])
def test_an_attitude_may_be_a_scipy_rotation(attitude):
    state = State(5, Rotation.from_quat(attitude), W)
    np.testing.assert_array_equal(state.attitude, Rotation.from_quat(attitude).as_quat())
    np.testing.assert_allclose(state.attitude, attitude, rtol=0, atol=2e-16)
    np.testing.assert_array_equal(state.angular_velocity, W)


def test_a_body_and_a_state_are_printed_with_units():
    assert repr(RigidBody.from_moments(0.5, 1.0, 1.25)) \
        == 'RigidBody(asymmetric top, principal moments (0.5, 1, 1.25) kg m^2)'
    assert repr(State(7, (0, 0, 1, 0), (1e-6, 0.1234567, -2))) == (
        'State(time 7 ns, attitude xyzw (0, 0, 1, 0), '
        'angular velocity (1e-06, 0.123457, -2) rad/s)')


def test_a_start_is_normalised_but_one_of_unit_length_is_left_alone():
    np.testing.assert_allclose(State(0, (0, 0, 0, 5.0)).attitude, [0, 0, 0, 1], rtol=0)
    unit = so3.normalize(np.array([0.1, -0.3, 0.2, 0.9]))
    np.testing.assert_array_equal(State(0, unit).attitude, unit)
    np.testing.assert_array_equal(State(0, (3e-310, 0, 0, 0)).attitude, [1, 0, 0, 0])
    for q in RANDOM.normal(size=(300, 4)) * 10.0 ** RANDOM.uniform(-250, 250, (300, 1)):
        np.testing.assert_array_equal(State(0, q).attitude, so3.normalize(q))


def test_the_arrays_of_a_state_are_read_only_copies():
    given = np.array([0.0, 0.6, 0.0, 0.8]), np.ones(3), np.ones(3), np.ones(2)
    state = State(0, *given)
    found = [state.attitude, state.angular_velocity, state.rotor_momentum, state.wheel_speeds]
    for mine, its in zip(given, found):
        before = its.tolist()
        mine += 1.0
        assert its.tolist() == before
        with pytest.raises(ValueError, match='read-only'):
            its[0] = 0.0
