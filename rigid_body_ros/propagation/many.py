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

"""Integrate many motions at once."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
import math
import time
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels, layout, many_loop, motion_layout, Rows
from rigid_body_ros.engine.binding import LANES
from rigid_body_ros.mechanics.bodies import RigidBodies
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import (
    beginning_at,
    Field,
    GravityGradient,
    packed,
    UniformField,
)
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import States
from rigid_body_ros.mechanics.torque import torque_logs, TorqueLog
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.propagation.options import checked_times, Options, validated
from rigid_body_ros.propagation.problem import Problem
from rigid_body_ros.propagation.timeline import OtherTorques, Timeline

#: If a kernel call takes less than this time, s, the next call computes twice as many runs. Python
#: handles signals between the calls.
_PATIENCE = 0.05
#: One log for all runs; or, for each run, one log or a sequence of logs.
LogsOfRuns = TorqueLog | Sequence[TorqueLog | Sequence[TorqueLog]] | None


@dataclass(frozen=True, eq=False)
class Trajectories:
    """
    The states of many motions at the same times.

    Attributes
    ----------
    times_ns : array of int64, shape (m,)
    attitude : array, shape (n, m, 4)
        x y z w, body to space, as in `Trajectory`. NaN for a failed run.
    angular_velocity : array, shape (n, m, 3), rad/s, body axes
        NaN for a failed run.
    messages : tuple of n str
        For each run that failed, the reason. For each other run, an empty string.

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


def propagate_many(bodies: RigidBodies, starts: States, log: LogsOfRuns = None, *, at: ArrayLike,
                   wheels: TorqueLog | Sequence[TorqueLog] | None = None,
                   fields: Sequence[Field] | Sequence[Sequence[Field]] = (),
                   torque_gains: ArrayLike | None = None, solver: str = Options.solver,
                   tolerance: float = Options.tolerance,
                   max_step: float | None = Options.max_step,
                   torque_timeout: float = Options.torque_timeout) -> Trajectories:
    """
    Integrate many motions, each of which agrees bit for bit with `propagate`.

    Run i is the motion of `bodies[i]` from `starts[i]`. If a run fails, the other runs continue:
    the states of the failed run are NaN, and its message says why it failed. The loop over the
    runs releases Python's global interpreter lock, so several threads can compute runs at the same
    time.

    Parameters
    ----------
    bodies : RigidBodies
        The n bodies.
    starts : States
        The start of each body.
    log : TorqueLog, or sequence of n TorqueLog or of n sequences of TorqueLog, optional
        One log for all runs, or one or several logs for each run. The torques of several logs add
        up. The sum is computed only once for all runs with the same logs. None for torque-free
        motion.
    at : array of int, shape (m,), ns
        The times, as for `propagate`. They are the same for all runs.
    wheels : TorqueLog, or sequence of n TorqueLog, optional
        The torque on the rotors, as for `propagate`: one log for all runs, or one log for each
        run.
    fields : sequence of UniformField or GravityGradient, or n such sequences, optional
        See `Problem`: one sequence for all runs, or one sequence for each run. Runs with fields
        are computed one by one instead of several at once.
    torque_gains : array, shape (n,), optional
        Factors by which to multiply the torques: each log of run i is replaced by
        `log.with_torques(torque_gains[i] * log.torques)`.
    solver, tolerance, max_step, torque_timeout
        See `Problem`.

    Returns
    -------
    Trajectories

    Raises
    ------
    ValueError
        There is no body; the numbers of bodies, starts, logs or gains differ; a time lies before a
        start or is not an integer that fits in int64; an option is out of its range; a gain times
        a torque is not finite; the torque on rotors is in space axes; some runs have fields and
        other runs have none; `wheels` lists named wheels; or the solver does not handle the
        torques, rotors, damping or fields that are given.

    """
    options = validated(solver, tolerance, max_step, torque_timeout)
    if not isinstance(wheels, TorqueLog) and any(
            isinstance(wheel, Wheel) for wheel in wheels or ()):
        raise ValueError('wheels: expected torques on the rotors, found named wheels, which '
                         'only propagate computes')
    runs = _Runs(bodies, starts, at, options, _of_runs(fields, starts))
    gains = None if torque_gains is None else np.array(torque_gains, float)
    if gains is not None and gains.shape != (len(bodies),):
        raise ValueError(f'torque_gains: expected shape ({len(bodies)},), found {gains.shape}')
    logs, motors = _of_each(log, len(bodies), 'log'), _of_each(wheels, len(bodies), 'wheels')
    for which in _alike(logs, motors):
        problem = _AT_REST.replaced(log=logs[which[0]], wheels=motors[which[0]], options=options)
        if gains is None or (not fields and _can_scale(problem, gains)):
            runs.advance(problem, which, gains)
            continue
        for row in which.tolist():
            scaled = [each.with_torques(gains[row] * each.torques) for each in problem.logs]
            runs.advance(problem.replaced(log=scaled), np.array([row]))
    return runs.trajectories()


def _of_runs(fields: Sequence[Any], starts: States) -> NDArray[Any] | None:
    """
    Pack fields for the kernels, in one row per run or one row for all runs.

    If there are no fields, the result is None.
    """
    if not fields:
        return None
    begins_ns = starts.time_ns.tolist()
    if isinstance(fields[0], UniformField | GravityGradient):
        of_each = [fields] * (len(begins_ns) if len(set(begins_ns)) > 1 else 1)
    elif len(fields) != len(begins_ns):
        raise ValueError(f'fields: expected {len(begins_ns)}, one for each body, '
                         f'found {len(fields)}')
    else:
        of_each = list(fields)
    rows = [packed(beginning_at(of_run, begin_ns)) for of_run, begin_ns in zip(of_each, begins_ns)]
    if all(row is None for row in rows):
        return None
    filled = [row for row in rows if row is not None]
    if len(filled) < len(rows):
        raise ValueError('fields: expected fields for each run or for none, found '
                         f'{len(rows) - len(filled)} runs without')
    result = np.concatenate(filled)
    result.flags.writeable = False
    return result


def _alike(logs: Sequence[Any], motors: Sequence[Any]) -> list[NDArray[np.intp]]:
    """Return groups of run indices. The runs in a group have the same logs and wheels."""
    return _grouped([(*map(id, torque_logs(log)), id(motor)) for log, motor in zip(logs, motors)])


def _of_each(given: Any, count: int, name: str) -> Sequence[Any]:
    """Return the value given for each run; raise ValueError if the number of values is wrong."""
    if given is None or isinstance(given, TorqueLog):
        return [given] * count
    if len(given) != count:
        raise ValueError(f'{name}: expected {count}, one for each body, found {len(given)}')
    return list(given)


def _grouped(keys: Iterable[Hashable]) -> list[NDArray[np.intp]]:
    """Return the indices of each key, ordered by the first appearance of the keys."""
    groups: dict[Hashable, list[int]] = {}
    for row, key in enumerate(keys):
        groups.setdefault(key, []).append(row)
    return [np.array(rows) for rows in groups.values()]


def _can_scale(problem: Problem, gains: Floats) -> bool:
    """
    Return whether the kernels can multiply the torques of a problem by the gains.

    The kernels multiply polynomial coefficients. These are the torques themselves only if the log
    is held. If a product is not finite, the result is False, so that `TorqueLog` does the
    multiplication and reports the error.
    """
    logs = problem.logs
    if len(problem.sources) != 1 or not logs:
        return not logs
    largest = float(np.abs(gains).max()) * float(np.abs(logs[0].torques).max(initial=0.0))
    return logs[0].interpolation == 'hold' and math.isfinite(largest)


def _change_together(one: Rows, other: Rows) -> bool:
    """Return whether two sets of held torques change at the same times and have the same axes."""
    return (one.torques.shape == other.torques.shape and one.torques.shape[1] == 1
            and np.array_equal(one.times_ns, other.times_ns)
            and np.array_equal(one.in_space, other.in_space))


class _Runs:
    """The states of all runs, and their motions at the requested times."""

    def __init__(self, bodies: RigidBodies, starts: States, at: ArrayLike,
                 options: Options, fields: NDArray[Any] | None) -> None:
        if len(starts) != len(bodies):
            raise ValueError(f'starts: expected {len(bodies)}, one for each body, '
                             f'found {len(starts)}')
        if not len(bodies):
            raise ValueError('bodies: expected at least one, found none')
        begins_ns = starts.time_ns
        self._times_ns, ascends, _ = checked_times(at, int(begins_ns.max()))
        checked_times(self._times_ns, int(begins_ns.min()))
        options.check_terms(bool(bodies.is_damped.any()), bool(starts.has_rotors.any()),
                            fields is not None)
        self._bodies, self._options, self._fields = bodies, options, fields
        self._order = layout.IN_ORDER if ascends else np.argsort(self._times_ns, kind='stable')
        self._messages = [of_body or of_start for of_body, of_start in zip(bodies.messages,
                                                                           starts.messages)]
        count = len(bodies)
        self._progress = np.zeros(count, layout.PROGRESS)
        self._progress['grid'] = self._progress['begin'] = starts._packed
        self._progress['grid_ns'] = self._progress['begin_ns'] = begins_ns
        self._progress['budget'] = layout.BUDGET
        self._progress['stop'][np.array([bool(message) for message in self._messages])] = \
            layout.FAILED
        self._motions: Floats = np.empty((count, motion_layout.SIZE * self._times_ns.size))
        self._is_linear = bodies.is_damped | starts.has_rotors
        #: The rotor momentum of each run at its start, and its low-order part, N m s.
        self._momentum: Floats = np.zeros((count, 2, 3))
        self._momentum[:, 0] = starts.rotor_momentum
        #: Runs that are waiting to be computed together, each with its own torques. The torques of
        #: all these runs change at the same times, and the indices of the runs lie between two
        #: neighbouring multiples of LANES.
        self._queued: list[tuple[int, Rows]] = []

    def advance(self, problem: Problem, which: NDArray[np.intp],
                gains: Floats | None = None) -> None:
        """
        Compute the runs `which`, all with the torques of one problem.

        If `gains` is given, the torques of run i are multiplied by `gains[i]`. The array has one
        entry for each of the n runs. The problem must then have a single log.
        """
        which = which[self._progress['stop'][which] != layout.FAILED]
        if not (which.size and self._times_ns.size):
            return
        if len(problem.logs) < 2 and not problem.wheels and self._fields is None:
            self._advance_alike(problem, which, gains)
            return
        # When torques are summed, the first row begins at the start of the run, so only runs with
        # the same start time can share rows. With motors, the rows also depend on the rotor
        # momentum.
        begins_ns = self._progress['grid_ns'][which].tolist()
        momenta = self._momentum[which] * problem.has_rotors
        for rows in _grouped([(begin_ns, momentum.tobytes())
                              for begin_ns, momentum in zip(begins_ns, momenta)]):
            self._advance_alike(problem, which[rows])

    def _advance_alike(self, problem: Problem, which: NDArray[np.intp],
                       gains: Floats | None = None) -> None:
        """Compute runs that have the same torques, so that they can share one set of rows."""
        begins_ns = self._progress['grid_ns'][which]
        momentum = self._momentum[which[0]] if problem.has_rotors else None
        timeline = Timeline(problem.logs, problem.wheels, self._options.timeout_ns, False,
                            int(begins_ns[0]), momentum, OtherTorques(self._fields))
        self._progress['row'][which] = timeline.times_ns.searchsorted(begins_ns, 'right') - 1
        for begin, end, rows in timeline.chunks(self._progress['row'][which],
                                                len(timeline.times_ns)):
            self._progress['row'][which] -= begin
            going = which[self._progress['stop'][which] != layout.FAILED]
            self._progress['stop'][going] = end - begin
            self._run(which, rows, gains)
            self._progress['row'][which] += begin

    def _run(self, which: NDArray[np.intp], rows: Rows, gains: Floats | None) -> None:
        """Run the loop over some runs, with linear terms only for rotors or damping."""
        rows, terms = rows._replace(torques=rows.torques[None], terms=None), rows.terms
        if self._fields is not None:
            assert terms
            momentum = terms.momentum[None] if len(terms.momentum) > 1 else self._momentum[:, None]
            own_fields: Any = many_loop.ManyTerms(
                momentum, terms.motors, terms.space, self._fields)
            self._run_alike(which, rows._replace(terms=own_fields), gains)
            return
        if terms and terms.motors is not None:
            of_all: Any = many_loop.ManyTerms(terms.momentum[None], terms.motors, terms.space)
            self._run_alike(which, rows._replace(terms=of_all), gains)
            return
        is_linear = self._is_linear[which] | (terms is not None)
        if len(which) == 1 and not is_linear[0] and gains is None and rows.torques.shape[2] == 1:
            self._queue(int(which[0]), rows)
            return
        self._run_alike(which[~is_linear], rows, gains)
        own: Any = many_loop.ManyTerms(self._momentum[:, None], None,
                                       terms.space if terms else None)
        self._run_alike(which[is_linear], rows._replace(terms=own), gains)

    def _queue(self, run: int, rows: Rows) -> None:
        """Queue a run, to be computed with other runs whose torques change at the same times."""
        if self._queued:
            last, before = self._queued[-1]
            if run // LANES != last // LANES or not _change_together(rows, before):
                self._run_queued()
        self._queued.append((run, rows))

    def _run_queued(self) -> None:
        """Run the loop over the queued runs, each with its own torques."""
        if not self._queued:
            return
        which, rows = np.array([run for run, _ in self._queued]), self._queued[0][1]
        if len(which) > 1:  # see `many_loop.run_each`
            torques = np.empty((LANES, *rows.torques.shape[1:]))
            for run, own in self._queued:
                torques[run % LANES] = own.torques
            rows = rows._replace(torques=torques)
        self._queued.clear()
        self._run_alike(which, rows, None)

    def _run_alike(self, which: NDArray[np.intp], rows: Rows, gains: Floats | None) -> None:
        """Run the loop over some runs, a limited number at a time."""
        runs = many_loop.Runs(self._progress, self._motions, self._bodies._constants,
                              np.ones(len(self._progress)) if gains is None else gains)
        of_all = cast(many_loop.ManyRows, rows)  # torques and momentum have an additional axis
        work = many_loop.workspace(LANES, of_all)
        done, chunk = 0, LANES
        while done < len(which):
            began = time.monotonic()
            done += kernels.run_each(which[done:done + chunk], runs, self._times_ns, self._order,
                                     of_all, self._options.method, work)
            if time.monotonic() - began < _PATIENCE:
                chunk *= 2

    def trajectories(self) -> Trajectories:
        """Return the motions, with NaN for the failed runs."""
        self._run_queued()
        failed = self._progress['stop'] == layout.FAILED
        for run in np.flatnonzero(failed).tolist():
            self._messages[run] = self._messages[run] or str(self._options.too_fast(
                int(self._progress['grid_ns'][run])))
        count, size = len(self._messages), self._times_ns.size
        self._motions[failed] = np.nan
        attitude, rates = np.split(self._motions, [4 * size], axis=1)
        return Trajectories(self._times_ns, attitude.reshape(count, size, 4),
                            rates.reshape(count, size, 3), tuple(self._messages))


#: A placeholder problem whose torques are replaced by those of the runs. The body and the start of
#: this problem are not used.
_AT_REST = Problem(RigidBody(np.eye(3)), State())
