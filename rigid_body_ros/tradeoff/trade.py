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

"""Measure the time and the error of every setting, and recommend a setting for each target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
import time

import numpy as np
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.propagation.options import RECORDS
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.tradeoff.choices import Error, Measurement, OnWhole, recommend, Setting
from rigid_body_ros.tradeoff.problem import (
    Case,
    final_differences,
    interpolation_errors,
    Reference,
    turned_angle,
    whole,
)
from rigid_body_ros.tradeoff.result import Tradeoff

#: Default target of `measure` and of --target, rad.
TARGET = 1e-6
_TOLERANCES = tuple(float(f'1e-{k}') for k in range(2, 16))
#: Angle through which the body turns in the longest fixed step, rad, and maximum number of steps
#: in a run. A run with that many steps takes about 0.1 s.
_LONGEST_ANGLE, _MOST_STEPS = 1.0, 1_000_000
_FEWEST_REPEATS, _MOST_REPEATS = 3, 15
#: The wall time of a run shorter than this, in seconds, depends on what ran before. Before each of
#: these short runs, the same setting therefore runs once without being timed.
_BRIEF = 0.01


def measure(problem: Problem, *, end_ns: int | None = None,
            targets: Sequence[float] = (TARGET,), seconds: float = 10.0,
            track: Track = no_progress) -> Tradeoff:
    """
    Measure every solver, and choose the cheapest setting for each target.

    Parameters
    ----------
    problem : Problem
        The motion. Its solver, tolerance and longest step are ignored.
    end_ns : int, optional
        End of the motion. By default, the motion ends at the last torque stamp or, if there are no
        torques, 50 turns after the start.
    targets : sequence of float, rad
        The largest attitude errors that you allow at any time during the motion.
    seconds : float
        Wall time to spend on repeated runs, s. Runs over the whole motion may take up to the same
        time again.
    track : callable, optional
        A function that wraps the iteration over the settings, for example to show progress.

    Returns
    -------
    Tradeoff

    Raises
    ------
    ValueError
        The body does not rotate and there is neither torque nor field; the end is not after the
        start; or the torques spin the body so fast that its motion cannot be computed.

    """
    case = whole(problem, end_ns)
    stretch = case.stretch()
    reference = Reference.of(stretch)
    measurements = _with_pareto_front(
        _measure_all(stretch, _settings_of(stretch, reference.trajectory), reference, seconds,
                     track),
        reference.floor)
    growth = case.seconds / stretch.seconds
    error_on_whole = OnWhole(case, stretch, reference, measurements, seconds)
    choices = {target: recommend(measurements, target, reference.guaranteed_error, growth,
                                 error_on_whole)
               for target in targets}
    return Tradeoff(stretch, case, turned_angle(reference.trajectory), measurements, reference,
                    interpolation_errors(stretch), final_differences(case), choices,
                    error_on_whole)


def _settings_of(case: Case, motion: Trajectory) -> list[Setting]:
    """Return all settings to measure for a case and its motion, from coarse to fine."""
    settings = [Setting(solver.name) for solver in RECORDS
                if case.conserves and not solver.takes_torque]
    settings += [Setting(solver.name, tolerance) for solver in RECORDS
                 if solver.takes_torque and not solver.fixed_step for tolerance in _TOLERANCES]
    steps, step = [], case.natural_step(motion, _LONGEST_ANGLE)
    while step >= 1e-9 and case.seconds / step <= _MOST_STEPS:
        steps.append(round(step * 1e9) / 1e9)
        step /= 2.0
    return settings + [Setting(solver.name, max_step=step) for solver in RECORDS
                       if solver.fixed_step and (
                           solver.takes_linear_terms or not case.has_linear_terms)
                       for step in steps]


def _measure_all(case: Case, settings: Sequence[Setting], reference: Reference,
                 seconds: float, track: Track) -> list[Measurement]:
    """
    Measure the error and the wall time of every setting.

    Every setting runs once to get its error. Then all settings run in turn to time them.
    """
    measurements = [_first_run(case, setting, reference)
                    for setting in track(settings, len(settings))]
    times: list[list[float]] = [[] for _ in measurements]
    limit = time.perf_counter() + seconds
    for repeat in track(range(_MOST_REPEATS), _MOST_REPEATS):
        if repeat >= _FEWEST_REPEATS and time.perf_counter() > limit:
            continue  # without running anything, so that the progress bar reaches its end
        for run, measured in zip(measurements, times):
            if not run.failure:
                if run.first_seconds < _BRIEF:
                    case.run(**run.setting.options)
                began = time.perf_counter()
                case.run(**run.setting.options)
                measured.append(time.perf_counter() - began)
    return [replace(run, seconds=min(measured)) if measured else run
            for run, measured in zip(measurements, times)]


def _first_run(case: Case, setting: Setting, reference: Reference) -> Measurement:
    began = time.perf_counter()
    try:
        motion = case.run(**setting.options)
    except ValueError as error:
        return Measurement(setting, failure=str(error))
    seconds = time.perf_counter() - began
    return Measurement(setting, _error(case, motion, reference.trajectory), seconds, seconds)


def _error(case: Case, motion: Trajectory, reference: Trajectory) -> Error:
    attitude = so3.angle_between(motion.attitude, reference.attitude)
    rates = np.linalg.norm(motion.angular_velocity - reference.angular_velocity, axis=1)
    momentum, energy = reference.angular_momentum_space, reference.kinetic_energy
    body, start = case.problem.body, case.problem.start
    if case.conserves:
        momentum = so3.rotate(start.attitude, body.angular_momentum(start.angular_velocity))[None]
        energy = body.kinetic_energy(start.angular_velocity)
    momentum_error = np.linalg.norm(motion.angular_momentum_space - momentum, axis=1).max()
    energy_error = np.abs(motion.kinetic_energy - energy).max()
    # Divide by the momentum of the body alone, because the total including rotors may be zero.
    size = np.linalg.norm(body.angular_momentum(reference.angular_velocity), axis=1).max()
    return Error(float(attitude[-1]), float(attitude.max()), float(rates.max()),
                 float(momentum_error / size), float(energy_error / np.max(energy)))


def _with_pareto_front(measurements: Sequence[Measurement],
                       floor: float) -> tuple[Measurement, ...]:
    """Mark the Pareto-optimal settings, treating errors below the floor as equal to the floor."""
    best, optimal = math.inf, set()
    for number, run in sorted(enumerate(measurements), key=lambda item: item[1].seconds):
        error = max(run.error.attitude, floor)
        if not run.failure and error < best:
            best = error
            optimal.add(number)
    return tuple(replace(run, pareto_optimal=number in optimal)
                 for number, run in enumerate(measurements))
