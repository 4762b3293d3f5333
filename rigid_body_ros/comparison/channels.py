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
Compare the errors of one measured quantity with the noise of its sensor.

The spread is the standard deviation of the noise. It is estimated from how much the errors change
between neighbouring samples. An incorrect model hardly affects this estimate, because the errors
that it causes change slowly.
The errors count as noise if outliers are rare and do not come in clusters, and if the errors do
not persist for longer than sensor noise would. The noise also limits for how long a motion can be
predicted from a measured start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.comparison.result import Comparison
from rigid_body_ros.inference.noise import (
    ALARM,
    batches_of,
    chance,
    come_together,
    FEWEST,
    noise_of,
)
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem

#: Ratio of the standard deviation of normal noise to its median absolute value.
_NORMAL = 1.4826
#: An error is an outlier if it exceeds `_OUTLIER` times the spread. If outliers make up more than
#: the fraction `_SCATTERED` of the errors, the errors are not just noise.
_OUTLIER, _SCATTERED = 15.0, 0.3
#: Errors below this limit, in rad or rad/s, are treated as rounding errors.
_ROUNDING = 1e-7
#: The spread of an axis is at least this fraction of the largest spread of the three axes.
_LEAST = 1e-3
#: Errors are compared with the noise in batches of this duration, s.
_BATCH = 1.0
ATTITUDE, RATE = 'rotation_vectors', 'rates'
UNITS = {ATTITUDE: 'rad', RATE: 'rad/s'}
#: A motion counts as unpredictable when the standard deviation of its attitude exceeds this limit,
#: rad.
_LOST = 0.1
#: The start is assumed to be estimated from `_SPAN` seconds of the measurement, but from at least
#: `_FEWEST` samples.
_SPAN, _FEWEST = 1.0, 11
#: `_STEP` is the finite-difference step for changes of the start, rad or rad/s. `_INSTANTS` is the
#: number of times at which the uncertainty is computed.
_STEP, _INSTANTS = 1e-7, 1000


@dataclass(frozen=True, eq=False)
class Channel:
    """
    The errors of one quantity of one sensor.

    Attributes
    ----------
    topic : str
    kind : str
        'rotation_vectors' or 'rates'.
    seconds : array, shape (n,), s
        Time since the start of the motion.
    errors : array, shape (n, 3), rad or rad/s

    """

    topic: str
    kind: str
    seconds: Floats
    errors: Floats

    @property
    def key(self) -> tuple[str, str]:
        """Return the topic and the kind, which together identify the channel."""
        return self.topic, self.kind

    @cached_property
    def spread(self) -> Floats:
        """Return the standard deviation of the noise on each axis, from neighbouring samples."""
        before, here, after = self.seconds[:-2], self.seconds[1:-1], self.seconds[2:]
        share = ((here - before) / (after - before))[:, None]
        left = np.abs(self._curved(share)) / np.sqrt(1.0 + share ** 2 + (1.0 - share) ** 2)
        sizes = _NORMAL * np.median(left, axis=0)
        return np.maximum(sizes, max(_LEAST * float(sizes.max()), _ROUNDING))

    def _curved(self, share: Floats) -> Floats:
        """Return the deviation of each error from the line between its two neighbours."""
        if self.kind != ATTITUDE:
            return self.errors[1:-1] - (1.0 - share) * self.errors[:-2] - share * self.errors[2:]
        turns = so3.exp(self.errors)  # rotation vectors are discontinuous at half a turn
        back = so3.conjugate(turns[:-2])
        middle = so3.exp(share * so3.log(so3.multiply(back, turns[2:])))
        return so3.log(so3.multiply(so3.conjugate(middle), so3.multiply(back, turns[1:-1])))

    @cached_property
    def outliers(self) -> NDArray[np.bool_]:
        """Return a mask of the outliers: errors that are much larger than the spread."""
        return np.asarray((np.abs(self.errors) > _OUTLIER * self.spread).any(axis=1))

    @property
    def median(self) -> float:
        """Return the median length of the errors."""
        return float(np.median(np.linalg.norm(self.errors, axis=1)))

    @property
    def ratio(self) -> float:
        """Return the median error divided by the median error that pure noise would have."""
        return float(np.median(np.abs(self.errors) / self.spread)) * _NORMAL

    @cached_property
    def is_noise(self) -> bool:
        """Return whether sensor noise alone can explain the errors."""
        if np.median(np.abs(self.errors)) <= _ROUNDING:
            return True
        if self.outliers.mean() > _SCATTERED or come_together(self.outliers):
            return False
        errors = np.where(self.outliers[:, None], np.nan, self.errors)
        noise = noise_of([errors], 1.0)
        left = noise.innovations(errors / np.maximum(noise.sizes, 1e-300))
        size = max(FEWEST, round(_BATCH / float(np.median(np.diff(self.seconds)))))
        return len(left) < size or chance(noise, batches_of(left, size)) >= ALARM


def channels_of(comparison: Comparison, until_ns: int = NEVER_NS) -> Iterator[Channel]:
    """Generate the channels of a comparison, with the samples up to the time `until_ns`."""
    for errors in comparison.errors:
        rows = errors.times_ns <= until_ns
        seconds = np.asarray(1e-9 * (errors.times_ns[rows] - comparison.motion.start.time_ns),
                             float)
        for kind in (ATTITUDE, RATE):
            values = getattr(errors, kind)
            if values is not None and len(seconds) >= FEWEST:
                yield Channel(errors.topic, kind, seconds, values[rows])


def predictable_s(problem: Problem, channels: Sequence[Channel]) -> float | None:
    """
    Return the time after which the uncertainty of the start alone causes an error of 0.1 rad.

    The start is assumed to be estimated from one second of the measurement.

    Parameters
    ----------
    problem : Problem
        The model.
    channels : sequence of Channel
        The errors of each measured quantity, from which its noise is estimated.

    Returns
    -------
    float, s, or None
        The time since the start; None if the motion is predictable up to the last sample.

    """
    end = max((float(channel.seconds[-1]) for channel in channels), default=0.0)
    if end <= 0.0:
        return None
    seconds = np.linspace(0.0, end, _INSTANTS + 1)[1:]
    times_ns = problem.start.time_ns + np.round(1e9 * seconds).astype(np.int64)
    start, attitude = problem.start, problem.propagate(at=times_ns).attitude
    variances = np.zeros(len(times_ns))
    for row, sigma in enumerate(_deviations(channels)):
        change = _STEP * np.eye(6)[row]
        moved = State(start.time_ns, so3.multiply(start.attitude, so3.exp(change[:3])),
                      start.angular_velocity + change[3:], start.rotor_momentum)
        other = problem.replaced(start=moved).propagate(at=times_ns).attitude
        variances += (sigma / _STEP * so3.angle_between(attitude, other)) ** 2
    lost = np.flatnonzero(variances > _LOST ** 2)
    return float(seconds[lost[0]]) if lost.size else None


def _deviations(channels: Sequence[Channel]) -> Floats:
    """
    Return the standard deviations of the start.

    The first three values are for the attitude, rad, and the last three for the angular velocity,
    rad/s. If the attitude is not measured, the first three values are 0.
    """
    found: Floats = np.full(6, np.inf)
    for channel in channels:
        spacing = float(np.median(np.diff(channel.seconds)))
        count = max(_FEWEST, round(_SPAN / spacing))
        mean = channel.spread / np.sqrt(count)
        if channel.kind == ATTITUDE:
            found[:3] = np.minimum(found[:3], mean)
            # The rate is the slope of a line fitted to the attitudes, so compute the standard
            # deviation of this slope.
            mean = mean * np.sqrt(12.0) / (count * spacing)
        found[3:] = np.minimum(found[3:], mean)
    if not any(channel.kind == ATTITUDE for channel in channels):
        found[:3] = 0.0
    return found
