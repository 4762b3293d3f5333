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

"""Integration of a motion under several torque logs, with rotors or damping."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import motion_layout
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import layout, loop, summation
from rigid_body_ros.propagation.models import CombinedUsage
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import origin_of
from rigid_body_ros.propagation.requested import checked_times
from rigid_body_ros.propagation.rotors import Rotors
from rigid_body_ros.propagation.trajectory import Trajectory


class CombinedMotion:
    """
    A motion under several torque logs, with rotors or damping.

    Parameters
    ----------
    body : RigidBody
    start : State
    logs : sequence of TorqueLog
        They add up.
    wheels : TorqueLog
        Torque of the motors on the rotors, body axes.
    options : Options

    Raises
    ------
    ValueError
        The solver takes no such terms, or the torque on the rotors is in space axes.

    """

    def __init__(self, body: RigidBody, start: State, logs: Sequence[TorqueLog],
                 wheels: TorqueLog, options: Options) -> None:
        check_wheels(wheels)
        self._body, self._options = body, options
        self._sum = summation.summed(logs, wheels, start.time_ns, start._rotors,
                                     options.timeout_ns)
        self._has_rotors = bool(start._has_rotors or wheels.torques.any())
        #: See `loop.run`.
        self._terms = self._sum.terms[None] if summation.in_two_frames([*logs, wheels]) else (
            self._sum.terms if self._has_rotors or body.is_damped else None)
        self._check_solver([*logs, wheels])
        begin_ns, states, progress = self._begin(start, [*logs, wheels])
        self._times_ns = np.append(begin_ns, self._sum.times_ns[1:])
        self._times_ns.flags.writeable = False  # one type for the kernels
        self._states, self._progress, self._end_ns = states, progress, start.time_ns

    def _check_solver(self, sources: Sequence[TorqueLog]) -> None:
        options = self._options
        if not options.record.takes_torque and any(log.torques.any() for log in sources):
            raise ValueError(f'solver {options.solver!r} handles torque-free motion only, '
                             'found torques')
        options.check_linear_terms(self._body.is_damped, self._has_rotors)

    def advance(self, at: ArrayLike) -> Trajectory:
        """
        Return the motion at times, none of them before those of the previous call.

        Parameters
        ----------
        at : array of int, shape (m,), ns
            In any order.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            As for `propagate`.

        """
        times, ascends, end_ns = checked_times(at, self._end_ns)
        rows = loop.IN_ORDER if ascends else np.argsort(times, kind='stable')
        motion = motion_layout.allocate(times.size)
        closed = self._fill(times, rows, motion)
        begin_ns, self._end_ns = self._end_ns, end_ns
        usage = CombinedUsage(self._body, self._times_ns, self._sum, self._options, begin_ns,
                              end_ns, closed, self._has_rotors)
        return Trajectory(self._body, times, motion, usage,
                          Rotors(self._times_ns, self._sum.terms))

    def _fill(self, times: NDArray[np.int64], rows: NDArray[np.intp],
              motion: Floats) -> NDArray[np.bool_]:
        """Fill the motion, and return `SolverUsage.closed`."""
        progress, end = self._progress, len(self._times_ns)
        closed = np.zeros(end + 1, np.bool_)
        progress[layout.DONE] = 0
        while times.size and (result := loop.run(
                self._states, progress, times, rows, motion, closed, self._times_ns,
                self._sum.polynomials, self._sum.in_space, 0, end, self._body._constants,
                self._options.held_settings, loop.BUDGET,
                self._terms)):
            if result == loop.TOO_FAST:
                raise self._options.too_fast(int(progress[layout.GRID_NS]))
        return closed

    def _begin(self, start: State,
               sources: Sequence[TorqueLog]) -> tuple[int, Floats, NDArray[np.int64]]:
        """Return the beginning of the first segment, ns, and the states and progress there."""
        rule = None
        if start._origin is not None and self._continues(start.time_ns, sources):
            rule = self._options.rule(self._body, self._sum.polynomials[0],
                                      bool(self._sum.in_space[0]), self._sum.terms[0, :2])
        origin = origin_of(start, rule)
        if origin.begin_ns != start.time_ns:
            self._sum.terms[0, -2:] = origin.rotors
        return (origin.begin_ns, layout.pack_states(origin.grid, origin.begin),
                layout.pack_place(origin.grid_ns, origin.begin_ns, 0))

    def _continues(self, start_ns: int, sources: Sequence[TorqueLog]) -> bool:
        """Return whether the first segment may have begun before the start."""
        if any(log.interpolation != 'hold' for log in sources):
            return False
        changes = any((log.segments(self._options.timeout_ns)[0] == start_ns).any()
                      for log in sources)
        return not (changes and (self._body.is_damped or self._sum.acts(slice(1)).any()))


def check_wheels(wheels: TorqueLog) -> None:
    """Raise ValueError if a torque on the rotors is in space axes."""
    if wheels.in_space.any():
        raise ValueError('wheels: expected torques in body axes, found torques in space axes')
