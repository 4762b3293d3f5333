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

"""Torques that wait to be applied, or wait for the clock."""

from __future__ import annotations

import bisect
from collections import Counter, deque
from collections.abc import Iterator
import time
from typing import NamedTuple

from rigid_body_ros.live.events import ENDED, Events, FUTURE, LATE, OVERLOAD, RejectedError

#: Largest number of torques that may wait in the queue.
_MAX_QUEUE = 100_000
#: In real time, new torques are rejected while more than _BACKLOG torques wait and the first of
#: them has waited for longer than _MAX_WAIT, s. Meanwhile the motion catches up.
_BACKLOG, _MAX_WAIT = 5000, 2.0

#: Identity of a publisher; None if the middleware does not report it.
Sender = bytes | None
#: Stands for the sender of every message if the middleware cannot tell publishers apart.
UNKNOWN_SENDER: Sender = b''


class Queued(NamedTuple):
    """
    A received message, which is decoded later, so that many messages can be received quickly.

    `arrived_ns` is the time of arrival, ns (0 in lockstep); `since` is the same time by the
    monotonic clock, s.
    """

    source: int
    data: bytes
    sender: Sender
    arrived_ns: int
    since: float


class TorqueQueue:
    """
    Torques in the order of arrival.

    Torques that wait for the clock are called early: later torques may overtake them.

    Parameters
    ----------
    events : Events
    is_patient : bool
        Whether torques may wait without a time limit, as in lockstep.

    """

    def __init__(self, events: Events, is_patient: bool) -> None:
        self._events, self._is_patient = events, is_patient
        self._waiting: deque[Queued] = deque()
        #: Early torques, by the cause for which they would be rejected now.
        self._early: dict[str, deque[Queued]] = {FUTURE: deque(), LATE: deque()}

    def __bool__(self) -> bool:
        """Return whether torques wait to be applied; early torques do not count."""
        return bool(self._waiting)

    def __len__(self) -> int:
        """Return the number of torques that wait to be applied or for the clock."""
        return len(self._waiting) + sum(map(len, self._early.values()))

    @property
    def waiting_time(self) -> float:
        """Return how long the first torque has waited to be applied, s."""
        return time.monotonic() - self._waiting[0].since if self._waiting else 0.0

    def by_source(self) -> Counter[int]:
        """Return, for each source, the number of torques that wait."""
        return Counter(queued.source for queue in (self._waiting, *self._early.values())
                       for queued in queue)

    def check_room(self) -> None:
        """Raise RejectedError if too many torques wait or, in real time, many wait too long."""
        count, waited = len(self._waiting), self.waiting_time
        is_late = not self._is_patient and count > _BACKLOG and waited > _MAX_WAIT
        if is_late or count >= _MAX_QUEUE:
            raise RejectedError(OVERLOAD, f'{count} torques wait, the first for {waited:.3g} s; '
                                'new ones are rejected until the node catches up')

    def put(self, queued: Queued) -> None:
        """Append a torque."""
        self._waiting.append(queued)

    def pop(self) -> Queued:
        """Remove and return the first torque."""
        return self._waiting.popleft()

    def pop_all(self) -> Iterator[Queued]:
        """Remove and generate all torques that are in the queue now, except early ones."""
        for _ in range(len(self._waiting)):
            yield self._waiting.popleft()

    def hold(self, queued: Queued, cause: str) -> None:
        """Make a torque wait for the clock; `cause` is why it would be rejected now."""
        self._early[cause].append(queued)

    def first_early(self, cause: str) -> Queued | None:
        """Return the first early torque held for `cause`, or None if there is none."""
        return next(iter(self._early[cause]), None)

    def release(self, cause: str) -> None:
        """Move the first early torque held for `cause` to its place in the queue, by arrival."""
        queued = self._early[cause].popleft()
        place = bisect.bisect_left(self._waiting, queued.since, key=_since)
        self._waiting.insert(place, queued)

    def end(self, kept: str) -> None:
        """At the end of an epoch, reject all torques but early ones held for the cause `kept`."""
        unmet = {FUTURE: 'the clock reached the stamp of this torque',
                 LATE: 'the clock was set back to the stamp of this torque'}
        ended = [(self._waiting, 'this torque was applied'), *(
            (self._early[cause], event) for cause, event in unmet.items() if cause != kept)]
        for queue, event in ended:
            for queued in queue:
                self._events.reject(
                    RejectedError(ENDED, f'the epoch ended before {event}'), queued.source)
            queue.clear()


def _since(queued: Queued) -> float:
    return queued.since
