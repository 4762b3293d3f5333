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

"""The motion under a torque that grows sample by sample."""

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
from rigid_body_ros.common.times import instant, NEVER_NS
from rigid_body_ros.propagation import loop
from rigid_body_ros.propagation.loop import Origin
from rigid_body_ros.propagation.options import duration_ns, Options
from rigid_body_ros.torque import FRAMES

_NO_TORQUE = np.zeros((1, 3))
#: What a kernel fills and nobody reads: only its last state is wanted.
_UNUSED = np.empty(7), np.empty(2, np.bool_)


class Propagator:
    """
    The motion under a torque that grows sample by sample.

    A torque fixes the state at its stamp under the torque before it; the state between stamps
    is a prediction that nothing later is built on. A torque that comes late, by less than
    `history`, is put in its place and the later ones are applied again; of equal stamps the
    last to come counts. So the states at the stamps are those of `propagate` with the whole log,
    bit for bit, whatever the order of arrival.

    Parameters
    ----------
    body, start, solver, tolerance, max_step, torque_timeout
        As for `propagate`.
    history : float, s
        How much older than the newest stamp a torque may be. States further back are forgotten.

    Raises
    ------
    ValueError
        An option is out of its range.

    """

    def __init__(self, body: RigidBody, start: State, *, solver: str = 'auto',
                 tolerance: float = 1e-15, max_step: float | None = None,
                 torque_timeout: float = 0.0, history: float = 1.0) -> None:
        self._options = Options(solver, tolerance, max_step, torque_timeout)
        #: How much older than the newest stamp a torque is dropped; never that stamp itself.
        self.history_ns = max(1, duration_ns(history, 'history'))
        self._body = body
        first = _Change(start.time_ns, start.time_ns, _NO_TORQUE, False)
        self._start = start
        first.segment = self._segment(start, first.torque, False)
        self._changes = [first]
        #: Stamp of the torque in force at the start, if one came.
        self._before_start: int | None = None
        self._newest_ns: int | None = None

    @property
    def earliest_ns(self) -> int:
        """Return the earliest time that `at` still answers for."""
        return self._changes[0].time_ns

    def apply(self, time_ns: int, torque: ArrayLike, frame: str = 'body') -> bool:
        """
        Hold a torque from a stamp on, up to the next stamp.

        Parameters
        ----------
        time_ns : int
            In any order. A torque from before the start holds there, too, up to the next stamp.
        torque : array, shape (3,), N m
            About the centre of mass; zeros end the torque.
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
            292 years or more from the start, or the torques before brought the body beyond
            1e9 rad/s; it is not applied then.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked(time_ns)
        values = np.array(torque, float).reshape(1, -1)
        if values.shape != (1, 3) or not np.all(np.isfinite(values)):
            raise ValueError(f'torque at {time_ns} ns: expected 3 finite numbers, '
                             f'found {values[0].tolist()}')
        if self._options.solver == 'exact' and values.any():
            raise ValueError("solver 'exact' is for motion without torque, found a torque of "
                             f'{values[0].tolist()} N m at {time_ns} ns')
        if frame not in FRAMES:
            raise ValueError(f"frame: expected 'body' or 'space', found {frame!r}")
        if self._newest_ns is not None and self._newest_ns - time_ns >= self.history_ns:
            return False
        self._forget_before(time_ns - self.history_ns)
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
            From `earliest_ns` on; past the newest stamp its torque holds, up to the timeout.
        within : float, s
            How long to work for it.

        Raises
        ------
        ValueError
            The time lies before the start, or further back than is remembered, does not fit
            int64 or lies 292 years or more from the start, or the torques bring the body beyond
            1e9 rad/s.
        TypeError
            The time is not an integer.
        TimeoutError
            It would have taken longer; the next call goes on from where this one got.

        """
        time_ns, until = self._checked(time_ns), time.monotonic() + within
        index = bisect.bisect_right(self._changes, time_ns, key=_time_ns) - 1
        if index < 0:
            raise ValueError(f'expected a time from {self.earliest_ns} ns on, found {time_ns} ns')
        self._resolve(index, until)
        return self._active(self._changes[index], time_ns, until).state_at(time_ns, until)

    def _checked(self, time_ns: int) -> int:
        found = instant(time_ns)
        if abs(found - self._start.time_ns) >= NEVER_NS:
            raise ValueError('time_ns: expected a time within 292 years of the start, '
                             f'{self._start.time_ns} ns, found {found} ns')
        return found

    def _apply_before_start(self, time_ns: int, torque: Floats, in_space: bool) -> None:
        # Nothing is forgotten before a stamp is `history` past the start, and a stamp as old as
        # the start is dropped from then on: so the first change is still the start.
        if self._before_start is not None and time_ns < self._before_start:
            return
        self._before_start = time_ns
        start = self._changes[0]
        timeout = self._options.timeout_ns
        if timeout and time_ns + timeout <= start.time_ns:
            torque, in_space = _NO_TORQUE, False
        self._changes[0] = _Change(start.time_ns, time_ns, torque, in_space)
        # A torque at the start begins a segment there, even if it repeats the one before.
        self._changes[0].segment = self._segment(
            _bare(self._start) if time_ns == start.time_ns and torque.any() else self._start,
            torque, in_space)
        self._forget_from(1)

    def _insert(self, change: _Change) -> None:
        index = bisect.bisect_left(self._changes, change.time_ns, key=_time_ns)
        found = index < len(self._changes) and self._changes[index].time_ns == change.time_ns
        self._changes[index:index + found] = [change]
        self._forget_from(index + 1)

    def _forget_before(self, horizon_ns: int) -> None:
        """Keep what a late torque may change; ValueError, and nothing is forgotten, as of `at`."""
        oldest = bisect.bisect_right(self._changes, horizon_ns, key=_time_ns) - 1
        if oldest > 0:
            self._resolve(oldest)
            del self._changes[:oldest]

    def _forget_from(self, index: int) -> None:
        # Segments are resolved from the front: where one is missing, the later ones are, too.
        while index < len(self._changes) and self._changes[index].segment is not None:
            self._changes[index].segment = self._changes[index].silence = None
            index += 1

    def _resolve(self, index: int, until: float = math.inf) -> None:
        """Give every change up to this one its segment, or raise TimeoutError."""
        first = index
        while self._changes[first].segment is None:
            first -= 1
        for before, change in zip(self._changes[first:index], self._changes[first + 1:index + 1]):
            active = self._active(before, change.time_ns, until)
            if active.coasts and not change.torque.any():
                change.segment = active
            else:
                change.segment = self._segment(active.end_at(change.time_ns, until),
                                               change.torque, change.in_space)
            if time.monotonic() > until:
                raise TimeoutError(f'the motion is known up to {change.time_ns} ns')

    def _active(self, change: _Change, time_ns: int, until: float) -> _Segment:
        """Return the segment that holds at a time from a change on, before the next change."""
        assert change.segment is not None
        due = change.stamp_ns + self._options.timeout_ns
        if not self._options.timeout_ns or change.segment.coasts or time_ns < due:
            return change.segment
        if change.silence is None:
            change.silence = self._segment(change.segment.end_at(due, until), _NO_TORQUE,
                                           False)
        return change.silence

    def _segment(self, start: State, torque: Floats, in_space: bool) -> _Segment:
        return _Segment(self._body, self._options, self.history_ns, start, torque, in_space)


@dataclass
class _Change:
    """A torque from a time on; the stamp is earlier than the time only for the start."""

    time_ns: int
    stamp_ns: int
    torque: Floats
    in_space: bool
    segment: _Segment | None = None
    #: The coast that follows when the torque times out.
    silence: _Segment | None = None


def _time_ns(change: _Change) -> int:
    return change.time_ns


def _bare(state: State) -> State:
    """Return a state that does not tell where it comes from."""
    return State._as_computed(state.time_ns, state._packed)


def _frozen(values: ArrayLike) -> NDArray[Any]:
    """Return an array of the kind that logs hold: the kernels are compiled for one kind."""
    array = np.array(values)
    array.flags.writeable = False
    return array


class _Segment:
    """The motion from a start on under one held torque, with the grid points reached so far."""

    def __init__(self, body: RigidBody, options: Options, history_ns: int, start: State,
                 torque: Floats, in_space: bool) -> None:
        self.coasts = not torque.any()
        self._options, self._history_ns = options, history_ns
        self._rule = options.rule(body, torque, in_space)
        origin = loop.origin(start, self._rule)
        self._grid_ns = [*dict.fromkeys((origin.begin_ns, origin.grid_ns))]
        self._states = [origin.begin, origin.grid][:len(self._grid_ns)]
        self._log = (_frozen([origin.begin_ns]), _frozen([torque]), _frozen([in_space]), 0, 1, 0)
        self._arguments = options.kernel_arguments(body)

    def state_at(self, time_ns: int, until: float) -> State:
        if time_ns == self._grid_ns[0]:
            return State._as_computed(time_ns, self._states[0], Origin(
                self._rule, time_ns, self._states[0], time_ns, self._states[0]))
        nearest = bisect.bisect_right(self._grid_ns, time_ns) - 1
        states = loop.working_states(self._states[nearest], self._states[0])
        grid, _, out = states.reshape(3, -1)
        grid_ns, begin_ns = self._grid_ns[nearest], self._grid_ns[0]
        sample, silent, done = 0, False, 0
        while not done:
            grid_ns, begin_ns, sample, silent, done, fast = loop.run(*(
                states, grid_ns, begin_ns, sample, silent, done, np.array([time_ns]),
                loop.IN_ORDER, *_UNUSED, *self._log, *self._arguments, loop.BUDGET))
            if fast:
                raise self._options.too_fast(time_ns if done else grid_ns)
            if time.monotonic() > until:
                break
        if grid_ns > self._grid_ns[-1]:
            self._grid_ns.append(grid_ns)
            self._states.append(grid)
            self._thin(grid_ns - self._history_ns)
        if not done:
            raise TimeoutError(f'the motion is known up to {grid_ns} ns, not yet to {time_ns} ns')
        return State._as_computed(time_ns, out, Origin(
            self._rule, self._grid_ns[0], self._states[0], grid_ns, grid))

    def end_at(self, time_ns: int, until: float) -> State:
        """Return a state that the next segment begins with, even if the torque stays the same."""
        return _bare(self.state_at(time_ns, until))

    def _thin(self, horizon_ns: int) -> None:
        # A late torque asks at most `history` back; the start stays for whoever asks further.
        while len(self._grid_ns) > 2 and self._grid_ns[2] <= horizon_ns:
            del self._grid_ns[1], self._states[1]
