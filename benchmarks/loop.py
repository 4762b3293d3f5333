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
Compare a closed loop with two bare rclpy nodes that send each other the same messages.

    python benchmarks/loop.py [--rounds 25] [--json FILE]

The loop is `attitude_node` in lockstep, with a step of 1 ms, and `attitude_controller`. The bare
nodes are those of `bare_loop.py`. All use the executor of the package, and rounds of the two loops
alternate. The times are per step: wall time, and processor time of the node and of the controller,
which runs in this process. A ratio is ours / bare, the median over the rounds.
"""

import argparse
import json
import os
from pathlib import Path
import subprocess
import sys
import time

from bare_loop import BareController, STEP_NS
import numpy as np
import psutil
import rclpy
from rclpy.signals import SignalHandlerOptions
from rigid_body_ros.node.attitude_controller import AttitudeController
from rigid_body_ros.node.process import executor_of, spin

HERE = Path(__file__).resolve().parent
#: Number of states in a round before timing starts, and number of timed states.
WARM, STATES = 200, 1000
#: s; a loop that takes longer is considered stuck.
LONGEST = 120.0
OURS, BARE = '/ours', '/bare'
NODES = {
    OURS: ['-c', 'from rigid_body_ros.commands import main; main.attitude_node()', '--ros-args',
           '--params-file', str(HERE.parent / 'config' / 'tumbler.yaml'), '-p', 'mode:=lockstep',
           '-p', f'step:={STEP_NS / 1e9}'],
    BARE: [str(HERE / 'bare_loop.py'), '--ros-args']}
NAMES = 'wall', 'node', 'controller'
#: Largest allowed ratio of wall times.
BAR = 1.3


class Timed:
    """A controller that records when it has received WARM states, and STATES more."""

    count = 0

    def __init__(self, process):
        self._process, self.marks, self._began = process, [], time.monotonic()
        super().__init__()

    def create_subscription(self, kind, topic, callback, qos):
        """Create a subscription whose callback also counts the states."""
        def on_state(state):
            self.count += 1
            if self.count in (WARM, WARM + STATES):
                used = self._process.cpu_times()
                self.marks.append((time.perf_counter(), used.user + used.system,
                                   time.process_time()))
            callback(state)
        return super().create_subscription(kind, topic, on_state, qos)

    def is_done(self):
        """Return whether all states have arrived."""
        assert time.monotonic() - self._began < LONGEST, f'stopped after {self.count} states'
        return len(self.marks) == 2


class TimedController(Timed, AttitudeController):
    """The example controller, timed."""


class TimedBareController(Timed, BareController):
    """The bare controller, timed."""


def time_round(namespace, process):
    """Return the times of a step, s, in the order of NAMES."""
    rclpy.init(args=['--ros-args', '-r', f'__ns:={namespace}'],
               signal_handler_options=SignalHandlerOptions.NO)
    try:
        controller = (TimedController if namespace == OURS else TimedBareController)(process)
        spin(executor_of(), controller, controller.is_done)
    finally:
        rclpy.try_shutdown()
    return np.diff(controller.marks, axis=0)[0] / STATES


def measure(rounds):
    """Return the times of all rounds, shape (rounds, 3), by namespace."""
    nodes = {name: psutil.Popen([sys.executable, *command, '-r', f'__ns:={name}'],
                                stderr=subprocess.DEVNULL) for name, command in NODES.items()}
    found = {name: [] for name in nodes}
    try:
        for number in range(rounds + 1):
            for name, process in nodes.items():
                times = time_round(name, process)
                if number:  # the first round is for warming up
                    found[name].append(times)
    finally:
        for process in nodes.values():
            process.terminate()
            process.wait()
    return {name: np.array(times) for name, times in found.items()}


def main():
    """Print the table, and mark a wall time beyond its limit."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--rounds', type=int, default=25)
    parser.add_argument('--json', type=Path, help='write the figures')
    arguments = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    found = measure(arguments.rounds)
    ours, bare = (np.median(found[name], axis=0) for name in (OURS, BARE))
    ratios = np.median(found[OURS] / found[BARE], axis=0)
    print(f'{"us per step":12}{"ours":>8}{"bare":>8}{"ratio":>8}')
    for name, *times, ratio in zip(NAMES, ours, bare, ratios):
        print(f'{name:12}{times[0] * 1e6:8.0f}{times[1] * 1e6:8.0f}{ratio:8.2f}'
              f'{"  MISS" if name == "wall" and ratio > BAR else ""}')
    if arguments.json:
        arguments.json.write_text(json.dumps(
            {name: times.tolist() for name, times in found.items()}, indent=1))


if __name__ == '__main__':
    main()
