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

"""
Generate possible sensor faults, each with measurements from which the fault has been removed.

The errors that remain in these corrected measurements show whether the fault is the cause.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, written
from rigid_body_ros.comparison.channels import ATTITUDE, Channel, RATE
from rigid_body_ros.inference.align import CLOCK, is_asked, MOUNT
from rigid_body_ros.inference.alignment import Alignment
from rigid_body_ros.inference.guess import davenport
from rigid_body_ros.inference.noise import FEWEST
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.measured import Measured

#: A rotation that is within this angle of a swap of axes, rad, is described as a swap.
_NEAR = 0.09
#: Values that differ by less than `_SAME` times the spread are treated as equal. A frozen attitude
#: is detected only if the body turns by about `_MOVES` times the spread in the meantime.
_SAME, _MOVES = 6.0, 30.0
#: A gyro counts as saturated if more than this fraction of its incorrect values lie at one limit.
_AT_LIMIT = 0.9


@dataclass(frozen=True, eq=False)
class Fault:
    """
    A possible fault of a sensor, and the measurements after the fault has been removed.

    Attributes
    ----------
    name, text : str
        The name of the fault, and a description. If the description depends on the alignment,
        `text` is empty, and `described` generates the description.
    measured : Measured
        The measurements after the fault has been removed.
    align : tuple of str
        The alignments to fit in addition to those that the user asked for.
    is_aligned : bool
        Whether `measured` is already converted to the clock and the axes of the motion.

    """

    name: str
    text: str
    measured: Measured
    align: tuple[str, ...] = ()
    is_aligned: bool = False

    def described(self, alignment: Alignment) -> str:
        """Describe the fault, given the alignment that was fitted without the fault."""
        if self.align:
            return _clock_text(alignment) if self.name == 'clock_offset' else \
                _rotation_text(alignment)
        return self.text


def faults(sensor: Measured, aligned: Measured, wrong: Sequence[Channel],
           align: Collection[str]) -> Iterator[Fault]:
    """
    Generate possible faults of a sensor, beginning with the simplest.

    Parameters
    ----------
    sensor : Measured
        The measurements of the incorrect quantities: those whose errors exceed the noise.
    aligned : Measured
        The same measurements, converted to the clock and the axes of the motion, without samples
        outside the time span of the motion.
    wrong : sequence of Channel
        The errors of the incorrect quantities.
    align : collection of str
        The names of the alignments that the user asked for.

    """
    by_kind = {channel.kind: channel for channel in wrong}
    yield from _misread(sensor)
    for kind, name in ((CLOCK, 'clock_offset'), (MOUNT, 'constant_rotation')):
        if not is_asked(align, kind, sensor.topic):
            yield Fault(name, '', sensor, (kind,))
    if RATE in by_kind:
        yield from _of_gyro(aligned, by_kind[RATE])
    if ATTITUDE in by_kind:
        yield from _of_attitude(aligned, by_kind[ATTITUDE])


def _misread(sensor: Measured) -> Iterator[Fault]:
    if sensor.attitude is not None:
        yield Fault('quaternion_order', 'the measured quaternions are in the order w, x, y, z; '
                    'expected x, y, z, w',
                    replace(sensor, attitude=np.roll(sensor.attitude, -1, axis=1)))
        yield Fault('inverse_quaternion', 'the measured quaternions map space vectors to body '
                    'vectors; expected the reverse',
                    replace(sensor, attitude=so3.conjugate(sensor.attitude)))
    if sensor.angular_velocity is not None:
        yield Fault('degrees', 'the measured angular velocity is in degrees per second; expected '
                    'rad/s', replace(sensor, angular_velocity=np.radians(sensor.angular_velocity)))


def _of_gyro(aligned: Measured, channel: Channel) -> Iterator[Fault]:
    rates = aligned.angular_velocity
    assert rates is not None
    rates, count = rates.copy(), len(channel.errors)
    bias = np.median(channel.errors, axis=0)

    def changed(values: Floats) -> Measured:
        return replace(aligned, attitude=None, angular_velocity=values)
    yield Fault('gyro_bias', f'the gyro has a bias of {written(bias)} rad/s, body axes',
                changed(rates - bias), is_aligned=True)
    expected = rates[:count] - channel.errors
    scale = np.array([slope(*pair) for pair in zip(expected.T, rates[:count].T)])
    moves = np.median(np.abs(expected), axis=0) > channel.spread
    scale = np.where(moves & (np.abs(scale) > 1e-3), scale, 1.0)
    yield Fault('gyro_scale', f'the gyro measures {written(scale)} times the angular velocity, '
                'body axes', changed(rates / scale), is_aligned=True)
    spread = float(channel.spread.max())
    values = np.abs(rates[:count][np.abs(channel.errors) > _SAME * spread])
    if len(values) < FEWEST:
        return
    limit = float(np.median(values))
    if np.mean(np.abs(values - limit) < _SAME * spread) > _AT_LIMIT:
        # Choose the samples by their expected values, because a choice by measured values would
        # depend on the noise.
        kept = np.flatnonzero((np.abs(expected) < limit - _SAME * spread).all(axis=1))
        if len(kept) >= FEWEST:
            yield Fault('gyro_saturation', f'the gyro saturates at {limit:.4g} rad/s',
                        changed(rates).rows(kept), is_aligned=True)


def _of_attitude(aligned: Measured, channel: Channel) -> Iterator[Fault]:
    attitude, count = aligned.attitude, len(channel.errors)
    assert attitude is not None
    only = replace(aligned, angular_velocity=None)
    expected = so3.multiply(attitude[:count], so3.exp(-channel.errors))
    still = _still(attitude[:count], expected, float(channel.spread.max()))
    if still.any() and (~still).sum() >= FEWEST:
        times = channel.seconds[still]
        kept = ~np.append(still, np.zeros(len(aligned) - count, bool))
        yield Fault('frozen_attitude', f'the attitude is frozen in {still.sum()} samples from '
                    f'{times[0]:.4g} s to {times[-1]:.4g} s after the start', only.rows(kept),
                    is_aligned=True)
    bad = channel.outliers
    if not FEWEST <= bad.sum() < count:
        return
    turn = davenport(so3.exp(channel.errors[bad]))
    turned = attitude.copy()
    turned[:count][bad] = so3.multiply(attitude[:count][bad], so3.conjugate(turn))
    yield Fault('flipped_attitude', f'the attitude is flipped in {bad.sum()} of {count} samples, '
                f'first {channel.seconds[bad][0]:.4g} s after the start: {_turn_text(turn)} about '
                'the body', replace(only, attitude=turned), is_aligned=True)


def _still(attitude: Floats, expected: Floats, spread: float) -> NDArray[np.bool_]:
    """Return a mask of the samples whose attitude is constant although the body moves."""
    steps = so3.angle_between(expected[:-1], expected[1:])
    lag = max(1, math.ceil(_MOVES * spread / max(float(np.median(steps)), 1e-12)))
    still = np.zeros(len(attitude), bool)
    if lag > len(attitude) // 4:
        return still
    begins = np.flatnonzero(
        (so3.angle_between(attitude[:-lag], attitude[lag:]) < _SAME * spread)
        & (so3.angle_between(expected[:-lag], expected[lag:]) > 2.0 * _SAME * spread))
    for begin in begins:
        still[begin:begin + lag + 1] = True
    return still


def slope(x: Floats, y: Floats) -> float:
    """Return the slope k of the line y = k x that fits best, giving less weight to outliers."""
    weights = np.ones(len(x))
    for _ in range(10):
        found = float(np.sum(weights * x * y) / max(np.sum(weights * x * x), 1e-300))
        left = np.abs(y - found * x)
        weights = 1.0 / np.maximum(left / max(2.0 * float(np.median(left)), 1e-300), 1.0)
    return found


def _clock_text(alignment: Alignment) -> str:
    offset = alignment.clock_offset_s
    late = 'early' if offset > 0.0 else 'late'
    return f'the measured stamps are {abs(offset):.4g} s too {late} relative to the torques; ' \
           '--align clock corrects that'


def _rotation_text(alignment: Alignment) -> str:
    parts = []
    for name, quaternion in (('the axes of the sensor and of the body', alignment.mount),
                             ('the two space axes', alignment.space)):
        if so3.angle_between(quaternion, [0.0, 0.0, 0.0, 1.0]) > 3e-3:
            parts.append(f'{_turn_text(quaternion)} between {name}')
    return f'a constant rotation: {" and ".join(parts) or "too small to name"}; --align mount ' \
           'corrects that'


def _turn_text(quaternion: Floats) -> str:
    vector = so3.log(quaternion)
    angle = float(np.linalg.norm(vector))
    matrix = so3.matrix(quaternion)
    swap = np.round(matrix)
    is_swap = np.array_equal(swap @ swap.T, np.eye(3)) and np.linalg.det(swap) > 0.0
    axis = vector / max(angle, 1e-300)
    if is_swap and so3.angle_between(so3.from_matrix(swap), quaternion) < _NEAR \
            and not np.array_equal(swap, np.eye(3)):
        return f'{math.degrees(angle):.0f} degrees about {written(np.round(axis, 2) + 0.0)}, ' \
               f'which swaps axes ({axes_text(swap)})'
    return f'{math.degrees(angle):.3g} degrees about {written(np.round(axis, 2) + 0.0)}'


def axes_text(turn: Floats) -> str:
    """Describe a signed permutation of axes in text such as 'x = -y, y = x, z = z'."""
    parts = []
    for row, name in zip(turn, 'xyz'):
        column = int(np.argmax(np.abs(row)))
        parts.append(f'{name} = {"-" if row[column] < 0.0 else ""}{"xyz"[column]}')
    return ', '.join(parts)
