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
Measure a closed loop of `attitude_node` in lockstep and `attitude_controller`.

    python benchmarks/loop.py [--rounds 12]

Both run with a step of 1 ms. The table has the medians over the rounds, per step: wall time, and
processor time of the node and of the controller, which runs in this process.
"""

import argparse
import time

import numpy as np
from processes import command, isolate, processor_time, SCENE
import psutil
import rclpy
from rclpy.signals import SignalHandlerOptions
from rigid_body_ros.node.attitude_controller import AttitudeController
from rigid_body_ros.node.process import executor_of, spin

#: Number of states in a round before timing starts, and number of timed states.
WARM, STATES = 200, 1000
#: s; a loop that takes longer is considered stuck.
LONGEST = 120.0


class TimedController(AttitudeController):
    """The example controller, which records when it has received WARM states, and STATES more."""

    count = 0

    def __init__(self, process):
        self._process, self.marks, self._began = process, [], time.monotonic()
        super().__init__()

    def create_subscription(self, kind, topic, callback, qos):
        """Create a subscription whose callback also counts the states."""
        def on_state(state):
            self.count += 1
            if self.count in (WARM, WARM + STATES):
                self.marks.append((time.perf_counter(), processor_time(self._process),
                                   time.process_time()))
            callback(state)
        return super().create_subscription(kind, topic, on_state, qos)

    def is_done(self):
        """Return whether all states have arrived."""
        assert time.monotonic() - self._began < LONGEST, f'stopped after {self.count} states'
        return len(self.marks) == 2


def time_round(process):
    """Return the times of a step, s: wall time, node, controller."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        controller = TimedController(process)
        spin(executor_of(), controller, controller.is_done)
    finally:
        rclpy.try_shutdown()
    return np.diff(controller.marks, axis=0)[0] / STATES


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().partition('\n')[0])
    parser.add_argument('--rounds', type=int, default=12)
    rounds = parser.parse_args().rounds
    isolate()
    node = psutil.Popen(command('attitude_node', '--ros-args', '--params-file', SCENE, '-p',
                                'mode:=lockstep', '-p', 'step:=0.001'))
    try:
        time_round(node)  # for warming up
        times = np.median([time_round(node) for _ in range(rounds)], axis=0)
    finally:
        node.terminate()
        node.wait()
    for name, seconds in zip(('wall', 'node', 'controller'), times):
        print(f'{name:12}{seconds * 1e6:8.0f} us per step')


if __name__ == '__main__':
    main()
