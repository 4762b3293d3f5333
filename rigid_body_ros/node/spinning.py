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

"""The main loop of a process that runs one node."""

from __future__ import annotations

from collections.abc import Callable
import gc
import signal

from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rigid_body_ros.runtime import interrupts

#: How often the loop checks for signals, in seconds.
_SIGNAL_PERIOD = 0.1

#: Number of new objects after which Python looks for unused ones. The default of 700 takes a tenth
#: of the time that a torque takes.
_YOUNG = 20_000


def executor_of(context: Context | None = None) -> Executor:
    """Return an executor, of the kind that uses the least processor time per message."""
    try:  # EventsExecutor uses half as much time as SingleThreadedExecutor
        from rclpy.experimental import EventsExecutor
    except ImportError:  # before Jazzy
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Executor, node: Node, is_done: Callable[[], bool] = lambda: False) -> None:
    """Spin a node until it is done or a SIGINT or SIGTERM arrives, and then destroy it."""
    stop: list[int] = []
    executor.add_node(node)
    # From now on, signals only end the loop, and do not interrupt callbacks.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stop.append(number))
    interrupts.check()
    # Freeze the objects that exist now. Otherwise, a garbage collection would visit the objects of
    # all modules, and would delay the outputs by 0.05 to 0.2 s.
    gc.freeze()
    gc.set_threshold(_YOUNG)
    while not (stop or is_done()):
        # The timeout gives the loop a chance to notice signals. Without the timeout,
        # EventsExecutor may hang.
        executor.spin_once(timeout_sec=_SIGNAL_PERIOD)
    node.destroy_node()
