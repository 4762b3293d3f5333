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

"""The trade itself: settings timed, compared with a reference, and one recommended."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import math
import statistics
import time
from typing import Any, NamedTuple

import numpy as np
from rigid_body_ros import so3
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.propagation import Trajectory, warm_up
from rigid_body_ros.propagation.solvers import RECORDS
from rigid_body_ros.torque import TorqueLog
from rigid_body_ros.tradeoff.problem import Problem, Reference, TIGHTEST, turned_angle, whole
from rigid_body_ros.tradeoff.readings import compare_readings, Reading

#: Wraps an iterable of so many items, to show progress.
Track = Callable[[Iterable[Any], int], Iterable[Any]]

_TOLERANCES = tuple(float(f'1e-{k}') for k in range(2, 16))
#: Angle of the longest step of the ladders, rad; the most steps of one run, a tenth of a second.
_LONGEST_ANGLE, _MOST_STEPS = 1.0, 1_000_000
_FEWEST_REPEATS, _MOST_REPEATS = 3, 15
#: What a reference costs, in runs of the series.
_REFERENCE = 14.0
#: s; a shorter run notices what ran before it, and is repeated once without being timed.
_NOTICES = 0.01


class Setting(NamedTuple):
    """A solver and what it is set to."""

    solver: str
    tolerance: float | None = None
    #: s
    max_step: float | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Return the keyword arguments of `propagate`."""
        return {name: value for name, value in self._asdict().items() if value is not None}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the lines of a scene that ask for this, whatever else the scene says."""
        if self.max_step is not None:
            return f'solver: {self.solver}', f'max_step: {self.max_step!r}'
        return (f'solver: {self.solver}', f'tolerance: {self.tolerance or TIGHTEST!r}',
                'max_step: 0.0')


class Error(NamedTuple):
    """How far a motion is from the reference, at most over the outputs unless it says final."""

    #: rad
    attitude_final: float
    attitude: float
    #: rad/s
    angular_velocity: float
    #: Of the largest there is. Without torque from the start's, otherwise from the reference's.
    momentum: float
    energy: float


_NO_ERROR = Error(*5 * [math.nan])


@dataclass(frozen=True)
class Run:
    """
    What a setting gave.

    Attributes
    ----------
    setting : Setting
    error : Error
        NaN where the run failed.
    seconds : float
        Wall time, the median of repeats in turns; NaN where the run failed.
    first_seconds : float
        Wall time of the first call, of kernels that are loaded.
    failure : str
        Why it failed; empty where it did not.
    on_front : bool
        No other setting is both cheaper and nearer.

    """

    setting: Setting
    error: Error
    seconds: float
    first_seconds: float
    failure: str = ''
    on_front: bool = False


class Choice(NamedTuple):
    """The cheapest setting that meets the target."""

    run: Run
    #: Attitude error to reckon with on the whole log, rad.
    error: float
    #: Whether that was measured on the whole log, or scaled from the stretch.
    measured: bool


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """
    What was measured.

    Attributes
    ----------
    stretch, whole : Problem
    angle : float
        That the body turns by over the stretch, rad.
    runs : tuple of Run
    floor, last_digits : float
        Rounding on the stretch, and the effect of the last digits there, rad; see `Reference`.
    readings : tuple of Reading
    target : float, rad
    choice : Choice or None
    load_seconds : float
        Time that loading the kernels took, or compiling them, the first time.

    """

    stretch: Problem
    whole: Problem
    angle: float
    runs: tuple[Run, ...]
    floor: float
    last_digits: float
    readings: tuple[Reading, ...]
    target: float
    choice: Choice | None
    load_seconds: float

    @property
    def reading(self) -> Reading | None:
        """Return the reading that the scene asks for, if it leaves anything open."""
        return next((reading for reading in self.readings
                     if reading.interpolation == self.stretch.log.interpolation), None)

    @property
    def dominant(self) -> str:
        """Return what the error of the recommended setting, or of the best, is owed to most."""
        errors = [run.error.attitude for run in self.runs if not run.failure]
        solver = self.choice.run.error.attitude if self.choice else min(errors, default=math.inf)
        shares = {'rounding': self.floor, 'solver': solver, 'last digits': self.last_digits,
                  'reading': self.reading.estimate if self.reading else 0.0}
        # A solver at the floor has no error of its own to show.
        if solver <= 2.0 * self.floor:
            shares['solver'] = 0.0
        return max(shares, key=lambda name: shares[name])


def measure(body: RigidBody, start: State, log: TorqueLog | None = None, *,
            end_ns: int | None = None, torque_timeout: float = 0.0, target: float = 1e-6,
            seconds: float = 10.0, track: Track = lambda items, total: items) -> Tradeoff:
    """
    Measure every solver, and choose the cheapest setting that meets a target.

    Parameters
    ----------
    body, start : RigidBody, State
        As for `propagate`.
    log : TorqueLog, optional
        None: no torques.
    end_ns : int, optional
        Where the whole ends: the last stamp, or after 50 turns where there is no log.
    torque_timeout : float, s
        As for `propagate`.
    target : float, rad
        Attitude error that is allowed, anywhere in the whole log.
    seconds : float
        Wall time to repeat runs for, and to look at the whole log for.
    track : callable, optional
        Wraps the iteration over the settings, to show progress.

    Raises
    ------
    ValueError
        Nothing moves, or the torques bring the body beyond what can be worked out.

    """
    began = time.perf_counter()
    warm_up()
    load_seconds = time.perf_counter() - began
    problem = whole(body, start, log, end_ns, torque_timeout)
    stretch = problem.stretch()
    reference = Reference.of(stretch)
    runs = _front(_timed(stretch, _settings(stretch, reference.trajectory), reference, seconds,
                         track), reference.floor)
    choice = recommend(runs, target, reference.certain, problem.seconds / stretch.seconds,
                       _judge(problem, stretch, reference, runs, seconds))
    return Tradeoff(stretch, problem, turned_angle(reference.trajectory), runs, reference.floor,
                    reference.last_digits, compare_readings(stretch), target, choice, load_seconds)


def recommend(runs: Sequence[Run], target: float, floor: float, growth: float,
              judge: Callable[[Run], float | None]) -> Choice | None:
    """
    Return the cheapest setting that meets a target on the whole log, if one does.

    Parameters
    ----------
    runs : sequence of Run
        On a stretch from the start: one that misses the target there misses it on the whole log.
    target, floor : float, rad
        The floor counts as an error of the setting. It is that of `Reference.certain`: rounding,
        or the effect of the last digits where that is larger.
    growth : float
        How much longer the whole log is.
    judge : callable
        Returns the attitude error on the whole log, rad, or None where that costs too much. Then
        the error of the stretch is taken to grow with the square of the time: one of the rates
        that grows evenly, as that of the energy does with RK4, makes one of the attitude that
        grows so; only near a separatrix, where rounding grows exponentially, is it more.

    """
    fitting = [run for run in runs if run.error.attitude + floor <= target]  # nor NaN
    for run in sorted(fitting, key=lambda run: run.seconds):
        error = judge(run)
        measured = error is not None
        if error is None:
            error = (run.error.attitude + floor) * growth ** 2
        if error <= target:
            return Choice(run, error, measured)
    return None


def _settings(problem: Problem, motion: Trajectory) -> list[Setting]:
    settings = [Setting(solver.name) for solver in RECORDS
                if problem.torque_free and not solver.takes_torque]
    settings += [Setting(solver.name, tolerance) for solver in RECORDS
                 if solver.takes_torque and not solver.fixed_step for tolerance in _TOLERANCES]
    longest = problem.natural_step(motion, _LONGEST_ANGLE)
    for solver in [solver.name for solver in RECORDS if solver.fixed_step]:
        step = longest
        while step >= 1e-9 and problem.seconds / step <= _MOST_STEPS:
            settings.append(Setting(solver, max_step=round(step * 1e9) / 1e9))
            step /= 2.0
    return settings


def _timed(problem: Problem, settings: Sequence[Setting], reference: Reference, seconds: float,
           track: Track) -> list[Run]:
    """Run every setting once for its error, and again, in turns, for the time it takes."""
    runs = []
    for setting in track(settings, len(settings)):
        began = time.perf_counter()
        try:
            motion = problem.run(**setting.options)
        except ValueError as error:
            runs.append(Run(setting, _NO_ERROR, math.nan, math.nan, str(error)))
            continue
        first = time.perf_counter() - began
        runs.append(Run(setting, _error(problem, motion, reference.trajectory), first, first))
    times: list[list[float]] = [[] for _ in runs]
    limit = time.perf_counter() + seconds
    for turn in track(range(_MOST_REPEATS), _MOST_REPEATS):
        if turn >= _FEWEST_REPEATS and time.perf_counter() > limit:
            continue  # lets the bar come to its end
        for run, measured in zip(runs, times):
            if not run.failure:
                if run.first_seconds < _NOTICES:
                    problem.run(**run.setting.options)
                began = time.perf_counter()
                problem.run(**run.setting.options)
                measured.append(time.perf_counter() - began)
    return [replace(run, seconds=statistics.median(measured)) if measured else run
            for run, measured in zip(runs, times)]


def _error(problem: Problem, motion: Trajectory, right: Trajectory) -> Error:
    attitude = so3.angle_between(motion.attitude, right.attitude)
    rates = np.linalg.norm(motion.angular_velocity - right.angular_velocity, axis=1)
    momentum, energy = right.angular_momentum_space, right.kinetic_energy
    if problem.torque_free:
        start = problem.start
        momentum = so3.rotate(start.attitude,
                              problem.body.angular_momentum(start.angular_velocity))[None]
        energy = problem.body.kinetic_energy(start.angular_velocity)
    lost = np.linalg.norm(motion.angular_momentum_space - momentum, axis=1).max()
    gained = np.abs(motion.kinetic_energy - energy).max()
    size = np.linalg.norm(momentum, axis=1).max()
    return Error(float(attitude[-1]), float(attitude.max()), float(rates.max()),
                 float(lost / size), float(gained / np.max(energy)))


def _front(runs: Sequence[Run], floor: float) -> tuple[Run, ...]:
    """Mark what nothing is both cheaper and nearer than; below the floor all are as near."""
    best, marked = math.inf, set()
    for number, run in sorted(enumerate(runs), key=lambda item: item[1].seconds):
        error = max(run.error.attitude, floor)
        if not run.failure and error < best:
            best = error
            marked.add(number)
    return tuple(replace(run, on_front=number in marked) for number, run in enumerate(runs))


def _judge(whole: Problem, stretch: Problem, reference: Reference, runs: Sequence[Run],
           seconds: float) -> Callable[[Run], float | None]:
    """Return what tells the error of a setting on the whole log, while there is time for it."""
    if stretch is whole:
        return lambda run: run.error.attitude + reference.certain
    growth = whole.seconds / stretch.seconds
    left, known = seconds, None
    series = max((run.seconds for run in runs if run.setting == Setting('taylor', TIGHTEST)),
                 default=math.inf)

    def judge(run: Run) -> float | None:
        nonlocal left, known
        cost = growth * (run.seconds + (0.0 if known else _REFERENCE * series))
        if cost > left:
            return None
        left -= cost
        known = known or Reference.of(whole)
        try:
            motion = whole.run(**run.setting.options)
        except ValueError:
            return math.inf
        apart = so3.angle_between(motion.attitude, known.trajectory.attitude)
        return float(apart.max()) + known.certain
    return judge
