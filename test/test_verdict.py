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
Fits, comparisons and live checks say whether a model is wrong, and name what is wrong.

`simulated` makes the recordings.
"""

from dataclasses import replace
from functools import cache
import json
import re

from campaign import experiment, fit, TRUE
from conftest import at_night, memory_limit, RECORDINGS
from measurements import truth
import numpy as np
import pytest
from rigid_body_ros import (
    compare,
    Experiment,
    identify,
    Measured,
    Problem,
    propagate,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
)
from rigid_body_ros.commands import main
from rigid_body_ros.comparison.comparison import compare_motion
from rigid_body_ros.inference.hypotheses import _distance, _still
from rigid_body_ros.inference.monitor import ERROR, first_suspect, Monitor, Settings
from rigid_body_ros.inference.motion import Recorded
from rigid_body_ros.mechanics import so3
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit
from simulated import INERTIA, named, recordings

pytestmark = pytest.mark.slow
GUESS, BODY = RigidBody.from_moments(0.03, 0.03, 0.03), RigidBody(INERTIA)
EXPLAINED = {'level': 'explained', 'consistent': True, 'reasons': [], 'suspects': []}


@cache
def recorded(name, seconds=12.0, seed=0, level=1.0):
    """Return a kind of a length, and a recording of it."""
    kind = replace(named(name), seconds=seconds)
    recording, = recordings(kind, [seed], level)
    return kind, recording


@cache
def identified(name):
    return fit(*recorded(name))


def changed(**changes):
    """Return the result for a motion that the model describes but for some changes."""
    kind = replace(named('all well'), **{'seconds': 12.0, **changes})
    return fit(kind, *recordings(kind, [0]))


def covered(result):
    return sum(low <= TRUE[name] <= high for name in TRUE
               for low, high in [result.estimates[name].interval_95])


@pytest.mark.parametrize('name', ['noise AR 0.8', 'mount and clock of each', *at_night(
    '3 % outliers', 'lag, estimated', 'attitude at 20 Hz', 'weight, estimated', 'all well',
    'gyro alone', 'weak torque', 'unequal axes', 'delay, estimated', 'gyro scale, estimated')])
def test_a_right_model_is_explained_and_its_intervals_cover_the_truth(name):
    result = identified(name)
    assert result.verdict.as_dict() == EXPLAINED
    assert all(one.systematic == 0.0 for one in result.estimates.values())
    kind, truth = named(name), dict(TRUE)
    if name == 'mount and clock of each':
        for topic, clock, mount in (('/mocap', kind.clock, kind.mount),
                                    ('/imu', kind.gyro_clock, kind.gyro_mount)):
            truth[f'clock_offset@{topic}'] = clock
            truth.update({f'mount.{axis}@{topic}': value for axis, value in zip('xyz', mount)})
    for component, value in truth.items():
        one = result.estimates[component]
        assert abs(one.value - value) < 4.0 * one.sigma, component


@pytest.mark.parametrize(('name', 'suspects'), [
    ('gyro bias', {'gyro_bias'}),
    *at_night(('mount of the gyro 5 degrees', {'mount@/imu'}), ('damping', {'damping'}),
              ('torque bias', {'torque_bias'}), ('rotor', {'rotor_momentum'}),
              ('gains of all axes', {'torque_gains'}), ('delay 100 ms', {'torque_delay'}),
              ('weight', {'weight'}), ('clock of the gyro 50 ms', {'clock_offset@/imu'}),
              ('gyro scale', {'gyro_scale'}), ('mount 30 degrees', {'mount@/mocap'}),
              ('payload dropped', {'inertia_change'}))])
def test_the_suspect_is_what_is_wrong(name, suspects):
    result = identified(name)
    assert not result.verdict.is_consistent
    assert result.verdict.reasons
    assert suspects <= {one.name for one in result.verdict.suspects[:2]}
    assert result.verdict.level == 'rejected' or covered(result) >= 5
    # Even for a known motion, an estimate contains the mean noise of all attitudes.
    for axis in 'xyz':
        assert result.estimates[f'initial_attitude.{axis}'].sigma > 0.95 * 2e-3 / np.sqrt(1200)


@pytest.mark.nightly
def test_noise_that_lasts_does_not_exceed_the_given_noise_and_widens_the_intervals():
    right, wrong = (fit(*recorded('noise AR 0.8'), attitude_noise=noise, rate_noise=5e-3).verdict
                    for noise in (2e-3, 1.5e-3))
    assert right.reasons == []
    assert any('exceed the given noise' in reason for reason in wrong.reasons)
    white, coloured = identified('all well'), changed(colour=0.8, gyro_colour=0.8)
    for name in TRUE:  # as the long-run variance
        ratio = coloured.estimates[name].sigma / white.estimates[name].sigma
        assert ratio == pytest.approx(3.0, rel=0.1), name


@pytest.mark.nightly
def test_a_suspect_that_is_estimated_too_explains_all():
    first = identified('weight')
    kind, recording = recorded('weight', 20.0)
    command = first.verdict.suspects[0].command
    second = fit(kind, recording, estimate=command.removeprefix('--estimate ').split(','))
    assert second.verdict.is_consistent
    assert covered(second) >= 5
    np.testing.assert_allclose([second.estimates[f'weight.{axis}'].value for axis in 'xyz'],
                               kind.weight, atol=2e-5)


@pytest.mark.nightly
def test_errors_beyond_what_can_be_predicted_are_no_finding():
    result = fit(*recorded('all well', 100.0, 1), validate=0.8)
    assert result.validation.chi2_per_dof > 100.0  # the motion magnifies the error of the fit
    assert 20.0 < result.predictable_s < 80.0
    assert result.verdict.is_consistent


def test_a_bad_prediction_is_a_finding():
    kind = replace(named('all well'), seconds=12.0, dropped=0.9)
    result = fit(kind, *recordings(kind, [0]), validate=0.5)
    assert any('validation' in reason for reason in result.verdict.reasons)


@pytest.mark.nightly
@pytest.mark.parametrize('guess', [(0.02, 0.03, 0.05), *at_night(
    ((0.05, 0.02, 0.03),), ((0.0005, 0.04, 0.04),))])
def test_a_fit_can_leave_a_guess_of_a_plate_or_a_rod(guess):
    result, other = changed(guess=guess), identified('all well')
    for name in TRUE:
        assert result.estimates[name].value == pytest.approx(
            other.estimates[name].value, abs=0.1 * other.estimates[name].sigma)
    assert not result.is_flat


def test_a_plate_is_called_one():
    assert changed(inertia=np.diag([0.02, 0.03, 0.05]), seconds=6.0).is_flat


def test_a_known_gain_limits_the_certainty_of_the_inertia():
    result = fit(*recorded('all well', 6.0), estimate=['inertia', 'start', 'torque_gain'],
                 priors={'torque_gain': '5%'})
    assert result.is_complete
    for name in ('inertia.ixx', 'inertia.iyy', 'inertia.izz'):
        one = result.estimates[name]
        assert one.sigma / one.value == pytest.approx(0.05, rel=0.02)
    assert result.estimates['torque_gain'].sigma == pytest.approx(0.05, rel=0.01)


def test_a_small_mounting_is_no_large_one():
    result = fit(*recorded('mocap turned by 1 degree', 12.0, 1))
    assert result.verdict.level == 'approximate'
    assert result.verdict.suspects[0].name == 'mount@/mocap'
    assert covered(result) == 6
    assert 'the model leaves' in result.verdict.reasons[0]
    assert re.match(r'Ixx = 0\.0\d+ kg m\^2 within \S+ %, Iyy = .*; approximate: ',
                    result.headline)


def of_bodies(factors):
    """Fit recordings of bodies, whose inertias differ by these factors, as those of one body."""
    kind, experiments = replace(named('all well'), seconds=6.0), []
    for factor, one in zip(factors, recordings(kind, range(len(factors)))):
        # Twice the torque turns twice the inertia as fast.
        experiments.append(experiment(kind, replace(one, torques=one.torques / factor)))
    return identify(GUESS, experiments)


def test_the_scatter_between_recordings_says_how_certain_an_estimate_is():
    factors = [1.02, 0.97, 1.01, 0.98, 1.03]
    result = of_bodies(factors)
    assert result.verdict.level == 'approximate'
    expected = stdtrit(4, 0.975) * np.std(factors, ddof=1) / np.sqrt(5)
    for name in ('inertia.ixx', 'inertia.iyy', 'inertia.izz'):
        one = result.estimates[name]
        half = 0.5 * np.diff(one.interval_95)[0] / TRUE[name]
        assert 0.3 * expected < half < 3.0 * expected
        low, high = one.interval_95
        assert low * np.mean(factors) <= TRUE[name] <= high * np.mean(factors)
    rows = [row for row in result.rows() if row[0].startswith('recording')]
    assert len(rows) == 2 * len(factors)
    for (name, text), one in zip(rows, result.residuals):
        size, whole = (np.sqrt(np.mean(np.sum(each ** 2, axis=1)))
                       for each in (one.errors[one.inliers], one.measured))
        left = f'{size:.2g} rad of the attitude' if one.is_attitude else \
            f'{100.0 * size / whole:.2g} % of the angular velocity'
        assert (name, text) == (f'recording {one.recording + 1}',
                                f'{one.topic}: {left} unexplained (rms)')
        assert result.as_dict()['unexplained'][one.name] == pytest.approx(
            size if one.is_attitude else size / whole, rel=1e-12)


@pytest.mark.nightly
def test_a_recording_of_another_body_is_named():
    reasons = of_bodies([1.0, 1.0, 1.0, 1.3, 1.0]).verdict.reasons
    assert any(reason.startswith('recording 4 does not fit the others') for reason in reasons)


def test_a_fit_that_is_not_as_certain_as_accepted_is_rejected():
    verdict = fit(*recorded('all well', 6.0), accept=1e-6).verdict
    assert verdict.level == 'rejected'
    assert 'inertia.ixx: the interval is wider than the accepted 1e-06' in verdict.reasons


@pytest.mark.parametrize(('name', 'seed', 'seconds'), [
    ('fuel burnt', 3, 12.0), *at_night(('dipole in an unknown field', 1, 20.0),
                                       ('gains of all axes', 1, 20.0))])
def test_an_estimate_is_as_uncertain_as_the_halves_of_the_recording_differ(name, seed, seconds):
    # No suspect is the cause, or it cannot tell how large the cause is.
    result = fit(*recorded(name, seconds, seed, 10.0))
    assert result.verdict.level == 'approximate'
    assert covered(result) >= 5


def test_a_suspect_beside_the_moment_of_a_field_is_fitted():
    given = experiment(*recorded('torque bias'))
    pivot = UniformField((1e-6, 0.0, 0.0), (0.0, 0.0, -9.8), 'pivot')
    result = identify(GUESS, replace(given, fields=[pivot]),
                      estimate=['inertia', 'start', 'pivot.moment'])
    assert 'torque_bias' in {one.name for one in result.verdict.suspects}


def on_the_ground(torque, has_attitude=False, bias=0.01):
    """Return 10 s of noise of the sensors of a body that stands still while torques are logged."""
    random, times = np.random.default_rng(5), np.arange(1000) * 10_000_000
    log = TorqueLog(times[::5], torque * np.cumsum(random.normal(size=(200, 3)), axis=0))
    measured = [Measured('/imu', times, None, bias + 2e-3 * random.normal(size=(1000, 3)))]
    if has_attitude:
        turned = Rotation.from_rotvec(2e-3 * random.normal(size=(1000, 3)))
        measured.append(Measured('/mocap', times, turned.as_quat(), None))
    return Experiment(State(0), log, measured)


@pytest.mark.parametrize(('has_attitude', 'torque', 'names', 'text'), [
    (False, 5e-3, ('inertia', 'start'), 'the logged torque has no visible effect'),
    (True, 5e-3, ('start', 'torque_gains'), 'the logged torque has no visible effect'),
    (True, 0.0, ('inertia', 'start'), 'this says nothing about it')])
def test_a_body_that_does_not_move_is_rejected_with_one_reason(has_attitude, torque, names, text):
    recording = on_the_ground(torque, has_attitude)
    verdict = identify(GUESS, recording, estimate=names).verdict
    assert (verdict.level, verdict.suspects) == ('rejected', [])
    reason, *others = verdict.reasons
    assert reason == f'the body does not visibly move: {text}'
    assert all('has no visible effect about' in other for other in others)


@pytest.mark.parametrize(('torque', 'level'), [(5e-3, 'rejected'), (0.0, 'explained')])
def test_only_a_body_that_should_move_is_compared_with_a_reason(torque, level):
    recording = on_the_ground(torque, True, bias=0.0)
    verdict = compare(GUESS, recording.start, recording.log, measured=recording.measured,
                      align=['start']).verdict
    assert (verdict.level, verdict.reasons) == (level, [] if level == 'explained' else [
        'the body does not visibly move: the logged torque has no visible effect'])


def test_a_motion_of_three_degrees_is_a_motion():
    recording, body = on_the_ground(3e-6, bias=0.0), RigidBody.from_moments(0.02, 0.03, 0.04)
    gyro, = recording.measured
    motion = propagate(body, recording.start, recording.log, at=gyro.stamps_ns)
    assert motion.rotation.magnitude().max() < 0.06
    moving = replace(gyro, angular_velocity=gyro.angular_velocity + motion.angular_velocity)
    result = identify(body, replace(recording, measured=[moving]),
                      estimate=['start', 'torque_gain'])
    assert result.verdict.is_consistent
    gain = result.estimates['torque_gain']
    assert abs(gain.value - 1.0) < 4.0 * gain.sigma < 0.2


@pytest.mark.parametrize(('name', 'prior'), [
    ('gyro bias', {'gyro_bias': 1e-5}),
    *at_night(('mount of the gyro 5 degrees', {'mount': 1e-4}),
              ('gyro scale', {'gyro_scale': '0.01%'}))])
def test_a_suspect_that_the_user_rules_out_is_not_named_and_does_not_widen(name, prior):
    usual, narrow = identified(name), fit(*recorded(name), priors=prior)
    assert [one.name.partition('@')[0] for one in usual.verdict.suspects] == [*prior]
    assert narrow.verdict.suspects == []
    for one, other in zip(usual.estimates.values(), narrow.estimates.values()):
        assert (one.value, one.sigma) == (other.value, other.sigma)
        assert other.systematic <= one.systematic
    assert any(one.systematic > 0.0 for one in usual.estimates.values())


def test_a_model_of_a_body_at_rest_is_right_but_no_fit_of_it():
    times = np.arange(1000) * 10_000_000
    measured = [Measured('/mocap', times, np.tile([0.0, 0.0, 0.0, 1.0], (1000, 1)), None),
                Measured('/imu', times, None, np.zeros((1000, 3)))]
    body, experiment = RigidBody(np.eye(3)), Experiment(State(0), None, measured)
    assert compare(body, State(0), measured=measured).verdict.reasons == []
    for log in (None, TorqueLog([0], [[1e-3, 0.0, 0.0]])):
        verdict = identify(body, replace(experiment, log=log)).verdict
        assert verdict.level == 'rejected'
        assert verdict.reasons[0].startswith('the body does not visibly move')


VALUES = {'gyro_bias': np.array([0.01, -0.02, 0.005]), 'gyro_scale': np.array([1.03, 0.98, 1.0])}
MOUNT = Rotation.from_rotvec([0.0, 0.3, -0.4])


def motion():
    return truth(seconds=10.0)


def noisy(level=1.0, seed=0, **options):
    return motion().measured(2e-3 * level, 5e-3 * level, seed=seed, **options)


def apart(both):
    """Return a sensor as two, of attitudes and of rates."""
    return [replace(both, topic='/mocap', angular_velocity=None),
            replace(both, topic='/imu', attitude=None)]


def sensors(level=1.0, seed=0, **options):
    return apart(noisy(level, seed, **options))


def against(motion, measured, **options):
    return compare(motion.body, motion.start, motion.log, measured=measured, **options)


def with_rows(values, first, last, by):
    """Return values of which some rows are replaced."""
    return np.concatenate([values[:first], by(values[first:last]), values[last:]])


def held(values):
    return with_rows(values, 400, 700, lambda rows: np.tile(rows[0], (300, 1)))


#: Faults of a sensor: the attitudes and rates it gives instead, by the name of the suspect.
FAULTS = {
    'quaternion_order': lambda q, w: (np.roll(q, 1, axis=1), w),
    'inverse_quaternion': lambda q, w: (so3.conjugate(q), w),
    'frozen_attitude': lambda q, w: (held(q), w),
    'flipped_attitude': lambda q, w: (with_rows(
        q, 250, 350, lambda rows: so3.multiply(rows, [0.0, 0.0, 1.0, 0.0])), w),
    'degrees': lambda q, w: (q, np.degrees(w)),
    'rates_in_space': lambda q, w: (q, so3.rotate(q, w)),
    'gyro_axes': lambda q, w: (q, w * [1.0, 1.0, -1.0]),
    'gyro_bias': lambda q, w: (q, w + VALUES['gyro_bias']),
    'gyro_scale': lambda q, w: (q, w * VALUES['gyro_scale']),
    'gyro_saturation': lambda q, w: (q, np.clip(w, -1.2, 1.2)),
    'frozen_rates': lambda q, w: (q, held(w)),
    'mount': lambda q, w: (q, MOUNT.apply(w, inverse=True))}
#: What the description of a suspect says beside the topic.
TEXTS = {'gyro_saturation': 'saturates at 1.2 rad/s', 'degrees': 'degrees per',
         'frozen_attitude': 'from 4 s to 6.9', 'quaternion_order': 'w, x, y, z',
         'flipped_attitude': '100 of 1000 samples, first 2.5 s after the start: 180 degrees'}


def broken(name):
    """Return measurements of a sensor with a fault."""
    both = noisy()
    attitude, rates = FAULTS[name](both.attitude, both.angular_velocity)
    return replace(both, attitude=attitude, angular_velocity=rates)


@pytest.mark.parametrize(('name', 'has_model'), [
    *((name, False) for name in (*FAULTS, 'clock_offset')), *((name, True) for name in (
        'quaternion_order', 'flipped_attitude', 'frozen_attitude', 'gyro_bias', 'gyro_scale'))])
def test_a_fault_of_a_sensor_is_named_with_the_sensor(name, has_model):
    mocap, imu = apart(broken(name)) if name in FAULTS else sensors()
    if name == 'clock_offset':
        imu = replace(imu, stamps_ns=imu.stamps_ns + 1_500_000_000)
    verdict = against(motion(), [mocap, imu]).verdict if has_model else of_pair(mocap, imu)
    assert verdict.level != 'explained'
    suspect = verdict.suspects[0]
    assert suspect.name == name
    topic = '/mocap' if 'attitude' in name or 'quaternion' in name else '/imu'
    assert not suspect.text or suspect.text.startswith(f'{topic}: ')
    if has_model or topic == '/imu':
        assert TEXTS.get(name, '') in suspect.text
    if name in VALUES:
        np.testing.assert_allclose(suspect.value, VALUES[name], atol=2e-3)


def under_torque_in_space(true):
    exact = propagate(true.body, true.start, TorqueLog(true.torque_times, true.torques, 'space'),
                      at=true.stamps_ns)
    return replace(true, attitude=exact.rotation, rates=exact.angular_velocity)


#: What is wrong about the measurement, the body or the log, by the name of the suspect.
MIXED_UP = {
    'start': lambda _: {'sensor': noisy(space=Rotation.from_euler('x', 180.0, degrees=True))},
    'clock_offset': lambda _: {'sensor': noisy(clock=0.035)},
    'gyro_mount': lambda _: {'sensor': broken('mount')},
    'torque_axes': lambda true: {'log': TorqueLog(
        true.torque_times, true.torques[:, [1, 0, 2]] * [1.0, -1.0, 1.0])},
    'torque_in_space': lambda true: {'sensor': under_torque_in_space(true).measured(1e-3, 2e-3)},
    'torque_in_body': lambda true: {'log': TorqueLog(true.torque_times, true.torques, 'space')},
    'torque_gain': lambda true: {'log': TorqueLog(true.torque_times, true.torques / 0.8)},
    'inertia': lambda true: {'body': RigidBody(
        true.inertia + np.diag([0.002, -0.001, 0.003]))}}


def mixed_up(name):
    """Return the body, the log and the measurement of a mix-up of conventions."""
    given = {'body': motion().body, 'log': motion().log, 'sensor': noisy()}
    return {**given, **MIXED_UP[name](motion())}.values()


@pytest.mark.parametrize('name', MIXED_UP)
def test_a_mix_up_is_named(name):
    body, log, sensor = mixed_up(name)
    found = compare(body, motion().start, log, measured=sensor)
    assert not found.verdict.is_consistent
    assert found.verdict.suspects[0].name == name
    assert found.as_dict()['likely_causes'][0]['cause'] == name


@pytest.mark.parametrize('name', ['gyro_mount', 'torque_in_body'])
def test_a_fit_names_the_same_mix_up_though_it_does_not_know_the_inertia(name):
    _, log, sensor = mixed_up(name)
    verdict = identify(GUESS, Experiment(motion().start, log, [sensor])).verdict
    assert (verdict.level, verdict.suspects[0].name) == ('rejected', name)


def wrong(name):
    one = experiment(*recorded(name))
    return compare(BODY, one.start, one.log, measured=one.measured)


def of_monitor(one):
    """Return the first suspect that a live check names, or None if it raises no alarm."""
    monitor = Monitor(Problem(BODY, State(0)),
                      Settings(5.0, 0.0, 1e-3, 2e-3, 24.0))
    monitor.apply(one.log.times_ns, one.log.torques)
    for sensor in one.measured:
        monitor.measure(sensor.topic, sensor.stamps_ns, *(
            np.full((len(sensor), size), np.nan) if values is None else values
            for values, size in ((sensor.attitude, 4), (sensor.angular_velocity, 3))))
    alarms = [judgement for judgement in monitor.judgements() if judgement.level == ERROR]
    return first_suspect(*monitor.latest()) if alarms else None


@pytest.mark.parametrize(('name', 'seconds'), [('gyro bias', 12.0), ('damping', 12.0), *at_night(*(
    (name, 30.0) for name in (
        'weight', 'attitude frozen for 3 s', 'rotor', 'torque bias',
        'gains of all axes', 'mount 30 degrees', 'clock 10 ms', 'clock drifts', 'gyro scale',
        'gyro saturates', 'gyro in degrees per second', 'attitude of space in body axes')))])
def test_comparison_fit_and_live_check_name_the_same_cause(name, seconds):
    one = experiment(*recorded(name, seconds))
    compared, fitted = (found.verdict.suspects[0].name for found in (
        compare(BODY, one.start, one.log, measured=one.measured),
        identify(BODY, one, estimate=['start'])))
    assert compared in named(name).causes
    assert [compared, fitted] == [of_monitor(one).name] * 2


def test_a_mounting_is_named_with_its_angle():
    suspect = wrong('mount of the gyro 5 degrees').verdict.suspects[0]
    assert suspect.name == 'mount@/imu'
    assert suspect.command == '--align mount corrects that'
    assert np.degrees(np.linalg.norm(suspect.value)) == pytest.approx(5.0, rel=0.05)


@pytest.mark.parametrize('level', [0.1, 10.0])
@pytest.mark.parametrize('seed', [0, *at_night(*range(1, 10))])
def test_a_perfect_model_names_nothing(level, seed):
    verdict = against(motion(), sensors(level, seed, outliers=0.02 * (seed % 2))).verdict
    assert verdict.as_dict() == EXPLAINED


@pytest.mark.parametrize(('torque', 'first'), [(0.0, []), (1e-4, ['torque_bias'])])
def test_a_body_at_rest_is_not_in_degrees(torque, first):
    random, times = np.random.default_rng(0), np.arange(1, 1001) * 10 ** 7
    moved = propagate(BODY, State(0), TorqueLog([0], [[torque, 0.0, 0.0]]), at=times)
    noise = Rotation.from_rotvec(1e-3 * random.normal(size=(1000, 3)))
    measured = [Measured('/mocap', times, (moved.rotation * noise).as_quat(), None),
                Measured('/imu', times, None,
                         moved.angular_velocity + 1e-3 * random.normal(size=(1000, 3)))]
    suspects = compare(BODY, State(0), measured=measured).verdict.suspects
    assert [one.name for one in suspects][:1] == first


def test_of_two_faults_the_larger_is_named_first():
    mocap, imu = sensors()
    imu = replace(imu, angular_velocity=0.5 * imu.angular_velocity + 0.03)
    suspects = against(motion(), [mocap, imu]).verdict.suspects
    assert suspects[0].name == 'gyro_scale'


def test_each_sensor_has_its_own_clock_and_mounting():
    turns = {'/mocap': np.radians(3.0) * np.array([0.6, -0.64, 0.48]),
             '/imu': np.radians(30.0) * np.array([0.0, 0.6, -0.8])}
    clocks = {'/mocap': 0.03, '/imu': -0.03}
    measured = [sensors(clock=clocks[topic], mount=Rotation.from_rotvec(turn))[number]
                for number, (topic, turn) in enumerate(turns.items())]
    found = against(motion(), measured, align=['clock', 'mount'])
    assert found.verdict.is_consistent
    for one, (topic, turn) in zip(found.alignments, turns.items()):
        assert abs(one.clock_offset_s - clocks[topic]) < 3.0 * one.sigma['clock_offset_s']
        apart = so3.log(so3.multiply(so3.conjugate(so3.exp(turn)), one.mount))
        assert np.linalg.norm(apart) < 3.0 * np.linalg.norm(one.sigma['mount_rad'])
    as_dict = found.as_dict()
    assert [*as_dict['alignments']] == ['/mocap', '/imu']
    for name, value in as_dict['alignments']['/mocap'].items():
        assert as_dict['alignment'][name] == value


def test_errors_that_the_start_explains_are_no_finding():
    # A spin about the middle axis flips repeatedly, so a change of the start grows as exp(t).
    body, times = RigidBody.from_moments(1.0, 2.0, 3.0), np.arange(1, 6001) * 5 * 10 ** 7
    start = State(0, angular_velocity=(1e-3, 1.0, 1e-3))
    random = np.random.default_rng(3)
    motion = propagate(body, start, at=times)
    noise = Rotation.from_rotvec(1e-3 * random.normal(size=(6000, 3)))
    measured = Measured('/mocap', times, (motion.rotation * noise).as_quat(), None)

    def frozen(first):
        attitude = measured.attitude.copy()
        attitude[first:first + 100] = attitude[first]
        return compare(body, start, measured=replace(measured, attitude=attitude), horizons=None)
    found = frozen(3000)
    assert found.as_dict()['attitude_error_rad']['max'] > 0.1
    assert 5.0 < found.predictable_s < 30.0
    assert found.verdict.is_consistent
    assert frozen(60).verdict.suspects[0].name == 'frozen_attitude'
    assert [one.seconds for one in found.horizons] == [0.1, 1.0, 10.0]
    assert compare(body, start, measured=replace(
        measured, attitude=motion.attitude)).predictable_s is None


def test_a_noisy_sensor_that_is_frozen_for_long_needs_little_memory():
    phases = 1e-4 * np.arange(30_000)
    rates = np.stack([np.sin(phases), np.cos(phases), np.sin(phases + 1.0)], axis=1)
    measured = rates + 1e-2 * np.random.default_rng(0).normal(size=rates.shape)
    measured[10_000:] = measured[10_000]
    with memory_limit(20e6):
        still = _still(measured, rates, 1e-2, _distance)
    assert still[11_000:].all()
    assert not still[:9_000].any()


def test_usual_horizons_are_those_that_the_measurement_has():
    mocap, imu = apart(truth().measured(2e-3, 5e-3))
    assert [one.seconds for one in against(truth(), mocap, horizons=None).horizons] == [
        0.1, 1.0, 10.0]
    coarse = mocap.rows(np.arange(0, 900, 20))
    assert [one.seconds for one in against(truth(), coarse, horizons=None).horizons] == [1.0]
    assert against(truth(), imu, horizons=None).horizons == ()


def of_pair(mocap, imu):
    return compare_motion(Recorded.of_attitudes(mocap), [imu]).verdict


@pytest.mark.parametrize('name', ['noise AR 0.8', '3 % outliers', 'attitude at 20 Hz', *at_night(
    'all well', 'weak torque', 'noise AR 0.5', '20 % missing')])
def test_two_right_sensors_agree(name):
    verdict = of_pair(*experiment(*recorded(name, 8.0)).measured)
    assert verdict.as_dict() == EXPLAINED


def test_a_gap_of_either_sensor_is_left_out():
    mocap, imu = sensors()
    kept = np.r_[:350, 475:len(mocap)]
    for pair in ((mocap.rows(kept), imu), (mocap, imu.rows(kept))):
        assert of_pair(*pair).is_consistent


def test_a_body_at_rest_is_not_frozen():
    times = np.arange(3000) * 10 ** 7
    log = TorqueLog(np.array([0, 10, 11]) * 10 ** 9, [[0.0] * 3, [0.01, 0.0, 0.0], [0.0] * 3])
    motion = propagate(BODY, State(0), log, at=times)
    attitude = so3.exp(np.round(so3.log(motion.attitude), 3))
    rates = np.round(motion.angular_velocity, 3)
    verdict = of_pair(Measured('/mocap', times, attitude, None),
                      Measured('/imu', times, None, rates))
    assert not any('frozen' in one.name for one in verdict.suspects)


def test_the_command_compares_sensors_without_a_scene(tmp_path, capsys, refusal):
    path, out = str(RECORDINGS / 'flight.mcap'), tmp_path / 'out.json'
    status = main.attitude_compare([path, '--measured', '/mocap', '--measured', '/gyro',
                                    '--json', str(out), '--report', str(tmp_path / 'page.html'),
                                    '--plot', str(tmp_path / 'errors.png')])
    assert status == 0
    assert capsys.readouterr().out.startswith('verdict          explained: ')
    assert json.loads(out.read_text())['verdict']['consistent']
    for options, text in (
            (['--measured', '/mocap'], '/mocap: expected a second sensor to compare with, or '
             '--scene, found none'),
            (['--measured', '/gyro'], 'expected at least 10 attitudes to compare with, or '
             '--scene, found none'),
            (['--measured', '/mocap', '--check'], '--check: expected --scene, found none'),
            (['--measured', '/mocap', '--topic', '/torque'],
             '--topic: expected --scene, found none')):
        assert refusal('attitude_compare', path, *options).endswith(text)
