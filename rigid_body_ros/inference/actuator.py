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

"""Actuator model: apply gain, delay and lag to the logged torques."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.mechanics.torque import TorqueLog

#: Lags shorter than this, in seconds, are ignored.
_SHORTEST = 1e-6
#: Times after each torque sample at which the torque returned by `lagged` changes. The unit of
#: these times is the lag, rounded down to a power of two.
_NODES = np.concatenate([np.arange(1, 16) / 16.0, np.arange(8, 16) / 8.0, np.arange(8, 17) / 4.0,
                         [5.0, 6.0, 8.0]])


def applied(logs: Sequence[TorqueLog], physics: Physics, timeout_ns: int) -> list[TorqueLog]:
    """
    Return the torques that the actuators apply to the body, without the torque bias.

    Parameters
    ----------
    logs : sequence of TorqueLog
        The logged torques.
    physics : Physics
        The parameters, including gain, delay and lag.
    timeout_ns : int
        Longest time for which a torque sample acts, ns; see `TorqueLog.segments`.

    """
    gains = physics.number('torque_gain') * physics.value('torque_gains')
    delay_ns = round(physics.number('torque_delay') * 1e9)
    lag = physics.number('torque_lag')
    result = []
    for log in logs:
        scaled = TorqueLog(log.times_ns + delay_ns, gains * log.torques, log.in_space,
                           log.interpolation)
        result.append(lagged(scaled, lag, timeout_ns) if lag > _SHORTEST and len(log)
                      else scaled)
    return result


def lagged(log: TorqueLog, lag: float, timeout_ns: int = 0) -> TorqueLog:
    """
    Return the torque that an actuator with a first-order lag produces for a command.

    The result is piecewise constant. Each piece equals the mean of the exact lagged torque over
    that piece, so the impulse is exact. After a step in the command, the result changes several
    times within one time constant.

    Parameters
    ----------
    log : TorqueLog
        The commanded torque.
    lag : float, s
        Time constant; must be positive.
    timeout_ns : int
        Longest time for which a torque sample acts, ns; see `TorqueLog.segments`.

    Raises
    ------
    InputError
        The log contains torques both in body axes and in space axes.

    """
    if log.in_space.any() and not log.in_space.all():
        raise InputError('torque_lag: expected torques in one frame, found torques in body axes '
                         'and in space axes')
    nodes_ns = _nodes(log, lag, timeout_ns)
    seconds = np.append(np.diff(nodes_ns), round(1e9 * _NODES[-1] * lag)) * 1e-9
    begin = log.at(nodes_ns, timeout_ns)[0]
    slope = np.zeros_like(begin)
    if log.interpolation != 'hold':
        slope[:-1] = (log.at(nodes_ns[1:] - 1, timeout_ns)[0] - begin[:-1]) / seconds[:-1, None]
    ratio = seconds / lag
    decay = np.exp(-ratio)
    ends = begin + slope * (seconds - lag)[:, None]  # what the lagged torque converges to
    first = begin - slope * lag
    share = -np.expm1(-ratio) / ratio
    middle = 0.5 * slope * seconds[:, None]
    away = np.stack([_away(first[:, axis].tolist(), ends[:, axis].tolist(), decay.tolist())
                     for axis in range(3)], axis=1)
    means = first + middle + share[:, None] * away
    # The last value is held indefinitely. By then, the torque has caught up with the command.
    means[-1] = begin[-1]
    return TorqueLog(nodes_ns, means, 'space' if log.in_space.all() else 'body')


def _away(first: list[float], ends: list[float], decay: list[float]) -> list[float]:
    """Return the lagged torque minus the commanded torque at each stamp, for a single axis."""
    # The torque starts at zero. Plain floats are ten times as fast as arrays of three numbers.
    away, state = [], 0.0
    for command, end, left in zip(first, ends, decay):
        away.append(state - command)
        state = end + left * away[-1]
    return away


def _nodes(log: TorqueLog, lag: float, timeout_ns: int) -> NDArray[np.int64]:
    """
    Return the times at which the piecewise constant lagged torque changes, ns.

    The times usually stay the same when the lag changes a little.
    """
    times_ns = log.segments(timeout_ns)[0]
    unit_ns = 1e9 * 2.0 ** math.floor(math.log2(lag))
    after = np.round(unit_ns * _NODES).astype(np.int64)
    gaps = np.append(np.diff(times_ns), np.iinfo(np.int64).max)
    nodes = times_ns[:, None] + after
    return np.union1d(times_ns, nodes[after < gaps[:, None]])
