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
Measure processor time and memory of `attitude_monitor` at 200 Hz torque, 200 Hz IMU, 100 Hz mocap.

    python benchmarks/monitor_live.py [--before FOLDER] [--seconds 120] [--json FILE]

The model is right, windows last 5 s, and messages arrive in real time over DDS. A bare rclpy node
with the same subscriptions receives the same messages at the same time and drops them. With
`--before`, the monitor of another checkout receives them as well. Processor time is that of each
process, as a fraction of one processor: the median over blocks of 20 s. Memory is the resident
memory (RSS), once a minute.
"""

import argparse
import json
import os
from pathlib import Path
import statistics
import subprocess
import sys
import time

from geometry_msgs.msg import PoseStamped, WrenchStamped
import monitor as campaign
import numpy as np
import psutil
import rclpy
from rigid_body_ros import messages
from rigid_body_ros.node.process import executor_of
from sensor_msgs.msg import Imu

HERE = Path(__file__).resolve().parent.parent
RATES = TORQUE_HZ, MOCAP_HZ, IMU_HZ = 200, 100, 200
TOPICS = {'/torque': (WrenchStamped, messages.WRENCH), '/mocap': (PoseStamped, messages.POSE),
          '/imu': (Imu, messages.IMU)}
#: s; block for a value of processor time, interval between values of memory, and time before both.
BLOCK, MINUTE, SETTLED = 20.0, 60.0, 20.0
BARE = """
from geometry_msgs.msg import PoseStamped, WrenchStamped
import rclpy
from rigid_body_ros.node.process import executor_of
from sensor_msgs.msg import Imu
rclpy.init()
node, executor = rclpy.create_node('bare'), executor_of()
for kind, topic in ((WrenchStamped, '/torque'), (PoseStamped, '/mocap'), (Imu, '/imu')):
    node.create_subscription(kind, topic, lambda message: None, 1000, raw=True)
executor.add_node(node)
while rclpy.ok():
    executor.spin_once(timeout_sec=0.1)
"""
MONITOR = 'from rigid_body_ros.commands import main; main.attitude_monitor()'


def parameters():
    """Return the arguments that define the scene of the monitor."""
    entries = zip(('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz'),
                  campaign.INERTIA[np.triu_indices(3)].tolist())
    values = {**{f'inertia.{name}': value for name, value in entries},
              'torque_topics': '[/torque]', 'monitor.measured': '[/mocap, /imu]',
              'monitor.attitude_noise': campaign.ATTITUDE_NOISE,
              'monitor.rate_noise': campaign.RATE_NOISE}
    return [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]


class Process:
    """A process, with the processor time and the memory that it uses."""

    def __init__(self, program, *arguments, checkout=HERE):
        self._popen = subprocess.Popen([sys.executable, '-c', program, *arguments], cwd='/',
                                       env=os.environ | {'PYTHONPATH': str(checkout)})
        self._process = psutil.Process(self._popen.pid)
        self.shares, self.memory = [], []
        self._began, self._before = time.monotonic(), 0.0

    def end(self):
        """End a block of processor time, and begin the next."""
        now, used = time.monotonic(), self._used()
        self.shares.append((used - self._before) / (now - self._began))
        self._began, self._before = now, used

    def weigh(self):
        """Record the resident memory, MB."""
        self.memory.append(self._process.memory_info().rss * 1e-6)

    def _used(self):
        times = self._process.cpu_times()
        return times.user + times.system

    def stop(self):
        """End the process."""
        self._popen.kill()
        self._popen.wait()


def stream(seconds, begin_ns):
    """Generate the time, the topic and the content of each message to send, sorted by stamp."""
    no_orientation = [0.0] * 4 + [-1.0] + [0.0] * 8
    for torques, mocap, gyro in campaign.pieces(1, seconds, rates=RATES, piece=1):
        found = [(time_ns, '/torque', [0.0, 0.0, 0.0, *torque])
                 for time_ns, torque in zip(torques[0].tolist(), torques[1])]
        found += [(time_ns, '/mocap', [0.0, 0.0, 0.0, *attitude])
                  for time_ns, attitude in zip(mocap[0].tolist(), mocap[1])]
        found += [(time_ns, '/imu', [*no_orientation, *rate, *[0.0] * 21])
                  for time_ns, rate in zip(gyro[0].tolist(), gyro[1])]
        for time_ns, topic, values in sorted(found, key=lambda message: message[0]):
            stamp_ns = begin_ns + time_ns
            yield stamp_ns, topic, TOPICS[topic][1].encode(
                stamp_ns, 'world' if topic == '/mocap' else 'base_link', values)


class Driver:
    """Sends torques and measurements, and receives what the monitors publish."""

    def __init__(self, names):
        rclpy.init()
        self._node, self._executor = rclpy.create_node('driver'), executor_of()
        self._publishers = {topic: self._node.create_publisher(kind, topic, 1000)
                            for topic, (kind, _) in TOPICS.items()}
        #: The messages about its windows, by monitor.
        self.found = {name: [] for name in names}
        for name in names:
            self._node.create_subscription(
                WrenchStamped, f'/{name}/attitude_monitor/residual_torque',
                self.found[name].append, 1000, raw=True)
        self._executor.add_node(self._node)

    def connect(self, count):
        """Wait until this many processes subscribe to each topic."""
        while any(publisher.get_subscription_count() < count
                  for publisher in self._publishers.values()):
            self._executor.spin_once(timeout_sec=0.1)

    def send(self, seconds, on_block, on_minute):
        """Send messages at their times; call a function after each block and each minute."""
        begin_ns = time.time_ns()
        block_ns, minute_ns = (begin_ns + round(SETTLED * 1e9),) * 2
        for stamp_ns, topic, data in stream(seconds, begin_ns):
            while (rest_ns := stamp_ns - time.time_ns()) > 0:
                self._executor.spin_once(timeout_sec=1e-9 * rest_ns)
            self._publishers[topic].publish(data)
            if stamp_ns >= block_ns:
                on_block()
                block_ns += round(BLOCK * 1e9)
            if stamp_ns >= minute_ns:
                on_minute()
                minute_ns += round(MINUTE * 1e9)


def measure(seconds, checkouts):
    """Run for a time, s; return the processes by name, and the driver."""
    driver = Driver(checkouts)
    processes = {name: Process(
        MONITOR, '--ros-args', *parameters(), '-r', f'__ns:=/{name}', checkout=checkout)
        for name, checkout in checkouts.items()}
    processes['bare'] = Process(BARE)
    try:
        driver.connect(len(processes))
        driver.send(seconds, lambda: [one.end() for one in processes.values()],
                    lambda: [one.weigh() for one in processes.values()])
    finally:
        for one in processes.values():
            one.stop()
        rclpy.try_shutdown()
    return processes, driver


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--before', type=Path, help='another checkout to compare with')
    parser.add_argument('--seconds', type=int, default=120, help='at least 60')
    parser.add_argument('--json', type=Path, help='write the figures')
    arguments = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    checkouts = {'this': HERE} | ({'before': arguments.before.resolve()} if arguments.before
                                  else {})
    processes, driver = measure(arguments.seconds, checkouts)
    print(f'{"":10}{"processor":>10}{"windows":>9}{"RSS, MB: first":>16}{"last":>7}{"most":>7}')
    for name, one in processes.items():
        windows = len(driver.found[name]) if name in checkouts else ''
        print(f'{name:10}{statistics.median(one.shares[1:]):10.2%}{windows:>9}'
              f'{one.memory[0]:16.1f}{one.memory[-1]:7.1f}{max(one.memory):7.1f}')
    if arguments.before:
        same = sum(one == other for one, other in zip(*driver.found.values()))
        print(f'residual torques with the same bits: {same}')
    if arguments.json:
        arguments.json.write_text(json.dumps(
            {name: {'shares': one.shares, 'memory': one.memory}
             for name, one in processes.items()}, indent=1))


if __name__ == '__main__':
    main()
