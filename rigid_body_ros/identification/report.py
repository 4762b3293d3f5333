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

"""Report an identification: estimates, errors over time, torques, and the moving body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.identification.result import Identification
from rigid_body_ros.inference.errors import correlations, Residuals
from rigid_body_ros.inference.noise import NORMAL_95
from rigid_body_ros.inference.residual_torque import residual_panels
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report import moving_body
from rigid_body_ros.report.charts import Curves, Panel, SIGNED
from rigid_body_ros.report.panels import Drawn, in_degrees, quantity_panels, torque_panels
from rigid_body_ros.report.report import matrix, Report, table

#: Largest lag in the plot of an autocorrelation, s, and minimum number of lags in that plot.
_LAG, _FEWEST = 2.0, 20


def report_of(fit: Identification, first: Problem, name: str, degrees: bool = False) -> Report:
    """
    Return the report of an identification.

    Parameters
    ----------
    fit : Identification
        The result, with at least one sample.
    first : Problem
        The problem of the first recording, whose motion, errors and torques the report shows.
    name : str
        Name of the first recording.
    degrees : bool
        Whether to show angles in degrees.

    """
    story = [('recording', name), *fit.verdict.rows(has_estimates=True), *fit.rows(degrees),
             ('moving body', 'the motion with all estimates'), *_restarts(fit)]
    panels, (header, *estimated) = [*_panels(fit, first)], fit.table(degrees)
    attitudes = next(((one.stamps_ns, one.values) for one in fit.aligned if one.is_attitude), None)
    body = moving_body.of_motion(fit.motion, _stamps_ns(fit), attitudes)
    return Report(f'{name}: estimated parameters', fit.headline, story,
                  [*map(in_degrees, panels)] if degrees else panels, body,
                  table=table(header, estimated), matrix=matrix(
                      'correlation of the estimates (orange: positive, blue: negative)',
                      [*fit.estimates], fit.correlation) if fit.estimates else '')


def _restarts(fit: Identification) -> Iterator[tuple[str, str]]:
    """Generate a note on why the computed curves jump; generate nothing if they do not jump."""
    stamps_ns = np.concatenate([part.stamps_ns for part in fit.residuals
                                if part.is_training and not part.recording])
    if 1e-9 * np.ptp(stamps_ns) > 1.5 * fit.window_s:
        yield 'computed curves', f'begin again every {fit.window_s:.3g} s in the part that was ' \
                                 'fitted, with the state that fits best'


def _panels(fit: Identification, first: Problem) -> Iterator[Panel]:
    quantities = fit.errors_of(0)
    if not quantities:
        return
    start_ns = int(_stamps_ns(fit)[0])
    for parts in quantities:
        lines = _lines(fit, parts, start_ns)
        yield from (replace(panel, lines=lines) for panel in _of_channel(parts, start_ns))
    end_ns = max(int(part.stamps_ns[-1]) for parts in quantities for part in parts)
    yield from torque_panels(first.acting_logs, start_ns, end_ns, fit.motion.options.timeout_ns)
    if fit.residual_torque:
        yield from residual_panels(fit.residual_torque, [
            one for one in fit.aligned if one.is_attitude and len(one) > 1], start_ns)
    for parts in quantities:
        yield from _correlations(parts[0])
    for number in range(1, len(fit.starts)):
        for parts in fit.errors_of(number):
            yield from _of_channel(parts, int(_stamps_ns(fit, number)[0]))


def _stamps_ns(fit: Identification, recording: int = 0) -> NDArray[np.int64]:
    """Return the stamps of all samples of a recording."""
    return np.unique(np.concatenate([
        part.stamps_ns for part in fit.residuals if part.recording == recording]))


def _of_channel(parts: Sequence[Residuals], start_ns: int) -> Iterator[Panel]:
    """Return one panel with the measured and computed values, and one with the errors."""
    stamps_ns, inliers, measured, computed, errors = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ('stamps_ns', 'inliers', 'measured', 'computed', 'errors'))
    first = parts[0]
    where = f'recording {first.recording + 1}, {first.topic}' if first.recording else first.topic
    return quantity_panels(where, 'axes of the sensor', Drawn(stamps_ns, inliers), measured,
                           computed, ('computed minus measured', errors),
                           ('±2 sigma assumed by the fit', 2.0 * first.noise), start_ns)


def _lines(fit: Identification, parts: Sequence[Residuals], start_ns: int) -> dict[str, float]:
    """
    Return the times to mark in the plots, s, keyed by their labels.

    One is the time at which the validation begins. The other is the time at which the motion
    becomes unpredictable.
    """
    ahead = [part for part in parts if not part.is_training]
    lines = {}
    if ahead:
        lines['start of the validation'] = 1e-9 * float(ahead[0].stamps_ns[0] - start_ns)
    if ahead and fit.predictable_s is not None:
        lines['predictable up to here'] = fit.predictable_s + 1e-9 * (
            fit.motion.start.time_ns - start_ns)
    return lines


def _correlations(errors: Residuals) -> Iterator[Panel]:
    """Generate a panel with the autocorrelation of a channel's fit errors."""
    if len(errors.stamps_ns) < 4 * _FEWEST or not errors.is_training:
        return
    spacing = 1e-9 * float(np.median(np.diff(errors.stamps_ns)))
    found = correlations(errors.errors, errors.inliers)[1:max(_FEWEST, round(_LAG / spacing)) + 1]
    lags = np.arange(1, len(found) + 1) * spacing
    limit: Floats = np.full((2, 1), NORMAL_95 / np.sqrt(errors.inliers.sum()))
    quantity = 'attitude' if errors.is_attitude else 'rate'
    yield Panel(f'{errors.topic}: autocorrelation of the {quantity} errors of the fit', '', [
        Curves(np.asarray(lags, np.float64), found, found, SIGNED),
        Curves(np.asarray(lags[[0, -1]], np.float64), -limit, limit,
               ['95 % limits of white noise'], style='limits')],
        'lag (s)')
