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
Run an AttitudeNode in a process that composes nodes itself, until SIGINT.

    python composed.py EXECUTOR [beside] --ros-args ...

EXECUTOR is spin, single, multi or events. With `beside`, a second node runs in the same executor,
and blocks it for 50 ms at a time.
"""

import signal
import sys
import time

import rclpy
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rigid_body_ros.node import AttitudeNode

#: s; duration and period of the callback that blocks.
BLOCK, PERIOD = 0.05, 0.06


class StoppedError(Exception):
    """A signal was received."""


def spin_events(node, sibling, stop):
    """Spin in an EventsExecutor without its `spin`, which hangs in the PyPI wheels of rclpy."""
    from rclpy.experimental import EventsExecutor
    executor = EventsExecutor()
    for each in (node, *sibling):
        executor.add_node(each)
    while not stop:
        executor.spin_once(timeout_sec=0.1)


def spin_until(node, name, sibling, stop):
    """Spin in an executor without a timeout, which only a callback can end."""
    def check():
        if stop:
            raise StoppedError
    node.create_timer(0.1, check)
    executor = {'spin': rclpy.get_global_executor, 'single': SingleThreadedExecutor,
                'multi': MultiThreadedExecutor}[name]()
    for each in sibling:
        executor.add_node(each)
    try:
        if name == 'spin':
            rclpy.spin(node)
        executor.add_node(node)
        executor.spin()
    except StoppedError:
        executor.shutdown()


def main(name, *beside):
    """Spin until a signal, then destroy the node."""
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    stop, sibling = [], []
    signal.signal(signal.SIGINT, lambda number, frame: stop.append(number))
    node = AttitudeNode()
    if 'beside' in beside:
        sibling.append(rclpy.create_node('sibling', use_global_arguments=False))
        sibling[0].create_timer(PERIOD, lambda: time.sleep(BLOCK))
    if name == 'events':
        spin_events(node, sibling, stop)
    else:
        spin_until(node, name, sibling, stop)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(*sys.argv[1:sys.argv.index('--ros-args')])
