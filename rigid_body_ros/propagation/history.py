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

"""The changes to a body's inputs, and the motion between these changes."""

from __future__ import annotations

import bisect
from collections.abc import Mapping
import math
import time
from typing import Any

from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import changed, RATE
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Axial, Wheels
from rigid_body_ros.propagation.acting import ActingSamples
from rigid_body_ros.propagation.change import Active, Change
from rigid_body_ros.propagation.lags import Lagging
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import without_origin
from rigid_body_ros.propagation.segment import (
    NewBody,
    OutOfTimeError,
    Sample,
    Segment,
    Sum,
    summed,
)
from rigid_body_ros.propagation.wheels import Commands, friction_of, in_force


class History:
    """
    A body's inputs after each change, and its motion, which is computed only when needed.

    Parameters
    ----------
    body : RigidBody
        The first body.
    start : State
    options : Options
    acting : ActingSamples
        The actuator delays, limits and lags that apply to the samples.
    wheels : Wheels or None
        The named wheels.
    fields : array of FIELDS, shape (1,), or None
    history_ns : int
        A torque or a body is dropped if its stamp is older than the newest stamp by this time or
        more.

    Attributes
    ----------
    changes : list of Change
        The changes, in order. The first one is the start of the motion, until the start is
        discarded.
    newest_ns : int or None
        The newest stamp; None before the first stamp.

    """

    def __init__(self, body: RigidBody, start: State, options: Options, acting: ActingSamples,
                 wheels: Wheels | None, fields: NDArray[Any] | None, history_ns: int) -> None:
        self._options, self._acting = options, acting
        self._wheels, self._fields = wheels, fields
        self._history_ns = history_ns
        #: The state of the named wheels at the start, or None if there are no named wheels.
        self._axial: Axial | None = None
        self._start = start
        self._has_friction = wheels is not None and wheels.has_friction
        if wheels:
            self._start, self._axial = wheels.begun(start)
        self.changes = [Change(start.time_ns, {}, self.new_body(-NEVER_NS, body, RATE),
                               Commands.none(len(wheels) if wheels else 0))]
        #: The times of the changes, ns. This list can be searched ten times as fast as `changes`.
        self._times_ns = [start.time_ns]
        self.newest_ns: int | None = None
        self._begin()

    def inserted(self, time_ns: int, delay_ns: int = 0) -> int | None:
        """
        Return the index of the change at `time_ns + delay_ns`; insert a change if there is none.

        The result is None if the stamp is too old.
        """
        if self.newest_ns is not None and self.newest_ns - time_ns >= self._history_ns:
            return None
        if self.newest_ns is not None:  # `newest_ns` does not include the new stamp yet
            self._discard_before(self.newest_ns - self._history_ns)
        self.newest_ns = time_ns if self.newest_ns is None else max(self.newest_ns, time_ns)
        time_ns += delay_ns
        index = max(self.index_of(time_ns), 0)
        if time_ns > self.changes[index].time_ns:
            before = self.changes[index]
            self.changes.insert(index + 1, Change(
                time_ns, {**before.samples}, before.body, before.commands))
            self._times_ns.insert(index + 1, time_ns)
            index += 1
        return index

    def put(self, index: int, new: Sample | NewBody, source: int = 0) -> None:
        """Store a sample or a body, which takes effect at the change `index`."""
        # A sample is in force until the next sample of the same source, and a body is in force
        # until the next body. The start is discarded only after a stamp that is later than the
        # start by at least `history` has arrived. From then on, stamps before the start are
        # dropped. Therefore the start is still the first change whenever a stamp before the start
        # is accepted.
        for change in self.changes[index:]:
            found = change.body if isinstance(new, NewBody) else change.samples.get(source)
            if found is not None and found.stamp_ns > new.stamp_ns:
                break
            if isinstance(new, NewBody):
                change.body = new
            else:
                change.samples[source] = new
        self._renew(index)

    def take(self, index: int, time_ns: int, row: Floats) -> None:
        """
        Store wheel commands that take effect at a change.

        A wheel whose entry is NaN keeps its command.
        """
        for change in self.changes[index:]:
            change.commands = change.commands.taking(time_ns, row)
        self._renew(index)

    def active(self, index: int, time_ns: int, until: float) -> Active:
        """
        Return the segment and the wheels at a time at or after the change `index`.

        The method raises TimeoutError if the computing time runs out.
        """
        self.compute(index, until)
        return self._active_at(self.changes[index], time_ns, until)

    def _renew(self, index: int) -> None:
        """Discard the motion from a change onward, so that it is computed again."""
        self._discard_segments(index)
        if self.changes[0].active is None:
            self._begin()

    def _begin(self) -> None:
        """Compute the segment that begins at the start of the motion."""
        start, first = self._start, self.changes[0]
        axial = self._axial and self._axial_once(self._axial, first.commands, start)
        total = self._sum(first, start.time_ns, axial, {})
        # A torque whose stamp is the start begins a new segment, even if this torque equals the
        # previous one.
        begins = first.begins_at(start.time_ns, self._acting)
        acts = not total.is_zero() or self._fields is not None or (
            first.body.body.is_damped or start._has_rotors or self._has_friction)
        first.active = self._active_from(without_origin(start) if begins and acts else start,
                                         total, first.body, axial)

    def index_of(self, time_ns: int) -> int:
        """Return the index of the last change at or before a time, or -1 if there is none."""
        return bisect.bisect_right(self._times_ns, time_ns) - 1

    def between(self, after_ns: int, until_ns: int) -> list[Change]:
        """Return the changes at times later than `after_ns` and not later than `until_ns`."""
        return self.changes[self.index_of(after_ns) + 1:self.index_of(until_ns) + 1]

    def _sum(self, change: Change, time_ns: int, axial: Axial | None,
             before: Mapping[int, Lagging]) -> Sum:
        """
        Return the sum of all torques that act from a given time onward.

        `before` contains the sources that were lagging up to `time_ns`.
        """
        acting = self._acting
        motors = None
        if self._wheels and axial and not self._has_friction:
            motors = self._wheels.torque(axial.efforts)[None]
        total = summed(acting.acting(change.samples), time_ns, self._options.timeout_ns, motors)
        if not acting.lag:
            return total
        lagging = acting.lagging(change.samples, time_ns, before)
        return total._replace(lagging=lagging, lags=acting.lags(lagging, time_ns))

    def _discard_before(self, horizon_ns: int) -> None:
        """
        Discard the changes that late torques can no longer affect.

        These are all changes before the one that is in force at `horizon_ns`.

        The method raises ValueError under the same conditions as `Propagator.at`.
        """
        oldest = self.index_of(horizon_ns)
        if oldest > 0:
            self.compute(oldest)
            del self.changes[:oldest], self._times_ns[:oldest]

    def _discard_segments(self, index: int) -> None:
        # Segments are computed in order. So if one segment is missing, all later segments are
        # missing, too.
        self.changes[index].discard()
        for change in self.changes[index + 1:]:
            if change.active is None:
                break
            change.discard()

    def compute(self, index: int, until: float = math.inf) -> None:
        """
        Compute the segments of all changes up to and including the change `index`.

        The method raises TimeoutError if the computing time runs out.
        """
        first = index
        while self.changes[first].active is None:
            first -= 1
        for before, change in zip(self.changes[first:index], self.changes[first + 1:index + 1]):
            change.active = self._next(
                self._active_at(before, change.time_ns, until), change, change.time_ns, until)
            if time.monotonic() > until:
                raise OutOfTimeError(change.time_ns)

    def _active_at(self, change: Change, time_ns: int, until: float) -> Active:
        """Return the segment and the wheels at a time between a change and the next change."""
        active = change.active
        assert active is not None
        for k, due_ns in enumerate(change.due_ns(self._acting)):
            if time_ns < due_ns:
                break
            if k == len(change.after_timeouts):
                change.after_timeouts.append(self._next(active, change, due_ns, until))
            active = change.after_timeouts[k]
        return active

    def _next(self, active: Active, change: Change, time_ns: int, until: float) -> Active:
        body, segment, start, end = change.body, active.segment, None, None
        if body.stamp_ns == time_ns:
            start = changed(segment.end_at(time_ns, until), segment.body, body.carrier, body.keep)
        axial = active.axial
        if axial:
            end = start or segment.end_at(time_ns, until)
            axial = self._axial_once(axial, change.commands, end)
        total = self._sum(change, time_ns, axial, segment.lagging)
        if start is None:
            if segment.coasts and total.is_zero():
                return Active(segment, axial)
            start = end or segment.end_at(time_ns, until)
        return self._active_from(start, total, body, axial)

    def _axial_once(self, axial: Axial, commands: Commands, state: State) -> Axial:
        """Return the state of the wheels once commands are in force at a carrier state."""
        assert self._wheels
        return in_force(self._wheels, axial, commands, state, self._options.timeout_ns)

    def new_body(self, stamp_ns: int, body: RigidBody, keep: str) -> NewBody:
        """Return a `NewBody` for a body that takes over at a stamp."""
        carrier = self._wheels.carrier(body) if self._wheels else body
        return NewBody(stamp_ns, body, keep, carrier)

    def _active_from(self, start: State, total: Sum, body: NewBody,
                     axial: Axial | None) -> Active:
        friction = None
        if self._wheels and axial and self._has_friction:
            friction = friction_of(self._wheels, axial.efforts[None])
        segment = Segment(body.carrier, self._options, self._history_ns, start, total,
                          self._fields, friction)
        return Active(segment, axial)
