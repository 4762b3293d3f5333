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

"""Timers that cost little processor time."""

from __future__ import annotations

from collections.abc import Callable
import inspect

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

_NO_ARGUMENTS = inspect.Signature()


def timer(node: Node, period: float, callback: Callable[[], None],
          clock: Clock | None = None) -> Timer:
    """Create a timer with a period in seconds, which uses a steady clock unless one is given."""
    def tick() -> None:
        callback()
    # In each period, rclpy inspects the signature of the callback, which takes 20 us otherwise.
    vars(tick)['__signature__'] = _NO_ARGUMENTS
    # Give each timer its own clock. When a timer is reset, EventsExecutor calls the overdue timers
    # on the same clock twice, and these timers then pause to make up for the extra calls.
    return node.create_timer(period, tick,
                             clock=clock or Clock(clock_type=ClockType.STEADY_TIME))
