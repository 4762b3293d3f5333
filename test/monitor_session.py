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

"""Run the node `attitude_monitor` in a separate process, send messages to it, and record it."""

import os
import signal
import subprocess
import sys
import time

from conftest import ROOT, SECOND
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rigid_body_ros import messages, scene
from rosgraph_msgs.msg import Clock
import yaml

sys.path.insert(0, str(ROOT / 'benchmarks'))
import monitor as campaign  # noqa: E402, I100

#: s; how long to wait for anything.
PATIENCE = 120.0
PROGRAM = ('import sys; from rigid_body_ros.commands import main; '
           'sys.exit(main.attitude_monitor())')
#: The same, but its wall clock and that of the middleware are ahead by the ns in a file.
WITH_CLOCK = """
from pathlib import Path
from rclpy.clock import Clock
from rclpy.duration import Duration
from rigid_body_ros.node.intake import DrainCallback
now, pass_on, shift = Clock.now, DrainCallback.pass_on, Path({!r})
def passed_on(drain, message, info):
    info['received_timestamp'] += int(shift.read_text())
    pass_on(drain, message, info)
Clock.now = lambda clock: now(clock) + Duration(nanoseconds=int(shift.read_text()))
DrainCallback.pass_on = passed_on
""" + PROGRAM
BEGIN_NS = 1000 * SECOND
#: ns; simulated time per second. If it were ten times as fast as real time, it might count as a
#: jump.
FASTER = 6 * SECOND
TOPICS = {'/torque': (WrenchStamped, messages.WRENCH), '/mocap': (QuaternionStamped,
          messages.QUATERNION), '/gyro': (Vector3Stamped, messages.VECTOR3)}
#: The names of these inputs in diagnostics.
NAMES = 'torques', 'measured /mocap', 'measured /gyro'


def stream(seconds, **wrong):
    """Return stamps, topics and messages, sorted by stamp."""
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
    """A monitor in a separate process, and what it publishes."""

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
        self._domain, self.names = domain, NAMES

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
        """Create the publishers of all inputs of the monitor."""
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
        """Wait until the monitor receives all topics and the clock, and its outputs arrive."""
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
        """Publish a time and a message; return whether messages have arrived since `before`."""
        self.set_clock(self.now_ns)
        publisher.publish(data)
        return self.values(name)['rejected: unknown frame'] > before

    def count(self):
        """Return the number of messages that have arrived, or are known to be lost."""
        return sum(self.values(name)[key] for name in self.names for key in ('received', 'lost'))

    def play(self, found):
        """Publish messages no faster than the monitor judges them, and wait for all to arrive."""
        began = time.monotonic() - found[0][0] / FASTER
        for number, (stamp_ns, topic, data) in enumerate(found):
            if not number % 20:
                self.wait(is_over, time.monotonic, began + stamp_ns / FASTER)
                self.set_clock(stamp_ns)
            self.publishers[topic].publish(data)
            self.wait(self.keeps_up, stamp_ns, number)
        self.set_clock(found[-1][0])
        # Some of the earlier messages may still have been in transit.
        self.received += len(found)
        self.wait(lambda: self.count() >= self.received)

    def keeps_up(self, stamp_ns, number):
        """Return whether the monitor has almost caught up with the last message."""
        errors = self.errors['rate_error']
        last_ns = messages.VECTOR3.decode(errors[-1]).stamp_ns if errors else BEGIN_NS
        # If an input is silent, no window may be judged.
        return last_ns > stamp_ns - 4 * SECOND or self.count() + 400 > self.received + number

    def has_judged(self, count):
        """Return whether this many windows have been judged."""
        return len(self.errors['rate_error']) >= count

    def has_jumped(self, count):
        """Return whether the monitor has noticed this many jumps of the clock."""
        return self.values('motion')['clock jumps'] == count

    def is_silent(self, name):
        """Return whether the monitor has reported an input as silent."""
        return 'nothing for' in self.status(name).message

    def set_clock(self, stamp_ns):
        clock, self.now_ns = Clock(), stamp_ns
        clock.clock.sec, clock.clock.nanosec = divmod(stamp_ns, SECOND)
        self.clock.publish(clock)

    def status(self, name):
        """Return the latest status with this name."""
        return next(status for array in reversed(self.diagnostics) for status in array.status
                    if status.name == f'/attitude_monitor: {name}')

    def values(self, name):
        return {pair.key: int(pair.value) for pair in self.status(name).values
                if pair.value.isdigit()}

    def levels(self):
        """Return the levels that the status of the model has had."""
        return {status.level for array in self.diagnostics for status in array.status
                if status.name.endswith(': model')}

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)


def is_over(clock, until):
    """Return whether a time is over."""
    return clock() > until


def shifted(found, shift_ns):
    """Return messages with shifted stamps."""
    return [(stamp_ns + shift_ns, topic, TOPICS[topic][1].encode(
        stamp_ns + shift_ns, '', TOPICS[topic][1].decode(data).values))
        for stamp_ns, topic, data in found]


def find(found, seconds):
    """Return the index of the first message from a time on."""
    return next(row for row, (stamp_ns, _, _) in enumerate(found)
                if stamp_ns >= BEGIN_NS + seconds * SECOND)
