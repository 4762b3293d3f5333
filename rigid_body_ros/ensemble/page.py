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

"""Put the page of an ensemble together."""

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

#: Length of the bar of a rank correlation or R^2 of 1, and height of its picture, in its own
#: units.
_WIDTH, _HEIGHT = 100.0, 20.0

#: Percentiles over time, and their names.
_BANDS = (('p5_rad', '5 %'), ('p25_rad', '25 %'), ('p50_rad', 'median'), ('p75_rad', '75 %'),
          ('p95_rad', '95 %'))


def page(found: Mapping[str, Any], name: str, scene: Scene, command: str,
         replay: Callable[[int], str]) -> Page:
    """
    Return the page of an ensemble.

    Parameters
    ----------
    found : mapping
        The results, as in summary.json.
    name : str
        Name of the recording, or of the scene.
    scene : Scene
        The scene of the nominal motion.
    command : str
        The command line.
    replay : function
        Returns the command that computes a run again.

    """
    requirements = found.get('requirements', ())
    facts = [*rows(found), *(fact for one in requirements for fact in required(one))]
    tables = [part for one in requirements for part in _tables(one, replay)]
    angle = f'parameter: {ANGLE}' if requirements else 'parameter'
    tables += _bars(angle, 'rank correlation', ranked(found))
    return Page(f'{name}: {found["runs"]} runs', facts, [*_panels(found)],
                warnings=scene.warnings, scene=scene, command=command, table=''.join(tables))


def _tables(one: Mapping[str, Any], replay: Callable[[int], str]) -> Iterator[str]:
    """Generate the worst runs of a requirement, and the effects of the parameters."""
    worst = [(str(each['run']), f'{each["value"]:.3g} {one["unit"]}', replay(each['run']))
             for each in one['worst']]
    if worst:
        yield table((f'worst run: {one["require"]}', 'at the end', 'computed again by'), worst)
    yield from _bars(f'parameter: {one["require"]}', 'explains (R^2)', strongest(one['effects']))


def _bars(name: str, number: str, found: Sequence[tuple[str, float]]) -> Iterator[str]:
    cells = [(key, f'{round(value, 2) + 0.0:.2f}', _bar(value)) for key, value in found]
    if cells:
        yield table((name, number, ''), cells)


def _panels(found: Mapping[str, Any]) -> Iterator[Panel]:
    histogram, bands = found['histogram'], found.get('bands')
    if bands:
        angles = np.array([bands[key] for key, _ in _BANDS]).T
        yield Panel('angle from the nominal attitude', 'rad', [Curves(
            np.array(bands['times_s']), angles, angles, [name for _, name in _BANDS])],
            kind='log' if histogram['edges_rad'][0] > 0.0 else 'linear')
    if histogram:
        yield _bins(histogram['edges_rad'], histogram['runs'], found['angle_from_nominal_rad'],
                    'angle from the nominal final attitude (rad)')
    for one in found.get('requirements', ()):
        quantity, _, limit = one['require'].split()
        if one['histogram']:
            panel = _bins(**one['histogram'], percentiles=one['percentiles'],
                          label=f'{quantity} at the end ({one["unit"]})')
            yield replace(panel, lines={**panel.lines, 'limit': float(limit)})


def _bins(edges: Sequence[float], runs: Sequence[int], percentiles: Mapping[str, float],
          label: str) -> Panel:
    counts = np.array([0, *runs, 0], float)[:, None]
    return Panel('runs', '', [Curves(np.array([edges[0], *edges]), counts, counts, ['runs'],
                                     step=True)],
                 label, 'logx' if edges[0] > 0.0 else 'linear',
                 {name: percentiles[key] for key, name in MARKED})


def _bar(correlation: float) -> Markup:
    """Return a rank correlation, or an R^2, as a bar from the middle of a picture."""
    left, width = _WIDTH * min(0.0, correlation), _WIDTH * abs(correlation)
    return Markup(f'<svg class="picture" viewBox="{-_WIDTH:g} 0 {2 * _WIDTH:g} {_HEIGHT:g}" '
                  f'aria-hidden="true"><rect class="bar c0" x="{left:.1f}" y="4" '
                  f'width="{width:.1f}" height="{_HEIGHT - 8.0:g}"/></svg>')
