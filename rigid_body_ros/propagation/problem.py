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

"""All that determines a motion, and its integration: at once, or piece by piece."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels, layout, motion_layout, state_layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import beginning_at, Field, packed
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import torque_logs, TorqueLog
from rigid_body_ros.propagation.models import SolverUsage
from rigid_body_ros.propagation.options import Options, validated
from rigid_body_ros.propagation.origin import origin_of
from rigid_body_ros.propagation.requested import checked_times
from rigid_body_ros.propagation.timeline import Timeline
from rigid_body_ros.propagation.trajectory import Trajectory


class Problem:
    """
    A body, its start, its torques, and the solver: all that determines a motion.

    Parameters
    ----------
    body : RigidBody
        The body. It rotates about its centre of mass, which may move in any way.
    start : State
        The state at the earliest time of the motion. From a state that `Propagator.at` returned,
        the motion continues with the same bits.
    log : TorqueLog or sequence of TorqueLog, optional
        None for torque-free motion. Several logs add up, each with its own last sample, frames,
        interpolation and timeout. Before the first sample a torque is zero.
    wheels : TorqueLog, optional
        Torque of the motors on the rotors, body axes. The body feels the opposite torque.
    fields : sequence of UniformField or GravityGradient
        Torques that depend on the attitude; at most one gravity gradient.
    solver : str
        'auto' uses the simplest model that the scene allows: closed form for a long coast, a
        Taylor series for anything else. 'taylor' always uses the series. 'exact' is the closed
        form and handles torque-free motion only. 'rk4', 'strang' and 'explicit_euler' take fixed
        steps.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned, 1e-15 to 1. Rounding adds
        to it.
    max_step : float, optional, s
        Upper limit of a step. A solver with fixed steps requires it: its steps are that long.
    torque_timeout : float, s
        If positive, the torque is zero from this long after a sample to the next one.

    Attributes
    ----------
    body : RigidBody
    start : State
    logs : tuple of TorqueLog
        Those that have samples.
    wheels : TorqueLog, optional
        None if it has no samples.
    fields : tuple of UniformField or GravityGradient
        An orbit without a time has that of the start.
    options : Options

    Raises
    ------
    ValueError
        An option is out of its range, the torque of wheels is in space axes, there are two gravity
        gradients, or the solver does not handle torques, rotors, damping or fields.

    """

    def __init__(self, body: RigidBody, start: State,
                 log: TorqueLog | Sequence[TorqueLog] | None = None, *,
                 wheels: TorqueLog | None = None, fields: Sequence[Field] = (),
                 solver: str = Options.solver,
                 tolerance: float = Options.tolerance,
                 max_step: float | None = Options.max_step,
                 torque_timeout: float = Options.torque_timeout) -> None:
        #: The fields for the kernels; None without.
        self._fields: NDArray[Any] | None = None
        self.fields: tuple[Field, ...] = ()
        if fields:
            self.fields = beginning_at(fields, start.time_ns)
            self._fields = packed(self.fields)
        self._set(body, start, log, wheels,
                  validated(solver, tolerance, max_step, torque_timeout))

    def _set(self, body: RigidBody, start: State, log: TorqueLog | Sequence[TorqueLog] | None,
             wheels: TorqueLog | None, options: Options) -> None:
        self.body, self.start, self.options = body, start, options
        self.logs = tuple([each for each in torque_logs(log) if len(each)])
        self.wheels = wheels if wheels else None
        if self.wheels and self.wheels.in_space.any():
            raise ValueError('wheels: expected torques in body axes, found torques in space axes')
        options.check_terms(body.is_damped, self.has_rotors, bool(self.fields))
        if not options.record.takes_torque:
            for each in self.sources:
                _check_torque_free(each, options)

    @property
    def has_rotors(self) -> bool:
        """Return whether there are rotors that turn, or motors that turn them."""
        return self.start._has_rotors or bool(self.wheels and self.wheels.torques.any())

    @property
    def has_torque(self) -> bool:
        """Return whether a torque is not zero, those on the rotors included."""
        return any(log.torques.any() for log in self.sources)

    @property
    def sources(self) -> tuple[TorqueLog, ...]:
        """Return the torques on the body, and then that on the rotors, if there is one."""
        return (*self.logs, self.wheels) if self.wheels else self.logs

    def replaced(self, *, body: RigidBody | None = None, start: State | None = None,
                 log: TorqueLog | Sequence[TorqueLog] | None = None,
                 wheels: TorqueLog | None = None, fields: Sequence[Field] | None = None,
                 options: Options | None = None) -> Problem:
        """Return the same problem with some parts replaced; raise ValueError as `Problem` does."""
        changed = Problem.__new__(Problem)
        changed.fields, changed._fields = self.fields, self._fields
        if fields is not None:
            changed.fields = beginning_at(fields, self.start.time_ns)
            changed._fields = packed(changed.fields)
        changed._set(body or self.body, start or self.start, self.logs if log is None else log,
                     self.wheels if wheels is None else wheels, options or self.options)
        return changed

    def solved_by(self, **options: Any) -> Problem:
        """Return the same problem with other `Options`, except for the timeout of the torques."""
        timeout = self.options.torque_timeout
        return self.replaced(options=Options(torque_timeout=timeout, **options))

    def between(self, start: State, end_ns: int) -> Problem:
        """Return the problem from another start on, with only the torques up to a time, ns."""
        begin_ns = start.time_ns
        return self.replaced(start=start,
                             log=[log.between(begin_ns, end_ns) for log in self.logs],
                             wheels=self.wheels and self.wheels.between(begin_ns, end_ns))

    def torque(self, times_ns: NDArray[np.int64], attitude: Floats) -> Floats:
        """
        Return the torque on the body at given times; at a jump, the value after it.

        Parameters
        ----------
        times_ns : array of int, shape (m,), ns
            In any order.
        attitude : array, shape (m, 4)
            The attitudes at these times, x y z w, which turn torques in space axes.

        Returns
        -------
        array, shape (m, 3), N m, body axes
            That of the fields included, without that on the rotors.

        """
        total = np.zeros((len(times_ns), 3))
        for log in self.logs:
            torque, in_space = log.at(times_ns, self.options.timeout_ns)
            total += np.where(in_space[:, None], so3.rotate(so3.conjugate(attitude), torque),
                              torque)
        for one in self.fields:
            total += one.torque(self.body, times_ns, attitude)
        return total

    def biased(self, torque: Floats, end_ns: int) -> Problem:
        """Return the problem with a constant torque, N m, body axes, added up to a time, ns."""
        bias = TorqueLog.constant(torque, self.start.time_ns, end_ns, self.options.timeout_ns)
        return self.replaced(log=[*self.logs, bias])

    def rotor_momentum(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the momentum of the rotors at times, N m s, body axes, shape (m, 3)."""
        return Integration(self).rotor_momentum(times_ns)

    def propagate(self, *, at: ArrayLike) -> Trajectory:
        """
        Return the motion at times.

        Parameters
        ----------
        at : array of int, shape (m,), ns
            In any order, none before the start.

        Raises
        ------
        ValueError
            A time lies before the start or is not an integer that fits int64, or the torques
            accelerate the body beyond 1e9 rad/s.

        """
        return Integration(self).advance(at)


def _check_torque_free(log: TorqueLog, options: Options) -> None:
    if log.torques.any():
        row = int(np.flatnonzero(log.torques.any(axis=1))[0])
        raise ValueError(f'solver {options.solver!r} handles torque-free motion only, found '
                         f'a torque of {log.torques[row].tolist()} N m at '
                         f'{log.times_ns[row]} ns (sample {row})')


class Integration:
    """
    A motion computed piece by piece, with the bits of `propagate` under the whole logs.

    Parameters
    ----------
    problem : Problem
        With all torques, or with a first piece of each log.

    Attributes
    ----------
    problem : Problem
        With the present piece of each log.

    """

    def __init__(self, problem: Problem) -> None:
        start = problem.start
        self.problem, self._end_ns = problem, start.time_ns
        self._timeline = self._timeline_from(start._rotors if start._has_rotors else None)
        self._progress, self._is_begun = self._begin(), False

    def _timeline_from(self, momentum: Floats | None) -> Timeline:
        problem = self.problem
        return Timeline(problem.logs, problem.wheels, problem.options.timeout_ns,
                        problem.body.is_damped, self._end_ns, momentum, problem._fields)

    def _begin(self) -> NDArray[Any]:
        start, stop = self.problem.start, len(self._timeline.times_ns)
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
        """Return the rule of a segment that may have begun before the start, or None."""
        problem, start_ns = self.problem, self.problem.start.time_ns
        found = self._timeline.held(row)
        if found is None:
            return None
        torque, in_space, *others = found
        acts = torque.any() or any(other.any() for other in others)
        # A torque at the start begins a segment there, even if it repeats the one before.
        begins = any((log.segments(problem.options.timeout_ns)[0] == start_ns).any()
                     for log in problem.sources) and (acts or self._timeline.has_terms)
        return None if begins else problem.options.rule(
            problem.body, problem._fields, torque, in_space, *others)

    def extend(self, problem: Problem) -> None:
        """
        Continue under the next piece of each log.

        Parameters
        ----------
        problem : Problem
            The same problem with the next pieces. Each begins with the sample in force at the end
            of the motion so far, or earlier. For cubic interpolation there are three samples
            before that one, and three after the end of the piece.

        """
        end_ns = self._end_ns
        momentum = self._timeline.momentum(np.array([end_ns]))[0] \
            if self._timeline.has_rotors else None
        self.problem = problem
        self._timeline = self._timeline_from(momentum)
        self._progress['row'], self._is_begun = self._timeline.in_force(end_ns), True

    def advance(self, at: ArrayLike, until_ns: int | None = None) -> Trajectory:
        """
        Return the motion at times, none of them before those of the previous call.

        Parameters
        ----------
        at : array of int, shape (m,), ns
            In any order.
        until_ns : int, optional
            The motion is computed up to this time, and no time of `at` is later; `extend` follows.
            It is that of a sample. None if there are no more torques, or if the next call
            continues within this piece.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            A time lies before the end of the motion so far or is not an integer that fits int64,
            or the torques accelerate the body beyond 1e9 rad/s.

        """
        begin_ns = self._end_ns
        times_ns, ascends, end_ns = checked_times(at, begin_ns)
        count, stop = times_ns.size, len(self._timeline.times_ns)
        if until_ns is not None and until_ns > begin_ns:
            stop = int(np.searchsorted(self._timeline.times_ns, until_ns))
            if end_ns < until_ns:  # the end of the piece was not requested
                times_ns, end_ns = np.append(times_ns, until_ns), until_ns
        order = layout.IN_ORDER if ascends else np.argsort(times_ns, kind='stable')
        motion = motion_layout.allocate(times_ns.size)
        closed = self._fill(times_ns, order, motion, stop)
        self._end_ns = end_ns
        usage = SolverUsage(self.problem.body, self.problem.options, self._timeline, begin_ns,
                            end_ns, closed)
        if times_ns.size > count:
            times_ns = times_ns[:count]
        return Trajectory(self.problem.body, times_ns, motion, usage)

    def rotor_momentum(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the momentum of the rotors in this piece at times, N m s, shape (m, 3)."""
        return self._timeline.momentum(times_ns)[:, 0]

    def _fill(self, times_ns: NDArray[np.int64], order: NDArray[np.intp], motion: Floats,
              stop: int) -> NDArray[np.bool_]:
        """Fill the motion up to a row, and return `SolverUsage.closed`."""
        closed = np.zeros(len(self._timeline.times_ns) + 1, np.bool_)
        progress, problem = self._progress, self.problem
        if not times_ns.size:
            return closed
        if self._is_begun:
            progress['done'] = 0
        for first, end, rows in self._timeline.chunks(int(progress['row'][0]), stop):
            if self._is_begun or end - first < len(closed) - 1:
                progress['row'] -= first
                progress['stop'] = end - first
            marks = closed[first:first + len(rows.times_ns) + 1]
            while result := kernels.run(progress, times_ns, order, motion, marks, rows,
                                        problem.body._constants, problem.options.method):
                if result == layout.TOO_FAST:
                    raise problem.options.too_fast(int(progress['grid_ns'][0]))
            if first:
                progress['row'] += first
        self._is_begun = True
        if stop < len(closed) - 1 and (done := int(progress['done'][0])) < times_ns.size:
            # The end of the piece is requested again.
            again = (order if len(order) else np.arange(times_ns.size))[done:]
            grid = progress['grid'][0]
            motion_layout.attitude(motion)[again] = state_layout.attitude(grid)
            motion_layout.angular_velocity(motion)[again] = state_layout.angular_velocity(grid)
        return closed


def propagate(body: RigidBody, start: State, log: TorqueLog | Sequence[TorqueLog] | None = None,
              *, at: ArrayLike, wheels: TorqueLog | None = None, fields: Sequence[Field] = (),
              solver: str = Options.solver, tolerance: float = Options.tolerance,
              max_step: float | None = Options.max_step,
              torque_timeout: float = Options.torque_timeout) -> Trajectory:
    """
    Integrate Euler's equations under torque logs: solve a `Problem` at times.

    Parameters
    ----------
    body, start, log, wheels, fields, solver, tolerance, max_step, torque_timeout
        As for `Problem`.
    at : array of int, shape (m,), ns
        Times to return, in any order, none before the start.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError
        A time lies before the start or is not an integer that fits int64, an option is out of its
        range, the solver 'exact' is given torques, or the torques accelerate the body beyond
        1e9 rad/s.

    """
    return Integration(Problem(
        body, start, log, wheels=wheels, solver=solver, tolerance=tolerance, max_step=max_step,
        torque_timeout=torque_timeout, fields=fields)).advance(at)
