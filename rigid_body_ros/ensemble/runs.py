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

"""Compute the runs of an ensemble: draw parameters, propagate motions, and collect results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine.binding import LANES
from rigid_body_ros.ensemble.applied import Applied, components, Reach
from rigid_body_ros.ensemble.controller import Actuated, closed_loop, Controller
from rigid_body_ros.ensemble.dispersions import (
    dispersed,
    Dispersion,
    draws,
    Fitted,
    INERTIA,
    NOISE,
    units_of,
    units_with,
)
from rigid_body_ros.ensemble.motions import COMPONENTS
from rigid_body_ros.ensemble.requirements import ANGLE, Requirement
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem, propagate_many
from rigid_body_ros.propagation.many import LogsOfRuns
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.scene.parts import values_of

_START = units_of('inertia', 'initial_attitude', 'initial_angular_velocity')
MOTION = 'motion'
_END = {**COMPONENTS, ANGLE: 'rad'}

#: Limits for the runs that are computed at once. `_AT_ONCE` limits the number of runs. `_STEPS`
#: limits the number of torque samples and fixed steps; if each run has its own logs, `_SAMPLES`
#: replaces this limit. `_STATES` limits the number of states that are kept. The limits are high
#: enough to make the time spent in Python negligible, and low enough for a quick response to an
#: interrupt. `_SAMPLES` and `_STATES` are lower to save memory: each sample of a separate log
#: takes 33 bytes, and each state takes 56 bytes.
_AT_ONCE, _STEPS, _SAMPLES, _STATES = 4096, 2 ** 22, 2 ** 20, 2 ** 18

#: The columns of a table of runs, by name. They contain the run numbers, the status 'ok' or
#: 'failed', the messages, and the values, which are NaN in failed runs.
Columns = dict[str, NDArray[Any]]
#: The first run of a block, and the run after its last run.
Span = tuple[int, int]
#: The motions of n runs, shape (n, m, 7), a message for each run, and the results of the
#: requirements, shape (n, k). The message is empty if the run did not fail.
_Motions = tuple[Floats, list[str], Floats]


@dataclass(frozen=True, eq=False)
class Ensemble:
    """
    An ensemble of runs with dispersed parameters.

    The result of run number i depends only on i and on the attributes below.

    Attributes
    ----------
    problem : Problem
        The nominal motion.
    end_ns : int, ns
        The end of every run.
    dispersions : tuple of Dispersion
        The distributions of the parameters that vary.
    seed : int
        The seed of the random numbers.
    fitted : Fitted, optional
        Estimates that replace values of the problem. Their values in each run are drawn from
        their joint distribution.
    times_ns : array of int64, shape (m,), ns, optional
        The times at which states are kept. The last time is the end of the runs. By default, only
        the final state is kept.
    controller : Controller, optional
        A controller that returns a torque for each state. A dispersed torque gain or torque noise
        applies both to the controller's torque and to the recorded torques.
    requirements : tuple of Requirement
        Requirements that hold from some time on. Their results are columns.

    Raises
    ------
    InputError
        A dispersion is relative to a nominal value of zero; a dispersion varies torques or an
        orbit that the problem does not have; or a dispersion varies a body that changes during the
        motion.

    """

    problem: Problem
    end_ns: int
    dispersions: tuple[Dispersion, ...]
    seed: int
    fitted: Fitted | None = None
    times_ns: Ints | None = None
    controller: Controller | None = None
    requirements: tuple[Requirement, ...] = ()

    def __post_init__(self) -> None:
        for dispersion in self.dispersions:
            key = dispersion.key
            if dispersion.relative and self.nominal.get(key) == 0.0:
                raise InputError(f'{key}: relative: expected a nominal value other than 0')
        for key in self.keys:
            if key.startswith('orbit.') and key not in self.nominal:
                raise InputError(f'{key}: expected a scene with an orbit, found none')
            if (key in ('torque_gain', NOISE) and not (self.problem.logs or self.controller)) \
                    or (key == 'clock_offset'
                        and not (self.problem.logs or self.problem.efforts)):
                raise InputError(f'{key}: expected a recording of torques, found none')
            if self.problem.changes and key.split('.')[0] in (INERTIA, 'damping'):
                raise InputError(f'{key}: expected a body that does not change, found '
                                 f'{len(self.problem.changes)} changes')

    @property
    def in_python(self) -> bool:
        """Return whether Python code takes most of the time of a run."""
        return bool(self.controller or self.requirements)

    @property
    def keys(self) -> list[str]:
        """Return the keys of the parameters that vary."""
        estimates = self.fitted.estimates if self.fitted else ()
        return [*(dispersion.key for dispersion in self.dispersions), *estimates]

    @cached_property
    def nominal(self) -> dict[str, float]:
        """Return the nominal value of each key, without any dispersion."""
        columns = Applied.nominal(self.problem).columns()
        values = {name: float(column[0]) for name, column in columns.items()}
        return {**values, **self.fitted.nominal} if self.fitted else values

    @cached_property
    def nominal_motion(self) -> Floats:
        """
        Return the motion without any dispersion; raise the same errors as `propagate`.

        Returns
        -------
        array, shape (m, 7)
            Attitude, x y z w, and angular velocity, rad/s, at `times_ns` or, if this is None, at
            the end of the motion.

        """
        return self._nominal[0]

    def check(self) -> None:
        """
        Check that the nominal motion can be computed, and that the controller is reproducible.

        Raises
        ------
        ValueError
            `propagate` rejects the nominal motion. The error is a `ControllerError` if the
            controller fails, or if it returns different torques when the motion is computed again.

        """
        _, first = self._nominal
        if self.controller:
            _, again = replace(self)._nominal  # the copy computes the motion again
            self.controller.check_same(first, again)

    def replayed(self, run: int) -> tuple[Problem, dict[str, float]]:
        """
        Compute a run, and return the problem and the parameters of the run.

        The problem includes the torques of the controller.
        """
        applied = self.applied(np.array([run]))
        _, problem = replace(self, times_ns=None).solved(applied, 0)
        return problem, {key: float(column[0]) for key, column in applied.columns().items()}

    @property
    def times(self) -> Floats | None:
        """Return the times at which states are kept, in seconds since the start."""
        if self.times_ns is None:
            return None
        return (self.times_ns - self.problem.start.time_ns) / 1e9

    @cached_property
    def columns(self) -> dict[str, str]:
        """
        Return the unit of each numeric column.

        The parameters come first, then the final state, and the results of the requirements.
        """
        names = [field.name for field in self.problem.fields
                 if isinstance(field, UniformField) and field.name]
        more = {key: unit for key, unit in units_with(names).items()
                if key in self.keys and key not in _START}
        return {**_START, **more, **_END, **self._results}

    @property
    def _results(self) -> dict[str, str]:
        """Return the unit of each result of the requirements."""
        return {name: unit for requirement in self.requirements
                for name, unit in requirement.columns.items()}

    def rows(self, first: int, stop: int) -> Columns:
        """
        Compute the runs from `first` up to, but not including, `stop`.

        Returns
        -------
        dict
            The columns 'run', 'status' ('ok' or 'failed') and 'message', and those listed in
            `columns`, each of shape (stop - first,). If states are kept, the result also contains
            'motion', shape (stop - first, m, 7), with the same components as `nominal_motion`. All
            numbers of a failed run are NaN.

        Raises
        ------
        KeyboardInterrupt
            A signal was received.
        InputError
            This process cannot import the controller, or finds different source code.

        """
        if self.controller:
            self.controller.check()
        pieces = []
        for begin in range(first, stop, self._at_once):
            interrupts.check()
            pieces.append(self._rows(np.arange(begin, min(begin + self._at_once, stop))))
        return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}

    def applied(self, runs: Ints) -> Applied:
        """
        Return the parameters of some runs.

        The result contains a message for each run whose body or start is impossible.
        """
        return self._applied(runs, draws(self.dispersions, self.seed, runs),
                             self.fitted.draw(self.seed, runs) if self.fitted else {})

    @property
    def moments(self) -> tuple[Floats, Floats]:
        """
        Return the mean of the numbers that a run draws, and a factor of their covariance.

        The mean has shape (p,). The covariance is F F^T for the factor F, shape (p, p).
        """
        if self.fitted:
            return self.fitted.mean, self.fitted.factor
        mean, sigma = np.vstack([dispersion.moments for dispersion in self.dispersions]).T
        return mean, np.diag(sigma)

    def with_numbers(self, numbers: Floats) -> Applied:
        """Return the parameters of runs that draw the given numbers, shape (n, p)."""
        ends = np.cumsum([len(dispersion.moments) for dispersion in self.dispersions], dtype=int)
        drawn = {dispersion.key: columns for dispersion, columns in zip(
            self.dispersions, np.split(numbers, ends, axis=1))}
        return self._applied(np.arange(len(numbers)), drawn,
                             self.fitted.values(numbers) if self.fitted else {})

    def _applied(self, runs: Ints, drawn: Mapping[str, Floats],
                 estimates: Mapping[str, Floats]) -> Applied:
        values = dispersed(self.dispersions, self.nominal, drawn, len(runs))
        return Applied.with_values(self.problem, runs, {**values, **estimates}, self._of_fields)

    @cached_property
    def _nominal(self) -> tuple[Floats, Problem]:
        """
        Return the nominal motion and the problem that describes it.

        The problem includes the torques of the controller.
        """
        return replace(self, dispersions=()).solved(self._without, 0)

    @cached_property
    def _without(self) -> Applied:
        """Return the parameters of a run without any dispersion."""
        values = dispersed((), self.nominal, {}, 1)
        return Applied.with_values(self.problem, np.zeros(1, np.int64), values, self._of_fields)

    @property
    def _at(self) -> Ints:
        """Return the times at which states are computed, ns."""
        return np.array([self.end_ns]) if self.times_ns is None else self.times_ns

    @property
    def _have_own_logs(self) -> bool:
        """
        Return whether each run needs separate logs.

        This is necessary if the logs of different runs differ by more than a gain.
        """
        varied = {name.split('.')[0] for name in self.columns}
        return self._noise > 0.0 or bool(varied & {'torque_bias', 'clock_offset'})

    @cached_property
    def _of_fields(self) -> list[str]:
        """Return the keys of field parameters that are varied or estimated."""
        of_fields = {key for field in self.problem.fields for key in values_of(field)}
        return [key for key in self.keys if key in of_fields]

    @cached_property
    def _noise(self) -> float:
        """Return the standard deviation of the noise in each component of the torque, N m."""
        return sum(dispersion.bounds[0] for dispersion in self.dispersions
                   if dispersion.key == NOISE)

    @cached_property
    def _at_once(self) -> int:
        """Return how many runs to compute together in one call."""
        longest = self.problem.options.max_step or math.inf
        steps = (self.end_ns - self.problem.start.time_ns) / 1e9 / longest
        steps += sum(map(len, self.problem.sources))
        limit = _SAMPLES if self._have_own_logs else _STEPS
        runs = int(max(min(limit / (1.0 + steps), _STATES / len(self._at), _AT_ONCE), 1.0))
        return runs - runs % LANES or runs  # whole groups of runs that step together, if possible

    def _rows(self, runs: Ints) -> Columns:
        # Suppress warnings about infinite values and NaN, which the messages of the runs report.
        with np.errstate(over='ignore', invalid='ignore'):
            applied = self.applied(runs)
            motions, messages, results = self._motions(applied)
        failed = np.array([bool(message) for message in messages])
        end, angle = motions[:, -1], np.full(len(runs), np.nan)
        angle[~failed] = so3.angle_between(end[~failed, :4], self.nominal_motion[-1, :4])
        numbers = {**applied.columns(), **components('attitude', end[:, :4]),
                   **components('angular_velocity', end[:, 4:]), ANGLE: angle,
                   **dict(zip(self._results, results.T))}
        return {'run': runs, 'status': np.where(failed, 'failed', 'ok'),
                'message': np.array(messages),
                **{name: np.where(failed, np.nan, numbers[name]) for name in self.columns},
                **({} if self.times_ns is None else {MOTION: motions})}

    def _motions(self, applied: Applied) -> _Motions:
        """
        Return the motions of some runs.

        Runs that are impossible, or whose body would turn too far, are not computed.
        """
        messages = [impossible or too_far for impossible, too_far in zip(
            applied.messages, self._reach.messages(applied))]
        motions = np.full((len(messages), len(self._at), 7), np.nan)
        results = np.full((len(messages), len(self._results)), np.nan)
        rows = np.flatnonzero([not message for message in messages])
        if len(rows) and not (self.in_python or self.problem.changes or self.problem.named_wheels
                              or self.problem.actuators):
            possible = applied if len(rows) == len(messages) else self.applied(applied.runs[rows])
            with suppress(ValueError):  # otherwise, find out which of the runs fail, and why
                motions[rows], of_rows = self._together(possible)
                for row, message in zip(rows.tolist(), of_rows):
                    messages[row] = message
                return motions, messages, results
        for row in rows.tolist():
            interrupts.check()
            try:
                motion, problem = self.solved(applied, row)
                results[row] = [*{  # a requirement that is repeated has its columns once
                    name: number for requirement in self.requirements
                    for name, number in zip(requirement.columns, requirement.measured(
                        problem, self.end_ns, self._nominal[1]))}.values()]
                motions[row] = motion
            except ValueError as error:
                run = f'run {applied.runs[row]}: ' if self.controller else ''
                messages[row] = reason(ValueError(f'{run}{error}'))
        return motions, messages, results

    @cached_property
    def _reach(self) -> Reach:
        return Reach(self.problem, self.end_ns, self._noise, self._without)

    def _together(self, applied: Applied) -> tuple[Floats, list[str]]:
        count = len(applied.runs)
        shared = self.problem.logs
        logs: LogsOfRuns = [shared] * count if len(shared) > 1 else next(iter(shared), None)
        wheels: Sequence[TorqueLog] | TorqueLog | None = self.problem.wheels
        gains = applied.torque_gain if 'torque_gain' in self.columns else None
        if self._have_own_logs:
            logs, motors = zip(*(self.recorded(applied, row) for row in range(count)))
            wheels, gains = [log for log in motors if log] or None, None
        motions = propagate_many(
            applied.bodies, applied.starts, logs, at=self._at, wheels=wheels,
            fields=applied.fields if self._of_fields else self.problem.fields,
            torque_gains=gains, **asdict(self.problem.options))
        return np.concatenate([motions.attitude, motions.angular_velocity], axis=-1), [
            message and reason(ValueError(message)) for message in motions.messages]

    def solved(self, applied: Applied, row: int) -> tuple[Floats, Problem]:
        """
        Compute a run, and return the motion, shape (m, 7), and the problem of the run.

        If there is a controller, the last log of the problem contains the controller's torques.
        """
        problem = self.problem_of(applied, row)
        if self.controller:
            motion, log = closed_loop(problem, self.controller, self._at,
                                      self._actuated(applied, row))
            return motion, problem.replaced(log=[*problem.logs, log], actuator=[
                *(problem.actuators or [None] * len(problem.logs)), self.controller.actuator])
        states = problem.propagate(at=self._at)
        return np.concatenate([states.attitude, states.angular_velocity], axis=-1), problem

    def problem_of(self, applied: Applied, row: int) -> Problem:
        """Return the problem of a run, without the torques of the controller."""
        logs, wheels = self.recorded(applied, row)
        # A torque bias acts directly on the body, even if the other torques act through actuators.
        actuators = [*(self.problem.actuators or [None] * len(self.problem.logs)), None]
        start = replace(applied.starts[row], wheel_speeds=self.problem.start.wheel_speeds)
        offset, efforts = float(applied.clock_offset[row]), self.problem.efforts
        return self.problem.replaced(
            body=applied.bodies[row], start=start, log=logs, wheels=wheels,
            actuator=actuators[:len(logs)], fields=applied.fields[row],
            efforts=efforts and EffortLog(_later_ns(efforts.times_ns, offset), efforts.efforts))

    def recorded(self, applied: Applied, row: int) -> tuple[list[TorqueLog], TorqueLog | None]:
        """
        Return the recorded torques in a run: first those on the body, then those on the rotors.

        Raises
        ------
        ValueError
            A torque is not finite, or a stamp does not fit into 64 bits.

        """
        gain, offset = applied.torque_gain[row], float(applied.clock_offset[row])
        torques = [gain * log.torques for log in self.problem.logs]
        if self._noise:
            random = self._random(int(applied.runs[row]))
            torques = [torque + random.normal(0.0, self._noise, torque.shape)
                       for torque in torques]
        logs = [_later(log, offset, torque) for log, torque in zip(self.problem.logs, torques)]
        bias, wheels = applied.torque_bias[row], self.problem.wheels
        if bias.any():
            logs.append(TorqueLog.constant(bias, self.problem.start.time_ns, self.end_ns,
                                           self.problem.options.timeout_ns))
        return logs, wheels and (_later(wheels, offset, wheels.torques) if offset else wheels)

    def _actuated(self, applied: Applied, row: int) -> Actuated:
        """Return a function that applies the gain and noise of a run to a controller's torque."""
        gain, noise = applied.torque_gain[row], self._noise
        if not noise:
            return lambda torque: np.asarray(gain * torque)
        random = self._random(int(applied.runs[row]), 1)
        return lambda torque: np.asarray(gain * torque + random.normal(0.0, noise, 3))

    def _random(self, *key: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))


def _later(log: TorqueLog, offset: float, torques: Floats) -> TorqueLog:
    """Return a log of other torques, N m, whose stamps are `offset` seconds later."""
    return TorqueLog(_later_ns(log.times_ns, offset), torques, log.in_space, log.interpolation)


def _later_ns(times_ns: Ints, offset: float) -> Ints:
    if not abs(offset) < NEVER_NS / 1e9:
        raise ValueError(f'clock_offset: expected less than 292 years, found {offset:g} s')
    offset_ns = round(offset * 1e9)
    ends = [int(stamp) + offset_ns for stamp in times_ns[[0, -1]]] if len(times_ns) else []
    if any(abs(end) >= NEVER_NS for end in ends):
        raise ValueError(f'clock_offset: expected stamps that fit 64 bits, found {offset:g} s')
    return times_ns + offset_ns
