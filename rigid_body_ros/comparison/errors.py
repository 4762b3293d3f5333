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

"""The errors of a measured motion: measured minus computed, after alignment."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.comparison.align import align as aligned_by
from rigid_body_ros.comparison.align import apart, errors_of, START
from rigid_body_ros.comparison.alignment import Alignment
from rigid_body_ros.comparison.horizons import Horizon
from rigid_body_ros.comparison.motion import divided, inside, Motion
from rigid_body_ros.propagation import Problem
from rigid_body_ros.sensing.measured import Measured
from rigid_body_ros.sensing.residual_torque import ResidualTorque

#: What is compared: its name, its unit, and the attribute of `Errors`.
QUANTITIES = ('attitude error', 'rad', 'rotation_vectors'), ('rate error', 'rad/s', 'rates')


@dataclass(frozen=True, eq=False)
class Errors:
    """
    The errors of one sensor: measured minus computed.

    Attributes
    ----------
    topic : str
    times_ns : array of int64, shape (n,)
        In the time of the motion: the clock offset is added.
    rotation_vectors : array, shape (n, 3), rad, body axes, optional
        From the computed attitude to the measured one; None without attitudes.
    rates : array, shape (n, 3), rad/s, body axes, optional
        None without angular velocities.

    """

    topic: str
    times_ns: NDArray[np.int64]
    rotation_vectors: Floats | None
    rates: Floats | None


@dataclass(frozen=True, eq=False)
class Comparison:
    """
    A measured motion compared with the propagated one.

    Attributes
    ----------
    measured : tuple of Measured
        As given.
    alignments : tuple of Alignment
        Of each sensor.
    errors : tuple of Errors
        Of each sensor, after alignment.
    left_out : int
        Number of samples outside of the motion.
    horizons : tuple of Horizon
    residual_torque : ResidualTorque, optional
        None for a recorded motion, or the measurement is too short.
    motion : Problem or Recorded
        With the fitted start.
    recording : str
        Name of the recording, if there is one.
    causes : tuple
        Likely causes of the errors; see `find_causes`.
    predictable_s : float, optional
        After this time the measured uncertainty of the start alone explains errors of 0.1 rad;
        None if it does not before the end, and for a recorded motion.

    """

    measured: tuple[Measured, ...]
    alignments: tuple[Alignment, ...]
    errors: tuple[Errors, ...]
    left_out: int
    horizons: tuple[Horizon, ...]
    residual_torque: ResidualTorque | None
    motion: Motion
    recording: str = ''
    causes: tuple[Any, ...] = ()
    predictable_s: float | None = None

    @property
    def alignment(self) -> Alignment:
        """Return the alignment of the first measured attitude, else of the first sensor."""
        return next((one for one, sensor in zip(self.alignments, self.measured)
                     if sensor.attitude is not None), self.alignments[0])

    @property
    def samples(self) -> int:
        """Return the number of samples that are compared."""
        return sum(len(errors.times_ns) for errors in self.errors)

    @property
    def span_s(self) -> float:
        """Return the time from the first sample to the last, s."""
        times_ns = np.concatenate([errors.times_ns for errors in self.errors])
        return 1e-9 * float(np.ptp(times_ns))

    @property
    def aligned(self) -> tuple[Measured, ...]:
        """Return the measurements in the time and the axes of the motion."""
        return tuple(_within(self.motion, one.applied(sensor))
                     for one, sensor in zip(self.alignments, self.measured))

    def of(self, name: str) -> list[Errors]:
        """Return the errors of the sensors that measure 'rotation_vectors' or 'rates'."""
        return [errors for errors in self.errors
                if getattr(errors, name) is not None and len(errors.times_ns)]

    def pooled(self, name: str) -> Floats | None:
        """
        Return the 'rotation_vectors' or 'rates' of all sensors in the order of time.

        None if no sensor measures that within the motion.
        """
        chosen = self.of(name)
        if not chosen:
            return None
        times_ns = np.concatenate([errors.times_ns for errors in chosen])
        values = np.concatenate([getattr(errors, name) for errors in chosen])
        return np.asarray(values[np.argsort(times_ns, kind='stable')])

    def as_dict(self) -> dict[str, Any]:
        """Return the result as JSON types; units are in the names."""
        torque = self.residual_torque
        found: dict[str, Any] = {
            'recording': self.recording, 'measured': [errors.topic for errors in self.errors],
            'samples': self.samples, 'span_s': self.span_s, 'left_out': self.left_out,
            'rejected': sum(sensor.rejected for sensor in self.measured),
            'alignment': self.alignment.as_dict(),
            'alignments': {sensor.topic: one.of_sensor()
                           for one, sensor in zip(self.alignments, self.measured)},
            'attitude_error_rad': statistics(self.pooled('rotation_vectors'), final=True),
            'rate_error_rad_s': statistics(self.pooled('rates'), final=True),
            'horizons': [_horizon_dict(horizon) for horizon in self.horizons],
            'residual_torque_N_m': statistics(torque.torques if torque else None),
            'predictable_s': self.predictable_s,
            'likely_causes': [cause.as_dict() for cause in self.causes]}
        if torque:
            found['residual_torque_N_m'] |= {'noise': torque.noise.tolist(),
                                             'window_s': torque.window_s}
        return found


def compared(motion: Motion, measured: Sequence[Measured],
             align: Collection[str], most: int | None = None) -> Comparison:
    """Return only the errors after alignment, of at most this many samples."""
    alignments = aligned_by(motion, measured, align, most)
    if START in align and isinstance(motion, Problem):
        motion = motion.replaced(start=alignments[0].start)
    sensors = [one.applied(sensor) for one, sensor in zip(alignments, measured)]
    within = [_within(motion, sensor) for sensor in sensors]
    if not any(len(sensor) for sensor in within):
        raise apart(motion, sensors)
    states = motion.propagate(at=np.concatenate([sensor.stamps_ns for sensor in within]))
    errors = tuple(Errors(sensor.topic, sensor.stamps_ns, *errors_of(sensor, part))
                   for sensor, part in zip(within, divided(states, within)))
    left_out = sum(map(len, sensors)) - sum(map(len, within))
    return Comparison(tuple(measured), alignments, errors, left_out, (), None, motion)


def _within(motion: Motion, sensor: Measured) -> Measured:
    return sensor.rows(inside(motion, sensor.stamps_ns))


def statistics(vectors: Floats | None, final: bool = False) -> dict[str, Any]:
    """
    Return statistics of the lengths of vectors, and the rms of each component.

    Parameters
    ----------
    vectors : array, shape (n, 3), optional
        None or no rows: every value is None.
    final : bool
        Whether to return the last length as well.

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


def _horizon_dict(horizon: Horizon) -> dict[str, Any]:
    values = statistics(horizon.angles[:, None])
    return {'seconds': horizon.seconds, 'windows': len(horizon.angles),
            **{f'attitude_{name}_rad': values[name] for name in ('rms', 'median', 'p95')},
            **({'monitor': [one.as_dict() for one in horizon.judgements]}
               if horizon.judgements else {})}
