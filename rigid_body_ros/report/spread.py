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

"""Draw the spread of an ensemble into a PNG file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from rigid_body_ros.report.figures import label, legend, literal, save
from rigid_body_ros.report.style import COLOURS, MARKED, STYLES

#: The largest number of rank correlations that are drawn, beginning with the strongest.
_SHOWN = 10


def draw(path: str | Path, found: Mapping[str, Any], correlations: Sequence[tuple[str, float]],
         title: str) -> None:
    """
    Draw the angles over time, a histogram of the final angles, and the rank correlations.

    Parameters
    ----------
    path : str or Path
        The PNG file, with any suffix. An existing file is overwritten.
    found : mapping
        The results, as in summary.json. At least one run must have succeeded.
    correlations : sequence of (str, float)
        The names and rank correlations of the parameters, beginning with the strongest.
    title : str
        The title, to which the number of runs is appended. The title is drawn literally, so a $
        does not start a formula.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    correlations, bands = correlations[:_SHOWN], found.get('bands')
    heights = [2.5] * (1 + bool(bands))
    if correlations:
        heights.append(0.7 + 0.25 * len(correlations))
    figure = Figure(figsize=(9.0, 0.6 + sum(heights)), layout='constrained')
    failed = f', {found["failed"]} failed' if found['failed'] else ''
    figure.suptitle(f'{literal(title)}\n{found["runs"]} runs{failed}')
    panels = figure.subplots(len(heights), 1, gridspec_kw={'height_ratios': heights},
                             squeeze=False)[:, 0]
    if bands:
        _draw_bands(panels[0], bands, logarithmic=found['histogram']['edges_rad'][0] > 0.0)
    _draw_histogram(panels[int(bool(bands))], found['histogram'], found['angle_from_nominal_rad'])
    if correlations:
        _draw_correlations(panels[-1], correlations)
    save(figure, path, dpi=120)


def _draw_bands(panel: Axes, bands: Mapping[str, Sequence[float]], *, logarithmic: bool) -> None:
    seconds = np.array(bands['times_s'])
    angles = {k: np.array(bands[f'p{k}_rad']) for k in (5, 25, 50, 75, 95)}
    for low, high, alpha in ((5, 95, 0.25), (25, 75, 0.45)):
        panel.fill_between(seconds, angles[low], angles[high], color=COLOURS[0], alpha=alpha,
                           linewidth=0.0, label=f'{low} % to {high} %')
    panel.plot(seconds, angles[50], color=COLOURS[1], linewidth=1.4, label='median')
    if logarithmic:
        positive = angles[5][angles[5] > 0.0]
        panel.set_yscale('log')
        panel.set_ylim(0.5 * float(np.percentile(positive, 5.0)), 2.0 * float(angles[95].max()))
        panel.set_ylabel('angle from the\nnominal attitude (rad)')
    else:
        label(panel.yaxis, 'angle from the\nnominal attitude', 'rad', angles[95])
    panel.set_xlim(0.0, max(float(seconds[-1]), 1e-9))
    panel.set_xlabel('time from the start (s)')
    panel.grid(alpha=0.3)
    legend(panel)


def _draw_histogram(panel: Axes, histogram: Mapping[str, Any],
                    percentiles: Mapping[str, float]) -> None:
    edges = np.array(histogram['edges_rad'])
    panel.stairs(histogram['runs'], edges, fill=True, color='#bbbbbb')
    if edges[0] > 0.0:
        panel.set_xscale('log')
        panel.set_xlabel('angle from the nominal final attitude (rad)')
    else:
        panel.axvline(0.0, color=COLOURS[3], linestyle=STYLES[3], linewidth=1.4, label='nominal')
        label(panel.xaxis, 'angle from the nominal final attitude', 'rad', edges)
    for (key, name), colour, style in zip(MARKED, COLOURS, STYLES):
        panel.axvline(percentiles[key], color=colour, linestyle=style, linewidth=1.4, label=name)
    panel.set_ylabel('runs')
    panel.grid(alpha=0.3)
    legend(panel)


def _draw_correlations(panel: Axes, correlations: Sequence[tuple[str, float]]) -> None:
    names, values = zip(*correlations)
    bars = panel.barh(range(len(names)), values, color=COLOURS[0], height=0.7)
    texts = [f'{round(value, 2) + 0.0:.2f}'.replace('-', '−') for value in values]
    panel.bar_label(bars, texts, padding=3, fontsize=8)
    panel.set_yticks(range(len(names)), [literal(name) for name in names])
    panel.invert_yaxis()
    panel.set_xlim(min(0.0, min(values) - 0.15), 1.1)  # leave room for the numbers
    panel.set_xlabel('rank correlation of this angle with the distance from the nominal value')
    panel.grid(alpha=0.3, axis='x')
    panel.set_axisbelow(True)
