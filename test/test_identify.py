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

"""Identify a body from measured motions: values, uncertainties, and what is undetermined."""

from dataclasses import replace
from functools import cache
import json

from conftest import at_night
import numpy as np
import pytest
from rigid_body_ros import (
    Actuator,
    EffortLog,
    Problem,
    propagate,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
    Wheel,
)
from rigid_body_ros.identification import Experiment, Identification, identify
from rigid_body_ros.inference.fit import errors_of, triangle
from rigid_body_ros.inference.setup import channels_of, setup_of
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.recording.observed import Measurements
from rigid_body_ros.scene.quantities import components_of
from tumbling import INERTIA, mounted, SECOND, shifted, Truth, with_outliers

GUESS = RigidBody(np.diag([0.03, 0.03, 0.03]))
ATTITUDE, RATE = 2e-3, 5e-3
#: Noise of attitudes, rad, and of rates, rad/s.
NOISES = [(ATTITUDE, RATE), pytest.param((0.0, 0.0), marks=pytest.mark.nightly)]
INERTIA_NAMES = [f'inertia.i{entry}' for entry in ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')]


@cache
def tumble(seconds=20.0):
    return Truth(seconds)


def inertia_error(result, inertia=INERTIA):
    return np.abs(result.body.inertia - inertia).max() / inertia.max()


def assert_covered(result, truth, width=4.0):
    for name, value in truth.items():
        one = result.estimates[name]
        assert one.identifiable
        assert abs(one.value - value) < width * one.sigma, name


def inertia_truth(inertia=INERTIA):
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    return dict(zip(INERTIA_NAMES, inertia[rows, columns]))


@pytest.mark.slow
@pytest.mark.parametrize('factor', [3.0, *at_night(1.0, 1.0 / 3.0)])
def test_the_inertia_is_exact_without_noise_from_a_guess_three_times_off(factor):
    result = identify(RigidBody(factor * np.diag(np.diag(INERTIA))),
                      tumble().experiment(tumble().measured()))
    assert result.converged
    assert inertia_error(result) < 1e-9
    assert result.unidentifiable == []


@pytest.mark.slow
def test_a_sphere_is_guess_enough_where_the_torque_is_weak_and_samples_are_few():
    # As in NASA's check-case of a brick, which test_validation.py fits if its data is available.
    brick = np.diag([0.0019, 0.0062, 0.0072])
    truth = Truth(seconds=30.0, measured_hz=10, amplitude=2e-5, inertia=brick,
                  rates=(0.17, 0.35, 0.52), attitude=(0.0, 0.0, 0.0, 1.0))
    result = identify(RigidBody(0.005 * np.eye(3)), truth.experiment(truth.measured()))
    np.testing.assert_allclose(result.body.inertia, brick, rtol=1e-8, atol=1e-8 * 0.0072)


@pytest.mark.slow
@pytest.mark.parametrize(('attitude', 'rate'), [(0.0, None), (None, 0.0)])
def test_either_attitudes_or_rates_are_enough(attitude, rate):
    result = identify(GUESS, tumble().experiment(tumble().measured(attitude, rate)))
    assert inertia_error(result) < 1e-8
    assert ('initial_attitude.x' in result.estimates) == (attitude is not None)


@pytest.mark.slow
def test_noisy_attitudes_are_enough():
    result = identify(GUESS, tumble().experiment(tumble().measured(ATTITUDE, None)))
    assert_covered(result, inertia_truth())


@pytest.mark.slow
def test_the_start_is_fitted_from_a_wrong_one():
    wrong = State(0, (0.5, 0.1, 0.0, 1.0), (0.0, 0.0, 0.0))
    result = identify(GUESS, tumble().experiment(tumble().measured(), start=wrong))
    assert so3.angle_between(result.starts[0].attitude, tumble().start.attitude) < 1e-9
    np.testing.assert_allclose(result.starts[0].angular_velocity, tumble().rates, atol=1e-9)
    turned = so3.log(so3.multiply(so3.conjugate(wrong.attitude), tumble().start.attitude))
    found = [result.estimates[f'initial_attitude.{axis}'].value for axis in 'xyz']
    np.testing.assert_allclose(found, turned, atol=1e-9)


@pytest.mark.slow
def test_a_given_start_is_kept():
    result = identify(GUESS, tumble().experiment(tumble().measured(ATTITUDE, RATE)),
                      estimate=['inertia'])
    assert [*result.estimates] == INERTIA_NAMES
    assert result.starts[0].angular_velocity.tolist() == list(tumble().rates)
    assert_covered(result, inertia_truth())


@pytest.mark.slow
def test_noise_levels_and_intervals():
    result = identify(GUESS, tumble().experiment(tumble().measured(ATTITUDE, RATE, seed=3)))
    assert_covered(result, inertia_truth())
    assert result.noise == pytest.approx({'/imu attitude': ATTITUDE,
                                          '/imu angular_velocity': RATE}, rel=0.05)
    for one in result.estimates.values():
        low, high = one.interval_95
        assert high - low == pytest.approx(2 * 1.96 * one.sigma, rel=1e-4)


@pytest.mark.slow
def test_chi_square_with_given_noise():
    result = identify(GUESS, tumble().experiment(tumble().measured(ATTITUDE, RATE)),
                      attitude_noise=ATTITUDE, rate_noise=RATE)
    assert 0.9 < result.training.chi2_per_dof < 1.1
    assert result.training.samples == 2 * len(tumble().stamps_ns)


@pytest.mark.slow
def test_gyro_bias():
    clean = tumble().measured(None, RATE)
    bias = np.array([0.02, -0.03, 0.01])
    gyro = Measured('/gyro', clean.stamps_ns, None, clean.angular_velocity + bias)
    result = identify(GUESS, tumble().experiment(gyro), estimate=['inertia', 'start', 'gyro_bias'])
    assert_covered(result, inertia_truth())
    assert_covered(result, dict(zip(('gyro_bias.x', 'gyro_bias.y', 'gyro_bias.z'), bias)))


@pytest.mark.slow
def test_clock_offset_and_mount():
    vector = np.array([0.12, -0.13, 0.09])
    camera = mounted(shifted(tumble().measured(ATTITUDE, None, topic='/camera'), 0.035), vector)
    gyro = shifted(tumble().measured(None, RATE, topic='/gyro'), 0.035)
    result = identify(GUESS, tumble().experiment(camera, gyro),
                      estimate=['inertia', 'start', 'clock_offset', 'mount'])
    assert_covered(result, {**inertia_truth(), 'clock_offset': 0.035,
                            **dict(zip(('mount.x', 'mount.y', 'mount.z'), vector))})
    assert result.estimates['clock_offset'].sigma < 1e-3


@pytest.mark.slow
def test_a_mount_turns_the_rates_of_its_topic_too():
    vector = np.array([0.12, -0.13, 0.09])
    truth = Truth(seconds=5.0)
    experiment = truth.experiment(mounted(truth.measured(), vector))
    result = identify(RigidBody(INERTIA), experiment, estimate=['start', 'mount'])
    found = [result.estimates[f'mount.{axis}'].value for axis in 'xyz']
    np.testing.assert_allclose(found, vector, atol=1e-9)
    assert result.training.rate_rms < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize('offset', [1.5, *at_night(-1.5)])
def test_a_clock_offset_of_seconds(offset):
    sensor = shifted(tumble().measured(ATTITUDE, RATE), offset)
    result = identify(GUESS, tumble().experiment(sensor),
                      estimate=['inertia', 'start', 'clock_offset'])
    assert_covered(result, {**inertia_truth(), 'clock_offset': offset})


@pytest.mark.slow
def test_covariances_in_messages_are_not_used():
    # Many drivers fill in constant covariances, and a wrong constant would give a wrong interval.
    plain = tumble().measured(ATTITUDE, RATE)
    constant = np.tile(np.eye(3), (len(plain.stamps_ns), 1, 1))
    result = identify(GUESS, tumble().experiment(replace(
        plain, attitude_covariance=constant, rate_covariance=constant)))
    assert result.noise['/imu attitude'] == pytest.approx(ATTITUDE, rel=0.05)


@pytest.mark.slow
def test_torque_gain_and_bias_with_a_known_inertia():
    bias = (0.002, -0.001, 0.003)
    truth = Truth(bias=bias, gain=0.9)
    result = identify(RigidBody(INERTIA), truth.experiment(truth.measured(ATTITUDE, RATE)),
                      estimate=['start', 'torque_gain', 'torque_bias'])
    assert_covered(result, {'torque_gain': 0.9, 'torque_bias.x': bias[0],
                            'torque_bias.y': bias[1], 'torque_bias.z': bias[2]})


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'axes'), [('torque_gain', ['']), (
    'torque_gains', [' about x', ' about y', ' about z'])])
def test_a_logged_torque_that_did_not_act_is_a_reason_against_the_model(name, axes):
    free = Truth(amplitude=0.0)
    noise = TorqueLog(free.times, np.random.default_rng(3).normal(scale=0.01, size=(201, 3)))
    experiment = replace(free.experiment(free.measured(ATTITUDE, RATE)), log=noise)
    result = identify(RigidBody(INERTIA), experiment, estimate=['start', name])
    assert all(one.identifiable for one in result.estimates.values())
    assert (result.verdict.level, result.verdict.is_consistent) == ('approximate', False)
    texts = [reason.split(': ')[-1] for reason in result.verdict.reasons]
    assert texts == [f'the logged torque has no visible effect{axis}' for axis in axes]


@pytest.mark.slow
def test_a_gain_of_zero_is_a_reason_for_its_axis_only():
    truth = Truth(axes=(1.0, 0.0, 1.0))
    torques = truth.torques + np.outer(
        np.random.default_rng(4).normal(scale=0.01, size=201), [0.0, 1.0, 0.0])
    experiment = replace(truth.experiment(truth.measured(ATTITUDE, RATE)),
                         log=TorqueLog(truth.times, torques))
    result = identify(RigidBody(INERTIA), experiment, estimate=['start', 'torque_gains'])
    assert result.verdict.reasons == [
        'torque_gains.y: the interval contains 0: the logged torque has no visible effect about y']
    assert result.estimates['torque_gains.x'].value == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_torque_bias_does_not_time_out():
    truth = Truth(seconds=2.0, amplitude=0.0, bias=(0.002, -0.001, 0.003))
    result = identify(RigidBody(INERTIA), Experiment(truth.start, None, [truth.measured()]),
                      estimate=['start', 'torque_bias'], torque_timeout=0.03)
    values = [result.estimates[f'torque_bias.{axis}'].value for axis in 'xyz']
    np.testing.assert_allclose(values, truth.bias, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize('delay', [1.7, 2.3])
def test_a_torque_delay_keeps_within_two_seconds_and_is_not_determined_there(delay):
    log = TorqueLog(tumble().times - round(delay * SECOND), tumble().torques)
    experiment = replace(tumble().experiment(tumble().measured()), log=log)
    result = identify(RigidBody(INERTIA), experiment, estimate=['torque_gain', 'torque_delay'])
    found = result.estimates['torque_delay']
    assert found.value == pytest.approx(min(delay, 2.0), abs=1e-8 if delay < 2.0 else 2e-3)
    assert found.identifiable == (delay < 2.0)
    assert result.estimates['torque_gain'].identifiable
    reasons = [one['reason'] for one in result.as_dict()['unidentifiable']
               if [*one['direction']] == ['torque_delay']]
    assert [reason.split(':')[0] for reason in reasons] == (
        [] if delay < 2.0 else ['at its bound of 2 s'])
    assert ('not determined   torque_delay: at its bound' in result.text()) == (delay > 2.0)


@pytest.mark.nightly
def test_a_plate_is_the_start_of_its_estimates_and_the_centre_of_what_is_known():
    experiment = tumble(5.0).experiment(tumble(5.0).measured(ATTITUDE, RATE))
    plate = RigidBody.from_moments(0.02, 0.03, 0.05)
    result = identify(plate, experiment, estimate=['inertia', 'start'],
                      priors={'inertia.izz': 1e-9})
    assert [result.estimates[name].start for name in INERTIA_NAMES] == [
        0.02, 0.03, 0.05, 0.0, 0.0, 0.0]
    assert result.estimates['inertia.izz'].value == pytest.approx(0.05, abs=1e-7)


@pytest.mark.slow
def test_torque_bias_and_inertia():
    truth = Truth(bias=(0.002, -0.001, 0.003))
    result = identify(GUESS, truth.experiment(truth.measured(ATTITUDE, RATE)),
                      estimate=['inertia', 'start', 'torque_bias'])
    assert_covered(result, {**inertia_truth(), 'torque_bias.x': 0.002})


@pytest.mark.slow
@pytest.mark.parametrize(('modelled', 'noise', 'suspects'), [
    (['torque_bias'], 0.0, []), *at_night(
        (['torque_bias'], 1e-4, []), ([], 1e-4, ['torque_bias']))])
def test_a_model_is_explained_unless_it_lacks_something(modelled, noise, suspects):
    truth = Truth(bias=(0.002, -0.001, 0.003))
    result = identify(GUESS, truth.experiment(truth.measured(noise, noise)),
                      estimate=['inertia', 'start', *modelled])
    assert result.verdict.is_consistent is not bool(suspects)
    assert [one.name for one in result.verdict.suspects[:1]] == suspects


@pytest.mark.slow
def test_damping():
    damping = np.array([[2e-3, 3e-4, 0.0], [3e-4, 1e-3, 0.0], [0.0, 0.0, 3e-3]])
    truth = Truth(damping=damping)
    result = identify(GUESS, truth.experiment(truth.measured(ATTITUDE, RATE)),
                      estimate=['inertia', 'start', 'damping'])
    assert_covered(result, {**inertia_truth(), 'damping.dxx': 2e-3, 'damping.dxy': 3e-4,
                            'damping.dyz': 0.0})
    assert np.linalg.eigvalsh(result.body.damping)[0] >= 0.0


@pytest.mark.slow
def test_three_moments_keep_the_products():
    guess = INERTIA + np.diag([0.01, 0.004, -0.01])
    result = identify(RigidBody(guess), tumble().experiment(tumble().measured()),
                      estimate=['inertia_diagonal', 'start'])
    assert inertia_error(result) < 1e-9
    assert result.body.inertia[0, 2] == pytest.approx(INERTIA[0, 2], rel=1e-12)


def flywheel(**options):
    """Return the motion of a free body whose flywheel spins up."""
    times = np.arange(61) / 10
    spin = 0.05 * np.clip(times - 1.0, 0.0, 3.0) / 3.0
    return Truth(seconds=6.0, amplitude=0.0, momentum=np.outer(spin, [0.6, 0.5, 0.6]),
                 measured_hz=100, **options)


@pytest.mark.slow
def test_a_flywheel_that_spins_up_gives_the_scale_of_the_inertia_without_torque():
    truth = flywheel()
    assert inertia_error(identify(GUESS, truth.experiment(truth.measured()))) < 1e-8
    noisy = identify(GUESS, truth.experiment(truth.measured(ATTITUDE, RATE)))
    assert noisy.unidentifiable == []
    assert_covered(noisy, inertia_truth())


@pytest.mark.slow
@pytest.mark.parametrize(('attitude', 'rate'), [(0.0, 0.0), (ATTITUDE, RATE)])
def test_wheels_with_names_give_the_inertia_without_torque(attitude, rate):
    body, stamps = RigidBody(INERTIA), np.arange(1, 1000) * (SECOND // 50)
    wheels = [Wheel('x', (1.0, 0.0, 0.0), 2e-3, initial_speed=20.0, max_torque=0.02),
              Wheel('y', (0.0, 1.0, 0.0), 2e-3, initial_speed=-10.0),
              Wheel('skewed', (1.0, 1.0, 1.0), 1e-3)]
    times = np.arange(100) * (SECOND // 5)
    efforts = EffortLog(times, 0.03 * np.sin(
        np.outer(times / 1e9, [0.7, 1.1, 1.7]) + np.arange(3.0)))
    motion = propagate(body, State(0, (0.1, -0.2, 0.3, 0.9), (0.5, 1.0, 0.2)), at=stamps,
                       wheels=wheels, efforts=efforts)
    random = np.random.default_rng(5)
    imu = Measured('/imu', stamps, so3.multiply(motion.attitude, so3.exp(
        attitude * random.normal(size=(999, 3)))),
        motion.angular_velocity + rate * random.normal(size=(999, 3)))
    # The momenta of the wheels depend on the initial rate, which is also estimated.
    result = identify(GUESS, Experiment(State(), None, [imu], wheels, efforts=efforts))
    assert result.unidentifiable == []
    if rate:
        assert result.verdict.level == 'explained'
        assert_covered(result, inertia_truth())
    else:
        assert inertia_error(result) < 1e-12
    again = propagate(result.body, result.starts[0], at=stamps, wheels=wheels, efforts=efforts)
    assert so3.angle_between(again.attitude, motion.attitude).max() < 1e-11 + attitude


@pytest.mark.slow
def test_heavy_wheels_need_no_gyro():
    body, stamps = RigidBody.from_moments(0.045, 0.12, 0.14), np.arange(1, 2000) * (SECOND // 100)
    times, start = np.arange(400) * (SECOND // 20), State(0, angular_velocity=(0.15, 0.3, -0.1))
    wheels = [Wheel('x', (1.0, 0.0, 0.0), 5e-3), Wheel('z', (0.0, 0.0, 1.0), 5e-3)]
    efforts = EffortLog(times, 0.01 * np.stack([np.sin(times / 1e9), np.cos(0.7e-9 * times)], 1))
    motion = propagate(body, start, at=stamps, wheels=wheels, efforts=efforts)
    noise = so3.exp(ATTITUDE * np.random.default_rng(1).normal(size=(1999, 3)))
    camera = Measured('/camera', stamps, so3.multiply(motion.attitude, noise), None)
    # A rate guessed from noisy attitudes would give the wheels a wrong momentum in later windows.
    result = identify(body, Experiment(start, None, [camera], wheels, efforts=efforts),
                      validate=0.2)
    assert result.verdict.level == 'explained', result.verdict.reasons
    assert_covered(result, inertia_truth(body.inertia))


@pytest.mark.slow
def test_the_momentum_of_a_rotor():
    truth = Truth(momentum=np.tile([0.0, 0.01, 0.02], (201, 1)))
    unknown = State(0, truth.attitude, truth.rates)
    experiment = Experiment(unknown, truth.log, [truth.measured(ATTITUDE, RATE)])
    result = identify(RigidBody(INERTIA), experiment, estimate=['start', 'rotor_momentum'])
    assert_covered(result, dict(zip([f'initial_rotor_momentum.{axis}' for axis in 'xyz'],
                                    (0.0, 0.01, 0.02))))
    np.testing.assert_allclose(result.starts[0].rotor_momentum, (0.0, 0.01, 0.02), atol=1e-4)


@pytest.mark.slow
def test_outliers_are_counted_and_do_no_harm():
    measured, bad = with_outliers(tumble().measured(ATTITUDE, RATE), 0.02)
    result = identify(GUESS, tumble().experiment(measured))
    assert_covered(result, inertia_truth())
    assert 2 * bad.sum() - 2 <= result.training.outliers <= 2 * bad.sum() + 2
    assert result.noise == pytest.approx({'/imu attitude': ATTITUDE,
                                          '/imu angular_velocity': RATE}, rel=0.05)


@pytest.mark.slow
def test_two_recordings_give_one_inertia_and_two_starts():
    other = Truth(rates=(-0.3, 0.2, 0.9), seconds=10.0)
    both = identify(GUESS, [tumble().experiment(tumble().measured(ATTITUDE, RATE)),
                            other.experiment(other.measured(ATTITUDE, RATE))])
    alone = identify(GUESS, other.experiment(other.measured(ATTITUDE, RATE)))
    assert_covered(both, {**inertia_truth(), 'initial_angular_velocity.x[2]': -0.3})
    assert both.estimates['inertia.ixx'].sigma < alone.estimates['inertia.ixx'].sigma
    assert len(both.starts) == 2


@pytest.mark.slow
def test_recordings_with_different_sensors():
    other = Truth(rates=(-0.3, 0.2, 0.9), seconds=10.0)
    result = identify(GUESS, [tumble().experiment(tumble().measured(ATTITUDE, None)),
                              other.experiment(other.measured(None, RATE))])
    assert result.unidentifiable == []
    assert 'initial_attitude.x' in result.estimates
    assert 'initial_attitude.x[2]' not in result.estimates
    assert_covered(result, inertia_truth())


@pytest.mark.slow
def test_the_errors_of_all_samples_are_in_the_result():
    measured, bad = with_outliers(tumble().measured(ATTITUDE, RATE), 0.02)
    result = identify(GUESS, tumble().experiment(measured), validate=0.3)
    first, _, last, _ = result.residuals
    assert [one.is_training for one in result.residuals] == [True, True, False, False]
    stamps_ns = np.concatenate([first.stamps_ns, last.stamps_ns])
    assert stamps_ns.tolist() == measured.stamps_ns.tolist()
    assert abs(np.sum(~first.inliers) - bad[:len(first.stamps_ns)].sum()) <= 1
    assert abs(first.autocorrelation) < 0.1


@pytest.mark.slow
def test_validation_is_kept_out_of_the_fit():
    whole = tumble().measured(ATTITUDE, RATE)
    result = identify(GUESS, tumble().experiment(whole), validate=0.3)
    assert result.training.samples == pytest.approx(1.4 * len(whole.stamps_ns), rel=0.01)
    assert result.training.samples + result.validation.samples == 2 * len(whole.stamps_ns)
    assert result.validation.attitude_rms < 2 * ATTITUDE
    spoilt = Measured(whole.topic, whole.stamps_ns, whole.attitude, whole.angular_velocity.copy())
    spoilt.angular_velocity[-200:] += 1.0
    again = identify(GUESS, tumble().experiment(spoilt), validate=0.3)
    assert np.array_equal(again.body.inertia, result.body.inertia)
    assert again.validation.rate_rms > 0.5


@pytest.mark.slow
@pytest.mark.parametrize('noise', NOISES)
def test_without_torque_only_ratios_of_moments_are_known(noise):
    truth = Truth(amplitude=0.0)
    result = identify(GUESS, truth.experiment(truth.measured(*noise)))
    assert not any(result.estimates[name].identifiable for name in INERTIA_NAMES)
    assert result.estimates['inertia.ixx'].interval_95 is None
    assert result.estimates['initial_angular_velocity.x'].identifiable
    assert 'ratios' in ' '.join(one.reason for one in result.unidentifiable)


@pytest.mark.slow
@pytest.mark.parametrize('noise', NOISES)
def test_torque_gain_and_inertia_are_not_known_together(noise):
    result = identify(GUESS, tumble().experiment(tumble().measured(*noise)),
                      estimate=['inertia', 'start', 'torque_gain'])
    assert not result.estimates['torque_gain'].identifiable
    assert not any(result.estimates[name].identifiable for name in INERTIA_NAMES[:3])
    direction, = result.unidentifiable
    assert direction.reason == 'only the ratio of torque to inertia enters the motion'
    assert {'inertia.izz', 'torque_gain'} <= {*direction.components}


@pytest.mark.slow
@pytest.mark.parametrize('noise', NOISES)
def test_a_rotation_about_one_axis_gives_one_moment(noise):
    truth = Truth(inertia=np.diag([0.02, 0.03, 0.04]), rates=(0.0, 0.0, 0.3), axes=(0, 0, 1))
    result = identify(RigidBody.from_moments(0.03, 0.03, 0.03),
                      truth.experiment(truth.measured(*noise)))
    assert not result.estimates['inertia.ixx'].identifiable
    assert not result.estimates['inertia.iyy'].identifiable
    assert_covered(result, {'inertia.izz': 0.04}, width=4.0 if noise[0] else 1e9)


@pytest.mark.slow
def test_the_result_as_json(tmp_path):
    result = identify(GUESS, tumble().experiment(tumble().measured(ATTITUDE, RATE)),
                      estimate=['inertia', 'start', 'torque_gain'], validate=0.2)
    data = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert data['estimates']['torque_gain'] == {
        'value': result.estimates['torque_gain'].value, 'unit': '', 'start': 1.0, 'sigma': None,
        'systematic': 0.0, 'interval_95': None, 'identifiable': False}
    assert data['guess_attitude_xyzw'] == tumble().start.attitude.tolist()
    names, units, matrix = (data['covariance'][key] for key in ('names', 'units', 'matrix'))
    assert names == [*data['estimates']]
    assert dict(zip(names, units))['inertia.ixy'] == 'kg m^2'
    for name, row in zip(names, matrix):
        sigma = data['estimates'][name]['sigma']
        assert (sigma is None) == (row.count(None) == len(names))
        assert sigma is None or row[names.index(name)] == pytest.approx(sigma ** 2, rel=1e-12)
    known = [k for k, row in enumerate(matrix) if row.count(None) < len(names)]
    known = np.array(matrix, float)[np.ix_(known, known)]
    assert np.array_equal(known, known.T)
    assert data['training'].keys() == data['validation'].keys() == {
        'samples', 'outliers', 'attitude_rms_rad', 'rate_rms_rad_s', 'chi2_per_dof'}
    (tmp_path / 'fit.json').write_text(json.dumps(data))
    saved = Identification.load(tmp_path / 'fit.json')
    for name, one in result.estimates.items():
        assert (saved.values[name], saved.units[name]) == (one.value, one.unit)
    np.testing.assert_array_equal(saved.covariance, result.covariance)
    np.testing.assert_array_equal(saved.guess_attitude, result.guess_attitude)
    assert (saved.converged, saved.level) == (result.converged, result.verdict.level)


#: A weight about a pivot, and the guess that a fit starts from.
WEIGHT = {'moment': (0.002, -0.003, -0.02), 'field': (0.0, 0.0, -9.81)}
NEAR = UniformField((0.0, 0.0, -0.01), WEIGHT['field'], 'pivot')
MOMENT = [f'pivot.moment.{axis}' for axis in 'xyz']


@cache
def swinging(amplitude=0.02):
    return Truth(amplitude=amplitude, **WEIGHT)


def with_field(experiment, field=NEAR):
    return replace(experiment, fields=[field])


@pytest.mark.slow
def test_the_moment_of_a_field_is_exact_without_noise():
    experiment = with_field(swinging().experiment(swinging().measured()))
    result = identify(GUESS, experiment, estimate=['inertia', 'start', 'pivot.moment'])
    assert result.converged
    assert inertia_error(result) < 1e-9
    found = [result.estimates[name] for name in MOMENT]
    np.testing.assert_allclose([one.value for one in found], WEIGHT['moment'], atol=1e-11)
    assert [one.start for one in found] == [0.0, 0.0, -0.01]
    assert {one.unit for one in found} == {'kg m or A m^2'}


@pytest.mark.slow
@pytest.mark.parametrize('sensors', [(ATTITUDE, None), *at_night(((ATTITUDE, RATE),))])
def test_noisy_moments_are_covered(sensors):
    experiment = with_field(swinging().experiment(swinging().measured(*sensors, seed=5)))
    result = identify(GUESS, experiment, estimate=['pivot.moment', 'inertia', 'start'])
    assert_covered(result, {**inertia_truth(), **dict(zip(MOMENT, WEIGHT['moment']))})
    assert [*result.estimates][:9] == [*INERTIA_NAMES, *MOMENT]


@pytest.mark.slow
def test_a_known_weight_gives_the_scale_of_the_inertia_without_torque():
    known = UniformField(*WEIGHT.values(), 'pivot')
    experiment = with_field(swinging(0.0).experiment(swinging(0.0).measured()), known)
    result = identify(GUESS, experiment)
    assert inertia_error(result) < 1e-9


@pytest.mark.slow
def test_a_weight_is_a_field_of_the_result():
    experiment = swinging().experiment(swinging().measured())
    result = identify(GUESS, experiment, estimate=['inertia', 'start', 'weight'],
                      gravity=WEIGHT['field'])
    weight, = result.fields
    assert weight.name == 'weight'
    np.testing.assert_allclose(weight.moment, WEIGHT['moment'], atol=1e-11)
    again = propagate(result.body, result.starts[0], experiment.log, at=swinging().stamps_ns,
                      fields=result.fields)
    assert so3.angle_between(again.attitude, swinging().q).max() < 1e-8


@pytest.mark.nightly
def test_moment_and_inertia_are_not_known_together_without_torque():
    experiment = with_field(swinging(0.0).experiment(swinging(0.0).measured(ATTITUDE, RATE)))
    result = identify(GUESS, experiment, estimate=['inertia', 'start', 'pivot.moment'])
    direction, = result.unidentifiable
    assert direction.reason == 'only the ratio of torque to inertia enters the motion'
    assert {name.split('.')[0] for name in direction.components} == {'inertia', 'pivot'}


def bad(**changes):
    measured = tumble().measured()
    fields = {'topic': '/pose', 'stamps_ns': measured.stamps_ns, 'attitude': measured.attitude,
              'angular_velocity': None}
    return tumble().experiment(Measured(**{**fields, **changes}))


@pytest.mark.parametrize(('experiment', 'options', 'message'), [
    (lambda: bad(attitude=np.full((999, 4), np.nan)), {}, '/pose: expected finite attitudes'),
    (lambda: bad(stamps_ns=tumble().stamps_ns - 100 * SECOND), {},
     '/pose: expected attitudes from'),
    (lambda: bad(stamps_ns=tumble().stamps_ns[:3], attitude=tumble().q[:3]), {},
     '/pose: expected at least 8 attitudes'),
    (lambda: tumble().experiment(), {}, 'expected at least one measured topic'),
    (lambda: [bad(), replace(bad(), wheels=[Wheel('x', (1.0, 0.0, 0.0), 1e-3)])], {},
     'expected the same wheels in all recordings, found others'),
    (bad, {'estimate': ['mass']}, "estimate: expected names among inertia.*found 'mass'"),
    (bad, {'estimate': ['inertia', 'inertia_diagonal']}, 'expected one of'),
    (bad, {'estimate': ['pivot.moment']},
     r"expected moments of the fields of the scene \(none\), found 'pivot'"),
    (lambda: with_field(bad(), UniformField(*WEIGHT.values(), 'weight')), {'estimate': ['weight']},
     'weight: expected a scene without a field of that name, found one; estimate weight.moment'),
    (bad, {'estimate': ['weight'], 'gravity': (0.0, 0.0, 0.0)}, 'gravity: expected a field other'),
    (bad, {'estimate': ['pivot.field']}, "NAME.moment of a field, found 'pivot.field'"),
    *((bad, {'estimate': [name]}, f'expected @TOPIC after the parameter of a sensor .*{name}')
      for name in ('start@/pose', 'inertia@', 'mount@')),
    (bad, {'estimate': []}, 'at least one name'),
    (bad, {'estimate': ['start', 'start']}, 'each name once'),
    (bad, {'attitude_noise': 0.0}, 'attitude_noise: expected a number greater than zero'),
    (bad, {'validate': 1.0}, 'validate: expected a fraction'),
])
def test_bad_input_is_named(experiment, options, message):
    with pytest.raises(ValueError, match=message):
        identify(GUESS, experiment(), **options)


@pytest.mark.slow
@pytest.mark.parametrize('seconds', at_night(60.0, 300.0))
def test_a_chaotic_tumble_of_minutes(seconds):
    truth = Truth(seconds, measured_hz=20)
    result = identify(RigidBody(3.0 * np.diag(np.diag(INERTIA))),
                      truth.experiment(truth.measured()))
    assert inertia_error(result) < 1e-8
    noisy = identify(GUESS, truth.experiment(truth.measured(ATTITUDE, RATE)))
    assert_covered(noisy, inertia_truth())


@pytest.mark.nightly
def test_intervals_cover_the_truth_and_are_as_short_as_possible():
    truth, covered, errors, sigmas, chi2, distances = tumble(10.0), [], [], [], [], []
    for seed in range(20):
        result = identify(GUESS, truth.experiment(truth.measured(ATTITUDE, RATE, seed)),
                          attitude_noise=ATTITUDE, rate_noise=RATE)
        for name, value in inertia_truth().items():
            low, high = result.estimates[name].interval_95
            covered.append(low <= value <= high)
            errors.append((result.estimates[name].value - value) / result.estimates[name].sigma)
        sigmas.append([result.estimates[name].sigma for name in INERTIA_NAMES])
        chi2.append(result.training.chi2_per_dof)
        error = [result.estimates[name].value - value for name, value in inertia_truth().items()]
        distances.append(error @ np.linalg.solve(result.covariance[:6, :6], error))
    assert abs(np.mean(distances) - 6) < 4 * np.sqrt(2 * 6 / 20)  # chi-square with 6 degrees
    assert 0.88 <= np.mean(covered) <= 1.0  # 120 intervals that are correlated
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.2
    assert min(chi2) > 0.9
    assert max(chi2) < 1.1
    assert np.ptp(sigmas, axis=0).max() < 0.05 * np.max(sigmas)


@pytest.mark.slow
def test_a_log_in_space_axes():
    # Under a torque in space axes, the momentum in space is known, whatever the inertia is.
    times = np.arange(100) * (SECOND // 10)
    torque = TorqueLog(times, 0.01 * np.sin(np.outer(times * 1e-9, [0.9, 1.3, 0.5])), 'space')
    body, start = RigidBody(INERTIA), State(angular_velocity=(0.3, -0.2, 0.5))
    stamps = np.arange(1, 500) * (SECOND // 50)
    motion = propagate(body, start, torque, at=stamps)
    measured = Measured('/pose', stamps, motion.attitude, None)
    assert inertia_error(identify(GUESS, Experiment(start, torque, [measured]))) < 1e-8


@pytest.mark.parametrize(('rows', 'columns'), [(50, 7), (7, 7), (3, 5), (4, 1)])
def test_triangular_factors(rows, columns):
    matrix = np.random.default_rng(0).standard_normal((rows, columns))
    matrix[:, columns // 2] = matrix[:, 0]  # makes it rank-deficient
    factor = triangle(matrix.T.copy())
    np.testing.assert_allclose(factor.T @ factor, matrix.T @ matrix, atol=1e-12)
    assert np.array_equal(factor, np.triu(factor))


@pytest.mark.slow
@pytest.mark.parametrize(('names', 'scene'), [
    (['start', 'torque_lag'], None), (['start', 'torque_delay', 'torque_gain'], None),
    (['inertia', 'start'], Actuator(delay=0.02, time_constant=0.1, limit=(0.015,) * 3))])
def test_actuators_are_those_of_a_propagation(names, scene):
    truth = tumble()
    real = scene or Actuator(delay=0.03 * ('torque_delay' in names),
                             time_constant=0.12 * ('torque_lag' in names))
    problem = Problem(RigidBody(INERTIA), truth.start, truth.log, actuator=real)
    motion = problem.propagate(at=truth.stamps_ns)
    sensor = Measured('/imu', truth.stamps_ns, motion.attitude, motion.angular_velocity)
    observed = (problem, Measurements([sensor])) if scene else truth.experiment(sensor)
    found = identify(GUESS if scene else RigidBody(INERTIA), observed, estimate=names)
    assert found.training.attitude_rms < 1e-9
    for name, value in (('torque_lag', 0.12), ('torque_delay', 0.03), ('torque_gain', 1.0)):
        if name in names:
            assert found.estimates[name].value == pytest.approx(value, abs=1e-8)
    if scene:
        assert inertia_error(found) < 1e-8


@pytest.mark.parametrize('lag', [0.0, 0.1])
def test_slopes_of_predictions_are_the_limits_of_differences(lag):
    names = ('inertia', 'torque_gain', 'torque_gains', 'torque_bias', 'torque_delay', 'torque_lag',
             'weight', 'clock_offset', 'clock_drift', 'mount', 'gyro_bias', 'gyro_scale@/imu',
             'damping', 'rotor_momentum')
    problem, measured = tumble(2.0).experiment(tumble(2.0).measured(ATTITUDE, RATE)).observed(
        GUESS, 0.0)
    gyro = Measured('/gyro', measured.sensors[0].stamps_ns[::3], None,
                    measured.sensors[0].angular_velocity[::3])
    # Samples between the stamps of torques, so that no step goes from one torque to the next.
    apart = [replace(one, stamps_ns=one.stamps_ns + 2_500_000)
             for one in channels_of([*measured.sensors, gyro], 0)]
    setup = setup_of([problem], [apart], [name for name in names if name != 'torque_gain'])
    window, = setup.windows(setup.span_ns, setup.given)
    state = Poses(problem.start.attitude, problem.start.angular_velocity)
    physics = setup.parameters.guess
    for name, value in (('torque_lag', [lag]), ('mount', [0.1, -0.2, 0.3]),
                        ('torque_gains', [0.9, 1.1, 1.2]), ('weight', [0.0, 0.0, 1e-3]),
                        ('torque_bias', [1e-3, 0.0, 2e-3]), ('damping', 3 * [1e-3] + 3 * [0.0]),
                        ('gyro_scale@/imu', [1.1, 1.2, 0.9])):
        physics = physics.with_value(name, np.array(value))
    predicted, slopes = window.linearize(physics, state, names)
    for found, expected in zip(predicted, window.predict(physics, state)):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    at = [replace(channel, **{'attitude' if channel.is_attitude else 'angular_velocity': each})
          for channel, each in zip(window.channels, predicted)]
    components = [(name, entry) for name in names for entry in np.eye(len(components_of(name)))]
    for row, (name, entry) in enumerate(components, 6):
        step = (1e-5 if name in ('weight', 'damping', 'inertia') else 1e-4) * entry
        values = physics.value(*name.split('@'))
        errors = [errors_of(at, window.predict(physics.with_value(
            name, values + times * step), state)) for times in range(4)]
        for channel, slope, (none, one, two, three) in zip(window.channels, slopes, zip(*errors)):
            change = (18.0 * one - 9.0 * two + 2.0 * three - 11.0 * none) / (6.0 * step.sum())
            # Without a lag, the first derivative is that of a delay.
            limit = 1e-5 if name != 'torque_lag' or lag else 0.1
            assert np.abs(slope[row] - change).max() < limit * np.abs(change).max(initial=1e-3), (
                name, channel.topic)
