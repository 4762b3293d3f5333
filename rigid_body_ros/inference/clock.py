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

"""Guess the clock offset without knowing the inertia."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.residual_torque import residual_torque
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured

#: Largest clock offset to try, and spacing of the offsets, both in seconds.
_LARGEST, _SPACING = 10.0, 0.02
#: Approximate number of samples used to evaluate each offset.
_ROWS = 500
#: Largest offset to try, as a fraction of the duration of the measurements.
_OVERLAP = 0.5
#: A clock offset is accepted only if the fraction of the torque that stays unexplained at this
#: offset is less than `_BETTER` times the fraction that stays unexplained at zero offset.
_BETTER = 0.8


def likely_offset(problem: Problem, sensors: Sequence[Measured]) -> float:
    """
    Return the clock offset for which the logged torques best explain the measured motion.

    The torque required for a given motion is a linear function of the entries of the inertia. For
    each trial offset, linear least squares therefore finds the best inertia, and no guess of the
    inertia is needed.

    Parameters
    ----------
    problem : Problem
        The model. Its inertia is not used.
    sensors : sequence of Measured
        The measurements. Only one sensor is used: the gyro with the most samples or, if there is
        no gyro, the sensor with the most samples.

    Returns
    -------
    float, s
        The offset to add to the stamps of the measurements. It is 0 unless some other offset
        explains the torques much better.

    """
    sensor = max(sensors, key=lambda one: (one.angular_velocity is not None, len(one)))
    residual = residual_torque(problem, sensor)
    if residual is None or not residual.logged.any():
        return 0.0
    seconds = 1e-9 * (residual.times_ns - residual.times_ns[0])
    rows = slice(None, None, -(-len(seconds) // _ROWS))
    largest = min(_LARGEST, _OVERLAP * seconds[-1])
    offsets = _SPACING * np.arange(-int(largest / _SPACING), int(largest / _SPACING) + 1)
    left = np.array([_unexplained(seconds[rows] + offset, residual.of_inertia[rows], seconds,
                                  residual.logged) for offset in offsets])
    best = int(np.argmin(left))
    return float(offsets[best]) if left[best] < _BETTER * left[len(left) // 2] else 0.0


def _unexplained(times: Floats, of_inertia: Floats, seconds: Floats, logged: Floats) -> float:
    """Return the fraction of the torque at the given times (s) that no inertia can explain."""
    inside = (times >= 0.0) & (times <= seconds[-1])
    torques = np.stack([np.interp(times[inside], seconds, column) for column in logged.T], axis=1)
    matrix, wanted = of_inertia[inside].reshape(-1, 6), torques.ravel()
    total = float(wanted @ wanted)
    if not total:
        return 1.0
    errors = wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    return float(errors @ errors) / total
