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
from dataclasses import dataclass

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.inference.alarms import Judgement
from rigid_body_ros.inference.motion import errors_of
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
    stamps_ns = next((one.stamps_ns for one in sensors if one.attitude is not None), np.empty(0))
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
    with_attitude = [sensor for sensor in sensors if sensor.attitude is not None]
    if not with_attitude:
        return Horizon(seconds, np.empty(0))
    sensor = with_attitude[0].rows(with_attitude[0].stamps_ns >= problem.start.time_ns)
    stamps_ns, step_ns = sensor.stamps_ns, round(1e9 * seconds)
    if len(stamps_ns) < 2:
        return Horizon(seconds, np.empty(0))
    spacing_ns = int(np.median(np.diff(stamps_ns)))
    if step_ns < _SHORTEST * spacing_ns:
        raise InputError(f'{sensor.topic}: expected a horizon of at least '
                         f'{1e-9 * spacing_ns:g} s, the time between two samples, found '
                         f'{seconds:g} s')
    # Accept samples that are late by up to half the time between samples.
    half_ns = spacing_ns // 2
    _, rows = np.unique((stamps_ns - stamps_ns[0] + half_ns) // step_ns, return_index=True)
    momenta = problem.rotor_momentum(stamps_ns[rows])
    windows = list(zip(rows[:-1].tolist(), rows[1:].tolist(), momenta))
    windows = windows[thinned(len(windows), _WINDOWS)]
    angles = [_error(problem, sensor, (first, last), step_ns, momentum)
              for first, last, momentum in track(windows, len(windows))
              if abs(stamps_ns[last] - stamps_ns[first] - step_ns) <= 2 * half_ns]
    return Horizon(seconds, np.array(angles, float))


def _error(problem: Problem, sensor: Measured, window: tuple[int, int], step_ns: int,
           momentum: Floats) -> float:
    first, last = window
    until_ns = sensor.stamps_ns[first] + step_ns // 5
    count = int(np.searchsorted(sensor.stamps_ns, until_ns, 'right')) - first
    count = min(max(count, 2), _SAMPLES, last - first + 1)
    start = _restarted(problem, sensor.rows(np.arange(first, first + count)), momentum)
    end = sensor.rows(np.array([last]))
    motion = problem.between(start, int(end.stamps_ns[0])).propagate(at=end.stamps_ns)
    assert sensor.attitude is not None
    return float(so3.angle_between(motion.attitude[0], sensor.attitude[last]))


def _restarted(problem: Problem, samples: Measured, momentum: Floats) -> State:
    """Fit a motion to a few samples, and return the state of the motion at the first sample."""
    assert samples.attitude is not None
    first_ns, (_, rates) = int(samples.stamps_ns[0]), measured_rates(samples)
    start = State(first_ns, samples.attitude[0], np.median(rates, axis=0), momentum)
    if len(samples) < 3:
        return start
    seconds = 1e-9 * (samples.stamps_ns - first_ns)
    columns = np.stack([np.ones(len(seconds)), seconds], axis=1)
    for _ in range(_CORRECTIONS):
        motion = problem.between(start, int(samples.stamps_ns[-1])).propagate(
            at=samples.stamps_ns)
        vectors, rate_errors = errors_of(samples, motion)
        assert vectors is not None
        # Work in space axes, where the components of a constant attitude error do not change.
        vectors = so3.rotate(motion.attitude, vectors)
        offset, drift = _line(columns, vectors)
        turn = so3.conjugate(start.attitude)
        change = so3.rotate(turn, drift) if rate_errors is None else \
            _line(columns[:, :1], rate_errors)[0]
        attitude = so3.multiply(so3.exp(offset), start.attitude)
        start = State(first_ns, so3.normalize(attitude), start.angular_velocity + change, momentum)
        usual = float(np.median(np.linalg.norm(vectors, axis=1)))
        if np.linalg.norm(offset) + seconds[-1] * np.linalg.norm(change) \
                < max(_CORRECTED, _NEGLIGIBLE * usual):
            break
    return start


def _line(columns: Floats, values: Floats) -> Floats:
    """Fit a linear combination of columns to values, giving less weight to outliers."""
    weights = np.ones((len(values), 1))
    for _ in range(3):
        weighted = weights ** 2 * columns
        found = np.linalg.solve(weighted.T @ columns, weighted.T @ values)
        distances = np.linalg.norm(values - columns @ found, axis=1, keepdims=True)
        limit = max(2.0 * float(np.median(distances)), 1e-300)
        weights = np.minimum(limit / np.maximum(distances, limit), 1.0)
    return np.asarray(found)
