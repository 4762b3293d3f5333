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
from dataclasses import dataclass
import math
import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, instant, NEVER_NS
from rigid_body_ros.kernels import motion_layout
from rigid_body_ros.propagation import layout, loop
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import Origin, origin_of, without_origin
from rigid_body_ros.torque import FRAMES

_NO_TORQUE = np.zeros((1, 3))
#: Outputs of the loop that are not read: only its latest state is used.
_UNUSED = motion_layout.allocate(1), np.empty(2, np.bool_)


class Propagator:
    """
    The motion under torques that arrive sample by sample.

    A torque commits the state at its stamp, computed under the torque before it. A state between
    stamps is a prediction: no later state depends on it. A torque that arrives late, by less than
    `history`, is inserted, and the later torques are applied again; of torques with equal stamps
    the last to arrive is used. So the states at the stamps are those of `propagate` with the whole
    log, bit for bit, in whatever order the torques arrive.

    Parameters
    ----------
    body, start, solver, tolerance, max_step, torque_timeout
        As for `propagate`.
    history : float, s
        How much older than the newest stamp a torque may be. Older states are discarded.

    Raises
    ------
    ValueError
        An option is out of its range.

    """

    def __init__(self, body: RigidBody, start: State, *, solver: str = Options.solver,
                 tolerance: float = Options.tolerance,
                 max_step: float | None = Options.max_step,
                 torque_timeout: float = Options.torque_timeout, history: float = 1.0) -> None:
        self._options = Options(solver, tolerance, max_step, torque_timeout)
        #: ns, at least 1; a torque older than the newest stamp by this much or more is dropped.
        self.history_ns = max(1, duration_ns(history, 'history'))
        self._body = body
        first = _Change(start.time_ns, start.time_ns, _NO_TORQUE, False)
        self._start = start
        first.segment = self._segment(start, first.torque, False)
        self._changes = [first]
        #: Stamp of the torque in force at the start, if one arrived.
        self._start_stamp_ns: int | None = None
        self._newest_ns: int | None = None

    @property
    def earliest_ns(self) -> int:
        """Return the earliest time that `at` accepts."""
        return self._changes[0].time_ns

    def apply(self, time_ns: int, torque: ArrayLike, frame: str = 'body') -> bool:
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

        Returns
        -------
        bool
            False if the torque was dropped: it is older than the newest stamp by `history` or
            more.

        Raises
        ------
        ValueError
            The torque is not finite, the frame is unknown, the time does not fit int64 or lies
            292 years or more from the start, the solver is 'exact' and the torque is not zero,
            or earlier torques accelerate the body beyond 1e9 rad/s. The torque is not applied.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        values = np.array(torque, float).reshape(1, -1)
        if values.shape != (1, 3) or not np.all(np.isfinite(values)):
            raise ValueError(f'torque at {time_ns} ns: expected 3 finite numbers, '
                             f'found {values[0].tolist()}')
        if not self._options.record.takes_torque and values.any():
            raise ValueError(f'solver {self._options.solver!r} handles torque-free motion only, '
                             f'found a torque of {values[0].tolist()} N m at {time_ns} ns')
        if frame not in FRAMES:
            raise ValueError(f"frame: expected 'body' or 'space', found {frame!r}")
        if self._newest_ns is not None and self._newest_ns - time_ns >= self.history_ns:
            return False
        self._discard_before(time_ns - self.history_ns)
        self._newest_ns = time_ns if self._newest_ns is None else max(self._newest_ns, time_ns)
        if time_ns <= self._changes[0].time_ns:
            self._apply_before_start(time_ns, values, frame == 'space')
        else:
            self._insert(_Change(time_ns, time_ns, values, frame == 'space'))
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
        index = bisect.bisect_right(self._changes, time_ns, key=_time_ns) - 1
        if index < 0:
            raise ValueError(f'time_ns: expected {self.earliest_ns} ns or later, '
                             f'found {time_ns} ns')
        self._compute_segments(index, until)
        return self._segment_at(self._changes[index], time_ns, until).state_at(time_ns, until)

    def _checked_time(self, time_ns: int) -> int:
        found = instant(time_ns)
        if abs(found - self._start.time_ns) >= NEVER_NS:
            raise ValueError('time_ns: expected a time within 292 years of the start '
                             f'({self._start.time_ns} ns), found {found} ns')
        return found

    def _apply_before_start(self, time_ns: int, torque: Floats, in_space: bool) -> None:
        # The first change is still the start: it is discarded only when a stamp is `history` after
        # the start, and then `apply` drops every torque with a stamp as old as the start.
        if self._start_stamp_ns is not None and time_ns < self._start_stamp_ns:
            return
        self._start_stamp_ns = time_ns
        start = self._changes[0]
        timeout = self._options.timeout_ns
        if timeout and time_ns + timeout <= start.time_ns:
            torque, in_space = _NO_TORQUE, False
        self._changes[0] = _Change(start.time_ns, time_ns, torque, in_space)
        # A torque at the start begins a segment there, even if it repeats the one before.
        begins = time_ns == start.time_ns and torque.any()
        self._changes[0].segment = self._segment(
            without_origin(self._start) if begins else self._start, torque, in_space)
        self._discard_segments(1)

    def _insert(self, change: _Change) -> None:
        index = bisect.bisect_left(self._changes, change.time_ns, key=_time_ns)
        found = index < len(self._changes) and self._changes[index].time_ns == change.time_ns
        self._changes[index:index + found] = [change]
        self._discard_segments(index + 1)

    def _discard_before(self, horizon_ns: int) -> None:
        """Discard changes that no late torque can affect; raise ValueError as `at` does."""
        oldest = bisect.bisect_right(self._changes, horizon_ns, key=_time_ns) - 1
        if oldest > 0:
            self._compute_segments(oldest)
            del self._changes[:oldest]

    def _discard_segments(self, index: int) -> None:
        # Segments are computed from the front: if one is missing, all later ones are, too.
        while index < len(self._changes) and self._changes[index].segment is not None:
            self._changes[index].segment = self._changes[index].after_timeout = None
            index += 1

    def _compute_segments(self, index: int, until: float = math.inf) -> None:
        """Compute the segment of every change up to this one, or raise TimeoutError."""
        first = index
        while self._changes[first].segment is None:
            first -= 1
        for before, change in zip(self._changes[first:index], self._changes[first + 1:index + 1]):
            active = self._segment_at(before, change.time_ns, until)
            if active.coasts and not change.torque.any():
                change.segment = active
            else:
                change.segment = self._segment(active.end_at(change.time_ns, until),
                                               change.torque, change.in_space)
            if time.monotonic() > until:
                raise _timed_out(change.time_ns)

    def _segment_at(self, change: _Change, time_ns: int, until: float) -> _Segment:
        """Return the segment that contains a time between a change and the next."""
        assert change.segment is not None
        due = change.stamp_ns + self._options.timeout_ns
        if not self._options.timeout_ns or change.segment.coasts or time_ns < due:
            return change.segment
        if change.after_timeout is None:
            change.after_timeout = self._segment(change.segment.end_at(due, until), _NO_TORQUE,
                                                 False)
        return change.after_timeout

    def _segment(self, start: State, torque: Floats, in_space: bool) -> _Segment:
        return _Segment(self._body, self._options, self.history_ns, start, torque, in_space)


@dataclass
class _Change:
    """A torque that comes into force at a time. At the start its stamp may be earlier."""

    time_ns: int
    stamp_ns: int
    torque: Floats
    in_space: bool
    segment: _Segment | None = None
    #: The coast that begins when the torque times out.
    after_timeout: _Segment | None = None


def _time_ns(change: _Change) -> int:
    return change.time_ns


def _timed_out(reached_ns: int) -> TimeoutError:
    return TimeoutError(f'the limit on the computing time was reached at {reached_ns} ns of the '
                        'motion: call again to continue from there, or raise the limit')


def _read_only(values: ArrayLike) -> NDArray[Any]:
    """Return a read-only array, as in a log: the kernels are compiled for this type."""
    array = np.array(values)
    array.flags.writeable = False
    return array


class _Segment:
    """The motion under one held torque, with the grid points reached so far."""

    def __init__(self, body: RigidBody, options: Options, history_ns: int, start: State,
                 torque: Floats, in_space: bool) -> None:
        self.coasts = not torque.any()
        self._options, self._history_ns = options, history_ns
        self._rule = options.rule(body, torque, in_space)
        origin = origin_of(start, self._rule)
        self._grid_ns = [*dict.fromkeys((origin.begin_ns, origin.grid_ns))]
        self._states = [origin.begin, origin.grid][:len(self._grid_ns)]
        self._log = _read_only([origin.begin_ns]), _read_only([torque]), _read_only([in_space])
        self._constants = body._constants

    def state_at(self, time_ns: int, until: float) -> State:
        begin_ns, begin = self._grid_ns[0], self._states[0]
        if time_ns == begin_ns:
            return State._as_computed(time_ns, begin, Origin(
                self._rule, begin_ns, begin, begin_ns, begin))
        nearest = bisect.bisect_right(self._grid_ns, time_ns) - 1
        states = layout.pack_states(self._states[nearest], begin)
        progress = layout.pack_place(self._grid_ns[nearest], begin_ns, 0)
        self._run(states, progress, time_ns, until)
        grid, _, latest = layout.unpack_states(states)
        grid_ns = int(progress[layout.GRID_NS])
        if grid_ns > self._grid_ns[-1]:
            self._grid_ns.append(grid_ns)
            self._states.append(grid)
            self._discard_grid_points(grid_ns - self._history_ns)
        if not progress[layout.DONE]:
            raise _timed_out(grid_ns)
        return State._as_computed(time_ns, latest, Origin(
            self._rule, begin_ns, begin, grid_ns, grid))

    def _run(self, states: Floats, progress: NDArray[np.int64], time_ns: int,
             until: float) -> None:
        """Run the loop up to a time, or until the computing time is used up."""
        times = np.array([time_ns])
        while result := loop.run(states, progress, times, loop.IN_ORDER, *_UNUSED, *self._log,
                                 0, 1, self._constants, self._options.settings, loop.BUDGET):
            if result == loop.TOO_FAST:
                raise self._options.too_fast(
                    time_ns if progress[layout.DONE] else int(progress[layout.GRID_NS]))
            if time.monotonic() > until:
                break

    def end_at(self, time_ns: int, until: float) -> State:
        """Return the state with which the next segment begins."""
        return without_origin(self.state_at(time_ns, until))

    def _discard_grid_points(self, horizon_ns: int) -> None:
        # Keep those of the last `history`, which `at` resumes from after a late torque, and the
        # beginning, from which it computes any earlier time.
        while len(self._grid_ns) > 2 and self._grid_ns[2] <= horizon_ns:
            del self._grid_ns[1], self._states[1]
