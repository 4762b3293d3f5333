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
The motion on which solvers are measured, its reference, and a stretch that is quick to compute.

The reference is the Taylor series at its tightest tolerance, with shorter steps. The error that
results from interpolating between the samples of a torque log is estimated as well.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, instant, LONGEST
from rigid_body_ros.engine import body_layout, kernels, state_layout, tensor
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import INTERPOLATIONS, stamps_of, TorqueLog
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.propagation.sensitivity import last_digit_effect

TIGHTEST = 1e-15
#: Default length of a torque-free motion, in turns.
TURNS = 50.0
#: Angle through which the body typically turns in one step of the Taylor series, rad.
_SERIES_ANGLE = 0.5
#: Maximum number of output times plus series steps in a stretch. Computing such a stretch takes a
#: few milliseconds.
_WORK = 20_000
#: Number of output times in addition to the torque stamps. The additional times reveal errors
#: between stamps that are far apart.
_OUTPUTS = 100
#: A coefficient of Euler's equations that is too small to affect the motion. Because this
#: coefficient is not zero, the kernels use the arithmetic for full tensors, so the rounding errors
#: differ even if the given tensor is diagonal.
_NEGLIGIBLE = 1e-200
#: Order in which the error of each interpolation converges with the sample spacing, for smooth
#: torques.
_ORDERS = {'hold': 1, 'linear': 2, 'cubic': 4}
#: An interpolation is clearly better than another if its error is less than this fraction of the
#: other's error.
CLEARLY = 0.25


@dataclass(frozen=True, eq=False)
class Case:
    """
    A motion on which settings are measured.

    Attributes
    ----------
    problem : Problem
        The problem. Each run replaces its solver.
    times_ns : array of int64, shape (m,)
        Ascending output times.

    """

    problem: Problem
    times_ns: NDArray[np.int64]

    @property
    def seconds(self) -> float:
        """Return the simulated time, s."""
        return (int(self.times_ns[-1]) - self.problem.start.time_ns) * 1e-9

    @property
    def torque_free(self) -> bool:
        """Return whether all logged torques are zero, including torques on the rotors."""
        return not self.problem.has_torque

    @property
    def has_linear_terms(self) -> bool:
        """Return whether rotors or damping add terms linear in the angular velocity."""
        return self.problem.body.is_damped or self.problem.has_rotors

    @property
    def has_terms(self) -> bool:
        """Return whether there are rotors, damping or fields."""
        return self.has_linear_terms or bool(self.problem.fields)

    @property
    def conserves(self) -> bool:
        """Return whether the momentum and the energy of the body are constant."""
        return self.torque_free and not self.has_terms

    @property
    def samples(self) -> int:
        """Return the number of torque samples."""
        return sum(map(len, self.problem.sources))

    @property
    def interpolation(self) -> str:
        """Return the interpolation of the torques, or 'hold' if there are no torques."""
        return self.problem.logs[0].interpolation if self.problem.logs else 'hold'

    @property
    def can_interpolate(self) -> bool:
        """
        Return whether all torques are in one log and one frame, and there are no actuators.

        Commands to actuators are always held.
        """
        logs = self.problem.logs
        return not self.problem.actuators and not self.torque_free \
            and len(logs) == len(self.problem.sources) == 1 \
            and np.unique(logs[0].in_space).size == 1

    def run(self, **options: Any) -> Trajectory:
        """Compute the motion with the given `Options`, raising ValueError as `propagate` does."""
        return self.problem.solved_by(**options).propagate(at=self.times_ns)

    def in_principal_axes(self, max_step: float) -> Floats:
        """
        Compute the attitudes, shape (m, 4), with the Taylor series in principal axes.

        The rounding errors there differ, because no terms of J^-1 tau cancel. The principal
        moments and axes have about 32 digits. Torques and rates are rounded only once, after they
        have been rotated. The motion must have no rotors, damping or fields, so `has_terms` must
        be false.
        """
        problem, (moments, axes) = self.problem, self.problem.body._principal
        rates = _components(axes, problem.start.angular_velocity[None])[0]
        rotation = so3.from_matrix(axes[0])
        start = State._as_computed(problem.start.time_ns, state_layout.pack(
            rates[:, 0], so3.multiply(problem.start.attitude, rotation), rates[:, 1]))
        # Torques in space axes do not change.
        logs = [log.with_torques(np.where(log.in_space[:, None], log.torques,
                                          _components(axes, log.torques)[..., 0]))
                for log in problem.acting_logs]
        # Actuator limits apply along the body axes, so `acting_logs` applies them before the
        # conversion. Actuator lags are the same in all axes.
        lags = [actuator and actuator.lag for actuator in problem.actuators]
        problem = problem.replaced(body=_principal_body(moments), start=start, log=logs,
                                   actuator=lags or None)
        motion = replace(self, problem=problem).run(solver='taylor', tolerance=TIGHTEST,
                                                    max_step=max_step)
        return so3.multiply(motion.attitude, so3.conjugate(rotation))

    def until(self, end_ns: int) -> Case:
        """Return the motion up to an end time, without samples that the motion does not need."""
        problem = self.problem.between(self.problem.start, end_ns)
        return Case(problem, _times(problem, end_ns))

    def stretch(self) -> Case:
        """
        Return the longest part of the motion that is quick to compute.

        This is the whole motion, its first half, its first quarter, or an even shorter part.
        """
        start_ns = self.problem.start.time_ns
        span_ns = int(self.times_ns[-1]) - start_ns
        # Begin with the shortest stretch, because the cost of the whole motion is still unknown.
        shorter = self.until(start_ns + max(span_ns >> 30, 1))
        for halvings in range(29, -1, -1):
            longer = self.until(start_ns + max(span_ns >> halvings, 1))
            angle = turned_angle(longer.run(solver='taylor'))
            if angle / _SERIES_ANGLE + len(longer.times_ns) > _WORK:
                return shorter
            shorter = longer
        return self

    def natural_step(self, motion: Trajectory, angle: float) -> float:
        """
        Return the time, s, that the body takes to turn by `angle` at its top speed.

        The result is never longer than the longest gap between torque stamps.
        """
        first_ns, last_ns = self.problem.start.time_ns, int(self.times_ns[-1])
        stamps = stamps_of(self.problem.sources)
        edges = np.union1d([first_ns, last_ns],
                           stamps[(stamps > first_ns) & (stamps < last_ns)])
        speed = float(np.linalg.norm(motion.angular_velocity, axis=1).max())
        return min(angle / speed if speed else math.inf, float(np.diff(edges).max()) * 1e-9)


@dataclass(frozen=True, eq=False)
class Reference:
    """
    The reference motion and its accuracy.

    Attributes
    ----------
    trajectory : Trajectory
    floor : float, rad
        Largest difference between solutions that differ only in their rounding errors. These
        solutions come from the series with several step lengths and, if there are no rotors,
        damping or fields, from the series in principal axes. If there is also no torque, the
        closed form is included as well.
    last_digits : float, rad
        Largest change of the attitude if the last digits of inertia, torques and start change, as
        computed by `last_digit_effect`.

    """

    trajectory: Trajectory
    floor: float
    last_digits: float

    @property
    def guaranteed_error(self) -> float:
        """Return the smallest error that can be guaranteed, rad."""
        return max(self.floor, self.last_digits)

    @classmethod
    def of(cls, case: Case) -> Reference:
        """Compute the reference for a motion."""
        plain = case.run(solver='taylor', tolerance=TIGHTEST)
        step = case.natural_step(plain, _SERIES_ANGLE)
        best, other = (case.run(solver='taylor', tolerance=TIGHTEST, max_step=share * step)
                       for share in (0.7, 0.4))
        motions = [best.attitude, plain.attitude, other.attitude]
        if not case.has_terms:
            motions.append(case.in_principal_axes(0.55 * step))
        if case.conserves:
            motions.append(case.run(solver='exact').attitude)
        floor = max(float(so3.angle_between(*pair).max()) for pair in combinations(motions, 2))
        return cls(best, max(floor, math.ulp(1.0)), last_digit_effect(case.problem, case.times_ns))


def _principal_body(moments: Floats) -> RigidBody:
    """
    Return a body in its principal axes; its motion can be computed only with the Taylor series.

    `moments` contains the high and the low parts of the principal moments, kg m^2, shape (2, 3).
    """
    exact = np.vectorize(Fraction, otypes=[object])
    coefficients = tensor.euler_coefficients(np.diag(exact(moments[0]) + exact(moments[1])))
    coefficients[0, 0, 1] = _NEGLIGIBLE
    body = RigidBody(np.diag(moments[0]))
    body._constants = body_layout.pack(
        coefficients, moments, np.stack([np.eye(3), np.zeros((3, 3))]), np.zeros((2, 3, 3)))
    return body


def _components(axes: Floats, vectors: Floats) -> Floats:
    """Return the high and low parts of vectors along axes that have high and low parts, too."""
    result = np.empty((len(vectors), 3, 2))
    high, low = np.ascontiguousarray(axes)
    kernels.fill_components(high, low, vectors, result)
    return result


def whole(problem: Problem, end_ns: int | None) -> Case:
    """
    Return the whole motion up to `end_ns`.

    By default, the motion ends at the last torque stamp or, if there are no torques, after `TURNS`
    turns.

    Raises
    ------
    ValueError
        The body does not rotate and there is neither torque nor field, or the end is not after the
        start.

    """
    start_ns = problem.start.time_ns
    speed = float(np.linalg.norm(problem.start.angular_velocity))
    stamps = stamps_of(problem.sources)
    least, _, largest = problem.body.principal_moments
    fastest = speed + sum(float(field.speed(least, largest)) for field in problem.fields)
    if not fastest and not problem.has_torque:
        raise ValueError('expected a nonzero initial angular velocity or torque, found neither')
    if end_ns is not None:
        end_ns = instant(end_ns, 'end_ns')
        if end_ns <= start_ns:
            raise ValueError(f'end_ns: expected a time after the start, {start_ns} ns, '
                             f'found {end_ns} ns')
    elif stamps.size:
        end_ns = int(stamps[-1])
        if end_ns <= start_ns:
            raise ValueError('expected the last torque after the start of the motion, '
                             f'{start_ns} ns, found it at {end_ns} ns')
    else:
        turns = min(TURNS * 2.0 * math.pi / (speed or fastest), LONGEST)
        end_ns = start_ns + max(duration_ns(turns, 'end_ns'), 1)
    return Case(problem, _times(problem, end_ns))


def _times(problem: Problem, end_ns: int) -> NDArray[np.int64]:
    start_ns = problem.start.time_ns
    grid = start_ns + np.linspace(0, end_ns - start_ns, _OUTPUTS + 1).astype(np.int64)
    stamps = stamps_of(problem.sources)
    inside = (stamps > start_ns) & (stamps <= end_ns)
    return np.union1d(stamps[inside], np.append(grid[1:], end_ns))


def turned_angle(motion: Trajectory) -> float:
    """Return the angle, rad, through which the body turns from the first to the last output."""
    speed = np.linalg.norm(motion.angular_velocity, axis=1)
    return float(np.sum(np.maximum(speed[1:], speed[:-1]) * np.diff(motion.times_ns)) * 1e-9)


class InterpolationError(NamedTuple):
    """Estimated attitude error, rad, that one interpolation of a torque log causes."""

    interpolation: str
    #: Largest change in the attitude if only every second sample is kept.
    thinned: float
    #: Error with all samples of the log, extrapolated from logs with fewer samples.
    estimate: float


def interpolation_errors(case: Case) -> tuple[InterpolationError, ...]:
    """Estimate the error of each interpolation by leaving out some of the samples."""
    if not case.can_interpolate or len(case.problem.logs[0]) < 3:
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
    if not case.can_interpolate:
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
