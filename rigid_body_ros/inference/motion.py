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

"""Propagated and recorded motions that measurements can be compared with."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.inference.noise import FEWEST, JUMP
from rigid_body_ros.mechanics import hermite, so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.recording.measured import Measured

#: Lengths of the parts that `Recorded.of_attitudes` tries, s, and by how much the errors may
#: exceed those of the next shorter parts.
_PARTS, _AS_GOOD = (1.0, 0.5, 0.25, 0.125, 0.06, 0.0), 1.15
#: A part, or the time between two parts, has a gap if it is longer than usual by this factor.
_GAP = 1.5
#: Step by which interpolated rates are differentiated, ns.
_STEP_NS = 10_000
#: The noise is estimated from this quantile of the squared errors of the parts.
_QUANTILE = 0.95


class Recorded:
    """
    A recorded motion, interpolated between its samples.

    Parameters
    ----------
    samples : Measured
        The samples of the motion. They must contain both attitudes and angular velocities.
    source : Measured, optional
        The attitudes that `of_attitudes` was given.
    spacing_ns : int
        The errors of samples of the motion that are further apart than this, ns, are independent.

    Attributes
    ----------
    source : Measured, optional
    spacing_ns : int
    start : State
        The earliest state.
    end_ns : int
        Time of the latest state.

    """

    def __init__(self, samples: Measured, source: Measured | None = None,
                 spacing_ns: int = 0) -> None:
        self.source, self.spacing_ns = source, spacing_ns
        stamps_ns, attitude, rates = samples.stamps_ns, samples.attitude, samples.angular_velocity
        assert attitude is not None
        assert rates is not None
        self._stamps_ns, self._poses = stamps_ns, Poses(attitude, rates)
        self.start = State(int(stamps_ns[0]), attitude[0], rates[0])
        self.end_ns = int(stamps_ns[-1])

    @classmethod
    def of_attitudes(cls, sensor: Measured) -> Recorded:
        """
        Return the motion that a sensor measures with at least ten attitudes.

        The measurement is divided into parts, as long as rotation vectors in them follow a
        polynomial. The motion has a state in the middle of each part, and is unknown where the
        measurement has a gap. Single outliers are ignored.

        Raises
        ------
        InputError
            The attitude never changes, or too few attitudes are no outliers and in no gap.

        """
        steps = so3.angle_between(sensor.values[:-1], sensor.values[1:])
        if not steps.any():
            raise InputError(f'{sensor.topic}: expected an attitude that changes, found '
                             f'{sensor.values[0].tolist()} in all {len(sensor)} samples')
        alone = np.minimum(np.append(steps, np.inf), np.append(np.inf, steps))
        sensor = sensor.rows(alone <= JUMP * np.median(steps[steps > 0.0]))
        spacing = max(1e-9 * float(np.median(np.diff(sensor.stamps_ns))), 1e-9)
        if len(sensor) < FEWEST:
            raise InputError(f'{sensor.topic}: expected at least {FEWEST} attitudes that '
                             f'are not outliers, found {len(sensor)}')
        fewest = FEWEST // 2  # because at least two parts are needed to interpolate
        halves = [min(max(round(0.5 * length / spacing), fewest // 2),
                      (len(sensor) // 2 - 1) // 2) for length in _PARTS]
        fits = [_polynomials(sensor, half) for half in dict.fromkeys(halves)]
        longest = next((k for k, (fit, shorter) in enumerate(pairwise(fits))
                        if fit[1] <= _AS_GOOD * shorter[1]), len(fits) - 1)
        # In the next shorter parts, the errors of the polynomials are far below the noise.
        motion, _ = fits[min(longest + 1, len(fits) - 1)]
        if len(motion) < 2:
            raise InputError(f'{sensor.topic}: expected attitudes without so many gaps, found '
                             f'{len(motion)} parts with at least {fewest} samples')
        return cls(motion, sensor, int(np.median(np.diff(motion.stamps_ns))))

    def is_known(self, times_ns: Ints) -> NDArray[np.bool_]:
        """Return a mask of the times that are not in a gap between the samples."""
        rows = np.clip(np.searchsorted(self._stamps_ns, times_ns) - 1, 0,
                       len(self._stamps_ns) - 2)
        is_near = np.diff(self._stamps_ns)[rows] <= _GAP * self.spacing_ns
        return is_near if self.spacing_ns else np.ones(len(times_ns), bool)

    #: A recorded motion has no torques. A window asks for them, and for the two methods below.
    fields = logs = actuators = ()

    def between(self, *_: object) -> Recorded:
        """Return the same motion."""
        return self

    def rotor_momentum(self, times_ns: Ints) -> Floats:
        """Return zeros, shape (m, 3)."""
        return np.zeros((len(times_ns), 3))

    def angular_acceleration(self, times_ns: Ints) -> Floats:
        """Return the angular acceleration, rad/s^2, body axes, shape (m, 3)."""
        before, after = (self.propagate(at=times_ns + step) for step in (-_STEP_NS, _STEP_NS))
        return (after.angular_velocity - before.angular_velocity) / (2e-9 * _STEP_NS)

    def propagate(self, *, at: Ints) -> Poses:
        """Return the states at the given times, interpolated by `hermite.between`."""
        stamps_ns, (attitude, rates) = self._stamps_ns, self._poses
        rows = np.clip(np.searchsorted(stamps_ns, at, 'right') - 1, 0, len(stamps_ns) - 2)
        span = np.diff(stamps_ns)[rows] * 1e-9
        part = (at - stamps_ns[rows]) * 1e-9 / span
        return Poses(*hermite.between((attitude[rows], rates[rows]),
                                      (attitude[rows + 1], rates[rows + 1]), span, part))


def _polynomials(sensor: Measured, half: int) -> tuple[Measured, float]:
    """
    Fit polynomials to parts of `2 * half + 1` attitudes, of second or third degree.

    Return the states in the middle of the parts, and an estimate of the noise of the attitudes.
    """
    from scipy.special import chdtri
    seconds, attitude = 1e-9 * (sensor.stamps_ns - sensor.stamps_ns[0]), sensor.values
    # Parts do not overlap, because the acceleration between overlapping parts would only be noise.
    middle = np.arange(half, len(sensor) - half, 2 * half + 1)
    around = middle[:, None] + np.arange(-half, half + 1)
    lengths = np.ptp(seconds[around], axis=1)
    length = float(np.median(lengths))
    middle, around = middle[lengths <= _GAP * length], around[lengths <= _GAP * length]
    turns = so3.difference(attitude[middle][:, None], attitude[around])
    times = seconds[around] - seconds[middle, None]
    columns = (times[..., None] / length) ** np.arange(3 if half < 4 else 4)
    normal = np.einsum('nki,nkj->nij', columns, columns)
    coefficients = np.linalg.solve(normal, np.einsum('nki,nkx->nix', columns, turns))
    # A short manoeuvre shows in few parts, so use a high quantile, divided by that of chi-square.
    left = np.quantile(np.sum((turns - columns @ coefficients) ** 2, axis=(1, 2)), _QUANTILE)
    usual = chdtri(3.0 * (around.shape[1] - columns.shape[2]), 1.0 - _QUANTILE)
    # The derivative of a small rotation vector is the angular velocity in body axes.
    motion = Measured(sensor.topic, sensor.stamps_ns[middle],
                      so3.multiply(attitude[middle], so3.exp(coefficients[:, 0])),
                      coefficients[:, 1] / length)
    return motion, float(np.sqrt(left / usual))


#: A motion that measurements can be compared with.
Motion = Problem | Recorded


def poses_of(states: Trajectory | Poses) -> Poses:
    """Return the attitudes and the angular velocities of a motion."""
    return Poses(states.attitude, states.angular_velocity)


def span_of(motion: Motion) -> tuple[int, int]:
    """Return the times of the earliest and the latest state, ns."""
    return motion.start.time_ns, motion.end_ns if isinstance(motion, Recorded) else NEVER_NS // 2


def inside(motion: Motion, times_ns: Ints, margin_ns: int = 0) -> NDArray[np.bool_]:
    """
    Return a mask of the times that are inside a motion.

    These times are at least `margin_ns` after the start and before the end of the motion, and not
    in a gap of a recorded motion.
    """
    first_ns, last_ns = span_of(motion)
    within = (times_ns >= first_ns + margin_ns) & (times_ns <= last_ns - margin_ns)
    return within & motion.is_known(times_ns) if isinstance(motion, Recorded) else within


def divided(states: Trajectory | Poses, sensors: Sequence[Measured]) -> list[Poses]:
    """
    Divide states among sensors, and return one set of states for each sensor.

    The argument `states` holds the states at the samples of the first sensor, followed by those of
    the other sensors.
    """
    ends = np.cumsum([0, *map(len, sensors)]).tolist()
    return [poses_of(states).rows(slice(*part)) for part in pairwise(ends)]


def errors_of(sensor: Measured, states: Poses) -> tuple[Floats | None, Floats | None]:
    """
    Return how far the measurements of a sensor are from a motion at the same times.

    Returns
    -------
    rotation_vectors : array, shape (n, 3), optional
        Rotation from the computed to the measured attitude, rad, body axes.
    rate_errors : array, shape (n, 3), optional
        Measured minus computed angular velocity, rad/s, body axes.

    """
    attitude, rates = sensor.attitude, sensor.angular_velocity
    return (None if attitude is None else so3.difference(states.attitude, attitude),
            None if rates is None else rates - states.angular_velocity)


def no_overlap_error(motion: Motion, sensors: Sequence[Measured]) -> InputError:
    """Return the error to raise if the measurements and the motion do not overlap in time."""
    stamps_ns = sensors[0].stamps_ns
    return InputError(f'{sensors[0].topic}: expected measurements during the motion, which begins '
                      f'at {motion.start.time_ns} ns, found them from {stamps_ns[0]} ns to '
                      f'{stamps_ns[-1]} ns; are the clocks the same (--time-source log)?')
