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


"""The residual torque in space axes, and its spectrum."""

import numpy as np
import pytest
from rigid_body_ros import Measured, Problem, RigidBody, so3, State, TorqueLog
from rigid_body_ros.inference.residual_torque import residual_torque, spectrum, with_attitude

SECOND = 10 ** 9
BODY = RigidBody.from_moments(0.02, 0.03, 0.04)


def residual(torque=0.0, hertz=1.0, noise=5e-3, seconds=40.0, axis=2):
    """Return the residual torque of a gyro on a body with an unknown torque about one axis."""
    stamps_ns = np.arange(round(seconds * 100)) * (SECOND // 100)
    turn = 2.0 * np.pi * hertz
    rates = noise * np.random.default_rng(1).standard_normal((len(stamps_ns), 3))
    rates[:, axis] += torque / BODY.principal_moments[axis] / turn * (
        1.0 - np.cos(turn * 1e-9 * stamps_ns))
    return residual_torque(Problem(BODY, State()), Measured('/imu', stamps_ns, None, rates))


@pytest.mark.parametrize('hertz', [0.3, 1.0, 2.5])
def test_a_sine_has_its_amplitude_at_its_frequency(hertz):
    found = spectrum(residual(3e-3, hertz, noise=1e-4))
    best = np.argmax(found.amplitudes[:, 2])
    assert found.hertz[best] == pytest.approx(hertz, abs=0.02)
    assert found.amplitudes[best, 2] == pytest.approx(3e-3, rel=0.03)
    assert found.amplitudes[best, 2] > 5.0 * found.limits[best, 2]


@pytest.mark.slow
@pytest.mark.parametrize('seconds', [40.0, 300.0])
def test_white_noise_exceeds_its_limit_at_one_frequency_in_a_hundred(seconds):
    found = spectrum(residual(seconds=seconds))
    assert np.mean(found.amplitudes > found.limits) == pytest.approx(0.01, abs=0.01)
    assert np.median(found.amplitudes / found.limits) > 0.3


def test_a_recording_too_short_for_a_cycle_has_no_spectrum():
    assert spectrum(residual(seconds=0.5)) is None


def test_a_torque_that_is_constant_in_space_axes_is_so_there():
    stamps_ns = np.arange(2000) * (SECOND // 100)
    force, start = np.array([2e-4, -1e-4, 3e-4]), State(angular_velocity=(0.5, 1.0, 0.2))
    truth = Problem(BODY, start, TorqueLog([0], [force], 'space')).propagate(at=stamps_ns)
    attitudes = Measured('/mocap', stamps_ns[::2], truth.attitude[::2], None)
    gyro = with_attitude(Measured('/imu', stamps_ns, None, truth.angular_velocity), attitudes)
    found = residual_torque(Problem(BODY, start), gyro)
    torques, noise = found.in_space(attitudes)
    np.testing.assert_allclose(torques, np.tile(force, (len(torques), 1)), atol=4e-6)
    rows = np.searchsorted(stamps_ns, found.times_ns)
    axes = so3.rotate(truth.attitude[rows][:, None], np.eye(3))
    variances = np.einsum('nji,j,njk->nik', axes, found.noise ** 2, axes)
    np.testing.assert_allclose(noise ** 2, np.einsum('nii->ni', variances), rtol=1e-3)
