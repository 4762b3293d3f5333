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

from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
import math
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import motion_layout
from rigid_body_ros.kernels.lanes import LANES
from rigid_body_ros.mechanics.bodies import RigidBodies
from rigid_body_ros.mechanics.states import States
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import layout, loop, many_loop, summation
from rigid_body_ros.propagation.combined import check_wheels
from rigid_body_ros.propagation.integration import check_solver
from rigid_body_ros.propagation.options import Options, validated
from rigid_body_ros.propagation.requested import checked_times

_NO_LOG = TorqueLog([], [])
#: s; a call of the kernel that takes less is followed by one for twice as many runs. In between
#: Python handles signals.
_PATIENCE = 0.05
#: A log of all runs, or one or several of each.
Logs = TorqueLog | Sequence[TorqueLog | Sequence[TorqueLog]] | None


class _Piece(NamedTuple):
    """A piece of a log, for `many_loop.run_each`."""

    times_ns: NDArray[np.int64]
    #: Shape (k, ...): of run i the row i % k.
    polynomials: Floats
    in_space: NDArray[np.bool_]
    #: The samples for which there are polynomials.
    first: int
    stop: int


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


def propagate_many(bodies: RigidBodies, starts: States, log: Logs = None, *, at: ArrayLike,
                   wheels: TorqueLog | Sequence[TorqueLog] | None = None,
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
        Logs that runs have in common are added up once.
    at : array of int, shape (m,), ns
        As for `propagate`, the same for all runs.
    wheels : TorqueLog, or sequence of n TorqueLog, optional
        As for `propagate`: of all runs, or of each.
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
        torque is not finite, the torque of wheels is in space axes, or the solver does not handle
        torques, rotors or damping.

    """
    runs = _Runs(bodies, starts, at, validated(solver, tolerance, max_step, torque_timeout))
    gains = None if torque_gains is None else np.array(torque_gains, float)
    if gains is not None and gains.shape != (len(bodies),):
        raise ValueError(f'torque_gains: expected shape ({len(bodies)},), found {gains.shape}')
    for which, logs, motors in _alike(log, wheels, len(bodies)):
        if gains is None or _can_scale(logs, motors, gains):
            runs.advance(logs, motors, which, gains)
            continue
        for row in which.tolist():
            scaled = [one.with_torques(gains[row] * one.torques) for one in logs]
            runs.advance(scaled, motors, np.array([row]))
    return runs.trajectories()


def _alike(log: Logs, wheels: TorqueLog | Sequence[TorqueLog] | None,
           count: int) -> Iterator[tuple[NDArray[np.intp], list[TorqueLog], TorqueLog]]:
    """Generate the runs that have the same logs, those that are not empty, and their wheels."""
    if ((log is None or isinstance(log, TorqueLog))
            and (wheels is None or isinstance(wheels, TorqueLog))):
        yield np.arange(count), [log] if log else [], wheels or _NO_LOG
        return
    each, motors = _of_each(log, count, 'log'), _of_each(wheels, count, 'wheels')
    for which in _grouped([(*map(id, _listed(one)), id(motor))
                           for one, motor in zip(each, motors)]):
        yield (which, [one for one in _listed(each[which[0]]) if one],
               motors[which[0]] or _NO_LOG)


def _of_each(given: Any, count: int, name: str) -> Sequence[Any]:
    """Return what is given for each run, or raise ValueError."""
    if given is None or isinstance(given, TorqueLog):
        return [given] * count
    if len(given) != count:
        raise ValueError(f'{name}: expected {count}, one for each body, found {len(given)}')
    return list(given)


def _listed(logs: TorqueLog | Sequence[TorqueLog] | None) -> Sequence[TorqueLog]:
    return [logs] if isinstance(logs, TorqueLog) else logs or []


def _grouped(keys: Iterable[Hashable]) -> list[NDArray[np.intp]]:
    """Return the rows of each key, in order."""
    found: dict[Hashable, list[int]] = {}
    for row, key in enumerate(keys):
        found.setdefault(key, []).append(row)
    return [np.array(rows) for rows in found.values()]


def _can_scale(logs: Sequence[TorqueLog], wheels: TorqueLog, gains: Floats) -> bool:
    """
    Return whether the kernels can multiply the torques of logs.

    They multiply the coefficients of the polynomials, which for a held log are the torques. If a
    product is not finite, `TorqueLog` reports it.
    """
    if len(logs) != 1 or wheels:
        return not logs
    largest = float(np.abs(gains).max()) * float(np.abs(logs[0].torques).max(initial=0.0))
    return logs[0].interpolation == 'hold' and math.isfinite(largest)


def _change_together(one: _Piece, other: _Piece) -> bool:
    """Return whether two held torques change at the same times and are in the same axes."""
    return (one.polynomials.shape == other.polynomials.shape and one.polynomials.shape[2] == 1
            and np.array_equal(one.times_ns, other.times_ns)
            and np.array_equal(one.in_space, other.in_space))


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
        options.check_linear_terms(bool(bodies.is_damped.any()), bool(starts.has_rotors.any()))
        self._bodies, self._options = bodies, options
        self._has_terms = bodies.is_damped | starts.has_rotors
        self._rows = loop.IN_ORDER if ascends else np.argsort(self._times, kind='stable')
        self._messages = [one or other for one, other in zip(bodies.messages, starts.messages)]
        packed = starts._packed
        self._states: Floats = np.concatenate([packed] * 3, axis=1)
        self._progress = np.zeros((len(bodies), layout.DONE + 1), np.int64)
        self._motions: Floats = np.empty((len(bodies), motion_layout.SIZE * self._times.size))
        self._failed = np.array([bool(message) for message in self._messages])
        #: Runs with torques of their own, to run together: of the rows from a multiple of LANES to
        #: the next, under torques that change at the same times.
        self._queued: list[tuple[int, _Piece, Floats]] = []
        #: Of each run, for `loop.run`, if the rotors have no motors.
        self._terms: Floats = np.zeros((len(bodies), 2, 3))
        self._terms[:, 0] = starts.rotor_momentum

    def advance(self, logs: Sequence[TorqueLog], wheels: TorqueLog, which: NDArray[np.intp],
                gains: Floats | None = None) -> None:
        """
        Compute some of the runs, those that share logs and wheels.

        A single log is multiplied by a gain for each of all runs.
        """
        check_wheels(wheels)
        self._options.check_linear_terms(False, bool(wheels.torques.any()))
        for log in (*logs, wheels):
            check_solver(self._options, log)
        which = which[~self._failed[which]]
        if not (which.size and self._times.size):
            return
        if len(logs) > 1 or wheels:
            self._advance_summed(logs, wheels, which)
        else:
            self._advance_single(logs[0] if logs else _NO_LOG, which, gains)

    def _advance_single(self, log: TorqueLog, which: NDArray[np.intp],
                        gains: Floats | None) -> None:
        begins = self._begin_ns[which]
        for begin_ns in np.unique(begins).tolist():
            self._progress[which[begins == begin_ns]] = layout.pack_place(
                begin_ns, begin_ns, *log.in_force(begin_ns, self._options.timeout_ns))
        first = int(self._progress[which, layout.SAMPLE].min())
        for begin, stop, polynomials in log.polynomials(first):
            self._run(which, _Piece(log.times_ns, polynomials[None], log.in_space, begin, stop),
                      self._options.settings, self._has_terms[which], self._terms, gains)

    def _advance_summed(self, logs: Sequence[TorqueLog], wheels: TorqueLog,
                        which: NDArray[np.intp]) -> None:
        """Do it under a sum of logs, as `CombinedMotion` does."""
        in_two_frames = summation.in_two_frames([*logs, wheels])
        terms_vary = bool(wheels) or in_two_frames
        momenta = self._terms[which]
        # Without motors, the sum of the torques does not depend on the momentum of the rotors.
        for rows in _grouped([(begin_ns, momentum.tobytes() if terms_vary else b'') for
                              begin_ns, momentum in zip(self._begin_ns[which].tolist(), momenta)]):
            alike, begin_ns = which[rows], int(self._begin_ns[which[rows[0]]])
            total = summation.summed(logs, wheels, begin_ns, momenta[rows[0]],
                                     self._options.timeout_ns)
            total.times_ns.flags.writeable = False  # one type for the kernels
            self._progress[alike] = layout.pack_place(begin_ns, begin_ns, 0)
            terms = total.terms[None] if in_two_frames else total.terms
            self._run(alike, _Piece(total.times_ns, total.polynomials[None], total.in_space, 0,
                                    len(total.times_ns)), self._options.held_settings,
                      self._has_terms[alike] | in_two_frames | wheels.torques.any(),
                      terms[None] if terms_vary else self._terms)

    def _run(self, which: NDArray[np.intp], piece: _Piece, settings: Floats,
             has_terms: NDArray[np.bool_], terms: Floats, gains: Floats | None = None) -> None:
        """Run the loop over some runs, with terms for those that have them."""
        if len(which) == 1 and not has_terms.any() and gains is None:
            self._queue(int(which[0]), piece, settings)
            return
        for rows, given in ((which[~has_terms], None), (which[has_terms], terms)):
            self._run_alike(rows, piece, settings, given, gains)

    def _queue(self, row: int, piece: _Piece, settings: Floats) -> None:
        """Run the loop over a run later, with others whose torques change at the same times."""
        if self._queued:
            last, before, others = self._queued[-1]
            if (row // LANES != last // LANES or settings is not others
                    or not _change_together(piece, before)):
                self._run_queued()
        self._queued.append((row, piece, settings))

    def _run_queued(self) -> None:
        """Run the loop over the queued runs, each under torques of its own."""
        if not self._queued:
            return
        which = np.array([row for row, _, _ in self._queued])
        _, piece, settings = self._queued[0]
        polynomials = piece.polynomials
        if len(which) > 1:  # see `many_loop.run_each`
            polynomials = np.empty((LANES, *piece.polynomials.shape[1:]))
            for row, own, _ in self._queued:
                polynomials[row % LANES] = own.polynomials
            polynomials.flags.writeable = False  # one type for the kernels
        self._queued.clear()
        self._run_alike(which, piece._replace(polynomials=polynomials), settings, None, None)

    def _run_alike(self, which: NDArray[np.intp], piece: _Piece, settings: Floats,
                   terms: Floats | None, gains: Floats | None) -> None:
        """Run the loop over some runs, in chunks."""
        gains = np.ones(len(self._failed)) if gains is None else gains
        done, chunk = 0, LANES
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
        self._run_queued()
        for row in np.flatnonzero(self._failed).tolist():
            self._messages[row] = self._messages[row] or str(self._options.too_fast(
                int(self._progress[row, layout.GRID_NS])))
        count, size = len(self._messages), self._times.size
        self._motions[self._failed] = np.nan
        attitude, rates = np.split(self._motions, [4 * size], axis=1)
        return Trajectories(self._times, attitude.reshape(count, size, 4),
                            rates.reshape(count, size, 3), tuple(self._messages))
