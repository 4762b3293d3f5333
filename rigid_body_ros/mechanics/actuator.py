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

#: Shortest time constant other than zero, s.
_SHORTEST = 1e-9
#: Longest time until a lag is over, ns (146 years). A ROS stamp plus this time still fits int64.
_LONGEST_NS = 2 ** 62


@dataclass(frozen=True, eq=False)
class Actuator:
    """
    An actuator, which turns commanded torques into the torques that act on the body.

    A command u with the stamp t acts from t + `delay` on. Each component of u is clipped to
    +-`limit`, in the axes in which the command was given. The torque y follows the command with a
    first-order lag, T y' + y = u, where T is `time_constant`. y is zero at the start of the
    motion, and equals u once u has not changed for 40 time constants. The torques in body axes and
    in space axes lag separately: when a command in space axes replaces a command in body axes, the
    torque in body axes decays while the torque in space axes builds up, and vice versa.

    Parameters
    ----------
    delay : float, s
    time_constant : float, s
        At least 1e-9, or 0 for no lag.
    limit : array, shape (3,), N m
        The largest absolute value of the torque about each axis; 0 for no limit.

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
        """Return the delay in whole nanoseconds."""
        return duration_ns(self.delay, 'delay of an actuator')

    @cached_property
    def expiry_ns(self) -> int:
        """Return how long the lag after a command lasts, ns; 0 without a lag."""
        return min(round(EXPIRY * self.time_constant * 1e9), _LONGEST_NS)

    @property
    def lag(self) -> Actuator:
        """Return an actuator with the lag of this one, but without its delay and limit."""
        return Actuator(time_constant=self.time_constant)

    @cached_property
    def _bound(self) -> Floats | None:
        limit = np.asarray(self.limit)
        return np.where(limit > 0.0, limit, np.inf) if limit.any() else None

    def limited(self, torques: Floats) -> Floats:
        """Return commands, N m, shape (n, 3), clipped to the limit."""
        return torques if self._bound is None else np.clip(torques, -self._bound, self._bound)

    def acting(self, log: TorqueLog) -> TorqueLog:
        """
        Return the commands of a log after the delay and the limit, but before the lag.

        Raises
        ------
        ValueError
            The log is interpolated; an actuator accepts only commands that are held.

        """
        if log.interpolation != 'hold':
            raise ValueError('actuator: expected commands that are held, found interpolation '
                             f'{log.interpolation!r}')
        return TorqueLog(log.times_ns + self.delay_ns, self.limited(log.torques), log.in_space)


#: One actuator for all sources of torque, an actuator or None for each source, or no actuator.
Actuators = Actuator | Sequence[Actuator | None] | None


def actuators_of(given: Actuators, count: int) -> tuple[Actuator | None, ...]:
    """
    Return the actuator of each source.

    Raises
    ------
    ValueError
        The number of actuators differs from the number of sources.

    """
    if given is None or isinstance(given, Actuator):
        return (given,) * count
    if len(given) != count:
        raise ValueError(f'actuator: expected {count}, one or None for each source, found '
                         f'{len(given)}')
    return tuple(given)


def time_constants(actuators: Sequence[Actuator | None]) -> list[float]:
    """
    Return the distinct nonzero time constants of actuators, s, in the order of the actuators.

    Raises
    ------
    ValueError
        There are more than `MOST_LAGS` distinct time constants.

    """
    found = [*dict.fromkeys(each.time_constant for each in actuators
                            if each and each.time_constant)]
    if len(found) > MOST_LAGS:
        raise ValueError(f'actuator: expected at most {MOST_LAGS} different time constants, found '
                         f'{len(found)}')
    return found
