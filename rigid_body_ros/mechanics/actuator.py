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

"""The model of an actuator: delay, limit and first-order lag of its commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.common.times import duration_ns, LONGEST
from rigid_body_ros.engine import EXPIRY, MOST_LAGS
from rigid_body_ros.mechanics.torque import TorqueLog

#: s; the shortest time constant other than zero.
_SHORTEST = 1e-9
#: ns; 146 years. Later times still fit int64.
_LONGEST_NS = 2 ** 62


@dataclass(frozen=True, eq=False)
class Actuator:
    """
    An actuator: it turns commands into the torques that act.

    A command u stamped t acts from t + delay on, limited axis by axis, in the axes in which it was
    given. The torque y follows it with a first-order lag, T y' + y = u. It is zero at the start of
    the motion. In body axes and in space axes it lags separately: after a command in one, the
    torque in the other decays. After 40 time constants the torque is the command.

    Parameters
    ----------
    delay : float, s
    time_constant : float, s
        0: the torque is the command at once. Otherwise at least 1e-9.
    limit : array, shape (3,), N m
        The largest absolute value about each axis; 0: no limit.

    Raises
    ------
    ValueError
        A number is negative, not finite or too large, or a time constant is too short.

    """

    delay: float = 0.0
    time_constant: float = 0.0
    limit: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        duration_ns(self.delay, 'delay of an actuator')
        constant = self.time_constant
        if not (constant == 0.0 or _SHORTEST <= constant <= LONGEST):
            raise ValueError(f'time_constant of an actuator: expected 0 or {_SHORTEST:g} to '
                             f'{LONGEST:g} s, found {constant}')
        limit = np.array(self.limit, float)
        if limit.shape != (3,) or not (np.isfinite(limit).all() and (limit >= 0.0).all()):
            raise ValueError('limit of an actuator: expected 3 finite numbers from 0 on, found '
                             f'{quoted(limit.tolist())}')
        limit.flags.writeable = False
        object.__setattr__(self, 'limit', limit)

    @cached_property
    def delay_ns(self) -> int:
        """Return the delay, ns, rounded."""
        return duration_ns(self.delay, 'delay of an actuator')

    @cached_property
    def expiry_ns(self) -> int:
        """Return the time after which the lag of a command is over, ns; 0 without a lag."""
        return min(round(EXPIRY * self.time_constant * 1e9), _LONGEST_NS)

    @property
    def lag(self) -> Actuator:
        """Return the lag of the actuator alone."""
        return Actuator(time_constant=self.time_constant)

    @cached_property
    def _bound(self) -> Floats | None:
        limit = np.asarray(self.limit)
        return np.where(limit > 0.0, limit, np.inf) if limit.any() else None

    def limited(self, torques: Floats) -> Floats:
        """Return commands, N m, shape (n, 3), within the limit."""
        return torques if self._bound is None else np.clip(torques, -self._bound, self._bound)

    def acting(self, log: TorqueLog) -> TorqueLog:
        """
        Return when and how the commands of a log act, before the lag.

        Raises
        ------
        ValueError
            The log is interpolated: a command is held.

        """
        if log.interpolation != 'hold':
            raise ValueError('actuator: expected commands that are held, found interpolation '
                             f'{log.interpolation!r}')
        return TorqueLog(log.times_ns + self.delay_ns, self.limited(log.torques), log.in_space)


#: One for every source, or one or None for each.
Actuators = Actuator | Sequence[Actuator | None] | None


def actuators_of(given: Actuators, count: int) -> tuple[Actuator | None, ...]:
    """
    Return the actuator of each of the sources.

    Raises
    ------
    ValueError
        There are more or fewer than the sources.

    """
    if given is None or isinstance(given, Actuator):
        return (given,) * count
    if len(given) != count:
        raise ValueError(f'actuator: expected {count}, one or None for each source, found '
                         f'{len(given)}')
    return tuple(given)


def time_constants(actuators: Sequence[Actuator | None]) -> list[float]:
    """
    Return the different time constants of actuators, s, in their order.

    Raises
    ------
    ValueError
        There are too many.

    """
    found = [*dict.fromkeys(each.time_constant for each in actuators
                            if each and each.time_constant)]
    if len(found) > MOST_LAGS:
        raise ValueError(f'actuator: expected at most {MOST_LAGS} different time constants, found '
                         f'{len(found)}')
    return found
