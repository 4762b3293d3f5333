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

"""Estimate the error that results from interpolating between the samples of a torque log."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.torque import INTERPOLATIONS, TorqueLog
from rigid_body_ros.propagation import Trajectory
from rigid_body_ros.tradeoff.problem import Case

#: Order in which the error of each interpolation converges with the sample spacing, for smooth
#: torques.
_ORDERS = {'hold': 1, 'linear': 2, 'cubic': 4}
#: An interpolation is clearly better than another if its error is less than this fraction of the
#: other's error.
CLEARLY = 0.25


class InterpolationError(NamedTuple):
    """Estimated attitude error, rad, that one interpolation of a torque log causes."""

    interpolation: str
    #: Largest change in the attitude if only every second sample is kept.
    thinned: float
    #: Error with all samples of the log, extrapolated from logs with fewer samples.
    estimate: float


def interpolation_errors(case: Case) -> tuple[InterpolationError, ...]:
    """Estimate the error of each interpolation by leaving out some of the samples."""
    if not _can_interpolate(case) or len(case.problem.logs[0]) < 3:
        return ()
    changes = {}
    for name in INTERPOLATIONS:
        with suppress(ValueError):  # the body spins too fast with this interpolation
            changes[name] = _change(case, name, 2), _change(case, name, 4)
    coarsest, _ = changes.get('hold', (0.0, 0.0))
    return tuple(InterpolationError(name, half, _extrapolated(name, half, quarter, coarsest))
                 for name, (half, quarter) in changes.items())


def final_differences(case: Case) -> dict[str, float | None]:
    """
    Return how much the final attitude changes with interpolations other than the scene's.

    Returns
    -------
    dict
        The angle, rad, for each of the other interpolations, keyed by name. The angle is None if
        the body spins so fast with that interpolation that the motion cannot be computed.

    """
    if not _can_interpolate(case):
        return {}
    last, rows = replace(case, times_ns=case.times_ns[-1:]), np.arange(len(case.problem.logs[0]))
    end = _motion(last, case.interpolation, rows).attitude[0]
    differences: dict[str, float | None] = {
        name: None for name in INTERPOLATIONS if name != case.interpolation}
    for name in differences:
        with suppress(ValueError):  # the body spins too fast with this interpolation
            other = _motion(last, name, rows).attitude[0]
            differences[name] = float(so3.angle_between(other, end))
    return differences


def _can_interpolate(case: Case) -> bool:
    """Return whether all torques are in one log and one frame, and there are no actuators."""
    logs = case.problem.logs
    if case.problem.actuators:  # commands to actuators are always held
        return False
    return not case.torque_free and len(logs) == len(case.problem.sources) == 1 \
        and np.unique(logs[0].in_space).size == 1


def _change(case: Case, interpolation: str, spacing: int) -> float:
    """Return the largest change of attitude, rad, if only every `spacing`-th sample is kept."""
    rows = np.arange(len(case.problem.logs[0]))
    full = _motion(case, interpolation, rows)
    # Start the thinned log at each of the first `spacing` samples in turn. With just one of these
    # choices, a pulse that lasts an even number of samples might not change at all.
    thinned = [_motion(case, interpolation, np.union1d(rows[first::spacing], rows[[0, -1]]))
               for first in range(spacing)]
    return max(float(so3.angle_between(full.attitude, motion.attitude).max())
               for motion in thinned)


def _extrapolated(interpolation: str, half: float, quarter: float, hold: float) -> float:
    """
    Return the extrapolated error, rad, of an interpolation of all samples.

    The error is extrapolated from the changes with one half and one quarter of the samples.

    Halving the sample spacing reduces the error by a factor of 2^order. If a higher-order
    interpolation is not clearly better than hold, the torque is not smooth at this spacing, and
    the order is assumed to be 1.
    """
    order = _ORDERS[interpolation] if half < CLEARLY * hold else 1
    observed = quarter / half - 1.0 if half else 2.0
    return half / (min(max(observed, 2.0), 2.0 ** order) - 1.0)


def _motion(case: Case, interpolation: str, rows: NDArray[np.intp]) -> Trajectory:
    log, = case.problem.logs
    part = TorqueLog(log.times_ns[rows], log.torques[rows], log.in_space[rows], interpolation)
    return replace(case, problem=case.problem.replaced(log=part)).run(solver='taylor')
