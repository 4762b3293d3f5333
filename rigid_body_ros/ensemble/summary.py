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

"""Summarize the runs of a complete ensemble: distributions, requirements, and what matters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
import math
import re
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import CUT
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.motions import Motions
from rigid_body_ros.ensemble.requirements import ANGLE, Requirement
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.mechanics import so3

#: The percentiles of the final states that are reported, and those of the angles over time.
PERCENTILES, _BANDS = (1, 5, 25, 50, 75, 95, 99, 100), (5, 25, 50, 75, 95)
#: Maximum number of bars in a histogram.
_BARS = 60
#: The axis is logarithmic if the 99th percentile exceeds the 5th by more than this factor.
_DECADES = 100.0
#: Maximum number of points in time for which percentiles are computed. A picture needs no more.
_TIMES = 500
#: Maximum number of angles to hold in memory, at 8 bytes each. If an ensemble has more runs than
#: this, each pass through the motions covers only one point in time.
_KEPT = 2 ** 24
#: The effects are computed from at most this many runs, beginning with the first run.
_SAMPLE = 100_000
#: A term of the quadratic is ignored as a rounding error if its mean square is below this fraction
#: of the square of the largest deviation.
_ROUNDING = 1e-20
#: A number, unless it is part of a word or of a unit such as 'kg m^2'.
_NUMBER = re.compile(r'(?<![\w^.])[-+]?(?:\d+\.?\d*(?:e[-+]?\d+)?|inf|nan)(?![\w^])')
#: The placeholder for a number that differs between messages, and a pattern that matches a list of
#: placeholders.
_OTHER = '...'
_OTHERS = re.compile(r'\.\.\.(, \.\.\.)+')
#: How many of the worst runs are reported.
_WORST = 5
#: The probability of each tail of a confidence interval.
_TAIL = 0.025


def judged(requirement: Requirement, ensemble: Ensemble, folder: Folder) -> dict[str, Any]:
    """
    Judge how well the runs of a complete folder meet a requirement.

    Returns
    -------
    dict
        The result as JSON types. 'met' is the number of runs that meet the requirement; failed
        runs never meet it. 'share' is 'met' divided by the number of all runs, and 'interval_95'
        is the 95 % confidence interval of 'share'. 'percentiles' and 'histogram' describe the
        quantity at the end or, with 'after_s', the overshoot. They are empty if all runs failed.
        'settling_time_s' contains percentiles of the 'settled' runs, which meet the limit at the
        end. 'worst' lists the worst runs. 'effects' says how much each parameter affects the
        quantity or the overshoot.

    """
    sign, more = 1.0 if requirement.relation[0] == '<' else -1.0, dict[str, Any]()
    if requirement.after is None:
        numbers, limit = final(folder, requirement.quantity) / requirement.size, requirement.limit
        worse = sign * numbers
    else:
        settled, numbers = (folder.numbers(name) for name in requirement.columns)
        worse, limit = numbers, 0.0
        more = {'after_s': requirement.after, 'settled': int(np.isfinite(settled).sum()),
                'settling_time_s': distribution(settled)[0]}
    met = int(requirement.is_met(sign * worse, limit).sum())  # NaN, in failed runs, is not met
    values, bars = distribution(numbers)
    order = np.argsort(-worse, kind='stable')[:_WORST]
    return {'require': str(requirement), 'unit': requirement.unit, **more, 'met': met,
            'share': met / folder.runs, 'interval_95': interval(met, folder.runs),
            'percentiles': values,
            'histogram': bars and {'edges': bars['edges_rad'], 'runs': bars['runs']},
            'worst': [{'run': run, 'value': float(numbers[run])} for run in order.tolist()
                      if math.isfinite(numbers[run])],
            'effects': effects(ensemble, folder, numbers)}


def summarized(ensemble: Ensemble, folder: Folder,
               requirements: Sequence[Requirement] = ()) -> dict[str, Any]:
    """
    Return the results of a complete ensemble as JSON types.

    Returns
    -------
    dict
        'runs' and 'failed' are the numbers of all runs and of failed runs, and 'failures' counts
        the failed runs by cause. 'angle_from_nominal_rad' contains percentiles of the angle
        between the final attitude and the nominal final attitude, and 'histogram' a histogram of
        this angle. Both are empty if all runs failed. 'rank_correlation' contains the correlation
        between this angle and the distance of each dispersed parameter from its nominal value.
        'bands' is present if the folder keeps states and at least one run did not fail.
        'requirements' is present if there are requirements, and contains the result of
        `judged` for each of them.

    """
    angles = folder.numbers(ANGLE)
    succeeded = int(np.isfinite(angles).sum())
    values, bars = distribution(angles)
    results = {'runs': folder.runs, 'failed': folder.runs - succeeded,
               'failures': causes(folder.messages()),
               'angle_from_nominal_rad': values, 'histogram': bars}
    if succeeded and folder.motions:
        results['bands'] = bands(folder.motions, ensemble.nominal_motion, succeeded)
    results['rank_correlation'] = correlations(ensemble, folder, angles)
    if requirements:
        results['requirements'] = [judged(requirement, ensemble, folder)
                                   for requirement in requirements]
    return results


def interval(met: int, runs: int) -> list[float]:
    """Return the Clopper-Pearson 95 % confidence interval for a probability."""
    from scipy.special import betaincinv  # slow to import
    return [float(betaincinv(met, runs - met + 1, _TAIL)) if met else 0.0,
            float(betaincinv(met + 1, runs - met, 1.0 - _TAIL)) if met < runs else 1.0]


def distribution(numbers: Floats) -> tuple[dict[str, float], dict[str, Any]]:
    """
    Return percentiles and a histogram of numbers, as JSON types.

    Parameters
    ----------
    numbers : array, shape (n,)
        The number of each run, NaN in failed runs.

    Returns
    -------
    percentiles : dict
        The percentiles 'p1', 'p5', and so on. Empty if all runs failed.
    histogram : dict
        The result of `histogram`. Empty if all runs failed.

    """
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return {}, {}
    values = dict(zip([f'p{k}' for k in PERCENTILES], percentiles(numbers, PERCENTILES).tolist()))
    return values, histogram(numbers, values)


def percentiles(numbers: Floats, wanted: Sequence[int]) -> Floats:
    """
    Return percentiles of some numbers, as `numpy.percentile` does with method='inverted_cdf'.

    NumPy has supported this method since version 1.22, but `numpy.percentile` is several times
    slower than this function.

    Parameters
    ----------
    numbers : array, shape (..., n)
        The numbers. The last axis must have at least one element. The array is sorted in place
        along this axis.
    wanted : sequence of int
        The percentiles to compute, from 1 to 100.

    Returns
    -------
    array, shape (..., len(wanted))
        For each percentile k, the smallest number x in the array such that at least k percent of
        the numbers are less than or equal to x.

    """
    ranks = [-(-k * numbers.shape[-1] // 100) - 1 for k in wanted]
    numbers.sort(axis=-1)
    return numbers[..., ranks]


def histogram(angles: Floats, percentiles: Mapping[str, float]) -> dict[str, Any]:
    """
    Return a histogram of angles, as JSON types.

    Parameters
    ----------
    angles : array, shape (n,), rad
        The angle of each run. There must be at least one.
    percentiles : mapping
        The percentiles 'p1', 'p5', 'p99' and 'p100' of the angles, rad.

    Returns
    -------
    dict
        'edges_rad', shape (m + 1,), contains the edges of the intervals, and 'runs', shape (m,),
        the number of runs in each interval. Normally, the intervals have equal widths and range
        from 0, or from the smallest angle if that is negative, to the largest angle. If the angles
        span several decades, the intervals instead have equal widths on a logarithmic axis. The
        first of these intervals begins at a tenth of the first percentile or at the smallest
        angle, whichever is larger, and also counts all smaller angles.

    """
    bars = min(math.isqrt(angles.size), _BARS)
    largest = max(percentiles['p100'], float(np.finfo(float).tiny))
    if percentiles['p1'] > 0.0 and _DECADES * percentiles['p5'] < percentiles['p99']:
        edges = np.geomspace(max(0.1 * percentiles['p1'], angles.min()), largest, bars + 1)
    else:
        edges = np.linspace(min(0.0, angles.min()), largest, bars + 1)
    counts, _ = np.histogram(np.maximum(angles, edges[0]), edges)
    return {'edges_rad': edges.tolist(), 'runs': counts.tolist()}


def bands(motions: Motions, nominal: Floats, runs: int) -> dict[str, Any]:
    """
    Return percentiles of the angle between the attitude of a run and the nominal attitude.

    Parameters
    ----------
    motions : Motions
        The motions of all runs.
    nominal : array, shape (m, 7)
        The nominal motion at the same times.
    runs : int
        Number of runs that did not fail, at least one.

    Returns
    -------
    dict
        The percentiles as JSON types. 'times_s' contains some of the times of the motions,
        including the first and the last. For each percentile k, 'pk_rad' contains the percentile
        at each of these times.

    """
    rows = np.unique(np.linspace(0, len(motions.times) - 1, _TIMES).astype(int))
    passes = math.ceil(len(rows) / max(_KEPT // runs, 1))
    angles = np.concatenate([percentiles(_angles(motions, nominal, some, runs), _BANDS)
                             for some in np.array_split(rows, passes)])
    return {'times_s': motions.times[rows].tolist(),
            **{f'p{k}_rad': column.tolist() for k, column in zip(_BANDS, angles.T)}}


def _angles(motions: Motions, nominal: Floats, rows: Ints, runs: int) -> Floats:
    """
    Return the angles from the nominal motion at some times, shape (times, runs).

    Only the runs that did not fail are included.
    """
    angles, end = np.empty((len(rows), runs)), 0
    for chunk in motions.chunks():
        attitudes = chunk[np.isfinite(chunk[:, 0, 0])][:, rows, :4]
        first, end = end, end + len(attitudes)
        angles[:, first:end] = so3.angle_between(attitudes, nominal[rows, :4]).T
    return angles


def final(folder: Folder, quantity: str) -> Floats:
    """Return the final value of a quantity in each run. The values of failed runs are NaN."""
    def columns(name: str, axes: str) -> Floats:
        return np.stack([folder.numbers(f'{name}.{axis}') for axis in axes], axis=-1)
    if quantity == ANGLE:
        return folder.numbers(ANGLE)
    if quantity == 'rate':
        return np.asarray(np.sqrt((columns('angular_velocity', 'xyz') ** 2).sum(axis=-1)))
    with np.errstate(invalid='ignore'):
        return np.asarray(so3.angle_between(columns('attitude', 'xyzw'), [0.0, 0.0, 0.0, 1.0]))


def correlations(ensemble: Ensemble, folder: Folder, angles: Floats) -> dict[str, float]:
    """
    Return the rank correlation between the deviation of each parameter and the final angle.

    The final angle, in `angles` for each run, is the angle between the final attitude and the
    nominal final attitude. This angle is correlated with the absolute deviation of the parameter
    from its nominal value.
    """
    from scipy.stats import spearmanr  # slow to import
    return {name: float(spearmanr(*columns)[0])
            for name, *columns in _varied(ensemble, folder, angles, np.abs)}


def effects(ensemble: Ensemble, folder: Folder, numbers: Floats) -> dict[str, float]:
    """
    Return the fraction of the variance of a quantity that each parameter explains.

    `numbers` contains the quantity in each run. The fraction is the adjusted R^2 of a quadratic in
    the parameter, fitted to the ranks of the quantity. The fraction shows effects that change sign
    with the deviation, such as the effect of a gain on a final rate. The fraction also shows
    effects that depend only on the size of the deviation, such as the effect of an initial rate
    that varies about zero. A rank correlation with the deviation would miss effects of this second
    kind.
    """
    return {name: _explained(*columns)
            for name, *columns in _varied(ensemble, folder, numbers, np.asarray)}


def causes(messages: Iterable[str]) -> dict[str, int]:
    """
    Return the number of messages for each cause, in the order in which the causes first occur.

    A cause is the common text of its messages, with '...' in place of numbers that differ.
    """
    counts, common = Counter[str](), dict[str, list[str]]()
    for message in messages:
        text = message.partition(CUT)[0]  # if a message was shortened, keep only its beginning
        pattern, numbers = _NUMBER.sub('\0', text), _NUMBER.findall(text)
        counts[pattern] += 1
        common[pattern] = [number if number == before else _OTHER for number, before in
                           zip(numbers, common.get(pattern, numbers))]
    merged = Counter[str]()  # causes that differ only in the length of a list of numbers are one
    for pattern, count in counts.items():
        pieces = zip_longest(pattern.split('\0'), common[pattern], fillvalue='')
        merged[_OTHERS.sub(_OTHER, ''.join(text + number for text, number in pieces))] += count
    return dict(merged)


def _varied(ensemble: Ensemble, folder: Folder, numbers: Floats,
            measure: Callable[[Floats], Floats]) -> Iterator[tuple[str, Floats, Floats]]:
    """
    Generate the name of each parameter that varies, its measured deviations, and the numbers.

    Both arrays have one element for each of the first runs that did not fail.
    """
    numbers = numbers[:_SAMPLE]
    for name, deviation in _deviations(ensemble, folder):
        succeeded = np.isfinite(numbers) & np.isfinite(deviation)
        columns = measure(deviation[succeeded]), numbers[succeeded]
        if succeeded.sum() > 3 and all(np.ptp(column) > 0.0 for column in columns):
            yield name, *columns


def _explained(deviation: Floats, numbers: Floats) -> float:
    from scipy.stats import rankdata  # slow to import
    ranks = rankdata(numbers) - 0.5 * (1.0 + len(numbers))
    linear = deviation - deviation.mean()
    linear /= np.abs(linear).max()
    square = linear ** 2 - (linear ** 2).mean()
    square -= linear * ((square * linear).sum() / (linear ** 2).sum())
    share = sum(float((term * ranks).sum() ** 2 / ((term ** 2).sum() * (ranks ** 2).sum()))
                for term in (linear, square) if (term ** 2).sum() > _ROUNDING * len(ranks))
    return max(1.0 - (1.0 - share) * (len(ranks) - 1) / (len(ranks) - 3), 0.0)


def _deviations(ensemble: Ensemble, folder: Folder) -> Iterator[tuple[str, Floats]]:
    """
    Generate the name of each parameter, with its deviations from the nominal value.

    The deviations are an array with one number for each run.
    """
    nominal = ensemble.nominal
    attitude = [f'initial_attitude.{axis}' for axis in 'xyzw']
    tilted = np.stack([folder.numbers(name, _SAMPLE) for name in attitude], axis=-1)
    with np.errstate(invalid='ignore'):  # the values of failed runs are NaN
        yield 'initial_attitude', np.asarray(
            so3.angle_between(tilted, [nominal[name] for name in attitude]))
    for name in ensemble.columns:
        if name in nominal and name not in attitude:
            yield name, folder.numbers(name, _SAMPLE) - nominal[name]
