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

"""Runs of an ensemble: what is drawn is applied, and what is applied is reported."""

import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, so3, State, TorqueLog
from rigid_body_ros.ensemble.dispersions import Dispersion
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.scene import InputError, Scene

SECOND = 10 ** 9
TIMES = np.arange(20) * SECOND // 10
TORQUES = 0.01 * np.sin(np.arange(60.0)).reshape(20, 3)
LOGS = (TorqueLog(TIMES, TORQUES),)
SCENE = {'inertia.ixx': 0.045, 'inertia.iyy': 0.12, 'inertia.izz': 0.14, 'inertia.ixy': 0.002,
         'initial_attitude.x': 0.1, 'initial_angular_velocity.y': 0.6,
         'initial_rotor_momentum.z': 0.003, 'damping.dxx': 1e-4}
TILT = Dispersion('initial_attitude', 'tilt', (0.02,))
VARY = (Dispersion('inertia', 'relative', (0.05,)), TILT,
        Dispersion('initial_angular_velocity.y', 'uniform', (0.5, 0.7)),
        Dispersion('initial_rotor_momentum.z', 'normal', (0.1,), relative=True),
        Dispersion('damping.dxx', 'uniform', (-0.5, 0.5), relative=True),
        Dispersion('torque_gain', 'normal', (0.03,)),
        Dispersion('torque_bias.x', 'normal', (1e-4,)),
        Dispersion('clock_offset', 'normal', (0.01,)))


def ensemble(*dispersions, logs=LOGS, **values):
    scene = Scene.from_values({**SCENE, **values})
    return Ensemble(scene, scene.start, logs, None, 2 * SECOND, dispersions, 1)


def numbers(row, prefix, axes='xyz'):
    return [row[f'{prefix}{axis}'] for axis in axes]


def test_a_row_has_the_bits_of_propagate_for_its_values():
    found = ensemble(*VARY, torque_timeout=0.5)
    for run in np.random.default_rng(1).integers(0, 10 ** 9, 100).tolist():
        row = found.row(run)
        body = RigidBody.from_moments(*numbers(row, 'inertia.i', (
            'xx', 'yy', 'zz', 'xy', 'xz', 'yz')))
        body = RigidBody(body.inertia, np.diag([row['damping.dxx'], 0.0, 0.0]))
        start = State(0, numbers(row, 'initial_attitude.', 'xyzw'),
                      numbers(row, 'initial_angular_velocity.'),
                      (0.0, 0.0, row['initial_rotor_momentum.z']))
        times = TIMES + round(row['clock_offset'] * SECOND)
        bias_times = np.arange(0, 2 * SECOND + 1, SECOND // 4)
        bias = np.outer(np.ones(len(bias_times)), [row['torque_bias.x'], 0.0, 0.0])
        motion = propagate(body, start, [TorqueLog(times, row['torque_gain'] * TORQUES),
                                         TorqueLog(bias_times, bias)],
                           at=[2 * SECOND], torque_timeout=0.5)
        assert row['status'] == 'ok'
        assert numbers(row, 'attitude.', 'xyzw') == motion.attitude[0].tolist()
        assert numbers(row, 'angular_velocity.') == motion.angular_velocity[0].tolist()
        nominal = propagate(found.scene.body, found.start, TorqueLog(TIMES, TORQUES),
                            at=[2 * SECOND], torque_timeout=0.5).attitude[0]
        assert row['angle_from_nominal'] == so3.angle_between(motion.attitude[0], nominal)


def test_values_are_those_drawn():
    found = ensemble(*VARY)
    rows = [found.row(run) for run in range(200)]
    assert all(0.5 <= row['initial_angular_velocity.y'] <= 0.7 for row in rows)
    assert all(0.5e-4 <= row['damping.dxx'] <= 1.5e-4 for row in rows)
    for name, mean, sigma in (('initial_rotor_momentum.z', 0.003, 0.0003),
                              ('torque_gain', 1.0, 0.03), ('torque_bias.x', 0.0, 1e-4),
                              ('clock_offset', 0.0, 0.01)):
        values = np.array([row[name] for row in rows])
        assert abs(values.mean() - mean) < 4 * sigma / np.sqrt(200)
        assert abs(values.std() - sigma) < 4 * sigma / np.sqrt(400)
    tilts = np.array([so3.angle_between(numbers(row, 'initial_attitude.', 'xyzw'),
                                        found.start.attitude) for row in rows])
    assert abs(np.mean(tilts ** 2) - 3 * 0.02 ** 2) < 4 * np.sqrt(6 / 200) * 0.02 ** 2


def test_a_relative_inertia_is_always_that_of_a_body_and_keeps_its_axes():
    found = ensemble(Dispersion('inertia', 'relative', (0.5,)))
    axes = found.scene.body.principal_axes
    for run in range(200):
        tensor = found.applied(run).body.inertia
        moments = axes.T @ tensor @ axes
        np.testing.assert_allclose(moments, np.diag(np.diag(moments)), atol=1e-15)
        assert 2.0 * np.diag(moments).max() < np.trace(moments)


def test_the_moments_vary_by_at_most_the_given_fraction():
    found = ensemble(Dispersion('inertia', 'relative', (0.05,)))
    axes = found.scene.body.principal_axes
    moments = [np.diag(axes.T @ found.applied(run).body.inertia @ axes) for run in range(1000)]
    spread = np.std(moments, axis=0) / found.scene.body.principal_moments
    assert np.all((spread > 0.05 * 0.64) & (spread < 0.05 * 1.1))


def test_an_impossible_body_is_a_row_with_its_reason():
    rows = ensemble(Dispersion('inertia.izz', 'normal', (0.1,))).rows(0, 50)
    failed = [row for row in rows if row['status'] == 'failed']
    assert 5 < len(failed) < 45
    assert all(row['message'].startswith('inertia: ') for row in failed)
    assert all(row['message'] == '' for row in rows if row['status'] == 'ok')


def test_noise_differs_from_sample_to_sample_and_from_run_to_run():
    found = ensemble(Dispersion('torque_noise', 'normal', (1e-4,)), TILT)
    noise = np.concatenate([found.applied(run).logs[0].torques - TORQUES for run in range(100)])
    assert abs(noise.mean()) < 4 * 1e-4 / np.sqrt(noise.size)
    assert abs(noise.std() - 1e-4) < 4 * 1e-4 / np.sqrt(2 * noise.size)
    assert len(np.unique(noise)) == noise.size


def test_without_dispersion_a_run_ends_where_the_nominal_one_does():
    found = ensemble(Dispersion('initial_angular_velocity.x', 'normal', (1e-300,)))
    assert found.row(0)['angle_from_nominal'] == 0.0


@pytest.mark.parametrize(('one', 'logs', 'message'), [
    (Dispersion('clock_offset', 'normal', (0.1,), relative=True), LOGS,
     'clock_offset: relative: expected a nominal value other than 0'),
    (Dispersion('torque_gain', 'normal', (0.1,)), (), 'expected a recording of torques'),
])
def test_a_dispersion_without_effect_is_a_mistake(one, logs, message):
    with pytest.raises(InputError, match=message):
        ensemble(one, logs=logs)
