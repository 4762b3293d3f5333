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

"""
The motion to measure: the whole motion, a stretch that is quick to compute, and the reference.

The reference is the Taylor series at its tightest tolerance with shorter steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import so3
from rigid_body_ros.body import RigidBody
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, instant, LONGEST
from rigid_body_ros.propagation import propagate, Trajectory
from rigid_body_ros.propagation.sensitivity import last_digit_effect
from rigid_body_ros.state import State
from rigid_body_ros.torque import TorqueLog
from rigid_body_ros.tradeoff.axes import PrincipalAxes

TIGHTEST = 1e-15
#: Length of a motion without torque, in turns.
TURNS = 50.0
#: Typical angle of a step of the Taylor series, rad.
_SERIES_ANGLE = 0.5
#: Largest number of samples and series steps in a stretch; they take about a tenth of a second.
_WORK = 4000
#: Outputs in addition to the torque stamps, to catch errors between stamps that are far apart.
_OUTPUTS = 100


@dataclass(frozen=True, eq=False)
class Problem:
    """
    A motion and its output times.

    Attributes
    ----------
    body : RigidBody
    start : State
    log : TorqueLog
        Empty if there are no torques.
    times_ns : array of int64, shape (m,)
        Ascending.
    torque_timeout : float, s

    """

    body: RigidBody
    start: State
    log: TorqueLog
    times_ns: NDArray[np.int64]
    torque_timeout: float = 0.0

    @property
    def seconds(self) -> float:
        """Return the simulated time, s."""
        return (int(self.times_ns[-1]) - self.start.time_ns) * 1e-9

    @property
    def torque_free(self) -> bool:
        """Whether all torques are zero."""
        return not self.log.torques.any()

    def run(self, **options: Any) -> Trajectory:
        """Return the motion; raise ValueError as `propagate` does."""
        return propagate(self.body, self.start, self.log, at=self.times_ns,
                         torque_timeout=self.torque_timeout, **options)

    def in_principal_axes(self, max_step: float) -> Floats:
        """Return the attitudes computed by the series in principal axes, shape (m, 4)."""
        axes = PrincipalAxes(self.body)
        turned = replace(self, body=axes.body, start=axes.start(self.start),
                         log=axes.log(self.log))
        return axes.back(turned.run(solver='taylor', tolerance=TIGHTEST,
                                    max_step=max_step).attitude)

    def until(self, end_ns: int) -> Problem:
        """Return the problem up to an end time, with the samples needed up to it."""
        part = self.log.between(self.start.time_ns, end_ns)
        return replace(self, log=part, times_ns=_times(part, self.start.time_ns, end_ns))

    def stretch(self) -> Problem:
        """Return the motion, or its first half, quarter, ...: as long as is quick to compute."""
        start_ns, span_ns = self.start.time_ns, int(self.times_ns[-1]) - self.start.time_ns
        # Begin with the shortest, because the cost of the whole motion is not known in advance.
        shorter = self.until(start_ns + max(span_ns >> 30, 1))
        for halvings in range(29, -1, -1):
            longer = self.until(start_ns + max(span_ns >> halvings, 1))
            angle = turned_angle(longer.run(solver='taylor'))
            if angle / _SERIES_ANGLE + len(longer.times_ns) > _WORK:
                return shorter
            shorter = longer
        return self

    def natural_step(self, motion: Trajectory, angle: float) -> float:
        """Return the time, s, to turn by an angle at top speed; at most the sample spacing."""
        inside = self.log.times_ns[self.log.times_ns > self.start.time_ns]
        edges = np.union1d([self.start.time_ns, self.times_ns[-1]],
                           inside[inside < self.times_ns[-1]])
        speed = float(np.linalg.norm(motion.angular_velocity, axis=1).max())
        return min(angle / speed if speed else math.inf, float(np.diff(edges).max()) * 1e-9)


@dataclass(frozen=True, eq=False)
class Reference:
    """
    The reference motion and how accurate it is.

    Attributes
    ----------
    trajectory : Trajectory
    floor : float, rad
        Largest difference between this motion and others that round differently: the series with
        other steps and in principal axes, and, without torque, the closed form.
    last_digits : float, rad
        How far a change of the last digits of inertia, torques and start moves the motion; see
        `last_digit_effect`.

    """

    trajectory: Trajectory
    floor: float
    last_digits: float

    @property
    def guaranteed_error(self) -> float:
        """Return the smallest error that can be guaranteed, rad."""
        return max(self.floor, self.last_digits)

    @classmethod
    def of(cls, problem: Problem) -> Reference:
        """Return the reference of a problem."""
        plain = problem.run(solver='taylor', tolerance=TIGHTEST)
        step = problem.natural_step(plain, _SERIES_ANGLE)
        best, other = (problem.run(solver='taylor', tolerance=TIGHTEST, max_step=share * step)
                       for share in (0.7, 0.4))
        motions = [best.attitude, plain.attitude, other.attitude,
                   problem.in_principal_axes(0.55 * step)]
        if problem.torque_free:
            motions.append(problem.run(solver='exact').attitude)
        floor = max(float(so3.angle_between(*pair).max()) for pair in combinations(motions, 2))
        moved = last_digit_effect(problem.body, problem.start, problem.log, at=problem.times_ns,
                                  torque_timeout=problem.torque_timeout)
        return cls(best, max(floor, math.ulp(1.0)), moved)


def whole(body: RigidBody, start: State, log: TorqueLog | None, end_ns: int | None,
          torque_timeout: float) -> Problem:
    """
    Return the whole motion, up to `end_ns`; by default to the last stamp, or for `TURNS` turns.

    Raises
    ------
    ValueError
        The body does not rotate and has no torques, or the end is not after the start.

    """
    speed = float(np.linalg.norm(start.angular_velocity))
    if not speed and (log is None or not log.torques.any()):
        raise ValueError('expected a nonzero initial angular velocity or torque, found neither')
    log = TorqueLog([], []) if log is None else log
    if end_ns is not None:
        end_ns = instant(end_ns, 'end_ns')
        if end_ns <= start.time_ns:
            raise ValueError(f'end_ns: expected a time after the start, {start.time_ns} ns, '
                             f'found {end_ns} ns')
    elif len(log):
        end_ns = int(log.times_ns[-1])
        if end_ns <= start.time_ns:
            raise ValueError('expected the last torque after the start of the motion, '
                             f'{start.time_ns} ns, found it at {end_ns} ns')
    else:
        turns = min(TURNS * 2.0 * math.pi / speed, LONGEST)
        end_ns = start.time_ns + max(duration_ns(turns, 'end_ns'), 1)
    return Problem(body, start, log, _times(log, start.time_ns, end_ns), torque_timeout)


def _times(log: TorqueLog, start_ns: int, end_ns: int) -> NDArray[np.int64]:
    grid = start_ns + np.linspace(0, end_ns - start_ns, _OUTPUTS + 1).astype(np.int64)
    inside = (log.times_ns > start_ns) & (log.times_ns <= end_ns)
    return np.union1d(log.times_ns[inside], np.append(grid[1:], end_ns))


def turned_angle(motion: Trajectory) -> float:
    """Return the angle that the body turns through from the first to the last output, rad."""
    speed = np.linalg.norm(motion.angular_velocity, axis=1)
    return float(np.sum(np.maximum(speed[1:], speed[:-1]) * np.diff(motion.times_ns)) * 1e-9)
