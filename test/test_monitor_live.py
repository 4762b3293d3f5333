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

"""The node `attitude_monitor`: its outputs, and what it reports about its inputs."""

from collections import Counter
import json
import time

from conftest import at_night, SECOND
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from live import decoded, PATIENCE, Session
from live_session import DIAGNOSTICS
import monitor as campaign
import numpy as np
import pytest
from rclpy.clock import Clock as NodeClock
from rclpy.duration import Duration
from rigid_body_ros import messages, scene
from rigid_body_ros.commands import main
from rigid_body_ros.node.attitude_monitor import AttitudeMonitor
from rigid_body_ros.node.intake import DrainCallback
from rigid_body_ros.node.open_loop import message_type
from rigid_body_ros.recording import Writer
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
import yaml

pytestmark = pytest.mark.ros
OK, ERROR = 0, 2
BEGIN_NS = 1000 * SECOND
#: Simulated time per time. If it were ten times as fast as real time, it might count as a jump.
FASTER = 6
TOPICS = {'/torque': messages.WRENCH, '/mocap': messages.QUATERNION, '/gyro': messages.VECTOR3}
#: The topics of the errors.
ATTITUDE, RATE = (f'/attitude_monitor/{name}_error' for name in ('attitude', 'rate'))
#: The names of these inputs in diagnostics.
NAMES = 'torques', 'measured /mocap', 'measured /gyro'
MEASURED = {'measured': ['/mocap', '/gyro'], 'window': 2.0,
            'attitude_noise': campaign.ATTITUDE_NOISE, 'rate_noise': campaign.RATE_NOISE}


def stream(seconds, **wrong):
    """Return stamps, topics and messages, sorted by stamp."""
    found = []
    for piece in campaign.pieces(4, seconds, piece=min(seconds, 60), **wrong):
        for (topic, kind), (times_ns, values) in zip(TOPICS.items(), piece):
            made = messages.wrench if topic == '/torque' else kind.encode
            frame_id = 'world' if topic == '/mocap' else 'base_link'
            found += [(stamp_ns, topic, made(stamp_ns, frame_id, one)) for stamp_ns, one in zip(
                (BEGIN_NS + times_ns).tolist(), values)]
    return sorted(found, key=lambda message: message[0])


def between(found, begin, end=np.inf):
    """Return the messages between two times, s."""
    return [message for message in found if begin <= (message[0] - BEGIN_NS) / SECOND < end]


def shifted(found, shift_ns):
    """Return messages with shifted stamps."""
    return [(stamp_ns + shift_ns, topic, TOPICS[topic].encode(
        stamp_ns + shift_ns, '', TOPICS[topic].decode(data).values))
        for stamp_ns, topic, data in found]


class Monitored(Session):
    """A session with a monitor, and what it publishes."""

    kind, name = AttitudeMonitor, 'attitude_monitor'

    def __init__(self, folder, domain, **parameters):
        entries = dict(zip(('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'),
                           campaign.INERTIA[np.triu_indices(3)].tolist()))
        qos = {f'qos_overrides.{topic}.subscription.{name}': value for topic in TOPICS
               for name, value in (('reliability', 'reliable'), ('depth', 10_000))}
        path = folder / 'scene.yaml'
        path.write_text(yaml.dump({'/**': {'ros__parameters': {
            'inertia': entries, 'history': 1.0, 'on_time_jump': 'ignore', 'use_sim_time': True,
            'monitor': MEASURED, **qos, **parameters}}}))
        super().__init__(path, domain)
        self.scene = scene.load(path)

    def _connect(self):
        self.record(ATTITUDE, messages.VECTOR3, 1000)
        self.record(RATE, messages.VECTOR3, 1000)
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self.diagnostics.append, 100)
        self._clock = self.node.create_publisher(Clock, '/clock', 10)
        self.connect()

    def connect(self):
        """Create the publishers of all inputs, and wait until the monitor subscribes."""
        self.publishers = {topic: self.node.create_publisher(
            message_type(topic, kind.name), topic, 10_000) for topic, kind in TOPICS.items()}
        self.wait_until(lambda: all(one.get_subscription_count()
                                    for one in self.publishers.values()), 'the subscriptions')

    def play(self, found):
        """Publish messages, and the time."""
        began = time.monotonic() - found[0][0] / FASTER / SECOND
        for number, (stamp_ns, topic, data) in enumerate(found):
            if not number % 20:
                self.set_clock(stamp_ns)
                self.spin(max(1e-3, began + stamp_ns / FASTER / SECOND - time.monotonic()))
            self.publishers[topic].publish(data)
        self.set_clock(found[-1][0])

    def wait_for_windows(self, count):
        self.wait_until(lambda: len(self.received[RATE]) >= count, 'windows')

    def wait_for(self, name, text):
        """Wait for a text in the status of an input, or of the model."""
        self.wait_until(lambda: text in self.diagnosis(name)[2], text)

    def wait_for_jumps(self, count):
        self.wait_until(lambda: self.values('motion')['clock jumps'] == count, 'jumps')

    def values(self, name):
        return self.diagnosis(name)[0]

    def check_levels(self):
        """Check that the model has never been rejected."""
        assert bytes([ERROR]) not in {status.level for array in self.diagnostics
                                      for status in array.status
                                      if status.name.endswith(': model')}


def compared(folder, found):
    """Return the result of attitude_compare for a recording of the same messages."""
    with Writer(folder / 'flight.mcap') as writer:
        for topic, kind in TOPICS.items():
            writer.add_topic(topic, kind)
        for stamp_ns, topic, data in found:
            writer.write(topic, stamp_ns, data)
    assert not main.attitude_compare([
        str(folder / 'flight.mcap'), '--scene', str(folder / 'scene.yaml'), '--measured', '/mocap',
        '--measured', '/gyro', '--horizon', '2', '--json', str(folder / 'found.json')])
    horizon, = json.loads((folder / 'found.json').read_text())['horizons']
    return horizon['monitor']


@pytest.mark.parametrize('actuator', [None, *at_night(
    {'topics': ['/torque'], 'delay': 0.03, 'time_constant': 0.02, 'limit': {'x': 0.02}})])
def test_a_right_model_is_explained_with_the_bits_of_the_offline_twin(tmp_path, domain, actuator):
    found, random = stream(20), np.random.default_rng(6)
    order = sorted(found, key=lambda message: message[0] + int(random.integers(0, SECOND // 4)))
    others = {'actuator': actuator} if actuator else {}
    with Monitored(tmp_path, domain, **others) as session:
        session.play(order)
        twin = compared(tmp_path, found)
        session.wait_for_windows(len(twin))
        rejected = {name: session.values(name)['rejected: late'] for name in NAMES}
        assert not any(rejected.values()), rejected
        for topic, field in ((ATTITUDE, 'attitude_error_rad'), (RATE, 'rate_error_rad_s')):
            published = decoded(session, topic)
            assert [(one.stamp_ns, one.values.tolist()) for one in published] == [
                (one['end_ns'], one[field]) for one in twin]
        if not actuator:
            session.wait_for('model', 'the model explains')
            assert session.diagnosis('model')[1] == OK


def test_an_imu_as_people_send_it_is_judged_or_named(tmp_path, domain):
    imu, found = messages.IMU, []
    for number, (stamp_ns, topic, data) in enumerate(stream(20)):
        found.append((stamp_ns, topic, data))
        if topic == '/gyro':
            values = np.zeros(imu.doubles)
            values[3], values[13:16] = 1.0, messages.VECTOR3.decode(data).values
            found.append((stamp_ns, '/imu', imu.encode(stamp_ns, '/base_link', values)))
            found += [found[-1]] * (number % 20 == 0)  # the same stamp twice
    with Monitored(tmp_path, domain, monitor={
            **MEASURED, 'measured': ['/mocap', '/gyro', '/imu']}) as session:
        imus = session.publishers['/imu'] = session.node.create_publisher(Imu, '/imu', 10_000)
        session.wait_until(imus.get_subscription_count, 'the subscription')
        session.play(found)
        session.wait_for_windows(8)
        session.wait_for('model', '/imu: the attitude is not used')
        session.wait_for('measured /imu', 'samples have the same stamp as a later one')
        assert session.values('measured /imu')['rejected: unknown frame'] == 0
        session.check_levels()


@pytest.mark.nightly
def test_a_wrong_torque_is_found_and_the_check_goes_on_without_a_sensor(tmp_path, domain):
    wrong = stream(60, **campaign.ERRORS['torque of 1 mN m about x'])
    with Monitored(tmp_path, domain) as session:
        session.play(between(wrong, 0, 30))
        session.wait_until(lambda: session.diagnosis('model')[1] == ERROR, 'an alarm')
        assert 'sigma' in session.diagnosis('model')[2]
        session.wait_for('model', 'first suspect: torque_bias')
        values = {pair.key: pair.value for pair in session.status('model').values}
        assert values['first suspect'].startswith('torque_bias (')
        # The mocap sends only invalid messages: its status says so, and the check continues.
        session.play([(stamp_ns, topic, messages.QUATERNION.encode(
            stamp_ns, 'nowhere', (0.0, 0.0, 0.0, 1.0)) if topic == '/mocap' else data)
            for stamp_ns, topic, data in between(wrong, 30)])
        session.wait_for('measured /mocap', 'nothing for')
        session.wait_until(lambda: len(session.received[RATE])
                           > len(session.received[ATTITUDE]), 'windows without the mocap')
        session.diagnostics.clear()
        session.restart()
        session.wait_for('model', 'no window yet')


@pytest.mark.nightly
def test_what_falls_silent_is_named_and_is_no_error_of_the_model(tmp_path, domain):
    found = stream(60)
    with Monitored(tmp_path, domain) as session:
        for begin, topic, name in zip((0, 16, 32), TOPICS, NAMES):
            # Eight seconds with the topic, eight without it.
            session.play(between(found, begin, begin + 8) + [
                message for message in between(found, begin + 8, begin + 16)
                if message[1] != topic])
            session.wait_for(name, 'nothing for')
        assert session.values('model')['windows skipped: no torque for longer than stale_after']
        session.play(between(found, 48))
        session.wait_until(lambda: session.diagnosis('model')[1] == OK, 'the end of the silence')
        session.check_levels()
        # Publish only the time from here on.
        session.set_clock(found[-1][0] + 20 * SECOND)
        session.wait_for('model', 'no measurements since')


@pytest.mark.nightly
def test_lost_torques_are_no_error_of_the_model(tmp_path, domain):
    found = stream(30)
    with Monitored(tmp_path, domain,
                   **{'qos_overrides./torque.subscription.depth': 100}) as session:
        session.play(between(found, 0, 9))
        data = next(data for _, topic, data in between(found, 9) if topic == '/torque')
        for _ in range(200):
            session.publishers['/torque'].publish(data)
        session.wait_until(lambda: session.values('torques')['lost'], 'a loss')
        session.play(between(found, 9))
        session.wait_until(lambda: session.values('model').get('windows skipped: torques lost'),
                           'windows that are skipped')
        session.check_levels()


@pytest.mark.nightly
def test_after_a_jump_of_simulated_time_the_check_begins_again(tmp_path, domain):
    found = stream(20)
    with Monitored(tmp_path, domain, on_time_jump='reset') as session:
        session.play(found)
        for number, begin_ns in enumerate((BEGIN_NS, BEGIN_NS + 1000 * SECOND), 1):
            (_, topic, late), count = found[-1], len(session.received[RATE])
            found = shifted(found, begin_ns - found[0][0])
            session.set_clock(begin_ns)
            session.wait_for_jumps(number)
            session.publishers[topic].publish(late)  # as if it was still in transit
            session.play(found)
            session.wait_for_windows(count + 6)
        counts = Counter()
        for name in NAMES:
            counts.update(session.values(name))
        assert counts['rejected: before the reset'] == 2
        assert not counts['rejected: late'] + counts['rejected: future']
        session.check_levels()


@pytest.mark.nightly
def test_steps_of_the_wall_clock_are_no_error_of_the_model(tmp_path, domain, monkeypatch):
    steps, shift_ns, windows = [-30.0, 100.0, -0.25], 0, 3
    now, pass_on = NodeClock.now, DrainCallback.pass_on

    def passed_on(drain, message, info):
        info['received_timestamp'] += shift_ns
        pass_on(drain, message, info)
    # The clock of the node, and that of the middleware.
    monkeypatch.setattr(NodeClock, 'now', lambda clock: now(clock) + Duration(
        nanoseconds=shift_ns))
    monkeypatch.setattr(DrainCallback, 'pass_on', passed_on)
    with Monitored(tmp_path, domain, on_time_jump='reset', use_sim_time=False) as session:
        for stamp_ns, topic, data in shifted(stream(120), time.time_ns() - BEGIN_NS):
            session.spin((stamp_ns - time.time_ns()) / SECOND)
            (_, _, data), = shifted([(stamp_ns, topic, data)], shift_ns)
            session.publishers[topic].publish(data)
            if len(session.received[RATE]) >= windows:
                if not steps:
                    break
                shift_ns += round(steps.pop(0) * SECOND)
                windows += 3
        assert not steps
        session.wait_for_jumps(3)
        session.check_levels()


@pytest.mark.nightly
def test_restarts_of_the_sources_and_of_the_monitor_are_no_error_of_the_model(tmp_path, domain):
    found = stream(60)
    with Monitored(tmp_path, domain) as session:
        session.play(between(found, 0, 15))
        for publisher in session.publishers.values():
            session.node.destroy_publisher(publisher)
        session.connect()
        session.play(between(found, 18, 33))
        session.restart()
        count = len(session.received[RATE])
        # As if the monitor discovers the publisher of torques last.
        session.play([message for message in between(found, 33.5)
                      if message[1] != '/torque' or message[0] > BEGIN_NS + 37 * SECOND])
        session.wait_for_windows(count + 8)
        session.check_levels()


def test_a_message_without_a_stamp_has_the_time_at_which_it_was_received(tmp_path, domain):
    stamps, times = [], []
    with Monitored(tmp_path, domain, use_sim_time=False) as session:
        inputs, gyro = session.tested._inputs, session.publishers['/gyro']
        # No executor waits for these topics: the monitor polls them all at once.
        polled = {subscription.topic_name for subscription in inputs.intake.subscriptions}
        assert polled == {*TOPICS}
        assert not polled & {each.topic_name for each in session.tested.subscriptions}
        measure = inputs.monitor.measure
        inputs.monitor.measure = lambda topic, stamps_ns, *found: (
            stamps.extend(stamps_ns) or measure(topic, stamps_ns, *found))
        for _ in range(3):
            times.append(time.time_ns())
            gyro.publish(messages.VECTOR3.encode(0, 'base_link', np.zeros(3)))
            assert gyro.wait_for_all_acked(Duration(seconds=PATIENCE))
        times.append(time.time_ns())
        session.wait_until(lambda: len(stamps) == 3, 'the messages')
    assert all(first <= stamp <= last for first, stamp, last in zip(times, stamps, times[1:]))


def test_torques_of_another_type_are_received(tmp_path, domain, stranger):
    with Monitored(tmp_path, domain) as session:
        session.set_clock(BEGIN_NS)
        session.node.destroy_publisher(session.publishers['/torque'])
        other = stranger.create_publisher(Vector3Stamped, '/torque', 10)
        session.wait_until(other.get_subscription_count, 'the subscription')
        other.publish(messages.VECTOR3.encode(BEGIN_NS, 'base_link', np.full(3, 1e-3)))
        session.wait_until(lambda: session.values('torques')['applied'] == 1, 'the torque')
