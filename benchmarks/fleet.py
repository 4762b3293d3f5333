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
Measure a fleet: eight nodes, each publishing at 100 Hz, first idle, then with torques at 100 Hz.

    python benchmarks/fleet.py [--nodes 8] [--rate 100] [--seconds 10]

Processor time is that of each node's process, as a fraction of one processor. Memory is resident
memory (RSS), the same with shared pages divided among the processes (PSS), and without shared
pages (USS).
"""

import argparse
import statistics
import subprocess
import time

from geometry_msgs.msg import QuaternionStamped, WrenchStamped
from processes import command, isolate, processor_time, SCENE
import psutil
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rigid_body_ros import messages

#: Hz
TORQUE_RATE = 100


class Body:
    """A node in its own namespace, with a publisher of torques and a subscription to states."""

    def __init__(self, observer, number, rate):
        namespace = f'/body_{number}'
        self.process, self.states = psutil.Popen(
            command('attitude_node', '--ros-args', '--params-file', SCENE, '-r',
                    f'__ns:={namespace}', '-p', f'publish_rate:={rate}'),
            stderr=subprocess.DEVNULL), 0
        self.torque = observer.create_publisher(WrenchStamped, f'{namespace}/torque', 10)
        observer.create_subscription(QuaternionStamped, f'{namespace}/attitude', self._on_state,
                                     100, raw=True)

    def _on_state(self, data):
        self.states += 1

    def stop(self):
        """End the node."""
        self.process.terminate()
        self.process.wait()


def measure(executor, bodies, seconds, with_torques):
    """Return the fraction of a processor and the rate of states of each node."""
    before = [(processor_time(body.process), body.states) for body in bodies]
    began = due = time.perf_counter()
    while (now := time.perf_counter()) < began + seconds:
        if with_torques and now >= due:
            due += 1 / TORQUE_RATE
            data = messages.wrench(0, 'base_link', [1e-4, 0.0, 0.0])  # stamp 0: on arrival
            for body in bodies:
                body.torque.publish(data)
        executor.spin_once(timeout_sec=0.001)
    taken = time.perf_counter() - began
    return [((processor_time(body.process) - used) / taken, (body.states - states) / taken)
            for body, (used, states) in zip(bodies, before)]


def main():
    """Print a line for each phase, then the memory."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--nodes', type=int, default=8)
    parser.add_argument('--rate', type=float, default=100.0, help='states per second, Hz')
    parser.add_argument('--seconds', type=float, default=10.0)
    arguments = parser.parse_args()
    isolate()
    rclpy.init()
    observer, executor = rclpy.create_node('observer'), SingleThreadedExecutor()
    executor.add_node(observer)
    began = time.perf_counter()
    bodies = [Body(observer, number, arguments.rate)
              for number in range(1, arguments.nodes + 1)]
    try:
        while not all(body.states for body in bodies):
            executor.spin_once(timeout_sec=0.1)
        print(f'{arguments.nodes} nodes publish after {time.perf_counter() - began:.1f} s')
        print(f'{"median of nodes":20}{"processor":>12}{"states/s":>10}')
        for label, with_torques in (('idle', False), (f'torques at {TORQUE_RATE} Hz', True)):
            rows = measure(executor, bodies, arguments.seconds, with_torques)
            share, rate = (statistics.median(column) for column in zip(*rows))
            print(f'{label:20}{share:11.1%} {rate:9.1f}')
        memory = [body.process.memory_full_info() for body in bodies]
        for name in ('rss', 'pss', 'uss'):
            values = [getattr(row, name) / 1e6 for row in memory]
            print(f'{name.upper():20}{statistics.median(values):9.0f} MB')
    finally:
        for body in bodies:
            body.stop()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
