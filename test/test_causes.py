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

"""A comparison names what is wrong, and the sensor; `simulated` makes the recordings."""

from dataclasses import replace
import json

from campaign import experiment
from conftest import at_night, CONFIG, memory_limit, RECORDINGS
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
)
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.comparison.comparison import compare_motion
from rigid_body_ros.inference.hypotheses import _distance, _still
from rigid_body_ros.inference.monitor import ERROR, first_suspect, Monitor, Settings
from rigid_body_ros.inference.motion import Recorded
from rigid_body_ros.mechanics import so3
from scipy.spatial.transform import Rotation
import simulated

BIAS, SCALE = np.array([0.01, -0.02, 0.005]), np.array([1.03, 0.98, 1.0])
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


def changed(values, first, last, by):
    """Return values of which some rows are replaced."""
    return np.concatenate([values[:first], by(values[first:last]), values[last:]])


def held(values):
    return changed(values, 400, 700, lambda rows: np.tile(rows[0], (300, 1)))


#: Faults of a sensor: the attitudes and rates it gives instead, by the name of the suspect.
FAULTS = {
    'quaternion_order': lambda q, w: (np.roll(q, 1, axis=1), w),
    'inverse_quaternion': lambda q, w: (so3.conjugate(q), w),
    'frozen_attitude': lambda q, w: (held(q), w),
    'flipped_attitude': lambda q, w: (changed(
        q, 250, 350, lambda rows: so3.multiply(rows, [0.0, 0.0, 1.0, 0.0])), w),
    'degrees': lambda q, w: (q, np.degrees(w)),
    'rates_in_space': lambda q, w: (q, so3.rotate(q, w)),
    'gyro_axes': lambda q, w: (q, w * [1.0, 1.0, -1.0]),
    'gyro_bias': lambda q, w: (q, w + BIAS),
    'gyro_scale': lambda q, w: (q, w * SCALE),
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


@pytest.mark.slow
@pytest.mark.parametrize('name', ['quaternion_order', 'flipped_attitude',
                                  'frozen_attitude', 'gyro_bias', 'gyro_scale'])
def test_a_fault_of_a_sensor_is_named_with_the_sensor(name):
    verdict = against(motion(), apart(broken(name))).verdict
    assert not verdict.is_consistent
    suspect = verdict.suspects[0]
    assert suspect.name == name
    assert TEXTS.get(name, '') in suspect.text
    if name in ('gyro_bias', 'gyro_scale'):
        np.testing.assert_allclose(suspect.value, {'gyro_bias': BIAS, 'gyro_scale': SCALE}[name],
                                   atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize('name', [*FAULTS, 'clock_offset'])
def test_a_fault_of_one_of_two_sensors_is_named_without_a_model(name):
    mocap, imu = apart(broken(name)) if name in FAULTS else sensors()
    if name == 'clock_offset':
        imu = replace(imu, stamps_ns=imu.stamps_ns + 1_500_000_000)
    verdict = of_pair(mocap, imu)
    assert verdict.level != 'explained'
    suspect = verdict.suspects[0]
    assert suspect.name == name
    topic = '/mocap' if 'attitude' in name or 'quaternion' in name else '/imu'
    assert not suspect.text or suspect.text.startswith(f'{topic}: ')
    assert topic == '/mocap' or TEXTS.get(name, '') in suspect.text


def mixed_up(name):
    """Return the measurement, the body and the log with a named mix-up of conventions."""
    true, sensor, body, log = motion(), noisy(), motion().body, motion().log
    times, torques = true.torque_times, true.torques
    space = TorqueLog(times, torques, 'space')
    if name == 'start':
        sensor = noisy(space=Rotation.from_euler('x', 180.0, degrees=True))
    elif name == 'clock_offset':
        sensor = noisy(clock=0.035)
    elif name == 'torque_axes':
        log = TorqueLog(times, torques[:, [1, 0, 2]] * [1.0, -1.0, 1.0])
    elif name == 'torque_in_space':
        exact = propagate(body, true.start, space, at=true.stamps_ns)
        sensor = replace(true, attitude=exact.rotation, rates=exact.angular_velocity
                         ).measured(1e-3, 2e-3)
    elif name == 'torque_in_body':
        log = space
    elif name == 'gyro_mount':
        sensor = broken('mount')
    elif name == 'torque_gain':
        log = TorqueLog(times, torques / 0.8)
    elif name == 'inertia':
        body = RigidBody(body.inertia + np.diag([0.002, -0.001, 0.003]))
    else:
        sensor = broken(name)
    return sensor, body, log


@pytest.mark.slow
@pytest.mark.parametrize('name', [
    'start', 'clock_offset', 'torque_axes', 'torque_in_space', 'torque_in_body', 'gyro_mount',
    'torque_gain', 'inertia'])
def test_a_mix_up_is_named(name):
    sensor, body, log = mixed_up(name)
    found = compare(body, motion().start, log, measured=sensor)
    assert not found.verdict.is_consistent
    assert found.verdict.suspects[0].name == name
    assert found.as_dict()['likely_causes'][0]['cause'] == name


@pytest.mark.slow
@pytest.mark.parametrize('name', ['gyro_mount', 'torque_in_body'])
def test_a_fit_names_the_same_mix_up_though_it_does_not_know_the_inertia(name):
    sensor, _, log = mixed_up(name)
    guess = RigidBody.from_moments(0.03, 0.03, 0.03)
    verdict = identify(guess, Experiment(motion().start, log, [sensor])).verdict
    assert (verdict.level, verdict.suspects[0].name) == ('rejected', name)


def recorded(name, seconds=12.0):
    """Return a kind of recording of a length, and what was logged of one."""
    kind = replace(simulated.named(name), seconds=seconds)
    one, = simulated.recordings(kind, [0])
    return kind, experiment(kind, one)


def wrong(name):
    one = recorded(name)[1]
    return compare(RigidBody(simulated.INERTIA), one.start, one.log, measured=one.measured)


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'level'), [
    ('damping', 'rejected'),
    *at_night(('weight', 'approximate'), ('payload dropped', 'rejected'))])
def test_a_fault_of_the_model_is_named(name, level):
    verdict = wrong(name).verdict
    assert verdict.level == level
    assert {one.name for one in verdict.suspects[:2]} & {*simulated.named(name).causes}


def of_monitor(one):
    """Return the first suspect that a live check names, or None if it raises no alarm."""
    monitor = Monitor(Problem(RigidBody(simulated.INERTIA), State(0)),
                      Settings(5.0, 0.0, 1e-3, 2e-3, 24.0))
    monitor.apply(one.log.times_ns, one.log.torques)
    for sensor in one.measured:
        monitor.measure(sensor.topic, sensor.stamps_ns, *(
            np.full((len(sensor), size), np.nan) if values is None else values
            for values, size in ((sensor.attitude, 4), (sensor.angular_velocity, 3))))
    alarms = [judgement for judgement in monitor.judgements() if judgement.level == ERROR]
    return first_suspect(*monitor.latest()) if alarms else None


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'seconds'), [('gyro bias', 12.0), *at_night(*(
    (name, 30.0) for name in (
        'weight', 'attitude frozen for 3 s', 'damping', 'rotor', 'torque bias',
        'gains of all axes', 'mount 30 degrees', 'clock 10 ms', 'clock drifts', 'gyro scale',
        'gyro saturates', 'gyro in degrees per second', 'attitude of space in body axes')))])
def test_comparison_fit_and_live_check_name_the_same_cause(name, seconds):
    kind, one = recorded(name, seconds)
    body = RigidBody(simulated.INERTIA)
    compared, fitted = (found.verdict.suspects[0].name for found in (
        compare(body, one.start, one.log, measured=one.measured),
        identify(body, one, estimate=['start'])))
    assert compared in kind.causes
    assert [compared, fitted] == [of_monitor(one).name] * 2


@pytest.mark.slow
def test_a_mounting_is_named_with_its_angle():
    suspect = wrong('mount of the gyro 5 degrees').verdict.suspects[0]
    assert suspect.name == 'mount@/imu'
    assert suspect.command == '--align mount corrects that'
    assert np.degrees(np.linalg.norm(suspect.value)) == pytest.approx(5.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize('level', [0.1, 10.0])
@pytest.mark.parametrize('seed', [0, *at_night(*range(1, 10))])
def test_a_perfect_model_names_nothing(level, seed):
    verdict = against(motion(), sensors(level, seed, outliers=0.02 * (seed % 2))).verdict
    assert verdict.as_dict() == {'level': 'explained', 'consistent': True, 'reasons': [],
                                 'suspects': []}


@pytest.mark.slow
@pytest.mark.parametrize(('torque', 'named'), [(0.0, []), (1e-4, ['torque_bias'])])
def test_a_body_at_rest_is_not_in_degrees(torque, named):
    random, times = np.random.default_rng(0), np.arange(1, 1001) * 10 ** 7
    body, start = RigidBody(simulated.INERTIA), State(0)
    moved = propagate(body, start, TorqueLog([0], [[torque, 0.0, 0.0]]), at=times)
    noise = Rotation.from_rotvec(1e-3 * random.normal(size=(1000, 3)))
    measured = [Measured('/mocap', times, (moved.rotation * noise).as_quat(), None),
                Measured('/imu', times, None,
                         moved.angular_velocity + 1e-3 * random.normal(size=(1000, 3)))]
    suspects = compare(body, start, measured=measured).verdict.suspects
    assert [one.name for one in suspects][:1] == named


@pytest.mark.slow
def test_of_two_faults_the_larger_is_named_first():
    mocap, imu = sensors()
    imu = replace(imu, angular_velocity=0.5 * imu.angular_velocity + 0.03)
    suspects = against(motion(), [mocap, imu]).verdict.suspects
    assert suspects[0].name == 'gyro_scale'


@pytest.mark.slow
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


@pytest.mark.slow
def test_one_sensor_can_be_aligned_alone():
    mocap, imu = sensors()
    turned = replace(imu, angular_velocity=Rotation.from_rotvec([0.3, 0.0, 0.0]).apply(
        imu.angular_velocity, inverse=True))
    found = against(motion(), [mocap, turned], align=['mount@/imu'])
    assert found.alignments[0].as_dict()['mount_xyzw'] == [0.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(so3.log(found.alignments[1].mount), [0.3, 0.0, 0.0], atol=2e-3)
    assert found.verdict.is_consistent
    with pytest.raises(InputError, match='align: mount@/gps: expected a topic among /mocap, /imu'):
        against(motion(), [mocap, imu], align=['mount@/gps'])


@pytest.mark.slow
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


@pytest.mark.slow
def test_usual_horizons_are_those_that_the_measurement_has():
    mocap, imu = apart(truth().measured(2e-3, 5e-3))
    assert [one.seconds for one in against(truth(), mocap, horizons=None).horizons] == [
        0.1, 1.0, 10.0]
    coarse = mocap.rows(np.arange(0, 900, 20))
    assert [one.seconds for one in against(truth(), coarse, horizons=None).horizons] == [1.0]
    assert against(truth(), imu, horizons=None).horizons == ()


def of_pair(mocap, imu):
    return compare_motion(Recorded.of_attitudes(mocap), [imu]).verdict


@pytest.mark.slow
@pytest.mark.parametrize('name', ['noise AR 0.8', '3 % outliers', 'attitude at 20 Hz', *at_night(
    'all well', 'weak torque', 'noise AR 0.5', '20 % missing')])
def test_two_right_sensors_agree(name):
    verdict = of_pair(*recorded(name, 8.0)[1].measured)
    assert verdict.as_dict() == {'level': 'explained', 'consistent': True, 'reasons': [],
                                 'suspects': []}


def test_a_gap_of_either_sensor_is_left_out():
    mocap, imu = sensors()
    kept = np.r_[:350, 475:len(mocap)]
    for pair in ((mocap.rows(kept), imu), (mocap, imu.rows(kept))):
        assert of_pair(*pair).is_consistent


def test_a_body_at_rest_is_not_frozen():
    times = np.arange(3000) * 10 ** 7
    log = TorqueLog(np.array([0, 10, 11]) * 10 ** 9, [[0.0] * 3, [0.01, 0.0, 0.0], [0.0] * 3])
    motion = propagate(RigidBody(simulated.INERTIA), State(0), log, at=times)
    attitude = so3.exp(np.round(so3.log(motion.attitude), 3))
    rates = np.round(motion.angular_velocity, 3)
    verdict = of_pair(Measured('/mocap', times, attitude, None),
                      Measured('/imu', times, None, rates))
    assert not any('frozen' in one.name for one in verdict.suspects)


def test_a_check_needs_enough_samples(tmp_path, capsys):
    path, scene = tmp_path / 'in.csv', str(CONFIG / 'tumbler.yaml')
    rows = [f'{0.1 * k},0,0,0,1' for k in range(1, 7)]
    path.write_text('\n'.join(['time,qx,qy,qz,qw', *rows]))
    (tmp_path / 'torque.csv').write_text('time,tx,ty,tz\n0,0,0,0\n1,0,0,0\n')
    arguments = [str(tmp_path / 'torque.csv'), '--scene', scene, '--measured', str(path)]
    assert main.attitude_compare([*arguments, '--check']) == 2
    assert '--check: expected at least 10 samples' in capsys.readouterr().err


def test_the_command_compares_sensors_without_a_scene(tmp_path, capsys):
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
        assert main.attitude_compare([path, *options]) == 2
        error = capsys.readouterr().err
        assert error.startswith('attitude_compare: error: ')
        assert error.endswith(f'{text}\n')
