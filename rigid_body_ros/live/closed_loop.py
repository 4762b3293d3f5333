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
Keep a lockstep loop from stopping, and from splitting into several chains.

A controller responds to every state that it receives. If a state is published twice, the
controller sends two torques; if the node responds to both, the loop has two chains of messages
from then on. If the node does not respond, or a message is lost, the loop stops.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import time
from typing import Any

import numpy as np
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.torque_queue import Sender, UNKNOWN_SENDER

#: A torque that is repeated within this time, s, after the response was published is assumed to
#: have been sent before the response arrived.
_IN_FLIGHT = 0.1
#: Period at which a state is published while no controller is connected, s.
_IDLE_PERIOD = 0.1
#: If the connections have not changed for this long, s, they are complete: a new controller can
#: both receive and send.
_CONNECTION_TIME = 0.5
#: How long the loop may be silent before the state is published again: the first timeout, and the
#: longest timeout, s. Fast DDS may deliver a message only after its next heartbeat, whose period
#: is 3 s. A repetition within these 3 s would reach the controller as a second copy. The timeout
#: doubles with every repetition, so that few copies pile up in the queue of a slow controller.
_TIMEOUT, _MAX_TIMEOUT = 4.0, 30.0


class DuplicateFilter:
    """
    Decide which torques with equal stamps require another response.

    Parameters
    ----------
    history_ns : int
        A torque that is older than the newest stamp by this time, ns, is too old.

    """

    def __init__(self, history_ns: int) -> None:
        self._history_ns = history_ns
        self._accepted: dict[int, _Accepted] = {}
        #: How many times the state at each stamp was published.
        self._publications: dict[int, int] = {}

    def clear(self) -> None:
        """Clear all records, because a new epoch begins."""
        self._accepted.clear()
        self._publications.clear()

    def published(self, stamp_ns: int) -> None:
        """Record that a state was published to a controller, which will send a torque."""
        self._publications[stamp_ns] = self._publications.get(stamp_ns, 0) + 1
        _drop_before(self._publications, stamp_ns - self._history_ns)

    def accepted(self, torque: Torque, sender: Sender) -> None:
        """Record that a torque was accepted and waits for its response."""
        previous = self._accepted.get(torque.stamp_ns)
        received = previous.received if previous else 1
        self._accepted[torque.stamp_ns] = _Accepted(torque, sender, received)
        _drop_before(self._accepted, torque.stamp_ns - self._history_ns)

    def responded(self, torque: Torque) -> None:
        """Record that the response to a torque was published."""
        if torque.stamp_ns in self._accepted:
            self._accepted[torque.stamp_ns].responded_at = time.monotonic()

    def discard(self, torque: Torque) -> None:
        """Record that a torque gets no response."""
        self._accepted.pop(torque.stamp_ns, None)

    def is_duplicate(self, torque: Torque, sender: Sender) -> bool:
        """
        Return whether a torque is a duplicate, which needs no response of its own.

        Call this once per torque. A controller that has received a state twice sends two torques,
        and a second controller sends its own torque; in both cases the second torque is a
        duplicate. But if a sender repeats or corrects a torque without having received the state
        twice, the torque needs another response, because the sender may not have received the
        first response.
        """
        first = self._accepted.get(torque.stamp_ns)
        if first is None:
            return False
        if sender == UNKNOWN_SENDER or sender != first.sender:
            return True
        first.received += 1
        if first.received <= self._publications.get(torque.stamp_ns, 0):
            return True
        in_flight = first.responded_at is None \
            or time.monotonic() - first.responded_at < _IN_FLIGHT
        return in_flight and self.is_same(torque)

    def is_waiting(self, torque: Torque) -> bool:
        """Return whether the accepted torque with the same stamp still awaits its response."""
        return self._accepted[torque.stamp_ns].responded_at is None

    def is_same(self, torque: Torque) -> bool:
        """Return whether a torque equals the accepted torque with the same stamp."""
        other = self._accepted[torque.stamp_ns].torque
        return torque.frame == other.frame and np.array_equal(torque.values, other.values,
                                                              equal_nan=True)


@dataclass
class _Accepted:
    """An accepted torque, and when the node responded to it."""

    torque: Torque
    sender: Sender
    #: Number of torques received from this sender with this stamp.
    received: int
    #: Time of the response, s, monotonic clock.
    responded_at: float | None = None


def _drop_before(entries: dict[int, Any], horizon_ns: int) -> None:
    # A late stamp comes after newer stamps in the dict, and stays until these are dropped.
    while entries and (oldest_ns := next(iter(entries))) < horizon_ns:
        del entries[oldest_ns]


class RepublishPolicy:
    """
    Decide when to publish the latest state again.

    While no publisher of torques is connected, the state is published ten times a second. A new
    controller receives the state once, after both sides have had time to discover each other.
    After that, the state is published again only after a long silence. Otherwise a controller
    would receive the state twice if it takes long to respond, or if the middleware delivers the
    state late. The state is never published immediately after a connection, because the
    subscription of a controller may be connected before the publisher of the controller.
    """

    def __init__(self) -> None:
        #: Numbers of connected publishers of torques and of subscriptions to states.
        self._connected = 0, 0
        self._changed_at = time.monotonic()
        self._published_at = -math.inf
        #: After a silence of this length, s, the state is published again. The length is
        #: _CONNECTION_TIME until a new controller has received a state.
        self._timeout = _CONNECTION_TIME

    @property
    def has_controller(self) -> bool:
        """Return whether a publisher of torques is connected."""
        return self._connected[0] > 0

    def published(self, is_repeated: bool) -> None:
        """Record that a state was published, for the first time or again."""
        self._published_at = time.monotonic()
        if self._timeout > _CONNECTION_TIME and is_repeated:
            self._timeout = min(2.0 * self._timeout, _MAX_TIMEOUT)
        elif (self._timeout > _CONNECTION_TIME
                or self._published_at - self._changed_at >= _CONNECTION_TIME):
            self._timeout = _TIMEOUT

    def is_due(self, publishers: int, subscriptions: int) -> bool:
        """
        Return whether to publish the latest state again now; call this regularly.

        Parameters
        ----------
        publishers, subscriptions : int
            The numbers of connected publishers of torques and of subscriptions to states.

        """
        now = time.monotonic()
        if publishers > self._connected[0] or subscriptions > self._connected[1]:
            self._changed_at = now
        if publishers > self._connected[0]:  # a subscription alone may be an observer
            self._timeout = _CONNECTION_TIME
        self._connected = publishers, subscriptions
        if now - self._changed_at < _CONNECTION_TIME:
            return False
        # A running loop needs no repetition, even if another controller joins.
        return now - self._published_at >= (self._timeout if publishers else _IDLE_PERIOD)
