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

from collections import Counter
import json
import os
import signal
import subprocess
import sys
import time

from conftest import at_night, ROOT, SECOND
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
#: The same, and its wall clock is ahead by the seconds in a file.
WITH_CLOCK = """
from pathlib import Path
from rclpy.clock import Clock
from rclpy.duration import Duration
now, shift = Clock.now, Path({!r})
Clock.now = lambda clock: now(clock) + Duration(nanoseconds=int(shift.read_text() or 0))
""" + PROGRAM
BEGIN_NS = 1000 * SECOND
#: ns; simulated time in a second. If it is ten times as fast as real time, it may jump.
FASTER = 6 * SECOND
TOPICS = {'/torque': (WrenchStamped, messages.WRENCH), '/mocap': (QuaternionStamped,
          messages.QUATERNION), '/gyro': (Vector3Stamped, messages.VECTOR3)}
#: Their names in diagnostics.
NAMES = 'torques', 'measured /mocap', 'measured /gyro'


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
    """A monitor in a process of its own, and what it publishes."""

    def __init__(self, path, domain, program=PROGRAM, **parameters):
        entries = dict(zip(('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'),
                           campaign.INERTIA[np.triu_indices(3)].tolist()))
        qos = {f'qos_overrides.{topic}.subscription.reliability': 'reliable' for topic in TOPICS}
        path.write_text(yaml.dump({'/**': {'ros__parameters': {
            'inertia': entries, 'history': 1.0, 'on_time_jump': 'ignore', 'use_sim_time': True,
            'monitor': {'measured': ['/mocap', '/gyro'], 'window': 2.0,
                        'attitude_noise': campaign.ATTITUDE_NOISE,
                        'rate_noise': campaign.RATE_NOISE}, **qos, **parameters}}}))
        self.scene = scene.load(path)
        self._environment = os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                                          'ROS_DOMAIN_ID': str(domain)}
        self._command = [sys.executable, '-c', program, '--ros-args', '--params-file', str(path)]
        self._domain = domain

    def __enter__(self):
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        self.start()
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=self._domain)
        self.node = rclpy.create_node('recorder', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.errors, self.diagnostics, self.now_ns = {}, [], BEGIN_NS
        for name in ('attitude_error', 'rate_error'):
            self.errors[name] = []
            self.node.create_subscription(Vector3Stamped, f'/attitude_monitor/{name}',
                                          self.errors[name].append, 1000, raw=True)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.diagnostics.append,
                                      QoSProfile(depth=100))
        self.clock = self.node.create_publisher(Clock, '/clock', 10)
        self.publish()
        self.connect()
        return self

    def publish(self):
        """Begin to publish what the monitor receives."""
        self.publishers = {topic: self.node.create_publisher(kind, topic, 10_000)
                           for topic, (kind, _) in TOPICS.items()}

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
        self.wait(lambda: all(one.get_subscription_count() == 1
                              for one in self.publishers.values())
                  and len(self.diagnostics) > count)
        # The monitor may not have found the publishers yet.
        for name, (topic, (_, kind)) in zip(NAMES, TOPICS.items()):
            data = kind.encode(self.now_ns, 'nowhere', np.zeros(kind.doubles))
            before = self.values(name)['rejected: unknown frame']
            self.wait(self.is_heard, name, before, self.publishers[topic], data)
        self.received = self.count()

    def wait(self, condition, *arguments):
        until = time.monotonic() + PATIENCE
        while not condition(*arguments):
            assert self.process.poll() is None, 'the monitor has ended'
            assert time.monotonic() < until, 'nothing happens'
            self._executor.spin_once(timeout_sec=0.01)

    def is_heard(self, name, before, publisher, data):
        """Return whether a message has arrived after some; publish another, and the time."""
        self.set_clock(self.now_ns)
        publisher.publish(data)
        return self.values(name)['rejected: unknown frame'] > before

    def count(self):
        """Return how many messages have arrived, or are known to be lost."""
        return sum(self.values(name)[key] for name in NAMES for key in ('received', 'lost'))

    def play(self, found):
        """Publish messages no faster than they are judged, and wait until all have arrived."""
        began = time.monotonic() - found[0][0] / FASTER
        for number, (stamp_ns, topic, data) in enumerate(found):
            if not number % 20:
                self.wait(is_over, time.monotonic, began + stamp_ns / FASTER)
                self.set_clock(stamp_ns)
            self.publishers[topic].publish(data)
            self.wait(self.keeps_up, stamp_ns, number)
        self.set_clock(found[-1][0])
        # Some of those before may have been on their way.
        self.received += len(found)
        self.wait(lambda: self.count() >= self.received)

    def keeps_up(self, stamp_ns, number):
        """Return whether the monitor is not far behind a message, the last of a number."""
        errors = self.errors['rate_error']
        last_ns = messages.VECTOR3.decode(errors[-1]).stamp_ns if errors else BEGIN_NS
        # If an input is silent, no window may be judged.
        return last_ns > stamp_ns - 4 * SECOND or self.count() + 400 > self.received + number

    def has_judged(self, count):
        """Return whether so many windows have been judged."""
        return len(self.errors['rate_error']) >= count

    def has_jumped(self, count):
        """Return whether the monitor has noticed so many jumps of the clock."""
        return self.values('motion')['clock jumps'] == count

    def is_silent(self, name):
        """Return whether an input has been found silent."""
        return 'nothing for' in self.status(name).message

    def set_clock(self, stamp_ns):
        clock, self.now_ns = Clock(), stamp_ns
        clock.clock.sec, clock.clock.nanosec = divmod(stamp_ns, SECOND)
        self.clock.publish(clock)

    def status(self, name):
        """Return the latest status of this name."""
        return next(status for array in reversed(self.diagnostics) for status in array.status
                    if status.name == f'/attitude_monitor: {name}')

    def values(self, name):
        return {pair.key: int(pair.value) for pair in self.status(name).values
                if pair.value.isdigit()}

    def levels(self):
        """Return the levels that the model has had."""
        return {status.level for array in self.diagnostics for status in array.status
                if status.name.endswith(': model')}

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)


def is_over(clock, until):
    """Return whether a time is over."""
    return clock() > until


def shifted(found, shift_ns):
    """Return messages with other stamps."""
    return [(stamp_ns + shift_ns, topic, TOPICS[topic][1].encode(
        stamp_ns + shift_ns, '', TOPICS[topic][1].decode(data).values))
        for stamp_ns, topic, data in found]


def find(found, seconds):
    """Return the index of the first message from a time on."""
    return next(row for row, (stamp_ns, _, _) in enumerate(found)
                if stamp_ns >= BEGIN_NS + seconds * SECOND)


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
    monitor = Monitor(session.scene.problem(), settings_of(session.scene.values),
                      session.scene.actuators or ())
    for stamp_ns, topic, data in found:
        values = TOPICS[topic][1].decode(data).values[None]
        if topic == '/torque':
            monitor.apply([stamp_ns], values[:, 3:])
        else:
            monitor.measure(topic, [stamp_ns], *samples(TOPICS[topic][1], values))
    return [*monitor.judgements()]


@pytest.mark.parametrize('actuator', [None, *at_night(
    {'topics': ['/torque'], 'delay': 0.03, 'time_constant': 0.02, 'limit': {'x': 0.02}})])
def test_a_right_model_is_explained_with_the_bits_of_the_offline_twin(tmp_path, domain, actuator):
    found = stream(60)
    random = np.random.default_rng(6)
    order = sorted(found, key=lambda message: message[0] + int(random.integers(0, SECOND // 4)))
    others = {'actuator': actuator} if actuator else {}
    with Session(tmp_path / 'scene.yaml', domain, **others) as session:
        session.play(order)
        twin = expected(session, found)
        session.wait(session.has_judged, len(twin))
        rejected = {name: session.values(name)['rejected: late'] for name in NAMES}
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
        if not actuator:
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
        session.wait(session.is_silent, 'measured /mocap')
        assert len(session.errors['rate_error']) > len(session.errors['attitude_error'])
        # A crash and a restart.
        session.process.kill()
        session.process.wait()
        session.start()
        session.connect()
        session.wait(lambda: session.status('model').message.startswith('no window yet'))
        assert session.stop() == 0


def test_what_falls_silent_is_named_and_is_no_error_of_the_model(tmp_path, domain):
    found = stream(60)
    with Session(tmp_path / 'scene.yaml', domain) as session:
        begin_ns = BEGIN_NS
        for topic, name in zip(TOPICS, NAMES):
            # Eight seconds with the topic, eight without it.
            middle_ns, end_ns = begin_ns + 8 * SECOND, begin_ns + 16 * SECOND
            session.play([message for message in found if begin_ns <= message[0] < end_ns
                          and (message[1] != topic or message[0] < middle_ns)])
            session.wait(session.is_silent, name)
            begin_ns = end_ns
        assert session.values('model')['windows skipped: no torque for longer than stale_after']
        session.play([message for message in found if message[0] >= begin_ns])
        session.wait(lambda: session.status('model').level == b'\x00')
        assert b'\x02' not in session.levels()
        # Nothing comes any more, but for the time.
        session.set_clock(found[-1][0] + 20 * SECOND)
        session.wait(lambda: session.status('model').message.startswith('no measurements since'))
        assert session.stop() == 0


@pytest.mark.nightly
def test_lost_torques_are_no_error_of_the_model(tmp_path, domain):
    found = stream(30)
    with Session(tmp_path / 'scene.yaml', domain,
                 **{'qos_overrides./torque.subscription.depth': 5}) as session:
        session.play(found[:find(found, 9)])
        _, topic, data = next(message for message in found[find(found, 9):]
                              if message[1] == '/torque')
        lost = session.values('torques')['lost']
        while session.values('torques')['lost'] == lost:
            for _ in range(200):
                session.publishers[topic].publish(data)
            session.received += 200
            session.wait(lambda: session.count() >= session.received)
        session.play(found[find(found, 9):])
        session.wait(lambda: session.values('model').get('windows skipped: torques lost'))
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


def test_after_a_jump_of_simulated_time_the_check_begins_again(tmp_path, domain):
    found = stream(20)
    with Session(tmp_path / 'scene.yaml', domain, on_time_jump='reset') as session:
        session.play(found)
        for number, begin_ns in enumerate((BEGIN_NS, BEGIN_NS + 1000 * SECOND), 1):
            (_, topic, late), count = found[-1], len(session.errors['rate_error'])
            found = shifted(found, begin_ns - found[0][0])
            session.set_clock(begin_ns)
            session.wait(session.has_jumped, number)
            session.publishers[topic].publish(late)  # it was still on its way
            session.received += 1
            session.play(found)
            session.wait(session.has_judged, count + 6)
        counts = Counter()
        for name in NAMES:
            counts.update(session.values(name))
        assert counts['rejected: before the reset'] == 2
        assert not counts['rejected: late'] + counts['rejected: future']
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


@pytest.mark.nightly
def test_steps_of_the_wall_clock_are_no_error_of_the_model(tmp_path, domain):
    path, steps, shift_ns, windows = tmp_path / 'shift', [-30.0, 100.0, -0.25], 0, 3
    path.write_text('0')
    with Session(tmp_path / 'scene.yaml', domain, WITH_CLOCK.format(str(path)),
                 on_time_jump='reset', use_sim_time=False) as session:
        for stamp_ns, topic, data in shifted(stream(120), time.time_ns() - BEGIN_NS):
            session.wait(is_over, time.time_ns, stamp_ns)
            (_, _, data), = shifted([(stamp_ns, topic, data)], shift_ns)
            session.publishers[topic].publish(data)
            if session.has_judged(windows):
                if not steps:
                    break
                shift_ns += round(steps.pop(0) * SECOND)
                windows += 3
                (tmp_path / 'next').write_text(str(shift_ns))
                (tmp_path / 'next').replace(path)
        assert not steps
        session.wait(session.has_jumped, 3)
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


@pytest.mark.nightly
def test_restarts_of_the_sources_and_of_the_monitor_are_no_error_of_the_model(tmp_path, domain):
    found = stream(60)
    with Session(tmp_path / 'scene.yaml', domain) as session:
        session.play(found[:find(found, 15)])
        for publisher in session.publishers.values():
            session.node.destroy_publisher(publisher)
        session.publish()
        session.connect()
        session.play(found[find(found, 18):find(found, 33)])
        session.process.kill()
        session.process.wait()
        session.start()
        session.connect()
        count = len(session.errors['rate_error'])
        # The torques are found last.
        session.play([message for message in found[find(found, 33.5):]
                      if message[1] != '/torque' or message[0] > BEGIN_NS + 37 * SECOND])
        session.wait(session.has_judged, count + 8)
        assert b'\x02' not in session.levels()
        assert session.stop() == 0


@pytest.mark.parametrize(('line', 'words'), [
    ('monitor.rate_noise:=0.0', 'monitor.rate_noise: expected the standard deviation'),
    ('inertia_topic:=true', 'inertia_topic: expected false'),
    ('monitor.measured:=["a b"]', 'monitor.measured: expected names of topics'),
    ('monitor.measured:=["/imu", "/imu"]', 'monitor.measured: expected each topic once')])
def test_a_scene_that_cannot_be_checked_is_an_error_of_one_line(tmp_path, domain, line, words):
    session = Session(tmp_path / 'scene.yaml', domain)
    result = subprocess.run([*session._command, '-p', line], env=session._environment, check=False,
                            capture_output=True, text=True, timeout=PATIENCE)
    assert result.returncode == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1
