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
Compute the error of a model over a window: the measured minus the predicted final state.

The samples in the first fifth of the window are used to estimate the initial state, which is then
propagated under the logged torques. The samples in the last fifth are used to correct the
predicted state. This correction, taken at the end of the window, is the error. The covariance of
the error accounts for the uncertainty of the initial state and of the correction. The residual
torque is the constant torque that best explains the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.inference.guess import IDENTITY
from rigid_body_ros.inference.motion import errors_of
from rigid_body_ros.inference.noise import NoiseLevel
from rigid_body_ros.inference.residual_torque import measured_rates
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.derivatives import with_derivatives
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.scene.quantities import START

#: A state is estimated from one fifth of a window, which must contain at least `FEWEST` samples
#: from one sensor.
_PART, FEWEST = 5, 3
#: A sample is an outlier if its error exceeds both `_OUTLIER` standard deviations and `_UNUSUAL`
#: times the median error.
_OUTLIER, _UNUSUAL = 6.0, 4.0
#: An estimated state is corrected at most `_CORRECTIONS` times. The corrections stop earlier if
#: the chi-square of a correction is below `_NEGLIGIBLE`.
_CORRECTIONS, _NEGLIGIBLE = 6, 1e-2
#: Number of samples used to guess the rates.
_GUESSED = 5
#: The noise of the attitudes and of the angular velocities of a sensor.
Levels = tuple[NoiseLevel, NoiseLevel]


@dataclass(frozen=True, eq=False)
class WindowError:
    """
    The error of a prediction over a window, measured minus computed.

    Attributes
    ----------
    begin_ns, end_ns : int
    attitude : array, shape (3,), rad, body axes
        Rotation vector from the computed to the measured attitude at the end of the window. NaN if
        no attitude is measured.
    rate : array, shape (3,), rad/s, body axes
        Measured minus computed angular velocity at the end of the window.
    covariance : array, shape (6, 6)
        Covariance of `attitude` and `rate`, in this order.
    torque : array, shape (3,), N m, body axes
        The constant torque that best explains the error.
    torque_covariance : array, shape (3, 3), N^2 m^2
    outliers : int
        Number of samples ignored as outliers.
    residuals : tuple of (array or None, array or None)
        For each sensor, measured minus computed attitudes and angular velocities in the window.

    """

    begin_ns: int
    end_ns: int
    attitude: Floats
    rate: Floats
    covariance: Floats
    torque: Floats
    torque_covariance: Floats
    outliers: int
    residuals: tuple[tuple[Floats | None, Floats | None], ...]


class _Estimate(NamedTuple):
    """A correction of a start state, with its covariance and the number of outliers."""

    change: Floats
    covariance: Floats
    outliers: int
    #: Times of the samples, ns, shape (m,). For each time, `gain`, shape (p, m, 6), holds the
    #: correction that a unit error in each component causes.
    times_ns: Ints
    gain: Floats

    def by(self, errors: Floats) -> Floats:
        """Return the corrections, shape (p, k), that errors of shape (m, 6, k) cause."""
        return np.einsum('pmi,mik->pk', self.gain, errors)


def window_error(problem: Problem, sensors: Sequence[Measured], noises: Sequence[Levels],
                 begin_ns: int, end_ns: int) -> WindowError | None:
    """
    Compute the error of the model's prediction over a window.

    Parameters
    ----------
    problem : Problem
        The model and the torques. Only the rotor momentum of the start state is used.
    sensors : sequence of Measured
        The measurements, already converted to the clock and the axes of the problem.
    noises : sequence of (NoiseLevel, NoiseLevel)
        The noise of the attitudes and of the angular velocities of each sensor.
    begin_ns, end_ns : int
        Start and end of the window.

    Returns
    -------
    WindowError or None
        None if the first or the last fifth of the window contains too few samples.

    """
    turn_ns = end_ns - (end_ns - begin_ns) // _PART
    inside = [sensor.between(begin_ns, end_ns) for sensor in sensors]
    first = [sensor.between(begin_ns, begin_ns + end_ns - turn_ns) for sensor in inside]
    last = [sensor.between(turn_ns, end_ns) for sensor in inside]
    has_attitude, has_rates = (all(_longest(part, name) for part in (first, last))
                               for name in ('attitude', 'angular_velocity'))
    needs_attitude = problem.fields or any(log.in_space.any() for log in problem.logs)
    if not has_attitude and (needs_attitude or not has_rates):
        return None
    # Without attitudes, the first three components of a state are not estimated.
    fitted = slice(0 if has_attitude else 3, 6)
    guess = State(begin_ns, *_guess(first, begin_ns, has_attitude), _momentum(problem, begin_ns))
    start, estimate, *_ = _estimated(problem, guess, begin_ns, first, noises, fitted)
    times_ns = np.unique(np.concatenate(
        [[turn_ns, end_ns], *(sensor.stamps_ns for sensor in inside)]))
    model = problem.between(start, end_ns)
    states, slopes = with_derivatives(model, [START, 'torque_bias'], times_ns)
    derivatives, moved = np.split(slopes.both[..., fitted.start:], [-3], axis=2)
    row = int(np.searchsorted(times_ns, turn_ns))
    later = State(turn_ns, states.attitude[row], states.angular_velocity[row],
                  _momentum(problem, turn_ns))
    _, correction, ahead, to_end = _estimated(problem, later, end_ns, last, noises, fitted)
    sent = derivatives[-1]
    change = np.append(so3.difference(states.attitude[-1], ahead.attitude[-1]),
                       ahead.angular_velocity[-1] - states.angular_velocity[-1])
    change += to_end @ correction.change
    covariance = to_end @ correction.covariance @ to_end.T + sent @ estimate.covariance @ sent.T
    # The torque also changes the first estimate, and thereby the prediction.
    moved = moved - derivatives @ estimate.by(moved[np.searchsorted(times_ns, estimate.times_ns)])
    by_torque = (to_end @ correction.by(
        moved[np.searchsorted(times_ns, correction.times_ns)]))[fitted]
    # The torque that best explains the change, by weighted least squares.
    weight = np.linalg.solve(covariance[fitted, fitted], by_torque)
    torque_covariance = np.asarray(np.linalg.inv(by_torque.T @ weight), float)
    torque = torque_covariance @ (weight.T @ change[fitted])
    residuals = tuple(errors_of(sensor, states.rows(np.searchsorted(times_ns, sensor.stamps_ns)))
                      for sensor in inside)
    attitude = change[:3] if has_attitude else np.full(3, np.nan)
    return WindowError(begin_ns, end_ns, attitude, change[3:], covariance, torque,
                       torque_covariance, estimate.outliers + correction.outliers, residuals)


def _momentum(problem: Problem, time_ns: int) -> Floats:
    return problem.rotor_momentum(np.array([time_ns]))[0]


def _guess(sensors: Sequence[Measured], begin_ns: int,
           has_attitude: bool) -> tuple[Floats, Floats]:
    """Guess the attitude and the angular velocity at `begin_ns`."""
    gyro, mocap = (_longest(sensors, name) for name in ('angular_velocity', 'attitude'))
    source = gyro or mocap
    assert source is not None
    rates = np.median(measured_rates(source)[1][:_GUESSED], axis=0)
    if not has_attitude or mocap is None:
        return IDENTITY, rates
    seconds = 1e-9 * (begin_ns - mocap.stamps_ns[0])
    return so3.multiply(mocap.values[0], so3.exp(rates * seconds)), rates


def _longest(sensors: Sequence[Measured], name: str) -> Measured | None:
    """Return the sensor with the most samples of a quantity, if it has `FEWEST` or more."""
    return max((sensor for sensor in sensors if getattr(sensor, name) is not None
                and len(sensor) >= FEWEST), key=len, default=None)


def _estimated(problem: Problem, start: State, until_ns: int, sensors: Sequence[Measured],
               noises: Sequence[Levels], fitted: slice) -> tuple[State, _Estimate, Poses, Floats]:
    """
    Correct the `fitted` components of a start until the motion fits the samples of some sensors.

    Return the new start state, the last correction, the motion before that correction, and its
    final derivatives.
    """
    times_ns = np.unique(np.concatenate([*(sensor.stamps_ns for sensor in sensors), [until_ns]]))
    for _ in range(_CORRECTIONS):
        model = problem.between(start, int(times_ns[-1]))
        states, slopes = with_derivatives(model, [START], times_ns)
        derivatives = slopes.both[..., fitted]
        estimate = _solved(times_ns, states, derivatives, sensors, noises)
        change = estimate.change
        turned = so3.multiply(start.attitude, so3.exp(change[:3])) if len(change) > 3 \
            else start.attitude
        start = replace(start, attitude=so3.normalize(turned),
                        angular_velocity=start.angular_velocity + change[-3:])
        if change @ np.linalg.solve(estimate.covariance, change) < _NEGLIGIBLE:
            break
    return start, estimate, states, derivatives[-1]


def _solved(times_ns: Ints, states: Poses, derivatives: Floats,
            sensors: Sequence[Measured], noises: Sequence[Levels]) -> _Estimate:
    """Return the correction of the start that fits the samples best."""
    count, outliers = derivatives.shape[2], 0
    gain = np.zeros((count, len(times_ns), 6))
    normal, wide, right = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    for sensor, levels in zip(sensors, noises):
        rows = np.searchsorted(times_ns, sensor.stamps_ns)
        parts = [*zip(errors_of(sensor, states.rows(rows)), (slice(0, 3), slice(3, 6)), levels)]
        # Without corrections of the attitude, only the angular velocities are used.
        for errors, part, level in parts if count == 6 else parts[1:]:
            if errors is None or not len(errors):
                continue
            sizes = np.abs(errors).max(axis=1)
            kept = sizes <= max(_OUTLIER * level.stated, _UNUSUAL * float(np.median(sizes)))
            outliers += int(np.sum(~kept))
            columns = derivatives[rows[kept], part].reshape(-1, count) / level.stated
            weight = columns.T @ columns
            normal += weight
            wide += level.factor * weight
            right += columns.T @ (errors[kept].ravel() / level.stated)
            gain[:, rows[kept], part] += columns.T.reshape(count, -1, 3) / level.stated
    inverse = np.linalg.inv(normal)
    return _Estimate(inverse @ right, inverse @ wide @ inverse, outliers, times_ns,
                     np.tensordot(inverse, gain, 1))
