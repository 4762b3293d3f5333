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

"""The noise of a channel: the size of the noise on each axis, and how long the noise persists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.mechanics import so3

#: Probability of a false alarm in each test.
ALARM = 1e-4
#: Minimum number of samples in a batch, and minimum number of outliers that can form clusters.
FEWEST = 10
#: Half-width of the 95 % interval of a normal variable, in standard deviations.
NORMAL_95 = 1.959963984540054
#: Ratio of the standard deviation of normal noise to its median absolute value.
NORMAL = 1.4826
#: A sample is an outlier if both steps to its neighbours, or that to their median, are longer than
#: usual by this factor: no body jumps to some state and back.
JUMP = 10.0
#: The noise of an axis is at least this fraction of that of all axes, because one axis of a sensor
#: may be stuck, and at least the second number, rad or rad/s. Starts that differ by less count as
#: equal.
LEAST, SMALLEST = 1e-3, 1e-7
#: Maximum number of previous samples that a sample may depend on.
_ORDER = 3
#: Largest `Noise.lasting` that a sensor may have. An autoregression with the single coefficient
#: 0.92 has this value.
LONGEST = 5.0
#: In the noise estimate, the weight of a window falls to 1/e after `_MEMORY` more windows. Before
#: the first window, the estimate starts with `_EARLIER` fictitious samples that have the AR(1)
#: correlation `_CAUTION`. These samples make early alarms rarer.
_MEMORY, _EARLIER, _CAUTION = 60.0, 1000.0, 0.5
#: Largest correlation that is assumed between adjacent samples.
_MOST = 0.95


@dataclass(frozen=True, eq=False)
class Noise:
    """
    Noise in which each sample depends on a few of the previous samples.

    Attributes
    ----------
    sizes : array, shape (3,)
        Standard deviation on each axis.
    coefficients : array, shape (p,)
        The coefficients c in x[t] = c[0] x[t-1] + ... + c[p-1] x[t-p] + innovation.
    lasting : float
        How many times larger the standard deviation of the mean of many samples is than it would
        be for independent samples. This is the square root of the long-run variance divided by the
        variance, limited to the range from 1 to `LONGEST`.
    overlap : float
        How many times larger the variance of the mean square is than it would be for independent
        samples. This is 1 plus twice the sum of the squared correlations.

    """

    sizes: Floats
    coefficients: Floats = field(default_factory=lambda: np.empty(0))
    lasting: float = 1.0
    overlap: float = 1.0

    def innovations(self, errors: Floats) -> Floats:
        """
        Return the part of each error that cannot be predicted from the previous errors.

        The errors, shape (n, 3), must be those of consecutive samples. If `lasting` equals
        `LONGEST`, the method returns the errors divided by `LONGEST` instead.
        """
        if self.lasting >= LONGEST:
            return errors / LONGEST
        order = len(self.coefficients)
        result = errors[order:].copy()
        for k, coefficient in enumerate(self.coefficients, 1):
            result -= coefficient * errors[order - k:len(errors) - k]
        return result


def tail(square: float, count: int) -> float:
    """Return the probability that the sum of squares of `count` normal numbers is larger."""
    from scipy.special import chdtrc  # slow to import
    return float(chdtrc(count, square)) if count else 1.0


def rms(vectors: Floats) -> float:
    """Return the root-mean-square length of some vectors, or 0 if there are none."""
    return float(np.sqrt(np.mean(np.sum(vectors ** 2, axis=1)))) if len(vectors) else 0.0


def batches_of(left: Floats, size: int) -> Floats:
    """
    Divide errors into n batches, and return two statistics of each batch, shape (2, n, 3).

    The statistics are the square of the sum of the errors, and the sum of their squares. Both are
    divided by the number of finite samples in the batch.
    """
    count = len(left) // size
    batches = left[:count * size].reshape(count, size, 3)
    finite = np.maximum(np.isfinite(batches).sum(axis=1), 1)
    return np.stack([np.nansum(batches, axis=1) ** 2 / finite,
                     np.nansum(batches ** 2, axis=1) / finite])


def chance(noise: Noise, batches: Floats) -> float:
    """
    Return the probability that independent innovations scatter at least as much as `batches`.

    Parameters
    ----------
    noise : Noise
        The noise of the errors.
    batches : array, shape (2, n, 3)
        The result of `batches_of` for the innovations.

    Returns
    -------
    float
        The smallest of the probabilities for the three axes.

    """
    means, squares = batches
    scale = 1.0 if noise.lasting >= LONGEST else np.maximum(squares.mean(axis=0), 1e-300)
    return tail(float(np.max(means.sum(axis=0) / scale)), len(means))


def come_together(bad: NDArray[np.bool_]) -> bool:
    """
    Return whether outliers cluster.

    Outliers cluster if they form fewer runs of adjacent samples than chance can explain.
    """
    from scipy.special import ndtr
    count, share = int(bad.sum()), float(np.mean(bad))
    # Use the runs test of Wald and Wolfowitz (1940).
    runs = int(bad[0]) + int(np.sum(bad[1:] & ~bad[:-1]))
    mean = count * (1.0 - share)
    spread = max(np.sqrt(mean * share * (1.0 - share)), 1e-9)
    return float(ndtr((runs - mean) / spread)) < ALARM


def noise_of(parts: Sequence[Floats], share: float) -> Noise:
    """
    Estimate the noise of a channel with an autoregression.

    The order of the autoregression is the one with the best information criterion.

    Parameters
    ----------
    parts : sequence of array, shape (n, 3)
        Errors of consecutive samples, with NaN for samples to ignore.
    share : float
        Number of errors divided by the number of degrees of freedom, at least 1.

    """
    sizes = np.sqrt(share * np.nanmean(np.concatenate(parts) ** 2, axis=0))
    scaled = [part / np.where(sizes > 0.0, sizes, 1.0) for part in parts]
    covariances = np.array([_lagged(scaled, lag) for lag in range(_ORDER + 1)])
    count = sum(int(np.isfinite(part).sum()) for part in scaled)
    if not covariances[0] > 0.0:
        return Noise(sizes)
    correlations = covariances / covariances[0]
    best, coefficients = 0.0, np.empty(0)
    for order in range(1, _ORDER + 1):
        toeplitz = correlations[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
        trial = np.linalg.lstsq(toeplitz, correlations[1:order + 1], rcond=None)[0]
        left = max(1.0 - float(trial @ correlations[1:order + 1]), 1e-12)
        criterion = count * np.log(left) + order * np.log(max(count, 2))
        if criterion < best:
            best, coefficients = criterion, trial
    order = len(coefficients)
    if not order:
        return Noise(sizes)
    left = 1.0 - float(coefficients @ correlations[1:order + 1])
    ratio = left / max(1.0 - float(coefficients.sum()), 1e-3) ** 2
    continued = [*correlations[:order + 1]]
    while len(continued) < 1000 and np.abs(continued[-order:]).max() > 1e-3:
        continued.append(float(np.clip(coefficients @ continued[:-order - 1:-1], -1.0, 1.0)))
    overlap = 1.0 + 2.0 * float(np.sum(np.square(continued[1:])))
    return Noise(sizes, coefficients, float(np.sqrt(np.clip(ratio, 1.0, LONGEST ** 2))), overlap)


def _lagged(parts: Sequence[Floats], lag: int) -> float:
    """Return the mean product of two samples that are `lag` samples apart."""
    products = [part[lag:] * part[:len(part) - lag] for part in parts if len(part) > lag]
    finite = [product[np.isfinite(product)] for product in products]
    return float(np.mean(np.concatenate(finite))) if any(map(len, finite)) else 0.0


def spread_of(stamps_ns: Ints, errors: Floats, is_attitude: bool = False) -> Floats:
    """
    Estimate the noise of some errors from how far each is from the line between its neighbours.

    A wrong model hardly affects this estimate, because the errors that it causes change slowly.

    Parameters
    ----------
    stamps_ns : array of int64, shape (n,), ns
        The times of the samples.
    errors : array, shape (n, 3)
        The errors, at least three.
    is_attitude : bool
        Whether the errors are rotation vectors.

    Returns
    -------
    array, shape (3,)
        The standard deviation on each axis.

    """
    before, here, after = stamps_ns[:-2], stamps_ns[1:-1], stamps_ns[2:]
    share = ((here - before) / (after - before))[:, None]
    if is_attitude:  # rotation vectors are discontinuous at half a turn
        turns = so3.exp(errors)
        back = so3.conjugate(turns[:-2])
        middle = so3.exp(share * so3.difference(turns[:-2], turns[2:]))
        left = so3.difference(middle, so3.multiply(back, turns[1:-1]))
    else:
        left = errors[1:-1] - (1.0 - share) * errors[:-2] - share * errors[2:]
    sizes = NORMAL * np.median(np.abs(left) / np.sqrt(
        1.0 + share ** 2 + (1.0 - share) ** 2), axis=0)
    return np.maximum(sizes, max(LEAST * float(sizes.max()), SMALLEST))


def with_bound(sigma: ArrayLike, bound: ArrayLike) -> Floats:
    """
    Add to a standard deviation an error of which only the bound is known.

    Any value up to the bound is equally likely, so the standard deviation of such an error is the
    bound divided by sqrt(3) (JCGM 100:2008, 4.3.7).
    """
    return np.hypot(sigma, np.divide(bound, np.sqrt(3.0)))


@dataclass
class NoiseLevel:
    """
    The actual noise of one quantity of a sensor, including its correlation.

    Both the size and the correlation of the noise are estimated from all windows so far.

    Parameters
    ----------
    stated : float
        Standard deviation of each component, as stated in the scene.

    """

    stated: float
    #: Three statistics of the differences between adjacent samples: how many there are, the sum of
    #: their squares, and the sum of the products of successive differences. Before the statistics
    #: are computed, a line fitted to the differences is subtracted, because model errors are
    #: smooth.
    _sums: Floats = field(init=False)
    #: Whether the sensor measures the quantity.
    is_measured: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        change = 1.0 - _CAUTION
        self._sums = _EARLIER * self.stated ** 2 * np.array([
            1.0 / self.stated ** 2, 2.0 * change, -change ** 2])

    def add(self, errors: Floats | None) -> None:
        """
        Update the estimate with the errors of a window, shape (n, 3).

        Nothing happens if the errors are None or if there are fewer than four of them.
        """
        if errors is None or len(errors) < 4:
            return
        self.is_measured = True
        steps = np.diff(errors, axis=0)
        columns = np.stack([np.ones(len(steps)), np.arange(len(steps))], axis=1)
        steps = steps - columns @ np.linalg.lstsq(columns, steps, rcond=None)[0]
        # Clip the differences, because outliers and jumps are not noise.
        limit = 6.0 * float(np.median(np.abs(steps))) / 0.6745
        steps = np.clip(steps, -limit, limit)
        self._sums *= np.exp(-1.0 / _MEMORY)
        self._sums += steps.size, np.sum(steps ** 2), np.sum(steps[1:] * steps[:-1])

    @property
    def _correlation(self) -> float:
        _, squares, products = self._sums
        return float(np.clip(1.0 + 2.0 * products / squares, 0.0, _MOST)) if squares else 0.0

    @property
    def factor(self) -> float:
        """Return the factor by which AR(1) correlation multiplies the variance of a mean."""
        return (1.0 + self._correlation) / (1.0 - self._correlation)

    @property
    def size(self) -> float:
        """Return the standard deviation of each component, estimated from the samples."""
        count, squares, _ = self._sums
        return float(np.sqrt(squares / count / 2.0 / (1.0 - self._correlation)))
