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

"""The result of a fit: the errors that are left, their noise, and the weights that follow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.fit import LeastSquares, Weights
from rigid_body_ros.inference.noise import NORMAL
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.recording.measured import Measured

#: A sample is an outlier if its error exceeds this many standard deviations.
_OUTLIER = 5.0
#: If fewer samples than this fraction are within that limit, the limit says nothing, because
#: nearly all samples cannot be outliers.
_RARE = 0.1
#: Smallest standard deviation that the search for outliers assumes, rad or rad/s. Rounding errors
#: are smaller than this and therefore never count as outliers.
_NO_OUTLIER = 1e-8
#: Scale of the Cauchy loss, in standard deviations.
_CAUCHY = 2.4
#: Standard deviations below this number come from rounding errors. The unit is rad for attitudes;
#: standard deviations of angular velocities are relative to the rate.
ROUNDING = 1e-11


@dataclass(frozen=True, eq=False)
class Solution:
    """
    The result of a fit with windows of a given length.

    Attributes
    ----------
    length_ns : int
    problem : LeastSquares
        The problem that was solved. Its reference states are those of the solution.
    physics : Physics
        The fitted parameters.
    errors : list of list of array, shape (n, 3)
        Predicted minus measured values of each channel of each recording, rad or rad/s.
    weights : Weights
        The weights for the next fit, computed from these errors.
    inliers : list of list of array of bool, shape (n,)
        Which samples of each channel of each recording are not outliers.
    evaluations : int
        Number of function evaluations in this fit and all fits before it.
    converged : bool

    """

    length_ns: int
    problem: LeastSquares
    physics: Physics
    errors: list[list[Floats]]
    weights: Weights
    inliers: list[list[NDArray[np.bool_]]]
    evaluations: int
    converged: bool

    def with_spreads(self, spreads: list[list[Floats]]) -> Solution:
        """Return the solution with other `Weights.spreads`."""
        weights = replace(self.weights, spreads=spreads)
        return replace(self, weights=weights, problem=self.problem.weighted(weights))

    @property
    def count(self) -> int:
        """Return the number of errors, without those of outliers."""
        return sum(3 * int(np.sum(kept & np.isfinite(errors[:, 0])))
                   for inliers, every in zip(self.inliers, self.errors)
                   for kept, errors in zip(inliers, every))


def solution_of(problem: LeastSquares, physics: Physics, length_ns: int, evaluations: int,
                converged: bool = False, is_last: bool = False) -> Solution:
    """
    Return the solution of a problem whose reference states and parameters are fitted.

    If `is_last` is true, outliers have no weight. Otherwise, large errors have less weight.
    """
    setup, errors = problem.setup, problem.residuals(physics)
    total = sum(int(np.isfinite(error).sum()) for every in errors for error in every)
    share = float(np.sqrt(total / max(total - problem.size, 1)))
    found = [[_weighed(*pair, setup, share, is_last) for pair in zip(*each)]
             for each in zip(errors, setup.channels)]
    sigma = [[one for one, _, _ in every] for every in found]
    roots = [[one for _, one, _ in every] for every in found]
    inliers = [[one for _, _, one in every] for every in found]
    weights = Weights(sigma, roots, problem.weights.spreads)
    return Solution(length_ns, problem, physics, errors, weights, inliers, evaluations, converged)


def _weighed(error: Floats, channel: Measured, setup: Setup, share: float, is_last: bool
             ) -> tuple[float, Floats, NDArray[np.bool_]]:
    """
    Return the noise of a channel, the root of the weight of each sample, and the inliers.

    The errors of samples outside windows are NaN. These samples count as inliers.
    """
    floor = ROUNDING * (1.0 if channel.is_attitude else max(1.0, setup.rate))
    given = setup.attitude_noise if channel.is_attitude else setup.rate_noise
    level, used = max(NORMAL * median_size(error) * share, floor), np.isfinite(error[:, 0])
    distances = np.nan_to_num(
        np.linalg.norm(error, axis=1) / max(level, given or 0.0, _NO_OUTLIER))
    inliers = distances <= _OUTLIER
    if used.any() and np.mean(inliers[used]) < _RARE:
        inliers = np.ones(len(inliers), bool)
    if not is_last:
        return given or level, 1.0 / np.sqrt(1.0 + distances ** 2 / (3.0 * _CAUCHY ** 2)), inliers
    kept = error[inliers & used]
    level = max(float(np.sqrt(np.mean(kept ** 2))) * share, floor) if len(kept) else floor
    return given or level, inliers.astype(float), inliers


def median_size(error: Floats) -> float:
    """Return the median magnitude of errors, ignoring samples outside windows, which are NaN."""
    finite = np.abs(error[np.isfinite(error)])
    return float(np.median(finite)) if finite.size else 0.0
