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

"""Figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.propagation import Trajectory
from rigid_body_ros.torque import TorqueLog

#: Okabe and Ito's colours, which the colour-blind tell apart; the styles do so in greyscale.
_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#000000', '#CC79A7', '#56B4E9')
_STYLES = ('-', '--', '-.', ':')
_MARKERS = ('o', 's', '^', 'D', 'v', 'x')
#: More points than this a curve has no pixels for.
_POINTS = 20_000


def motion(path: str | Path, trajectory: Trajectory, log: TorqueLog, sequence: str,
           title: str, timeout_ns: int = 0) -> None:
    """
    Draw Euler angles, quaternion, angular velocity and torque over time into a PNG file.

    Parameters
    ----------
    path : str or Path
        A PNG file whatever its name, written over if it is there.
    trajectory : Trajectory
        In ascending order of time.
    log : TorqueLog
        Drawn in the axes that its samples are given in.
    sequence : str
        Of the Euler angles.
    title : str
        Drawn as it stands: a $ in it begins no formula.
    timeout_ns : int
        As for `TorqueLog.segments`.

    """
    rows = np.unique(np.linspace(0, len(trajectory.times_ns) - 1, _POINTS).astype(int))
    start_ns, end_ns = trajectory.times_ns[0], trajectory.times_ns[-1]
    seconds = (trajectory.times_ns[rows] - start_ns) * 1e-9
    angles = trajectory.euler_angles(sequence)[rows]
    names = (('φ', 'θ', 'ψ') if sequence == 'ZXZ' else
             tuple(f'{axis}{number}' for number, axis in enumerate(sequence, 1)))
    figure = Figure(figsize=(9.0, 10.0), layout='constrained')
    # A file name is no formula, and need not be text.
    figure.suptitle(title.encode(errors='replace').decode(), parse_math=False)
    panels = figure.subplots(4, 1, sharex=True)
    _curves(panels[0], seconds, _without_jumps(angles), names, f'Euler angles {sequence} (rad)')
    _angle_ticks(panels[0], angles)
    _curves(panels[1], seconds, trajectory.attitude[rows], ('x', 'y', 'z', 'w'), 'quaternion')
    _curves(panels[2], seconds, trajectory.angular_velocity[rows], ('ω₁', 'ω₂', 'ω₃'),
            'angular velocity,\nbody axes (rad/s)')
    times = _torque_times(log, int(start_ns), int(end_ns), timeout_ns)
    torques, _ = log.at(times, timeout_ns)
    frames = np.unique(log.in_space)
    axes = 'body axes' if not frames.any() else 'space axes' if frames.all() else 'mixed axes'
    _curves(panels[3], (times - start_ns) * 1e-9, torques, ('τ₁', 'τ₂', 'τ₃'),
            f'torque,\n{axes} (N m)')
    figure.align_ylabels(panels)
    panels[3].set_xlabel('time from the start (s)')
    panels[3].set_xlim(0.0, max(float(seconds[-1]), 1e-9))
    FigureCanvasAgg(figure).print_figure(path, dpi=120, format='png')


def work_precision(path: str | Path, curves: Mapping[str, tuple[Sequence[float],
                   Sequence[float]]], title: str, lines: Mapping[str, float]) -> None:
    """
    Draw cost over error, a curve a solver, into a PNG file.

    Parameters
    ----------
    path : str or Path
        A PNG file whatever its name, written over if it is there.
    curves : dict
        By solver, attitude errors, rad, and costs, wall seconds per simulated second.
    title : str
        Drawn as it stands: a $ in it begins no formula.
    lines : dict
        By name, attitude errors, rad, to compare with.

    """
    figure = Figure(figsize=(7.2, 5.0), layout='constrained')
    panel = figure.subplots()
    panel.set_title(title.encode(errors='replace').decode(), parse_math=False, loc='left',
                    pad=14 + 11 * len(lines), fontsize=11)
    taken: list[Floats] = []
    for number, (name, (errors, costs)) in enumerate(curves.items()):
        # Below the spacing of doubles there is no error to show.
        x, y = np.maximum(errors, np.finfo(float).eps), np.asarray(costs)
        panel.loglog(x, y, _STYLES[number % len(_STYLES)], linewidth=1.4, markersize=4.5,
                     color=_COLOURS[number], marker=_MARKERS[number])
        _name_curve(panel, name, x, y, _COLOURS[number], taken)
    for row, (name, value) in enumerate(sorted(lines.items(), key=lambda line: line[1])):
        value = max(value, float(np.finfo(float).eps))
        panel.axvline(value, color='#555555', linestyle=_STYLES[row % len(_STYLES)],
                      linewidth=1.0, zorder=1)
        panel.annotate(f'{name} {value:.0e}', (value, 1.0), (0, 4 + 11 * row), fontsize=8,
                       xycoords=('data', 'axes fraction'), textcoords='offset points',
                       color='#333333', horizontalalignment='center')
    panel.margins(0.08)
    panel.set_xlabel('largest attitude error (rad)')
    panel.set_ylabel('wall time per simulated second (s/s)')
    panel.grid(alpha=0.25)
    FigureCanvasAgg(figure).print_figure(path, dpi=200, format='png')


def _name_curve(panel: Axes, name: str, x: Floats, y: Floats, colour: str,
                taken: list[Floats]) -> None:
    # At its dearest end: at the other all curves meet. Above a name that stands there already.
    end = np.log10([x[np.argmax(y)], y.max()])
    near = sum(bool(np.all(np.abs(end - other) < (2.0, 0.2))) for other in taken)
    taken.append(end)
    left = end[0] > -2.0  # no room on the right
    panel.annotate(name.replace('_', ' '), (x[np.argmax(y)], y.max()),
                   (-6 if left else 6, 4 + 12 * near), color=colour, fontsize=9,
                   horizontalalignment='right' if left else 'left', textcoords='offset points',
                   fontweight='bold',
                   path_effects=[withStroke(linewidth=3, foreground='white')])


def _curves(panel: Axes, x: Floats, columns: Floats, names: tuple[str, ...], label: str) -> None:
    for column, name, colour, style in zip(columns.T, names, _COLOURS, _STYLES):
        panel.plot(x, column, style, color=colour, linewidth=1.2, label=name)
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)
    panel.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=2.5)


def _without_jumps(angles: Floats) -> Floats:
    # A line from 2 pi back to 0 would show a motion that is none.
    broken = angles.copy()
    broken[1:][np.abs(np.diff(angles, axis=0)) > np.pi] = np.nan
    return broken


def _angle_ticks(panel: Axes, angles: Floats) -> None:
    low, high = (-2, 2) if angles.min() < 0.0 else (0, 4)
    names = {-2: '−π', -1: '−π/2', 0: '0', 1: 'π/2', 2: 'π', 3: '3π/2', 4: '2π'}
    panel.set_yticks([number * np.pi / 2.0 for number in range(low, high + 1)],
                     [names[number] for number in range(low, high + 1)])


def _torque_times(log: TorqueLog, start_ns: int, end_ns: int,
                  timeout_ns: int) -> NDArray[np.int64]:
    # Both sides of every change, so that a step is drawn as one; a grid where there are too many.
    changes, _ = log.segments(timeout_ns)
    grid = start_ns + np.linspace(0, end_ns - start_ns, _POINTS // 4).astype(np.int64)
    if 2 * len(changes) <= _POINTS:
        grid = np.concatenate([grid, changes - 1, changes])
    grid = np.unique(grid)
    return grid[(grid >= start_ns) & (grid <= end_ns)]
