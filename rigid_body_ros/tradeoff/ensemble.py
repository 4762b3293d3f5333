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

"""Derive a target from the spread of an ensemble, and find the cheapest setting for many runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
import math
from pathlib import Path
import time

import numpy as np
from rigid_body_ros.common.errors import InputError, quoted, reason
from rigid_body_ros.mechanics.bodies import RigidBodies
from rigid_body_ros.mechanics.states import States
from rigid_body_ros.propagation import Problem, propagate_many
from rigid_body_ros.runtime.limits import read_json
from rigid_body_ros.tradeoff.choices import Advice, Choice, DEFAULT, recommend, Setting, Spread
from rigid_body_ros.tradeoff.result import Tradeoff

#: Many runs are timed in `_ROUNDS` rounds. In each round, every setting computes the same number
#: of runs, at most `_MOST_RUNS`. The cheapest setting takes about `_TIMED` seconds for these runs.
_TIMED, _ROUNDS, _MOST_RUNS = 0.01, 5, 256


def read(folder: str | Path) -> Spread:
    """
    Read the spread of an ensemble from the ensemble's folder.

    Raises
    ------
    InputError
        The folder does not contain a complete ensemble, or the median angle between the runs and
        the nominal attitude is zero.

    """
    path = Path(folder) / 'summary.json'
    data = read_json(path, 'summary of the ensemble')
    try:
        median = data['angle_from_nominal_rad'].get('p50')
        spread = Spread(int(data['runs']), float(median or 0.0), int(data['start_ns']),
                        int(data['end_ns']), str(data['recording']))
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f'{path}: expected the summary of an ensemble, found another file: '
                         f'{reason(error)}') from error
    if not 0.0 < spread.median < math.inf:
        raise InputError(f'{path}: angle_from_nominal_rad: p50: expected an angle greater than 0, '
                         f'found {quoted(median)}')
    return spread


def advise(result: Tradeoff, spread: Spread) -> Tradeoff:
    """
    Return a result to which the cheapest setting for many runs, and its cost, are added.

    Parameters
    ----------
    result : Tradeoff
        A result whose targets include the target of the spread.
    spread : Spread
        The spread of an ensemble of the same motion.

    """
    choice = _recommended_for_many(result, spread.target)
    settings = [DEFAULT, *([choice.measurement.setting] if choice else [])]
    seconds = _seconds_per_run(result, settings)
    return replace(result, choices={**result.choices, spread.target: choice},
                   ensemble=Advice(spread, seconds[1] if choice else None, seconds[0]))


def _recommended_for_many(result: Tradeoff, target: float) -> Choice | None:
    """
    Return the cheapest setting for many runs.

    Only one setting of each solver is timed with many runs. The ratio of this setting's cost per
    run to its cost in a single run is used to scale the costs of all settings of the solver.
    """
    single = {one.setting: one for one in result.measurements if not one.failure}
    best: dict[str, Setting] = {}
    for one in sorted(single.values(), key=lambda one: one.seconds):
        if one.error.attitude <= target:
            best.setdefault(one.setting.solver, one.setting)
    many = dict(zip(best, _seconds_per_run(result, [*best.values()])))
    scaled = [replace(one, seconds=one.seconds * many[one.setting.solver]
                      / single[best[one.setting.solver]].seconds)
              for one in single.values() if one.setting.solver in best]
    choice = recommend(scaled, target, result.reference.guaranteed_error, result.growth,
                       lambda one: result.error_on_whole(single[one.setting]))
    return choice and choice._replace(measurement=single[choice.measurement.setting])


def _seconds_per_run(result: Tradeoff, settings: list[Setting]) -> list[float]:
    """
    Return the wall time per run, s, of each setting.

    The time is measured while many copies of the whole motion are computed at once.
    """
    cheapest = min(one.seconds for one in result.measurements if not one.failure)
    runs = min(_MOST_RUNS, math.ceil(_TIMED / cheapest))
    run = _run_of(result.stretch.problem, runs, int(result.stretch.times_ns[-1]))
    rounds = []
    for _ in range(_ROUNDS):
        times = [time.perf_counter()]
        for setting in settings:
            run(**setting.options)
            times.append(time.perf_counter())
        rounds.append(np.diff(times))
    return [float(fastest) * result.growth / runs for fastest in np.min(rounds, axis=0)]


def _run_of(problem: Problem, runs: int, end_ns: int) -> Callable[..., object]:
    """Return a function that computes the final states of `runs` copies of a motion at once."""
    start = problem.start
    bodies = RigidBodies(np.tile(problem.body.inertia, (runs, 1, 1)), problem.body.damping)
    starts = States(start.time_ns, np.tile(start.attitude, (runs, 1)), start.angular_velocity,
                    start.rotor_momentum)
    acting = problem.acting_logs  # the lags of actuators are ignored here
    logs = [acting] * runs if len(acting) > 1 else next(iter(acting), None)
    return partial(propagate_many, bodies, starts, logs, at=[end_ns], wheels=problem.wheels,
                   fields=problem.fields,
                   torque_timeout=problem.options.torque_timeout)
