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

"""attitude_node with several topics of torques, and with torques on rotors."""

from dataclasses import replace
import re
import subprocess

from conftest import at_night, SECOND
from geometry_msgs.msg import Twist, Vector3Stamped, Wrench, WrenchStamped
from live import commit, decoded, live_values, PATIENT, replayed, run_clock, set_parameter, TUMBLER
from live_session import ACCEPTED, ATTITUDE, COMMITTED, LiveSession, RELIABLE
import numpy as np
import pytest
from rcl_interfaces.srv import DescribeParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from rigid_body_ros import messages, read, recording, scene, State
from rigid_body_ros.mechanics import so3
from rigid_body_ros.replay.verify import verify
from test_faults import torques_of

pytestmark = pytest.mark.ros
#: The topics of torques, and the logs of their accepted torques.
LOGS = {'torque': ACCEPTED, 'disturbance': f'{ACCEPTED}_1',
        'wheel_torque': '/attitude_node/accepted_wheel_torque'}
WHEELS = 'wheel_torque'
SOURCES = ('-p', 'torque_topics:=[torque, disturbance]', '-p', 'wheels:=true',
           '-p', 'initial_rotor_momentum.x:=0.01', '-p', 'initial_rotor_momentum.z:=-0.02',
           *RELIABLE, '-p', 'qos_overrides./disturbance.subscription.reliability:=reliable',
           '-p', 'qos_overrides./wheel_torque.subscription.reliability:=reliable')
#: A weight below the pivot, a dipole, and an orbit whose gravity gradient is strong enough to see.
FIELDS = """
    fields: [pivot, magnet]
    pivot: {moment: {z: -0.002}, field: {z: -9.81}}
    magnet: {moment: {x: 2.0}, field: {y: 0.003}}
    orbit: {mean_motion: 0.2, position: {x: 0.8, y: 0.6}}
    torque_topics: [torque, disturbance]
    wheels: true
    initial_rotor_momentum: {x: 0.01, z: -0.02}
"""
LOCKSTEP = ('-p', 'mode:=lockstep', '-p', 'step:=0.02')
STEP_NS = SECOND // 50


class Sources(LiveSession):
    """A session that publishes on every topic of torques and records every log."""

    def _connect(self):
        super()._connect()
        everything = QoSProfile(depth=100_000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.publishers = {topic: self.node.create_publisher(WrenchStamped, topic, 10_000)
                           for topic in LOGS if topic != 'torque'}
        self.publishers['torque'] = self._torque
        for log in list(LOGS.values())[1:]:
            self.received[log] = []
            self.node.create_subscription(WrenchStamped, log, self.received[log].append,
                                          everything, raw=True)
        self.rotor_momentum = []
        self.node.create_subscription(Vector3Stamped, 'rotor_momentum', lambda data: (
            self.rotor_momentum.append(messages.VECTOR3.decode(data))), 1000, raw=True)
        for publisher in self.publishers.values():
            self.wait_until(publisher.get_subscription_count, 'the node to subscribe')

    def publish_on(self, topic, stamp_ns, torque, frame_id=''):
        """Publish a torque, N m, on a topic."""
        self.publishers[topic].publish(messages.wrench(stamp_ns, frame_id, torque))

    def accepted(self, topic):
        """Return the accepted torques of a topic, decoded, of all epochs."""
        return decoded(self, LOGS[topic], messages.WRENCH)

    def write(self, path):
        """Write the logs and the committed states to a recording."""
        with recording.Writer(path) as writer:
            for topic, kind in {COMMITTED: messages.ODOMETRY,
                                **dict.fromkeys(LOGS.values(), messages.WRENCH)}.items():
                writer.add_topic(topic, kind)
                for data in self.received[topic]:
                    writer.write(topic, kind.decode(data).stamp_ns, data)


def replayed_sources(tmp_path, live):
    """Return the stamps and states committed in the last epoch, and the motion by `propagate`."""
    path, topics = tmp_path / 'live.mcap', list(LOGS.values())
    live.write(path)
    run = scene.load(tmp_path / 'live.yaml')
    result = verify(path, run, path, recording.Topics(tuple(topics[:-1]), topics[-1]))
    assert result.same.all()
    logs = [recording.torque_log(log, recording.epochs(path, recording.read(path, log))[-1],
                                 run.values['body_frame'], run.values['space_frame'])
            for log in topics]
    committed = recording.read(path, COMMITTED, messages.ODOMETRY)
    begin = int(np.flatnonzero(committed.stamps_ns == run.start.time_ns)[-1])
    stamps_ns = committed.stamps_ns[begin:]
    motion = run.problem().replaced(log=logs[:-1], wheels=logs[-1]).propagate(at=stamps_ns)
    return (stamps_ns, live_values(committed)[begin:],
            np.hstack([motion.attitude, motion.angular_velocity]), logs, run)


def plan(live, random, topics):
    """Return torques at 200 Hz for 4 s: (time of publication, topic, stamp, torque, frame)."""
    start_ns, rows = live.now_ns(), []
    for topic in topics:
        for number in range(800):
            stamp_ns = start_ns + number * SECOND // 200 + int(random.integers(0, SECOND // 500))
            delay_ns = int(random.integers(0, SECOND // 2)) * int(random.integers(0, 2))
            torque = random.normal(size=3) * 0.02 * (random.random() > 0.3)
            frames = ('', 'base_link') if topic == WHEELS else ('', 'base_link', 'world')
            rows.append((stamp_ns + delay_ns, topic, stamp_ns, torque,
                         frames[random.integers(len(frames))]))
    return sorted(rows, key=lambda row: row[0])


@pytest.mark.parametrize('arguments', [
    ('-p', 'torque_timeout:=0.02', '-p', 'damping.dxx:=0.01', '-p', 'damping.dyy:=0.02'),
    pytest.param((), marks=pytest.mark.nightly)])
def test_live_is_replay_bit_for_bit_with_several_sources(tmp_path, domain, arguments):
    random = np.random.default_rng(29)
    with Sources(TUMBLER, domain, *SOURCES, *PATIENT, *arguments) as live:
        rows = plan(live, random, LOGS)
        for due_ns, topic, stamp_ns, torque, frame_id in rows:
            live.spin((due_ns - live.now_ns()) * 1e-9)
            live.publish_on(topic, stamp_ns, torque, frame_id)
        stamps = np.unique([row[2] for row in rows])
        live.wait_until(lambda: sum(len(live.accepted(topic)) for topic in LOGS) == len(rows),
                        'all torques')
        commit(live, 1 + len(stamps))
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        stamps_ns, committed, expected, _, run = replayed_sources(tmp_path, live)
    for topic in LOGS:
        accepted = [message.stamp_ns for message in live.accepted(topic)]
        if topic == 'torque':
            accepted.pop()  # the torque that is far ahead
        assert sorted(accepted) == sorted(row[2] for row in rows if row[1] == topic)
        assert np.any(np.diff(accepted) < 0)  # they did come out of order
    # One state for each change, however many sources there are.
    np.testing.assert_array_equal(stamps_ns[1:1 + len(stamps)], stamps)
    np.testing.assert_array_equal(committed, expected)
    assert run.start.rotor_momentum.tolist() == [0.01, 0.0, -0.02]


def test_rotor_momentum_is_published_with_the_other_outputs(tmp_path, domain):
    start_ns = 100 * SECOND
    with Sources(TUMBLER, domain, *SOURCES, '-p', 'use_sim_time:=true',
                 '-p', f'start_time:={start_ns}') as live:
        run_clock(live, start_ns, until=lambda: live.received[COMMITTED])
        live.publish_on(WHEELS, start_ns, [0.001, 0.0, 0.002])
        run_clock(live, start_ns, until=lambda: live.accepted(WHEELS))
        run_clock(live, start_ns, seconds=2)
        assert live.stop() == 0
    attitudes = [messages.QUATERNION.decode(data).stamp_ns for data in live.received[ATTITUDE]]
    found = {message.stamp_ns: message for message in live.rotor_momentum}
    assert len(set(attitudes) & set(found)) > 50
    for message in list(found.values()):
        seconds = (message.stamp_ns - start_ns) * 1e-9
        np.testing.assert_allclose(
            message.values, [0.01 + 0.001 * seconds, 0.0, -0.02 + 0.002 * seconds], atol=1e-16)
        assert message.frame_id == 'base_link'


def test_equal_stamps_replace_each_other_within_one_source_only(tmp_path, domain):
    with Sources(TUMBLER, domain, *SOURCES) as live:
        stamp_ns = live.now_ns()
        for topic, torque in (('torque', 0.01), ('disturbance', 0.02), ('torque', 0.03),
                              (WHEELS, 0.04)):
            live.publish_on(topic, stamp_ns, [torque, 0.0, 0.0])
            live.spin(0.1)
        live.wait_until(lambda: [len(live.accepted(topic)) for topic in LOGS] == [2, 1, 1],
                        'the torques')
        live.wait_for_torques(2)
        values, _, _ = torques_of(live)
        others, _, _ = live.diagnosis('torques_1')
        wheels, _, _ = live.diagnosis('wheel torques')
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        stamps_ns, committed, expected, logs, _ = replayed_sources(tmp_path, live)
    assert [log.torques.tolist() for log in logs] == [
        [[0.03, 0.0, 0.0]], [[0.02, 0.0, 0.0]], [[0.04, 0.0, 0.0]]]
    assert stamps_ns.tolist()[1:] == [stamp_ns]
    np.testing.assert_array_equal(committed, expected)
    assert [counts['replaced (same stamp)'] for counts in (values, others, wheels)] == [1, 0, 0]
    assert [counts['applied'] for counts in (values, others, wheels)] == [2, 1, 1]


def test_faults_are_counted_by_cause_and_publishers_named_by_topic(domain):
    with Sources(TUMBLER, domain, *SOURCES) as live:
        live.publish_on('disturbance', live.now_ns(), [np.nan, 0.0, 0.0])
        live.publish_on('disturbance', live.now_ns(), [0.1, 0.0, 0.0], 'map')
        live.publish_on(WHEELS, live.now_ns(), [0.1, 0.0, 0.0], 'world')
        second = live.node.create_publisher(WrenchStamped, 'disturbance', 10)
        live.wait_until(lambda: '/disturbance: 2 publishers: /live_session, /live_session; '
                        'torques of several publishers' in live.diagnosis('torques_1')[2],
                        'a warning')
        live.node.destroy_publisher(second)
        live.node.destroy_publisher(live.publishers[WHEELS])
        live.wait_until(lambda: '/wheel_torque: no publisher'
                        in live.diagnosis('wheel torques')[2], 'a warning')
        found = [live.diagnosis(name)[0] for name in ('torques', 'torques_1', 'wheel torques')]
        words = live.end()
    counts = [{name.removeprefix('rejected: '): count for name, count in values.items()
               if name.startswith('rejected') and count} for values in found]
    assert counts == [{}, {'not finite': 1, 'unknown frame': 1}, {'unknown frame': 1}]
    assert 'torque on disturbance rejected (1 so far): not finite: ' in words
    assert ('torque on wheel_torque rejected (1 so far): unknown frame: frame_id: expected '
            "'base_link' or '', because the torque on rotors is in body axes, found 'world'"
            ) in words


def test_a_reset_keeps_the_torques_and_a_new_state_the_rotor_momentum(tmp_path, domain):
    with Sources(TUMBLER, domain, *SOURCES) as live:
        begin_ns = live.now_ns()
        live.publish_on(WHEELS, begin_ns, [0.0, 0.1, 0.0])
        live.wait_until(lambda: live.accepted(WHEELS), 'the torque on the rotors')
        live.spin(1.2)  # longer than `history`: a slow source keeps its torque
        live.publish_on('disturbance', live.now_ns(), [0.0, 0.0, 0.01])
        live.wait_until(lambda: live.accepted('disturbance'), 'the torque')
        live.set_state(State(0, (0, 0, 1, 0), (0.1, 0.2, 0.3)))
        live.wait_until(lambda: len(live.accepted(WHEELS)) == 2, 'the new epoch')
        live.dump_parameters(tmp_path / 'live.yaml')
        start = scene.load(tmp_path / 'live.yaml').start
        assert start.attitude.tolist() == [0, 0, 1, 0]
        expected = 0.1 * (start.time_ns - begin_ns) * 1e-9
        np.testing.assert_allclose(start.rotor_momentum, [0.01, expected, -0.02], rtol=1e-14)
        assert live.reset().success
        live.wait_until(lambda: len(live.accepted(WHEELS)) == 3, 'the torques of the new epoch')
        live.publish_on('torque', live.now_ns(), [0.01, 0.0, 0.0])
        live.wait_until(lambda: live.accepted('torque'), 'the torque')
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        _, committed, expected, logs, run = replayed_sources(tmp_path, live)
    assert run.start.rotor_momentum.tolist() == [0.01, 0.0, -0.02]
    # Each epoch logs the torques in force again.
    assert [len(live.accepted(topic)) for topic in LOGS] == [1, 3, 3]
    assert [len(log.times_ns) for log in logs] == [1, 1, 1]
    np.testing.assert_array_equal(committed, expected)


def with_fields(path):
    """Write a scene with fields, an orbit, rotors and two topics, and return its path."""
    path.write_text(TUMBLER.read_text() + FIELDS + f'    start_time: {SECOND}\n')
    return path


@pytest.mark.nightly
def test_fields_act_alike_live_and_in_a_replay_of_each_epoch(tmp_path, domain):
    random, given = np.random.default_rng(36), with_fields(tmp_path / 'scene.yaml')
    with Sources(given, domain, *SOURCES, *LOCKSTEP) as live:
        def ask(numbers):
            for number in numbers:
                for topic in random.permutation([*LOGS]):
                    live.publish_on(topic, number * STEP_NS, random.normal(size=3) * 1e-3)
                live.wait_until(lambda due=(number + 1) * STEP_NS: any(
                    messages.QUATERNION.decode(data).stamp_ns == due
                    for data in live.received[ATTITUDE]), 'a response')
        ask(range(50, 80))
        live.set_state(State(90 * STEP_NS, (0.5, 0.5, 0.5, 0.5), (0.1, 0.2, 0.3)))
        live.wait_until(lambda: 90 * STEP_NS in [
            messages.ODOMETRY.decode(data).stamp_ns for data in live.received[COMMITTED]],
            'the new epoch')
        ask(range(90, 120))
        names = [f'{name}.{group}.{axis}' for name in ('pivot', 'magnet')
                 for group in ('moment', 'field') for axis in 'xyz']
        described = live.call(DescribeParameters, 'describe_parameters', names=names).descriptors
        denied = set_parameter(live, 'pivot.moment.z', 0.0)
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        live.write(tmp_path / 'live.mcap')
    run, dumped = scene.load(given), scene.load(tmp_path / 'live.yaml')
    # The scene with which the node was started reproduces the bits of both epochs.
    topics = recording.Topics((ACCEPTED, LOGS['disturbance']), LOGS[WHEELS])
    result = verify(tmp_path / 'live.mcap', run, tmp_path / 'live.mcap', topics)
    assert result.same.all()
    assert result.epochs == result.compared_epochs == 2
    # The scene that the node reports reproduces the last epoch, 0.8 s later on the orbit.
    problem, again = (read(tmp_path / 'live.mcap', replace(
        each, start=dumped.start), topic=topics.torques, wheel_torque=topics.wheel_torque)
        for each in (run, dumped))
    stamps_ns = problem.stamps_ns[problem.stamps_ns >= problem.start.time_ns]
    motion = problem.propagate(at=stamps_ns)
    np.testing.assert_array_equal(again.propagate(at=stamps_ns).attitude, motion.attitude)
    np.testing.assert_allclose(problem.fields[-1].position, so3.rotate(
        so3.exp([0.0, 0.0, 0.16]), [0.8, 0.6, 0.0]), atol=1e-15)
    # The fields matter: without them, the motion differs.
    without = problem.replaced(fields=()).propagate(at=stamps_ns)
    assert abs(without.attitude - motion.attitude).max() > 0.01
    assert all(each.read_only and each.floating_point_range and each.description
               for each in described)
    assert not denied.successful
    assert 'pivot.moment.z' in denied.reason


def test_lockstep_waits_for_every_topic_that_has_a_publisher(tmp_path, domain):
    def answers(live):
        return [0, *(messages.QUATERNION.decode(data).stamp_ns
                     for data in live.received[ATTITUDE])]

    with Sources(TUMBLER, domain, *SOURCES, *LOCKSTEP) as live:
        for number in range(1, 21):
            stamp_ns = number * STEP_NS
            topics = list(LOGS)[number % 3:] + list(LOGS)[:number % 3]
            for place, topic in enumerate(topics):
                live.publish_on(topic, stamp_ns, [1e-3 * number, 2e-3 * place, 0.0])
                if number == 5 and place < 2:
                    live.spin(0.2)
                    assert answers(live)[-1] == stamp_ns
            live.wait_until(lambda due=stamp_ns + STEP_NS: answers(live)[-1] == due, 'a response')
        live.publish_on(WHEELS, 21 * STEP_NS, [0.0, 0.0, 1e-3])
        live.publish_on('torque', 21 * STEP_NS, [0.0, 0.0, 1e-3])
        live.wait_until(lambda: re.search(
            '/disturbance: no torque for .* has not responded to the state at 420000000',
            live.diagnosis('torques_1')[2]), 'a warning')
        live.node.destroy_publisher(live.publishers['disturbance'])

        def has_responded():  # repeat the torque, as a controller does
            live.publish_on('torque', 21 * STEP_NS, [0.0, 0.0, 1e-3])
            live.spin(0.5)
            return answers(live)[-1] == 22 * STEP_NS
        live.wait_until(has_responded, 'a response')
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        stamps_ns, committed, expected, _, _ = replayed_sources(tmp_path, live)
    assert stamps_ns.tolist() == [number * STEP_NS for number in range(1, 22)]
    np.testing.assert_array_equal(committed, expected)


class Thrusters(LiveSession):
    """A session whose only topic of torques has another name."""

    topic = 'thrusters'


def test_one_topic_of_another_name_is_all_that_changes(tmp_path, domain):
    with Thrusters(TUMBLER, domain, '-p', 'torque_topics:=[thrusters]', '-p',
                   'qos_overrides./thrusters.subscription.reliability:=reliable') as live:
        for number in range(5):
            live.publish(live.now_ns(), '', [0.01, 0.0, 1e-3 * number])
            live.spin(0.05)
        live.wait_for_torques(5)
        names = {name for name, _ in live.node.get_subscriber_names_and_types_by_node(
            'attitude_node', '/')}
        live.dump_parameters(tmp_path / 'live.yaml')
        assert live.stop() == 0
        run = replayed(tmp_path, live)
    assert '/thrusters' in names
    assert '/torque' not in names
    assert len(run.accepted.stamps_ns) == 5
    np.testing.assert_array_equal(run.committed, run.replay)


def publisher_of(live, kind):
    """Return a publisher of another type, which replaces that of WrenchStamped."""
    live.disconnect()
    return live.node.create_publisher(kind, 'torque', 1000)


def made(kind, stamp_ns, torque):
    """Return a message with a torque, N m, in body axes."""
    message = kind()
    vector = message.vector if kind is Vector3Stamped else message.torque
    vector.x, vector.y, vector.z = torque
    if kind is Vector3Stamped:
        message.header.frame_id = 'base_link'
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND)
    return message


@pytest.mark.parametrize('kind', [Wrench, Vector3Stamped])
def test_torques_of_another_type_are_accepted_and_replayed(tmp_path, domain, kind):
    with LiveSession(TUMBLER, domain, *RELIABLE, *PATIENT, '-p', 'stale_after:=0.0') as live:
        live.publish(live.now_ns(), '', [0.01, 0.0, 0.0])
        live.wait_for_torques(1)
        publisher = publisher_of(live, kind)
        live.wait_until(publisher.get_subscription_count, 'the node to subscribe')
        begin_ns, sent = live.now_ns(), []
        for number in range(5):
            sent.append((live.now_ns(), [0.0, 0.001 * number, -0.02]))
            publisher.publish(made(kind, *sent[-1]))
            live.spin(0.05)
        live.wait_for_torques(6)
        live.node.destroy_publisher(publisher)
        live.synchronize()
        live._torque = live.node.create_publisher(WrenchStamped, 'torque', 10)
        live.wait_until(lambda: live.torque_subscriptions, 'the node to subscribe again')
        end_ns = live.now_ns()
        commit(live, 7)
        live.wait_until(lambda: live.diagnosis('torques')[1:] == (0, 'OK'), 'no warning')
        live.dump_parameters(tmp_path / 'live.yaml')
        words = live.end()
        run = replayed(tmp_path, live)
    assert f'/torque: torques are geometry_msgs/msg/{kind.__name__}' in words
    np.testing.assert_array_equal(run.accepted.values[1:-1, 3:], [torque for _, torque in sent])
    stamps_ns = run.accepted.stamps_ns[1:-1]
    if kind is Vector3Stamped:
        np.testing.assert_array_equal(stamps_ns, [stamp_ns for stamp_ns, _ in sent])
    else:  # a Wrench is stamped as it arrives
        assert np.all(np.diff([begin_ns, *stamps_ns, end_ns]) > 0)
    np.testing.assert_array_equal(run.committed, run.replay)


@pytest.mark.parametrize(('kind', 'arguments', 'accepted'), [
    (Twist, (), 'geometry_msgs/msg/WrenchStamped, geometry_msgs/msg/Wrench, '
     'geometry_msgs/msg/Vector3Stamped, px4_msgs/msg/VehicleTorqueSetpoint'),
    (Wrench, LOCKSTEP, 'geometry_msgs/msg/WrenchStamped, geometry_msgs/msg/Vector3Stamped')])
def test_diagnostics_name_a_type_that_is_not_accepted(domain, kind, arguments, accepted):
    with LiveSession(TUMBLER, domain, *arguments) as live:
        publisher = publisher_of(live, kind)
        expected = f'/torque: expected one of {accepted}, found geometry_msgs/msg/{kind.__name__}'
        live.wait_until(lambda: expected in live.diagnosis('torques')[2], 'a warning')
        assert not publisher.get_subscription_count()


@pytest.mark.parametrize(('arguments', 'message'), [
    (('torque_topics:=[torque, a, torque]',),
     "torque_topics: expected each topic once, found 'torque' twice"),
    (('torque_topics:=[torque, wheel_torque]', 'wheels:=true'),
     'torque_topics: expected topics that the node does not use for anything else, found '
     '/wheel_torque twice'),
    (('torque_topics:=[3, 4]',), 'torque_topics: expected names of topics'),
    (('torque_topics:=[]',), 'torque_topics: expected a list of text, found none'),
    (('wheels:=true', 'solver:=strang', 'max_step:=0.01'), "solver 'strang' handles neither"),
    *at_night(
        (('torque_topics:=[torque, /torque]',),
         'torque_topics: expected topics that the node does not use for anything else, found '
         '/torque twice'),
        (('torque_topics:=[~/accepted_torque]',),
         'torque_topics: expected topics that the node does not use for anything else, found '
         '/attitude_node/accepted_torque twice'),
        (('torque_topics:=torque',), 'torque_topics: expected a list of text'))])
def test_sources_that_make_no_sense_are_rejected_in_one_line(domain, arguments, message):
    session = LiveSession(TUMBLER, domain)
    words = [word for argument in arguments for word in ('-p', argument)]
    result = subprocess.run([*session.command, *words], env=session.environment,
                            capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 2
    line = result.stderr.splitlines()[-1]
    assert line.startswith(f'attitude_node: error: {message}'), result.stderr
    assert 'Traceback' not in result.stderr
