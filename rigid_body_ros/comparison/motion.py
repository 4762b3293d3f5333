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

"""Motions to compare with measurements: propagated, or recorded before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.mechanics import hermite
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import propagate, Trajectory
from rigid_body_ros.sensing.measured import Measured


class Poses(NamedTuple):
    """Attitudes x y z w, shape (n, 4), and angular velocities, rad/s, body axes, shape (n, 3)."""

    attitude: Floats
    angular_velocity: Floats


@dataclass(frozen=True, eq=False)
class Model:
    """
    A body, its start and its torques.

    Attributes
    ----------
    body : RigidBody
    start : State
    logs : tuple of TorqueLog
        Their torques add up.
    wheels : TorqueLog, optional
        Torque of the motors on the rotors, body axes.
    options : dict
        Keyword arguments of `propagate`.
    last_ns : int
        Time of the latest state; the motion of an epoch ends where the next one begins.

    """

    body: RigidBody
    start: State
    logs: tuple[TorqueLog, ...] = ()
    wheels: TorqueLog | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    last_ns: int = NEVER_NS // 2

    @property
    def first_ns(self) -> int:
        """Return the time of the earliest state."""
        return self.start.time_ns

    @property
    def timeout_ns(self) -> int:
        """Return the torque timeout, ns; 0 if a torque is held for ever."""
        return round(1e9 * self.options.get('torque_timeout', 0.0))

    def at(self, times_ns: NDArray[np.int64]) -> Poses:
        """Return the states at times, in any order, none before the start."""
        motion = self.trajectory(times_ns)
        return Poses(motion.attitude, motion.angular_velocity)

    def trajectory(self, times_ns: NDArray[np.int64]) -> Trajectory:
        """Return the motion at times, in any order, none before the start."""
        return propagate(self.body, self.start, self.logs, at=times_ns, wheels=self.wheels,
                         **self.options)

    def rotor_momentum(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the momenta of the rotors at times, N m s, body axes, shape (n, 3)."""
        if self.wheels is None:
            return np.broadcast_to(self.start.rotor_momentum, (len(times_ns), 3))
        return self.trajectory(times_ns).rotor_momentum

    def between(self, start: State, end_ns: int) -> Model:
        """Return the same model from another start on, with only the torques it needs."""
        logs = tuple(log.between(start.time_ns, end_ns) for log in self.logs)
        wheels = self.wheels and self.wheels.between(start.time_ns, end_ns)
        return Model(self.body, start, logs, wheels, self.options)


@dataclass(frozen=True, eq=False)
class Recorded:
    """
    A motion that was recorded, interpolated between its samples.

    Attributes
    ----------
    samples : Measured
        With attitudes and angular velocities.

    """

    samples: Measured

    @property
    def first_ns(self) -> int:
        """Return the time of the earliest state."""
        return int(self.samples.stamps_ns[0])

    @property
    def last_ns(self) -> int:
        """Return the time of the latest state."""
        return int(self.samples.stamps_ns[-1])

    def at(self, times_ns: NDArray[np.int64]) -> Poses:
        """
        Return the states at times.

        `hermite.between` interpolates between the measured angular velocities.

        Raises
        ------
        InputError
            A time is after the last sample.

        """
        stamps_ns, attitude = self.samples.stamps_ns, self.samples.attitude
        rates = self.samples.angular_velocity
        assert attitude is not None
        assert rates is not None
        if times_ns.size and times_ns.max() > stamps_ns[-1]:
            raise InputError(f'expected a motion up to the last measurement at {times_ns.max()} '
                             f'ns, found its end at {stamps_ns[-1]} ns')
        rows = np.clip(np.searchsorted(stamps_ns, times_ns, 'right') - 1, 0, len(stamps_ns) - 2)
        span = np.diff(stamps_ns)[rows] * 1e-9
        part = (times_ns - stamps_ns[rows]) * 1e-9 / span
        return Poses(*hermite.between((attitude[rows], rates[rows]),
                                      (attitude[rows + 1], rates[rows + 1]), span, part))
