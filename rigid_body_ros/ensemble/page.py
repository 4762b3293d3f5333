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

"""Assemble the HTML page that shows the results of an ensemble."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rigid_body_ros.ensemble.runs import ANGLE
from rigid_body_ros.ensemble.summary import ranked, required, rows, strongest
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.page import Markup, Page, table
from rigid_body_ros.report.style import MARKED
from rigid_body_ros.scene import Scene

#: `_WIDTH` is the length of a bar for a rank correlation or R^2 of 1. `_HEIGHT` is the height of
#: all bars. Both are in units of the drawing.
_WIDTH, _HEIGHT = 100.0, 10.0

#: For each band in the plot over time: the lower and upper percentile, the name and the style.
_BANDS = ((5, 95, '5 % to 95 %', 'band'), (25, 75, '25 % to 75 %', 'band'),
          (50, 50, 'median', 'line'))


def page(found: Mapping[str, Any], name: str, scene: Scene, command: str,
         replay: Callable[[int], str]) -> Page:
    """
    Return a page that shows the results of an ensemble.

    Parameters
    ----------
    found : mapping
        The results, as in summary.json.
    name : str
        Name of the recording, or of the scene.
    scene : Scene
        The scene of the nominal motion.
    command : str
        The command line that computed the ensemble.
    replay : function
        A function that takes a run number and returns the command that recomputes this run.

    """
    requirements = found.get('requirements', ())
    facts = [*rows(found), *(fact for one in requirements for fact in required(one))]
    tables = [part for one in requirements for part in _tables(one, replay)]
    angle = f'parameter: {ANGLE}' if requirements else 'parameter'
    tables += _bars(angle, 'rank correlation', ranked(found))
    return Page(f'{name}: {found["runs"]} runs', _headline(found), facts, [*_panels(found)],
                warnings=scene.warnings, scene=scene, command=command, table=''.join(tables))


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


def _panels(found: Mapping[str, Any]) -> Iterator[Panel]:
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
                 {name: percentiles[key] for key, name in MARKED})


def _bar(correlation: float) -> Markup:
    """Draw a bar for a rank correlation or an R^2. Negative values have a different colour."""
    colour = 'c1' if correlation < 0.0 else 'c0'
    return Markup(f'<svg class="share" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" aria-hidden="true">'
                  f'<rect class="bar {colour}" width="{_WIDTH * abs(correlation):.1f}" '
                  f'height="{_HEIGHT:g}"/></svg>')
