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
Keep a lockstep loop from stopping and from splitting into several chains of messages.

A controller responds to every state that it receives, so if the node publishes a state twice, the
controller sends two torques. If the node responded to both torques, two chains of messages would
circulate in the loop from then on. On the other hand, if the node responds to neither torque, or
if a message is lost, the loop stops.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import time
from typing import Any

import numpy as np
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.torque_queue import Sender, UNKNOWN_SENDER

#: After the node has responded to a torque, the same torque may arrive again. If it arrives within
#: this time, s, we assume that the controller repeated the torque before the node's response
#: reached the controller.
_IN_FLIGHT = 0.1
#: Period at which the state is published while no controller is connected, s.
_IDLE_PERIOD = 0.1
#: If no connection has been added or removed for this long, s, we assume that all connections are
#: complete, so that a new controller can both receive and send.
_CONNECTION_TIME = 0.5
#: How long the loop may be silent before the state is republished, s: the first timeout and the
#: longest one. The first timeout is longer than 3 s, because Fast DDS has a heartbeat period of
#: 3 s and may hold back a message until the next heartbeat. A state that is republished within
#: those 3 s would reach the controller in addition to the delayed original. The timeout doubles
#: with every repetition, so that only a few copies pile up in the queue of a slow controller.
_TIMEOUT, _MAX_TIMEOUT = 4.0, 30.0


class DuplicateFilter:
    """
    Decide whether a second torque of a source with the same stamp requires another response.

    Parameters
    ----------
    history_ns : int
        A torque is too old if its stamp is older than the newest stamp by this time or more, ns.

    """

    def __init__(self, history_ns: int) -> None:
        self._history_ns = history_ns
        #: The accepted torques at each stamp, by source.
        self._accepted: dict[int, dict[int, _Accepted]] = {}
        #: How many times the state at each stamp was published.
        self._publications: dict[int, int] = {}

    def clear(self) -> None:
        """Clear all records at the beginning of a new epoch."""
        self._accepted.clear()
        self._publications.clear()

    def published(self, stamp_ns: int) -> None:
        """Record that a state was published to a controller, which will respond with a torque."""
        self._publications[stamp_ns] = self._publications.get(stamp_ns, 0) + 1
        _drop_before(self._publications, stamp_ns - self._history_ns)

    def accepted(self, torque: Torque, sender: Sender) -> None:
        """Record that a torque was accepted and is waiting for its response."""
        previous = self._at(torque)
        received = previous.received if previous else 1
        self._accepted.setdefault(torque.stamp_ns, {})[torque.source] = _Accepted(
            torque, sender, received)
        _drop_before(self._accepted, torque.stamp_ns - self._history_ns)

    def responded(self, torque: Torque) -> None:
        """Record that the response to the torques at the stamp of a torque was published."""
        for accepted in self._accepted.get(torque.stamp_ns, {}).values():
            accepted.responded_at = time.monotonic()

    def discard(self, torque: Torque) -> None:
        """Record that a torque will not get a response."""
        self._accepted.get(torque.stamp_ns, {}).pop(torque.source, None)

    def is_duplicate(self, torque: Torque, sender: Sender) -> bool:
        """
        Return whether a torque is a duplicate, so that the node need not respond to it.

        Call this once per torque. A torque can be a duplicate for two reasons: a controller that
        has received a state twice sends two torques, and a second controller sends a torque of its
        own. On the other hand, a sender may repeat or correct a torque without having received the
        state twice. Such a torque needs another response, because the first response may not have
        reached the sender.
        """
        first = self._at(torque)
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

    def _at(self, torque: Torque) -> _Accepted | None:
        """Return the accepted torque of the same source with the same stamp, if there is one."""
        return self._accepted.get(torque.stamp_ns, {}).get(torque.source)

    def is_waiting(self, torque: Torque) -> bool:
        """Return whether the accepted torque with the same stamp is still awaiting a response."""
        return self._accepted[torque.stamp_ns][torque.source].responded_at is None

    def is_same(self, torque: Torque) -> bool:
        """Return whether a torque equals the accepted torque with the same stamp."""
        other = self._accepted[torque.stamp_ns][torque.source].torque
        return torque.frame == other.frame and np.array_equal(torque.values, other.values,
                                                              equal_nan=True)


@dataclass
class _Accepted:
    """An accepted torque, its sender, and the time at which the node responded to it."""

    torque: Torque
    sender: Sender
    #: Number of torques with this stamp that have been received from this sender.
    received: int
    #: Time of the response on the monotonic clock, s, or None before the response.
    responded_at: float | None = None


def _drop_before(entries: dict[int, Any], horizon_ns: int) -> None:
    # The dict is in the order of insertion. If an entry was added late, entries with newer stamps
    # precede it, so the late entry stays until those entries have been dropped.
    while entries and (oldest_ns := next(iter(entries))) < horizon_ns:
        del entries[oldest_ns]


class RepublishPolicy:
    """
    Decide when to republish the latest state.

    While no torque publisher is connected, the state is published ten times a second. When a new
    controller connects, the state is published to this controller once, after both sides have had
    time to discover each other. From then on, the state is republished only after a long silence.
    With a shorter timeout, a controller would receive the state twice whenever it takes long to
    respond or the middleware delivers the state late. The state is never published right after a
    connection, because a controller's subscription may be connected before its publisher.
    """

    def __init__(self) -> None:
        #: The numbers of connected torque publishers and state subscriptions.
        self._connected = 0, 0
        self._changed_at = time.monotonic()
        self._published_at = -math.inf
        #: How long the loop may be silent before the state is republished, s. This is
        #: _CONNECTION_TIME until a new controller has received a state.
        self._timeout = _CONNECTION_TIME

    @property
    def has_controller(self) -> bool:
        """Return whether a torque publisher is connected."""
        return self._connected[0] > 0

    def published(self, is_repeated: bool) -> None:
        """Record that a state was published, and whether it had been published before."""
        self._published_at = time.monotonic()
        if self._timeout > _CONNECTION_TIME and is_repeated:
            self._timeout = min(2.0 * self._timeout, _MAX_TIMEOUT)
        elif (self._timeout > _CONNECTION_TIME
                or self._published_at - self._changed_at >= _CONNECTION_TIME):
            self._timeout = _TIMEOUT

    def is_due(self, publishers: int, subscriptions: int) -> bool:
        """
        Return whether to republish the latest state now. Call this method regularly.

        Parameters
        ----------
        publishers, subscriptions : int
            The numbers of torque publishers and state subscriptions that are connected now.

        """
        now = time.monotonic()
        if publishers > self._connected[0] or subscriptions > self._connected[1]:
            self._changed_at = now
        if publishers > self._connected[0]:  # a new subscription alone may be that of an observer
            self._timeout = _CONNECTION_TIME
        self._connected = publishers, subscriptions
        if now - self._changed_at < _CONNECTION_TIME:
            return False
        # While the loop is running, there is no need to republish the state, even if another
        # controller joins.
        return now - self._published_at >= (self._timeout if publishers else _IDLE_PERIOD)
