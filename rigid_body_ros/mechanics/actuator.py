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

"""An actuator model with a delay, a torque limit and a first-order lag."""

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

#: Shortest accepted time constant other than zero, s.
_SHORTEST = 1e-9
#: Longest duration of a lag, ns (146 years). A ROS stamp plus this duration still fits in int64.
_LONGEST_NS = 2 ** 62


@dataclass(frozen=True, eq=False)
class Actuator:
    """
    An actuator, which turns commanded torques into the torques applied to the body.

    A command u with stamp t takes effect at t + `delay`. Each component of u is clipped to
    +-`limit`, in the axes in which the command was given. The applied torque y then follows u with
    a first-order lag, T y' + y = u, where T is `time_constant`. The torque y is zero at the start
    of the motion. Once u has been constant for 40 time constants, y equals u. Torques in body axes
    and torques in space axes lag separately: when a command in space axes replaces a command in
    body axes, the torque in body axes decays while the torque in space axes builds up, and vice
    versa.

    Parameters
    ----------
    delay : float, s
    time_constant : float, s
        The time constant T of the lag: at least 1e-9, or 0 for no lag.
    limit : array, shape (3,), N m
        The largest absolute torque about each axis, or 0 for no limit.

    Raises
    ------
    ValueError
        A parameter is negative, not finite or too large, or the time constant is between 0 and
        1e-9.

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
        """Return the time, ns, for which the lag lasts after a command; 0 if there is no lag."""
        return min(round(EXPIRY * self.time_constant * 1e9), _LONGEST_NS)

    @property
    def lag(self) -> Actuator:
        """Return an actuator with the same lag, but without the delay and the limit."""
        return Actuator(time_constant=self.time_constant)

    @cached_property
    def _bound(self) -> Floats | None:
        limit = np.asarray(self.limit)
        return np.where(limit > 0.0, limit, np.inf) if limit.any() else None

    def limited(self, torques: Floats) -> Floats:
        """Clip commands, N m, shape (n, 3), to the limit."""
        return torques if self._bound is None else np.clip(torques, -self._bound, self._bound)

    def acting(self, log: TorqueLog) -> TorqueLog:
        """
        Return a log of commands after the delay and the limit, but without the lag.

        Raises
        ------
        ValueError
            The log is interpolated. An actuator accepts only commands that are held.

        """
        if log.interpolation != 'hold':
            raise ValueError('actuator: expected commands that are held, found interpolation '
                             f'{log.interpolation!r}')
        return TorqueLog(log.times_ns + self.delay_ns, self.limited(log.torques), log.in_space)


#: One actuator for all torque sources, a sequence with an actuator or None for each source, or
#: None if there are no actuators.
Actuators = Actuator | Sequence[Actuator | None] | None


def actuators_of(given: Actuators, count: int) -> tuple[Actuator | None, ...]:
    """
    Return the actuator of each torque source, or None for a source without an actuator.

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
    Return the distinct nonzero time constants, s, in the order of the actuators.

    Raises
    ------
    ValueError
        There are more than `MOST_LAGS` distinct time constants.

    """
    constants = [*dict.fromkeys(actuator.time_constant for actuator in actuators
                                if actuator and actuator.time_constant)]
    if len(constants) > MOST_LAGS:
        raise ValueError(f'actuator: expected at most {MOST_LAGS} different time constants, found '
                         f'{len(constants)}')
    return constants
