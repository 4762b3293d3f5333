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

"""The result of a comparison, with its text, its JSON data and its report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, written
from rigid_body_ros.inference.align import Alignment
from rigid_body_ros.inference.horizons import Horizon
from rigid_body_ros.inference.motion import Motion
from rigid_body_ros.inference.noise import spread_of
from rigid_body_ros.inference.residual_torque import residual_panels, ResidualTorque
from rigid_body_ros.inference.verdict import Verdict
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.account import Account
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
from rigid_body_ros.report.text import lines, numbers, rounded, scaled

#: The quantities that are compared. Each has a name, a unit, and an attribute of `Errors`.
_QUANTITIES = ('attitude error', 'rad', 'rotation_vectors'), ('rate error', 'rad/s', 'rates')


@dataclass(frozen=True, eq=False)
class Errors:
    """
    The errors of one sensor after alignment: measured minus computed values.

    Attributes
    ----------
    topic : str
    times_ns : array of int64, shape (n,)
        The times of the measurements on the clock of the motion: their stamps plus the clock
        offset.
    rotation_vectors : array, shape (n, 3), rad, body axes, optional
        Rotations from the computed to the measured attitudes; None if the sensor does not measure
        attitudes.
    rates : array, shape (n, 3), rad/s, body axes, optional
        Errors of the angular velocity; None if the sensor does not measure angular velocities.

    """

    topic: str
    times_ns: NDArray[np.int64]
    rotation_vectors: Floats | None
    rates: Floats | None


def statistics(vectors: Floats | None, final: bool = False) -> dict[str, Any]:
    """
    Return statistics of the lengths of some vectors, and the rms value of each component.

    Parameters
    ----------
    vectors : array, shape (n, 3), optional
        The vectors. All statistics are None if this array is None or has no rows.
    final : bool
        Whether to include 'final', the length of the last vector.

    """
    names = ['rms', 'median', 'p95', 'max', *(['final'] if final else []), 'axes_rms']
    if vectors is None or not len(vectors):
        return dict.fromkeys(names)
    lengths = np.linalg.norm(vectors, axis=1)
    values = [float(np.sqrt(np.mean(lengths ** 2))), float(np.median(lengths)),
              float(np.percentile(lengths, 95.0)), float(lengths.max()),
              *([float(lengths[-1])] if final else []),
              np.sqrt(np.mean(vectors ** 2, axis=0)).tolist()]
    return dict(zip(names, values))


@dataclass(frozen=True, eq=False)
class Comparison:
    """
    The result of comparing measurements with a motion.

    Attributes
    ----------
    measured : tuple of Measured
        The measurements of each sensor before alignment.
    alignments : tuple of Alignment
        The alignment of each sensor.
    aligned : tuple of Measured
        The measurements during the motion, converted to its clock and axes.
    errors : tuple of Errors
        The errors of each sensor, after alignment.
    left_out : int
        Number of samples that were left out of the comparison because they are before the start or
        after the end of the motion.
    horizons : tuple of Horizon
        For each horizon, the errors of motions that restart from measured states.
    residual_torque : ResidualTorque, optional
        The torque that is missing from the model. None if the motion was recorded rather than
        computed, or if the measurement is too short.
    motion : Problem or Recorded
        The motion that the measurements are compared with. If the start was fitted, the motion
        begins with the fitted start.
    recording : str
        Name of the recording; empty if there is no recording.
    verdict : Verdict, optional
        Whether the model, with any start, explains the measurements, and what may be wrong. None
        if this was not asked for, or if the measurement is too short.
    torques : Account, optional
        What became of the recorded torques.
    predictable_s : float, optional
        Time since the start, s, after which the uncertainty of a measured start alone causes
        errors of 0.1 rad. None if the measurement ends before this time, or if the motion was
        recorded rather than computed.

    """

    measured: tuple[Measured, ...]
    alignments: tuple[Alignment, ...]
    aligned: tuple[Measured, ...]
    errors: tuple[Errors, ...]
    left_out: int
    horizons: tuple[Horizon, ...]
    residual_torque: ResidualTorque | None
    motion: Motion
    recording: str = ''
    verdict: Verdict | None = None
    predictable_s: float | None = None
    torques: Account | None = None

    @property
    def alignment(self) -> Alignment:
        """
        Return the alignment of the first sensor with attitudes.

        If no sensor measures attitudes, return the alignment of the first sensor.
        """
        return next((alignment for alignment, sensor in zip(self.alignments, self.measured)
                     if sensor.attitude is not None), self.alignments[0])

    @property
    def of_sensors(self) -> dict[str, dict[str, Any]]:
        """Return the clock offset and the mounting of each sensor, by topic, as JSON types."""
        return {sensor.topic: alignment.of_sensor()
                for alignment, sensor in zip(self.alignments, self.measured)}

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """Return the times of all samples, ascending, ns."""
        return np.unique(np.concatenate([errors.times_ns for errors in self.errors]))

    @property
    def samples(self) -> int:
        """Return the number of samples that were compared."""
        return sum(len(errors.times_ns) for errors in self.errors)

    @property
    def span_s(self) -> float:
        """Return the time between the first and the last sample, s."""
        return 1e-9 * float(np.ptp(self.times_ns))

    def of(self, name: str) -> list[Errors]:
        """Return the errors of the sensors that measure `name`: 'rotation_vectors' or 'rates'."""
        return [errors for errors in self.errors
                if getattr(errors, name) is not None and len(errors.times_ns)]

    def pooled(self, name: str) -> Floats | None:
        """
        Return the errors of all sensors in one array, sorted by time.

        The argument `name` is 'rotation_vectors' or 'rates'. The result is None if no sensor
        measures this quantity during the motion.
        """
        chosen = self.of(name)
        if not chosen:
            return None
        times_ns = np.concatenate([errors.times_ns for errors in chosen])
        values = np.concatenate([getattr(errors, name) for errors in chosen])
        return np.asarray(values[np.argsort(times_ns, kind='stable')])

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON types, with units in the names of the keys."""
        torque = self.residual_torque
        torques = statistics(torque.torques if torque else None)
        if torque:
            torques |= {'noise': torque.noise.tolist(), 'window_s': torque.window_s}
        return {
            'recording': self.recording, 'measured': [errors.topic for errors in self.errors],
            'samples': self.samples, 'span_s': self.span_s, 'left_out': self.left_out,
            'rejected': sum(sensor.account.rejected for sensor in self.measured),
            'accounts': {sensor.topic: sensor.account.as_dict() for sensor in self.measured} | (
                {'torques': self.torques.as_dict()} if self.torques else {}),
            'alignment': self.alignment.as_dict(),
            'alignments': self.of_sensors,
            'attitude_error_rad': statistics(self.pooled('rotation_vectors'), final=True),
            'rate_error_rad_s': statistics(self.pooled('rates'), final=True),
            'horizons': [_horizon_dict(horizon) for horizon in self.horizons],
            'residual_torque_N_m': torques,
            'predictable_s': self.predictable_s,
            'verdict': self.verdict and self.verdict.as_dict(),
            # Deprecated: the suspects of the verdict under the name of earlier versions.
            'likely_causes': [{'cause': suspect.name, 'text': suspect.text or suspect.command}
                              for suspect in self.verdict.suspects] if self.verdict else []}

    def text(self, degrees: bool = False) -> str:
        """Return a summary as text, with one fact per line."""
        return lines(f'{name:17}{text}' for name, text in self.rows(degrees))

    __str__ = text

    def rows(self, degrees: bool = False) -> Iterator[tuple[str, str]]:
        """Generate the verdict and the facts, each as a name and a text."""
        if self.verdict:
            yield from self.verdict.rows()
        yield from self.facts(degrees)

    def facts(self, degrees: bool = False) -> Iterator[tuple[str, str]]:
        """
        Generate the facts of the summary, each as a name and a text.

        The name is empty in a row that continues the previous row.
        """
        topics = ', '.join(errors.topic for errors in self.errors)
        yield 'measured', f'{self.samples} samples of {topics}, over {self.span_s:.9g} s'
        for sensor in self.measured:
            if text := sensor.account.counted:
                yield 'account', f'{sensor.topic}: {text}'
        if self.torques and self.torques.counted:
            yield 'account', f'torques: {self.torques.counted}'
        if self.left_out:
            count = self.left_out
            yield 'left out', f'{count} sample{"s" if count > 1 else ""} outside of the motion'
        for damage in dict.fromkeys(sensor.damage for sensor in self.measured if sensor.damage):
            yield 'lost', damage
        if isinstance(self.motion, Problem) and not self.motion.sources:
            yield 'torques', 'none in the recording: the body is free'
        yield from _alignments(self, degrees)
        for label, unit, attribute in _QUANTITIES:
            yield from _errors(label, *scaled(unit, degrees), self.pooled(attribute), True)
        factor, unit = scaled('rad', degrees)
        for horizon in self.horizons:
            angles = factor * horizon.angles
            text = f'rms {math.sqrt(np.mean(angles ** 2)):.3g}, 95 % ' \
                   f'{np.percentile(angles, 95.0):.3g} {unit} in {len(angles)} windows' \
                if len(angles) else 'no window, or no measured attitude'
            yield f'after {horizon.seconds:g} s', text
        if self.predictable_s is not None:
            yield 'predictable', f'for {self.predictable_s:.4g} s from the start; later errors ' \
                                 'say nothing about the model, but the errors after horizons do'
        if torque := self.residual_torque:
            yield from _errors('residual torque', 1.0, 'N m', torque.torques)
            noise = numbers(torque.noise, 3, ', ')
            yield '', f'noise ({noise}) N m, in windows of {torque.window_s:.3g} s'


def _horizon_dict(horizon: Horizon) -> dict[str, Any]:
    values = statistics(horizon.angles[:, None])
    return {'seconds': horizon.seconds, 'windows': len(horizon.angles),
            **{f'attitude_{name}_rad': values[name] for name in ('rms', 'median', 'p95')},
            **({'monitor': [judgement.as_dict() for judgement in horizon.judgements]}
               if horizon.judgements else {})}


def _alignments(comparison: Comparison, degrees: bool) -> Iterator[tuple[str, str]]:
    """Generate the rows for each sensor, then those for the space axes and the start."""
    for alignment, sensor in zip(comparison.alignments, comparison.measured):
        sigma = alignment.sigma or {}
        of = f' of {sensor.topic}' if len(comparison.measured) > 1 else ''
        if 'clock_offset_s' in sigma:
            spread = float(sigma['clock_offset_s'])
            yield 'clock offset', f'{rounded(alignment.clock_offset_s, spread)} s ' \
                                  f'({_known(spread, "s")}), added to the measured stamps{of}'
        if 'mount_rad' in sigma:
            yield 'mounting', _turn(alignment.mount, sigma['mount_rad'], degrees) + of
    alignment = comparison.alignment
    sigma, start = alignment.sigma or {}, alignment.start
    if 'space_rad' in sigma:
        yield 'space axes', _turn(alignment.space, sigma['space_rad'], degrees)
    if start:
        text = f'attitude xyzw {written(start.attitude)}'
        if 'initial_attitude_rad' in sigma:
            factor, unit = scaled('rad', degrees)
            text += f' ({_known(factor * np.max(sigma["initial_attitude_rad"]), unit)})'
        yield 'start', text
        yield '', 'angular velocity ' + _vector(
            start.angular_velocity, sigma['initial_angular_velocity_rad_s'],
            *scaled('rad/s', degrees))


def _turn(quaternion: Floats, sigma: Floats, degrees: bool) -> str:
    return 'rotation vector ' + _vector(so3.log(quaternion), sigma, *scaled('rad', degrees))


def _vector(values: Floats, sigma: Any, factor: float, unit: str) -> str:
    """
    Return a vector as text, followed by the largest of its standard deviations.

    The components of the vector are rounded to suit their standard deviations.
    """
    spreads = factor * np.broadcast_to(sigma, 3)
    texts = ', '.join(rounded(factor * value, spread) for value, spread in zip(values, spreads))
    return f'({texts}) {unit} ({_known(float(spreads.max()), unit)})'


def _known(sigma: float, unit: str) -> str:
    return f'sigma {sigma:.2g} {unit}' if math.isfinite(sigma) else \
        'the measurement does not determine it'


def _errors(name: str, factor: float, unit: str, vectors: Floats | None,
            final: bool = False) -> Iterator[tuple[str, str]]:
    if vectors is None or not len(vectors):
        return
    values = statistics(factor * vectors, final)
    axes = numbers(values.pop('axes_rms'), 3, ', ')
    names = {'rms': 'rms', 'median': 'median', 'p95': '95 %', 'max': 'max', 'final': 'at the end'}
    parts = ', '.join(f'{names[key]} {value:.3g}' for key, value in values.items())
    yield name, f'{parts} {unit}'
    yield '', f'rms about the body axes ({axes}) {unit}'


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
    stamps_ns = comparison.times_ns
    topics = ', '.join(errors.topic for errors in comparison.errors)
    attitudes = next(((sensor.stamps_ns, sensor.attitude) for sensor in comparison.aligned
                      if sensor.attitude is not None and len(sensor)), None)
    body = moving_body.of_motion(comparison.motion, stamps_ns, attitudes) \
        if isinstance(comparison.motion, Problem) else None
    shown = [('moving body', 'the computed motion')] if body else []
    panels = [*_panels(comparison, stamps_ns), *_horizons(comparison, degrees)]
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
    label, unit, attribute = next(row for row in _QUANTITIES if comparison.of(row[2]))
    factor, unit = scaled(unit, degrees)
    size = factor * statistics(comparison.pooled(attribute))['rms']
    return f'{label} {size:.3g} {unit} (rms) over {comparison.span_s:.3g} s'


def _panels(comparison: Comparison, stamps_ns: NDArray[np.int64]) -> Iterator[Panel]:
    start_ns, end_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    motion, aligned = comparison.motion, comparison.aligned
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
