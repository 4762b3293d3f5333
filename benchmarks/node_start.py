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
Measure the start of the node, from its command to its first state, and its memory.

    python benchmarks/node_start.py [--before FOLDER] [--bare] [--count 10]

Each start is a new process. On a busy machine, compare processor times. Memory is that of the
process when its first state arrives: resident (VmRSS), and without what it shares with other
processes (USS). `--before` alternates with another checkout, and `--bare` with a bare rclpy node
that publishes one topic. Set FASTDDS_BUILTIN_TRANSPORTS=UDPv4 to measure without shared memory.
"""

import argparse
import os
from pathlib import Path
import statistics
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from geometry_msgs.msg import QuaternionStamped
import psutil
import rclpy

HERE = Path(__file__).resolve().parent.parent
COMMAND = [sys.executable, '-c', 'from rigid_body_ros.commands import main; main.attitude_node()',
           '--ros-args', '--params-file', str(HERE / 'config' / 'tumbler.yaml')]
BARE = [sys.executable, str(HERE / 'benchmarks' / 'timer_node.py'), '--ros-args']


def environment_of(checkout, code):
    """Return an environment that imports from a checkout, with a folder for Python's bytecode."""
    environment = {**os.environ, 'PYTHONPATH': str(checkout), 'PYTHONPYCACHEPREFIX': str(code)}
    environment.pop('PYTHONDONTWRITEBYTECODE', None)
    return environment


def start(node, environment, command=COMMAND):
    """Return the time and processor time, s, and the memory, MB, up to the first state."""
    namespace, received = f'/start_{time.monotonic_ns()}', []
    subscription = node.create_subscription(QuaternionStamped, f'{namespace}/attitude',
                                            received.append, 10)
    began = time.perf_counter()
    process = subprocess.Popen([*command, '-r', f'__ns:={namespace}'], env=environment, cwd='/',
                               stderr=subprocess.DEVNULL)
    try:
        while not received:
            rclpy.spin_once(node, timeout_sec=1.0)
            if process.poll() is not None:
                raise RuntimeError(f'the node ended with status {process.returncode}')
        seconds = time.perf_counter() - began
        usage = psutil.Process(process.pid)
        memory, used = usage.memory_full_info(), usage.cpu_times()
    finally:
        process.kill()
        process.wait()
        node.destroy_subscription(subscription)
    return seconds, used.user + used.system, memory.rss / 1e6, memory.uss / 1e6


def main():
    """Print the medians."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--before', type=Path, help='another checkout to compare with')
    parser.add_argument('--bare', action='store_true', help='compare with a bare rclpy node')
    parser.add_argument('--count', type=int, default=10, help='number of starts')
    arguments = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    checkouts = {'this': HERE} | ({'before': arguments.before.resolve()} if arguments.before
                                  else {})
    commands = dict.fromkeys(checkouts, COMMAND) | ({'bare': BARE} if arguments.bare else {})
    checkouts |= {'bare': HERE} if arguments.bare else {}
    rclpy.init()
    node = rclpy.create_node('observer')
    runs = {name: [] for name in checkouts}
    with TemporaryDirectory() as code:
        for name, checkout in checkouts.items():  # compile bytecode first, as an installation does
            start(node, environment_of(checkout, code), commands[name])
        for _ in range(arguments.count):
            for name, checkout in checkouts.items():
                runs[name].append(start(node, environment_of(checkout, code), commands[name]))
    rclpy.try_shutdown()
    print(f'{"median":16}{"s":>8}{"CPU s":>8}{"RSS MB":>8}{"USS MB":>8}{"of":>5}')
    for name, rows in runs.items():
        print(f'{name:16}' + '{:8.2f}{:8.2f}{:8.0f}{:8.0f}{:5d}'.format(
            *(statistics.median(column) for column in zip(*rows)), len(rows)))


if __name__ == '__main__':
    main()
