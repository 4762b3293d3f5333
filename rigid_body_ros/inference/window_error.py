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
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
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
_BIAS = 'torque_bias'


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
    times_ns: NDArray[np.int64]
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
    has_attitude = all(_count(part, 'attitude') >= FEWEST for part in (first, last))
    has_rates = all(_count(part, 'angular_velocity') >= FEWEST for part in (first, last))
    if not has_attitude and (not has_rates or _needs_attitude(problem)):
        return None
    guess = State(begin_ns, *_guess(first, begin_ns, has_attitude), _momentum(problem, begin_ns))
    start, estimate, *_ = _estimated(problem, guess, begin_ns, first, noises, has_attitude)
    times_ns = np.unique(np.concatenate(
        [[turn_ns, end_ns], *(sensor.stamps_ns for sensor in inside)]))
    model = problem.between(start, end_ns)
    states, both = linear_motion(model, times_ns, [START, _BIAS])
    derivatives, moved = np.split(both[..., 0 if has_attitude else 3:], [-3], axis=2)
    row = int(np.searchsorted(times_ns, turn_ns))
    later = State(turn_ns, states.attitude[row], states.angular_velocity[row],
                  _momentum(problem, turn_ns))
    _, found, ahead, slopes = _estimated(problem, later, end_ns, last, noises, has_attitude)
    to_end, sent = slopes[-1], derivatives[-1]
    change = _change(states.rows([-1]), ahead.rows([-1]))[0] + to_end @ found.change
    covariance = to_end @ found.covariance @ to_end.T + sent @ estimate.covariance @ sent.T
    # The torque also changes the first estimate, and thereby the prediction.
    moved = moved - derivatives @ estimate.by(moved[np.searchsorted(times_ns, estimate.times_ns)])
    by_torque = found.by(moved[np.searchsorted(times_ns, found.times_ns)])
    torque, torque_covariance = _explained(change, covariance, to_end @ by_torque, has_attitude)
    residuals = tuple(errors_of(sensor, states.rows(np.searchsorted(times_ns, sensor.stamps_ns)))
                      for sensor in inside)
    attitude = change[:3] if has_attitude else np.full(3, np.nan)
    return WindowError(begin_ns, end_ns, attitude, change[3:], covariance, torque,
                       torque_covariance, estimate.outliers + found.outliers, residuals)


def _momentum(problem: Problem, time_ns: int) -> Floats:
    return problem.rotor_momentum(np.array([time_ns]))[0]


def _count(sensors: Sequence[Measured], name: str) -> int:
    """Return the number of samples of the sensor with the most samples of the named quantity."""
    return max((len(sensor) for sensor in sensors if getattr(sensor, name) is not None), default=0)


def _needs_attitude(problem: Problem) -> bool:
    """Return whether a torque or a field of the problem depends on the attitude."""
    return bool(problem.fields) or any(log.in_space.any() for log in problem.logs)


def _guess(sensors: Sequence[Measured], begin_ns: int,
           has_attitude: bool) -> tuple[Floats, Floats]:
    """Guess the attitude and the angular velocity at `begin_ns`."""
    name = 'angular_velocity' if _count(sensors, 'angular_velocity') >= FEWEST else 'attitude'
    rates = np.median(measured_rates(_longest(sensors, name))[1][:_GUESSED], axis=0)
    if not has_attitude:
        return IDENTITY, rates
    turned = _longest(sensors, 'attitude')
    assert turned.attitude is not None
    seconds = 1e-9 * (begin_ns - turned.stamps_ns[0])
    return so3.multiply(turned.attitude[0], so3.exp(rates * seconds)), rates


def _longest(sensors: Sequence[Measured], name: str) -> Measured:
    return max((sensor for sensor in sensors if getattr(sensor, name) is not None), key=len)


def _corrected(start: State, change: Floats) -> State:
    turn, rate = change[:-3], change[-3:]
    attitude = so3.multiply(start.attitude, so3.exp(turn)) if len(turn) else start.attitude
    return State(start.time_ns, so3.normalize(attitude), start.angular_velocity + rate,
                 start.rotor_momentum)


def linear_motion(problem: Problem, times_ns: NDArray[np.int64],
                  names: Sequence[str] = (START,)) -> tuple[Poses, Floats]:
    """
    Compute a motion and its derivatives with respect to parameters.

    Returns
    -------
    states : Poses
        The motion at the m times.
    derivatives : array, shape (m, 6, p)
        At each time, there is one row for each component of the rotation vector and the rates, and
        one column for each of the p components of the parameters.

    """
    states, found = with_derivatives(problem, names, times_ns)
    return states, found.both


def _change(states: Poses, others: Poses) -> Floats:
    """Return other states minus the given ones, shape (m, 6)."""
    turned = so3.difference(states.attitude, others.attitude)
    return np.concatenate([turned, others.angular_velocity - states.angular_velocity], axis=1)


def _estimated(problem: Problem, start: State, until_ns: int, sensors: Sequence[Measured],
               noises: Sequence[Levels], has_attitude: bool
               ) -> tuple[State, _Estimate, Poses, Floats]:
    """
    Correct a start state until the motion fits the samples of some sensors.

    Without `has_attitude`, only the angular velocity is corrected. Return the new start state, the
    last correction, and the motion before that correction, with its derivatives.
    """
    times_ns = np.unique(np.concatenate([*(sensor.stamps_ns for sensor in sensors), [until_ns]]))
    for _ in range(_CORRECTIONS):
        model = problem.between(start, int(times_ns[-1]))
        states, derivatives = linear_motion(model, times_ns)
        derivatives = derivatives[..., 0 if has_attitude else 3:]
        estimate = _solved(times_ns, states, derivatives, sensors, noises)
        start, change = _corrected(start, estimate.change), estimate.change
        if change @ np.linalg.solve(estimate.covariance, change) < _NEGLIGIBLE:
            break
    return start, estimate, states, derivatives


def _solved(times_ns: NDArray[np.int64], states: Poses, derivatives: Floats,
            sensors: Sequence[Measured], noises: Sequence[Levels]) -> _Estimate:
    """Return the correction of the start that fits the samples best."""
    count, outliers = derivatives.shape[2], 0
    gain = np.zeros((count, len(times_ns), 6))
    normal, wide, right = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    for sensor, levels in zip(sensors, noises):
        rows = np.searchsorted(times_ns, sensor.stamps_ns)
        found = errors_of(sensor, states.rows(rows))
        parts = [*zip(found, (slice(0, 3), slice(3, 6)), levels)]
        # Without corrections of the attitude, only the angular velocities are used.
        for errors, part, level in parts if count == 6 else parts[1:]:
            if errors is None or not len(errors):
                continue
            kept = _usual(errors, level.stated)
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


def _usual(errors: Floats, sigma: float) -> NDArray[np.bool_]:
    """Return a mask of the errors that are not outliers."""
    sizes = np.abs(errors).max(axis=1)
    return np.asarray(sizes <= max(_OUTLIER * sigma, _UNUSUAL * float(np.median(sizes))))


def _explained(change: Floats, covariance: Floats, by_torque: Floats, has_attitude: bool
               ) -> tuple[Floats, Floats]:
    """
    Return the torque that best explains a change of the final state.

    The second result is the covariance of this torque.
    """
    first = 0 if has_attitude else 3
    weight = np.linalg.solve(covariance[first:, first:], by_torque[first:])
    spread = np.linalg.inv(by_torque[first:].T @ weight)
    return spread @ (weight.T @ change[first:]), spread
