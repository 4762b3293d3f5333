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

"""Test the errors of a fit for reasons against its model."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.errors import of_training, rms
from rigid_body_ros.inference.evidence import explained, linear, solved, split_channels, widened
from rigid_body_ros.inference.noise import ALARM, batches_of, chance, come_together, FEWEST, Noise
from rigid_body_ros.inference.solution import Solution

#: Errors are averaged over batches of this length, in seconds, to find errors that persist.
_BATCH = 1.0
#: A model that leaves more than this of a channel unexplained, rad or relative to the rates, is
#: rejected. No attitude sensor is noisier than this.
MISFIT = 0.1
#: Largest plausible noise of a gyro, in rad/s or, if this is more, as a fraction of the measured
#: rates.
_NOISIEST_RATE = 0.3
#: The errors of a recording may be this many times as large as those of most others.
_NOISIER = 4.0
#: Largest plausible fraction of outliers among the samples of a sensor.
_MOST_OUTLIERS = 0.3


class Reason(NamedTuple):
    """A reason against a model, and whether this reason alone is enough to reject the model."""

    text: str
    rejects: bool = False
    #: Whether the reason rejects the model unless a suspect explains it.
    is_contradiction: bool = False


def halves(solution: Solution) -> tuple[list[Reason], dict[str, float], float]:
    """
    Compare the estimates from the first and the second halves of the recordings.

    Return a list of reasons, which is empty if the estimates agree, `Findings.drift` and
    `Findings.apart`.
    """
    if not solution.problem.parameters.size:
        return [], {}, 1.0
    problem = widened(solution, pieces=2)
    given, scales = linear(problem), problem.parameters.scales
    matrix, errors = given.stacked()
    if len({*given.is_late}) < 2:
        return [], {}, 1.0
    second = given.split([*range(matrix.shape[1])], given.is_late)
    drop, rank, p = explained(second, matrix, errors)
    ratio = max(float(np.sqrt(drop / max(rank, 1))), 1.0)
    (early, early_sigma), (late, late_sigma) = (solved(half, errors)
                                                for half in (matrix - second, second))
    apart, sigma = np.abs(early - late), np.hypot(early_sigma, late_sigma)
    # A difference that is visible, if not significant, tells how far the fit may be off.
    drift = dict(zip(given.names, np.where(apart > sigma, np.nan_to_num(apart) * scales,
                                           0.0).tolist()))
    reasons = [Reason(f'the two halves of the recording give different values ({probability(p)})',
                      is_contradiction=True)] if p < ALARM else []
    return reasons, drift, ratio


def tests_of(solution: Solution, found: list[list[Noise]]) -> Iterator[Reason]:
    """Generate the reasons against the model that its errors give, from noise of a given form."""
    yield from _of_noise(solution, found)
    yield from _of_outliers(solution)
    yield from _of_correlation(solution, found)


def _of_noise(solution: Solution, found: list[list[Noise]]) -> Iterator[Reason]:
    """
    Generate a reason against the model for each channel whose noise is too large.

    Noise is too large if no sensor is plausibly that noisy, or if it exceeds the noise that the
    user gave, or that of most other recordings.
    """
    from scipy.special import ndtr
    setup, every = solution.problem.setup, of_training(solution)
    for one, noise in zip(every, chain(*found)):
        size = rms(one.kept) / np.sqrt(3.0)
        if one.is_attitude and size > MISFIT:
            yield Reason(f'{one.topic}: attitude errors of {size:.2g} rad are not the noise of a '
                         'sensor', True)
        elif not one.is_attitude and size > _NOISIEST_RATE * max(
                1.0, rms(one.measured) / np.sqrt(3.0)):
            yield Reason(f'{one.topic}: errors of {size:.2g} rad/s are not the noise of a gyro',
                         True)
        others = float(np.median([other.noise for other in every if (
            other.topic, other.is_attitude) == (one.topic, one.is_attitude)]))
        if size > _NOISIER * others:
            yield Reason(f'recording {one.recording + 1} does not fit the others: the errors of '
                         f'{one.topic} are {size / others:.2g} times as large')
        given = setup.attitude_noise if one.is_attitude else setup.rate_noise
        spread = np.sqrt(2.0 * noise.overlap / max(one.kept.size, 1))
        if given and ndtr((1.0 - (size / given) ** 2) / spread) < ALARM:
            yield Reason(f'{one.topic}: errors of {size:.2g} exceed the given noise of '
                         f'{given:.2g}')


def _of_outliers(solution: Solution) -> Iterator[Reason]:
    """Generate a reason against the model for each channel with clustered or too many outliers."""
    for one in of_training(solution):
        bad = ~one.inliers
        if bad.sum() < FEWEST:
            continue
        together, share = come_together(bad), float(np.mean(bad))
        if together or share > _MOST_OUTLIERS:
            how = 'in clusters' if together else 'more than a sensor has'
            yield Reason(f'{one.topic}: {100.0 * share:.2g} % of the samples are outliers, {how}',
                         share > _MOST_OUTLIERS)


def _of_correlation(solution: Solution, found: list[list[Noise]]) -> Iterator[Reason]:
    """
    Generate a reason against the model for each channel with errors that persist.

    Such errors stay correlated for longer than the noise of the channel explains.
    """
    problem = solution.problem
    sums: dict[tuple[int, int], list[Floats]] = {}
    for k, window in enumerate(problem.windows):
        for channel, errors in split_channels(problem, k,
                                              problem.scaled_errors(k, solution.physics)):
            noise = found[window.experiment][channel]
            left = noise.innovations(errors)
            stamps_ns = window.channels[channel].stamps_ns
            spacing = max(float(np.median(np.diff(stamps_ns))) * 1e-9, 1e-9) \
                if len(stamps_ns) > 1 else 1.0
            size = max(FEWEST, round(_BATCH / spacing))
            if len(left) >= size:
                sums.setdefault((window.experiment, channel), []).append(batches_of(left, size))
    for (number, channel), parts in sums.items():
        p = chance(found[number][channel], np.concatenate(parts, axis=1))
        if p < ALARM:
            one = problem.setup.channels[number][channel]
            what = 'attitude' if one.is_attitude else 'angular velocity'
            yield Reason(f'{one.topic}: errors of the {what} last for a second or more '
                         f'({probability(p)})')


def probability(p: float) -> str:
    """Format a probability as text."""
    return f'p = {p:.1g}' if p >= 1e-300 else 'p < 1e-300'
