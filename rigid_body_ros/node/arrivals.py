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

"""The messages of a subscription as they arrive, and how many of them never did."""

from __future__ import annotations

from collections.abc import Callable
import inspect
import time
from typing import Any

from rclpy.subscription import Subscription

#: s; for how long one call takes messages.
_BUDGET = 0.02
#: Publishers that are remembered; those that fell silent longest ago go first.
_MOST_SENDERS = 100

#: Identity of a publisher; None where the middleware does not report it.
Sender = bytes | None
#: One of several publishers that cannot be told apart.
UNKNOWN: Sender = b''


class Arrivals:
    """
    A callback that takes every message that waits in a subscription, and counts lost ones.

    A publisher numbers its messages. A gap in the numbers is a loss, whether the network or the
    full queue of the subscription dropped the messages. An executor hands over one message at a
    time; this callback takes the others as well, so that the queue is empty when other work
    begins.

    Parameters
    ----------
    take : callable
        Receives the bytes of each message and its sender.
    done : callable
        Called when no message waits any more.
    missing : callable
        Receives the number of messages in a gap.

    Attributes
    ----------
    subscription : Subscription
        Set once it exists.

    """

    #: rclpy passes what it knows of a message only to a callback of two parameters.
    __signature__ = inspect.signature(lambda message, info: None)

    def __init__(self, take: Callable[[bytes, Sender], None], done: Callable[[], None],
                 missing: Callable[[int], None]) -> None:
        self._take, self._done, self._missing = take, done, missing
        self._last: dict[Sender, int] = {}
        self.subscription: Subscription

    def __call__(self, *taken: Any) -> None:
        """Take a message and all that wait behind it."""
        # EventsExecutor passes message and information as one tuple, other executors as two.
        found = taken if len(taken) == 2 else taken[0]
        subscription = self.subscription
        with subscription.handle:
            # A publisher that is faster than this loop must not keep it from ending.
            until = time.monotonic() + _BUDGET
            while found is not None:
                message, info = found
                self._take(message, self._sender(info))
                if time.monotonic() > until:
                    break
                found = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        self._done()

    def _sender(self, info: dict[str, Any]) -> Sender:
        number, identity = info.get('publication_sequence_number'), info.get('publisher_gid')
        if number is None:
            return None
        sender = identity['data'] if identity else None
        if sender is None and self.subscription.handle.get_publisher_count() > 1:
            self._last.clear()  # the numbers of several publishers, mixed
            return UNKNOWN
        before = self._last.pop(sender, number - 1)
        self._last[sender] = number
        if len(self._last) > _MOST_SENDERS:
            del self._last[next(iter(self._last))]
        if number > before + 1:
            self._missing(number - before - 1)
        return sender
