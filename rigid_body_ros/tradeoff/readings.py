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

"""What a log leaves open between its samples, whatever solver reads it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import so3
from rigid_body_ros.propagation import Trajectory
from rigid_body_ros.torque import INTERPOLATIONS, TorqueLog
from rigid_body_ros.tradeoff.problem import Problem

#: Order of convergence of each reading of a log in the spacing of its samples.
READING_ORDERS = {'hold': 1, 'linear': 2, 'cubic': 4}


class Reading(NamedTuple):
    """How a log is read between its samples, and what that leaves open, rad at most."""

    interpolation: str
    #: What leaving out every other sample changes.
    thinned: float
    #: What that says of the log as it is, from how fast it converges.
    estimate: float


def compare_readings(problem: Problem) -> tuple[Reading, ...]:
    """Return what each reading of the log leaves open, by leaving samples out of it."""
    log = problem.log
    if len(log) < 3 or np.unique(log.in_space).size > 1 or problem.torque_free:
        return ()
    readings = []
    for name in INTERPOLATIONS:
        try:
            half, quarter = (_thinned(problem, name, every) for every in (2, 4))
        except ValueError:  # this reading alone spins the body beyond all bounds
            continue
        # How fast it converges is what is seen, not the order for smooth torques: pulses have 1.
        highest = 2.0 ** READING_ORDERS[name]
        ratio = min(max(quarter / half - 1.0, 2.0), highest) if half else highest
        readings.append(Reading(name, half, half / (ratio - 1.0)))
    return tuple(readings)


def _thinned(problem: Problem, interpolation: str, every: int) -> float:
    """Return what it changes, rad at most, to take one of so many samples only."""
    rows = np.arange(len(problem.log))
    full = _read(problem, interpolation, rows)
    # From each beginning: a pulse that lasts an even number of samples may not miss one of them.
    thin = [_read(problem, interpolation, np.union1d(rows[first::every], rows[[0, -1]]))
            for first in range(every)]
    return max(float(so3.angle_between(full.attitude, motion.attitude).max()) for motion in thin)


def _read(problem: Problem, interpolation: str, rows: NDArray[np.intp]) -> Trajectory:
    log = problem.log
    part = TorqueLog(log.times_ns[rows], log.torques[rows], log.in_space[rows], interpolation)
    return replace(problem, log=part).run(solver='taylor')
