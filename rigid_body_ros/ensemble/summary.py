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

"""Judge requirements on the final states, and summarize the results as text and as a report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
import math
import operator
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.ensemble import distributions
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.runs import ANGLE, Ensemble
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.report import Markup, Report, table
from rigid_body_ros.report.text import lines

#: Maximum number of parameters to list in the text.
_PRINTED = 5
#: An R^2 may be due to chance if it is smaller than this number divided by the number of runs.
_CHANCE = 10.0
#: `_WIDTH` is the length of a bar for a rank correlation or R^2 of 1. `_HEIGHT` is the height of
#: all bars. Both are in units of the drawing.
_WIDTH, _HEIGHT = 100.0, 10.0

#: For each band in the plot over time: the lower and upper percentile, the name and the style.
_BANDS = ((5, 95, '5 % to 95 %', 'band'), (25, 75, '25 % to 75 %', 'band'),
          (50, 50, 'median', 'line'))
#: The percentiles to mark in a histogram, and their names.
_MARKED = (('p5', '5 %'), ('p50', 'median'), ('p95', '95 %'))
#: The quantities that a requirement can limit, and their units.
UNITS = {'rate': 'rad/s', 'angle': 'rad', ANGLE: 'rad'}
#: How many of the worst runs are reported.
_WORST = 5
_RELATIONS: dict[str, Callable[[Floats, float], NDArray[np.bool_]]] = {
    '<': operator.lt, '<=': operator.le, '>': operator.gt, '>=': operator.ge}
_EXPRESSION = re.compile(r'\s*(\w+)\s*(<=|>=|<|>)\s*(\S+)\s*')
#: The probability of each tail of a confidence interval.
_TAIL = 0.025


@dataclass(frozen=True)
class Requirement:
    """
    A limit on a quantity at the end of a run.

    Attributes
    ----------
    quantity : str
        What is limited. 'rate' is the angular speed of the body, rad/s. 'angle' is the angle
        between the space axes and the body axes, rad. 'angle_from_nominal' is the angle between
        the body axes in this run and in the nominal run, rad.
    relation : str
        '<', '<=', '>' or '>='.
    limit : float

    """

    quantity: str
    relation: str
    limit: float

    @classmethod
    def read(cls, text: str) -> Requirement:
        """Parse a requirement such as 'rate < 0.05'; raise InputError if the text is invalid."""
        found = _EXPRESSION.fullmatch(text)
        with suppress(ValueError):
            if found and found[1] in UNITS and math.isfinite(limit := float(found[3])):
                return cls(found[1], found[2], limit)
        raise InputError(f'expected one of {", ".join(UNITS)}, then <, <=, > or >=, and a '
                         f"number, such as 'rate < 0.05', found {quoted(text)}")

    def __str__(self) -> str:
        return f'{self.quantity} {self.relation} {self.limit:.12g}'

    def judged(self, ensemble: Ensemble, folder: Folder) -> dict[str, Any]:
        """
        Judge how well the runs of a complete folder meet the requirement.

        Returns
        -------
        dict
            The result as JSON types. 'met' is the number of runs that meet the requirement; failed
            runs never meet it. 'share' is 'met' divided by the number of all runs, and
            'interval_95' is the 95 % confidence interval of 'share'. 'percentiles' and 'histogram'
            describe the quantity, and are empty if all runs failed. 'worst' lists the worst runs.
            'effects' says how much each parameter affects the quantity.

        """
        numbers = distributions.final(folder, self.quantity)
        with np.errstate(invalid='ignore'):  # the values of failed runs are NaN
            met = int(_RELATIONS[self.relation](numbers, self.limit).sum())
        values, bars = distributions.distribution(numbers)
        return {'require': str(self), 'unit': UNITS[self.quantity], 'met': met,
                'share': met / folder.runs, 'interval_95': interval(met, folder.runs),
                'percentiles': values,
                'histogram': bars and {'edges': bars['edges_rad'], 'runs': bars['runs']},
                'worst': self._worst(numbers),
                'effects': distributions.effects(ensemble, folder, numbers)}

    def _worst(self, numbers: Floats) -> list[dict[str, Any]]:
        """
        Return the worst runs, beginning with the worst run.

        Runs with equal numbers are in the order of their run numbers.
        """
        order = np.argsort(-numbers if self.relation in ('<', '<=') else numbers, kind='stable')
        return [{'run': run, 'value': float(numbers[run])} for run in order[:_WORST].tolist()
                if math.isfinite(numbers[run])]


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
        `Requirement.judged` for each of them.

    """
    angles = folder.numbers(ANGLE)
    succeeded = int(np.isfinite(angles).sum())
    found, bars = distributions.distribution(angles)
    results = {'runs': folder.runs, 'failed': folder.runs - succeeded,
               'failures': distributions.causes(folder.messages()),
               'angle_from_nominal_rad': found, 'histogram': bars}
    if succeeded and folder.motions:
        results['bands'] = distributions.bands(folder.motions, ensemble.nominal_motion, succeeded)
    results['rank_correlation'] = distributions.correlations(ensemble, folder, angles)
    if requirements:
        results['requirements'] = [one.judged(ensemble, folder) for one in requirements]
    return results


def interval(met: int, runs: int) -> list[float]:
    """Return the Clopper-Pearson 95 % confidence interval for a probability."""
    from scipy.special import betaincinv  # slow to import
    return [float(betaincinv(met, runs - met + 1, _TAIL)) if met else 0.0,
            float(betaincinv(met + 1, runs - met, 1.0 - _TAIL)) if met < runs else 1.0]


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
    shown, requirements = rows(found), found.get('requirements', ())
    if not requirements:  # otherwise, the rows of each requirement list the effects
        shown += _named('depends on', [f'{name} (rank correlation {value:.2f})'
                                       for name, value in strongest(found['rank_correlation'])])
    for one in requirements:
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
    if found['percentiles']:
        facts.append(('', f'{quantity} at the end: {_spread(found["percentiles"], unit)}'))
    return facts


def _named(name: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    """Return the first few texts as rows (name, text), of which only the first has a name."""
    return [*zip([name, *[''] * _PRINTED], texts[:_PRINTED])]


def rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return rows of the form (name, text) on the number of runs, the failures and the angles."""
    facts = [('runs', str(found['runs'])),
             *(('failed', f'{count}: {cause}') for cause, count in found['failures'].items())]
    if angles := found['angle_from_nominal_rad']:
        facts.append(('from nominal end', _spread(angles, 'rad')))
    return facts


def _spread(percentiles: Mapping[str, float], unit: str) -> str:
    median, most, largest = (f'{percentiles[name]:.3g} {unit}' for name in ('p50', 'p95', 'p100'))
    return f'median {median}, 95 % below {most}, largest {largest}'


def strongest(found: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return pairs of names and numbers, beginning with the number of largest magnitude."""
    return sorted(found.items(), key=lambda item: -abs(item[1]))


def report_of(found: Mapping[str, Any], name: str, replay: Callable[[int], str]) -> Report:
    """
    Return the report of an ensemble.

    Parameters
    ----------
    found : mapping
        The results, as in summary.json.
    name : str
        Name of the recording, or of the scene.
    replay : function
        A function that takes a run number and returns the command that recomputes this run.

    """
    requirements = found.get('requirements', ())
    facts = [*rows(found), *(fact for one in requirements for fact in required(one))]
    tables = [part for one in requirements for part in _tables(one, replay)]
    angle = f'parameter: {ANGLE}' if requirements else 'parameter'
    tables += _bars(angle, 'rank correlation', strongest(found['rank_correlation']))
    return Report(f'{name}: {found["runs"]} runs', _headline(found), facts, [*panels_of(found)],
                  table=''.join(tables))


def _headline(found: Mapping[str, Any]) -> str:
    """
    Return a headline that tells how many runs meet each requirement.

    If there are no requirements, the headline gives the final angles from the nominal attitude.
    """
    runs, angles = found['runs'], found['angle_from_nominal_rad']
    said = [f'{100.0 * one["share"]:.3g} % of {runs} runs meet {one["require"]} {one["unit"]}'
            for one in found.get('requirements', ())]
    if not said and angles:
        said = [f'half of {runs - found["failed"]} runs end within {angles["p50"]:.3g} rad of the '
                f'nominal attitude, 95 % within {angles["p95"]:.3g} rad']
    if found['failed']:
        said.append(f'{found["failed"]} of {runs} runs failed')
    return '; '.join(said)


def _tables(one: Mapping[str, Any], replay: Callable[[int], str]) -> Iterator[str]:
    """
    Generate two tables for a requirement.

    The first table shows the effects of the parameters, and the second the worst runs.
    """
    yield from _bars(f'parameter: {one["require"]}', 'explains (R²)', strongest(one['effects']))
    worst = [(str(each['run']), f'{each["value"]:.3g} {one["unit"]}', replay(each['run']))
             for each in one['worst']]
    if worst:
        yield table((f'worst run: {one["require"]}', 'at the end', 'computed again by'), worst)


def _bars(name: str, number: str, found: Sequence[tuple[str, float]]) -> Iterator[str]:
    cells = [(key, f'{round(value, 2) + 0.0:.2f}', _bar(value)) for key, value in found]
    if cells:
        yield table((name, number, ''), cells)


def panels_of(found: Mapping[str, Any]) -> Iterator[Panel]:
    """Generate the panels of the results: angles over time, and histograms."""
    histogram, bands = found['histogram'], found.get('bands')
    if bands:
        angles = {k: np.array(bands[f'p{k}_rad'])[:, None] for k in (5, 25, 50, 75, 95)}
        yield Panel('angle from the nominal attitude', 'rad', [
            Curves(np.array(bands['times_s']), angles[low], angles[high], [name], style=style)
            for low, high, name, style in _BANDS],
            kind='log' if histogram['edges_rad'][0] > 0.0 else 'linear')
    if histogram:
        yield _bins(histogram['edges_rad'], histogram['runs'], found['angle_from_nominal_rad'],
                    'angle from the nominal final attitude', 'rad')
    for one in found.get('requirements', ()):
        quantity, _, limit = one['require'].split()
        if one['histogram']:
            panel = _bins(**one['histogram'], percentiles=one['percentiles'],
                          label=f'{quantity} at the end', unit=one['unit'])
            yield replace(panel, lines={**panel.lines, 'limit': float(limit)})


def _bins(edges: Sequence[float], runs: Sequence[int], percentiles: Mapping[str, float],
          label: str, unit: str) -> Panel:
    counts = np.array([*runs, 0], float)[:, None]
    return Panel(f'runs by {label}', '', [Curves(np.array(edges), 0.0 * counts, counts, ['runs'],
                                                 step=True, style='band')],
                 f'{label} ({unit})', 'logx' if edges[0] > 0.0 else 'linear',
                 {name: percentiles[key] for key, name in _MARKED})


def _bar(correlation: float) -> Markup:
    """Draw a bar for a rank correlation or an R^2. Negative values have a different colour."""
    colour = 'c1' if correlation < 0.0 else 'c0'
    return Markup(f'<svg class="share" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" aria-hidden="true">'
                  f'<rect class="bar {colour}" width="{_WIDTH * abs(correlation):.1f}" '
                  f'height="{_HEIGHT:g}"/></svg>')
