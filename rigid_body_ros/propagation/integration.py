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

"""Integration of a motion: all at once, or piece by piece as its log comes."""

from __future__ import annotations

from collections.abc import Hashable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instants, NEVER_NS
from rigid_body_ros.propagation.loop import (
    BUDGET,
    IN_FORCE,
    IN_ORDER,
    order,
    origin,
    run,
    working_states,
)
from rigid_body_ros.propagation.models import Answers
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.propagator import Propagator
from rigid_body_ros.propagation.trajectory import Trajectory
from rigid_body_ros.torque import TorqueLog

_NO_LOG = TorqueLog([], [])


def propagate(body: RigidBody, start: State, log: TorqueLog | None = None, *, at: ArrayLike,
              solver: str = 'auto', tolerance: float = 1e-15, max_step: float | None = None,
              torque_timeout: float = 0.0) -> Trajectory:
    """
    Integrate Euler's equations under a torque log.

    Parameters
    ----------
    body : RigidBody
        Turns about its centre of mass, which may move as it likes.
    start : State
        Its time is the earliest that can be asked for. One that `Propagator.at` returned goes on
        with the same bits.
    log : TorqueLog, optional
        None means torque-free. Before its first sample the torque is zero.
    at : array of int, shape (m,), ns
        Times to return, in any order, none before the start.
    solver : str
        'auto': the least model that the scene needs, a long coast in closed form, anything else
        by a Taylor series; 'taylor'; 'exact', for motion without torque; or one of 'rk4',
        'strang' and 'explicit_euler', which take fixed steps.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned, 1e-15 to 1. Rounding adds
        to it.
    max_step : float, optional, s
        Upper limit of a step, or the step of a solver of fixed step, which needs it.
    torque_timeout : float, s
        If positive, the torque is zero from this long after a sample to the next one.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError
        A time lies before the start or is not an integer that fits int64, an option is out of its
        range, the solver 'exact' is given torques, or the torques bring the body beyond 1e9 rad/s.

    """
    motion = Run(body, start, solver=solver, tolerance=tolerance, max_step=max_step,
                 torque_timeout=torque_timeout)
    return motion.advance(_NO_LOG if log is None else log, at)


class Run:
    """
    A motion worked out piece by piece, with the bits of `propagate` under the whole log.

    Parameters
    ----------
    body, start, solver, tolerance, max_step, torque_timeout
        As for `propagate`.

    Raises
    ------
    ValueError
        An option is out of its range.

    """

    def __init__(self, body: RigidBody, start: State, *, solver: str = 'auto',
                 tolerance: float = 1e-15, max_step: float | None = None,
                 torque_timeout: float = 0.0) -> None:
        self._body, self._start = body, start
        self._options = _options(solver, tolerance, max_step, torque_timeout)
        self._arguments = self._options.kernel_arguments(body)
        self._place: tuple[Floats, int, int, int, bool] | None = None
        self._reached_ns = start.time_ns

    def advance(self, log: TorqueLog, at: ArrayLike, *, dropped: int = 0,
                stop: int | None = None) -> Trajectory:
        """
        Return the motion at times, none before those of the last call.

        Parameters
        ----------
        log : TorqueLog
            A piece: from the sample in force at the end of the piece before, or the start, on.
        at : array of int, shape (m,), ns
            In any order.
        dropped : int
            How many samples at the front of the piece before are left out of this one.
        stop : int, optional
            The sample that the next piece goes on from: none of `at` comes after its stamp, and
            the motion is worked out up to there. None: the piece is used up, or goes on.

        Raises
        ------
        ValueError
            As `propagate`.

        """
        times, ascends, end_ns = _checked_times(at, self._reached_ns)
        _check_solver(self._options, log)
        count, begin_ns = times.size, self._reached_ns
        if stop is not None and end_ns < log.times_ns[stop]:
            end_ns = int(log.times_ns[stop])
            times = np.append(times, end_ns)
        rows = IN_ORDER if ascends else np.argsort(times, kind='stable')
        # One block of memory: two, freed together, go back to the system, and to get their pages
        # again costs the next run as much as its arithmetic.
        block = np.empty(7 * times.size)
        closed = self._fill(log, times, rows, block, dropped, len(log) if stop is None else stop)
        self._reached_ns = end_ns
        attitude: Floats = block[:4 * times.size].reshape(-1, 4)
        rates: Floats = block[4 * times.size:].reshape(-1, 3)
        if times.size > count:  # the end of the piece was not asked for
            times, attitude, rates = times[:count], attitude[:count], rates[:count]
        return Trajectory(self._body, times, attitude, rates, Answers(
            self._body, log, self._options, begin_ns, end_ns, closed))

    def _fill(self, log: TorqueLog, times: NDArray[np.int64], rows: NDArray[np.intp],
              motion: Floats, dropped: int, stop: int) -> NDArray[np.bool_]:
        """Fill the motion, and return in which samples a coast was answered in closed form."""
        closed = np.zeros(len(log) + 1, np.bool_)
        if self._place:
            states, grid_ns, begin_ns, sample, silent = self._place
            # In a coast that goes on, an earlier sample may be in force: it says no more than -1.
            sample = max(sample - dropped, -1)
        else:
            states, grid_ns, begin_ns, sample, silent = self._begun(log)
        begins_later = stop < len(log) and log.times_ns[stop] <= self._start.time_ns
        if begins_later:  # nothing but the start itself can be asked for
            stop = len(log)
        done, timeout_ns = 0, self._options.timeout_ns
        for first, end, torques in log.polynomials(sample):
            while sample < min(end, stop) and done < times.size:
                grid_ns, begin_ns, sample, silent, done, fast = run(
                    states, grid_ns, begin_ns, sample, silent, done, times, rows, motion, closed,
                    log.times_ns, torques, log.in_space, first, min(end, stop), timeout_ns,
                    *self._arguments, BUDGET)
                if fast:
                    raise self._options.too_fast(grid_ns)
        if done < times.size:  # the end of the piece, asked for again
            again = (np.arange(times.size) if len(rows) == 0 else rows)[done:]
            motion[:4 * times.size].reshape(-1, 4)[again] = states[4:8]
            motion[4 * times.size:].reshape(-1, 3)[again] = states[:3]
        if self._place or (times.size and not begins_later):
            self._place = states, grid_ns, begin_ns, sample, silent
        return closed

    def _begun(self, log: TorqueLog) -> tuple[Floats, int, int, int, bool]:
        start = self._start
        if start._origin is None and log.interpolation == 'hold':
            return working_states(start._packed), start.time_ns, start.time_ns, IN_FORCE, False
        sample, silent = log.in_force(start.time_ns, self._options.timeout_ns)
        rule = None if start._origin is None else _rule_at_start(
            self._body, start, log, self._options, sample, silent)
        begun = origin(start, rule)
        states = working_states(begun.grid, begun.begin)
        return states, begun.grid_ns, begun.begin_ns, sample, silent


def _options(*values: Any) -> Options:
    try:
        return _known_options(*values)
    except TypeError:  # not hashable: certainly not an option
        return Options(*values)


@lru_cache
def _known_options(*values: Any) -> Options:
    return Options(*values)  # to check them takes a tenth of a short run


def _checked_times(at: ArrayLike, start_ns: int) -> tuple[NDArray[np.int64], bool, int]:
    """Return times, whether they ascend, and the last of them."""
    times = instants(at, 'at')
    if times.size > 1:
        ascends, first_ns, last_ns = order(times)
    else:  # to call a kernel takes as long as the rest here
        ascends, (first_ns, last_ns) = True, 2 * (times.tolist() or [start_ns])
    for time_ns in (first_ns, last_ns):
        if not start_ns <= time_ns < NEVER_NS:
            raise ValueError(f'at: expected times from the start, {start_ns} ns, on, '
                             f'found {time_ns} ns')
    if last_ns - start_ns >= NEVER_NS:
        raise ValueError(f'at: expected times within 292 years of the start, {start_ns} ns, '
                         f'found {last_ns} ns')
    return times, ascends, int(last_ns)  # a numpy integer where numba is absent


def _check_solver(options: Options, log: TorqueLog) -> None:
    if options.solver == 'exact' and log.torques.any():
        row = int(np.flatnonzero(log.torques.any(axis=1))[0])
        raise ValueError(f"solver 'exact' is for motion without torque, found torque {row} of "
                         f'{log.torques[row].tolist()} N m at {log.times_ns[row]} ns')


def _rule_at_start(body: RigidBody, start: State, log: TorqueLog, options: Options, sample: int,
                   silent: bool) -> Hashable:
    if sample < 0 or silent:
        return options.rule(body, np.zeros(3), False)
    torque = log.torques[sample]
    # A torque at the start begins a segment there, even if it repeats the one before.
    if log.interpolation != 'hold' or (torque.any() and log.times_ns[sample] == start.time_ns):
        return None
    return options.rule(body, torque, bool(log.in_space[sample]))


def warm_up() -> None:
    """Compile every kernel, or load what an earlier process compiled."""
    body, start = RigidBody(np.eye(3)), State()
    propagate(body, start, TorqueLog([0], [[1.0, 0.0, 0.0]]), at=[1]).euler_angles()
    Propagator(body, start).at(1)
