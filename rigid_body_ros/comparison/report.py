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

"""Report a comparison: its errors over time, the torques, and the moving body."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.comparison.result import Comparison, Errors, QUANTITIES, statistics
from rigid_body_ros.inference.motion import Motion
from rigid_body_ros.inference.noise import spread_of
from rigid_body_ros.inference.residual_torque import residual_panels
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report import moving_body
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.panels import (
    Drawn,
    field_panels,
    in_degrees,
    quantity_panels,
    torque_panels,
)
from rigid_body_ros.report.report import Report
from rigid_body_ros.report.text import scaled


def report_of(comparison: Comparison, name: str, degrees: bool = False) -> Report:
    """
    Return the report of a comparison.

    Parameters
    ----------
    comparison : Comparison
        The comparison. If the motion was computed rather than recorded, the report animates
        the body.
    name : str
        Name of the recording.
    degrees : bool
        Whether to show angles in degrees.

    """
    stamps_ns = np.unique(np.concatenate([errors.times_ns for errors in comparison.errors]))
    topics = ', '.join(errors.topic for errors in comparison.errors)
    motion, aligned = comparison.motion, comparison.aligned
    attitudes = next(((one.stamps_ns, one.attitude) for one in aligned
                      if one.attitude is not None and len(one)), None)
    body = moving_body.of_motion(motion, stamps_ns, attitudes) \
        if isinstance(motion, Problem) else None
    shown = [('moving body', 'the computed motion')] if body else []
    panels = [*_panels(comparison, aligned, stamps_ns), *_horizons(comparison, degrees)]
    verdict = [*comparison.verdict.rows()] if comparison.verdict else []
    headline = '; '.join([*(said for _, said in verdict[:1]), _size(comparison, degrees)])
    return Report(f'{name}: {topics}', headline,
                  [*verdict[1:], ('recording', name), *comparison.facts(degrees), *shown],
                  [*map(in_degrees, panels)] if degrees else panels, body)


def _size(comparison: Comparison, degrees: bool) -> str:
    """
    Return the rms attitude error as text.

    If there are no attitudes, return the rms rate error instead.
    """
    label, unit, attribute = next(each for each in QUANTITIES if comparison.of(each[2]))
    factor, unit = scaled(unit, degrees)
    size = factor * statistics(comparison.pooled(attribute))['rms']
    return f'{label} {size:.3g} {unit} (rms) over {comparison.span_s:.3g} s'


def _panels(comparison: Comparison, aligned: Sequence[Measured],
            stamps_ns: NDArray[np.int64]) -> Iterator[Panel]:
    start_ns, end_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    motion = comparison.motion
    for errors, sensor in zip(comparison.errors, aligned):
        if len(sensor):
            yield from _of_sensor(errors, sensor, motion, start_ns)
    if isinstance(motion, Problem):
        yield from torque_panels(motion.logs, start_ns, end_ns, motion.options.timeout_ns)
        yield from field_panels(motion, stamps_ns, start_ns)
    if comparison.residual_torque:
        yield from residual_panels(comparison.residual_torque, aligned, start_ns)


def _of_sensor(errors: Errors, sensor: Measured, motion: Motion,
               start_ns: int) -> Iterator[Panel]:
    """Generate the panels of one sensor: measured and computed curves, and their differences."""
    samples = Drawn(errors.times_ns, np.ones(len(errors.times_ns), bool))
    states = motion.propagate(at=errors.times_ns)
    for measured, computed, values in (
            (sensor.attitude, states.attitude, errors.rotation_vectors),
            (sensor.angular_velocity, states.angular_velocity, errors.rates)):
        if measured is not None and values is not None:
            yield from quantity_panels(
                errors.topic, 'body axes', samples, measured, computed,
                ('measured minus computed', values),
                ('±2 sigma of the noise of a sample', 2.0 * _noise(errors, values)), start_ns)


def _noise(errors: Errors, values: Floats) -> float:
    """Return the largest noise of the three axes, or 0 if there are too few samples."""
    if len(values) < 3:
        return 0.0
    return float(spread_of(errors.times_ns, values, values is errors.rotation_vectors).max())


def _horizons(comparison: Comparison, degrees: bool) -> Iterator[Panel]:
    """Generate a panel that shows how the attitude error grows with the time after a restart."""
    horizons = sorted((horizon for horizon in comparison.horizons if len(horizon.angles)),
                      key=lambda horizon: horizon.seconds)
    if not horizons:
        return
    seconds = np.array([horizon.seconds for horizon in horizons])
    errors = np.maximum([np.percentile(horizon.angles, [50.0, 95.0]) for horizon in horizons],
                        1e-16)
    factor, unit = scaled('rad', degrees)
    texts = [[f'{factor * error:.3g} {unit} {horizon.seconds:g} s after a restart, in '
              f'{len(horizon.angles)} windows' for horizon, error in zip(horizons, column)]
             for column in errors.T]
    yield Panel('attitude error after a restart', 'rad', [
        Curves(seconds, errors, errors, ('median', '95 %'))],
        'time since the restart from the measurement (s)', 'loglog', texts=texts)
