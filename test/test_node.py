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

"""attitude_node over DDS, in a process where the process matters: live is replay, and outputs."""

import signal
import time

from conftest import at_night, RECORDINGS, SECOND
from live import check_late, decoded, finished, options, Session, stamps_of, TUMBLER, tumbler
from live_session import ACCEPTED, ATTITUDE, COMMITTED, LiveSession, RELIABLE
import numpy as np
import pytest
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import DescribeParameters
from rclpy.parameter import Parameter
from rigid_body_ros import messages, recording, RigidBody, scene
from rigid_body_ros.mechanics import euler
from rigid_body_ros.node import AttitudeNode
from rigid_body_ros.replay.verify import verify
from robots import converted, ROBOT, wrenches
from sensor_msgs.msg import Imu
import yaml

pytestmark = pytest.mark.ros


def test_live_is_replay_bit_for_bit_though_torques_come_late_and_out_of_order(tmp_path, domain):
    with LiveSession(TUMBLER, domain, *RELIABLE, *options(
            'history:=60.0 max_future:=59.9')) as live:
        check_late(tmp_path, live, 400, rate=200)


def test_what_is_published_between_stamps_is_the_motion_at_those_times(domain):
    torques = recording.read(RECORDINGS / 'tumbler.mcap')
    start_ns, count = int(torques.stamps_ns[0]), 501
    # The clock waits until every torque has arrived, so that no prediction lacks one.
    with Session(TUMBLER, domain, *RELIABLE, *options(
            f'use_sim_time:=true start_time:={start_ns} max_future:=11.0 history:=12.0')) as live:
        live.start_clock(start_ns)
        for stamp_ns, values in zip(torques.stamps_ns[:count].tolist(), torques.values):
            live.publish(stamp_ns, 'base_link', values[3:])
        live.hold_clock(start_ns, lambda: len(live.torques) == count, 'all torques')
        live.run_clock(start_ns, start_ns + 4 * SECOND)
    published = decoded(live, ATTITUDE)
    motion = tumbler(torques.stamps_ns[:count], torques.values[:count, 3:], start_ns).propagate(
        at=stamps_of(live, ATTITUDE))
    assert len(published) > 100
    assert {message.frame_id for message in published} == {'world'}
    np.testing.assert_array_equal([message.values for message in published], motion.attitude)


def test_parameters_have_descriptions_and_keep_the_scene(domain):
    with Session(TUMBLER, domain, *options(
            'initial_attitude.w:=-1 tolerance:=1e-9 initial_angular_velocity.y:=2 '
            'qos_overrides./attitude.publisher.depth:=3')) as live:
        # Integers and plain exponents are numbers.
        first = decoded(live, COMMITTED)[0].values
        assert first[messages.ORIENTATION].tolist() == [0.0, 0.0, 0.0, -1.0]
        assert first[messages.ANGULAR_VELOCITY].tolist() == [0.15, 2.0, -0.10]
        # An override of one topic leaves the others alone.
        depths = live.parameters(*(f'qos_overrides./{topic}.publisher.depth' for topic in (
            'attitude', 'euler_angles', 'angular_velocity')))
        assert depths == [3, 10, 10]
        descriptors = live.call(DescribeParameters, 'describe_parameters',
                                names=list(scene.PARAMETERS)).descriptors
        for descriptor in descriptors:
            parameter = scene.PARAMETERS[descriptor.name]
            assert descriptor.description.startswith(parameter.description)
            limits = descriptor.floating_point_range or descriptor.integer_range
            assert bool(limits) == bool(parameter.interval)
            assert descriptor.read_only == (descriptor.name != 'publish_rate')
        changes = {'inertia.ixx': 0.05, 'solver': 'taylor', 'start_time': 5, 'publish_rate': 1e9,
                   'use_sim_time': True, 'qos_overrides./torque.subscription.depth': 5}
        for name, value in changes.items():
            result = live.set_parameter(name, value)
            assert not result.successful
            assert name in result.reason
        # A change from a long to a short period takes effect at once, not after the long period.
        for value in (0.001, 20):
            assert live.set_parameter('publish_rate', value).successful
        count = len(live.received[ATTITUDE])
        live.wait_until(lambda: len(live.received[ATTITUDE]) > count + 10, 'the new rate')
        rate, = live.parameters('publish_rate')
        assert type(rate) is float
        events = []
        live.node.create_subscription(
            ParameterEvent, '/parameter_events',
            lambda event: events.append([value.name for value in event.changed_parameters]), 10)
        live.synchronize()
        assert live.reset().success
        live.wait_until(lambda: events, 'an event')
        live.synchronize()
    start, = events  # the start of an epoch is one event
    assert sorted(start) == sorted(name for name in scene.PARAMETERS if name.startswith(
        ('initial_', 'start_time')))


@pytest.mark.nightly
def test_the_rate_may_change_while_running(domain):
    start_ns = 100 * SECOND
    with Session(TUMBLER, domain, '-p', 'use_sim_time:=true') as live:
        live.start_clock(start_ns)
        live.run_clock(start_ns, start_ns + 2 * SECOND)
        assert live.set_parameter('publish_rate', 10).successful
        changed = len(live.received[ATTITUDE])
        live.run_clock(start_ns + 2 * SECOND, start_ns + 7 * SECOND)
    stamps = stamps_of(live, ATTITUDE)
    # Periods follow the simulated clock, which moves in steps of 10 ms.
    assert np.median(np.diff(stamps[:changed])) == SECOND // 100
    assert np.median(np.diff(stamps[changed + 1:])) == SECOND // 10


def test_equal_stamps_and_torques_from_before_the_start(tmp_path, domain):
    with Session(TUMBLER, domain, *RELIABLE, '-p', 'history:=30.0') as live:
        start_ns = stamps_of(live, COMMITTED)[0]
        later_ns = start_ns + SECOND // 10
        for stamp_ns, torque in ((start_ns - SECOND, 0.03), (start_ns - 2 * SECOND, 0.09),
                                 (start_ns, 0.01), (later_ns, 0.05), (later_ns, 0.02)):
            live.publish(stamp_ns, 'base_link', [torque, 0.0, 0.0])
        live.wait_for_torques(5)
        run = finished(tmp_path, live)
    assert len(run.accepted.stamps_ns) == 5
    assert run.stamps_ns.tolist() == [start_ns, later_ns]


def test_all_outputs_of_one_instant_have_its_stamp_and_one_attitude(domain):
    kinds = {'attitude': messages.QUATERNION, 'euler_angles': messages.VECTOR3,
             'angular_velocity': messages.VECTOR3, 'imu/data': messages.IMU,
             'odometry': messages.ODOMETRY}
    with Session(TUMBLER, domain, '-p', 'euler_sequence:=zyx') as live:
        for topic, kind in kinds.items():
            live.record(topic, kind, 1000)
        live.wait_until(lambda: all(len(live.received[topic]) > 30 for topic in kinds), 'all')
    received = {topic: {message.stamp_ns: message for message in decoded(live, topic)}
                for topic in kinds}
    stamps = set.intersection(*(set(messages) for messages in received.values()))
    assert len(stamps) > 20
    for stamp_ns in stamps:
        attitude, angles, rates, imu, odometry = (received[topic][stamp_ns] for topic in kinds)
        np.testing.assert_array_equal(angles.values,
                                      euler.from_quaternion(attitude.values, 'zyx'))
        np.testing.assert_array_equal(imu.values[:4], attitude.values)
        np.testing.assert_array_equal(imu.values[13:16], rates.values)
        np.testing.assert_array_equal(odometry.values[messages.ORIENTATION], attitude.values)
        np.testing.assert_array_equal(odometry.values[messages.ANGULAR_VELOCITY], rates.values)
        assert [message.frame_id for message in (attitude, angles, rates, imu, odometry)] == [
            'world', 'world', 'base_link', 'base_link', 'world']
        assert odometry.child_frame_id == 'base_link'


def test_wrenches_of_links_act_live_as_in_a_replay(tmp_path, domain):
    parameters, sent = tmp_path / 'robot.yaml', wrenches(300)
    parameters.write_text(yaml.dump({'/**': {'ros__parameters': {
        'robot_description': ROBOT, 'initial_angular_velocity': {'y': 0.6}}}}))
    with Session(parameters, domain, *RELIABLE) as live:
        stamps = live.now_ns() + np.arange(300) * SECOND // 1000
        rows = [messages.WRENCH.encode(stamp, frame_id, values) for stamp, frame_id, values in
                zip(stamps.tolist(), sent.frame_ids, sent.values)]
        for number in np.random.default_rng(1).permutation(300):
            live.publish_bytes(rows[number])
        for frame_id, force in (('arm', 0.0), ('hand', 0.0), ('map', 0.0), ('mast', np.nan),
                                ('propeller', 1.0)):
            live.publish_bytes(messages.WRENCH.encode(
                int(stamps[-1]), frame_id, [force, 0.0, 0.0, 0.0, 0.0, 1.0]))
        live.wait_for_torques(305)
        counts, _, text = live.diagnosis('torques')
        run, words = finished(tmp_path, live), live.words()
    assert [counts[name] for name in ('applied', 'rejected: unknown frame',
                                      'rejected: not finite')] == [300, 4, 1]
    in_space = np.array(sent.frame_ids) == 'world'
    assert counts['force ignored'] == np.count_nonzero(sent.values[in_space, 0])
    assert 'force' not in text
    line, = (line for line in words.splitlines() if 'the force of a WrenchStamped is ignored, as '
             'it has no lever arm' in line)
    assert line.startswith('[INFO]')
    assert "frame 'arm': joint 'to_arm' (revolute) moves it relative to the body" in words \
        or "frame 'hand': joint 'to_arm' (revolute) moves it relative to the body" in words
    order = np.argsort(run.accepted.stamps_ns)
    assert run.accepted.values[order].tobytes() == converted(sent).values.tobytes()
    assert {*run.accepted.frame_ids} == {'base_link', 'world'}
    with recording.Writer(tmp_path / 'sent.mcap') as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for stamp, row in zip(stamps.tolist(), rows):
            writer.write('/torque', stamp, row)
    loaded = scene.load(tmp_path / 'live.yaml')
    np.testing.assert_array_equal(loaded.body.inertia, RigidBody.from_urdf(ROBOT).inertia)
    verified = verify(tmp_path / 'sent.mcap', loaded, tmp_path / 'live.mcap',
                      motion_topic=COMMITTED)
    assert len(verified.same) == 301
    assert verified.same.all()


def test_the_nodes_of_a_fleet_differ_in_diagnostics_and_frames(tmp_path, domain):
    frames = {}
    with Session(TUMBLER, domain, *RELIABLE, *options(
            'history:=60.0 frame_prefix:=one/')) as live:
        two = AttitudeNode('second', context=live.node.context, namespace='two',
                           parameter_overrides=[Parameter('frame_prefix', value='two/')])
        assert two.resolve_topic_name('torque') == '/two/torque'
        live._executor.add_node(two)
        for topic in ('/imu/data', '/two/imu/data'):
            live.node.create_subscription(Imu, topic, lambda imu, topic=topic: frames.update(
                {topic: imu.header.frame_id}), 10)

        def statuses():
            return {status.name: status.hardware_id for array in live.diagnostics
                    for status in array.status}
        live.wait_until(lambda: len(statuses()) >= 4 and len(frames) == 2, 'both nodes')
        assert statuses() == {f'{node}: {status}': node for status in ('torques', 'motion')
                              for node in ('/attitude_node', '/two/second')}
        assert frames == {'/imu/data': 'one/base_link', '/two/imu/data': 'two/base_link'}
        start_ns = live.now_ns()
        for number, frame_id in enumerate(('', 'one/base_link', 'world', 'base_link', 'two/world',
                                           'two/base_link')):
            live.publish(start_ns + number, frame_id, [0.01, 0.02, number * 0.01])
        live.wait_until(lambda: live.diagnosis('torques')[0]['received'] == 6, 'all torques')
        counts, _, _ = live.diagnosis('torques')
        assert counts['rejected: unknown frame'] == 3
        assert [torque.frame_id for torque in decoded(live, ACCEPTED)] == [
            'one/base_link', 'one/base_link', 'world']
        assert live.parameters('frame_prefix') == ['one/']
        run = finished(tmp_path, live)
        for _ in range(2):  # a second time changes nothing
            two.destroy_node()
    assert len(run.stamps_ns) == 4


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
# Both `ros2 launch` and the terminal send the signal.
@pytest.mark.parametrize('count', [1, *at_night(1000)])
def test_signals_end_it_cleanly(domain, number, count):
    with LiveSession(TUMBLER, domain) as live:
        for _ in range(count):
            live.process.send_signal(number)
            time.sleep(0.01)
            if live.process.poll() is not None:
                break
        assert live.process.wait(timeout=10) == 0
        words = live.words()
        assert 'Traceback' not in words
        assert 'rror' not in words


def test_a_recorder_that_starts_later_gets_the_log_from_its_marker_on(domain):
    with Session(TUMBLER, domain, *RELIABLE) as live:
        sent = [live.now_ns() - number for number in range(41, 0, -1)]
        for stamp_ns in sent[:-1]:
            live.publish(stamp_ns, '', [1e-3, 0.0, 0.0])
        live.wait_until(lambda: len(live.torques) == 40, 'all torques')
        live.record(ACCEPTED, messages.WRENCH)
        received = live.received[ACCEPTED]
        live.wait_until(lambda: len(received) == 41, 'the log')
        live.publish(sent[-1], '', [1e-3, 0.0, 0.0])
        live.wait_until(lambda: len(received) == 42, 'the next torque')
    assert messages.is_epoch_marker(messages.WRENCH.decode(received[0]).frame_id)
    assert stamps_of(live, ACCEPTED) == sent


def test_torques_sent_before_the_node_started_are_reported(domain):
    with Session(TUMBLER, domain, *RELIABLE) as live:
        for _ in range(3):
            live.publish(live.now_ns(), '', [1e-3, 0.0, 0.0])
        live.wait_for_torques(3)
        live.restart()
        live.wait_until(lambda: live.torque_subscriptions == 1, 'the subscription')
        live.diagnostics.clear()
        live.publish(live.now_ns(), '', [1e-3, 0.0, 0.0])
        live.wait_until(lambda: 'torque: the first torque received from a publisher is its number '
                        '4; the earlier ones were not received' in live.words(), 'a report')
        assert live.diagnosis('torques')[0]['lost'] == 0
