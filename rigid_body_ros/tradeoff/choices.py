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

"""Compare measured settings, and choose the cheapest one that is accurate enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

from rigid_body_ros.mechanics import so3
from rigid_body_ros.tradeoff.problem import Case, Reference, TIGHTEST

#: Time needed to compute a reference, divided by the time of one run of the Taylor series.
_REFERENCE_COST = 14.0


class Setting(NamedTuple):
    """A solver, together with its tolerance or step."""

    solver: str
    tolerance: float | None = None
    #: Length of a step, s.
    max_step: float | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Return the setting as keyword arguments of `propagate`."""
        return {name: value for name, value in self._asdict().items() if value is not None}

    @property
    def size(self) -> str:
        """Return the tolerance or the step as text, or '-' if there is neither."""
        return f'step {self.max_step:.6g} s' if self.max_step else \
            f'tolerance {self.tolerance:.0e}' if self.tolerance else '-'

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the lines of a scene file that select this setting."""
        if self.max_step is not None:
            return f'solver: {self.solver}', f'max_step: {self.max_step!r}'
        return (f'solver: {self.solver}', f'tolerance: {self.tolerance or TIGHTEST!r}',
                'max_step: 0.0')


class Error(NamedTuple):
    """
    The errors of a motion, as deviations from the reference motion.

    These are the largest errors over all times, and the error of the final attitude.
    """

    #: Final and largest attitude error, rad.
    attitude_final: float
    attitude: float
    #: Largest angular velocity error, rad/s.
    angular_velocity: float
    #: Largest errors of the momentum and of the energy, divided by their largest values in the
    #: reference. If the body is free, the errors are the changes of momentum and energy since the
    #: start.
    momentum: float
    energy: float


_NO_ERROR = Error(*5 * [math.nan])


@dataclass(frozen=True)
class Measurement:
    """
    The measured error and cost of a setting.

    Attributes
    ----------
    setting : Setting
    error : Error
        NaN if the run failed.
    seconds : float
        Wall time of the fastest of several runs. The fastest run counts because other programs may
        slow down the others. NaN if the run failed.
    first_seconds : float
        Wall time of the first run, with the kernels already loaded.
    failure : str
        Why the run failed. Empty if it succeeded.
    pareto_optimal : bool
        Whether no other setting is both faster and more accurate.

    """

    setting: Setting
    error: Error = _NO_ERROR
    seconds: float = math.nan
    first_seconds: float = math.nan
    failure: str = ''
    pareto_optimal: bool = False

    def as_dict(self, span: float) -> dict[str, Any]:
        """Return the measurement of a motion of `span` seconds as JSON types."""
        error = self.error
        figures = {'attitude_error_final_rad': error.attitude_final,
                   'attitude_error_largest_rad': error.attitude,
                   'angular_velocity_error_largest_rad_per_s': error.angular_velocity,
                   'momentum_drift_relative': error.momentum,
                   'energy_drift_relative': error.energy,
                   'first_call_s': self.first_seconds, 'warm_call_s': self.seconds,
                   'cost_s_per_simulated_s': self.seconds / span,
                   'times_real_time': span / self.seconds}
        return {'solver': self.setting.solver, 'tolerance': self.setting.tolerance,
                'max_step_s': self.setting.max_step,
                **(dict.fromkeys(figures) if self.failure else figures),  # NaN is not valid JSON
                'on_pareto_front': self.pareto_optimal, 'failure': self.failure or None}


class Choice(NamedTuple):
    """The cheapest setting that meets a target."""

    measurement: Measurement
    #: Expected attitude error over the whole log, rad.
    error: float
    #: Whether `error` was measured on the whole log. Otherwise, `error` was scaled up from the
    #: error on the stretch.
    measured: bool


class OnWhole:
    """
    The errors of settings on the whole log, measured until the available time is used up.

    Parameters
    ----------
    whole, stretch : Case
    reference : Reference
        The reference of the stretch.
    measurements : sequence of Measurement
        The measurements on the stretch.
    seconds : float
        Wall time available for measurements on the whole log.

    Attributes
    ----------
    reference : Reference or None
        The reference for the whole log. If the stretch is shorter than the whole motion, this is
        None until the first error is measured.

    """

    def __init__(self, whole: Case, stretch: Case, reference: Reference,
                 measurements: Sequence[Measurement], seconds: float) -> None:
        self.reference = reference if stretch is whole else None
        self._whole, self._remaining = whole, seconds
        self._growth = whole.seconds / stretch.seconds
        self._series = min((run.seconds for run in measurements
                            if run.setting == Setting('taylor', TIGHTEST)), default=math.inf)
        #: The errors on the whole log that are known so far, rad.
        self._errors = {run: run.error.attitude + reference.guaranteed_error
                        for run in measurements if not run.failure} if stretch is whole else {}

    def __call__(self, measurement: Measurement) -> float | None:
        """
        Return the largest attitude error of a setting on the whole log, rad.

        Return None if computing the error would take too long.
        """
        if measurement not in self._errors:
            runs = 0.0 if self.reference else _REFERENCE_COST
            cost = self._growth * (measurement.seconds + runs * self._series)
            if cost > self._remaining:
                return None
            self._remaining -= cost
            self._errors[measurement] = self._measured(measurement)
        return self._errors[measurement]

    @property
    def least(self) -> float | None:
        """
        Return the smallest error measured on the whole log, rad.

        Return None if no error has been measured on the whole log.
        """
        return min(self._errors.values(), default=None)

    def _measured(self, measurement: Measurement) -> float:
        self.reference = self.reference or Reference.of(self._whole)
        try:
            motion = self._whole.run(**measurement.setting.options)
        except ValueError:
            return math.inf
        error = so3.angle_between(motion.attitude, self.reference.trajectory.attitude)
        return float(error.max()) + self.reference.guaranteed_error


def recommend(measurements: Sequence[Measurement], target: float, floor: float, growth: float,
              error_on_whole: Callable[[Measurement], float | None]) -> Choice | None:
    """
    Return the cheapest setting that meets a target on the whole log, or None if there is none.

    Parameters
    ----------
    measurements : sequence of Measurement
        Measurements on the stretch. A setting that misses the target on the stretch also misses it
        on the whole log.
    target, floor : float, rad
        The target, and a floor that is added to the error of every setting. The floor is
        `Reference.guaranteed_error`, the larger of the rounding floor and the effect of the last
        digits.
    growth : float
        Length of the whole log divided by the length of the stretch.
    error_on_whole : callable
        A function that returns the attitude error of a setting on the whole log, rad, or None if
        computing the error would take too long. In that case, the error on the stretch is assumed
        to grow with the square of the time. This assumption holds if the rate error grows
        linearly, for example because of the energy error of RK4. Errors grow faster only near a
        separatrix, where rounding errors grow exponentially.

    """
    # The error of a failed run is NaN, so a failed run never meets the target.
    fitting = [run for run in measurements if run.error.attitude + floor <= target]
    for run in sorted(fitting, key=lambda run: run.seconds):
        measured = error_on_whole(run)
        error = (run.error.attitude + floor) * growth ** 2 if measured is None else measured
        if error <= target:
            return Choice(run, error, measured is not None)
    return None
