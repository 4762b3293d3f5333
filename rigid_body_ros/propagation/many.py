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

"""Integration of many motions at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import time

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.bodies import RigidBodies
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import motion_layout
from rigid_body_ros.kernels.lanes import LANES
from rigid_body_ros.propagation import layout, loop, many_loop, summation
from rigid_body_ros.propagation.integration import check_solver
from rigid_body_ros.propagation.options import Options, validated
from rigid_body_ros.propagation.requested import checked_times
from rigid_body_ros.states import States
from rigid_body_ros.torque import TorqueLog

_NO_LOG = TorqueLog([], [])
#: s; a call of the kernel that takes less is followed by one for twice as many runs. In between
#: Python handles signals.
_PATIENCE = 0.05
#: Stamps, polynomials and frames of a log, and the samples for which there are polynomials.
_Piece = tuple[NDArray[np.int64], Floats, NDArray[np.bool_], int, int]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """
    Many motions at the same times.

    Attributes
    ----------
    times_ns : array of int64, shape (m,)
    attitude : array, shape (n, m, 4)
        x y z w, body to space, as in `Trajectory`. NaN for a failed run.
    angular_velocity : array, shape (n, m, 3), rad/s, body axes
        NaN for a failed run.
    messages : tuple of n str
        Why each run failed; empty for one that did not.

    """

    times_ns: NDArray[np.int64]
    attitude: Floats
    angular_velocity: Floats
    messages: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.messages)

    def __repr__(self) -> str:
        return (f'Trajectories({len(self)} runs, {self.times_ns.size} states each, '
                f'{self.failed.sum()} failed)')

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Whether each run failed, shape (n,)."""
        return np.array([bool(message) for message in self.messages], np.bool_)


def propagate_many(bodies: RigidBodies, starts: States,
                   log: TorqueLog | Sequence[TorqueLog | Sequence[TorqueLog]] | None = None, *,
                   at: ArrayLike,
                   torque_gains: ArrayLike | None = None, solver: str = Options.solver,
                   tolerance: float = Options.tolerance,
                   max_step: float | None = Options.max_step,
                   torque_timeout: float = Options.torque_timeout) -> Trajectories:
    """
    Integrate many motions, each with the bits of `propagate`.

    Run i is the motion of `bodies[i]` from `starts[i]`. A run that fails does not end the others:
    its states are NaN, and its message says why. The loop over the runs releases Python's global
    lock, so threads can share the runs.

    Parameters
    ----------
    bodies : RigidBodies
        n of them.
    starts : States
        n of them.
    log : TorqueLog, or sequence of n TorqueLog or of n sequences of TorqueLog, optional
        The log of all runs, or of each; several logs of a run add up. None for torque-free motion.
    at : array of int, shape (m,), ns
        As for `propagate`, the same for all runs.
    torque_gains : array, shape (n,), optional
        Each log of run i is `log.with_torques(torque_gains[i] * log.torques)`.
    solver, tolerance, max_step, torque_timeout
        As for `propagate`.

    Returns
    -------
    Trajectories

    Raises
    ------
    ValueError
        There is no body, the numbers of bodies, starts, logs or gains differ, a time lies before a
        start or is not an integer that fits int64, an option is out of its range, a gain times a
        torque is not finite, or the solver does not handle torques or damping.

    """
    runs = _Runs(bodies, starts, at, validated(solver, tolerance, max_step, torque_timeout))
    logs = _logs_of_each(log, len(bodies))
    gains = None if torque_gains is None else np.array(torque_gains, float)
    if gains is not None and gains.shape != (len(bodies),):
        raise ValueError(f'torque_gains: expected shape ({len(bodies)},), found {gains.shape}')
    shared = _NO_LOG if log is None else log
    if isinstance(shared, TorqueLog) and (gains is None or _can_scale(shared, gains)):
        runs.advance(shared, np.arange(len(bodies)), gains)
        return runs.trajectories()
    for row, each in enumerate(logs):
        if gains is not None:
            each = [one.with_torques(gains[row] * one.torques) for one in each]
        if len(each) < 2:
            runs.advance(each[0] if each else _NO_LOG, np.array([row]))
        else:
            runs.advance_summed(each, row)
    return runs.trajectories()


def _can_scale(log: TorqueLog, gains: Floats) -> bool:
    """
    Return whether the kernels can multiply the torques of a log.

    They multiply the coefficients of its polynomials, which for held torques are the torques. If a
    product is not finite, `TorqueLog` reports it.
    """
    largest = float(np.abs(gains).max()) * float(np.abs(log.torques).max(initial=0.0))
    return log.interpolation == 'hold' and math.isfinite(largest)


def _logs_of_each(log: TorqueLog | Sequence[TorqueLog | Sequence[TorqueLog]] | None,
                  count: int) -> list[list[TorqueLog]]:
    """Return the logs of each run that are not empty, or raise ValueError."""
    if log is None or isinstance(log, TorqueLog):
        return [[log] if log else []] * count
    if len(log) != count:
        raise ValueError(f'log: expected {count}, one for each body, found {len(log)}')
    return [[one for one in ([each] if isinstance(each, TorqueLog) else each) if len(one)]
            for each in log]


class _Runs:
    """The states of all runs, and their motions at the requested times."""

    def __init__(self, bodies: RigidBodies, starts: States, at: ArrayLike,
                 options: Options) -> None:
        if len(starts) != len(bodies):
            raise ValueError(f'starts: expected {len(bodies)}, one for each body, '
                             f'found {len(starts)}')
        if not len(bodies):
            raise ValueError('bodies: expected at least one, found none')
        self._begin_ns: NDArray[np.int64] = starts.time_ns
        self._times, ascends, _ = checked_times(at, int(self._begin_ns.max()))
        checked_times(self._times, int(self._begin_ns.min()))
        options.check_linear_terms(bool(bodies.is_damped.any()), False)
        self._bodies, self._options = bodies, options
        self._rows = loop.IN_ORDER if ascends else np.argsort(self._times, kind='stable')
        self._messages = [one or other for one, other in zip(bodies.messages, starts.messages)]
        packed = starts._packed
        self._states: Floats = np.concatenate([packed] * 3, axis=1)
        self._progress = np.zeros((len(bodies), layout.DONE + 1), np.int64)
        self._motions: Floats = np.empty((len(bodies), motion_layout.SIZE * self._times.size))
        self._failed = np.array([bool(message) for message in self._messages])

    def advance(self, log: TorqueLog, which: NDArray[np.intp],
                gains: Floats | None = None) -> None:
        """Compute some of the runs, those that share a log, times a gain for each of all runs."""
        check_solver(self._options, log)
        which = which[~self._failed[which]]
        if not (which.size and self._times.size):
            return
        begins = self._begin_ns[which]
        for begin_ns in np.unique(begins).tolist():
            self._progress[which[begins == begin_ns]] = layout.pack_place(
                begin_ns, begin_ns, *log.in_force(begin_ns, self._options.timeout_ns))
        damped = self._bodies.is_damped[which]
        first = int(self._progress[which, layout.SAMPLE].min())
        for begin, stop, polynomials in log.polynomials(first):
            piece = log.times_ns, polynomials, log.in_space, begin, stop
            for rows, terms in ((which[~damped], None), (which[damped], np.zeros((1, 4, 3)))):
                self._run(rows, piece, self._options.settings, terms, gains)
        self._report(which)

    def advance_summed(self, logs: Sequence[TorqueLog], row: int) -> None:
        """Compute a run under several logs, as `CombinedMotion` does."""
        for log in logs:
            check_solver(self._options, log)
        if self._messages[row] or not self._times.size:
            return
        begin_ns, which = int(self._begin_ns[row]), np.array([row])
        total = summation.summed(logs, _NO_LOG, begin_ns, np.zeros((2, 3)),
                                 self._options.timeout_ns)
        in_two_frames = (any(log.in_space.any() for log in logs)
                         and not all(log.in_space.all() for log in logs))
        total.times_ns.flags.writeable = False  # one type for the kernels
        self._progress[row] = layout.pack_place(begin_ns, begin_ns, 0)
        self._run(which, (total.times_ns, total.polynomials, total.in_space, 0,
                          len(total.times_ns)), self._options.held_settings,
                  total.terms if self._bodies.is_damped[row] or in_two_frames else None)
        self._report(which)

    def _report(self, which: NDArray[np.intp]) -> None:
        """Set the messages of the runs whose body became too fast."""
        for row in which[self._failed[which]].tolist():
            self._messages[row] = str(self._options.too_fast(
                int(self._progress[row, layout.GRID_NS])))

    def _run(self, which: NDArray[np.intp], piece: _Piece, settings: Floats,
             terms: Floats | None, gains: Floats | None = None) -> None:
        """Run the loop over some runs, in chunks."""
        done, chunk = 0, LANES
        gains = np.ones(len(self._failed)) if gains is None else gains
        while done < len(which):
            began = time.monotonic()
            done += many_loop.run_each(
                which[done:done + chunk], self._states, self._progress, self._times, self._rows,
                self._motions, *piece, self._bodies._constants, settings, loop.BUDGET, terms,
                gains, self._failed)
            if time.monotonic() - began < _PATIENCE:
                chunk *= 2

    def trajectories(self) -> Trajectories:
        """Return the motions, with NaN for the failed runs."""
        count, size = len(self._messages), self._times.size
        self._motions[self._failed] = np.nan
        attitude, rates = np.split(self._motions, [4 * size], axis=1)
        return Trajectories(self._times, attitude.reshape(count, size, 4),
                            rates.reshape(count, size, 3), tuple(self._messages))
