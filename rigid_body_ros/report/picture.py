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

"""Draw the panels of a report into a PNG file."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
import math
from pathlib import Path
from typing import Any
import warnings

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import EngFormatter
import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import shortened
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.report import Report

#: The palette of Okabe and Ito, which is suitable for colour-blind readers. In greyscale, curves
#: can be told apart by their dashes.
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#000000', '#CC79A7', '#56B4E9')
STYLES = ('-', '--', '-.', ':')
MARKERS = ('o', 's', '^', 'D', 'v', 'x')
#: More panels than this are drawn in two columns. A picture with one panel is taller.
_ONE_COLUMN, _WIDE, _ROW, _SINGLE = 6, 9.0, 2.5, 5.0
#: Numbers of characters that fit into the titles of the picture and of a panel, even if all
#: characters are wide.
_TITLE, _LABEL = 50, 70
_GREYS = '#333333', '#999999'
#: How to draw the curves of each style: broad lines lie behind the lines that they are compared
#: with.
_DRAWN: dict[str, dict[str, Any]] = {
    'line': {'linewidth': 1.2}, 'broad': {'linewidth': 3.5, 'alpha': 0.35, 'zorder': 1.5},
    'front': {'linewidth': 5.0, 'alpha': 0.3, 'zorder': 1.5, 'linestyle': '-'},
    'marks': {'linestyle': '', 'marker': '.', 'alpha': 0.6}}
#: Names of the multiples of a quarter turn.
_TURNS = {-2: '−π', -1: '−π/2', 0: '0', 1: 'π/2', 2: 'π', 3: '3π/2', 4: '2π'}


def draw(path: str | Path, report: Report) -> None:
    """
    Draw the panels of a report into a PNG file.

    An existing file is overwritten, and the name may have any suffix. All names are drawn
    literally: a $ does not start a formula. Characters that are missing from the font are drawn as
    boxes.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    panels = report.panels
    columns = 1 if len(panels) <= _ONE_COLUMN else 2
    rows = max(-(-len(panels) // columns), 1)
    height = _SINGLE if len(panels) == 1 else 0.6 + _ROW * rows
    figure = Figure(figsize=(_WIDE * columns, height), layout='constrained')
    figure.suptitle(_literal(report.title, _TITLE))
    places = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, panel in zip(places, panels):
        _draw_panel(axes, panel)
    for axes in places[len(panels):]:
        axes.set_axis_off()
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_text():  # ticks get their text later, often with powers of ten
            text.set_parse_math(False)
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Glyph|Matplotlib currently does not support')
        FigureCanvasAgg(figure).print_figure(path, dpi=120, format='png')


def _draw_panel(axes: Axes, panel: Panel) -> None:
    axes.set_title(_literal(panel.label, _LABEL), loc='left', fontsize=9.0)
    axes.set_xlabel(panel.x_label)
    axes.grid(alpha=0.3)
    if panel.kind in ('loglog', 'logx'):
        axes.set_xscale('log')
    if panel.kind in ('loglog', 'log'):
        axes.set_yscale('log', nonpositive='mask')
    shades = cycle((COLOURS[5], COLOURS[0]))
    for number, curves in enumerate(sorted(
            panel.curves, key=lambda curves: curves.style == 'marks')):
        _draw_curves(axes, panel, curves, number, next(shades) if curves.style == 'band' else '')
    for (name, x), (colour, dashes) in zip(panel.lines.items(), cycle(
            (colour, dashes) for colour in _GREYS for dashes in STYLES)):
        axes.axvline(x, color=colour, linestyle=dashes, linewidth=1.0, zorder=1,
                     label=_literal(name, _TITLE))
    _set_limits(axes, panel)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False,
                    handlelength=2.5, fontsize='small')


def _draw_curves(axes: Axes, panel: Panel, curves: Curves, number: int, shade: str) -> None:
    names = [_literal(name, _TITLE) or None for name in curves.names]
    if curves.style == 'band':
        _draw_band(axes, curves, names, shade)
        return
    markers = MARKERS[number % len(MARKERS)] if number < len(panel.texts) else ''
    # Noise is easier to see in thin, solid lines.
    thin = {'linewidth': 0.7, 'linestyle': '-'} if curves.style == 'line' and any(
        others.style == 'limits' for others in panel.curves) else {}
    first = number if panel.texts else 0  # one curve for each of several settings
    if curves.style == 'marks':
        low, high = axes.get_ylim()
    for column, name in enumerate(names):
        look = (column + first) % len(COLOURS)
        options = {'color': COLOURS[look], 'linestyle': STYLES[look % len(STYLES)],
                   'label': name, 'marker': markers, **_DRAWN.get(curves.style, {}), **thin}
        if curves.style == 'limits':
            colour = COLOURS[look] if len(names) > 1 else '#000000'
            for values, label in ((curves.low, None), (curves.high, name)):
                axes.plot(curves.x, values[:, column], '--', color=colour, linewidth=0.9,
                          label=label)
        elif curves.style == 'marks':
            axes.plot(curves.x, np.clip(curves.high[:, column], low, high), **options)
        else:
            axes.plot(*_joined(curves, column, math.pi if panel.kind == 'angle' else math.inf),
                      drawstyle='steps-post' if curves.step else 'default', **options)
    if curves.style == 'marks':
        axes.set_ylim(low, high)


def _draw_band(axes: Axes, curves: Curves, names: Sequence[str | None], shade: str) -> None:
    if curves.step:
        axes.stairs(curves.high[:-1, 0], curves.x, fill=True, color='#bbbbbb')
        axes.set_ylim(bottom=0.0)
        return
    for name, low, high, colour in zip(names, curves.low.T, curves.high.T,
                                       COLOURS if len(names) > 1 else [shade]):
        axes.fill_between(curves.x, low, high, color=colour, alpha=0.5, linewidth=0.0, label=name)


def _joined(curves: Curves, column: int, jump: float) -> tuple[Floats, Floats]:
    """Return the points of a curve, with NaN at gaps, and where it jumps by more than `jump`."""
    x, low, high = curves.x, curves.low[:, column], curves.high[:, column]
    breaks = np.abs(np.diff(high)) > jump
    if curves.gap is not None:
        breaks |= np.diff(x) > curves.gap
    if not np.array_equal(low, high):  # draw both extremes of each interval
        x, high, breaks = np.repeat(x, 2), np.ravel([low, high], 'F'), np.repeat(breaks, 2)
        breaks[::2] = False
        breaks = np.insert(breaks, 0, False)
    rows = np.flatnonzero(breaks) + 1
    return np.insert(x, rows, np.nan), np.insert(high, rows, np.nan)


def _set_limits(axes: Axes, panel: Panel) -> None:
    shown = [curves for curves in panel.curves if curves.style != 'marks' and len(curves.x)]
    values = np.concatenate([[0.0], *(values.ravel() for curves in shown
                                      for values in (curves.low, curves.high))])
    if panel.kind == 'linear' and shown:
        axes.set_xlim(min(curves.x[0] for curves in shown), max(
            1e-9, *(curves.x[-1] for curves in shown), *panel.lines.values()))
        _label(axes.yaxis, panel.unit, values)
    else:
        axes.set_ylabel(panel.unit and f'({panel.unit})')
    if panel.kind == 'angle':
        low, high = (-2, 2) if values.min() < 0.0 else (0, 4)
        ticks = range(low, high + 1)
        axes.set_yticks([0.5 * math.pi * number for number in ticks],
                        [_TURNS[number] for number in ticks])
        axes.set_xlim(shown[0].x[0], max(1e-9, shown[0].x[-1]))
    elif panel.kind == 'log' and (positive := values[values > 0.0]).size:
        axes.set_ylim(0.5 * float(np.percentile(positive, 2.0)), 2.0 * float(positive.max()))


def _label(axis: Axis, unit: str, values: Floats) -> None:
    """Label an axis; if all values are small, use a unit with a prefix, such as mrad/s."""
    largest = float(np.abs(values).max())
    exponent = min(3 * math.floor(math.log10(largest) / 3.0), 0) if largest and unit else 0
    exponent = max(exponent, min(EngFormatter.ENG_PREFIXES))
    if exponent:
        axis.set_major_formatter(lambda value, _: _scaled(value, 10.0 ** exponent))
    axis.set_label_text(unit and f'({EngFormatter.ENG_PREFIXES[exponent]}{unit})')


def _scaled(value: float, scale: float) -> str:
    return f'{round(value / scale, 9) + 0.0:g}'.replace('-', '−')  # + 0.0 turns -0 into 0


def _literal(text: str, most: int) -> str:
    """Shorten a text to fit into the picture, and replace bytes that are not text."""
    return shortened(text.encode(errors='replace').decode(), most)
