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

"""Restart a motion from measured states, and compute the error some time after each restart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.inference.monitor import Judgement
from rigid_body_ros.inference.residual_torque import measured_rates
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report.thinning import thinned
from rigid_body_ros.runtime.terminal import no_progress, Track

#: The state at a restart is estimated from at most this many samples.
_SAMPLES = 11
#: The default horizons, s, and the maximum number of windows for each horizon.
_USUAL, _WINDOWS = (0.1, 1.0, 10.0), 500
#: The shortest horizon, as a multiple of the time between samples. It is slightly less than 1 to
#: allow for jitter.
_SHORTEST = 0.99
#: The estimate of the state at a restart is corrected at most `_CORRECTIONS` times. The estimate
#: has converged when a correction is smaller than `_CORRECTED`, rad, or smaller than the fraction
#: `_NEGLIGIBLE` of the median error.
_CORRECTIONS, _CORRECTED, _NEGLIGIBLE = 8, 1e-10, 0.02


@dataclass(frozen=True, eq=False)
class Horizon:
    """
    The errors that build up within one horizon after each restart from a measured state.

    Attributes
    ----------
    seconds : float, s
        The horizon, which is the length of a window. The motion is restarted at the beginning of
        each window.
    angles : array, shape (n,), rad
        The attitude error at the end of each window.
    judgements : tuple of Judgement
        What a live check (`Monitor`) would report with windows of this length. The tuple is empty
        if the default horizons are used, if the scene does not give the sensor noise, or if the
        problem is not suitable for a live check.

    """

    seconds: float
    angles: Floats
    judgements: tuple[Judgement, ...] = ()


def usual_horizons(sensors: Sequence[Measured]) -> list[float]:
    """
    Return those default horizons that suit the first sensor with attitudes.

    A suitable horizon is at least as long as the usual time between two samples, and no longer
    than the measurement.
    """
    stamps_ns = next((sensor.stamps_ns for sensor in sensors if sensor.is_attitude), np.empty(0))
    if len(stamps_ns) < 2:
        return []
    shortest, longest = _SHORTEST * np.median(np.diff(stamps_ns)), np.ptp(stamps_ns)
    return [seconds for seconds in _USUAL if shortest <= 1e9 * seconds <= longest]


def horizon(problem: Problem, sensors: Sequence[Measured], seconds: float,
            track: Track = no_progress) -> Horizon:
    """
    Restart a motion repeatedly from measured states, and return the errors one horizon later.

    The state at each restart is estimated from the samples in the first fifth of the horizon, but
    from at least two and at most eleven samples. The estimate is refined in several steps. Each
    step propagates the motion from the first of these samples, fits a straight line in time to the
    errors, and uses the line to correct the state. If the measurement is long enough for more than
    500 restarts, at most 500 evenly spaced restarts are computed.

    Parameters
    ----------
    problem : Problem
        The model to restart.
    sensors : sequence of Measured
        Measurements, converted to the clock and the axes of the motion. Only the first sensor with
        attitudes is used, together with any angular velocities that it measures.
    seconds : float, s
        The horizon.
    track : callable, optional
        Wraps the loop over the windows to show progress.

    Raises
    ------
    InputError
        The horizon is shorter than the usual time between two samples.

    """
    sensor = next((sensor.rows(sensor.stamps_ns >= problem.start.time_ns)
                   for sensor in sensors if sensor.is_attitude), None)
    if sensor is None or len(sensor) < 2:
        return Horizon(seconds, np.empty(0))
    stamps_ns, step_ns = sensor.stamps_ns, round(1e9 * seconds)
    spacing_ns = int(np.median(np.diff(stamps_ns)))
    if step_ns < _SHORTEST * spacing_ns:
        raise InputError(f'{sensor.topic}: expected a horizon of at least '
                         f'{1e-9 * spacing_ns:g} s, the time between two samples, found '
                         f'{seconds:g} s')
    # Accept samples that are late by up to half the time between samples.
    half_ns = spacing_ns // 2
    _, rows = np.unique((stamps_ns - stamps_ns[0] + half_ns) // step_ns, return_index=True)
    first, last = (edges[thinned(len(edges), _WINDOWS)] for edges in (rows[:-1], rows[1:]))
    whole = np.abs(stamps_ns[last] - stamps_ns[first] - step_ns) <= 2 * half_ns
    first, last = first[whole], last[whole]
    starts = _restarted(problem, sensor, first, last, stamps_ns[first] + step_ns // 5)
    return Horizon(seconds, np.array([_error(problem, sensor, start, row)
                                      for start, row in track([*zip(starts, last)], len(last))]))


def _error(problem: Problem, sensor: Measured, start: State, row: int) -> float:
    """Return the error, rad, of a motion at a sample, if it begins in the given state."""
    at = sensor.stamps_ns[row:row + 1]
    motion = problem.between(start, int(at[0])).propagate(at=at)
    return float(so3.angle_between(motion.attitude[0], sensor.values[row]))


def _restarted(problem: Problem, sensor: Measured, first: Ints,
               last: Ints, until_ns: Ints) -> list[State]:
    """For each window, fit a motion to its first few samples, and return the state at `first`."""
    counts = np.searchsorted(sensor.stamps_ns, until_ns, 'right') - first
    counts = np.minimum(np.clip(counts, 2, _SAMPLES), last - first + 1)
    momenta = problem.rotor_momentum(sensor.stamps_ns[first])
    starts: dict[int, State] = {}
    for count in np.unique(counts).tolist():  # windows with equally many samples fit in one array
        group = np.flatnonzero(counts == count)
        rows = first[group][:, None] + np.arange(count)
        starts |= zip(group.tolist(), _fitted(problem, sensor, rows, momenta[group]))
    return [starts[k] for k in range(len(first))]


def _fitted(problem: Problem, sensor: Measured, rows: Ints, momenta: Floats) -> list[State]:
    """Fit a motion to the samples in each row of an array, and return their first states."""
    (_, rates), stamps_ns, attitude = measured_rates(sensor), sensor.stamps_ns, sensor.values
    has_rates = sensor.angular_velocity is not None
    begins = np.median(rates[rows if has_rates else rows[:, :-1]], axis=1)
    starts = [State(time_ns, *state) for time_ns, *state in zip(
        stamps_ns[rows[:, 0]].tolist(), attitude[rows[:, 0]], begins, momenta)]
    if rows.shape[1] < 3:
        return starts
    moving = [*range(len(starts))]
    for _ in range(_CORRECTIONS):
        used = rows[moving]
        motions = [problem.between(starts[k], int(stamps_ns[rows[k, -1]])).propagate(
            at=stamps_ns[rows[k]]) for k in moving]
        turned = np.stack([motion.attitude for motion in motions])
        vectors = so3.difference(turned, attitude[used])
        # Work in space axes, where the components of a constant attitude error do not change.
        vectors = so3.rotate(turned, vectors)
        seconds = 1e-9 * (stamps_ns[used] - stamps_ns[used[:, :1]])[:, :, None]
        offset, drift = _lines(np.concatenate([np.ones_like(seconds), seconds], 2), vectors)
        begin = np.stack([starts[k].attitude for k in moving])
        change = so3.rotate(so3.conjugate(begin), drift)
        if has_rates:
            change, = _lines(np.ones_like(seconds), rates[used] - np.stack(
                [motion.angular_velocity for motion in motions]))
        begin = so3.normalize(so3.multiply(so3.exp(offset), begin))
        for k, turn, faster in zip(moving, begin, change):
            starts[k] = replace(starts[k], attitude=turn,
                                angular_velocity=starts[k].angular_velocity + faster)
        usual = np.median(np.linalg.norm(vectors, axis=2), axis=1)
        size = np.linalg.norm(offset, axis=1) \
            + seconds[:, -1, 0] * np.linalg.norm(change, axis=1)
        moving = [k for k, is_moving in zip(
            moving, size >= np.maximum(_CORRECTED, _NEGLIGIBLE * usual)) if is_moving]
        if not moving:
            break
    return starts


def _lines(columns: Floats, values: Floats) -> Floats:
    """
    Fit linear combinations of columns to values, giving less weight to outliers.

    The columns have shape (n, m, k), and the values (n, m, 3). Return the coefficients, shape
    (k, n, 3).
    """
    weights = np.ones_like(columns[:, :, :1])
    for _ in range(3):
        weighted = (weights ** 2 * columns).swapaxes(1, 2)
        coefficients = np.linalg.solve(weighted @ columns, weighted @ values)
        distances = np.linalg.norm(values - columns @ coefficients, axis=2, keepdims=True)
        limit = np.maximum(2.0 * np.median(distances, axis=1, keepdims=True), 1e-300)
        weights = np.minimum(limit / np.maximum(distances, limit), 1.0)
    return np.asarray(coefficients.swapaxes(0, 1))
