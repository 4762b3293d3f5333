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

"""A queue of torques that are waiting to be applied or waiting for the clock."""

from __future__ import annotations

from collections import Counter, deque
import time
from typing import NamedTuple

from rigid_body_ros.live.events import ENDED, Events, FUTURE, LATE, OVERLOAD, RejectedError

#: Largest number of torques that may wait in the queue.
_MAX_QUEUE = 100_000
#: In real time, new torques are rejected while more than _BACKLOG torques are waiting and the
#: first of them has been waiting for longer than _MAX_WAIT, s. This gives the node time to catch
#: up.
_BACKLOG, _MAX_WAIT = 5000, 2.0

#: The identity of a publisher, or None if the middleware does not report it.
Sender = bytes | None
#: The sender of every message if the middleware cannot tell publishers apart.
UNKNOWN_SENDER: Sender = b''


class Queued(NamedTuple):
    """
    A received message that has not been decoded yet.

    Messages are decoded later, so that many of them can be received quickly. `arrived_ns` is the
    time of arrival, ns, or 0 in lockstep. `since` is the time of arrival on the monotonic clock,
    s.
    """

    source: int
    data: bytes
    sender: Sender
    arrived_ns: int
    since: float


class TorqueQueue:
    """
    A queue of torques in the order of their arrival.

    Torques that have to wait for the clock are called *early*. They are kept apart from the other
    torques, so torques that arrive later may overtake them.

    Parameters
    ----------
    events : Events
    is_patient : bool
        Whether torques may wait indefinitely, as in lockstep.

    """

    def __init__(self, events: Events, is_patient: bool) -> None:
        self._events, self._is_patient = events, is_patient
        self._waiting: deque[Queued] = deque()
        #: Early torques, each with the cause for which it would be rejected now.
        self._early: list[tuple[Queued, str]] = []

    def __bool__(self) -> bool:
        """Return whether any torques other than early torques are waiting to be applied."""
        return bool(self._waiting)

    def __len__(self) -> int:
        """Return the number of torques that are waiting, including early torques."""
        return len(self._waiting) + len(self._early)

    @property
    def waiting_time(self) -> float:
        """Return how long the first torque in the queue has been waiting to be applied, s."""
        return time.monotonic() - self._waiting[0].since if self._waiting else 0.0

    def by_source(self) -> Counter[int]:
        """Return the number of waiting torques from each source, including early torques."""
        return Counter(queued.source for queued in (
            *self._waiting, *(queued for queued, _ in self._early)))

    def check_room(self) -> None:
        """
        Raise RejectedError if the queue has no room for another torque.

        There is no room if too many torques are waiting, or, in real time, if many torques are
        waiting and the first of them has waited too long.
        """
        count, waited = len(self._waiting), self.waiting_time
        is_late = not self._is_patient and count > _BACKLOG and waited > _MAX_WAIT
        if is_late or count >= _MAX_QUEUE:
            raise RejectedError(OVERLOAD, f'{count} torques wait, the first for {waited:.3g} s; '
                                'new ones are rejected until the node catches up')

    def put(self, queued: Queued) -> None:
        """Append a received torque to the end of the queue."""
        self._waiting.append(queued)

    def pop(self) -> Queued:
        """Remove the first torque from the queue and return it."""
        return self._waiting.popleft()

    def hold(self, queued: Queued, cause: str) -> None:
        """Keep an early torque until the clock permits it, instead of rejecting it for `cause`."""
        self._early.append((queued, cause))

    def retry(self) -> None:
        """Put the early torques back at the front of the queue, because the clock has advanced."""
        self._waiting.extendleft(queued for queued, _ in reversed(self._early))
        self._early.clear()

    def end(self, kept: str) -> None:
        """
        Reject the waiting torques at the end of an epoch.

        Early torques that are held for the cause `kept` are not rejected and continue to wait.
        """
        unmet = {FUTURE: 'the clock reached the stamp of this torque',
                 LATE: 'the clock was set back to the stamp of this torque'}
        ended = [(queued, 'this torque was applied') for queued in self._waiting] + [
            (queued, unmet[cause]) for queued, cause in self._early if cause != kept]
        for queued, event in ended:
            self._events.reject(
                RejectedError(ENDED, f'the epoch ended before {event}'), queued.source)
        self._waiting.clear()
        self._early = [(queued, cause) for queued, cause in self._early if cause == kept]
