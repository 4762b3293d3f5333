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

"""attitude_node as a real process over real DDS."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import time

from conftest import at_night, RECORDINGS, ROOT, SECOND
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
from live import (
    commit,
    decoded,
    get_parameters,
    late_torques,
    PATIENT,
    publish_when_due,
    replayed,
    run_clock,
    set_parameter,
    spin_until,
    TUMBLER,
)
from live_session import ATTITUDE, COMMITTED, LiveSession, RELIABLE
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rcl_interfaces.srv import DescribeParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rigid_body_ros import messages, propagate, recording, RigidBody, scene, State, TorqueLog
from rigid_body_ros.mechanics import euler
from rigid_body_ros.node import AttitudeNode
from rigid_body_ros.replay.verify import verify
from robots import converted, ROBOT, wrenches
from sensor_msgs.msg import Imu
import yaml

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('timeout', [0.0, *at_night(0.02)])
def test_live_is_replay_bit_for_bit_though_torques_come_late_and_out_of_order(
        tmp_path, domain, timeout):
    with LiveSession(TUMBLER, domain, *RELIABLE, *PATIENT,
                     '-p', f'torque_timeout:={timeout}') as live:
        torques = late_torques(live.now_ns(), 800, rate=200)
        publish_when_due(live, torques)
        live.wait_until(lambda: len(live.torques) == len(torques), 'all torques')
        stamps = np.unique([torque.stamp_ns for torque in torques])
        commit(live, 1 + len(stamps))
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        run = replayed(tmp_path, live)
    *accepted, _ = run.accepted.stamps_ns
    assert sorted(accepted) == sorted(torque.stamp_ns for torque in torques)
    assert np.any(np.diff(accepted) < 0)  # they did come out of order
    np.testing.assert_array_equal(run.stamps_ns[1:1 + len(stamps)], stamps)
    np.testing.assert_array_equal(run.committed, run.replay)
    # The start state comes first, at the time in the dumped parameters.
    assert run.stamps_ns[0] == scene.load(tmp_path / 'live.yaml').start.time_ns


def test_what_is_published_between_stamps_is_the_motion_at_those_times(domain):
    torques = recording.read(RECORDINGS / 'tumbler.mcap')
    start_ns, count = int(torques.stamps_ns[0]), 501
    # The clock waits until every torque has arrived, so that no prediction lacks one.
    with LiveSession(TUMBLER, domain, *RELIABLE, '-p', 'use_sim_time:=true',
                     '-p', f'start_time:={start_ns}', '-p', 'max_future:=11.0',
                     '-p', 'history:=12.0') as live:
        run_clock(live, start_ns, until=lambda: live.received[COMMITTED])
        for row in range(count):
            live.publish(int(torques.stamps_ns[row]), 'base_link', torques.values[row, 3:])
        run_clock(live, start_ns, until=lambda: len(live.torques) == count)
        run_clock(live, start_ns, seconds=10)
        assert live.stop() == 0
    scene_ = scene.load(TUMBLER)
    start = State(start_ns, scene_.start.attitude, scene_.start.angular_velocity)
    log = TorqueLog(torques.stamps_ns[:count], torques.values[:count, 3:])
    published = decoded(live, ATTITUDE, messages.QUATERNION)
    motion = propagate(scene_.body, start, log, at=[message.stamp_ns for message in published])
    assert len(published) > 100
    assert {message.frame_id for message in published} == {'world'}
    np.testing.assert_array_equal([message.values for message in published], motion.attitude)


def test_parameters_have_descriptions_and_keep_the_scene(domain):
    with LiveSession(TUMBLER, domain) as live:
        names = list(scene.PARAMETERS)
        descriptors = live.call(DescribeParameters, 'describe_parameters',
                                names=names).descriptors
        for descriptor in descriptors:
            parameter = scene.PARAMETERS[descriptor.name]
            assert descriptor.description.startswith(parameter.description)
            limits = descriptor.floating_point_range or descriptor.integer_range
            assert bool(limits) == bool(parameter.interval)
            assert descriptor.read_only == (descriptor.name != 'publish_rate')
        changes = {'inertia.ixx': 0.05, 'solver': 'taylor', 'start_time': 5, 'publish_rate': 1e9,
                   'use_sim_time': True, 'qos_overrides./torque.subscription.depth': 5}
        for name, value in changes.items():
            result = set_parameter(live, name, value)
            assert not result.successful
            assert name in result.reason
        result = set_parameter(live, 'publish_rate', 20)
        assert result.successful, result.reason
        # A change from a long to a short period takes effect at once, not after the long period.
        for value in (0.001, 20):
            assert set_parameter(live, 'publish_rate', value).successful
        count = len(live.received[ATTITUDE])
        live.wait_until(lambda: len(live.received[ATTITUDE]) > count + 10, 'the new rate')
        rate, = get_parameters(live, 'publish_rate')
        assert rate.type == ParameterType.PARAMETER_DOUBLE


@pytest.mark.nightly
def test_the_start_of_an_epoch_is_one_parameter_event(domain):
    with LiveSession(TUMBLER, domain) as live:
        events = []
        live.node.create_subscription(
            ParameterEvent, '/parameter_events',
            lambda event: events.append([value.name for value in event.changed_parameters]), 10)
        live.spin(0.5)
        assert live.reset().success
        live.wait_until(lambda: events, 'an event')
        live.spin(0.3)
    start, = events
    assert sorted(start) == sorted(name for name in scene.PARAMETERS if name.startswith(
        ('initial_', 'start_time')))


@pytest.mark.nightly
def test_the_rate_may_change_while_running(domain):
    start_ns = 100 * SECOND
    with LiveSession(TUMBLER, domain, '-p', 'use_sim_time:=true') as live:
        run_clock(live, start_ns, seconds=2)
        assert set_parameter(live, 'publish_rate', 10).successful
        changed = len(live.received[ATTITUDE])
        run_clock(live, start_ns + 2 * SECOND, seconds=5)
        assert live.stop() == 0
    stamps = [message.stamp_ns for message in decoded(live, ATTITUDE, messages.QUATERNION)]
    # Periods follow the simulated clock, which moves in steps of 10 ms.
    assert np.median(np.diff(stamps[:changed])) == SECOND // 100
    assert np.median(np.diff(stamps[changed + 1:])) == SECOND // 10


def test_equal_stamps_and_torques_from_before_the_start(tmp_path, domain):
    with LiveSession(TUMBLER, domain, *RELIABLE, '-p', 'history:=30.0') as live:
        start_ns = decoded(live, COMMITTED, messages.ODOMETRY)[0].stamp_ns
        later_ns = start_ns + SECOND // 10
        for stamp_ns, torque in ((start_ns - SECOND, 0.03), (start_ns - 2 * SECOND, 0.09),
                                 (start_ns, 0.01), (later_ns, 0.05), (later_ns, 0.02)):
            live.publish(stamp_ns, 'base_link', [torque, 0.0, 0.0])
        live.wait_for_torques(5)
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        run = replayed(tmp_path, live)
    assert len(run.accepted.stamps_ns) == 5
    assert run.stamps_ns.tolist() == [start_ns, later_ns]
    np.testing.assert_array_equal(run.committed, run.replay)


@pytest.mark.nightly
def test_an_override_of_one_topic_leaves_the_others_alone(domain):
    with LiveSession(TUMBLER, domain,
                     '-p', 'qos_overrides./attitude.publisher.depth:=3') as live:
        names = [f'qos_overrides./{topic}.publisher.depth'
                 for topic in ('attitude', 'euler_angles', 'angular_velocity')]
        values = get_parameters(live, *names)
        assert [value.integer_value for value in values] == [3, 10, 10]


def test_all_outputs_of_one_instant_have_its_stamp_and_one_attitude(domain):
    kinds = {'attitude': (QuaternionStamped, messages.QUATERNION),
             'euler_angles': (Vector3Stamped, messages.VECTOR3),
             'angular_velocity': (Vector3Stamped, messages.VECTOR3),
             'imu/data': (Imu, messages.IMU), 'odometry': (Odometry, messages.ODOMETRY)}
    with LiveSession(TUMBLER, domain, '-p', 'euler_sequence:=zyx') as live:
        received = {topic: {} for topic in kinds}
        for topic, (kind, code) in kinds.items():
            def hear(data, topic=topic, code=code):
                message = code.decode(data)
                received[topic][message.stamp_ns] = message
            live.node.create_subscription(kind, topic, hear, 1000, raw=True)
        live.wait_until(lambda: all(len(messages) > 30 for messages in received.values()), 'all')
        assert live.stop() == 0
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


def test_the_inertia_comes_from_the_robot_description(tmp_path, domain):
    robot = """<robot name="r"><link name="base_link"><inertial><mass value="2"/>
      <origin xyz="0.1 0 0" rpy="0.3 -0.2 1.0"/>
      <inertia ixx="0.05" iyy="0.12" izz="0.14" ixy="0.002" ixz="0" iyz="0"/>
      </inertial></link></robot>"""
    parameters = tmp_path / 'robot.yaml'
    parameters.write_text(yaml.dump({'/**': {'ros__parameters': {
        'robot_description': robot, 'link': 'base_link',
        'initial_angular_velocity': {'y': 0.6}}}}))
    tensor = RigidBody.from_urdf(robot).inertia
    with LiveSession(parameters, domain, *RELIABLE) as live:
        value, = get_parameters(live, 'inertia.ixy')
        assert value.double_value == tensor[0, 1]
        for number in range(5):
            live.publish(live.now_ns(), '', [0.01, 0.0, 1e-3 * number])
            live.spin(0.05)
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        run = replayed(tmp_path, live)
    np.testing.assert_array_equal(run.committed, run.replay)
    np.testing.assert_array_equal(scene.load(tmp_path / 'live.yaml').body.inertia, tensor)


def test_wrenches_of_links_act_live_as_in_a_replay(tmp_path, domain):
    parameters, sent = tmp_path / 'robot.yaml', wrenches(300)
    parameters.write_text(yaml.dump({'/**': {'ros__parameters': {
        'robot_description': ROBOT, 'initial_angular_velocity': {'y': 0.6}}}}))
    with LiveSession(parameters, domain, *RELIABLE) as live:
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
        counts, _, _ = live.diagnosis('torques')
        live.dump_parameters(tmp_path / 'live.yaml')
        words = live.end()
        run = replayed(tmp_path, live)
    assert [counts[name] for name in ('applied', 'rejected: unknown frame',
                                      'rejected: not finite')] == [300, 4, 1]
    in_space = np.array(sent.frame_ids) == 'world'
    assert counts['force ignored'] == np.count_nonzero(sent.values[in_space, 0])
    assert "frame 'arm': joint 'to_arm' (revolute) moves it relative to the body" in words \
        or "frame 'hand': joint 'to_arm' (revolute) moves it relative to the body" in words
    np.testing.assert_array_equal(run.committed, run.replay)
    order = np.argsort(run.accepted.stamps_ns)
    assert run.accepted.values[order].tobytes() == converted(sent).values.tobytes()
    assert {*run.accepted.frame_ids} == {'base_link', 'world'}
    with recording.Writer(tmp_path / 'sent.mcap') as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for stamp, row in zip(stamps.tolist(), rows):
            writer.write('/torque', stamp, row)
    loaded = scene.load(tmp_path / 'live.yaml')
    verified = verify(tmp_path / 'sent.mcap', loaded, tmp_path / 'live.mcap',
                      motion_topic=COMMITTED)
    assert len(verified.same) == 301
    assert verified.same.all()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
# Both `ros2 launch` and the terminal send the signal.
@pytest.mark.parametrize('count', [1, *at_night(1000)])
def test_signals_end_it_cleanly(domain, number, count):
    with LiveSession(TUMBLER, domain) as live:
        live.spin(0.3)
        for _ in range(count):
            live.process.send_signal(number)
            time.sleep(0.01)
            if live.process.poll() is not None:
                break
        assert live.process.wait(timeout=10) == 0
        words = live.words()
        assert 'Traceback' not in words
        assert 'rror' not in words


def run_node(domain, *arguments):
    """Run the node with arguments with which it ends at once."""
    command = LiveSession(TUMBLER, domain)
    return subprocess.run([*command.command[:3], *arguments], env=command.environment,
                          capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize(('arguments', 'message'), [
    (('-p', 'inertia.ixx:=1'), 'inertia.iyy: expected a number (kg m^2), found none'),
    (('-p', 'inertia.ixx:=1', '-p', 'inertia.iyy:=1', '-p', 'inertia.izz:=5'),
     'not physical, principal moments 1, 1, 5 kg m^2'),
    (('--params-file', str(TUMBLER), '-p', 'intertia.ixx:=1.0'),
     'intertia.ixx: unknown key; did you mean inertia.ixx?'),
    (('--params-file', str(TUMBLER), '-p', 'tolerance:=tight'),
     "tolerance: expected a number, found 'tight'"),
    (('--params-file', str(TUMBLER), '-p', 'qos_overrides./torqe.subscription.depth:=5'),
     'qos_overrides./torqe.subscription.depth: not a topic, endpoint or policy of this node; '
     'did you mean qos_overrides./torque.subscription.depth?'),
    (('--params-file', 'none.yaml'), 'none.yaml'),
    *at_night(
        (('--params-file', str(TUMBLER), '-p', 'solver:=exact'),
         "solver: 'exact' handles torque-free motion only"),
        (('--params-file', str(TUMBLER), '-p', 'interpolation:=cubic'),
         "interpolation: expected 'hold', because a node does not know the next torque, "
         "found 'cubic'"),
        (('--params-file', str(TUMBLER), '-p', 'qos_overrides./torque.subscription.history:=all'),
         'history'),
        (('--params-file', str(TUMBLER), '-p', 'mode:=lockstep', '-p', 'time_source:=arrival'),
         "time_source: expected 'header', because lockstep replies to stamps, found 'arrival'"),
        (('--params-file', str(TUMBLER), '-p', 'publish_clock:=true'),
         "publish_clock: expected mode 'lockstep', in which the torques set the time, found "
         "'realtime'"),
        (('--params-file', str(TUMBLER), '-p', 'publish_clock:=1'),
         'publish_clock: expected true or false, found 1'),
        (('--params-file', str(TUMBLER), '-p', 'mode:=lockstep', '-p', 'publish_clock:=true',
          '-p', 'use_sim_time:=true'), 'publish_clock: expected use_sim_time false'),
        (('--params-file', str(TUMBLER), '-p', 'robot_description:=<robot>'),
         'robot_description: URDF: expected XML'),
        (('--params-file', str(TUMBLER), '-p', 'link:=base_link'),
         "link: expected an empty text, because robot_description is empty, found 'base_link'"))])
def test_a_mistake_is_reported_in_one_line(domain, arguments, message):
    result = run_node(domain, '--ros-args', *arguments)
    lines = [line for line in result.stderr.splitlines() if not line.startswith('[')]
    assert result.returncode == 2
    assert len(lines) == 1
    assert lines[0].startswith('attitude_node: error: ')
    assert message in lines[0]


def test_a_transform_needs_its_message(domain):
    if importlib.util.find_spec('tf2_msgs'):
        pytest.skip('tf2_msgs is installed')
    result = run_node(domain, '--ros-args', '--params-file', str(TUMBLER),
                      '-p', 'publish_tf:=true')
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1] == (
        'attitude_node: error: publish_tf: needs the package tf2_msgs, which is not installed')


def test_unknown_arguments_print_the_usage(domain):
    result = run_node(domain, '--rate', '5')
    assert result.returncode == 2
    assert 'unrecognized arguments: --rate 5' in result.stderr


def test_integers_and_plain_exponents_are_numbers(domain):
    with LiveSession(TUMBLER, domain, '-p', 'initial_attitude.w:=-1', '-p', 'tolerance:=1e-9',
                     '-p', 'initial_angular_velocity.y:=2') as live:
        first = decoded(live, COMMITTED, messages.ODOMETRY)[0].values
        assert first[messages.ORIENTATION].tolist() == [0.0, 0.0, 0.0, -1.0]
        assert first[messages.ANGULAR_VELOCITY].tolist() == [0.15, 2.0, -0.10]


@pytest.fixture
def root(tmp_path):
    """Return a copy of what the demo needs, because it writes to the folder of the repository."""
    shutil.copytree(ROOT / 'examples', tmp_path / 'examples')
    for name in ('config', 'test'):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def test_the_demo_runs(root, domain):
    result = subprocess.run([sys.executable, 'examples/demo.py'], cwd=root,
                            env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
                            capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert 'Live and replay agree bit for bit at 3001 of 3001 stamps.' in result.stdout
    assert 'open demo/report.html in a browser' in result.stdout
    assert 'attitude_replay' in (root / 'demo' / 'report.html').read_text(encoding='utf-8')


def test_an_interrupted_demo_says_so_in_one_line(root, domain):
    process = subprocess.Popen([sys.executable, 'examples/demo.py'], cwd=root,
                               env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               start_new_session=True)
    try:
        if not any(line.startswith('The node is up.') for line in process.stdout):
            raise RuntimeError(process.stderr.read())
        os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (errors, process.returncode) == ('demo: interrupted\n', 130)


def test_a_recorder_that_starts_later_gets_the_log_from_its_marker_on(context):
    node = AttitudeNode(context=context, parameter_overrides=[
        *(Parameter(f'inertia.{name}', value=1.0) for name in ('ixx', 'iyy', 'izz')),
        Parameter('qos_overrides./torque.subscription.reliability', value='reliable')])
    other, received = Node('other', context=context), []
    executor = SingleThreadedExecutor(context=context)
    for each in (node, other):
        executor.add_node(each)
    publisher = other.create_publisher(WrenchStamped, 'torque', 100)
    spin_until(executor, publisher.get_subscription_count)
    sent = [node.get_clock().now().nanoseconds - number for number in range(40, 0, -1)]
    for stamp_ns in sent:
        publisher.publish(messages.wrench(stamp_ns, '', [1e-3, 0.0, 0.0]))
    run = node._component._mode.run
    spin_until(executor, lambda: run.epoch.newest_ns == sent[-1])
    other.create_subscription(
        WrenchStamped, '/attitude_node/accepted_torque', received.append,
        QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL), raw=True)
    spin_until(executor, lambda: len(received) == 41)
    publisher.publish(messages.wrench(sent[-1] + 1, '', [1e-3, 0.0, 0.0]))
    spin_until(executor, lambda: len(received) == 42)
    found = [messages.WRENCH.decode(data) for data in received]
    assert messages.is_epoch_marker(found[0].frame_id)
    assert [message.stamp_ns for message in found[1:]] == [*sent, sent[-1] + 1]
    executor.shutdown()
    node.destroy_node()
    other.destroy_node()


def test_torques_sent_before_the_node_started_are_reported(domain):
    with LiveSession(TUMBLER, domain, *RELIABLE) as live:
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
        assert live.stop() == 0
