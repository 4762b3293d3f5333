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

"""The motion under torques that arrive sample by sample."""

from __future__ import annotations

import bisect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
import operator
import time

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, instant, NEVER_NS
from rigid_body_ros.mechanics.actuator import Actuators
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import changed, checked_keep, RATE
from rigid_body_ros.mechanics.fields import beginning_at, Field, packed
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import FRAMES
from rigid_body_ros.propagation.acting import ActingSamples
from rigid_body_ros.propagation.lags import Lagging
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import with_rest, without_origin
from rigid_body_ros.propagation.segment import (
    NewBody,
    Sample,
    Segment,
    Sum,
    summed,
    timed_out,
    WHEELS,
)


class Propagator:
    """
    The motion under torques that arrive sample by sample.

    A torque commits the state at its stamp, computed under the torque before it, and so does a
    change of the body. A state between stamps is a prediction: no later state depends on it. A
    torque that arrives late, by less than `history`, is inserted, and the later torques are
    applied again; of torques with equal stamps the last to arrive is used. So the states at the
    stamps are those of `propagate` with the whole log, bit for bit, in whatever order the torques
    of each source arrive.

    Parameters
    ----------
    history : float, s
        How much older than the newest stamp a torque may be. Older states are discarded.
    others
        As for `Problem`.

    Raises
    ------
    ValueError
        An option is out of its range, or there are two gravity gradients.

    """

    def __init__(self, body: RigidBody, start: State, *, fields: Sequence[Field] = (),
                 actuator: Actuators = None, solver: str = Options.solver,
                 tolerance: float = Options.tolerance, max_step: float | None = Options.max_step,
                 torque_timeout: float = Options.torque_timeout,
                 history: float = 1.0) -> None:
        self._options = Options(solver, tolerance, max_step, torque_timeout)
        #: ns, at least 1; a torque older than the newest stamp by this much or more is dropped.
        self.history_ns = max(1, duration_ns(history, 'history'))
        self._options.check_terms(body.is_damped, start._has_rotors, bool(fields))
        self._fields = packed(beginning_at(fields, start.time_ns))
        self._start = start
        self._acting = ActingSamples(actuator, self._options.timeout_ns, start.time_ns)
        self._changes = [_Change(start.time_ns, {}, NewBody(-NEVER_NS, body, RATE))]
        self._begin()
        self._newest_ns: int | None = None

    @property
    def earliest_ns(self) -> int:
        """Return the earliest time that `at` accepts."""
        return self._changes[0].time_ns

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp of all torques and bodies, ns, or None before the first."""
        return self._newest_ns

    def held(self, time_ns: int) -> Mapping[int, Sample]:
        """Return by source the sample in force at a time, also if it has timed out."""
        return self._changes[max(self._index_of(time_ns), 0)].samples

    def delay_ns(self, source: int) -> int:
        """Return how long after its stamp a torque of a source acts, ns."""
        return self._acting.delay_ns(source)

    def body_at(self, time_ns: int) -> NewBody:
        """Return the body in force at a time; the stamp of the first one is -NEVER_NS."""
        return self._changes[max(self._index_of(time_ns), 0)].body

    def bodies_since(self, time_ns: int) -> list[NewBody]:
        """Return the body in force at a time, and all later ones, but for the first one."""
        index = max(self._index_of(time_ns), 0)
        found = dict.fromkeys(change.body for change in self._changes[index:])
        return [body for body in found if body.stamp_ns != -NEVER_NS]

    def stamps(self, after_ns: int, until_ns: int) -> list[int]:
        """
        Return the stamps of torques and bodies in (after_ns, until_ns], ns, ascending.

        Those before `earliest_ns` are forgotten.
        """
        first = self._index_of(after_ns) + 1
        end = self._index_of(until_ns + self._acting.longest_delay_ns) + 1
        if not self._acting.longest_delay_ns:
            return [change.time_ns for change in self._changes[first:end]]
        found = {stamp_ns for change in self._changes[first:end] for stamp_ns in (
            change.body.stamp_ns, *(sample.stamp_ns for sample in change.samples.values()))}
        return sorted(stamp_ns for stamp_ns in found if after_ns < stamp_ns <= until_ns)

    def samples_since(self, time_ns: int) -> list[tuple[int, Sample]]:
        """Return source and sample of the torques in force at a time, and of all later ones."""
        index = max(self._index_of(time_ns), 0)
        return [*self._changes[index].samples.items(), *(
            (source, sample) for change in self._changes[index + 1:]
            for source, sample in change.samples.items()
            if sample.stamp_ns + self._acting.delay_ns(source) == change.time_ns)]

    def apply(self, time_ns: int, torque: ArrayLike, frame: str = 'body',
              source: int = 0) -> bool:
        """
        Apply a torque from its stamp to the next stamp.

        Parameters
        ----------
        time_ns : int
            The stamp, ns, in any order. A torque from before the start is in force from the start
            to the next stamp.
        torque : array, shape (3,), N m
            About the centre of mass.
        frame : str
            'body' or 'space'.
        source : int
            The torques of different sources add up; each holds, and times out, on its own.

        Returns
        -------
        bool
            False if the torque was dropped: it is older than the newest stamp by `history` or
            more.

        Raises
        ------
        ValueError
            The torque is not finite, the frame is unknown, the source is negative, the time does
            not fit int64 or lies 292 years or more from the start, the solver is 'exact' and the
            torque is not zero, or earlier torques accelerate the body beyond 1e9 rad/s. The torque
            is not applied.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        values = self._checked_torque(time_ns, torque)
        if frame not in FRAMES:
            raise ValueError(f"frame: expected 'body' or 'space', found {frame!r}")
        if not 0 <= operator.index(source) < WHEELS:
            raise ValueError(f'source: expected a number from 0 on, found {source}')
        return self._apply(time_ns, source, values, frame == 'space')

    def apply_wheels(self, time_ns: int, torque: ArrayLike) -> bool:
        """
        Apply a torque of the motors on the rotors, from its stamp to the next stamp.

        Parameters
        ----------
        time_ns : int
            As for `apply`.
        torque : array, shape (3,), N m, body axes
            The body feels the opposite torque.

        Returns
        -------
        bool
            As for `apply`.

        Raises
        ------
        ValueError
            As for `apply`, or the solver does not handle rotors.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        values = self._checked_torque(time_ns, torque)
        self._options.check_terms(False, bool(values.any()))
        return self._apply(time_ns, WHEELS, values, False)

    def apply_body(self, time_ns: int, body: RigidBody, keep: str = RATE) -> bool:
        """
        Change the body from a stamp to the next one of a body.

        Parameters
        ----------
        time_ns : int
            As for `apply`. A body from before the start starts in place of the first one.
        body : RigidBody
            With its damping.
        keep : str
            'rate' or 'momentum': what goes on, see `BodyLog`.

        Returns
        -------
        bool
            As for `apply`.

        Raises
        ------
        ValueError
            As for `apply`, `keep` is neither, or the solver does not handle damping.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        self._options.check_terms(body.is_damped, False)
        index = self._inserted(time_ns)
        if index is None:
            return False
        self._put(index, NewBody(time_ns, body, checked_keep(keep)))
        return True

    def at(self, time_ns: int, within: float = math.inf) -> State:
        """
        Return the state at a time under the torques known so far.

        Parameters
        ----------
        time_ns : int
            In ns, from `earliest_ns` on. After the newest stamp the torque is held until it times
            out.
        within : float, s
            Limit on the computing time.

        Returns
        -------
        State

        Raises
        ------
        ValueError
            The time lies before `earliest_ns`, does not fit int64 or lies 292 years or more from
            the start, or the torques accelerate the body beyond 1e9 rad/s.
        TypeError
            The time is not an integer.
        TimeoutError
            The limit on the computing time was reached. The next call continues from there.

        """
        time_ns, until = self._checked_time(time_ns), time.monotonic() + within
        index = self._index_of(time_ns)
        if index < 0:
            raise ValueError(f'time_ns: expected {self.earliest_ns} ns or later, '
                             f'found {time_ns} ns')
        self._compute_segments(index, until)
        state = self._segment_at(self._changes[index], time_ns, until).state_at(time_ns, until)
        return with_rest(state, self._start.time_ns) if self._acting.lag else state

    def torque(self, state: State) -> Floats:
        """
        Return the torque of all sources that acts at a state which `at` returned.

        Returns
        -------
        array, shape (3,), N m, body axes
            As the actuators apply it; without those on the rotors and of fields.

        """
        change = self._changes[max(self._index_of(state.time_ns), 0)]
        segment = self._segment_at(change, state.time_ns, math.inf)
        return self._acting.torque(change.samples, segment.lagging, state)

    def _checked_torque(self, time_ns: int, torque: ArrayLike) -> Floats:
        values = np.array(torque, float).reshape(1, -1)
        if values.shape != (1, 3) or not all(map(math.isfinite, values[0].tolist())):
            raise ValueError(f'torque at {time_ns} ns: expected 3 finite numbers, '
                             f'found {values[0].tolist()}')
        if not self._options.record.takes_torque and values.any():
            raise ValueError(f'solver {self._options.solver!r} handles torque-free motion only, '
                             f'found a torque of {values[0].tolist()} N m at {time_ns} ns')
        return values

    def _checked_time(self, time_ns: int) -> int:
        found = instant(time_ns)
        if abs(found - self._start.time_ns) >= NEVER_NS:
            raise ValueError('time_ns: expected a time within 292 years of the start '
                             f'({self._start.time_ns} ns), found {found} ns')
        return found

    def _apply(self, time_ns: int, source: int, torque: Floats, in_space: bool) -> bool:
        index = self._inserted(time_ns, self._acting.delay_ns(source))
        if index is None:
            return False
        self._put(index, Sample(time_ns, torque, in_space), source)
        return True

    def _inserted(self, time_ns: int, delay_ns: int = 0) -> int | None:
        """Return the index of the change by a stamp, or None if the stamp is too old."""
        if self._newest_ns is not None and self._newest_ns - time_ns >= self.history_ns:
            return None
        self._discard_before(time_ns - self.history_ns)
        self._newest_ns = time_ns if self._newest_ns is None else max(self._newest_ns, time_ns)
        time_ns += delay_ns
        index = max(self._index_of(time_ns), 0)
        if time_ns > self._changes[index].time_ns:
            before = self._changes[index]
            self._changes.insert(index + 1, _Change(time_ns, {**before.samples}, before.body))
            index += 1
        return index

    def _put(self, index: int, new: Sample | NewBody, source: int = 0) -> None:
        # A sample is in force up to the next one of its source, and so is a body. While a stamp
        # may still come from before the start, the first change is the start: it is discarded only
        # when a stamp is `history` after it, and then every stamp that is as old is dropped.
        for change in self._changes[index:]:
            found = change.body if isinstance(new, NewBody) else change.samples.get(source)
            if found is not None and found.stamp_ns > new.stamp_ns:
                break
            if isinstance(new, NewBody):
                change.body = new
            else:
                change.samples[source] = new
        self._discard_segments(index)
        if self._changes[0].segment is None:
            self._begin()

    def _begin(self) -> None:
        """Compute the first segment."""
        start, first = self._start, self._changes[0]
        total, lagging = self._sum(first, start.time_ns, {})
        # A torque at the start begins a segment there, even if it repeats the one before.
        begins = any(start.time_ns in (sample.stamp_ns, sample.stamp_ns + self._options.timeout_ns)
                     for sample in self._acting.acting(first.samples).values())
        acts = not total.is_zero() or self._fields is not None or (
            first.body.body.is_damped or start._has_rotors)
        first.segment = self._segment(without_origin(start) if begins and acts else start, total,
                                      first.body.body, lagging)

    def _index_of(self, time_ns: int) -> int:
        """Return the index of the change in force at a time, or -1."""
        if time_ns >= self._changes[-1].time_ns:  # as most torques are
            return len(self._changes) - 1
        return bisect.bisect_right(self._changes, time_ns, key=_time_ns) - 1

    def _sum(self, change: _Change, time_ns: int, before: Mapping[int, Lagging]
             ) -> tuple[Sum, Mapping[int, Lagging]]:
        acting = self._acting
        total = summed(acting.acting(change.samples), time_ns, self._options.timeout_ns)
        if not acting.lag:
            return total, before
        lagging = acting.lagging(change.samples, time_ns, before)
        return total._replace(lags=acting.lags(lagging, time_ns)), lagging

    def _discard_before(self, horizon_ns: int) -> None:
        """Discard changes that no late torque can affect; raise ValueError as `at` does."""
        oldest = self._index_of(horizon_ns)
        if oldest > 0:
            self._compute_segments(oldest)
            del self._changes[:oldest]

    def _discard_segments(self, index: int) -> None:
        # Segments are computed from the front: if one is missing, all later ones are, too.
        self._changes[index].segment = None
        self._changes[index].after_timeouts.clear()
        for change in self._changes[index + 1:]:
            if change.segment is None:
                break
            change.segment = None
            change.after_timeouts.clear()

    def _compute_segments(self, index: int, until: float = math.inf) -> None:
        """Compute the segment of every change up to this one, or raise TimeoutError."""
        first = index
        while self._changes[first].segment is None:
            first -= 1
        for before, change in zip(self._changes[first:index], self._changes[first + 1:index + 1]):
            change.segment = self._next_segment(
                self._segment_at(before, change.time_ns, until), change, change.time_ns, until)
            if time.monotonic() > until:
                raise timed_out(change.time_ns)

    def _segment_at(self, change: _Change, time_ns: int, until: float) -> Segment:
        """Return the segment that contains a time between a change and the next."""
        active = change.segment
        assert active is not None
        for k, due_ns in enumerate(self._acting.due_ns(change.samples, change.time_ns)):
            if time_ns < due_ns:
                break
            if k == len(change.after_timeouts):
                change.after_timeouts.append(self._next_segment(active, change, due_ns, until))
            active = change.after_timeouts[k]
        return active

    def _next_segment(self, active: Segment, change: _Change, time_ns: int,
                      until: float) -> Segment:
        total, lagging = self._sum(change, time_ns, active.lagging)
        body = change.body
        if body.stamp_ns == time_ns:
            start = changed(active.end_at(time_ns, until), active.body, body.body, body.keep)
            return self._segment(start, total, body.body, lagging)
        if active.coasts and total.is_zero():
            return active
        return self._segment(active.end_at(time_ns, until), total, body.body, lagging)

    def _segment(self, start: State, total: Sum, body: RigidBody,
                 lagging: Mapping[int, Lagging]) -> Segment:
        return Segment(body, self._options, self.history_ns, start, total, self._fields, lagging)


@dataclass
class _Change:
    """What is in force from a time on: the sample of each source, and the body."""

    time_ns: int
    samples: dict[int, Sample]
    body: NewBody
    segment: Segment | None = None
    #: The segments that begin when samples time out, or when a lag is over, in order.
    after_timeouts: list[Segment] = field(default_factory=list)


def _time_ns(change: _Change) -> int:
    return change.time_ns
