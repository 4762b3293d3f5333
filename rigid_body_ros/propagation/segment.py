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

"""The motion under constant torques."""

from __future__ import annotations

import bisect
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import Friction, kernels, layout, motion_layout, Sums
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation.lags import LaggingSources
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import Origin, origin_of
from rigid_body_ros.propagation.sources import acts, momentum_at
from rigid_body_ros.propagation.timeline import beginning_at, OtherTorques, rows_of, rule_of

#: Outputs of the loop that are never read, because a segment uses only the loop's latest state.
_UNUSED = motion_layout.allocate(1), np.empty(2, np.bool_)


class OutOfTimeError(TimeoutError):
    """Raised if the computing time reaches its limit; the state at `reached_ns` is known."""

    def __init__(self, reached_ns: int) -> None:
        super().__init__(f'the limit on the computing time was reached at {reached_ns} ns of the '
                         'motion: call again to continue from there, or raise the limit')
        self.reached_ns = reached_ns


def torque_acts(sums: Sums, lagging: LaggingSources | None) -> bool:
    """Return whether any torque acts in a single row."""
    return any(sums.torques.ravel().tolist()) or acts(sums.space) or acts(sums.motors) or (
        lagging is not None and bool(lagging.excess(sums.times_ns).any()))


class Segment:
    """The motion under constant torques, with the grid points reached so far."""

    def __init__(self, body: RigidBody, options: Options, history_ns: int, start: State,
                 sums: Sums, others: OtherTorques, friction: Friction | None = None) -> None:
        self.body, self.others = body, others
        self._options, self._history_ns = options, history_ns
        has_motors = acts(sums.motors)
        has_terms = body.is_damped or start._has_rotors or has_motors or (
            friction is not None or others.fields is not None)
        #: Whether neither torques nor rotors, damping, fields or friction act.
        self.coasts = not (has_terms or torque_acts(sums, others.lagging))
        momentum = start._rotors[None] if has_terms else sums.momentum
        rows = rows_of(sums, momentum, has_terms, has_motors, others, friction)
        self._rule = rule_of(options, body, rows, 0, start.time_ns, others)
        origin = origin_of(start, self._rule)
        if origin.begin_ns != start.time_ns:
            rows = beginning_at(rows, origin.begin_ns, origin.rotors, others.lagging)
        self._rows, self._rotors = rows, origin.rotors
        self._grid_ns, self._states = [origin.begin_ns], [origin.begin]
        if origin.grid_ns != origin.begin_ns:
            self._grid_ns.append(origin.grid_ns)
            self._states.append(origin.grid)
        #: Four values: the time and the state that were computed last, then the time and the state
        #: of the last grid point before that time.
        self._latest = origin.begin_ns, origin.begin, origin.begin_ns, origin.begin

    def state_at(self, time_ns: int, until: float) -> State:
        """Return the state at a time; raise TimeoutError or ValueError as `Propagator.at` does."""
        packed, grid_ns, grid = self._computed(time_ns, until)
        return State._as_computed(time_ns, packed, Origin(
            self._rule, self._grid_ns[0], self._states[0], grid_ns, grid, self._rotors),
            self._rotors_at(time_ns))

    def _computed(self, time_ns: int, until: float) -> tuple[Floats, int, Floats]:
        """Return the state at a time, and the time and the state of the last grid point."""
        begin_ns, begin = self._grid_ns[0], self._states[0]
        if time_ns == begin_ns:
            return begin, begin_ns, begin
        if time_ns != self._latest[0]:  # the last output is often the start of the next segment
            self._compute(time_ns, until)
        return self._latest[1:]

    def _compute(self, time_ns: int, until: float) -> None:
        """Compute and store the state at a time, starting from the last earlier grid point."""
        begin_ns, begin = self._grid_ns[0], self._states[0]
        nearest = bisect.bisect_right(self._grid_ns, time_ns) - 1
        progress = layout.begun(self._states[nearest], self._grid_ns[nearest], begin, begin_ns, 0,
                                1)
        self._run(progress, time_ns, until)
        grid, _, latest, grid_ns, _, _, done, _, _ = progress.item()
        if grid_ns > self._grid_ns[-1]:
            self._grid_ns.append(grid_ns)
            self._states.append(grid)
            self._discard_grid_points(grid_ns - self._history_ns)
        if not done:
            raise OutOfTimeError(grid_ns)
        self._latest = time_ns, latest, grid_ns, grid

    def _rotors_at(self, time_ns: int) -> Floats:
        terms = self._rows.terms
        if terms is None or terms.motors is None:
            return self._rotors
        rotors = momentum_at(self._rows.times_ns, terms.momentum, terms.motors,
                             np.array([time_ns]))[0]
        rotors.flags.writeable = False
        return rotors

    def _run(self, progress: NDArray[Any], time_ns: int, until: float) -> None:
        """Run the loop up to a time, or until the computing time is used up."""
        arguments = (progress, np.array([time_ns]), layout.IN_ORDER, *_UNUSED, self._rows,
                     self.body._constants, self._options.method)
        while result := kernels.run(*arguments):
            if result == layout.TOO_FAST:
                raise self._options.too_fast(
                    time_ns if progress['done'][0] else int(progress['grid_ns'][0]))
            if time.monotonic() > until:
                break

    def end_at(self, time_ns: int, until: float) -> State:
        """
        Return the state at a given time, as the start of a new segment.

        The new segment begins even if no torque changes.
        """
        return State._as_computed(time_ns, self._computed(time_ns, until)[0], None,
                                  self._rotors_at(time_ns))

    def _discard_grid_points(self, horizon_ns: int) -> None:
        # Keep the grid points within the last `history`, because `at` continues from one of them
        # after a late torque. Also keep the beginning of the segment, because `at` computes all
        # states before these grid points from the beginning.
        while len(self._grid_ns) > 2 and self._grid_ns[2] <= horizon_ns:
            del self._grid_ns[1], self._states[1]
