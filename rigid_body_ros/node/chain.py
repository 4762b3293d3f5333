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
What keeps a closed loop in lockstep one chain of state, torque, state, torque.

A controller answers every state that it receives. Publish a state twice, and it sends two torques;
answer both, and two chains run through the loop for ever. Answer too little, and a message that
was lost stops the loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
import time
from typing import Any

import numpy as np
from rigid_body_ros.node.arrivals import Sender, UNKNOWN
from rigid_body_ros.node.epoch import Torque

#: s. A torque that is repeated sooner after its answer was sent before the answer arrived.
_RECENT = 0.1
#: s; between two publications of a state that nobody is there to answer.
_REPEAT_EVERY = 0.1
#: s; for how long connections must stay the same before a new controller can hear and be heard.
_SETTLED = 0.5
#: s; how long a controller may work on a state before it is published again. The wait doubles
#: with every repetition, so that few of them pile up in the queue of a slow controller.
_PATIENCE, _LONGEST_PATIENCE = 2.0, 30.0


class Answers:
    """
    Which torques have an answer, and which repeated ones need another.

    Parameters
    ----------
    history_ns : int
        How much older than the newest stamp a torque may be.

    """

    def __init__(self, history_ns: int) -> None:
        self._history_ns = history_ns
        self._given: dict[int, _Answer] = {}
        #: How often the state of a stamp was published.
        self._published: dict[int, int] = {}

    def clear(self) -> None:
        """Forget everything: a new epoch begins."""
        self._given.clear()
        self._published.clear()

    def published(self, stamp_ns: int) -> None:
        """Note that a state was published to a controller, which then sends a torque."""
        self._published[stamp_ns] = self._published.get(stamp_ns, 0) + 1
        _drop_before(self._published, stamp_ns - self._history_ns)

    def expect(self, torque: Torque, sender: Sender) -> None:
        """Note that a torque was taken, and waits for its answer."""
        received = self._given[torque.stamp_ns].received if torque.stamp_ns in self._given else 1
        self._given[torque.stamp_ns] = _Answer(torque, sender, received)
        _drop_before(self._given, torque.stamp_ns - self._history_ns)

    def give(self, torque: Torque) -> None:
        """Note that the answer to a torque was published."""
        if torque.stamp_ns in self._given:
            self._given[torque.stamp_ns].given_at = time.monotonic()

    def forget(self, torque: Torque) -> None:
        """Note that a torque gets no answer."""
        self._given.pop(torque.stamp_ns, None)

    def repeated(self, torque: Torque, sender: Sender) -> bool:
        """
        Return whether a torque needs no answer, because its stamp has one; to be called once.

        A controller that received a state twice sends two torques, and a second controller sends
        one of its own. But a sender that repeats or corrects a torque by itself has to be
        answered again: it may not have received the answer.
        """
        answer = self._given.get(torque.stamp_ns)
        if answer is None:
            return False
        if sender == UNKNOWN or sender != answer.sender:
            return True
        answer.received += 1
        if answer.received <= self._published.get(torque.stamp_ns, 0):
            return True
        is_recent = answer.given_at is None or time.monotonic() - answer.given_at < _RECENT
        return is_recent and self.is_same(torque)

    def is_same(self, torque: Torque) -> bool:
        """Return whether a torque is the one that has the answer of its stamp."""
        other = self._given[torque.stamp_ns].torque
        return torque.frame == other.frame and np.array_equal(torque.values, other.values)


@dataclass
class _Answer:
    """A torque, its sender, how many came of its stamp, and when the answer was published, s."""

    torque: Torque
    sender: Sender
    received: int
    given_at: float | None = None


def _drop_before(entries: dict[int, Any], horizon_ns: int) -> None:
    # Stamps that come late stand behind newer ones, and stay until those are dropped.
    while entries and (oldest_ns := next(iter(entries))) < horizon_ns:
        del entries[oldest_ns]


class Offers:
    """
    Decides when the latest state is to be published again.

    While nobody publishes torques: ten times a second. To a new controller: once, when both sides
    have had time to find each other. After that only after long silence, because a controller
    that still works on a state would receive it twice. Never just after a connection: a controller
    that reads already may not be heard yet.

    Parameters
    ----------
    count : callable
        Returns how many publishers of torques, and how many readers of states, are connected.

    """

    def __init__(self, count: Callable[[], tuple[int, int]]) -> None:
        self._count = count
        self._connected = 0, 0
        self._changed_at = time.monotonic()
        self._published_at = -math.inf
        #: Whether a state was published since the connections settled.
        self._is_told = False
        self._patience = _PATIENCE

    @property
    def has_controller(self) -> bool:
        """Whether somebody publishes torques, as far as known."""
        return self._connected[0] > 0

    def published(self, is_repeated: bool) -> None:
        """Note that a state was published, for the first time or again."""
        self._published_at = time.monotonic()
        self._patience = min(2.0 * self._patience, _LONGEST_PATIENCE) \
            if is_repeated and self._is_told else _PATIENCE
        self._is_told |= self._published_at - self._changed_at >= _SETTLED

    def is_due(self) -> bool:
        """Return whether to publish the latest state again now; call it regularly."""
        now, (publishers, readers) = time.monotonic(), self._count()
        if publishers > self._connected[0] or readers > self._connected[1]:
            self._changed_at = now
        if publishers > self._connected[0]:  # a reader alone may be an observer
            self._is_told = False
        self._connected = publishers, readers
        if now - self._changed_at < _SETTLED:
            return False
        if not publishers:
            return now - self._published_at >= _REPEAT_EVERY
        # A loop that runs needs nothing, whoever joins it.
        return now - self._published_at >= (self._patience if self._is_told else _SETTLED)
