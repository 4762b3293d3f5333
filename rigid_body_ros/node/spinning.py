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

"""The loop of a process that runs one node."""

from __future__ import annotations

from collections.abc import Callable
import gc
import signal

from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rigid_body_ros.runtime import interrupts

#: Period of the check for signals, s.
_SIGNAL_PERIOD = 0.1


def executor_of(context: Context | None = None) -> Executor:
    """Return the executor that takes the least processor time per message."""
    try:  # EventsExecutor takes half the time of SingleThreadedExecutor
        from rclpy.experimental import EventsExecutor
    except ImportError:  # before Jazzy
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Executor, node: Node, is_done: Callable[[], bool] = lambda: False) -> None:
    """Spin a node until it is done, or until SIGINT or SIGTERM; then destroy it."""
    stop: list[int] = []
    executor.add_node(node)
    # From here on, a signal does not interrupt a callback.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stop.append(number))
    interrupts.check()
    # A garbage collection that visits all modules would stop the outputs for 0.05 to 0.2 s.
    gc.freeze()
    while not (stop or is_done()):
        # The timeout lets the loop notice signals; without a timeout, EventsExecutor may hang.
        executor.spin_once(timeout_sec=_SIGNAL_PERIOD)
    node.destroy_node()
