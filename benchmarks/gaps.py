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

    python benchmarks/gaps.py

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

from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, WrenchStamped
import numpy as np
import psutil
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rigid_body_ros import messages
from rigid_body_ros.node.diagnostics import APPLIED

HERE = Path(__file__).resolve().parent
#: Rates of torques, Hz, number of rounds, and duration of the torques in a round, s.
RATES, ROUNDS, SECONDS = (1000, 1500, 2000), 3, 5.0
#: s; how long a node may take to start, to publish again after the torques, and to end.
PATIENCE = 60.0
OURS, BARE = 'ours', 'bare'
COMMANDS = {
    OURS: ['-c', 'from rigid_body_ros.commands import main; main.attitude_node()', '--ros-args',
           '--params-file', str(HERE.parent / 'config' / 'tumbler.yaml'),
           '-p', 'publish_rate:=100.0'],
    BARE: [str(HERE / 'timer_node.py')]}
#: The longest gap may be this long, s, or this many times as long as that of the bare node.
GAP, TIMES = 0.1, 3.0


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

    def __init__(self, process):
        self._usage = psutil.Process(process.pid)
        self._node = rclpy.create_node('client')
        self._torque = self._node.create_publisher(WrenchStamped, 'torque', QoSProfile(
            depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT))
        self._attitude, self._diagnostics = (
            self._node.create_subscription(kind, topic, lambda data: None, 1000, raw=True)
            for kind, topic in ((QuaternionStamped, 'attitude'),
                                (DiagnosticArray, '/diagnostics')))
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
def connected(name):
    """Run a node, and connect a client."""
    with subprocess.Popen([sys.executable, *COMMANDS[name]], stderr=subprocess.DEVNULL) as process:
        client = Client(process)
        try:
            client.connect()
            yield client
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)
        finally:
            process.kill()
            client.destroy()


def measure(domain):
    """Measure in a ROS domain; return the rounds by rate and node, each as an array."""
    os.environ |= {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    rclpy.init()
    rounds = {(rate, name): [] for rate in RATES for name in COMMANDS}
    try:
        for _ in range(ROUNDS):
            for (rate, name), found in rounds.items():
                with connected(name) as client:
                    found.append(client.measure(rate))
    finally:
        rclpy.try_shutdown()
    return {key: np.array(found) for key, found in rounds.items()}


def printed(rounds):
    """Print a table that marks gaps beyond their limits; return the exit status."""
    print(f'{"":9}{"gap, ms":>8}{"worst":>8}{"bar":>8}{"by stamp":>10}{"outputs":>9}'
          f'{"age, ms":>9}{"99 %":>8}{"applied":>9}{"us each":>9}{"late, ms":>10}')
    status = 0
    for (rate, name), found in rounds.items():
        median, worst = Round(*np.median(found, axis=0)), Round(*np.max(found, axis=0))
        bar = max(GAP, TIMES * np.max(rounds[rate, BARE], axis=0)[0])
        is_missed = name == OURS and worst.gap > bar
        print(f'{rate:<5}{name:4}{median.gap * 1e3:8.0f}{worst.gap * 1e3:8.0f}'
              + (f'{bar * 1e3:8.0f}' if name == OURS else f'{"":8}')
              + f'{median.stamp_gap * 1e3:10.0f}{median.outputs:9.1f}{median.age * 1e3:9.2f}'
              f'{median.age_99 * 1e3:8.2f}{median.applied:9.0f}{median.processor * 1e6:9.0f}'
              f'{worst.late * 1e3:10.1f}{"  MISS" if is_missed else ""}')
        status |= is_missed
    return int(status)


def main():
    """Measure, and print the table."""
    return printed(measure(int(os.environ.get('ROS_DOMAIN_ID', 1 + os.getpid() % 100))))


if __name__ == '__main__':
    sys.exit(main())
