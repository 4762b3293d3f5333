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

from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, Generic

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine import Friction, kernels, layout, motion_layout, state_layout
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import changed
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Axial
from rigid_body_ros.propagation.inputs import Same
from rigid_body_ros.propagation.models import SolverUsage
from rigid_body_ros.propagation.options import checked_times
from rigid_body_ros.propagation.origin import origin_of
from rigid_body_ros.propagation.timeline import NO_OTHERS, OtherTorques, Timeline
from rigid_body_ros.propagation.trajectory import joined, Trajectory
from rigid_body_ros.propagation.wheels import Commands, in_force, WheelTimeline, with_outputs

#: The loop stops when it has found this many events of wheels, and continues with an empty list.
_EVENTS = 256


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

    """

    def __init__(self, problem: Same) -> None:
        start = problem.start
        self.problem, self._end_ns = problem, start.time_ns
        self._restart: Callable[[], Integration[Same]] | None = partial(Integration, problem)
        #: The current body (`_body`), and the same body without the axial inertia of the named
        #: wheels (`_carrier`).
        self._body = self._carrier = problem.body_at(start.time_ns)
        #: The state of the named wheels.
        self._wheels: WheelTimeline | None = None
        self._others = NO_OTHERS
        if problem.fields or problem.actuators:
            self._others = OtherTorques(problem._fields, problem.lagging())
        if problem.named_wheels:
            self._carrier = problem.named_wheels.carrier(self._body)
            start, axial = problem.named_wheels.begun(start)
            self._wheels = self._wheels_from(axial, start, -NEVER_NS)
        self._start = start
        has_rotors = start._has_rotors or problem.is_coupled
        #: When wheels have reached or left their largest speed: the last event of each wheel
        #: before this piece, and all events in it; see `layout.Friction`.
        self._events = list[Ints]()
        self._timeline = self._timeline_from(
            start.time_ns, start._rotors if has_rotors else None)
        self._progress, self._is_begun = self._begin(), False

    def _wheels_from(self, axial: Axial, state: State, after_ns: int) -> WheelTimeline:
        """
        Return the wheels from a state onward, where the commands in force take effect.

        These are the commands with stamps after `after_ns`; `axial` has the earlier ones.
        """
        problem = self.problem
        assert problem.named_wheels
        if problem.efforts:
            axial = in_force(problem.named_wheels, axial,
                             Commands.of(problem.efforts, after_ns, state.time_ns), state,
                             problem.options.timeout_ns)
        return self._wheels_on(axial)

    def _wheels_on(self, axial: Axial) -> WheelTimeline:
        """Return the wheels for the rest of the motion."""
        problem = self.problem
        assert problem.named_wheels
        return WheelTimeline(problem.named_wheels, axial, problem.efforts,
                             problem.options.timeout_ns, self._end_ns)

    def _timeline_from(self, start_ns: int, momentum: Floats | None) -> Timeline:
        """Return the inputs for the rest of the motion, which continues at `start_ns`."""
        problem = self.problem
        logs, wheels = problem.acting_logs, problem.wheels
        if self._wheels:
            wheels = self._wheels.log
        if problem.changes:
            # Leave out the torques outside this part of the motion, because the sum of these
            # torques is not needed here.
            span = start_ns, problem.changes.next_ns(start_ns)
            logs = tuple(log.between(*span) for log in logs)
            wheels = wheels and wheels.between(*span)
        self._sources = (*logs, wheels) if wheels else logs
        others = self._others
        if problem.is_coupled:
            wheels, others = None, others._replace(wheels=self._wheels)
        return Timeline(logs, wheels, problem.options.timeout_ns, self._body.is_damped,
                        start_ns, momentum, others)

    def _begin(self) -> NDArray[Any]:
        start, stop = self._start, len(self._timeline.times_ns)
        row = self._timeline.in_force(start.time_ns)
        if start._origin is None:
            return layout.begun(start._packed, start.time_ns, start._packed, start.time_ns, row,
                                stop)
        origin = origin_of(start, self._rule(row))
        if origin.begin_ns != start.time_ns:
            self._timeline.begin_earlier(origin.begin_ns, origin.rotors)
        return layout.begun(origin.grid, origin.grid_ns, origin.begin, origin.begin_ns, row,
                            stop)

    def _rule(self, row: int) -> Hashable:
        """
        Return the `Options.rule` of the segment in which the motion begins, or None.

        The result is None if this segment begins exactly at the start, or if a torque changes
        within the segment.
        """
        problem, start_ns = self.problem, self._start.time_ns
        timeline, timeout_ns = self._timeline, problem.options.timeout_ns
        # A torque whose stamp is the start begins a new segment, even if this torque equals the
        # previous one.
        begins = any((log.segments(timeout_ns)[0] == start_ns).any() for log in self._sources)
        if begins and (timeline.has_terms or (
                row >= 0 and timeline.acts(slice(row, row + 1)).item())):
            return None
        return timeline.rule(problem.options, self._carrier, row, start_ns)

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
        self.problem, self._restart = problem, None
        self._continue(self._wheels and self._wheels_on(self._wheels.axial(self._end_ns)))

    def _continue(self, wheels: WheelTimeline | None) -> None:
        """Continue the motion with a new timeline."""
        momentum, self._wheels, self._events = self._momentum(), wheels, []
        self._timeline = self._timeline_from(self._end_ns, momentum)
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
        changes, parts, later = self.problem.changes, list[Trajectory](), requested[0]
        if not changes or changes.next_ns(self._end_ns) > last_ns:
            return self._advance(*requested, until_ns)
        while (next_ns := changes.next_ns(self._end_ns)) <= last_ns:
            before = later < next_ns
            parts.append(self._advance(*checked_times(later[before], self._end_ns), next_ns))
            self._change(changes.bodies[changes.in_force(next_ns)])
            later = later[~before]
        parts.append(self._advance(*checked_times(later, self._end_ns), until_ns))
        return joined(requested[0], parts)

    def _state(self) -> State:
        """Return the state at the end of the motion so far, without the rotors."""
        return State._as_computed(self._end_ns, self._progress['latest'][0])

    def _wheels_after(self, state: State) -> WheelTimeline | None:
        """Return the wheels from the end of the motion so far onward, given the state there."""
        end_ns = self._end_ns
        return self._wheels and self._wheels_from(self._wheels.axial(end_ns - 1), state,
                                                  end_ns - 1)

    def _change(self, body: RigidBody) -> None:
        """Continue with another body from the end of the motion so far."""
        assert self.problem.changes
        carrier = self._wheels.wheels.carrier(body) if self._wheels else body
        state = changed(self._state(), self._carrier, carrier, self.problem.changes.keep)
        packed, time_ns = state._packed, state.time_ns
        self._body, self._carrier = body, carrier
        self._continue(self._wheels_after(state))
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
        motion = motion_layout.allocate(times_ns.size)
        closed, momenta = self._fill(times_ns, order, motion, stop)
        self._end_ns = end_ns
        usage = SolverUsage(self._body, self.problem.options, self._timeline, begin_ns,
                            end_ns, closed, self._wheels, tuple(self._events))
        if self._events:
            events = np.concatenate(self._events)[::-1]
            self._events = [events[np.unique(events[:, 2], return_index=True)[1]]]
        if times_ns.size > count:
            times_ns = times_ns[:count]
        return Trajectory(times_ns, motion, (usage,), momenta, _restart=self._restart)

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
        friction: Friction | None = None
        if self._is_begun:
            progress['done'] = 0
        for first, end, rows in self._timeline.chunks(progress['row'], stop):
            if rows.terms and rows.terms.friction:
                if friction is None:
                    friction = with_outputs(rows.terms.friction, times_ns.size, _EVENTS)
                    momenta = friction.momenta
                rows = rows._replace(terms=rows.terms._replace(
                    friction=friction._replace(efforts=rows.terms.friction.efforts)))
            if self._is_begun or end - first < len(closed) - 1:
                progress['row'] -= first
                progress['stop'] = end - first
            marks = closed[first:first + len(rows.times_ns) + 1]
            while result := kernels.run(progress, times_ns, order, motion, marks, rows,
                                        self._carrier._constants, problem.options.method):
                if result == layout.TOO_FAST:
                    raise problem.options.too_fast(int(progress['grid_ns'][0]))
                if friction:
                    self._take(friction)
            if first:
                progress['row'] += first
        self._is_begun = True
        if friction:
            self._take(friction)
        if stop < len(closed) - 1 and (done := int(progress['done'][0])) < times_ns.size:
            # The remaining outputs are at the end of the piece, so they get the state of the last
            # grid point.
            again = (order if len(order) else np.arange(times_ns.size))[done:]
            grid = progress['grid'][0]
            motion_layout.attitude(motion)[again] = state_layout.attitude(grid)
            motion_layout.angular_velocity(motion)[again] = state_layout.angular_velocity(grid)
            if momenta is not None:
                count = momenta.shape[1] // 2
                momenta[again] = np.append(state_layout.momenta(grid)[0, :count],
                                           state_layout.efforts(grid)[:count])
        return closed, momenta

    def _take(self, friction: Friction) -> None:
        """Store the events that the loop has recorded, and empty its list."""
        if count := int(friction.events[0, 0]):
            self._events.append(friction.events[1:1 + count].copy())
        friction.events[0, 0] = 0
