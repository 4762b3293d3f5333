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

"""Logs of PX4, and recordings of px4_msgs, read as recordings of other types."""

from functools import partial
import json
from types import SimpleNamespace

import bags
from measurements import write_scene
import numpy as np
import px4
import pytest
from rigid_body_ros import messages, recording, scene, State
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.live.events import RejectedError
from rigid_body_ros.live.inputs import wrench_of
from rigid_body_ros.recording.measurements import read_measured
from rigid_body_ros.recording.ulog_file import UlogFile
from tumbling import INERTIA, Truth

pytest.importorskip('pyulog', reason='pyulog is not installed')
#: us; a log begins some time after boot.
BOOT = 60_000_000
GAINS = np.array([0.08, 0.05, 0.02])


def logged(path, truth, gains=1.0, noise=(2e-3, 5e-3)):
    """Write a log of a motion; messages are published 3 ms late."""
    sensor = truth.measured(*noise)
    stamps = (sensor.stamps_ns // 1000 + BOOT).tolist()
    attitude = np.roll(sensor.attitude, 1, axis=1).tolist()
    torques = (truth.torques / gains).tolist()
    return px4.write(path, {
        'vehicle_attitude': [(t + 3000, t, q) for t, q in zip(stamps, attitude)],
        'vehicle_angular_velocity': [(t + 3000, t, w) for t, w in zip(
            stamps, sensor.angular_velocity.tolist())],
        'vehicle_torque_setpoint': [(t, t - 3000, tau) for t, tau in zip(
            (truth.times // 1000 + BOOT).tolist(), torques)],
        'battery_status': [(BOOT + 1, (12.0,))]})


def scene_of(path, inertia=INERTIA):
    return str(write_scene(path, SimpleNamespace(inertia=inertia, start=State())))


@pytest.mark.slow
def test_the_numbers_of_a_log_in_its_own_frames(tmp_path):
    samples = [(1000 + 10 * k, 1000 + 10 * k - 7, vector) for k, vector in enumerate(
        np.random.default_rng(0).normal(size=(20_000, 4)).astype(np.float32).tolist())]
    path = px4.write(tmp_path / 'log.ulg', {
        'vehicle_attitude': samples, ('vehicle_attitude', 1): samples[:5],
        'vehicle_angular_velocity': [(*row[:2], row[2][:3]) for row in samples],
        'vehicle_torque_setpoint': [(*row[:2], row[2][1:]) for row in samples]})
    times, sampled = (1000 * np.array([row[k] for row in samples]) for k in (0, 1))
    numbers = np.array([row[2] for row in samples])
    attitude = recording.read(path, 'vehicle_attitude', messages.QUATERNION)
    np.testing.assert_array_equal(attitude.values, numbers[:, [1, 2, 3, 0]])
    np.testing.assert_array_equal(attitude.stamps_ns, sampled)
    rates = recording.read(path, 'vehicle_angular_velocity', messages.VECTOR3, time_source='log')
    np.testing.assert_array_equal(rates.values, numbers[:, :3])
    np.testing.assert_array_equal(rates.stamps_ns, times)
    torques = recording.read(path)
    assert torques.topic == 'vehicle_torque_setpoint'
    np.testing.assert_array_equal(torques.values, np.pad(numbers[:, 1:], ((0, 0), (3, 0))))
    np.testing.assert_array_equal(torques.stamps_ns, times)
    assert {*torques.names, *attitude.names, *rates.names} == {''}
    assert len(read_measured(path, 'vehicle_attitude_1')) == 5


def test_a_log_that_changes_is_read_again(tmp_path):
    path = tmp_path / 'log.ulg'
    for count in (5, 6):
        px4.write(path, {'vehicle_torque_setpoint': [(k, k, (0.0, 0.0, 0.1 * k))
                                                     for k in range(1, count)]})
        assert len(recording.read(path)) == count - 1


def test_a_time_of_sampling_that_is_not_set_and_what_is_lost(tmp_path):
    rows = [(k, 0, (0.0, 0.0, 0.0, 1.0)) for k in range(1, 6)]
    path = px4.write(tmp_path / 'log.ulg', {'vehicle_attitude': rows},
                     [px4.dropout(30), px4.dropout(12)])
    measured = read_measured(path)
    np.testing.assert_array_equal(measured.stamps_ns, 1000 * np.arange(1, 6))
    assert measured.damage == f'{path}: 2 dropouts of the logger, together 42 ms'


@pytest.mark.parametrize(('content', 'message'), [
    (b'', 'expected a log of PX4 .ULog.: Invalid file format'),
    (b'\x89MCAP0\r\n' + bytes(30), 'expected a log of PX4 .ULog.: Invalid file format'),
    (b'ULog\x01\x12\x35\x01' + bytes(8), 'expected one topic of type .*, found none')])
def test_a_bad_log_is_one_line(tmp_path, capsys, content, message):
    path = tmp_path / 'log.ulg'
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as raised:
        recording.read(path)
    assert '\n' not in str(raised.value)
    assert capsys.readouterr().out == ''


def test_a_time_after_the_last_of_ros_is_one_line(tmp_path):
    path = px4.write(tmp_path / 'log.ulg', {'vehicle_attitude': [
        (5, 5, (0.0, 0.0, 0.0, 1.0)), (2 ** 63, 5, (0.0, 0.0, 0.0, 1.0))]})
    with pytest.raises(InputError, match='vehicle_attitude: message 2: expected a time up to'):
        read_measured(path)


def test_a_log_without_its_reader_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(main.sys.modules, 'pyulog', None)
    path = px4.write(tmp_path / 'log.ulg', {'vehicle_attitude': []})
    assert main.attitude_replay([str(path), '--scene', scene_of(tmp_path / 's.yaml')]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        "attitude_replay: error: Python module 'pyulog' is not installed; "
        'run python3 -m pip install pyulog')


CONTROLS = [(1000 * k, 990 * k, (0.1 * k, 0.2, -0.3 * k)) for k in range(1, 6)]
RATES = [(1000 * k, (0.1 * k, 0.2, -0.3 * k)) for k in range(1, 6)]


def test_a_log_from_before_the_topics_of_today(tmp_path):
    path = px4.write(tmp_path / 'log.ulg', {'actuator_controls_0': CONTROLS,
                                            'sensor_combined': RATES})
    torques, rates = recording.read(path), read_measured(path, 'sensor_combined')
    assert torques.topic == 'actuator_controls_0'
    expected = np.array([row[2] for row in CONTROLS], np.float32)
    np.testing.assert_array_equal(torques.values, np.pad(expected, ((0, 0), (3, 0))))
    np.testing.assert_array_equal(rates.angular_velocity, expected)
    for found in (torques, rates):
        np.testing.assert_array_equal(found.stamps_ns, 10 ** 6 * np.arange(1, 6))


def test_the_topics_of_today_replace_older_ones(tmp_path):
    path = px4.write(tmp_path / 'log.ulg', {
        'actuator_controls_0': CONTROLS, 'sensor_combined': RATES,
        'vehicle_torque_setpoint': CONTROLS, 'vehicle_angular_velocity': CONTROLS})
    assert recording.read(path).topic == 'vehicle_torque_setpoint'
    with recording.Source(path, None, recording.TORQUES) as source:
        assert {*source.types} == {'vehicle_torque_setpoint', 'vehicle_angular_velocity'}
    with pytest.raises(InputError, match='vehicle_angular_velocity: expected .*WrenchStamped'):
        recording.read(path, 'vehicle_angular_velocity')


@pytest.mark.parametrize(('states', 'expected'), [
    ('1100110', (30_000, 50_000)),  # from the first message in the air to the next on the ground
    ('1100', (30_000, 45_000)),  # until the end of the log
    ('0010001', (40_000, 70_000)),  # the longest
    ('0000', None), ('1111', None), ('', None)])
def test_the_longest_flight_in_a_log(tmp_path, states, expected):
    path = px4.write(tmp_path / 'log.ulg', {
        'vehicle_land_detected': [(10 * k, int(state), ()) for k, state in enumerate(states, 1)],
        'vehicle_torque_setpoint': [(45, 45, (0.0, 0.0, 0.0))]})
    assert UlogFile(path).flight_ns == expected


#: Ways to record px4_msgs: with definitions, without them, and compressed.
WRITERS = {'mcap': bags.mcap, 'unindexed': partial(bags.mcap, **bags.UNINDEXED),
           'sqlite': partial(bags.rosbag2, storage='SQLITE3'),
           'messages': partial(bags.rosbag2, compression='MESSAGE'),
           'humble': bags.sqlite, 'foxy': partial(bags.sqlite, schema=2)}
TIMES = [(BOOT + 1000 * k, BOOT + 1000 * k - 300) for k in range(1, 8)]
SAMPLED = 1000 * np.array(TIMES)[:, 1]
PUBLISHED = 1000 * np.array(TIMES)[:, 0]
NUMBERS = np.random.default_rng(3).normal(size=(7, 8)).astype(np.float32)
ODOMETRY = px4.sent('/fmu/out/vehicle_odometry', 'VehicleOdometry', TIMES, q=NUMBERS[:, :4],
                    angular_velocity=NUMBERS[:, 4:7])
MESSAGES = [message for rows in zip(
    px4.sent('/fmu/out/vehicle_attitude_v1', 'VehicleAttitude', TIMES, q=NUMBERS[:, :4]),
    px4.sent('/fmu/out/vehicle_angular_velocity', 'VehicleAngularVelocity', TIMES,
             xyz=NUMBERS[:, 1:4]),
    px4.sent('/fmu/out/sensor_combined', 'SensorCombined', TIMES, gyro_rad=NUMBERS[:, 2:5]),
    px4.sent('/fmu/in/vehicle_torque_setpoint', 'VehicleTorqueSetpoint', TIMES,
             xyz=NUMBERS[:, 3:6])) for message in rows]


@pytest.mark.parametrize('form', WRITERS)
def test_the_numbers_in_a_recording_of_px4_msgs(tmp_path, form):
    path = WRITERS[form](tmp_path, MESSAGES)
    torques = recording.read(path)
    assert torques.topic == '/fmu/in/vehicle_torque_setpoint'
    np.testing.assert_array_equal(torques.values, np.pad(NUMBERS[:, 3:6], ((0, 0), (3, 0))))
    np.testing.assert_array_equal(torques.stamps_ns, PUBLISHED)
    attitude = recording.read(path, '/fmu/out/vehicle_attitude_v1', messages.QUATERNION)
    np.testing.assert_array_equal(attitude.values, NUMBERS[:, [1, 2, 3, 0]])
    np.testing.assert_array_equal(attitude.stamps_ns, SAMPLED)
    assert read_measured(path).topic == attitude.topic
    for topic, first, stamps in (('vehicle_angular_velocity', 1, SAMPLED),
                                 ('sensor_combined', 2, PUBLISHED)):
        rates = read_measured(path, f'/fmu/out/{topic}')
        np.testing.assert_array_equal(rates.angular_velocity, NUMBERS[:, first:first + 3])
        np.testing.assert_array_equal(rates.stamps_ns, stamps)
    logged = recording.read(path, time_source='log')
    np.testing.assert_array_equal(logged.stamps_ns, PUBLISHED + bags.LOGGED)


def test_an_odometry_of_px4_has_attitude_and_rates(tmp_path):
    path = bags.mcap(tmp_path, ODOMETRY)
    measured = read_measured(path)
    expected = NUMBERS[:, [1, 2, 3, 0]].astype(float)
    np.testing.assert_allclose(
        measured.attitude, expected / np.linalg.norm(expected, axis=1)[:, None], rtol=1e-15)
    np.testing.assert_array_equal(measured.angular_velocity, NUMBERS[:, 4:7])
    np.testing.assert_array_equal(measured.stamps_ns, SAMPLED)


def test_another_version_of_px4_msgs_needs_its_definition(tmp_path):
    sent = px4.sent('/torque', 'ActuatorControls', TIMES, control=NUMBERS)
    np.testing.assert_array_equal(recording.read(bags.mcap(tmp_path, sent)).values[:, 3:],
                                  NUMBERS[:, :3])
    with pytest.raises(InputError, match='/torque: message 1: expected 52 bytes that begin with '
                       '00 01, as PX4 v1.14 to v1.17, because the recording does not, defines a '
                       'px4_msgs/msg/ActuatorControls, found 92 bytes that begin with 00 01'):
        recording.read(bags.sqlite(tmp_path, sent))


SETPOINTS = px4.sent('/torque', 'VehicleTorqueSetpoint', TIMES, xyz=NUMBERS[:, :3])


@pytest.mark.parametrize(('new', 'message'), [
    ('float64[3] xyz', 'expected float32.3. xyz in the definition of px4_msgs/msg/'
     'VehicleTorqueSetpoint, found none'),
    ('string xyz_name', 'expected float32.3. xyz in the definition'),
    ('float32[3] xyz\nstring text', "expected fields of fixed sizes, found .string text'"),
    ('float32[3] xyz\nuint8 s', 'message 1: expected 33 bytes that begin with 00 01, as the '
     'recording defines a px4_msgs/msg/VehicleTorqueSetpoint, found 32 bytes')])
def test_a_definition_that_does_not_fit_is_one_line(tmp_path, monkeypatch, new, message):
    monkeypatch.setattr(bags, '_schema', lambda kind, encoding: ('ros2msg', px4.DEFINITIONS[
        kind.split('/')[-1]].replace('float32[3] xyz', new).encode()))
    with pytest.raises(InputError, match=message) as raised:
        recording.read(bags.mcap(tmp_path, SETPOINTS))
    assert '\n' not in str(raised.value)


def test_a_message_in_another_encoding_is_one_line(tmp_path):
    with pytest.raises(InputError, match='/torque: message 1: .* found 32 bytes that begin with '
                       '00 00'):
        recording.read(bags.mcap(tmp_path, SETPOINTS, cdr=bags.big_endian))


@pytest.mark.parametrize(('topic', 'count'), [('/fmu/in/vehicle_torque_setpoint', 1),
                                              ('/torque', 0)])
def test_normalized_torques_in_a_recording_are_a_warning(tmp_path, capsys, topic, count):
    path = bags.mcap(tmp_path, MESSAGES + bags.traffic(bags.torques(8)[6:]))
    assert main.attitude_replay([str(path), '--scene', scene_of(tmp_path / 's.yaml'), '--topic',
                                 topic]) == 0
    assert capsys.readouterr().err.count(
        f'{path}: the torques of PX4 are normalized, not in N m') == count


def test_a_torque_that_arrives_live_has_its_time_of_publication():
    kind = messages.PX4_TYPES['VehicleTorqueSetpoint']
    torque = messages.WRENCH.decode(wrench_of(kind, SETPOINTS[2].cdr()))
    assert (torque.stamp_ns, torque.frame_id) == (PUBLISHED[2], '')
    np.testing.assert_array_equal(torque.values, [0.0, 0.0, 0.0, *NUMBERS[2, :3]])


@pytest.mark.parametrize(('data', 'message'), [
    (b'\0\1\0\0' + bytes(27), 'expected 32 bytes that begin with 00 01, .* found 31 bytes'),
    (b'', 'expected 32 bytes'), (b'\0\1\0\0' + b'\xff' * 28, 'expected a time up to')])
def test_a_malformed_torque_that_arrives_live_is_rejected(data, message):
    with pytest.raises(RejectedError, match=message):
        wrench_of(messages.PX4_TYPES['VehicleTorqueSetpoint'], data)


@pytest.mark.nightly
def test_the_gains_of_normalized_torques(tmp_path, capsys):
    path = logged(tmp_path / 'log.ulg', Truth(), GAINS)
    out, arguments = tmp_path / 'out.json', [
        str(path), '--scene', scene_of(tmp_path / 'scene.yaml'), '--topic',
        'vehicle_torque_setpoint', '--measured', 'vehicle_attitude', '--measured',
        'vehicle_angular_velocity', '--json']
    assert main.attitude_identify([*arguments, str(out), '--estimate', 'start,torque_gains']) == 0
    estimates = json.loads(out.read_text())['estimates']
    for axis, gain in zip('xyz', GAINS):
        one = estimates[f'torque_gains.{axis}']
        assert abs(one['value'] - gain) < 4.0 * one['sigma']
    assert 'normalized' not in capsys.readouterr().err
    # Taken for N m, the torques determine no inertia.
    assert main.attitude_identify([*arguments, str(tmp_path / 'b.json')]) == 3
    assert f'{path}: the torques of PX4 are normalized, not in N m' in \
        capsys.readouterr().err


@pytest.mark.slow
def test_a_log_is_replayed_and_compared(tmp_path, capsys):
    path, fitted, motion = logged(tmp_path / 'log.ulg', Truth()), str(tmp_path / 'fitted.yaml'), \
        str(tmp_path / 'motion.mcap')
    topics = ['--topic', 'vehicle_torque_setpoint']
    measured = [*topics, '--measured', 'vehicle_attitude']
    guess = scene_of(tmp_path / 'guess.yaml', 1.2 * np.diag(np.diag(INERTIA)))
    assert main.attitude_identify([str(path), '--scene', guess, *measured, '-o', fitted]) == 0
    np.testing.assert_allclose(scene.load(fitted).body.inertia, INERTIA, atol=3e-4)
    assert main.attitude_replay([str(path), '--scene', fitted, *topics, '-o', motion, '--rate',
                                 '50']) == 0
    assert len(read_measured(motion, '/attitude')) == 1001
    for more in (['--check'], ['--motion', motion]):
        assert main.attitude_compare([str(path), '--scene', fitted, *measured, *more]) == 0
    vary = tmp_path / 'vary.yaml'
    vary.write_text('torque_gain: {normal: 0.03}')
    assert main.attitude_ensemble(['--scene', fitted, *topics, '--recording', str(path),
                                   '--vary', str(vary), '--runs', '1', '-o',
                                   str(tmp_path / 'runs')]) == 0
    assert capsys.readouterr().err.count('normalized') == 5
