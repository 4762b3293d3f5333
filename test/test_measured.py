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

"""Measured topics in recordings, and the command that compares them."""

from dataclasses import replace
from html import escape
import json
import re
import shutil

from bags import Sent
from conftest import at_night, EPOCH_NS, memory_limit, SECOND
from measurements import (
    messages_of,
    Quaternion,
    TFMessage,
    torque_messages,
    transform,
    truth,
    write,
    write_scene,
)
import numpy as np
from pages import array, data_of
import pytest
from rigid_body_ros import messages, recording
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.comparison import read_measured
from rigid_body_ros.comparison.comparison import compare_recording
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording import Reading
from rigid_body_ros.scene import load

BOTH, ATTITUDES = ('Imu', 'Odometry'), (
    'QuaternionStamped', 'PoseStamped', 'PoseWithCovarianceStamped', 'TransformStamped',
    'TFMessage')
KNOWN = np.diag([1e-6, 4e-6, 9e-6])


@pytest.fixture(scope='module')
def measured():
    return truth().measured(1e-3, 2e-3)


@pytest.fixture(scope='module')
def scene(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp('scene') / 'scene.yaml', truth())


@pytest.fixture(scope='module')
def bag(tmp_path_factory, measured):
    """Return a recording of torques, an Imu and a gyro."""
    return write(tmp_path_factory.mktemp('bag') / 'flight.mcap', torque=torque_messages(truth()),
                 imu=messages_of('Imu', measured, KNOWN, KNOWN),
                 gyro=messages_of('Vector3Stamped', measured))


def only(path, kind, sensor, *covariances):
    return write(path / 'one.mcap', it=messages_of(kind, sensor, *covariances))


@pytest.mark.parametrize('kind', [*BOTH, *ATTITUDES, 'Vector3Stamped'])
def test_every_type_is_read(tmp_path, measured, kind):
    found = read_measured(only(tmp_path, kind, measured, KNOWN, KNOWN), '/it')
    np.testing.assert_array_equal(found.stamps_ns, measured.stamps_ns)
    if kind == 'Vector3Stamped':
        assert found.attitude is None
    else:
        np.testing.assert_allclose(found.attitude, measured.attitude, rtol=0, atol=1e-15)
    if kind in ATTITUDES:
        assert found.angular_velocity is None
    else:
        np.testing.assert_array_equal(found.angular_velocity, measured.angular_velocity)


@pytest.mark.parametrize('kind', BOTH)
def test_covariances_are_read_in_body_axes(tmp_path, measured, kind):
    found = read_measured(only(tmp_path, kind, measured, KNOWN, KNOWN), '/it')
    expected = np.broadcast_to(KNOWN, (2000, 3, 3))
    if kind == 'Odometry':  # its covariance of the pose is in space axes
        turn = so3.matrix(measured.attitude)
        expected = turn.transpose(0, 2, 1) @ KNOWN @ turn
    np.testing.assert_allclose(found.attitude_covariance, expected, rtol=0, atol=1e-18)
    np.testing.assert_array_equal(found.rate_covariance, np.broadcast_to(KNOWN, (2000, 3, 3)))
    found = read_measured(only(tmp_path, kind, measured), '/it')  # zeros are unknown
    assert (found.attitude_covariance, found.rate_covariance) == (None, None)
    assert found.attitude is not None


@pytest.mark.parametrize('value', [-1.0, 1e6])
def test_what_an_imu_does_not_measure_is_left_out(tmp_path, measured, value):
    unknown = np.diag([value, 0.0, 0.0])
    found = read_measured(only(tmp_path, 'Imu', measured, unknown, KNOWN), '/it')
    assert found.attitude is None
    assert found.angular_velocity is not None
    found = read_measured(only(tmp_path, 'Imu', measured, KNOWN, unknown), '/it')
    assert found.attitude is not None
    assert found.angular_velocity is None


def test_messages_without_a_possible_value_are_rejected(tmp_path, measured):
    bad = measured.rows(np.arange(100))
    bad.attitude[3], bad.attitude[4] = 0.0, np.nan
    bad.angular_velocity[7:10, 1] = np.inf, 1e300, -1.1e9
    found = read_measured(only(tmp_path, 'Imu', bad), '/it')
    assert (len(found), found.account.rejected) == (95, 5)
    bad.angular_velocity[:] = 1e300
    with pytest.raises(InputError, match='at least 4 messages with a finite .*, found 0 among 1'):
        read_measured(only(tmp_path, 'Vector3Stamped', bad), '/it')


@pytest.mark.parametrize(('name', 'value'), [
    ('attitude', 0.0), ('angular_velocity', np.inf), ('angular_velocity', 1e300)])
def test_a_quantity_that_is_never_usable_is_left_out_with_a_note(tmp_path, measured, name, value):
    bad = measured.rows(np.arange(100))
    getattr(bad, name)[:] = value
    found = read_measured(only(tmp_path, 'Imu', bad), '/it')
    assert getattr(found, name) is None
    assert found.account.notes == [
        f'the {name.replace("_", " ")} is not used: expected finite values, of a possible size, '
        'found none in 100 messages']


@pytest.mark.slow
def test_a_clock_that_jumps_ahead_is_named(run, tmp_path, measured):
    motion, sensor = truth(), measured.rows(slice(None, None, 10))
    times, stamps = motion.torque_times.copy(), sensor.stamps_ns.copy()
    for each in (times, stamps):
        each[len(each) // 2:] += 30 * SECOND
    path = write(tmp_path / 'jump.mcap',
                 torque=torque_messages(replace(motion, torque_times=times)),
                 imu=messages_of('Imu', replace(sensor, stamps_ns=stamps)))
    status, shown, error = run(path=path)
    assert (status, 'likely cause' in shown) == (0, False)
    assert error.startswith(
        f'attitude_compare: warning: {path}: torques: a torque acts for 30.05 s until the next '
        'one, from 9.95 s after the start')


INVALID = [np.diag([-1e-6, 1e-6, 1e-6]), np.full((3, 3), np.nan), np.diag([1e-6, np.nan, 1e-6]),
           [[1e-6, 1e300, 0.0], [1e300, 1e-6, 0.0], [0.0, 0.0, 1e-6]], np.full((3, 3), 1e-6),
           [[1e-6, 0.0, 0.0], [0.0, 1e-6, -2e-6], [0.0, -2e-6, 1e-6]]]


@pytest.mark.parametrize('covariance', INVALID)
def test_an_invalid_covariance_is_unknown(tmp_path, measured, covariance):
    for kind in (*BOTH, 'PoseWithCovarianceStamped'):
        found = read_measured(only(tmp_path, kind, measured.rows(np.arange(9)), covariance,
                                   covariance), '/it')
        assert len(found) == 9
        assert (found.attitude_covariance, found.rate_covariance) == (None, None)


def test_messages_out_of_order_are_sorted(tmp_path, measured):
    order = np.random.default_rng(1).permutation(50)
    sensor = measured.rows(np.append(order, [5, 6]))
    sensor.attitude[-2:] = [0.0, 0.0, 0.0, 1.0]
    found = read_measured(only(tmp_path, 'PoseStamped', sensor), '/it')
    np.testing.assert_array_equal(found.stamps_ns, measured.stamps_ns[:50])
    assert found.attitude[5:7].tolist() == [[0.0, 0.0, 0.0, 1.0]] * 2  # the last of equal stamps


@pytest.mark.slow
def test_frames_are_chosen_from_transforms_alone(run, tmp_path, measured):
    path = write(tmp_path / 'it.mcap', torque=torque_messages(truth()),
                 imu=messages_of('Imu', measured), tf=messages_of('TFMessage', measured))
    frames = '--frames', 'world', 'base_link'
    status, shown, error = run(*frames, '--measured', '/imu', path=path)
    assert (status, shown) == (2, '')
    assert '/imu: --frames: expected a topic of transforms or odometry, found sensor_msgs' in error
    assert run(*frames, '--measured', '/imu', '--measured', '/tf', path=path)[0] == 0
    assert 'transforms from' in run('--frames', 'world', 'x', '--measured', '/imu', '--measured',
                                    '/tf', path=path)[2]


def renamed(pairs, parent, child=''):
    """Change the frames of messages."""
    for stamp, message in pairs:
        message.header.frame_id = parent
        if hasattr(message, 'child_frame_id'):
            message.child_frame_id = child
        yield stamp, message


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'parent', 'child', 'warning'), [
    ('TransformStamped', 'world', 'b', "frames 'world' to 'base_link', found 'world' to 'b'"),
    ('Imu', 'b/imu', '', "frame_id 'base_link', found 'b/imu'"),
    ('PoseStamped', 'base_link', '', "frame_id 'world', found 'base_link'"),
    ('Odometry', '', '', '')])
def test_measurements_of_other_frames_are_a_warning(run, tmp_path, measured, kind, parent, child,
                                                    warning):
    sensor = measured.rows(np.arange(200))
    path = write(tmp_path / 'it.mcap', torque=torque_messages(truth()),
                 it=renamed(messages_of(kind, sensor), parent, child))
    status, _, error = run(path=path)
    assert status == 0
    assert error.count('\n') == bool(warning)
    if warning:
        assert error.startswith(f'attitude_compare: warning: {path}: /it: expected {warning}')


@pytest.mark.parametrize('kind', ['Odometry', 'TransformStamped'])
def test_two_bodies_in_one_topic_are_told_apart(tmp_path, measured, kind):
    sent = [*messages_of(kind, measured.rows(np.arange(40)))]
    [*renamed(sent[1::2], 'world', 'b')]
    path = write(tmp_path / 'it.mcap', it=sent)
    with pytest.raises(InputError, match="one pair of frames, found 'world' to 'base_link', "
                                         "'world' to 'b'; choose one with --frames"):
        read_measured(path)
    found = read_measured(path, frames=('world', 'b'))
    np.testing.assert_array_equal(found.stamps_ns, measured.stamps_ns[1:40:2])


@pytest.mark.parametrize('little_endian', [True, False])
def test_transforms_have_any_position_and_byte_order(little_endian):
    kind, names = messages.TRANSFORM, ['a', 'ab', 'abc', 'abcd', 'Flügel/機体']
    sent, raws = [], []
    for number in range(200):
        random = np.random.default_rng(number)
        parts = [transform(EPOCH_NS + number, Quaternion(*random.normal(size=4)), parent, child)
                 for parent, child in random.choice(names, (random.integers(0, 6), 2))]
        sent += [part for part in parts if (part.header.frame_id, part.child_frame_id)
                 == ('abc', 'Flügel/機体')]
        raws.append(Sent('/tf', TFMessage(parts), 0).cdr(little_endian))
    times = np.arange(200)
    raw = recording.bulk.Raw.from_bytes(raws, times, times)
    found, decoded = recording.bulk.decode_transforms(kind, raw, ('abc', 'Flügel/機体'))
    assert len(sent) > 10
    assert decoded.stamps_ns.tolist() == [
        part.header.stamp.sec * SECOND + part.header.stamp.nanosec for part in sent]
    rotations = [part.transform.rotation for part in sent]
    assert decoded.values[:, 3:].tolist() == [[q.x, q.y, q.z, q.w] for q in rotations]
    assert found.log_ns.tolist() == (decoded.stamps_ns - EPOCH_NS).tolist()
    for size in range(len(raws[-1])):  # cut anywhere: an error, but no crash
        cut = recording.bulk.Raw.from_bytes([raws[-1][:size]], times[:1], times[:1])
        with pytest.raises(recording.bulk.BadMessageError):
            recording.bulk.decode_transforms(kind, cut, ('abc', 'abc'))


@pytest.fixture
def run(capsys, bag, scene):
    """Return a function that runs the command and returns its exit status and outputs."""
    def call(*arguments, path=bag, scene=scene):
        status = main.attitude_compare([*map(str, (path, '--scene', scene, *arguments))])
        return status, *capsys.readouterr()
    return call


@pytest.fixture
def figures(run, tmp_path):
    """Return a function that runs the command, and returns its JSON file and its text."""
    def call(*arguments, **inputs):
        status, shown, _ = run(*arguments, '--json', tmp_path / 'it.json', **inputs)
        assert status == 0
        return json.loads((tmp_path / 'it.json').read_text()), shown
    return call


@pytest.mark.parametrize(('option', 'suffix'), [
    ('-o', '.mcap'), ('--json', '.json'), ('--plot', '.png'), ('--report', '.html')])
def test_an_input_is_never_an_output(run, tmp_path, bag, scene, option, suffix):
    for path in (bag, scene):
        before, link = path.read_bytes(), tmp_path / f'{path.stem}{suffix}'
        link.symlink_to(path)
        status, shown, error = run(option, link, '--overwrite')
        assert (status, shown) == (2, '')
        assert f'{link}: would overwrite the ' in error
        assert path.read_bytes() == before


@pytest.mark.slow
def test_the_command_writes_errors_a_plot_and_a_page_with_names_as_text(figures, tmp_path, bag):
    path = tmp_path / '<b>&.mcap'
    output, plot, report = (tmp_path / name for name in ('errors.mcap', 'p.png', 'page.html'))
    shutil.copy(bag, path)
    found, shown = figures('--report', report, '-o', output, '--plot', plot, '--horizon', 1,
                           path=path)
    assert 'likely cause' not in shown
    assert plot.read_bytes().startswith(b'\x89PNG')
    assert (found['recording'], found['measured']) == ('<b>&.mcap', ['/imu'])
    assert (found['samples'], found['span_s']) == (2000, pytest.approx(19.99))
    assert found['attitude_error_rad']['rms'] == pytest.approx(3 ** 0.5 * 1e-3, rel=0.05)
    assert found['rate_error_rad_s']['rms'] == pytest.approx(3 ** 0.5 * 2e-3, rel=0.05)
    assert [(each['seconds'], each['windows']) for each in found['horizons']] == [(1, 19)]
    assert found['residual_torque_N_m']['rms'] < 1e-3
    for name, noise in (('rotation_vector', 1e-3), ('angular_velocity', 2e-3)):
        vectors = recording.read(output, f'/error/{name}', messages.VECTOR3)
        assert (len(vectors), {*vectors.names}) == (2000, {'base_link'})
        assert np.sqrt(np.mean(vectors.values ** 2)) == pytest.approx(noise, rel=0.05)
    torques = recording.read(output, '/residual_torque')
    assert not torques.values[:, :3].any()
    assert np.abs(torques.values[:, 3:]).max() < 2e-3
    written = shown.splitlines()[-1]
    assert all(str(each) in written for each in (output, plot, report, tmp_path / 'it.json'))
    text = report.read_text(encoding='utf-8')
    assert '<b>' not in text
    assert '<p class="source">&lt;b&gt;&amp;.mcap: /imu</p>' in text
    assert re.search(r'<h1>Explained: no test rejects the model; attitude error \S+ rad '
                     r'\(rms\) over 20 s</h1>', text)
    assert str(tmp_path) not in text
    for line in shown.splitlines()[1:-1]:
        assert f'<dd>{escape(line[17:])}</dd>' in text
    data = data_of(text)
    assert [panel['label'] for panel in data['panels']] == [
        '/imu: attitude quaternion, body axes',
        '/imu: attitude error, measured minus computed, body axes',
        '/imu: angular velocity, body axes',
        '/imu: rate error, measured minus computed, body axes', 'torque, body axes',
        'residual torque, body axes, averaged over 0.26 s',
        'residual torque, space axes, averaged over 0.26 s',
        'amplitude of the residual torque, body axes', 'attitude error after a restart']
    errors, band = data['panels'][1]['curves']
    drawn = array(errors['low'], '<f4').reshape(3, -1)
    assert drawn.shape[1] == 2000
    assert np.sqrt(np.mean(drawn ** 2)) == pytest.approx(1e-3, rel=0.05)
    assert array(band['high'], '<f4') == pytest.approx(2e-3, rel=0.1)
    assert len(array(data['body']['ghost']['times'])) == 2000
    angles = data['panels'][-1]['texts'][0]
    assert [text.split(' rad ')[1] for text in angles] == ['1 s after a restart, in 19 windows']
    assert len(array(data['body']['times'])) == 2000


@pytest.mark.slow
def test_the_command_aligns_one_sensor_and_checks_it(run, figures, tmp_path):
    late = truth().measured(1e-3, 2e-3, clock=0.035, seed=1)
    path = write(tmp_path / 'flight.mcap', torque=torque_messages(truth()),
                 pose=messages_of('PoseStamped', truth().measured(1e-3, 2e-3)),
                 odom=messages_of('Odometry', late))
    found, shown = figures('--measured', '/pose', '--measured', '/odom', '--check', '--align',
                           'clock@/odom', path=path)
    assert 'added to the measured stamps of /odom' in shown
    assert found['verdict']['level'] == 'explained'
    offsets = {topic: one['clock_offset_s'] for topic, one in found['alignments'].items()}
    assert offsets == {'/pose': 0.0, '/odom': pytest.approx(0.035, abs=1e-3)}
    assert (found['alignment']['clock_offset_s'], found['predictable_s']) == (0.0, None)
    assert [one['seconds'] for one in found['horizons']] == [0.1, 1.0, 10.0]
    for wrong in ('start@/odom', 'clock,colour'):
        with pytest.raises(SystemExit, match='2'):
            run('--align', wrong, path=path)


@pytest.mark.slow
def test_only_a_part_is_compared_and_the_torque_before_it_still_acts(figures, tmp_path):
    motion, row = truth(), 503  # 20 ms before the next torque
    path = write(tmp_path / 'flight.mcap', torque=torque_messages(motion),
                 imu=messages_of('Imu', motion.measured()))
    part = write_scene(tmp_path / 'part.yaml', replace(
        motion, rates_at_start=motion.rates[row], turn=motion.attitude[row]))
    found, _ = figures('--from', '5.03', '--until', '12', '--horizon', 1, path=path, scene=part)
    assert (found['samples'], found['left_out']) == (698, 2000 - 698)
    assert found['span_s'] == pytest.approx(6.97)
    assert found['attitude_error_rad']['max'] < 1e-9


@pytest.mark.slow
def test_a_part_without_torques_begins_and_ends_at_its_times(figures, tmp_path, measured):
    path = write(tmp_path / 'free.mcap', imu=messages_of('Imu', measured))
    found, shown = figures('--from', '2', '--until', '3', path=path)
    assert 'none in the recording: the body is free' in shown
    assert found['samples'] == 101


def of_first_seconds(tmp_path, clock):
    """Compare the first ten seconds on the clock of the torques, and fit that of the sensor."""
    path = write(tmp_path / 'late.mcap', torque=torque_messages(truth()),
                 imu=messages_of('Imu', truth().measured(clock=clock)))
    scene = load(write_scene(tmp_path / 'scene.yaml', truth()))
    return compare_recording(path, scene, Reading(until=10.0), align=['clock'], horizons=[])


@pytest.mark.slow
@pytest.mark.parametrize('clock', [-0.5, *at_night(0.5, 4.0)])
def test_the_end_of_a_part_is_on_the_clock_of_the_torques(tmp_path, clock):
    found = of_first_seconds(tmp_path, clock)
    assert found.alignment.clock_offset_s == pytest.approx(clock, abs=1e-6)
    assert (found.samples, found.left_out) == (1001, 999)
    assert found.as_dict()['attitude_error_rad']['max'] < 1e-5


@pytest.mark.slow
def test_measurements_after_the_end_only_are_rejected(tmp_path):
    with pytest.raises(InputError, match='late.mcap: /imu: expected measurements before the end '
                                         r'of the motion \(--until or the next epoch\), which is '
                                         'at .* ns on their clock, found them from'):
        of_first_seconds(tmp_path, -15.0)


@pytest.mark.parametrize(('arguments', 'message'), [
    (('--from', '3', '--until', '2.5'), '--until: expected more than --from, 3 s, found 2.5 s'),
    (('--from', '21'), 'flight.mcap: /imu: expected measurements during the motion, from '
     f'{EPOCH_NS + 21 * SECOND} ns to the last torque or the end at '),
    (('--until', '1', '--motion', 'motion.mcap'), '--until: expected a motion that is computed'),
    (('--horizon', '1e-9'), '/imu: expected a horizon of at least 0.01 s, the time between two '
     'samples, found 1e-09 s'),
    (('--motion', 'BAG', '--horizon', '1'),
     'expected a model that can restart, found a recorded motion'),
    (('--until', '0.06', '--check'), '--check: expected at least 10 samples'),
    (('--motion', 'BAG', '--check'), '--check: expected a motion that is computed'),
    (('--align', 'mount@/gps'), 'align: mount@/gps: expected a topic among /imu'),
    (('--measured', '/mocap'), 'expected a topic /mocap, found /torque (geometry_msgs/msg/'),
    (('--measured', '/torque'), '/torque: expected geometry_msgs/msg/QuaternionStamped or'),
    (('--measured', '/imu'), '--measured: expected each topic once')])
def test_what_cannot_be_compared_is_one_line(bag, scene, refusal, arguments, message):
    measured = [] if arguments[1] in ('/mocap', '/torque') else ['--measured', '/imu']
    arguments = [bag if one == 'BAG' else one for one in arguments]
    with memory_limit(100e6):
        line = refusal('attitude_compare', bag, '--scene', scene, *measured, *arguments)
    assert message in line


@pytest.mark.slow
@pytest.mark.parametrize('name', ['motion.mcap', 'motion.csv'])
def test_a_recorded_motion_is_compared(figures, tmp_path, bag, scene, name):
    motion = tmp_path / name
    assert main.attitude_replay([str(bag), '--scene', str(scene), '--topic', '/torque', '-o',
                                str(motion), '--rate', '200', '--until', '20']) == 0
    found, _ = figures('--motion', motion)
    assert found['attitude_error_rad']['rms'] == pytest.approx(3 ** 0.5 * 1e-3, rel=0.05)
    assert found['residual_torque_N_m']['rms'] is None


@pytest.mark.slow
@pytest.mark.parametrize(('count', 'shift_ns', 'others', 'message'), [
    (3, 0, (), '/pose: expected at least 4 messages with a finite attitude'),
    (9, 1000 * SECOND, (), '/pose: expected measurements during the motion'),
    (9, None, (), 'expected stamps in the headers, found 0 in 9 of 9 messages; use --time-source '
     'log'),
    (9, 0, ('imu',), 'found /pose (geometry_msgs/msg/PoseStamped), /imu (sensor_msgs/msg/Imu); '
     'choose one with --measured')])
def test_a_bad_recording_is_one_line(refusal, tmp_path, measured, scene, count, shift_ns, others,
                                     message):
    few = measured.rows(np.arange(count))
    stamps_ns = np.zeros(count, int) if shift_ns is None else few.stamps_ns + shift_ns
    path = write(tmp_path / 'bad.mcap', torque=torque_messages(truth()),
                 pose=messages_of('PoseStamped', replace(few, stamps_ns=stamps_ns)),
                 **{name: messages_of('Imu', measured) for name in others})
    assert message in refusal('attitude_compare', path, '--scene', scene)
