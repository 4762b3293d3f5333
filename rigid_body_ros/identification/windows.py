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

"""Windows of a recording, and the predictions of the sensors in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.identification.actuator import applied
from rigid_body_ros.identification.parameters import Physics
from rigid_body_ros.identification.sensors import clocked, mounts
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.sensing.measured import Measured

#: Parameters that the torques of a window depend on.
_OF_TORQUES = 'torque_gain', 'torque_gains', 'torque_delay', 'torque_lag'
Stamps = Sequence[NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class AxialInertia:
    """
    Axial inertia of wheels with names: the fitted body lacks it, and has the wheels as rotors.

    The speeds of wheels are known at the start, relative to the body. So their axial momenta there
    follow from the rate of the body.

    Attributes
    ----------
    tensor : array, shape (3, 3), kg m^2
        The sum of I a a^T.
    rate : array, shape (3,), rad/s
        A guess of the rate at the start, for windows that begin later.
    start : State
        As it was given, with the speeds of the wheels.

    """

    tensor: Floats
    rate: Floats
    start: State


@dataclass(eq=False)
class Window:
    """
    A part of a recording, whose motion is computed from a state at its beginning.

    Attributes
    ----------
    experiment : int
        Number of the recording.
    is_first : bool
        Whether it begins at the start of the recording.
    problem : Problem
        With the torques that act in the window, and the momentum of the rotors at its beginning.
        Body, attitude and angular velocity do not count.
    channels : list of Measured
    rows : list of slice
        Which samples of each channel of the recording are in the window.
    origin_ns : int
        The start of the recording, from which the drift of clocks counts.
    axial : array, shape (3, 3), kg m^2, optional
        Axial inertia of wheels with names whose speeds are known at its beginning: the momentum
        of the rotors is relative to the body there.
    is_in_body : bool
        Whether all torques are in body axes, so that the motion turns with its initial attitude.

    """

    experiment: int
    is_first: bool
    problem: Problem
    channels: list[Measured]
    rows: list[slice]
    origin_ns: int
    axial: Floats | None = None
    is_in_body: bool = field(init=False)
    #: The latest gain, delay and lag, and the problem with them.
    _applied: tuple[bytes, Problem] | None = field(init=False, default=None)
    #: The latest stamps of all channels, the indices of each in their union, and the union.
    _times: tuple[Stamps, list[NDArray[np.intp]], NDArray[np.int64]] | None = field(
        init=False, default=None)

    def __post_init__(self) -> None:
        self.is_in_body = not (self.problem.fields or any(log.in_space.any()
                                                          for log in self.problem.logs))

    @property
    def anchor_ns(self) -> int:
        """Return its beginning, ns."""
        return self.problem.start.time_ns

    def predict(self, physics: Sequence[Physics], states: Poses) -> list[Floats]:
        """
        Return what the sensors measure without noise, for each channel.

        Parameters
        ----------
        physics : sequence of Physics, length c
            The parameters.
        states : Poses
            The c states at the beginning.

        Returns
        -------
        list of array, shape (c, n, 4) or (c, n, 3)

        Raises
        ------
        ValueError
            As for `propagate`.

        """
        found = [np.empty((len(physics), len(channel), 4 if channel.is_attitude else 3))
                 for channel in self.channels]
        for i, (one, attitude, velocity) in enumerate(zip(physics, states.attitude,
                                                          states.angular_velocity)):
            rows, times_ns = self._instants(one)
            motion = self._motion(one, attitude, velocity, times_ns)
            for channel, values, here in zip(self.channels, found, rows):
                values[i] = (motion.attitude if channel.is_attitude
                             else motion.angular_velocity)[here]
        return [_attitudes(values, mount) if channel.is_attitude
                else _rates(values, mount, physics, channel.topic)
                for channel, values, mount
                in zip(self.channels, found, mounts(physics, self.channels))]

    def state_at(self, physics: Physics, attitude: Floats, velocity: Floats,
                 time_ns: int) -> tuple[Floats, Floats]:
        """Return attitude and angular velocity at a time, from those at the beginning."""
        motion = self._motion(physics, attitude, velocity, np.array([time_ns]))
        return motion.attitude[0], motion.angular_velocity[0]

    def _motion(self, physics: Physics, attitude: Floats, velocity: Floats,
                times_ns: NDArray[np.int64]) -> Trajectory:
        """Return the motion at times; before the beginning, the state there."""
        momentum = self.problem.start.rotor_momentum + physics.value('rotor_momentum')
        if self.axial is not None:
            momentum = momentum + self.axial @ velocity
        start = State(self.anchor_ns, attitude, velocity, momentum)
        fields = physics.acting(self.problem.fields) if physics.values else None
        problem = self._acting(physics, int(times_ns[-1])).replaced(
            body=physics.body, start=start, fields=fields or None)
        return problem.propagate(at=np.maximum(times_ns, self.anchor_ns))

    def _instants(self, physics: Physics) -> tuple[list[NDArray[np.intp]], NDArray[np.int64]]:
        """Return the times of all samples, each once, and the indices of each channel in them."""
        stamps = [clocked(channel, physics, self.origin_ns) for channel in self.channels]
        if self._times is None or not all(map(np.array_equal, stamps, self._times[0])):
            union = np.unique(np.concatenate(stamps))
            self._times = stamps, [np.searchsorted(union, each) for each in stamps], union
        return self._times[1:]

    @property
    def size(self) -> int:
        """Return the number of samples of all channels."""
        return sum(len(channel) for channel in self.channels)

    def _acting(self, physics: Physics, end_ns: int) -> Problem:
        """Return the problem with the torques that act up to a time."""
        key = b''.join(physics.value(name).tobytes() for name in _OF_TORQUES)
        if not self._applied or key != self._applied[0]:
            self._applied = key, self.problem.replaced(
                log=applied(self.problem.logs, physics, self.problem.options.timeout_ns))
        problem, bias = self._applied[1], physics.value('torque_bias')
        return problem.biased(bias, end_ns) if bias.any() else problem


def _attitudes(attitude: Floats, mount: Floats | None) -> Floats:
    return attitude if mount is None else so3.multiply(attitude, mount)


def _rates(velocity: Floats, mount: Floats | None, physics: Sequence[Physics],
           topic: str) -> Floats:
    if mount is not None:
        velocity = so3.rotate(so3.conjugate(mount), velocity)
    scale, bias = (np.array([one.value(name, topic) for one in physics])[:, None]
                   for name in ('gyro_scale', 'gyro_bias'))
    return scale * velocity + bias
