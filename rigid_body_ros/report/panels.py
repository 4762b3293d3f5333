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
from rigid_body_ros.report.charts import Curves, FIELDS, Panel, QUATERNION, RATES, SIGNED, TORQUES
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
    Generate two panels: computed curves over measured curves, and the errors with limits.

    Parameters
    ----------
    where, axes : str
        The topic, and the name of the axes of the values and of the errors.
    samples : Drawn
        The times of the samples, and whether each sample is an outlier.
    measured, computed : array, shape (n, 4) or (n, 3)
        Quaternions x y z w, or angular velocities. The signs of quaternions are chosen so that
        their curves do not jump.
    errors : tuple of str and array, shape (n, 3)
        How the errors are computed, and the errors.
    band : tuple of str and float
        The name and the half width of the limits of the errors. If it is 0, there are no limits.
    start_ns : int
        The time at which the time axis starts.

    """
    name, unit, error, error_unit, names = (
        'attitude quaternion', '', 'attitude error', 'rad', QUATERNION) \
        if measured.shape[1] == 4 else ('angular velocity', 'rad/s', 'rate error', 'rad/s', RATES)
    if measured.shape[1] == 4:
        measured, computed = _without_jumps(measured, samples.inliers), _without_jumps(computed)
        if np.sum(measured * computed) < 0.0:
            measured = -measured
    yield Panel(f'{where}: {name}, {axes}', unit, [
        *samples.curves(measured, [f'{name} measured' for name in names], start_ns, 'broad'),
        Curves.thinned(samples.times_ns, computed, [f'{name} computed' for name in names],
                       start_ns)], SINCE_FIRST)
    (how, vectors), (limit, size) = errors, band
    curves = [*samples.curves(vectors, SIGNED, start_ns)]
    if size:
        curves.append(limits(samples.times_ns, np.full((2, 1), size), limit, start_ns))
    yield Panel(f'{where}: {error}, {how}, {axes}', error_unit, curves, SINCE_FIRST)


def _without_jumps(attitude: Floats, chosen: NDArray[np.bool_] | slice = slice(None)) -> Floats:
    """Flip signs so that each of the `chosen` quaternions is close to the one before."""
    smooth, part = attitude.copy(), attitude[chosen]
    same = np.sum(part[1:] * part[:-1], axis=1) >= 0.0
    smooth[chosen] *= np.cumprod(np.append(1.0, np.where(same, 1.0, -1.0)))[:len(part), None]
    return smooth


def limits(times_ns: NDArray[np.int64], sizes: Floats, name: str, start_ns: int) -> Curves:
    """
    Return dashed curves at plus and minus `sizes`.

    The shape of `sizes` is (n, k), or (2, k) if the limits are constant.
    """
    times_ns = times_ns[[0, -1]] if len(sizes) == 2 else times_ns
    upper = Curves.thinned(times_ns, sizes, [name, *[''] * (sizes.shape[1] - 1)], start_ns,
                           'limits')
    return replace(upper, low=-upper.high, gap=None)


def in_degrees(panel: Panel) -> Panel:
    """Return a copy of a panel that shows angles in degrees."""
    factor, unit = scaled(panel.unit, True)
    return replace(panel, unit=unit, curves=[curves.times(factor) for curves in panel.curves])


def torque_panels(logs: Sequence[TorqueLog], start_ns: int, end_ns: int,
                  timeout_ns: int = 0) -> list[Panel]:
    """Return a panel for each torque log that has samples."""
    times = np.unique(np.linspace(0, end_ns - start_ns, _SAMPLES).astype(np.int64)) + start_ns
    torques = []
    for log in filter(len, logs):
        torques.append(ThinnedTorque(timeout_ns))
        torques[-1].add(log, times)
    return panels_of(torques, start_ns, SINCE_FIRST)


def field_panels(problem: Problem, times_ns: NDArray[np.int64],
                 start_ns: int) -> Iterator[Panel]:
    """Generate a panel with the torque of the fields at ascending times; none without fields."""
    if problem.fields:
        times_ns = times_ns[thinned(len(times_ns), _SAMPLES)]
        torques = problem.field_torque(times_ns, problem.propagate(at=times_ns).attitude)
        yield Panel(f'{FIELDS}, body axes', 'N m', [Curves.thinned(
            times_ns, torques, TORQUES, start_ns)], SINCE_FIRST)


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
        end_ns, taken_ns = int(times[-1]), self._taken_ns
        changes, _ = log.segments(self._timeout_ns)
        part = changes[(changes > (times[0] if taken_ns is None else taken_ns))
                       & (changes <= end_ns)]
        grid = times if log.interpolation == 'cubic' else times[-1:]
        at = np.unique(np.concatenate([times[:1 if taken_ns is None else 0], part, grid]))
        torque, in_space = log.at(at, self._timeout_ns)
        self._extremes.add(at, torque)
        self._frames |= set(np.unique(in_space).tolist())
        self._taken_ns, self._step = end_ns, log.interpolation == 'hold'

    def panel(self, name: str, start_ns: int, x_label: str) -> Panel:
        """Return a panel with the torque that has been added so far."""
        axes = 'mixed' if len(self._frames) > 1 else 'space' if True in self._frames else 'body'
        return Panel(f'{name}, {axes} axes', 'N m', [Curves.of(
            self._extremes, TORQUES, start_ns, self._step)], x_label)


def panels_of(torques: Sequence[ThinnedTorque], start_ns: int,
              x_label: str = Panel.x_label) -> list[Panel]:
    """Return a panel for each torque. The torques are numbered unless there is only one."""
    return [torque.panel(f'torque {number}' if len(torques) > 1 else 'torque', start_ns, x_label)
            for number, torque in enumerate(torques, 1)]
