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

"""Integration of a motion: all at once, or piece by piece as its log arrives."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import motion_layout, state_layout
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import layout, loop
from rigid_body_ros.propagation.combined import CombinedMotion
from rigid_body_ros.propagation.models import SolverUsage
from rigid_body_ros.propagation.options import Options, validated
from rigid_body_ros.propagation.origin import origin_of
from rigid_body_ros.propagation.propagator import Propagator
from rigid_body_ros.propagation.requested import checked_times
from rigid_body_ros.propagation.rotors import Rotors
from rigid_body_ros.propagation.trajectory import Trajectory

_NO_LOG = TorqueLog([], [])


def propagate(body: RigidBody, start: State, log: TorqueLog | Sequence[TorqueLog] | None = None,
              *, at: ArrayLike, wheels: TorqueLog | None = None, solver: str = Options.solver,
              tolerance: float = Options.tolerance,
              max_step: float | None = Options.max_step,
              torque_timeout: float = Options.torque_timeout) -> Trajectory:
    """
    Integrate Euler's equations under a torque log.

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
    at : array of int, shape (m,), ns
        Times to return, in any order, none before the start.
    wheels : TorqueLog, optional
        Torque of the motors on the rotors, body axes. The body feels the opposite torque.
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
    logs = [log] if isinstance(log, TorqueLog) else [source for source in log or () if len(source)]
    if not wheels and len(logs) < 2:
        motion = Integration(body, start, solver=solver, tolerance=tolerance, max_step=max_step,
                             torque_timeout=torque_timeout)
        return motion.advance(logs[0] if logs else _NO_LOG, at)
    options = validated(solver, tolerance, max_step, torque_timeout)
    return CombinedMotion(body, start, logs, wheels or _NO_LOG, options).advance(at)


class Integration:
    """
    A motion computed piece by piece, with the bits of `propagate` under the whole log.

    Parameters
    ----------
    body, start, solver, tolerance, max_step, torque_timeout
        As for `propagate`.

    Raises
    ------
    ValueError
        An option is out of its range.

    """

    def __init__(self, body: RigidBody, start: State, *, solver: str = Options.solver,
                 tolerance: float = Options.tolerance,
                 max_step: float | None = Options.max_step,
                 torque_timeout: float = Options.torque_timeout) -> None:
        self._body, self._start = body, start
        self._options = validated(solver, tolerance, max_step, torque_timeout)
        #: Constant terms of `loop.run`; None if there are neither rotors nor damping.
        self._terms = _constant_terms(body, start, self._options)
        #: States and progress of the loop at the end of the last piece; None before the first.
        self._loop_arrays: tuple[Floats, NDArray[np.int64]] | None = None
        self._end_ns = start.time_ns

    def advance(self, log: TorqueLog, at: ArrayLike, *, dropped: int = 0,
                stop: int | None = None) -> Trajectory:
        """
        Return the motion at times, none of them before those of the previous call.

        Parameters
        ----------
        log : TorqueLog
            A piece of the log. It begins with the sample in force at the end of the previous
            piece, or at the start.
        at : array of int, shape (m,), ns
            In any order.
        dropped : int
            Number of samples at the front of the previous piece that this one does not contain.
        stop : int, optional
            The sample from which the next piece continues: the motion is computed up to its stamp,
            and no time of `at` is later. None if this is the last piece, or if the next call
            continues within it.

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            As for `propagate`.

        """
        times, ascends, end_ns = checked_times(at, self._end_ns)
        check_solver(self._options, log)
        count, begin_ns = times.size, self._end_ns
        if stop is not None and end_ns < log.times_ns[stop]:
            end_ns = int(log.times_ns[stop])
            times = np.append(times, end_ns)
        rows = loop.IN_ORDER if ascends else np.argsort(times, kind='stable')
        motion = motion_layout.allocate(times.size)
        closed = self._fill(log, times, rows, motion, dropped, len(log) if stop is None else stop)
        self._end_ns = end_ns
        rotors = Rotors.constant(self._start.time_ns, self._start._rotors) \
            if self._terms is not None and self._start._has_rotors else None
        usage = SolverUsage(self._body, log, self._options, begin_ns, end_ns, closed,
                            rotors is not None)
        if times.size > count:  # the end of the piece was not requested
            times = times[:count]
        return Trajectory(self._body, times, motion, usage, rotors)

    def _fill(self, log: TorqueLog, times: NDArray[np.int64], rows: NDArray[np.intp],
              motion: Floats, dropped: int, stop: int) -> NDArray[np.bool_]:
        """Fill the motion, and return `SolverUsage.closed`."""
        closed = np.zeros(len(log) + 1, np.bool_)
        states, progress = (self._resumed_arrays(dropped) if self._loop_arrays
                            else self._initial_arrays(log))
        begins_later = stop < len(log) and log.times_ns[stop] <= self._start.time_ns
        if begins_later:  # `at` can have no time but the start
            stop = len(log)
        progress[layout.DONE] = 0
        chunks = log.polynomials(int(progress[layout.SAMPLE])) if times.size else ()
        for first, end, polynomials in chunks:
            while result := loop.run(
                    states, progress, times, rows, motion, closed, log.times_ns, polynomials,
                    log.in_space, first, min(end, stop), self._body._constants,
                    self._options.settings, loop.BUDGET, self._terms):
                if result == loop.TOO_FAST:
                    raise self._options.too_fast(int(progress[layout.GRID_NS]))
        done = int(progress[layout.DONE])
        if done < times.size:  # the end of the piece, requested again
            again = (np.arange(times.size) if len(rows) == 0 else rows)[done:]
            grid, _, _ = layout.unpack_states(states)
            motion_layout.attitude(motion)[again] = state_layout.attitude(grid)
            motion_layout.angular_velocity(motion)[again] = state_layout.angular_velocity(grid)
        if self._loop_arrays or (times.size and not begins_later):
            self._loop_arrays = states, progress
        return closed

    def _resumed_arrays(self, dropped: int) -> tuple[Floats, NDArray[np.int64]]:
        assert self._loop_arrays is not None
        states, progress = self._loop_arrays
        # The sample in force may be among the dropped ones if a coast continues. Its torque is
        # zero, as before the first sample, so -1 can stand for it.
        progress[layout.SAMPLE] = max(int(progress[layout.SAMPLE]) - dropped, -1)
        return states, progress

    def _initial_arrays(self, log: TorqueLog) -> tuple[Floats, NDArray[np.int64]]:
        start = self._start
        if start._origin is None and log.interpolation == 'hold':
            return (layout.pack_states(start._packed),
                    layout.pack_place(start.time_ns, start.time_ns, layout.IN_FORCE))
        sample, timed_out = log.in_force(start.time_ns, self._options.timeout_ns)
        rule = None if start._origin is None else _rule_at_start(
            self._body, start, log, self._options, sample, timed_out, self._terms is not None)
        origin = origin_of(start, rule)
        return (layout.pack_states(origin.grid, origin.begin),
                layout.pack_place(origin.grid_ns, origin.begin_ns, sample, timed_out))


def _constant_terms(body: RigidBody, start: State, options: Options) -> Floats | None:
    if not (start._has_rotors or body.is_damped):
        return None
    options.check_linear_terms(body.is_damped, start._has_rotors)
    return start._rotors


def check_solver(options: Options, log: TorqueLog) -> None:
    """Raise ValueError if the log has torques and the solver handles none."""
    if not options.record.takes_torque and log.torques.any():
        row = int(np.flatnonzero(log.torques.any(axis=1))[0])
        raise ValueError(f'solver {options.solver!r} handles torque-free motion only, found '
                         f'a torque of {log.torques[row].tolist()} N m at '
                         f'{log.times_ns[row]} ns (sample {row})')


def _rule_at_start(body: RigidBody, start: State, log: TorqueLog, options: Options, sample: int,
                   timed_out: bool, has_terms: bool) -> Hashable:
    if sample < 0:
        return options.rule(body, np.zeros(3), False)
    stamp_ns, torque = int(log.times_ns[sample]), log.torques[sample]
    if timed_out:
        stamp_ns, torque = stamp_ns + options.timeout_ns, np.zeros(3)
    # A torque at the start begins a segment there, even if it repeats the one before.
    begins = stamp_ns == start.time_ns and (has_terms or torque.any())
    if begins or (log.interpolation != 'hold' and not timed_out):
        return None
    return options.rule(body, torque, bool(log.in_space[sample]) and not timed_out)


def warm_up() -> None:
    """Compile every kernel, or load the code that an earlier process compiled."""
    body, start = RigidBody(np.eye(3)), State()
    propagate(body, start, TorqueLog([0], [[1.0, 0.0, 0.0]]), at=[1, 2]).euler_angles()
    Propagator(body, start).at(1)
