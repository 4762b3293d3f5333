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

"""The node `attitude_monitor`: what it publishes, and what it says of its inputs."""

from functools import partial
import json
import os
import signal
import subprocess
import sys
import time

from conftest import ROOT, SECOND
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rigid_body_ros import messages, scene
from rigid_body_ros.commands import main
from rigid_body_ros.recording import Writer
from rigid_body_ros.sensing.monitor import Monitor, settings_of
from rigid_body_ros.sensing.reading import samples
from rosgraph_msgs.msg import Clock
import yaml

sys.path.insert(0, str(ROOT / 'benchmarks'))
import monitor as campaign  # noqa: E402, I100

pytestmark = pytest.mark.ros
#: s.
PATIENCE = 120.0
PROGRAM = ('import sys; from rigid_body_ros.commands import main; '
           'sys.exit(main.attitude_monitor())')
BEGIN_NS = 1000 * SECOND
TOPICS = {'/torque': (WrenchStamped, messages.WRENCH), '/mocap': (QuaternionStamped,
          messages.QUATERNION), '/gyro': (Vector3Stamped, messages.VECTOR3)}


def stream(seconds, **wrong):
    """Return stamps, topics and messages, in the order of the stamps."""
    found = []
    for torques, mocap, gyro in campaign.pieces(4, seconds, **wrong):
        found += [(BEGIN_NS + int(time_ns), '/torque', messages.wrench(
            BEGIN_NS + int(time_ns), 'base_link', torque)) for time_ns, torque in zip(*torques)]
        found += [(BEGIN_NS + int(time_ns), '/mocap', messages.QUATERNION.encode(
            BEGIN_NS + int(time_ns), 'world', one)) for time_ns, one in zip(*mocap)]
        found += [(BEGIN_NS + int(time_ns), '/gyro', messages.VECTOR3.encode(
            BEGIN_NS + int(time_ns), 'base_link', rate)) for time_ns, rate in zip(*gyro)]
    return sorted(found, key=lambda message: message[0])


class Session:
    """A monitor in a process of its own, under simulated time, and what it publishes."""

    def __init__(self, path, domain):
        entries = dict(zip(('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'),
                           campaign.INERTIA[np.triu_indices(3)].tolist()))
        qos = {f'qos_overrides.{topic}.subscription.reliability': 'reliable' for topic in TOPICS}
        path.write_text(yaml.dump({'/**': {'ros__parameters': {
            'inertia': entries, 'history': 1.0, 'on_time_jump': 'ignore', 'use_sim_time': True,
            'monitor': {'measured': ['/mocap', '/gyro'], 'window': 2.0,
                        'attitude_noise': campaign.ATTITUDE_NOISE,
                        'rate_noise': campaign.RATE_NOISE}, **qos}}}))
        self.scene = scene.load(path)
        self._environment = os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                                          'ROS_DOMAIN_ID': str(domain)}
        self._command = [sys.executable, '-c', PROGRAM, '--ros-args', '--params-file', str(path)]
        self._domain = domain

    def __enter__(self):
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        self.start()
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=self._domain)
        self.node = rclpy.create_node('recorder', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.errors, self.diagnostics = {}, []
        for name in ('attitude_error', 'rate_error'):
            self.errors[name] = []
            self.node.create_subscription(Vector3Stamped, f'/attitude_monitor/{name}',
                                          self.errors[name].append, 1000, raw=True)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.diagnostics.append,
                                      QoSProfile(depth=100))
        self.clock = self.node.create_publisher(Clock, '/clock', 10)
        self.publishers = {topic: self.node.create_publisher(kind, topic, 10_000)
                           for topic, (kind, _) in TOPICS.items()}
        self.connect()
        return self

    def __exit__(self, *error):
        self.process.kill()
        self.process.wait()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def start(self):
        self.process = subprocess.Popen(self._command, env=self._environment,
                                        stderr=subprocess.DEVNULL)

    def connect(self):
        """Wait until the monitor listens to all topics and the clock, and is heard."""
        count = len(self.diagnostics)
        self.wait(lambda: self.clock.get_subscription_count() == 1 and all(
            one.get_subscription_count() == 1 for one in self.publishers.values())
            and len(self.diagnostics) > count)
        # The monitor may not have found the publishers yet.
        self.set_clock(BEGIN_NS)
        for topic, (_, kind) in TOPICS.items():
            name = 'torques' if topic == '/torque' else f'measured {topic}'
            data = kind.encode(BEGIN_NS, 'nowhere', np.zeros(kind.doubles))
            publish = partial(self.publishers[topic].publish, data)
            self.wait(partial(self.is_heard, name, publish))
        self.received = self.count()

    def wait(self, condition):
        until = time.monotonic() + PATIENCE
        while not condition():
            assert self.process.poll() is None, 'the monitor has ended'
            assert time.monotonic() < until, 'nothing happens'
            self._executor.spin_once(timeout_sec=0.1)

    def is_heard(self, name, publish):
        """Return whether a message has arrived; publish another."""
        publish()
        return self.values(name)['rejected: unknown frame']

    def count(self):
        """Return how many messages have arrived."""
        return sum(self.values(name)['received'] for name in (
            'torques', 'measured /mocap', 'measured /gyro'))

    def play(self, found):
        """Publish messages no faster than they are judged, and wait until all have arrived."""
        for number, (stamp_ns, topic, data) in enumerate(found):
            if not number % 20:
                self.set_clock(stamp_ns)
            self.publishers[topic].publish(data)
            self.wait(partial(self.has_judged, stamp_ns - 4 * SECOND))
        self.set_clock(found[-1][0])
        # Some of those before may have been on their way.
        self.received += len(found)
        self.wait(lambda: self.count() >= self.received)

    def has_judged(self, time_ns):
        """Return whether a window that ends after a time has been judged."""
        errors = self.errors['rate_error']
        return (messages.VECTOR3.decode(errors[-1]).stamp_ns if errors else BEGIN_NS) > time_ns

    def set_clock(self, stamp_ns):
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(stamp_ns, SECOND)
        self.clock.publish(clock)

    def status(self, name):
        """Return the latest status of this name."""
        return next(status for array in reversed(self.diagnostics) for status in array.status
                    if status.name == f'/attitude_monitor: {name}')

    def values(self, name):
        return {pair.key: int(pair.value) for pair in self.status(name).values
                if pair.value.isdigit()}

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)


def compared(folder, found):
    """Return what attitude_compare says of a recording of the same messages."""
    with Writer(folder / 'flight.mcap') as writer:
        for topic, (_, kind) in TOPICS.items():
            writer.add_topic(topic, kind)
        for stamp_ns, topic, data in found:
            writer.write(topic, stamp_ns, data)
    assert not main.attitude_compare([
        str(folder / 'flight.mcap'), '--scene', str(folder / 'scene.yaml'), '--measured', '/mocap',
        '--measured', '/gyro', '--horizon', '2', '--json', str(folder / 'found.json')])
    horizon, = json.loads((folder / 'found.json').read_text())['horizons']
    return horizon['monitor']


def expected(session, found):
    """Return what a monitor without ROS says of the same messages, in the order of stamps."""
    monitor = Monitor(session.scene.problem(), settings_of(session.scene.values))
    for stamp_ns, topic, data in found:
        values = TOPICS[topic][1].decode(data).values[None]
        if topic == '/torque':
            monitor.apply([stamp_ns], values[:, 3:])
        else:
            monitor.measure(topic, [stamp_ns], *samples(TOPICS[topic][1], values))
    return [*monitor.judgements()]


def test_a_right_model_is_explained_with_the_bits_of_the_offline_twin(tmp_path, domain):
    found = stream(60)
    random = np.random.default_rng(6)
    order = sorted(found, key=lambda message: message[0] + int(random.integers(0, SECOND // 4)))
    with Session(tmp_path / 'scene.yaml', domain) as session:
        session.play(order)
        twin = expected(session, found)
        session.wait(lambda: len(session.errors['attitude_error']) >= len(twin))
        rejected = {name: session.values(name)['rejected: late'] for name in (
            'torques', 'measured /mocap', 'measured /gyro')}
        assert not any(rejected.values()), rejected
        for name in ('attitude', 'rate'):
            published = [messages.VECTOR3.decode(data)
                         for data in session.errors[f'{name}_error']]
            assert [one.stamp_ns for one in published] == [one.error.end_ns for one in twin]
            np.testing.assert_array_equal([one.values for one in published],
                                          [getattr(one.error, name) for one in twin])
        twin = compared(tmp_path, found)[:len(twin)]
        assert [one['rate_error_rad_s'] for one in twin] == [
            one.values.tolist() for one in published]
        session.wait(lambda: session.status('model').message.startswith('the model explains'))
        assert session.status('model').level == b'\x00'
        assert session.stop() == 0


def test_a_wrong_torque_is_found_and_the_check_goes_on_without_a_sensor(tmp_path, domain):
    wrong = stream(60, **campaign.ERRORS['torque of 1 mN m about x'])
    with Session(tmp_path / 'scene.yaml', domain) as session:
        first = [message for message in wrong if message[0] < BEGIN_NS + 30 * SECOND]
        session.play(first)
        session.wait(lambda: session.status('model').level == b'\x02')
        assert 'sigma' in session.status('model').message
        # The mocap has no valid message any more: its status says so, and the check goes on.
        session.play([(stamp_ns, topic, messages.QUATERNION.encode(
            stamp_ns, 'nowhere', (0.0, 0.0, 0.0, 1.0)) if topic == '/mocap' else data)
            for stamp_ns, topic, data in wrong[len(first):]])
        session.wait(lambda: '/mocap: nothing for' in session.status('measured /mocap').message)
        assert len(session.errors['rate_error']) > len(session.errors['attitude_error'])
        # A crash and a restart.
        session.process.kill()
        session.process.wait()
        session.start()
        session.connect()
        session.wait(lambda: session.status('model').message == 'no window yet')
        assert session.stop() == 0


@pytest.mark.parametrize(('line', 'words'), [
    ('monitor.rate_noise:=0.0', 'monitor.rate_noise: expected the standard deviation'),
    ('inertia_topic:=true', 'inertia_topic: expected false'),
    ('monitor.measured:=["a b"]', 'monitor.measured: expected names of topics'),
    ('monitor.measured:=["/imu", "/imu"]', 'monitor.measured: expected each topic once'),
    ('actuator.topics:=["torque"]', 'actuator.topics: expected none')])
def test_a_scene_that_cannot_be_checked_is_an_error_of_one_line(tmp_path, domain, line, words):
    session = Session(tmp_path / 'scene.yaml', domain)
    result = subprocess.run([*session._command, '-p', line], env=session._environment, check=False,
                            capture_output=True, text=True, timeout=PATIENCE)
    assert result.returncode == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1
