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

"""Show the summary of an ensemble as text and as a report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from rigid_body_ros.ensemble.requirements import ANGLE
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


def text_of(results: Mapping[str, Any], replay: Callable[[int], str]) -> str:
    """
    Return the results as text to print in a terminal.

    Parameters
    ----------
    results : mapping
        The results that `summarized` returns.
    replay : function
        A function that takes a run number and returns the command that recomputes this run.

    """
    shown, requirements = rows(results), results.get('requirements', ())
    if not requirements:  # otherwise, the rows of each requirement list the effects
        shown += _named('depends on', [f'{name} (rank correlation {value:.2f})'
                                       for name, value in strongest(results['rank_correlation'])])
    for requirement in requirements:
        unit = requirement['unit']
        shown += required(requirement) + _named('worst', [
            f'run {worst["run"]}, {worst["value"]:.3g} {unit}: {replay(worst["run"])}'
            for worst in requirement['worst']])
        shown += _named('depends on', [f'{name} (R^2 {value:.2f})'
                                       for name, value in strongest(requirement['effects'])
                                       if value * results['runs'] > _CHANCE])
    return lines(f'{name:17}{text}' for name, text in shown)


def required(requirement: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return rows of the form (name, text) that say how well the runs meet a requirement."""
    share, low, high = (f'{100.0 * share:.3g} %' for share in (
        requirement['share'], *requirement['interval_95']))
    facts = [('required', f'{_limit(requirement)}: met by {share} of the runs (95 % interval '
              f'{low} to {high})')]
    if requirement['percentiles']:
        spread = _spread(requirement['percentiles'], requirement['unit'])
        facts.append(('', f'{_judged(requirement)}: {spread}'))
        if 'after_s' in requirement:
            facts.append(('', f'settling time of {requirement["settled"]} runs: '
                          + _spread(requirement['settling_time_s'], 's')
                          if requirement['settled'] else 'no run settles'))
    return facts


def _limit(requirement: Mapping[str, Any]) -> str:
    """Return a requirement as text."""
    after = f' after {requirement["after_s"]:.12g} s' if 'after_s' in requirement else ''
    return f'{requirement["require"]} {requirement["unit"]}{after}'


def _judged(requirement: Mapping[str, Any]) -> str:
    """Return the name of the number that decides whether a run meets a requirement."""
    return 'overshoot' if 'after_s' in requirement else \
        f'{requirement["require"].split()[0]} at the end'


def _named(name: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    """Return the first few texts as rows (name, text), of which only the first has a name."""
    return [*zip([name, *[''] * _PRINTED], texts[:_PRINTED])]


def rows(results: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return rows of the form (name, text) on the number of runs, the failures and the angles."""
    facts = [('runs', str(results['runs'])),
             *(('failed', f'{count}: {cause}') for cause, count in results['failures'].items())]
    if angles := results['angle_from_nominal_rad']:
        facts.append(('from nominal end', _spread(angles, 'rad')))
    return facts


def _spread(percentiles: Mapping[str, float], unit: str) -> str:
    median, most, largest = (f'{percentiles[name]:.3g} {unit}' for name in ('p50', 'p95', 'p100'))
    return f'median {median}, 95 % below {most}, largest {largest}'


def strongest(shares: Mapping[str, float]) -> list[tuple[str, float]]:
    """Return pairs of names and numbers, beginning with the number of largest magnitude."""
    return sorted(shares.items(), key=lambda item: -abs(item[1]))


def report_of(results: Mapping[str, Any], name: str, replay: Callable[[int], str]) -> Report:
    """
    Return the report of an ensemble.

    Parameters
    ----------
    results : mapping
        The results, as in summary.json.
    name : str
        Name of the recording, or of the scene.
    replay : function
        A function that takes a run number and returns the command that recomputes this run.

    """
    requirements = results.get('requirements', ())
    facts = [*rows(results), *chain.from_iterable(map(required, requirements))]
    tables = [part for requirement in requirements for part in _tables(requirement, replay)]
    angle = f'parameter: {ANGLE}' if requirements else 'parameter'
    tables += _bars(angle, 'rank correlation', strongest(results['rank_correlation']))
    return Report(f'{name}: {results["runs"]} runs', _headline(results), facts,
                  [*panels_of(results)], table=''.join(tables))


def _headline(results: Mapping[str, Any]) -> str:
    """
    Return a headline that tells how many runs meet each requirement.

    If there are no requirements, the headline gives the final angles from the nominal attitude.
    """
    runs, angles = results['runs'], results['angle_from_nominal_rad']
    said = [f'{100.0 * requirement["share"]:.3g} % of {runs} runs meet {_limit(requirement)}'
            for requirement in results.get('requirements', ())]
    if not said and angles:
        said = [f'half of {runs - results["failed"]} runs end within {angles["p50"]:.3g} rad of '
                f'the nominal attitude, 95 % within {angles["p95"]:.3g} rad']
    if results['failed']:
        said.append(f'{results["failed"]} of {runs} runs failed')
    return '; '.join(said)


def _tables(requirement: Mapping[str, Any], replay: Callable[[int], str]) -> Iterator[str]:
    """
    Generate two tables for a requirement.

    The first table shows the effects of the parameters, and the second the worst runs.
    """
    limit, unit = _limit(requirement), requirement['unit']
    yield from _bars(f'parameter: {limit}', 'explains (R²)', strongest(requirement['effects']))
    worst = [(str(run['run']), f'{run["value"]:.3g} {unit}', replay(run['run']))
             for run in requirement['worst']]
    if worst:
        yield table((f'worst run: {limit}', _judged(requirement), 'computed again by'), worst)


def _bars(name: str, number: str, shares: Sequence[tuple[str, float]]) -> Iterator[str]:
    cells = [(key, f'{round(value, 2) + 0.0:.2f}', _bar(value)) for key, value in shares]
    if cells:
        yield table((name, number, ''), cells)


def panels_of(results: Mapping[str, Any]) -> Iterator[Panel]:
    """Generate the panels of the results: angles over time, and histograms."""
    histogram, bands = results['histogram'], results.get('bands')
    if bands:
        angles = {k: np.array(bands[f'p{k}_rad'])[:, None] for k in (5, 25, 50, 75, 95)}
        yield Panel('angle from the nominal attitude', 'rad', [
            Curves(np.array(bands['times_s']), angles[low], angles[high], [name], style=style)
            for low, high, name, style in _BANDS],
            kind='log' if histogram['edges_rad'][0] > 0.0 else 'linear')
    if histogram:
        yield _bins(histogram['edges_rad'], histogram['runs'], results['angle_from_nominal_rad'],
                    'angle from the nominal final attitude', 'rad')
    for requirement in results.get('requirements', ()):
        limit = 0.0 if 'after_s' in requirement else float(requirement['require'].split()[-1])
        if requirement['histogram']:
            panel = _bins(**requirement['histogram'], percentiles=requirement['percentiles'],
                          label=_judged(requirement), unit=requirement['unit'])
            yield replace(panel, lines={**panel.lines, 'limit': limit})


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
