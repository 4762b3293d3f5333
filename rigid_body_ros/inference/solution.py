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

from dataclasses import dataclass

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
#: If fewer samples than this fraction are within that limit, the limit says nothing.
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
    setup, errors, unknown = problem.setup, problem.residuals(physics), problem.size
    total = sum(int(np.isfinite(error).sum()) for every in errors for error in every)
    share = np.sqrt(total / max(total - unknown, 1))
    sigma, roots, inliers = [], [], []
    for every, channels in zip(errors, setup.channels):
        levels = [_level(error, channel, setup, share) for error, channel in zip(every, channels)]
        given = [setup.attitude_noise if channel.is_attitude else setup.rate_noise
                 for channel in channels]
        distances = [np.nan_to_num(np.linalg.norm(error, axis=1)
                                   / max(level, noise or 0.0, _NO_OUTLIER))
                     for error, level, noise in zip(every, levels, given)]
        inlier = [_inliers(distance, error) for distance, error in zip(distances, every)]
        if is_last:
            levels = [max(_rms(error[one]) * share, _floor(channel, setup))
                      for error, one, channel in zip(every, inlier, channels)]
        inliers.append(inlier)
        sigma.append([noise or level for noise, level in zip(given, levels)])
        roots.append([one.astype(float) if is_last else
                      1.0 / np.sqrt(1.0 + distance ** 2 / (3.0 * _CAUCHY ** 2))
                      for one, distance in zip(inlier, distances)])
    weights = Weights(sigma, roots, problem.weights.spreads)
    return Solution(length_ns, problem, physics, errors, weights, inliers, evaluations, converged)


def _inliers(distances: Floats, error: Floats) -> NDArray[np.bool_]:
    """Return a mask of the samples that are not outliers, which nearly all cannot be."""
    inliers, finite = distances <= _OUTLIER, np.isfinite(error[:, 0])
    if finite.any() and np.mean(inliers[finite]) < _RARE:
        return np.ones(len(inliers), bool)
    return np.asarray(inliers)


def _level(error: Floats, channel: Measured, setup: Setup, share: float) -> float:
    """Return an outlier-resistant estimate of the standard deviation of a channel's errors."""
    return max(NORMAL * median_size(error) * share, _floor(channel, setup))


def median_size(error: Floats) -> float:
    """Return the median magnitude of errors, ignoring samples outside windows, which are NaN."""
    finite = np.abs(error[np.isfinite(error)])
    return float(np.median(finite)) if finite.size else 0.0


def _rms(error: Floats) -> float:
    """Return the root-mean-square error, ignoring samples outside windows, which are NaN."""
    finite = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(finite ** 2))) if finite.size else 0.0


def _floor(channel: Measured, setup: Setup) -> float:
    return ROUNDING * (1.0 if channel.is_attitude else max(1.0, setup.rate))
