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

"""Summarize how far the final attitudes are from the nominal one, and which parameters matter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from rigid_body_ros.ensemble.bands import bands
from rigid_body_ros.ensemble.effects import correlations, effects
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.histogram import histogram
from rigid_body_ros.ensemble.percentiles import percentiles
from rigid_body_ros.ensemble.requirements import PERCENTILES, Requirement
from rigid_body_ros.ensemble.runs import ANGLE, Ensemble
from rigid_body_ros.report.text import lines

#: Maximum number of parameters to list in the text.
_PRINTED = 5
#: An R^2 may be due to chance if it is smaller than this number divided by the number of runs.
_CHANCE = 10.0


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
        'requirements' is present if there are requirements. For each requirement, this entry
        describes how well the runs meet the requirement, and how much each parameter affects the
        required quantity.

    """
    angles = folder.numbers(ANGLE, folder.runs)
    angles = angles[np.isfinite(angles)]
    results: dict[str, Any] = {'angle_from_nominal_rad': {}, 'histogram': {}}
    if angles.size:
        found = dict(zip((f'p{k}' for k in PERCENTILES),
                         percentiles(angles, PERCENTILES).tolist()))
        results = {'angle_from_nominal_rad': found, 'histogram': histogram(angles, found)}
        if folder.times is not None:
            results['bands'] = bands(folder, ensemble.nominal_motion, angles.size)
    return {'runs': folder.runs, 'failed': folder.runs - angles.size,
            'failures': folder.failures(), **results,
            'rank_correlation': correlations(ensemble, folder),
            **({'requirements': [{**one.judged(folder),
                                  'effects': effects(ensemble, folder, one.quantity)}
                                 for one in requirements]} if requirements else {})}


def text_of(found: Mapping[str, Any], replay: Callable[[int], str]) -> str:
    """
    Return the results as text to print in a terminal.

    Parameters
    ----------
    found : mapping
        The results that `summarized` returns.
    replay : function
        A function that takes a run number and returns the command that recomputes this run.

    """
    depends = [f'{name} (rank correlation {value:.2f})' for name, value in ranked(found)]
    if found.get('requirements'):  # the rows of each requirement list the effects instead
        depends = []
    shown = [*rows(found), *_named('depends on', depends)]
    for one in found.get('requirements', ()):
        shown += required(one) + _named('worst', [
            f'run {worst["run"]}, {worst["value"]:.3g} {one["unit"]}: {replay(worst["run"])}'
            for worst in one['worst']])
        shown += _named('depends on', [f'{name} (R^2 {value:.2f})'
                                       for name, value in strongest(one['effects'])
                                       if value * found['runs'] > _CHANCE])
    return lines(f'{name:17}{text}' for name, text in shown)


def required(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return rows of the form (name, text) that say how well the runs meet a requirement."""
    low, high = (f'{100.0 * limit:.3g}' for limit in found['interval_95'])
    quantity, unit = found['require'].split()[0], found['unit']
    facts = [('required', f'{found["require"]} {unit}: met by {100.0 * found["share"]:.3g} % of '
              f'the runs (95 % interval {low} % to {high} %)')]
    values = found['percentiles']
    if values:
        facts.append(('', f'{quantity} at the end: median {values["p50"]:.3g} {unit}, 95 % below '
                      f'{values["p95"]:.3g} {unit}, largest {values["p100"]:.3g} {unit}'))
    return facts


def _named(name: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    """Return the first few texts as rows (name, text), of which only the first has a name."""
    return [*zip([name, *[''] * _PRINTED], texts[:_PRINTED])]


def rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return rows of the form (name, text) on the number of runs, the failures and the angles."""
    facts = [('runs', str(found['runs'])),
             *(('failed', f'{count}: {cause}') for cause, count in found['failures'].items())]
    angles = found['angle_from_nominal_rad']
    if angles:
        facts.append(('from nominal end', f'median {angles["p50"]:.3g} rad, 95 % below '
                      f'{angles["p95"]:.3g} rad, largest {angles["p100"]:.3g} rad'))
    return facts


def ranked(found: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Return the rank correlations, beginning with the strongest."""
    return strongest(found['rank_correlation'])


def strongest(found: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return pairs of names and numbers, beginning with the number of largest magnitude."""
    return sorted(found.items(), key=lambda item: -abs(item[1]))
