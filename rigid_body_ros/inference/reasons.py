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
Test the errors of a fit for reasons against its model, which may be a little wrong.

What the model of a real robot leaves unexplained is not white noise: neighbouring errors are
alike. Estimates are therefore less certain than the number of samples suggests. Several recordings
tell best how certain they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.errors import correlations, of_training, Residuals, unexplained
from rigid_body_ros.inference.evidence import explained, linear, solved, split_channels, widened
from rigid_body_ros.inference.fit import Solution
from rigid_body_ros.inference.guess import davenport
from rigid_body_ros.inference.noise import (
    ALARM,
    batches_of,
    chance,
    come_together,
    FEWEST,
    Noise,
    NORMAL_95,
    rms,
)
from rigid_body_ros.mechanics import so3
from rigid_body_ros.scene.quantities import is_of_sensor

#: Errors are averaged over batches of this length, in seconds, to find errors that persist.
_BATCH = 1.0
#: A model that leaves more than this of a channel unexplained, rad or relative to the rates, is
#: rejected. No attitude sensor is noisier than this.
MOST_UNEXPLAINED = 0.1
#: Largest plausible noise of a gyro, in rad/s or, if this is more, as a fraction of the measured
#: rates.
_NOISIEST_RATE = 0.3
#: The errors of a recording may be this many times as large as those of most others.
_NOISIER = 4.0
#: Largest plausible fraction of outliers among the samples of a sensor.
_MOST_OUTLIERS = 0.3
#: At least one in so many independent errors counts as a degree of freedom that is left.
_FEW = 4.0
#: Numbers of parts of a recording whose means are compared.
_BATCHES = 8, 16, 32, 64
#: Minimum number of recordings whose scatter says how certain an estimate is.
_RECORDINGS = 3
#: A recording does not fit the others if it differs by more than this many times what the others
#: scatter. A recording is held by this part of the mean information.
_APART, _HELD = 6.0, 0.05
#: A body is at rest if it turns by less than this (rms, rad), if its mean angular velocity is at
#: most the bias of a gyro (rad/s), and if a fit leaves this part of the measurements unexplained.
#: Without fitted parameters, the errors must be so many times as large.
_STILL, _BIAS, _LEFT, _LARGER = 0.1, 0.05, 0.8, 10.0
#: Probability below the upper end of a 95 % interval.
_QUANTILE = 0.975


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
    fit, scales = linear(problem), problem.parameters.scales
    matrix, errors = fit.stacked()
    if len({*fit.is_late}) < 2:
        return [], {}, 1.0
    second = fit.split([*range(matrix.shape[1])], fit.is_late)
    drop, rank, p = explained(second, matrix, errors)
    ratio = max(float(np.sqrt(drop / max(rank, 1))), 1.0)
    (early, early_sigma), (late, late_sigma) = (solved(half, errors)
                                                for half in (matrix - second, second))
    apart, sigma = np.abs(early - late), np.hypot(early_sigma, late_sigma)
    # A difference that is visible, if not significant, tells how far the fit may be off.
    drift = dict(zip(fit.names, np.where(apart > sigma, np.nan_to_num(apart) * scales,
                                         0.0).tolist()))
    reasons = [Reason(f'the two halves of the recording give different values ({probability(p)})',
                      is_contradiction=True)] if p < ALARM else []
    return reasons, drift, ratio


def tests_of(solution: Solution, noises: list[list[Noise]]) -> Iterator[Reason]:
    """Generate the reasons against the model that its errors give, from noise of a given form."""
    yield from _of_noise(solution, noises)
    yield from _of_outliers(solution)
    yield from _of_correlation(solution, noises)


def _of_noise(solution: Solution, noises: list[list[Noise]]) -> Iterator[Reason]:
    """
    Generate a reason against the model for each channel whose noise is too large.

    Noise is too large if no sensor is plausibly that noisy, or if it exceeds the noise that the
    user gave, or that of most other recordings.
    """
    from scipy.special import ndtr
    setup, every = solution.problem.setup, of_training(solution)
    for part, noise in zip(every, chain(*noises)):
        size = rms(part.kept) / np.sqrt(3.0)
        if part.is_attitude and size > MOST_UNEXPLAINED:
            yield Reason(f'{part.topic}: attitude errors of {size:.2g} rad are not the noise of a '
                         'sensor', True)
        elif not part.is_attitude and size > _NOISIEST_RATE * max(
                1.0, rms(part.measured) / np.sqrt(3.0)):
            yield Reason(f'{part.topic}: errors of {size:.2g} rad/s are not the noise of a gyro',
                         True)
        others = float(np.median([other.noise for other in every if (
            other.topic, other.is_attitude) == (part.topic, part.is_attitude)]))
        if size > _NOISIER * others:
            yield Reason(f'recording {part.recording + 1} does not fit the others: the errors of '
                         f'{part.topic} are {size / others:.2g} times as large')
        stated = setup.noise_of(part.is_attitude)
        spread = np.sqrt(2.0 * noise.overlap / max(part.kept.size, 1))
        if stated and ndtr((1.0 - (size / stated) ** 2) / spread) < ALARM:
            yield Reason(f'{part.topic}: errors of {size:.2g} exceed the given noise of '
                         f'{stated:.2g}')


def _of_outliers(solution: Solution) -> Iterator[Reason]:
    """Generate a reason against the model for each channel with clustered or too many outliers."""
    for part in of_training(solution):
        bad = ~part.inliers
        if bad.sum() < FEWEST:
            continue
        together, share = come_together(bad), float(np.mean(bad))
        if together or share > _MOST_OUTLIERS:
            how = 'in clusters' if together else 'more than a sensor has'
            yield Reason(f'{part.topic}: {100.0 * share:.2g} % of the samples are outliers, {how}',
                         share > _MOST_OUTLIERS)


def _of_correlation(solution: Solution, noises: list[list[Noise]]) -> Iterator[Reason]:
    """
    Generate a reason against the model for each channel with errors that persist.

    Such errors stay correlated for longer than the noise of the channel explains.
    """
    problem = solution.problem
    sums: dict[tuple[int, int], list[Floats]] = {}
    for k, window in enumerate(problem.windows):
        for channel, errors in split_channels(problem, k,
                                              problem.scaled_errors(k, solution.physics)):
            noise = noises[window.experiment][channel]
            left = noise.innovations(errors)
            stamps_ns = window.channels[channel].stamps_ns
            spacing = max(float(np.median(np.diff(stamps_ns))) * 1e-9, 1e-9) \
                if len(stamps_ns) > 1 else 1.0
            size = max(FEWEST, round(_BATCH / spacing))
            if len(left) >= size:
                sums.setdefault((window.experiment, channel), []).append(batches_of(left, size))
    for (number, channel), parts in sums.items():
        p = chance(noises[number][channel], np.concatenate(parts, axis=1))
        if p < ALARM:
            measured = problem.setup.channels[number][channel]
            what = 'attitude' if measured.is_attitude else 'angular velocity'
            yield Reason(f'{measured.topic}: errors of the {what} last for a second or more '
                         f'({probability(p)})')


def probability(p: float) -> str:
    """Format a probability as text."""
    return f'p = {p:.1g}' if p >= 1e-300 else 'p < 1e-300'


def with_persistence(solution: Solution, noises: list[list[Noise]]) -> Solution:
    """
    Return a fit whose weights account for the correlation of the errors, however long it lasts.

    If errors are independent only n samples apart, n samples tell as much as one. The number of
    unknowns is subtracted from the number of independent errors.
    """
    times = persistence(solution)
    effective = sum(3.0 * float(inliers.sum()) / time for time, inliers in zip(
        chain(*times), chain(*solution.inliers)))
    free = max(effective - solution.problem.size, effective / _FEW)
    share = effective / free * _student(free) ** 2
    return solution.with_spreads([
        [weight.spread * max(np.sqrt(time * share) / noise.lasting, 1.0)
         for weight, time, noise in zip(*every)]
        for every in zip(solution.weights, times, noises)])


def persistence(solution: Solution) -> list[list[float]]:
    """Return how many samples tell as much as one, for each channel of each recording."""
    return [[_persistence(*pair) for pair in zip(*every)]
            for every in zip(solution.errors, solution.inliers)]


def _student(freedom: float) -> float:
    """Return the 95 % quantile of Student's distribution divided by that of the normal one."""
    from scipy.special import stdtrit
    return float(stdtrit(max(freedom, 1.0), _QUANTILE)) / NORMAL_95


def _persistence(errors: Floats, inliers: NDArray[np.bool_]) -> float:
    """
    Return how many samples tell as much as one sample with an independent error.

    This is the sum of the autocorrelation up to its first zero. Noise hides a small error that
    lasts from this sum, but not from the scatter of the means of many samples.
    """
    kept = inliers & np.isfinite(errors[:, 0])
    errors = np.where(kept[:, None], errors, 0.0)
    correlation = correlations(errors, kept).mean(axis=1)
    ends = np.flatnonzero(correlation <= 0.0)
    times = [float(1.0 + 2.0 * np.sum(correlation[1:ends[0] if len(ends) else None]))]
    for count in _BATCHES:
        means, squares = batches_of(errors, max(len(errors) // count, 1))
        times.append(float(means.sum() / max(squares.sum(), 1e-300)))
    return max(times)


def left_by(solution: Solution) -> Iterator[tuple[str, float]]:
    """Generate a text and a number for each quantity, which say what the model cannot explain."""
    quantities: dict[tuple[str, bool], list[Residuals]] = {}
    for part in of_training(solution):
        quantities.setdefault((part.topic, part.is_attitude), []).append(part)
    for parts in quantities.values():
        what, size = unexplained(parts)
        yield f'{parts[0].topic}: the model leaves {what} unexplained (rms)', size


def at_rest(solution: Solution) -> str:
    """Return why a recorded body that does not move says nothing about a model; '' if it moves."""
    setup = solution.problem.setup
    fits_motion = not all(map(is_of_sensor, setup.parameters.groups))
    # A quantity without samples shows nothing.
    quantities = [part for part in of_training(solution) if part.inliers.any()]
    if not setup.is_computed or any(_turns(part) or _is_explained(part, fits_motion)
                                    for part in quantities):
        return ''
    acts = any(log.torques.any() for log in setup.logs)
    return 'the body does not visibly move: ' + (
        'the logged torque has no visible effect' if acts else 'this says nothing about it')


def _turns(part: Residuals) -> bool:
    """Return whether a quantity shows that the body turns by more than noise and a gyro's bias."""
    turned = _about_mean(part)
    if not part.is_attitude:
        seconds = 1e-9 * np.diff(part.kept_ns, prepend=part.kept_ns[0])
        turned = np.cumsum(seconds[:, None] * turned, axis=0)
        # The integral is about the mean: it hides a steady rotation, which no bias explains.
        if rms(part.measured[part.inliers].mean(axis=0)[None]) > _BIAS:
            return True
    return rms(turned) > _STILL


def _is_explained(part: Residuals, fits_motion: bool) -> bool:
    """Return whether the model explains a quantity better than a constant does."""
    left, size = rms(part.kept), rms(_about_mean(part))
    # If nothing is fitted to the motion, a model that is right leaves the noise about the mean.
    return left < (np.sqrt(_LEFT) if fits_motion else _LARGER) * size or not (left or fits_motion)


def _about_mean(part: Residuals) -> Floats:
    """Return a measured quantity relative to its mean, as rotation vectors or rates."""
    values = part.measured[part.inliers]
    return so3.difference(davenport(values), values) if part.is_attitude \
        else values - values.mean(axis=0)


def scattered(solution: Solution) -> tuple[list[str], dict[str, float]]:
    """
    Return how certain the estimates are, judged by the scatter between the recordings.

    The first result names the recordings that do not fit the others. The second result holds a
    standard deviation for each shared component: that of a normal variable with the same 95 %
    interval as Student's distribution for that many recordings. Both are empty if there are fewer
    than three recordings.

    From the joint estimates, each recording alone would move by -A^-1 g, where A is its
    information matrix and g its gradient (a Gauss-Newton step). What a recording hardly determines
    is held by a small part of the information of all. All recordings count alike, because one that
    disagrees only seems to be noisy.
    """
    setup = solution.problem.setup
    count, size = len(setup.problems), setup.parameters.size
    if count < _RECORDINGS or not size:
        return [], {}
    problem = widened(solution)
    fit = linear(problem)
    matrices, gradients = np.zeros((count, size, size)), np.zeros((count, size, 1))
    for window, block in zip(problem.windows, fit.blocks):
        matrices[window.experiment] += block[:, :-1].T @ block[:, :-1]
        gradients[window.experiment] += block[:, :-1].T @ block[:, -1:]
    squares = np.linalg.solve(matrices + _HELD * matrices.mean(axis=0), gradients)[:, :, 0] ** 2
    sizes = _student(count - 1) * np.sqrt(squares.sum(axis=0) / (count * (count - 1)))
    others = (squares.sum(axis=0) - squares) / (count - 1)
    ratios = np.sqrt(np.max(squares / np.maximum(others, 1e-300), axis=1))
    texts = [f'recording {k + 1} does not fit the others: alone, it differs {ratios[k]:.2g} '
             'times as much as they do' for k in np.flatnonzero(ratios > _APART)]
    return texts, dict(zip(fit.names, (sizes * problem.parameters.scales).tolist()))
