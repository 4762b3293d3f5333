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

"""Recordings of a body, divided into channels. Each channel is one quantity of one topic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import Logs, torque_logs, TorqueLog
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.measured import Measured

#: Minimum number of samples in a channel.
_FEWEST = 8
#: An angular velocity is estimated from two attitudes that are about `_LAG` seconds apart. A state
#: is estimated from about `_LOCAL` samples.
_LAG, _LOCAL = 0.1, 25


@dataclass(frozen=True, eq=False)
class Experiment:
    """
    One recording: the torques that acted on the body, and the measurements.

    Attributes
    ----------
    start : State
        The initial state, or a guess of the initial state if 'start' is fitted. Measurements taken
        before the start are ignored.
    log : TorqueLog, sequence of TorqueLog or None
        The torques, as for `propagate`.
    measured : sequence of Measured
        The measurements of the sensors.
    wheels : TorqueLog or sequence of Wheel, optional
        The torque on the rotors, or the named wheels, as for `propagate`. All recordings must have
        the same wheels.
    fields : sequence of Field
        The fields, as for `propagate`. All recordings must have the same fields.
    efforts : EffortLog, optional
        Commands for the named wheels. The motion is first computed with the guess, to find out
        which commands are refused because a wheel has reached its maximum speed.
    torques : Account, optional
        What became of the recorded torques.

    """

    start: State
    log: Logs
    measured: Sequence[Measured]
    wheels: TorqueLog | Sequence[Wheel] | None = None
    fields: Sequence[Field] = ()
    efforts: EffortLog | None = None
    torques: Account | None = None

    @property
    def logs(self) -> list[TorqueLog]:
        """Return the torques as a list."""
        return torque_logs(self.log)


def channels_of(experiment: Experiment) -> list[Measured]:
    """
    Return the channels of a recording, without samples from before the start of the motion.

    Raises
    ------
    InputError
        The recording has no measured topic, or a topic has too few finite samples after the start.

    """
    if not experiment.measured:
        raise InputError('expected at least one measured topic, found none')
    return [_checked(channel, experiment.start.time_ns) for measured in experiment.measured
            for channel in measured.channels()]


def _checked(channel: Measured, start_ns: int) -> Measured:
    what = 'attitudes' if channel.is_attitude else 'angular velocities'
    finite = np.atleast_1d((np.abs(channel.values) <= FASTEST).all(axis=1))
    if channel.is_attitude:
        finite &= channel.values.any(axis=1)
    if not finite.any():
        raise InputError(f'{channel.topic}: expected finite {what}, found none among '
                         f'{len(finite)} samples')
    channel = channel.rows(finite & (channel.stamps_ns >= start_ns))
    if not len(channel):
        raise InputError(f'{channel.topic}: expected {what} from the start of the motion '
                         f'({start_ns} ns) on, found only earlier ones')
    if len(channel) < _FEWEST:
        raise InputError(f'{channel.topic}: expected at least {_FEWEST} {what} from the start of '
                         f'the motion on, found {len(channel)}')
    return replace(channel, attitude=so3.normalize(channel.values)) if channel.is_attitude \
        else channel


def typical_rate(channels: Sequence[Measured]) -> float:
    """Return an outlier-resistant estimate of the root-mean-square angular velocity, rad/s."""
    rates = [channel.values if not channel.is_attitude else _rates(channel)
             for channel in channels]
    found = max(float(np.sqrt(np.mean(np.minimum(squares, 25.0 * np.median(squares)))))
                for squares in (np.sum(rate * rate, axis=1) for rate in rates))
    return max(found, 1e-6)


def _rates(channel: Measured) -> Floats:
    """Compute angular velocities from pairs of attitudes that are close in time."""
    spacing = np.median(np.diff(channel.stamps_ns)) * 1e-9
    lag = min(max(1, round(_LAG / max(spacing, 1e-9))), len(channel) - 1)
    turned = so3.log(so3.multiply(so3.conjugate(channel.values[:-lag]), channel.values[lag:]))
    seconds = (channel.stamps_ns[lag:] - channel.stamps_ns[:-lag]) * 1e-9
    return turned / np.maximum(seconds, 1e-9)[:, None]


def local_state(channels: Sequence[Measured], time_ns: int, rate: float,
                fallback: State) -> tuple[Floats, Floats]:
    """
    Estimate the attitude and angular velocity at a given time from nearby measurements.

    Parameters
    ----------
    channels : sequence of Measured
        The measurements, already converted to the torque clock and to body axes.
    time_ns : int
        The time at which the state is wanted.
    rate : float, rad/s
        Typical angular velocity.
    fallback : State
        A state that provides the quantities that were not measured.

    Returns
    -------
    attitude, angular_velocity : array, shape (4,) and (3,)

    """
    attitude, velocity = fallback.attitude, fallback.angular_velocity
    has_rate = False
    for channel in channels:
        if channel.is_attitude or has_rate:
            continue
        near = _near(channel, time_ns, rate)
        if len(near):
            velocity = _robust_line((near.stamps_ns - time_ns) * 1e-9, near.values)[0]
            has_rate = True
    for channel in (one for one in channels if one.is_attitude):
        near = _near(channel, time_ns, rate)
        if not len(near):
            continue
        middle = near.values[np.argsort(near.stamps_ns)[len(near) // 2]]
        turned = so3.log(so3.multiply(so3.conjugate(middle), near.values))
        here, slope = _robust_line((near.stamps_ns - time_ns) * 1e-9, turned)
        attitude = so3.multiply(middle, so3.exp(here))
        velocity = velocity if has_rate else slope
        break
    return attitude, velocity


def _near(channel: Measured, time_ns: int, rate: float) -> Measured:
    span_ns = int(0.5e9 / rate)
    centre = int(np.searchsorted(channel.stamps_ns, time_ns))
    near = channel.rows(slice(max(centre - _LOCAL // 2, 0), centre + _LOCAL))
    distances = np.abs(near.stamps_ns - time_ns)
    closest = np.sort(distances)[:3]
    return near.rows(distances <= max(span_ns, int(closest.max(initial=0))))


def _robust_line(seconds: NDArray[np.floating], values: Floats) -> tuple[Floats, Floats]:
    """
    Fit a low-order polynomial to each column, giving less weight to outliers.

    Return the values of the polynomials and their slopes at time zero.
    """
    degree = 0 if len(seconds) < 3 else 1 if len(seconds) < 7 else 2
    columns = np.vander(seconds, degree + 1, increasing=True)
    weights: Floats = np.ones(len(seconds))
    coefficients: Floats = np.zeros((degree + 1, 3))
    for _ in range(8):
        root = np.sqrt(weights)[:, None]
        coefficients = np.linalg.lstsq(columns * root, values * root, rcond=None)[0]
        errors = np.linalg.norm(values - columns @ coefficients, axis=1)
        weights = 1.0 / (1.0 + (errors / (2.0 * np.median(errors) + 1e-12)) ** 2)
    return coefficients[0], coefficients[1] if degree else np.zeros(3)
