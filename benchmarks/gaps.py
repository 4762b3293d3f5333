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

"""
Measure for how long the outputs of the node stop under torques at 1, 1.5 and 2 kHz.

    python benchmarks/gaps.py [--busy 1] [--log] [--idle] [--rounds 3]

`--busy` keeps this many processors busy with other work. `--log` subscribes to the log, too.
`--idle` instead compares the processor times of the two nodes when nobody sends or listens: the
node with `config/robot_stack.yaml`, and the bare node with as many topics.

The node and a bare rclpy node with the same executor (`timer_node.py`) alternate; each round
starts one of them. A single process sends the torques and receives the outputs, because on two
processors, two processes would take more processor time from the node. This process needs no
executor: between two torques, it takes the messages that have arrived, and the middleware has
recorded their times of arrival.

The columns are:

- gap, worst: the longest time between the arrivals of two outputs, in the median and in the worst
  round. If the outputs stop, the gap ends with the first output, even after the last torque.
- by stamp: the longest time between the stamps of two outputs.
- outputs: per second.
- age, 99 %: the time from the stamp of an output to its arrival, median and 99th percentile.
- applied: torques per second.
- us each: the processor time of the node per applied torque.
- late: the largest delay in sending a torque. If this is long, the machine has other load.

All values but `worst` and `late` are medians over the rounds.
"""

import argparse
from contextlib import contextmanager, ExitStack
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
import psutil
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rigid_body_ros import messages
from rigid_body_ros.live.events import APPLIED

HERE = Path(__file__).resolve().parent
#: Rates of torques, Hz, number of rounds, and duration of the torques in a round, s.
RATES, SECONDS = (1000, 1500, 2000), 5.0
#: s; how long a node may take to start, to publish again after the torques, and to end.
PATIENCE = 60.0
OURS, BARE = 'ours', 'bare'
COMMANDS = {
    OURS: ['-c', 'from rigid_body_ros.commands import main; main.attitude_node()', '--ros-args',
           '--params-file', str(HERE.parent / 'config' / 'tumbler.yaml'),
           '-p', 'publish_rate:=100.0'],
    BARE: [str(HERE / 'timer_node.py'), '--ros-args']}
IDLE = {OURS: [*COMMANDS[OURS][:4], str(HERE.parent / 'config' / 'robot_stack.yaml')],
        BARE: [*COMMANDS[BARE], '-p', 'rate:=200.0', '-p', 'all_topics:=true']}
#: s; how long an idle node is measured.
IDLE_SECONDS = 10.0
#: The largest ratios of processor times: for a torque at the lowest rate, and idle.
PER_TORQUE, WHEN_IDLE = 1.5, 1.2
#: The longest gap may be this long, s, or this many times as long as that of the bare node.
GAP, GAP_BUSY, TIMES = 0.1, 0.25, 3.0


class Round(NamedTuple):
    """
    The measurements of a round.

    Attributes
    ----------
    gap, stamp_gap : float, s
        Longest time between two outputs, by arrival and by stamp.
    outputs : float, Hz
    age, age_99 : float, s
        Time from the stamp of an output to its arrival: median and 99th percentile.
    applied : float, Hz
    processor : float, s
        Processor time of the node per applied torque.
    late : float, s
        Largest delay in sending a torque.

    """

    gap: float
    stamp_gap: float
    outputs: float
    age: float
    age_99: float
    applied: float
    processor: float
    late: float


class Client:
    """Sends torques to a node, and receives its outputs and diagnostics."""

    def __init__(self, process, is_logged):
        self._usage = psutil.Process(process.pid)
        self._node = rclpy.create_node('client')
        self._torque = self._node.create_publisher(WrenchStamped, 'torque', QoSProfile(
            depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT))
        self._attitude, self._diagnostics = (
            self._node.create_subscription(kind, topic, lambda data: None, 1000, raw=True)
            for kind, topic in ((QuaternionStamped, 'attitude'),
                                (DiagnosticArray, '/diagnostics')))
        self._log = [
            self._node.create_subscription(kind, f'attitude_node/{topic}', lambda data: None,
                                           10_000, raw=True)
            for kind, topic in ((WrenchStamped, 'accepted_torque'), (Odometry, 'committed'))
            if is_logged]
        #: Time of arrival, ns, and data of each output.
        self._outputs = []
        #: For each diagnosis: time of arrival, ns, data, and processor time of the node so far, s.
        self._diagnoses = []

    def destroy(self):
        """Destroy the node of this client."""
        self._node.destroy_node()

    def connect(self):
        """Send torques until the node applies them."""
        until = time.monotonic() + PATIENCE
        while not (self._outputs and self._diagnoses and _applied(self._diagnoses[-1][1])):
            assert time.monotonic() < until, 'the node applies no torques'
            self.send(100, 0.1)

    def send(self, rate, seconds):
        """Send torques at equal intervals; return the largest delay, s."""
        late, began = 0.0, time.monotonic()
        for number in range(round(rate * seconds)):
            self._take()
            due = began + number / rate
            time.sleep(max(0.0, due - time.monotonic()))
            late = max(late, time.monotonic() - due)
            self._torque.publish(messages.wrench(
                time.time_ns(), '', [1e-3 * np.sin(0.1 * number), 1e-3, 0.0]))
        return late

    def measure(self, rate):
        """Send torques, and return the Round."""
        began_ns = time.time_ns()
        late = self.send(rate, SECONDS)
        ended_ns = time.time_ns()
        until = time.monotonic() + PATIENCE
        while self._outputs[-1][0] < ended_ns:
            assert time.monotonic() < until, 'no output after the torques'
            time.sleep(0.001)
            self._take()
        return Round(*self._output_figures(began_ns, ended_ns),
                     *self._torque_figures(began_ns, ended_ns), late)

    def _output_figures(self, began_ns, ended_ns):
        arrivals = np.array([arrival_ns for arrival_ns, _ in self._outputs])
        stamps = np.array([messages.QUATERNION.decode(data).stamp_ns for _, data in self._outputs])
        # From the last output before the torques to the first one after them.
        first, last = np.searchsorted(arrivals, began_ns) - 1, np.searchsorted(arrivals, ended_ns)
        arrivals, stamps = arrivals[first:last + 1] * 1e-9, stamps[first:last + 1] * 1e-9
        ages = np.percentile(arrivals - stamps, [50, 99])
        return (max(np.diff(arrivals)), max(np.diff(stamps)), (last - first - 1) / SECONDS, *ages)

    def _torque_figures(self, began_ns, ended_ns):
        during = [row for row in self._diagnoses if began_ns < row[0] < ended_ns]
        (began_ns, first, used), (ended_ns, last, used_last) = during[0], during[-1]
        applied = _applied(last) - _applied(first)
        return applied / (ended_ns - began_ns) * 1e9, (used_last - used) / applied

    def _take(self):
        self._outputs += _taken(self._attitude)
        for subscription in self._log:
            list(_taken(subscription))
        for arrival_ns, data in _taken(self._diagnostics):
            times = self._usage.cpu_times()
            self._diagnoses.append((arrival_ns, data, times.user + times.system))


def _taken(subscription):
    """Yield the time of arrival, ns, and the data of each message waiting in a subscription."""
    with subscription.handle:
        while found := subscription.handle.take_message(subscription.msg_type, subscription.raw):
            data, info = found
            yield info['received_timestamp'], data


def _applied(data):
    return next(int(pair.value) for status in deserialize_message(data, DiagnosticArray).status
                if status.name.endswith(': torques') for pair in status.values
                if pair.key == APPLIED)


@contextmanager
def running(command):
    """Run a Python process within the context."""
    with subprocess.Popen([sys.executable, *command], stderr=subprocess.DEVNULL) as process:
        try:
            yield process
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)
        finally:
            process.kill()


@contextmanager
def connected(name, is_logged=False):
    """Run a node, and connect a client."""
    log = ['-p', f'log:={str(is_logged).lower()}'] if name == BARE else []
    with running([*COMMANDS[name], *log]) as process:
        client = Client(process, is_logged)
        try:
            client.connect()
            yield client
        finally:
            client.destroy()


@contextmanager
def busy(count):
    """Keep some processors busy within the context."""
    with ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(running(['-c', 'while True: pass']))
        yield


def measure(domain, rounds=3, processors=0, is_logged=False):
    """Measure in a ROS domain; return the rounds by rate and node, each as an array."""
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    rclpy.init()
    found = {(rate, name): [] for rate in RATES for name in COMMANDS}
    try:
        with busy(processors):
            for _ in range(rounds):
                for (rate, name), each in found.items():
                    with connected(name, is_logged) as client:
                        each.append(client.measure(rate))
    finally:
        rclpy.try_shutdown()
    return {key: np.array(each) for key, each in found.items()}


def idle(domain, rounds):
    """Print the share of a processor that idle nodes use; return the exit status."""
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    shares = {name: [] for name in IDLE}
    for _ in range(rounds):
        for name, command in IDLE.items():
            with running(command) as process:
                time.sleep(5.0)  # the start
                usage = psutil.Process(process.pid)
                before = usage.cpu_times()
                time.sleep(IDLE_SECONDS)
                after = usage.cpu_times()
            shares[name].append((after.user + after.system - before.user - before.system)
                                / IDLE_SECONDS)
    ratio = np.median(np.divide(shares[OURS], shares[BARE]))
    print(f'idle: ours {np.median(shares[OURS]):.1%}, bare {np.median(shares[BARE]):.1%} of a '
          f'processor, ratio {ratio:.2f}{"  MISS" if ratio > WHEN_IDLE else ""}')
    return int(ratio > WHEN_IDLE)


def printed(rounds, gap=GAP):
    """Print a table that marks gaps beyond their limits; return the exit status."""
    print(f'{"":9}{"gap, ms":>8}{"worst":>8}{"bar":>8}{"by stamp":>10}{"outputs":>9}'
          f'{"age, ms":>9}{"99 %":>8}{"applied":>9}{"us each":>9}{"late, ms":>10}')
    status = 0
    for (rate, name), found in rounds.items():
        median, worst = Round(*np.median(found, axis=0)), Round(*np.max(found, axis=0))
        bar = max(gap, TIMES * np.max(rounds[rate, BARE], axis=0)[0])
        is_missed = name == OURS and worst.gap > bar
        print(f'{rate:<5}{name:4}{median.gap * 1e3:8.0f}{worst.gap * 1e3:8.0f}'
              + (f'{bar * 1e3:8.0f}' if name == OURS else f'{"":8}')
              + f'{median.stamp_gap * 1e3:10.0f}{median.outputs:9.1f}{median.age * 1e3:9.2f}'
              f'{median.age_99 * 1e3:8.2f}{median.applied:9.0f}{median.processor * 1e6:9.0f}'
              f'{worst.late * 1e3:10.1f}{"  MISS" if is_missed else ""}')
        status |= is_missed
    ratio = np.median(np.divide(*(rounds[RATES[0], name][:, Round._fields.index('processor')]
                                  for name in (OURS, BARE))))
    print(f'processor time per torque at {RATES[0]} Hz, ours / bare: {ratio:.2f}'
          f'{"  MISS" if ratio > PER_TORQUE else ""}')
    return int(status)


def main():
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().partition('\n')[0])
    parser.add_argument('--busy', type=int, default=0, help='number of busy processors')
    parser.add_argument('--log', action='store_true', help='subscribe to the log')
    parser.add_argument('--idle', action='store_true', help='measure idle nodes instead')
    parser.add_argument('--rounds', type=int, default=3)
    arguments = parser.parse_args()
    domain = int(os.environ.get('ROS_DOMAIN_ID', 1 + os.getpid() % 100))
    if arguments.idle:
        return idle(domain, arguments.rounds)
    rounds = measure(domain, arguments.rounds, arguments.busy, arguments.log)
    return printed(rounds, GAP if arguments.busy < 2 else GAP_BUSY)


if __name__ == '__main__':
    sys.exit(main())
