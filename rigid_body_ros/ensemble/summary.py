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

"""How far the runs of an ensemble end from the nominal one, and which parameters matter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.ensemble.bands import bands
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.histogram import histogram
from rigid_body_ros.ensemble.percentiles import percentiles
from rigid_body_ros.ensemble.runs import ANGLE, Ensemble
from rigid_body_ros.mechanics import so3
from rigid_body_ros.report.text import lines

_PERCENTILES = (1, 5, 25, 50, 75, 95, 99, 100)
#: Number of the first runs from which rank correlations are computed.
_SAMPLE = 100_000
#: Number of rank correlations in the text.
_PRINTED = 5


def summarized(ensemble: Ensemble, folder: Folder) -> dict[str, Any]:
    """
    Return the results of a complete ensemble as JSON.

    Returns
    -------
    dict
        Counts of runs and the reasons of failures; percentiles and histogram of the angle from
        the nominal final attitude, rad, empty if all runs failed; and rank correlations of that
        angle with the distance of each dispersed parameter from its nominal value. If the folder
        has times and a run did not fail, 'bands' as well.

    """
    angles = folder.numbers(ANGLE, folder.runs)
    angles = angles[np.isfinite(angles)]
    results: dict[str, Any] = {'angle_from_nominal_rad': {}, 'histogram': {}}
    if angles.size:
        found = dict(zip((f'p{k}' for k in _PERCENTILES),
                         percentiles(angles, _PERCENTILES).tolist()))
        results = {'angle_from_nominal_rad': found, 'histogram': histogram(angles, found)}
        if folder.times is not None:
            results['bands'] = bands(folder, ensemble.nominal_motion, angles.size)
    return {'runs': folder.runs, 'failed': folder.runs - angles.size,
            'failures': folder.failures(), **results,
            'rank_correlation': _correlations(ensemble, folder)}


def text_of(found: Mapping[str, Any]) -> str:
    """Return the results as text for a terminal."""
    depends = [f'{name} (rank correlation {value:.2f})'
               for name, value in ranked(found)[:_PRINTED]]
    names = ['depends on', *[''] * _PRINTED]
    return lines(f'{name:17}{text}' for name, text in [*rows(found), *zip(names, depends)])


def rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the number of runs, the failures and the angles as names and texts."""
    facts = [('runs', str(found['runs'])),
             *(('failed', f'{count}: {cause}') for cause, count in found['failures'].items())]
    angles = found['angle_from_nominal_rad']
    if angles:
        facts.append(('from nominal end', f'median {angles["p50"]:.3g} rad, 95 % below '
                      f'{angles["p95"]:.3g} rad, largest {angles["p100"]:.3g} rad'))
    return facts


def ranked(found: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Return the rank correlations, the strongest first."""
    return sorted(found['rank_correlation'].items(), key=lambda item: -abs(item[1]))


def _correlations(ensemble: Ensemble, folder: Folder) -> dict[str, float]:
    from scipy.stats import spearmanr  # takes long to import
    result, angles = {}, folder.numbers(ANGLE, _SAMPLE)
    for name, distance in _distances(ensemble, folder):
        known = np.isfinite(angles) & np.isfinite(distance)
        varies = known.sum() > 2 and np.ptp(distance[known]) > 0.0 and np.ptp(angles[known]) > 0.0
        if varies:
            result[name] = float(spearmanr(distance[known], angles[known])[0])
    return result


def _distances(ensemble: Ensemble, folder: Folder) -> list[tuple[str, Floats]]:
    """Return the distances of the parameters from their nominal values, in the first runs."""
    nominal = ensemble.nominal
    attitude = [f'initial_attitude.{axis}' for axis in 'xyzw']
    tilted = np.stack([folder.numbers(name, _SAMPLE) for name in attitude], axis=-1)
    with np.errstate(invalid='ignore'):  # failed runs
        tilt = np.asarray(so3.angle_between(tilted, [nominal[name] for name in attitude]))
    return [('initial_attitude', tilt), *(
        (name, np.abs(folder.numbers(name, _SAMPLE) - nominal[name]))
        for name in ensemble.columns if name in nominal and name not in attitude)]
