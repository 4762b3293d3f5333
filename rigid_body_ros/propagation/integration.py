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

"""Integrate a problem, all at once or piece by piece."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Generic

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine import kernels, layout, motion_layout, state_layout
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import changed
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Axial
from rigid_body_ros.propagation.inputs import Same
from rigid_body_ros.propagation.lags import with_momenta
from rigid_body_ros.propagation.models import SolverUsage
from rigid_body_ros.propagation.options import checked_times
from rigid_body_ros.propagation.origin import origin_of
from rigid_body_ros.propagation.timeline import NO_OTHERS, OtherTorques, Timeline
from rigid_body_ros.propagation.trajectory import joined, Trajectory
from rigid_body_ros.propagation.wheels import in_force, WheelTimeline

#: `_resolve` begins by trying `_WINDOW` wheel commands. If a wheel has a `max_speed`, so that
#: commands may be treated as zero, a timeline contains at most `_SPAN` wheel commands.
_WINDOW, _SPAN = 16, 512


class Integration(Generic[Same]):
    """
    A motion that is computed piece by piece and agrees bit for bit with `propagate`.

    Parameters
    ----------
    problem : Problem
        The problem with all torques, or with the first piece of each log.

    Attributes
    ----------
    problem : Problem
        The problem, which contains the current piece of each log.
    refused_commands : int
        Number of wheel commands that have been treated as zero so far, because their wheels were
        too fast.

    """

    # These defaults are class attributes, because most motions keep them, and it takes time to set
    # the attributes of an instance.
    #: Number of wheel commands for which `_resolve` has determined whether they act.
    _resolved = refused_commands = 0
    #: If the first row of the timeline begins before the start, the time at which the row begins,
    #: and the rotor momentum at that time. Otherwise None.
    _earlier: tuple[int, Floats] | None = None

    def __init__(self, problem: Same) -> None:
        start = problem.start
        self.problem, self._end_ns = problem, start.time_ns
        #: The current body (`_body`), and the same body without the axial inertia of the named
        #: wheels (`_carrier`).
        self._body = self._carrier = problem.body_at(start.time_ns)
        #: The latest time at which the next timeline may begin. This limit keeps timelines short.
        self._mark_ns = NEVER_NS
        #: The state of the named wheels.
        self._wheels: WheelTimeline | None = None
        self._others = NO_OTHERS
        if problem.fields or problem.actuators:
            self._others = OtherTorques(problem._fields, problem.lagging())
        if problem.named_wheels:
            self._carrier = problem.named_wheels.carrier(self._body)
            start, axial = problem.named_wheels.begun(start)
            self._wheels = self._wheels_from(axial, start)
        self._start = start
        has_rotors = start._has_rotors or problem.has_friction
        self._timeline = self._timeline_from(
            start.time_ns, start._rotors if has_rotors else None)
        self._progress, self._is_begun = self._begin(), False

    def _wheels_from(self, axial: Axial, state: State) -> WheelTimeline:
        """Return the wheels from a state onward, where the commands in force take effect."""
        problem, end_ns = self.problem, self._end_ns
        assert problem.named_wheels
        begun = in_force(problem.named_wheels, axial, problem.efforts, state,
                         problem.options.timeout_ns)
        if begun is not axial and begun.stamp_ns == end_ns:
            self.refused_commands += int(begun.refused.sum())
        return self._wheels_on(begun)

    def _wheels_on(self, axial: Axial) -> WheelTimeline:
        """Return the wheels for the rest of the motion."""
        problem, end_ns = self.problem, self._end_ns
        assert problem.named_wheels
        wheels, efforts = problem.named_wheels, problem.efforts
        self._resolved, self._mark_ns = 0, NEVER_NS
        if efforts and wheels.is_limited:  # a wrong guess rebuilds a timeline, so keep it short
            later_ns = efforts.times_ns[efforts.times_ns.searchsorted(end_ns, 'right'):]
            if len(later_ns) > _SPAN:
                self._mark_ns = int(later_ns[_SPAN])
                efforts = efforts.between(end_ns, self._mark_ns)
        return WheelTimeline(wheels, axial, efforts, problem.options.timeout_ns, end_ns)

    def _timeline_from(self, start_ns: int, momentum: Floats | None) -> Timeline:
        """Return the inputs for the rest of the motion, which continues at `start_ns`."""
        problem = self.problem
        logs, wheels = problem.acting_logs, problem.wheels
        if self._wheels:
            self._basis, wheels = (start_ns, momentum), self._wheels.log
        if problem.changes or self._mark_ns < NEVER_NS:
            # Leave out the torques outside this part of the motion, because the sum of these
            # torques is not needed here.
            end_ns = problem.changes.next_ns(start_ns) if problem.changes else NEVER_NS
            span = start_ns, min(end_ns, self._mark_ns)
            logs = tuple(log.between(*span) for log in logs)
            wheels = wheels and wheels.between(*span)
        self._sources = (*logs, wheels) if wheels else logs
        others = self._others
        if problem.has_friction:
            wheels, others = None, others._replace(wheels=self._wheels)
        return Timeline(logs, wheels, problem.options.timeout_ns, self._body.is_damped,
                        start_ns, momentum, others)

    def _rebuilt(self) -> Timeline:
        """Rebuild the timeline with the wheel commands that are now assumed to act."""
        timeline = self._timeline_from(*self._basis)
        if self._earlier:
            timeline.begin_earlier(*self._earlier)
        return timeline

    def _begin(self) -> NDArray[Any]:
        start, stop = self._start, len(self._timeline.times_ns)
        row = self._timeline.in_force(start.time_ns)
        if start._origin is None:
            return layout.begun(start._packed, start.time_ns, start._packed, start.time_ns, row,
                                stop)
        origin = origin_of(start, self._rule(row))
        if origin.begin_ns != start.time_ns:
            self._earlier = origin.begin_ns, origin.rotors
            self._timeline.begin_earlier(*self._earlier)
        return layout.begun(origin.grid, origin.grid_ns, origin.begin, origin.begin_ns, row,
                            stop)

    def _rule(self, row: int) -> Hashable:
        """
        Return the `Options.rule` of the segment in which the motion begins, or None.

        The result is None if this segment begins exactly at the start, or if a torque changes
        within the segment.
        """
        problem, start_ns = self.problem, self._start.time_ns
        found = self._timeline.held(row)
        if found is None:
            return None
        torque, in_space, others = found
        lagging = self._others.lagging
        acts = torque.any() or any(other.any() for other in others)
        # A torque whose stamp is the start begins a new segment, even if this torque equals the
        # previous one.
        begins = any((log.segments(problem.options.timeout_ns)[0] == start_ns).any()
                     for log in self._sources) and (acts or self._timeline.has_terms)
        if lagging and not others.pop().any():
            lagging = None
        key = [*([lagging.key(start_ns)] if lagging else []), *self._timeline.key(row)]
        return None if begins else problem.options.rule(
            self._carrier, problem._fields, torque, in_space, *others, *key)

    def extend(self, problem: Same) -> None:
        """
        Continue the motion with the next piece of each log.

        Parameters
        ----------
        problem : Problem
            The same problem with the next piece of each log. Each piece must begin with the sample
            in force at the end of the motion so far, or with an earlier sample. For cubic
            interpolation, the log must also contain the three samples before the sample in force,
            and the three samples after the end of the piece.

        """
        momentum = self._momentum()
        self.problem = problem
        if self._wheels:
            self._wheels = self._wheels_on(self._wheels.axial(self._end_ns))
        self._timeline, self._earlier = self._timeline_from(self._end_ns, momentum), None
        self._progress['row'], self._is_begun = self._timeline.in_force(self._end_ns), True

    def advance(self, at: ArrayLike, until_ns: int | None = None) -> Trajectory:
        """
        Continue the motion to the latest of the given times, and return it at all given times.

        Parameters
        ----------
        at : array of int, shape (m,), ns
            The times, in any order. No time may lie before the end of the motion so far.
        until_ns : int, optional
            The end of this piece, which must be the time of a sample. The motion is computed up to
            this time, and no time in `at` may be later. The next call must be to `extend`. Omit
            this argument if no more torques follow, or if the next call continues within this
            piece.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            A time lies before the end of the motion so far or is not an integer that fits in
            int64, or the torques accelerate the body beyond 1e9 rad/s.

        """
        requested = checked_times(at, self._end_ns)
        last_ns = requested[2] if until_ns is None else max(requested[2], until_ns)
        if self._next_ns > last_ns:
            return self._advance(*requested, until_ns)
        parts, later = list[Trajectory](), requested[0]
        while (next_ns := self._next_ns) <= last_ns:
            before, changes = later < next_ns, self.problem.changes
            parts.append(self._advance(*checked_times(later[before], self._end_ns), next_ns))
            if changes and next_ns == changes.times_ns[changes.in_force(next_ns)]:
                self._change(changes.bodies[changes.in_force(next_ns)])
            else:
                self.extend(self.problem)
            later = later[~before]
        parts.append(self._advance(*checked_times(later, self._end_ns), until_ns))
        return joined(requested[0], parts)

    @property
    def _next_ns(self) -> int:
        """Return the end of the current timeline, no later than the next change of the body."""
        changes = self.problem.changes
        return min(self._mark_ns, changes.next_ns(self._end_ns)) if changes else self._mark_ns

    def _change(self, body: RigidBody) -> None:
        """Continue with another body from the end of the motion so far."""
        assert self.problem.changes
        time_ns, momentum = self._end_ns, self._momentum()
        state, carrier = State._as_computed(time_ns, self._progress['latest'][0]), body
        if self._wheels:
            carrier = self._wheels.wheels.carrier(body)
        state = changed(state, self._carrier, carrier, self.problem.changes.keep)
        packed = state._packed
        self._body, self._carrier = body, carrier
        if self._wheels:  # the change affects the speeds, so check the commands at this time again
            self.refused_commands -= self._wheels.count_refused(time_ns - 1, time_ns)
            self._wheels = self._wheels_from(self._wheels.axial(time_ns - 1), state)
        self._timeline, self._earlier = self._timeline_from(time_ns, momentum), None
        self._progress = layout.begun(packed, time_ns, packed, time_ns,
                                      self._timeline.in_force(time_ns),
                                      len(self._timeline.times_ns))

    def _momentum(self) -> Floats | None:
        """Return the rotor momentum at the end of the motion so far, or None without rotors."""
        if not self._timeline.has_rotors:
            return None
        return self._timeline.momentum(np.array([self._end_ns]))[0]

    def _advance(self, times_ns: NDArray[np.int64], ascends: bool, end_ns: int,
                 until_ns: int | None) -> Trajectory:
        """Return the motion at times that `checked_times` returned, while the body is the same."""
        begin_ns = self._end_ns
        count, stop = times_ns.size, len(self._timeline.times_ns)
        if until_ns is not None and until_ns > begin_ns:
            stop = int(np.searchsorted(self._timeline.times_ns, until_ns))
            if end_ns < until_ns:  # the end of the piece was not requested: add it
                times_ns, end_ns = np.append(times_ns, until_ns), until_ns
        order = layout.IN_ORDER if ascends else np.argsort(times_ns, kind='stable')
        if self._wheels:
            self._resolve(self._wheels, end_ns)
            self.refused_commands += self._wheels.count_refused(begin_ns, end_ns)
        motion = motion_layout.allocate(times_ns.size)
        closed, momenta = self._fill(times_ns, order, motion, stop)
        self._end_ns = end_ns
        usage = SolverUsage(self._body, self.problem.options, self._timeline, begin_ns,
                            end_ns, closed, self._wheels)
        if times_ns.size > count:
            times_ns = times_ns[:count]
        return Trajectory(times_ns, motion, (usage,), momenta)

    def _resolve(self, wheels: WheelTimeline, end_ns: int) -> None:
        """Determine which of the wheel commands up to a time act and which are refused."""
        if not wheels.wheels.is_limited:
            return
        start, stop = self._mark(), int(wheels.times_ns.searchsorted(end_ns, 'right'))
        window = _WINDOW
        while self._resolved < stop:
            rows, before = slice(self._resolved, min(self._resolved + window, stop)), self._mark()
            speeds = self._speeds_at(wheels, wheels.times_ns[rows])
            wrong = wheels.first_wrong(rows, wheels.refused(rows, speeds))
            if wrong is None:
                self._resolved, window = rows.stop, 2 * window
                continue
            # Assume that the wheels are as fast at all later commands as they are at this one.
            wheels.assume(wrong, wheels.refused(slice(wrong, None), speeds[wrong - rows.start]))
            self._timeline, self._resolved, window = self._rebuilt(), wrong + 1, _WINDOW
            self._progress, self._is_begun = before
        self._progress, self._is_begun = start

    def _mark(self) -> tuple[NDArray[Any], bool]:
        """Return a copy of the progress, so that the loop can return to this point later."""
        return self._progress.copy(), self._is_begun

    def _speeds_at(self, wheels: WheelTimeline, times_ns: NDArray[np.int64]) -> Floats:
        """Continue to the last given time; return all wheel speeds, rad/s, shape (m, wheels)."""
        motion = motion_layout.allocate(times_ns.size)
        _, momenta = self._fill(times_ns, layout.IN_ORDER, motion, len(self._timeline.times_ns))
        if momenta is None:
            momenta = wheels.momenta(times_ns)[:, 0]
        return wheels.wheels.speeds(momenta, motion_layout.angular_velocity(motion))

    def rotor_momentum(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the rotor momentum at given times in this piece, N m s, shape (m, 3)."""
        return self._timeline.momentum(times_ns)[:, 0]

    def _fill(self, times_ns: NDArray[np.int64], order: NDArray[np.intp], motion: Floats,
              stop: int) -> tuple[NDArray[np.bool_], Floats | None]:
        """
        Compute the motion at the given times, but not beyond the beginning of the row `stop`.

        The method returns `SolverUsage.closed` and `Trajectory._momenta`.
        """
        closed = np.zeros(len(self._timeline.times_ns) + 1, np.bool_)
        progress, problem = self._progress, self.problem
        if not times_ns.size:
            return closed, None
        momenta: Floats | None = None
        if self._is_begun:
            progress['done'] = 0
        for first, end, rows in self._timeline.chunks(progress['row'], stop):
            if rows.terms and rows.terms.friction:
                rows, momenta = with_momenta(rows, times_ns.size)
            if self._is_begun or end - first < len(closed) - 1:
                progress['row'] -= first
                progress['stop'] = end - first
            marks = closed[first:first + len(rows.times_ns) + 1]
            while result := kernels.run(progress, times_ns, order, motion, marks, rows,
                                        self._carrier._constants, problem.options.method):
                if result == layout.TOO_FAST:
                    raise problem.options.too_fast(int(progress['grid_ns'][0]))
            if first:
                progress['row'] += first
        self._is_begun = True
        if stop < len(closed) - 1 and (done := int(progress['done'][0])) < times_ns.size:
            # The remaining outputs are at the end of the piece, so they get the state of the last
            # grid point.
            again = (order if len(order) else np.arange(times_ns.size))[done:]
            grid = progress['grid'][0]
            motion_layout.attitude(motion)[again] = state_layout.attitude(grid)
            motion_layout.angular_velocity(motion)[again] = state_layout.angular_velocity(grid)
            if momenta is not None:
                momenta[again] = state_layout.momenta(grid)[0, :momenta.shape[1]]
        return closed, momenta
