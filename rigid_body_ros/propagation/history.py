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
from collections.abc import Sequence
from dataclasses import dataclass, field
import math
import time
from typing import Any, NamedTuple

from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine import Sums
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import changed, RATE
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Axial, Wheels
from rigid_body_ros.propagation.lags import LaggingSources
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import without_origin
from rigid_body_ros.propagation.segment import OutOfTimeError, Segment, torque_acts
from rigid_body_ros.propagation.sources import Sample, summed_at
from rigid_body_ros.propagation.timeline import OtherTorques
from rigid_body_ros.propagation.wheels import Commands, coupled, in_force


class NewBody(NamedTuple):
    """
    A body that takes over at a stamp.

    `keep` names the quantity that stays the same at the change; see `BodyLog`.
    """

    stamp_ns: int
    body: RigidBody
    keep: str
    #: The body without the axial inertia of the named wheels. Without named wheels, the body
    #: itself.
    carrier: RigidBody


class Active(NamedTuple):
    """
    The motion from a change onward, and the state of the named wheels at its beginning.

    Without named wheels, `axial` is None.
    """

    segment: Segment
    axial: Axial | None


@dataclass(slots=True)
class Change:
    """The samples of all sources, the body and the wheel commands from a given time onward."""

    time_ns: int
    samples: dict[int, Sample]
    body: NewBody
    commands: Commands
    #: The motion from this change onward, then the motions from the times at which a torque times
    #: out or a lag ends, in order. Motions that have not been computed yet are missing at the end.
    motions: list[Active] = field(default_factory=list)

    @property
    def stamps_ns(self) -> set[int]:
        """Return the stamps of the samples, the body and the commands that are in force."""
        return {self.body.stamp_ns, *self.commands.stamps_ns, *(
            sample.stamp_ns for sample in self.samples.values())}


class History:
    """
    A body's inputs after each change, and its motion, which is computed only when needed.

    Parameters
    ----------
    body : RigidBody
        The first body.
    start : State
    options : Options
    time_constants : list of float, s
        The time constants of the lags of all sources, each once.
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

    def __init__(self, body: RigidBody, start: State, options: Options,
                 time_constants: Sequence[float], wheels: Wheels | None,
                 fields: NDArray[Any] | None, history_ns: int) -> None:
        self._options, self._timeout_ns = options, options.timeout_ns
        self._wheels, self._history_ns = wheels, history_ns
        #: The fields, and the lagging sources before the start, when nothing lags yet. Without
        #: lags, these are the other torques of all segments.
        self._others = OtherTorques(
            fields, LaggingSources(time_constants, {}) if time_constants else None)
        #: The state of the named wheels at the start, or None if there are no named wheels.
        self._axial: Axial | None = None
        self._start, self._start_ns = start, start.time_ns
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
        newest_ns = self.newest_ns
        if newest_ns is None:
            self.newest_ns = time_ns
        else:
            if newest_ns - time_ns >= self._history_ns:
                return None
            self._discard_before(newest_ns - self._history_ns)
            self.newest_ns = max(newest_ns, time_ns)
        time_ns += delay_ns
        index = max(self.index_of(time_ns), 0)
        if time_ns > self.changes[index].time_ns:
            before = self.changes[index]
            self.changes.insert(index + 1, Change(
                time_ns, {**before.samples}, before.body, before.commands, []))
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
            before = change.body if isinstance(new, NewBody) else change.samples.get(source)
            if before is not None and before.stamp_ns > new.stamp_ns:
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
        if not self.changes[0].motions:
            self._begin()

    def _begin(self) -> None:
        """Compute the segment that begins at the start of the motion."""
        start, first, axial = self._start, self.changes[0], self._axial
        if axial:
            axial = self._in_force(axial, first.commands, start)
        sums, others = self._inputs(first, start.time_ns, axial, self._others)
        segment = self._segment(start, sums, others, first.body, axial)
        # A torque whose stamp is the start begins a new segment, even if this torque equals the
        # previous one.
        if not segment.coasts and self._begins_at(first, start.time_ns):
            segment = self._segment(without_origin(start), sums, others, first.body, axial)
        first.motions.append(Active(segment, axial))

    def _begins_at(self, change: Change, time_ns: int) -> bool:
        """Return whether any torque in force takes effect or times out at a given time."""
        return any(time_ns in (since_ns, since_ns + self._timeout_ns) for since_ns in (
            change.commands.stamp_ns,
            *(sample.begins_ns for sample in change.samples.values())))

    def index_of(self, time_ns: int) -> int:
        """Return the index of the last change at or before a time, or -1 if there is none."""
        return bisect.bisect_right(self._times_ns, time_ns) - 1

    def between(self, after_ns: int, until_ns: int) -> list[Change]:
        """Return the changes at times later than `after_ns` and not later than `until_ns`."""
        return self.changes[self.index_of(after_ns) + 1:self.index_of(until_ns) + 1]

    def _inputs(self, change: Change, time_ns: int, axial: Axial | None,
                before: OtherTorques) -> tuple[Sums, OtherTorques]:
        """Return what acts from a given time onward; `before` acts up to this time."""
        motors = None
        if self._wheels and axial and not self._wheels.is_coupled:
            motors = self._wheels.torque(axial.efforts)[None]
        sums = summed_at(time_ns, change.samples, self._timeout_ns, motors)
        if before.lagging is None:
            return sums, before
        return sums, before._replace(lagging=before.lagging.under(
            change.samples, time_ns, self._timeout_ns, self._start_ns))

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
        self.changes[index].motions.clear()
        for change in self.changes[index + 1:]:
            if not change.motions:
                break
            change.motions.clear()

    def compute(self, index: int, until: float = math.inf) -> None:
        """
        Compute the segments of all changes up to and including the change `index`.

        The method raises TimeoutError if the computing time runs out.
        """
        if self.changes[index].motions:
            return
        first = index
        while not self.changes[first].motions:
            first -= 1
        for before, change in zip(self.changes[first:index], self.changes[first + 1:index + 1]):
            active = self._active_at(before, change.time_ns, until)
            change.motions.append(self._next(active, change, change.time_ns, until))
            if time.monotonic() > until:
                raise OutOfTimeError(change.time_ns)

    def _active_at(self, change: Change, time_ns: int, until: float) -> Active:
        """Return the segment and the wheels at a time between a change and the next change."""
        motions = change.motions
        for k, due_ns in enumerate(self._due_ns(change)):
            if time_ns < due_ns:
                return motions[k]
            if k + 1 == len(motions):
                motions.append(self._next(motions[k], change, due_ns, until))
        return motions[-1]

    def _due_ns(self, change: Change) -> list[int]:
        """Return the times after a change at which a torque times out or a lag ends."""
        if not self._timeout_ns and self._others.lagging is None:
            return []
        due = {due_ns for sample in change.samples.values()
               for due_ns in sample.due_ns(self._timeout_ns, self._start_ns)}
        if change.commands.efforts:
            due.add(change.commands.stamp_ns + self._timeout_ns)
        return sorted(due_ns for due_ns in due if due_ns > change.time_ns)

    def _next(self, active: Active, change: Change, time_ns: int, until: float) -> Active:
        body, (segment, axial), start, end = change.body, active, None, None
        if body.stamp_ns == time_ns:
            start = changed(segment.end_at(time_ns, until), segment.body, body.carrier, body.keep)
        if axial:
            end = start or segment.end_at(time_ns, until)
            axial = self._in_force(axial, change.commands, end)
        sums, others = self._inputs(change, time_ns, axial, segment.others)
        if start is None:
            if segment.coasts and not torque_acts(sums, others.lagging):
                return Active(segment, axial)
            start = end or segment.end_at(time_ns, until)
        return Active(self._segment(start, sums, others, body, axial), axial)

    def _in_force(self, axial: Axial, commands: Commands, state: State) -> Axial:
        """Return the state of the wheels once commands are in force at a carrier state."""
        assert self._wheels
        return in_force(self._wheels, axial, commands, state, self._timeout_ns)

    def new_body(self, stamp_ns: int, body: RigidBody, keep: str) -> NewBody:
        """Return a `NewBody` for a body that takes over at a stamp."""
        carrier = self._wheels.carrier(body) if self._wheels else body
        return NewBody(stamp_ns, body, keep, carrier)

    def _segment(self, start: State, sums: Sums, others: OtherTorques, body: NewBody,
                 axial: Axial | None) -> Segment:
        friction = None
        if self._wheels and axial and self._wheels.is_coupled:
            friction = coupled(self._wheels, axial.efforts[None])
        return Segment(body.carrier, self._options, self._history_ns, start, sums, others,
                       friction)
