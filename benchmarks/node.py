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
Compare the cost of the node with that of a bare rclpy node that only receives and publishes.

    python benchmarks/node.py [--json FILE]

Torques arrive at 1 kHz in lockstep, and the node publishes three topics. Rounds of the two nodes
alternate. Latency is the time from a torque to its attitude, seen from outside. Processor time is
that of the node's process per torque. A ratio is ours / floor, the median over the rounds. The
first torque of each node is timed separately, and compared with the thousandth. Both nodes keep
the last ten messages for a subscription. Messages that this process is too slow to receive are
counted, but have no latency.
"""

import argparse
import json
import os
from pathlib import Path
import subprocess
import sys
import time

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
import numpy as np
import psutil
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rigid_body_ros import messages

HERE = Path(__file__).resolve().parent
RATE, ROUNDS, TORQUES = 1000, 10, 2000
OURS, FLOOR = '/ours', '/floor'
COMMANDS = {
    OURS: ['-c', 'from rigid_body_ros.commands import main; main.attitude_node()', '--ros-args',
           '--params-file', str(HERE.parent / 'config' / 'tumbler.yaml'), '-p', 'mode:=lockstep'],
    FLOOR: [str(HERE / 'floor_node.py'), '--ros-args']}
#: Largest allowed ratios of median latency, 99th percentile and processor time.
BARS = {'median': 1.25, 'p99': 1.5, 'processor': 1.25}


class Client:
    """Sends torques to a node in its namespace, and times the responses."""

    def __init__(self, namespace, executor):
        command = [sys.executable, *COMMANDS[namespace], '-r', f'__ns:={namespace}']
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        self._usage = psutil.Process(self._process.pid)
        self._executor = executor
        self._node = rclpy.create_node('client', namespace=namespace)
        executor.add_node(self._node)
        self._torque = self._node.create_publisher(WrenchStamped, 'torque', 1000)
        self._sent, self.latencies, self.missed = {}, [], 0
        self._stamp_ns = 10 ** 9
        for topic, kind, callback in (('attitude', QuaternionStamped, self._on_attitude),
                                      ('euler_angles', Vector3Stamped, lambda data: None),
                                      ('angular_velocity', Vector3Stamped, lambda data: None)):
            self._node.create_subscription(kind, topic, callback, 1000, raw=True)

    def connected(self):
        """Return whether publisher and subscription are both connected."""
        return self._torque.get_subscription_count() and \
            self._node.count_publishers(f'{self._node.get_namespace()}/attitude')

    def time_round(self):
        """Return the median and 99th percentile of latency, and processor time per torque, s."""
        self._sent.clear()
        self.latencies.clear()
        before = self._used()
        due = time.perf_counter()
        for number in range(TORQUES):
            due += 1 / RATE
            while (rest := due - time.perf_counter()) > 0.0:
                self._executor.spin_once(timeout_sec=rest)
            self._stamp_ns += 10 ** 9 // RATE
            data = messages.wrench(self._stamp_ns, 'base_link',
                                   [1e-3 * np.sin(0.1 * number), 1e-3, 0.0])
            self._sent[self._stamp_ns // 10 ** 6] = time.perf_counter()
            self._torque.publish(data)
        until = time.perf_counter() + 10.0
        while self._stamp_ns // 10 ** 6 in self._sent:  # the last response
            assert time.perf_counter() < until, 'no response to the last torque'
            self._executor.spin_once(timeout_sec=0.01)
        self.missed += len(self._sent)
        return (*np.percentile(self.latencies, [50, 99]), (self._used() - before) / TORQUES)

    def _used(self):
        times = self._usage.cpu_times()
        return times.user + times.system

    def _on_attitude(self, data):
        now = time.perf_counter()
        stamp_ns = messages.QUATERNION.decode(data).stamp_ns
        if self._node.get_namespace() == OURS:
            stamp_ns -= 10 ** 6  # the response is one step, 1 ms, ahead
        sent = self._sent.pop(stamp_ns // 10 ** 6, None)
        if sent is not None:
            self.latencies.append(now - sent)

    def stop(self):
        """End the node."""
        self._process.terminate()
        self._process.wait()


def measure():
    """Return the rounds, shape (ROUNDS, 3), early latencies, s, and counts of missed responses."""
    rclpy.init()
    executor = SingleThreadedExecutor()
    clients = {name: Client(name, executor) for name in COMMANDS}
    try:
        while not all(client.connected() for client in clients.values()):
            executor.spin_once(timeout_sec=0.1)
        early = {}
        for name, client in clients.items():  # a round for warming up
            client.time_round()
            client.missed = 0
            early[name] = client.latencies[0], client.latencies[999]
        rounds = {name: [] for name in clients}
        for _ in range(ROUNDS):
            for name, client in clients.items():
                rounds[name].append(client.time_round())
    finally:
        for client in clients.values():
            client.stop()
        rclpy.try_shutdown()
    return ({name: np.array(values) for name, values in rounds.items()}, early,
            {name: client.missed for name, client in clients.items()})


def main():
    """Print the table, and mark values beyond their limits."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--json', type=Path, help='write the figures')
    arguments = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    rounds, early, missed = measure()
    ours, floor = np.median(rounds[OURS], axis=0), np.median(rounds[FLOOR], axis=0)
    ratios = np.median(rounds[OURS] / rounds[FLOOR], axis=0)
    print(f'{"us":12}{"ours":>8}{"floor":>8}{"ratio":>8}{"bar":>8}')
    for (name, bar), a, b, ratio in zip(BARS.items(), ours, floor, ratios):
        print(f'{name:12}{a * 1e6:8.0f}{b * 1e6:8.0f}{ratio:8.2f}{bar:8.2f}'
              f'{"" if ratio <= bar else "  MISS"}')
    for row, label in enumerate(('first', 'thousandth')):
        print(f'{label:12}{early[OURS][row] * 1e6:8.0f}{early[FLOOR][row] * 1e6:8.0f}')
    print(f'not received: {missed[OURS]} and {missed[FLOOR]} of {ROUNDS * TORQUES}')
    if arguments.json:
        arguments.json.write_text(json.dumps(
            {name: values.tolist() for name, values in rounds.items()}, indent=1))


if __name__ == '__main__':
    main()
