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

"""Chart panels that the pages of several commands share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report import style
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.text import scaled
from rigid_body_ros.report.thinning import Extremes, thinned

#: The label of a time axis that starts at the first measurement.
SINCE_FIRST = 'time from the first measurement (s)'
#: The number of times at which a torque is sampled to draw its curve.
_SAMPLES = 5000


class Drawn(NamedTuple):
    """
    The times of the samples to draw, and whether each sample is an outlier.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
    inliers : array of bool, shape (n,)
        A mask of the samples that are not outliers. Outliers are drawn as marks.

    """

    times_ns: NDArray[np.int64]
    inliers: NDArray[np.bool_]

    def curves(self, values: Floats, names: Sequence[str], start_ns: int,
               style: str = 'line') -> Iterator[Curves]:
        """Generate curves through the inliers and, if there are outliers, marks for them."""
        kept = self.inliers
        if kept.any():
            yield Curves.thinned(self.times_ns[kept], values[kept], names, start_ns, style)
        if not kept.all():
            unnamed = ['outliers (at the edge if out of range)', *[''] * (values.shape[1] - 1)]
            yield Curves.thinned(self.times_ns[~kept], values[~kept], unnamed, start_ns, 'marks')


def quantity_panels(where: str, axes: str, samples: Drawn, measured: Floats, computed: Floats,
                    errors: tuple[str, Floats], band: tuple[str, float],
                    start_ns: int) -> Iterator[Panel]:
    """
    Generate two panels: measured and computed values, and their errors.

    Parameters
    ----------
    where, axes : str
        The topic, and the name of the axes of the values and of the errors.
    samples, measured, computed, start_ns
        The samples, as for `overlay_panel`.
    errors : tuple of str and array, shape (n, 3)
        How the errors are computed, and the errors.
    band : tuple of str and float
        The name and the half width of the limits of the errors, as for `error_panel`.

    """
    name, unit, error, error_unit = ('attitude quaternion', '', 'attitude error', 'rad') \
        if measured.shape[1] == 4 else ('angular velocity', 'rad/s', 'rate error', 'rad/s')
    yield overlay_panel(f'{where}: {name}, {axes}', unit, samples, measured, computed, start_ns)
    yield error_panel(f'{where}: {error}, {errors[0]}, {axes}', error_unit, samples, errors[1],
                      band, start_ns)


def overlay_panel(label: str, unit: str, samples: Drawn, measured: Floats, computed: Floats,
                  start_ns: int) -> Panel:
    """
    Return a panel in which computed curves are drawn over measured curves.

    Parameters
    ----------
    label, unit : str
        The label and the unit of the y axis.
    samples : Drawn
        The times of the samples, and whether each sample is an outlier.
    measured, computed : array, shape (n, 4) or (n, 3)
        Quaternions x y z w, or vectors. The signs of quaternions are chosen so that their curves
        do not jump.
    start_ns : int
        The time at which the time axis starts.

    """
    names: Sequence[str] = style.QUATERNION if measured.shape[1] == 4 else style.RATES
    if measured.shape[1] == 4:
        measured, computed = _without_jumps(measured, samples.inliers), _without_jumps(computed)
        if np.sum(measured * computed) < 0.0:
            measured = -measured
    return Panel(label, unit, [
        *samples.curves(measured, [f'{name} measured' for name in names], start_ns, 'broad'),
        Curves.thinned(samples.times_ns, computed, [f'{name} computed' for name in names],
                       start_ns)], SINCE_FIRST)


def _without_jumps(attitude: Floats, chosen: NDArray[np.bool_] | None = None) -> Floats:
    """Flip signs so that each of the `chosen` quaternions is close to the one before."""
    found = attitude.copy()
    rows = slice(None) if chosen is None else np.flatnonzero(chosen)
    part = attitude[rows]
    same = np.sum(part[1:] * part[:-1], axis=1) >= 0.0
    found[rows] *= np.cumprod(np.append(1.0, np.where(same, 1.0, -1.0)))[:len(part), None]
    return found


def error_panel(label: str, unit: str, samples: Drawn, errors: Floats,
                band: tuple[str, float], start_ns: int) -> Panel:
    """
    Return a panel with errors, shape (n, 3), and with limits at plus and minus a half width.

    `band` contains the name of the limits and the half width.
    """
    name, size = band
    curves = [*samples.curves(errors, style.SIGNED, start_ns)]
    if size:
        curves.append(limits(samples.times_ns, np.full((2, 1), size), name, start_ns))
    return Panel(label, unit, curves, SINCE_FIRST)


def limits(times_ns: NDArray[np.int64], sizes: Floats, name: str, start_ns: int) -> Curves:
    """
    Return dashed curves at plus and minus `sizes`.

    The shape of `sizes` is (n, k), or (2, k) if the limits are constant.
    """
    times_ns = times_ns[[0, -1]] if len(sizes) == 2 else times_ns
    found = Curves.thinned(times_ns, sizes, [name, *[''] * (sizes.shape[1] - 1)], start_ns,
                           'limits')
    return replace(found, low=-found.high, gap=None)


def in_degrees(panel: Panel) -> Panel:
    """Return a copy of a panel that shows angles in degrees."""
    factor, unit = scaled(panel.unit, True)
    return replace(panel, unit=unit, curves=[each.times(factor) for each in panel.curves])


def torque_panels(logs: Sequence[TorqueLog], start_ns: int, end_ns: int,
                  timeout_ns: int = 0) -> Iterator[Panel]:
    """Generate a panel for each torque log that has samples."""
    logs = [log for log in logs if len(log)]
    times = np.unique(np.linspace(0, end_ns - start_ns, _SAMPLES).astype(np.int64)) + start_ns
    for log, name in zip(logs, style.torque_names(len(logs))):
        torque = ThinnedTorque(timeout_ns)
        torque.add(log, times)
        yield torque.panel(name, start_ns, SINCE_FIRST)


def field_panels(problem: Problem, times_ns: NDArray[np.int64],
                 start_ns: int) -> Iterator[Panel]:
    """Generate a panel with the torque of the fields at ascending times; none without fields."""
    if problem.fields:
        times_ns = times_ns[thinned(len(times_ns), _SAMPLES)]
        torques = problem.field_torque(times_ns, problem.propagate(at=times_ns).attitude)
        yield Panel(f'{style.FIELDS}, body axes', 'N m', [Curves.thinned(
            times_ns, torques, style.TORQUES, start_ns)], SINCE_FIRST)


class ThinnedTorque:
    """
    The torque of a log, which is thinned as the parts of the log are added one by one.

    Parameters
    ----------
    timeout_ns : int
        The maximum time for which a sample acts, ns, as for `TorqueLog.segments`.

    """

    def __init__(self, timeout_ns: int) -> None:
        self._timeout_ns, self._extremes = timeout_ns, Extremes(3)
        self._frames: set[bool] = set()
        self._taken_ns: int | None = None
        self._step = True

    def add(self, log: TorqueLog, times: NDArray[np.int64]) -> None:
        """Add the torque in the next part of the log, up to the last time in `times`."""
        end_ns = int(times[-1])
        changes, _ = log.segments(self._timeout_ns)
        known = changes[(changes > (times[0] if self._taken_ns is None else self._taken_ns))
                        & (changes <= end_ns)]
        first = times[:1] if self._taken_ns is None else times[:0]
        grid = times if log.interpolation == 'cubic' else times[-1:]
        at = np.unique(np.concatenate([first, known, grid]))
        torque, in_space = log.at(at, self._timeout_ns)
        self._extremes.add(at, torque)
        self._frames |= set(np.unique(in_space).tolist())
        self._taken_ns, self._step = end_ns, log.interpolation == 'hold'

    def panel(self, name: str, start_ns: int, x_label: str = Panel.x_label) -> Panel:
        """Return a panel with the torque that has been added so far."""
        axes = style.axes_name(np.array([*self._frames], np.bool_))
        return Panel(f'{name}, {axes}', 'N m', [Curves.of(
            self._extremes, style.TORQUES, start_ns, self._step)], x_label)
