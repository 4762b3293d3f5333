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

"""Panels that the pages of several commands share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report import style
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.thinning import Extremes

#: The label of an abscissa that begins at the first measurement.
SINCE_FIRST = 'time from the first measurement (s)'
#: Number of times at which a torque on a curve is sampled.
_SAMPLES = 5000


def error_panel(label: str, unit: str, times_ns: NDArray[np.int64], errors: Floats,
                start_ns: int) -> Panel:
    """Return a panel with the sizes of errors, shape (n, 3), and of their components."""
    sizes = np.abs(np.column_stack([errors, np.linalg.norm(errors, axis=1)]))
    names = (*style.ERRORS[1:], style.ERRORS[0])
    return Panel(label, unit, [Curves.thinned(times_ns, sizes, names, start_ns)], SINCE_FIRST,
                 'log')


def signed_error_panel(label: str, unit: str, times_ns: NDArray[np.int64], errors: Floats,
                       sigma: float, start_ns: int) -> Panel:
    """Return a panel with errors, shape (n, 3), between plus and minus two standard deviations."""
    names = [name.strip('|') for name in style.ERRORS[1:]]
    band: Floats = np.full((2, 2), 2.0 * sigma) * [1.0, -1.0]
    return Panel(label, unit, [
        Curves.thinned(times_ns, errors, names, start_ns),
        Curves.thinned(times_ns[[0, -1]], band, ['2 sigma of the noise', '-2 sigma'], start_ns)],
        SINCE_FIRST)


def torque_panels(logs: Sequence[TorqueLog], start_ns: int, end_ns: int,
                  timeout_ns: int = 0) -> Iterator[Panel]:
    """Generate a panel for each log that has samples."""
    logs = [log for log in logs if len(log)]
    times = np.unique(np.linspace(0, end_ns - start_ns, _SAMPLES).astype(np.int64)) + start_ns
    for log, name in zip(logs, style.torque_names(len(logs))):
        torque = ThinnedTorque(timeout_ns)
        torque.add(log, times)
        yield torque.panel(name, start_ns, SINCE_FIRST)


def field_panels(problem: Problem, times_ns: NDArray[np.int64],
                 start_ns: int) -> Iterator[Panel]:
    """Generate a panel with the torque of the fields at ascending times, if there are any."""
    if problem.fields:
        times_ns = times_ns[::-(-len(times_ns) // _SAMPLES)]
        torques = problem.field_torque(times_ns, problem.propagate(at=times_ns).attitude)
        yield Panel(f'{style.FIELDS}, body axes', 'N m', [Curves.thinned(
            times_ns, torques, style.TORQUES, start_ns)], SINCE_FIRST)


class ThinnedTorque:
    """
    The torque of one log over the time of a motion, thinned while it is added.

    Parameters
    ----------
    timeout_ns : int
        As for `TorqueLog.segments`.

    """

    def __init__(self, timeout_ns: int) -> None:
        self._timeout_ns, self._extremes = timeout_ns, Extremes(3)
        self._frames: set[bool] = set()
        self._taken_ns: int | None = None
        self._step = True

    def add(self, log: TorqueLog, times: NDArray[np.int64]) -> None:
        """Add the torque up to the last of these times."""
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
        """Return the panel."""
        axes = style.axes_name(np.array([*self._frames], np.bool_))
        return Panel(f'{name}, {axes}', 'N m', [Curves.of(
            self._extremes, style.TORQUES, start_ns, self._step)], x_label)
