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

"""A comparison of measured motion with the propagated one: errors, alignment, residuals."""

from dataclasses import replace
from functools import cache

from conftest import memory_limit
from measurements import free, INERTIA, truth
import numpy as np
import pytest
from rigid_body_ros import BodyLog, compare, Measured, propagate, RigidBody, State, TorqueLog
from rigid_body_ros.common.arrays import entries
from rigid_body_ros.inference.horizons import horizon
from rigid_body_ros.inference.motion import Recorded
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.fields import GravityGradient, UniformField
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.propagation import Problem
from scipy.spatial.transform import Rotation

MOUNT, SPACE = Rotation.from_rotvec([0.1, -0.15, 0.08]), Rotation.from_rotvec([0.3, 0.5, -1.0])
ATTITUDE_NOISE, RATE_NOISE = 1e-3, 2e-3


def noisy(**options):
    return truth().measured(ATTITUDE_NOISE, RATE_NOISE, **options)


def compared(measured, motion=None, **options):
    motion = motion or truth()
    return compare(motion.body, motion.start, motion.log, measured=measured,
                   **{'causes': False, **options})


def angle(quaternion, rotation):
    return float(so3.angle_between(quaternion, rotation.as_quat()))


@pytest.mark.slow
def test_the_truth_has_no_error():
    found = compared(truth().measured(), horizons=[1.0, 4.0]).as_dict()
    assert found['attitude_error_rad']['max'] < 1e-12
    assert found['rate_error_rad_s']['max'] < 1e-12
    assert all(each['attitude_p95_rad'] < 1e-9 for each in found['horizons'])
    assert [each['windows'] for each in found['horizons']] == [19, 4]
    assert found['residual_torque_N_m']['max'] < 1e-4 * 0.02  # of the torque
    assert found['alignment'] == {'clock_offset_s': 0.0, 'mount_xyzw': [0, 0, 0, 1],
                                  'space_xyzw': [0, 0, 0, 1], 'start': 'scene'}


def test_errors_are_the_noise():
    found = compared(noisy()).as_dict()
    assert found['samples'] == 2000
    for name, noise in (('attitude_error_rad', ATTITUDE_NOISE), ('rate_error_rad_s', RATE_NOISE)):
        assert found[name]['axes_rms'] == pytest.approx([noise] * 3, rel=0.05)
        assert found[name]['rms'] == pytest.approx(noise * 3 ** 0.5, rel=0.05)
        assert found[name]['median'] == pytest.approx(1.5382 * noise, rel=0.05)


def test_errors_are_measured_minus_computed_in_body_axes():
    turn = Rotation.from_rotvec([0.01, 0.0, 0.0])
    sensor = truth().measured()
    sensor = replace(sensor, attitude=(truth().attitude * turn).as_quat(),
                     angular_velocity=truth().rates + np.array([0.0, 0.2, 0.0]))
    errors, = compared(sensor).errors
    np.testing.assert_allclose(errors.rotation_vectors, [[0.01, 0.0, 0.0]] * 2000, rtol=0,
                               atol=1e-12)
    np.testing.assert_allclose(errors.rates, [[0.0, 0.2, 0.0]] * 2000, rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(('clock', 'mount', 'unmeasured', 'limit'), [
    (0.035, None, '', 1e-4), (-3.0, None, '', 1e-4), (0.0, MOUNT, '', 2e-4),
    (0.035, MOUNT, 'angular_velocity', 2e-3), (0.035, MOUNT, 'attitude', 2e-3),
    (-1.7, Rotation.from_rotvec([2.0, -1.0, 1.5]), '', 2e-3)],
    ids=['late', 'early', 'mount', 'of attitudes', 'of rates', 'large'])
def test_a_clock_offset_and_a_mounting_are_found(clock, mount, unmeasured, limit):
    align = ['clock'] * (clock != 0.0) + ['mount'] * (mount is not None)
    space, outliers = (SPACE, 0.02) if clock == -1.7 else (None, 0.0)
    sensor = noisy(clock=clock, mount=mount, space=space, outliers=outliers)
    found = compared(replace(sensor, **dict.fromkeys(filter(None, [unmeasured]))), align=align)
    one = found.alignment
    assert one.clock_offset_s == pytest.approx(clock, abs=min(limit, 1e-3))
    if mount is None:
        assert abs(one.clock_offset_s - clock) < 5 * one.sigma['clock_offset_s']
        assert found.as_dict()['attitude_error_rad']['axes_rms'] == pytest.approx(
            [ATTITUDE_NOISE] * 3, rel=0.05)
    else:
        assert angle(one.mount, mount) < min(limit, 5 * one.sigma['mount_rad'].max())
        assert ('space_rad' in one.sigma) == (unmeasured != 'attitude')
    if space is not None:
        assert angle(one.space, space) < limit


@pytest.mark.slow
def test_the_start_is_found_among_outliers():
    motion = truth()
    found = compare(motion.body, State(motion.start.time_ns), motion.log, align=['start'],
                    measured=noisy(outliers=0.02), causes=False)
    start = found.alignment.start
    assert angle(start.attitude, Rotation.from_quat(motion.start.attitude)) < 5e-4
    np.testing.assert_allclose(start.angular_velocity, motion.start.angular_velocity, atol=5e-4)
    assert found.as_dict()['attitude_error_rad']['median'] == pytest.approx(
        1.5382 * ATTITUDE_NOISE, rel=0.06)


@pytest.mark.slow
def test_what_a_spin_about_one_axis_does_not_determine_has_no_deviation():
    spinning = free(seconds=5.0, rates=(0.0, 0.0, 1.0))
    spinning = replace(spinning, inertia=np.diag([1.0, 2.0, 3.0]), rates=np.tile(
        [0.0, 0.0, 1.0], (500, 1)), attitude=Rotation.from_quat(
        spinning.start.attitude) * Rotation.from_rotvec(
        np.arange(500)[:, None] * [0.0, 0.0, 0.01]))
    found = compared(spinning.measured(1e-3, 1e-3, mount=MOUNT), spinning, align=['mount'])
    assert None in found.as_dict()['alignment']['sigma']['mount_rad']


def test_residual_torque_shows_when_and_where_a_torque_is_missing():
    motion = truth()
    times = 1e-9 * (motion.torque_times - motion.torque_times[0])
    missing = np.where((times >= 5.0) & (times < 8.0), 0.005, 0.0)[:, None] * [0.0, 1.0, 0.0]
    log = TorqueLog(motion.torque_times, motion.torques - missing)
    found = compare(motion.body, motion.start, log, measured=noisy(), causes=False)
    torque = found.residual_torque
    seconds = 1e-9 * (torque.times_ns - motion.torque_times[0])
    during = (seconds > 5.2) & (seconds < 7.8)
    outside = (seconds < 4.8) | (seconds > 8.2)
    np.testing.assert_allclose(torque.torques[during].mean(axis=0), [0.0, 0.005, 0.0], atol=1e-4)
    assert np.abs(torque.torques[outside]).max() < 6.0 * torque.noise.max()
    scatter = torque.torques[outside].std(axis=0)
    np.testing.assert_allclose(scatter, torque.noise, rtol=0.25)


@pytest.mark.slow
def test_horizons_see_the_model_not_the_distance():
    # With a wrong inertia the motion drifts away, but only a little within a second.
    motion = truth()
    body = RigidBody(INERTIA + np.diag([0.0, 0.001, 0.0]))
    found = compare(body, motion.start, motion.log, measured=noisy(), horizons=[0.5, 2.0],
                    causes=False).as_dict()
    short, long = (each['attitude_rms_rad'] for each in found['horizons'])
    assert short < 0.02
    assert short < 0.3 * long < found['attitude_error_rad']['rms']


@pytest.mark.slow
def test_horizons_skip_a_gap_of_any_length():
    known = free()
    sensor = known.measured(1e-4)
    sensor.stamps_ns[-2:] += 10 ** 18
    problem = Problem(known.body, known.start)
    with memory_limit(100e6):
        assert len(horizon(problem, [sensor], 0.5).angles) == 39


def test_a_recorded_motion_is_interpolated():
    motion = truth()
    states = Recorded(motion.measured().rows(np.arange(0, 2000, 2)))
    found = states.propagate(at=motion.stamps_ns[1:1990:2])
    assert so3.angle_between(found.attitude, motion.attitude.as_quat()[1:1990:2]).max() < 1e-6
    np.testing.assert_allclose(found.angular_velocity, motion.rates[1:1990:2], atol=1e-2)


WEIGHT = UniformField((0.002, -0.003, -0.02), (0.0, 0.0, -9.81), 'pivot')
WAVES = TorqueLog(np.arange(200) * 10 ** 8,
                  0.02 * np.sin(np.outer(np.arange(200), [0.07, 0.11, 0.17]) + np.arange(3.0)))
ORBIT = GravityGradient(0.4, (0.0, 0.6, 0.8), (1.0, 0.0, 0.0))
SPIN = np.array([[0.01, -0.02, 0.03], [0.05, 0.0, -0.03]])
#: What acts on a body beside its inertia.
ACTING = {
    'weight': {'fields': (WEIGHT,)}, 'orbit': {'fields': (ORBIT,)},
    'both': {'fields': (WEIGHT, ORBIT)}, 'under torque': {'fields': (WEIGHT, ORBIT), 'log': WAVES},
    'rotors': {'log': TorqueLog([0], [[0.01, -0.005, 0.004]], 'space'),
               'wheels': TorqueLog.from_momentum([0, 20 * 10 ** 9], SPIN)},
    'wheels': {'wheels': [Wheel('x', (1, 0, 0), inertia=5e-4, initial_speed=50.0)],
               'efforts': EffortLog([0, 4 * 10 ** 9], [[2e-3], [-2e-3]])}}


@cache
def under(name):
    """Return measurements at 100 Hz for 20 s, the positional arguments of `compare`, the rest."""
    acting = {**ACTING[name]}
    body = RigidBody(INERTIA, np.diag([1e-3, 2e-3, 5e-4]) if name == 'rotors' else None)
    start = State(0, (0.1, -0.2, 0.3, 0.9), (0.3, 0.5, -0.2),
                  SPIN[0] if name == 'rotors' else (0.0, 0.0, 0.0))
    given = body, start, acting.pop('log', None)
    motion = Problem(*given, **acting).propagate(at=np.arange(2000) * 10 ** 7)
    sensor = Measured('/imu', motion.times_ns, motion.attitude, motion.angular_velocity)
    return sensor, given, acting


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'gyro'), [
    ('weight', False), ('orbit', True), ('both', False), ('rotors', False), ('wheels', False)])
def test_a_torque_of_the_model_is_no_residual(name, gyro):
    sensor, given, acting = under(name)
    torques = Problem(*given, **acting).torque(sensor.stamps_ns, sensor.attitude)
    if gyro:
        sensor = replace(sensor, attitude=None)
    found = compare(*given, measured=sensor, horizons=() if gyro else [1.0], **acting)
    assert found.verdict.is_consistent
    assert np.abs(found.residual_torque.torques).max() < 4e-7
    if not gyro:
        assert found.as_dict()['attitude_error_rad']['max'] < 1e-14
        assert found.as_dict()['horizons'][0]['attitude_p95_rad'] < 1e-8
    if 'fields' in acting:  # without them in the model, their whole torque is residual
        residual = compare(*given, measured=sensor, causes=False).residual_torque
        rows = np.searchsorted(sensor.stamps_ns, residual.times_ns)
        np.testing.assert_allclose(residual.torques, torques[rows],
                                   atol=0.05 * np.abs(torques).max())


def with_noise(sensor, attitude=1e-4, rate=1e-4):
    random = np.random.default_rng(0)
    turned, faster = np.array([attitude, rate])[:, None, None] * random.standard_normal(
        (2, len(sensor), 3))
    return replace(sensor, attitude=so3.multiply(sensor.attitude, so3.exp(turned)),
                   angular_velocity=sensor.angular_velocity + faster)


@pytest.mark.slow
def test_a_wrong_inertia_is_named_under_a_weight():
    sensor, (_, start, log), acting = under('weight')
    verdict = compare(RigidBody(1.2 * INERTIA), start, log, measured=with_noise(sensor),
                      **acting).verdict
    # Without a torque, only the ratio of the weight to the inertia is known.
    assert {one.name for one in verdict.suspects[:2]} & {'inertia', 'pivot.moment'}


@pytest.mark.slow
def test_a_wrong_torque_is_named_under_fields():
    sensor, (body, start, log), acting = under('under torque')
    half = log.with_torques(0.5 * log.torques)
    suspect = compare(body, start, half, measured=with_noise(sensor), **acting).verdict.suspects[0]
    assert (suspect.name, suspect.value) == ('torque_gain', [pytest.approx(2.0, rel=0.02)])
    assert suspect.command == 'attitude_identify --estimate start,torque_gain fits it'


@pytest.mark.parametrize(('change', 'message'), [
    ({'stamps_ns': np.arange(3)}, '/imu: expected at least 4 samples, found 3'),
    ({'stamps_ns': np.zeros(2000, int)}, '/imu: expected increasing stamps'),
    ({'stamps_ns': np.arange(2000.0)}, '/imu: stamps: expected integer nanoseconds'),
    ({'attitude': None, 'angular_velocity': None}, '/imu: expected attitudes or angular'),
    ({'stamps_ns': np.arange(2000)}, '/imu: expected measurements during the motion'),
    ({'angular_velocity': np.full((2000, 3), 2e9)}, r'at most 1e\+09 rad/s, found 2e\+09'),
    ({'attitude': np.zeros((2000, 3))}, r'/imu: attitude: expected finite numbers of shape '),
    ({'attitude': np.ones((2000, 4))}, '/imu: attitude: expected unit quaternions, found norms'),
    ({'angular_velocity': np.full((2000, 3), np.nan)}, '6000 that are not finite')])
def test_measurements_are_checked(change, message):
    with pytest.raises(ValueError, match=message):
        compared(replace(noisy(), **change))


@pytest.mark.slow
def test_what_an_inertia_lacks_is_named_beside_wheels_with_names():
    motion, wheels = truth(), [Wheel('x', (1, 0, 0), inertia=0.2 * INERTIA[0, 0])]
    exact = propagate(motion.body, motion.start, motion.log, at=motion.stamps_ns, wheels=wheels)
    measured = Measured('/mocap', motion.stamps_ns, exact.attitude, exact.angular_velocity)
    wrong = RigidBody(INERTIA + np.diag([2e-3, 0.0, 0.0]))
    verdict = compare(wrong, motion.start, motion.log, measured=with_noise(measured),
                      wheels=wheels).verdict
    suspect = next(one for one in verdict.suspects if one.name == 'inertia')
    axial = np.diag([0.2 * INERTIA[0, 0], 0.0, 0.0])  # a fit treats wheels as rotors
    np.testing.assert_allclose(suspect.value, entries(INERTIA - axial), atol=2e-4)


@pytest.mark.parametrize(('options', 'message'), [
    ({'align': ['colour']}, "align: expected some of start, clock, mount, or .*, found 'colour'"),
    ({'horizons': [0.0]}, 'horizons: expected positive seconds, found 0.0'),
    ({'changes': BodyLog([10 ** 9], [RigidBody(INERTIA)])},
     'changes: expected a body that does not change, found 1')])
def test_invalid_arguments_are_rejected(options, message):
    with pytest.raises(ValueError, match=message):
        compared(noisy(), **options)
