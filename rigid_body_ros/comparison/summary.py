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

"""Summarize a comparison as text."""

from __future__ import annotations

from collections.abc import Iterator
import math
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats, written
from rigid_body_ros.comparison.alignment import Alignment
from rigid_body_ros.comparison.errors import Comparison, QUANTITIES, statistics
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.report.text import lines, rounded, scaled


def summary(comparison: Comparison, degrees: bool = False) -> str:
    """Return a summary, one line per fact."""
    return lines(f'{name:17}{text}' for name, text in rows(comparison, degrees))


def rows(comparison: Comparison, degrees: bool = False) -> Iterator[tuple[str, str]]:
    """Generate the facts: names, which are empty if a fact continues, and texts."""
    topics = ', '.join(errors.topic for errors in comparison.errors)
    yield 'measured', f'{comparison.samples} samples of {topics}, over {comparison.span_s:.9g} s'
    rejected = sum(sensor.rejected for sensor in comparison.measured)
    if rejected:
        yield 'rejected', f'{rejected} messages without a finite value up to {FASTEST:g} rad/s'
    if comparison.left_out:
        count = comparison.left_out
        yield 'left out', f'{count} sample{"s" if count > 1 else ""} outside of the motion'
    for damage in dict.fromkeys(sensor.damage for sensor in comparison.measured if sensor.damage):
        yield 'lost', damage
    if isinstance(comparison.motion, Problem) and not comparison.motion.sources:
        yield 'torques', 'none in the recording: the body is free'
    yield from _alignments(comparison, degrees)
    for label, unit, attribute in QUANTITIES:
        yield from _errors(label, *scaled(unit, degrees), comparison.pooled(attribute), True)
    factor, unit = scaled('rad', degrees)
    for horizon in comparison.horizons:
        angles = factor * horizon.angles
        text = f'rms {math.sqrt(np.mean(angles ** 2)):.3g}, 95 % ' \
               f'{np.percentile(angles, 95.0):.3g} {unit} in {len(angles)} windows' \
            if len(angles) else 'no window, or no measured attitude'
        yield f'after {horizon.seconds:g} s', text
    if comparison.predictable_s is not None:
        yield 'predictable', f'for {comparison.predictable_s:.4g} s from the start; later ' \
                             'errors say nothing about the model, those after horizons do'
    torque = comparison.residual_torque
    if torque:
        yield from _errors('residual torque', 1.0, 'N m', torque.torques)
        yield '', f'noise {written(torque.noise)} N m, in windows of {torque.window_s:.3g} s'
    for cause in comparison.causes:
        yield 'likely cause' if cause.explains else 'reduces', f'{cause.text} ({cause.evidence})'


def _alignments(comparison: Comparison, degrees: bool) -> Iterator[tuple[str, str]]:
    for one, sensor in zip(comparison.alignments, comparison.measured):
        sigma = one.sigma or {}
        of = f' of {sensor.topic}' if len(comparison.measured) > 1 else ''
        if 'clock_offset_s' in sigma:
            spread = float(sigma['clock_offset_s'])
            yield 'clock offset', f'{rounded(one.clock_offset_s, spread)} s ' \
                                  f'({_known(spread, "s")}), added to the measured stamps{of}'
        if 'mount_rad' in sigma:
            yield 'mounting', _turn(one.mount, sigma['mount_rad'], degrees) + of
    yield from _common(comparison.alignment, degrees)


def _turn(quaternion: Floats, sigma: Floats, degrees: bool) -> str:
    return 'rotation vector ' + _vector(so3.log(quaternion), sigma, *scaled('rad', degrees))


def _common(alignment: Alignment, degrees: bool) -> Iterator[tuple[str, str]]:
    """Generate the alignment that all sensors share."""
    sigma = alignment.sigma or {}
    if 'space_rad' in sigma:
        yield 'space axes', _turn(alignment.space, sigma['space_rad'], degrees)
    if alignment.start:
        text = f'attitude xyzw {written(alignment.start.attitude)}'
        if 'initial_attitude_rad' in sigma:
            factor, unit = scaled('rad', degrees)
            text += f' ({_known(factor * np.max(sigma["initial_attitude_rad"]), unit)})'
        yield 'start', text
        yield '', 'angular velocity ' + _vector(
            alignment.start.angular_velocity, sigma['initial_angular_velocity_rad_s'],
            *scaled('rad/s', degrees))


def _vector(values: Floats, sigma: Any, factor: float, unit: str) -> str:
    """Return a vector, each component rounded to its standard deviation, and the largest one."""
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
    axes = written(np.array(values.pop('axes_rms')))
    names = {'rms': 'rms', 'median': 'median', 'p95': '95 %', 'max': 'max', 'final': 'at the end'}
    parts = ', '.join(f'{names[key]} {value:.3g}' for key, value in values.items())
    yield name, f'{parts} {unit}'
    yield '', f'rms about the body axes {axes} {unit}'
