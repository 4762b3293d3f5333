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

"""Draw figures into PNG files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from pathlib import Path
from typing import Any, NamedTuple
import warnings

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import EngFormatter
import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import shortened
from rigid_body_ros.mechanics.torque import torque_logs, TorqueLog
from rigid_body_ros.propagation import Trajectory
from rigid_body_ros.report import style

_GREYS = ('#333333', '#999999')
#: Maximum number of points in a curve. Drawing more points would make no visible difference.
_POINTS = 20_000
#: The number of characters that fit into the title of a picture even if all characters are wide.
_TITLE = 50


def motion(path: str | Path, trajectory: Trajectory, log: TorqueLog | Sequence[TorqueLog],
           sequence: str, title: str, timeout_ns: int = 0,
           fields: Floats | None = None) -> None:
    """
    Draw a motion: Euler angles, quaternion, angular velocity and torque over time, in a PNG file.

    If the rotors have momentum, the figure also shows the rotor momentum.

    Parameters
    ----------
    path : str or Path
        The PNG file. Its name may have any suffix, and an existing file is overwritten.
    trajectory : Trajectory
        The motion, in ascending order of time.
    log : TorqueLog or sequence of TorqueLog
        The torques. Each sample is drawn in the axes in which it is given. Each log has its own
        panel.
    sequence : str
        The sequence of the Euler angles.
    title : str
        The title. It is drawn literally: a $ does not start a formula.
    timeout_ns : int
        The maximum time for which a sample acts, ns, as for `TorqueLog.segments`.
    fields : array, shape (m, 3), N m, body axes, optional
        The torque that the fields apply at the times of the trajectory.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    rows = _drawn(len(trajectory.times_ns))
    start_ns, end_ns = int(trajectory.times_ns[0]), int(trajectory.times_ns[-1])
    seconds = _seconds(trajectory.times_ns[rows], start_ns)
    logs, has_rotors = torque_logs(log), bool(trajectory.rotor_momentum.any())
    count = 3 + has_rotors + len(logs) + (fields is not None)
    figure = Figure(figsize=(9.0, 2.5 * count), layout='constrained')
    figure.suptitle(literal(title))
    panels = figure.subplots(count, 1, sharex=True)
    _draw_angles(panels[0], seconds, trajectory.euler_angles(sequence)[rows], sequence)
    _draw_curves(panels[1], seconds, trajectory.attitude[rows], style.QUATERNION)
    panels[1].set_ylabel('quaternion')
    _draw_vectors(panels[2], seconds, trajectory.angular_velocity[rows], style.RATES,
                  ('angular velocity', 'body axes', 'rad/s'))
    if has_rotors:
        _draw_vectors(panels[3], seconds, trajectory.rotor_momentum[rows], style.MOMENTA,
                      ('rotor momentum', 'body axes', 'N m s'))
    _draw_torques(panels[3 + has_rotors:], logs, (start_ns, end_ns), timeout_ns)
    if fields is not None:
        _draw_vectors(panels[-1], seconds, fields[rows], style.TORQUES,
                      (style.FIELDS, 'body axes', 'N m'))
    figure.align_ylabels(panels)
    panels[-1].set_xlim(0.0, max(float(seconds[-1]), 1e-9))
    label(panels[-1].xaxis, 'time from the start', 's', np.append(seconds, 1e-9))
    save(figure, path, dpi=120)


def work_precision(path: str | Path, curves: Mapping[str, tuple[Sequence[float],
                   Sequence[float]]], title: str, lines: Mapping[str, float]) -> None:
    """
    Draw the cost of solvers against their error into a PNG file, with one curve per solver.

    Parameters
    ----------
    path : str or Path
        The PNG file. Its name may have any suffix, and an existing file is overwritten.
    curves : dict
        For each solver, a list of attitude errors, rad, and a list of costs, in seconds of wall
        time per simulated second. Item i of both lists belongs to setting i of the solver.
    title : str
        The title. It is drawn literally: a $ does not start a formula.
    lines : dict
        Attitude errors to mark with vertical lines, rad, keyed by their labels in the legend.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    figure = Figure(figsize=(7.2, 5.0), layout='constrained')
    figure.suptitle(literal(title), fontsize=10)
    panel = figure.subplots()
    for number, (name, (errors, costs)) in enumerate(curves.items()):
        panel.loglog(errors, costs, style.STYLES[number % len(style.STYLES)],
                     linewidth=1.4, markersize=4.5, color=style.COLOURS[number],
                     marker=style.MARKERS[number], label=name.replace('_', ' '))
    for number, (text, value) in enumerate(lines.items()):
        panel.axvline(value, color=_GREYS[number // len(style.STYLES) % len(_GREYS)],
                      linestyle=style.STYLES[number % len(style.STYLES)], linewidth=1.0, zorder=1,
                      label=text)
    panel.margins(0.08)
    panel.set_xlabel('largest attitude error (rad)')
    panel.set_ylabel('wall time per simulated second (s/s)')
    panel.grid(alpha=0.25)
    legend(panel, fontsize=8)
    save(figure, path, dpi=200)


class Series(NamedTuple):
    """Vectors over time: a name, a unit, times in ns, shape (n,), and values, shape (n, 3)."""

    label: str
    unit: str
    times_ns: NDArray[np.int64]
    values: Floats


def errors(path: str | Path, panels: Sequence[Series], others: Sequence[Series],
           logs: Sequence[TorqueLog], horizons: Mapping[float, Floats], title: str,
           timeout_ns: int = 0) -> None:
    """
    Draw errors over time into a PNG file, on logarithmic axes and with the torques below them.

    Parameters
    ----------
    path : str or Path
        The PNG file. Its name may have any suffix, and an existing file is overwritten.
    panels : sequence of Series
        The errors in body axes. There must be at least one series.
    others : sequence of Series
        Further torques in body axes. They are drawn on linear axes below the torques of the logs.
    logs : sequence of TorqueLog
        The torques, drawn as in `motion`.
    horizons : dict
        The median and the 95th percentile of the attitude error, rad, for each horizon, s.
    title : str
        The title. It is drawn literally: a $ does not start a formula.
    timeout_ns : int
        The maximum time for which a sample acts, ns, as for `TorqueLog.segments`.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    start_ns = min(int(panel.times_ns.min()) for panel in panels)
    end_ns = max(int(panel.times_ns.max()) for panel in panels)
    logs = [log for log in logs if len(log)]
    shared = len(panels) + len(logs) + len(others)
    count = shared + bool(horizons)
    figure = Figure(figsize=(9.0, 2.5 * count), layout='constrained')
    figure.suptitle(literal(title))
    rows = figure.subplots(count, 1, squeeze=False)[:, 0]
    for row, panel in zip(rows, panels):
        _draw_errors(row, panel, start_ns)
    _draw_torques(rows[len(panels):], logs, (start_ns, end_ns), timeout_ns)
    for row, torque in zip(rows[len(panels) + len(logs):shared], others):
        _draw_vectors(row, *_thinned(torque, start_ns), style.TORQUES,
                      (torque.label, 'body axes', torque.unit))
    for row in rows[:shared]:
        row.set_xlim(0.0, max(1e-9 * (end_ns - start_ns), 1e-9))
    rows[shared - 1].set_xlabel('time from the first measurement (s)')
    if horizons:
        _draw_horizons(rows[-1], horizons)
    figure.align_ylabels(rows)
    save(figure, path, dpi=120)


def _draw_errors(row: Axes, series: Series, start_ns: int) -> None:
    seconds, values = _thinned(series, start_ns)
    least = float(np.finfo(float).tiny)
    sizes = np.maximum(np.abs(np.column_stack([np.linalg.norm(values, axis=1), values])), least)
    for column, name, colour, width in zip(sizes.T, style.ERRORS,
                                           ('#000000', *style.COLOURS), (1.2, 0.7, 0.7, 0.7)):
        row.semilogy(seconds, column, color=colour, linewidth=width, label=name,
                     zorder=3 if name == '|e|' else 2)
    shown = sizes[:, 0][sizes[:, 0] > 0.0]
    row.set_ylim(0.03 * float(np.percentile(shown, 5.0)), 3.0 * float(shown.max()))
    row.set_ylabel(f'{series.label} ({series.unit})')
    row.grid(alpha=0.3)
    legend(row, handlelength=2.5)


def _draw_horizons(row: Axes, horizons: Mapping[float, Floats]) -> None:
    seconds = sorted(horizons)
    for column, name in enumerate(('median', '95 %')):
        row.loglog(seconds, [max(float(horizons[each][column]), 1e-16) for each in seconds],
                   style.STYLES[column], color=style.COLOURS[column],
                   marker=style.MARKERS[column], label=name)
    row.set_xlabel('time since the restart from the measurement (s)')
    row.set_ylabel('attitude error (rad)')
    row.grid(alpha=0.3)
    legend(row)


def _thinned(series: Series, start_ns: int) -> tuple[Floats, Floats]:
    rows = _drawn(len(series.times_ns))
    return _seconds(series.times_ns[rows], start_ns), series.values[rows]


def _seconds(times_ns: NDArray[np.int64], start_ns: int) -> Floats:
    return np.asarray((times_ns - start_ns) * 1e-9, np.float64)


def _drawn(count: int) -> NDArray[np.intp]:
    """Return the indices of the rows to draw, out of `count` rows."""
    return np.unique(np.linspace(0, count - 1, _POINTS).astype(np.intp))


def _draw_angles(panel: Axes, seconds: Floats, angles: Floats, sequence: str) -> None:
    _draw_curves(panel, seconds, _without_jumps(angles), style.euler_names(sequence))
    panel.set_ylabel(f'Euler angles {sequence} (rad)')
    low, high = (-2, 2) if angles.min() < 0.0 else (0, 4)
    labels = {-2: '−π', -1: '−π/2', 0: '0', 1: 'π/2', 2: 'π', 3: '3π/2', 4: '2π'}
    panel.set_yticks([number * np.pi / 2.0 for number in range(low, high + 1)],
                     [labels[number] for number in range(low, high + 1)])


def _draw_torques(panels: Iterable[Axes], logs: Sequence[TorqueLog], span_ns: tuple[int, int],
                  timeout_ns: int) -> None:
    for panel, log, name in zip(panels, logs, style.torque_names(len(logs))):
        times = _torque_times(log, *span_ns, timeout_ns)
        torques, _ = log.at(times, timeout_ns)
        _draw_vectors(panel, _seconds(times, span_ns[0]), torques, style.TORQUES,
                      (name, style.axes_name(log.in_space), 'N m'))


def _draw_vectors(panel: Axes, x: Floats, columns: Floats, names: tuple[str, ...],
                  labels: tuple[str, str, str]) -> None:
    """Draw the components of vectors; `labels` contains the quantity, the axes and the unit."""
    quantity, axes, unit = labels
    _draw_curves(panel, x, columns, names)
    label(panel.yaxis, f'{quantity},\n{axes}', unit, columns)


def _draw_curves(panel: Axes, x: Floats, columns: Floats, names: tuple[str, ...]) -> None:
    for column, name, colour, dashes in zip(columns.T, names, style.COLOURS, style.STYLES):
        panel.plot(x, column, dashes, color=colour, linewidth=1.2, label=name)
    panel.grid(alpha=0.3)
    legend(panel, handlelength=2.5)


def _without_jumps(angles: Floats) -> Floats:
    # Do not draw a line from 2 pi back to 0, since it would look like a rotation.
    broken = angles.copy()
    broken[1:][np.abs(np.diff(angles, axis=0)) > np.pi] = np.nan
    return broken


def _torque_times(log: TorqueLog, start_ns: int, end_ns: int,
                  timeout_ns: int) -> NDArray[np.int64]:
    # Sample the torque on a grid. Unless there are too many changes, also sample it just before
    # and after each change, so that steps are vertical.
    changes, _ = log.segments(timeout_ns)
    grid = start_ns + np.linspace(0, end_ns - start_ns, _POINTS // 4).astype(np.int64)
    if 2 * len(changes) <= _POINTS:
        grid = np.concatenate([grid, changes - 1, changes])
    grid = np.unique(grid)
    return grid[(grid >= start_ns) & (grid <= end_ns)]


def literal(title: str) -> str:
    """Shorten a title to fit into the picture, and replace bytes that are not text."""
    return shortened(title.encode(errors='replace').decode(), _TITLE)


def save(figure: Figure, path: str | Path, dpi: int) -> None:
    """
    Save a figure to a PNG file.

    Names are drawn literally, so a $ does not start a formula. Characters that are missing from
    the font are drawn as boxes.
    """
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_text():  # ticks get their text later, often with powers of ten
            text.set_parse_math(False)
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'Glyph|Matplotlib currently does not support')
        FigureCanvasAgg(figure).print_figure(path, dpi=dpi, format='png')


def legend(panel: Axes, **options: Any) -> None:
    """Draw a legend to the right of a panel."""
    panel.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, **options)


def label(axis: Axis, text: str, unit: str, values: Floats) -> None:
    """Label an axis; if all values are small, use a unit with a prefix, such as mrad/s."""
    largest = float(np.abs(values).max())
    exponent = min(3 * math.floor(math.log10(largest) / 3.0), 0) if largest else 0
    exponent = max(exponent, min(EngFormatter.ENG_PREFIXES))
    if exponent:
        axis.set_major_formatter(lambda value, _: _scaled(value, 10.0 ** exponent))
    axis.set_label_text(f'{text} ({EngFormatter.ENG_PREFIXES[exponent]}{unit})')


def _scaled(value: float, scale: float) -> str:
    return f'{round(value / scale, 9) + 0.0:g}'.replace('-', '−')  # + 0.0 turns -0 into 0
