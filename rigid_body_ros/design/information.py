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

"""The intervals that a fit to a flight will have, from the derivatives of the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import entries, Floats
from rigid_body_ros.inference.coordinates import checked_priors, Prior
from rigid_body_ros.inference.evidence import certainty, Direction
from rigid_body_ros.inference.fit import LeastSquares, Weight
from rigid_body_ros.inference.noise import NORMAL_95
from rigid_body_ros.inference.setup import Setup, setup_of
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.scene.quantities import ATTITUDE, RATE, START

#: The criteria by which maneuvers can be compared.
MINMAX, DETERMINANT, TRACE = CRITERIA = 'minmax', 'D', 'A'
#: What a component that a flight does not determine adds to the cost. It outweighs any interval.
_UNKNOWN = 10.0
#: Eigenvalues of a covariance below this fraction of the largest are rounding errors.
_ROUNDING = 1e-13


class Instrument(NamedTuple):
    """A sensor: its topic, its quantity, its noise (rad or rad/s) and its sample rate, Hz."""

    topic: str
    is_attitude: bool
    noise: float
    hz: float = 100.0


@dataclass(frozen=True, eq=False)
class Question:
    """
    What an identification asks of a flight.

    Attributes
    ----------
    names : sequence of str
        The parameters to estimate, as for `identify`, except that the start of the flight is
        always estimated.
    sensors : sequence of Instrument
    priors : dict of str to float or str
        What is known before the flight, as for `identify`.
    criterion : str
        What should be small: the widest interval (minmax), the volume of all intervals (D), or the
        sum of their squares (A), each relative to the scale of its component.

    """

    names: Sequence[str]
    sensors: Sequence[Instrument]
    priors: Mapping[str, float | str]
    criterion: str = MINMAX

    def expected(self, flown: Problem, seconds: float, most_hz: float = np.inf) -> Expected:
        """
        Return the intervals that a fit to a flight of some seconds will have.

        To save time, sensors faster than `most_hz` are replaced by slower ones with less noise.
        """
        channels, weights = [], []
        for topic, is_attitude, noise, hz in self.sensors:
            taken = min(hz, most_hz)
            stamps_ns = flown.start.time_ns + np.round(
                np.arange(1, seconds * taken + 0.5) * (1e9 / taken)).astype(np.int64)
            motion = flown.propagate(at=stamps_ns)
            channels.append(Measured(topic, stamps_ns, *(
                (motion.attitude, None) if is_attitude else (None, motion.angular_velocity))))
            weights.append(Weight(noise * np.sqrt(taken / hz), np.ones(len(stamps_ns)),
                                  np.ones(3)))
        return self._of(setup_of([flown], [channels], (*self.names, START)), weights)

    def _of(self, setup: Setup, weights: list[Weight]) -> Expected:
        given, start = setup.given, setup.problems[0].start
        fit = LeastSquares(setup, setup.windows(setup.span_ns, given), Poses(
            start.attitude[None], start.angular_velocity[None]), [weights])
        if self.priors:
            fit.parameters = setup.parameters.with_priors(
                checked_priors(self.priors, setup.parameters))
        names, scales, values = fit.parameters.names, fit.parameters.scales, \
            fit.parameters.values(given)
        moments = fit.parameters.columns(['inertia', 'inertia_diagonal'])
        values[moments] += entries(setup.axial_tensor)[:len(moments)]
        starts = [name for kind in ([ATTITUDE] * setup.fits_attitude[0] + [RATE])
                  for name in kind.components]
        covariance, is_known, unknown = certainty(
            fit.information(given), [*names, *starts],
            np.append(values / scales, np.zeros(len(starts))))
        covariance = covariance[:len(names), :len(names)] * np.outer(scales, scales)
        scales = scales.copy()
        scales[moments] = np.mean(values[moments[:3]])
        return Expected(names, values, scales, covariance, is_known[:len(names)], unknown,
                        fit.parameters.priors)


class Expected(NamedTuple):
    """
    Expected intervals.

    Attributes
    ----------
    names : list of str
        The n components of the parameters.
    values, scales : array, shape (n,)
        The value and the scale of each component. The scale of an inertia is the mean moment.
    covariance : array, shape (n, n)
        The covariance, without the combinations that the flight does not determine.
    is_known : array of bool, shape (n,)
        Whether the flight determines each component.
    unknown : list of Direction
        The combinations that the flight does not determine.
    priors : dict of str to Prior
        What is known before the flight, by component.

    """

    names: list[str]
    values: Floats
    scales: Floats
    covariance: Floats
    is_known: NDArray[np.bool_]
    unknown: list[Direction]
    priors: Mapping[str, Prior]

    @property
    def half_widths(self) -> Floats:
        """Return the half-widths of the 95 % intervals; infinite if a component is not known."""
        return np.where(self.is_known, NORMAL_95 * np.sqrt(np.diag(self.covariance)), np.inf)

    @property
    def unknown_names(self) -> list[str]:
        """Return the names of the components that the flight does not determine."""
        return [name for name, is_known in zip(self.names, self.is_known) if not is_known]

    @property
    def widest(self) -> float:
        """Return the largest half-width relative to its scale."""
        return float((self.half_widths / self.scales).max())

    def cost(self, criterion: str) -> float:
        """Return the logarithm of what should be small; see `Question`."""
        relative = self.covariance / np.outer(self.scales, self.scales)
        variances, sizes = np.diag(relative), np.linalg.eigvalsh(relative)
        size = {MINMAX: variances.max(), TRACE: variances.sum(), DETERMINANT: np.exp(
            np.mean(np.log(sizes[sizes > _ROUNDING * sizes.max()])))}[criterion]
        return 0.5 * float(np.log(size)) + _UNKNOWN * int(np.sum(~self.is_known))
