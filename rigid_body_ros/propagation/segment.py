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
from collections.abc import Mapping
import sys
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import Friction, kernels, Lags, layout, motion_layout, Terms
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation.lags import friction_key, Lagging, terms_of
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import Origin, origin_of
from rigid_body_ros.propagation.summation import added, momentum_at
from rigid_body_ros.propagation.timeline import held_row

#: The source numbers of wheel commands, of the torque on the rotors, and of bodies. These are the
#: largest possible numbers, so that these sources come after all others.
COMMANDS, WHEELS, BODY = sys.maxsize - 2, sys.maxsize - 1, sys.maxsize
#: Outputs of the loop that are never read, because a segment uses only the loop's latest state.
_UNUSED = motion_layout.allocate(1), np.empty(2, np.bool_)
_NONE = np.zeros((1, 3))
_NOTHING_LAGS: Mapping[int, Lagging] = {}


class Sample(NamedTuple):
    """A torque from one source, N m, shape (1, 3)."""

    stamp_ns: int
    torque: Floats
    in_space: bool


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


class Sum(NamedTuple):
    """The total torques from all sources, N m, shape (1, 3); see `layout.Rows`."""

    torque: Floats
    in_space: bool
    space: Floats = _NONE
    motors: Floats = _NONE
    #: `lagging` contains the sources that lag, and `lags` the torques of these sources minus their
    #: commands.
    lagging: Mapping[int, Lagging] = _NOTHING_LAGS
    lags: Lags | None = None

    @property
    def others(self) -> tuple[Floats, ...]:
        """Return the torques in space axes and on the rotors, or () if both torques are zero."""
        # Most motions have neither of these torques, and checking arrays of zeros takes a tenth of
        # the time of a short segment.
        if self.space is self.motors or not (self.space.any() or self.motors.any()):
            return ()
        return self.space, self.motors

    def is_zero(self) -> bool:
        """Return whether no torque acts."""
        return not (any(self.torque[0].tolist()) or self.others
                    or (self.lags is not None and self.lags.excess.any()))


def summed(samples: Mapping[int, Sample], time_ns: int, timeout_ns: int,
           of_named: Floats | None = None) -> Sum:
    """
    Return the sum of the samples that have not timed out, added in the order of the sources.

    `of_named` is the total motor torque on the named wheels, N m, shape (1, 3).
    """
    groups: tuple[list[Floats], ...] = [], [], []
    body, space, motors = groups
    if of_named is not None:
        motors.append(of_named)
    for source in sorted(samples):
        stamp_ns, torque, in_space = samples[source]
        if not 0 < timeout_ns <= time_ns - stamp_ns:
            (motors if source == WHEELS else space if in_space else body).append(torque)
    if not (space or motors):
        return Sum(added(body), False)
    total, on_rotors = added(body), added(motors)
    total = total - on_rotors
    if not total.any():  # no torque acts in body axes, so store the torque in space axes instead
        return Sum(added(space), bool(space), _NONE, on_rotors)
    return Sum(total, False, added(space), on_rotors)


class OutOfTimeError(TimeoutError):
    """Raised if the computing time reaches its limit; the state at `reached_ns` is known."""

    def __init__(self, reached_ns: int) -> None:
        super().__init__(f'the limit on the computing time was reached at {reached_ns} ns of the '
                         'motion: call again to continue from there, or raise the limit')
        self.reached_ns = reached_ns


class Segment:
    """The motion under constant torques, with the grid points reached so far."""

    def __init__(self, body: RigidBody, options: Options, history_ns: int, start: State,
                 total: Sum, fields: NDArray[Any] | None = None,
                 friction: Friction | None = None) -> None:
        #: The sources that lag.
        self.lagging, lags = total.lagging, total.lags
        has_terms = fields is not None or friction is not None or (
            body.is_damped or start._has_rotors)
        self.coasts = total.is_zero() and not has_terms
        self.body, self._options, self._history_ns = body, options, history_ns
        key = [np.concatenate([each.key for each in self.lagging.values()])] \
            if lags is not None and lags.excess.any() else []
        if friction is not None:
            key.append(friction_key(friction))
        others = (total.space, total.motors) if key else total.others
        self._rule = options.rule(body, fields, total.torque, total.in_space, *others, *key)
        origin = origin_of(start, self._rule)
        self._rotors = origin.rotors
        self._grid_ns, self._states = [origin.begin_ns], [origin.begin]
        if origin.grid_ns != origin.begin_ns:
            self._grid_ns.append(origin.grid_ns)
            self._states.append(origin.grid)
        #: Four values: the time and the state that were computed last, then the time and the state
        #: of the last grid point before that time.
        self._latest = origin.begin_ns, origin.begin, origin.begin_ns, origin.begin
        terms = None
        if friction is not None or lags is not None or fields is not None:
            terms = terms_of(origin.rotors[None], total.motors[None], total.space[None], fields,
                             lags, friction)
        elif has_terms or others:
            terms = Terms(origin.rotors[None], total.motors[None], total.space[None])
        self._rows = held_row(origin.begin_ns, total.torque, total.in_space, terms)

    def state_at(self, time_ns: int, until: float) -> State:
        """Return the state at a time; raise TimeoutError or ValueError as `Propagator.at` does."""
        packed, grid_ns, grid = self._found(time_ns, until)
        return State._as_computed(time_ns, packed, Origin(
            self._rule, self._grid_ns[0], self._states[0], grid_ns, grid, self._rotors),
            self._rotors_at(time_ns))

    def _found(self, time_ns: int, until: float) -> tuple[Floats, int, Floats]:
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
        return State._as_computed(time_ns, self._found(time_ns, until)[0], None,
                                  self._rotors_at(time_ns))

    def _discard_grid_points(self, horizon_ns: int) -> None:
        # Keep the grid points within the last `history`, because `at` continues from one of them
        # after a late torque. Also keep the beginning of the segment, because `at` computes all
        # states before these grid points from the beginning.
        while len(self._grid_ns) > 2 and self._grid_ns[2] <= horizon_ns:
            del self._grid_ns[1], self._states[1]
