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
from rigid_body_ros.identification.experiment import mounted
from rigid_body_ros.identification.parameters import Physics
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.sensing.measured import Measured

#: ns; a window with a fitted clock begins this much before its first sample.
LEAD_NS = 200_000_000


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
    is_in_body : bool
        Whether all torques are in body axes, so that the motion turns with its initial attitude.

    """

    experiment: int
    is_first: bool
    problem: Problem
    channels: list[Measured]
    rows: list[slice]
    #: Of all channels, increasing, each once.
    stamps_ns: NDArray[np.int64] = field(init=False)
    is_in_body: bool = field(init=False)
    _scaled: tuple[float, Problem] = field(init=False)
    #: Where in `stamps_ns` those of each channel are.
    _moments: list[NDArray[np.intp]] = field(init=False)

    def __post_init__(self) -> None:
        stamps_ns = [channel.stamps_ns for channel in self.channels]
        self.stamps_ns = np.unique(np.concatenate(stamps_ns))
        self.is_in_body = not (self.problem.fields or any(log.in_space.any()
                                                          for log in self.problem.logs))
        self._scaled = 1.0, self.problem
        self._moments = [np.searchsorted(self.stamps_ns, each) for each in stamps_ns]

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
        motions = [self._motion(*one, self.stamps_ns + round(one[0].clock_offset * 1e9))
                   for one in zip(physics, states.attitude, states.angular_velocity)]
        attitude = np.stack([motion.attitude for motion in motions])
        velocity = np.stack([motion.angular_velocity for motion in motions])
        vectors = np.array([one.mount for one in physics])
        mount = so3.exp(vectors)[:, None] if vectors.any() else None
        bias = np.array([one.gyro_bias for one in physics])[:, None]
        return [_attitudes(attitude[:, rows], mount) if channel.is_attitude
                else _rates(velocity[:, rows], mount if is_mounted else None, bias)
                for channel, rows, is_mounted
                in zip(self.channels, self._moments, mounted(self.channels))]

    def state_at(self, physics: Physics, attitude: Floats, velocity: Floats,
                 time_ns: int) -> tuple[Floats, Floats]:
        """Return attitude and angular velocity at a time, from those at the beginning."""
        motion = self._motion(physics, attitude, velocity, np.array([time_ns]))
        return motion.attitude[0], motion.angular_velocity[0]

    def _motion(self, physics: Physics, attitude: Floats, velocity: Floats,
                times_ns: NDArray[np.int64]) -> Trajectory:
        """Return the motion at times, at the beginning for earlier ones."""
        momentum = self.problem.start.rotor_momentum + physics.rotor_momentum
        start = State(self.anchor_ns, attitude, velocity, momentum)
        fields = physics.acting(self.problem.fields) if physics.moments else None
        problem = self._acting(physics).replaced(body=physics.body, start=start, fields=fields)
        return problem.propagate(at=np.maximum(times_ns, self.anchor_ns))

    @property
    def size(self) -> int:
        """Return the number of samples of all channels."""
        return sum(len(channel) for channel in self.channels)

    def _acting(self, physics: Physics) -> Problem:
        """Return the problem with the gain and the bias of the torques."""
        if physics.torque_gain != self._scaled[0]:
            self._scaled = physics.torque_gain, self.problem.replaced(log=[
                log.with_torques(physics.torque_gain * log.torques) for log in self.problem.logs])
        problem = self._scaled[1]
        end_ns = int(self.stamps_ns[-1]) + LEAD_NS
        return problem.biased(physics.torque_bias, end_ns) if physics.torque_bias.any() \
            else problem


def _attitudes(attitude: Floats, mount: Floats | None) -> Floats:
    return attitude if mount is None else so3.multiply(attitude, mount)


def _rates(velocity: Floats, mount: Floats | None, bias: Floats) -> Floats:
    if mount is not None:
        velocity = so3.rotate(so3.conjugate(mount), velocity)
    return velocity + bias


def windows_of(number: int, problem: Problem, channels: Sequence[Measured], length_ns: int,
               offset_ns: int, lead_ns: int) -> list[Window]:
    """
    Divide a recording into windows.

    Parameters
    ----------
    number : int
        Number of the recording.
    problem : Problem
        Its start and its torques.
    channels : sequence of Measured
        Its sensors.
    length_ns : int
        Length of a window.
    offset_ns, lead_ns : int
        Added to the stamps; how much earlier than their first sample windows begin.

    Returns
    -------
    list of Window
        Those with samples, in order.

    """
    start_ns = problem.start.time_ns
    first_ns = max(start_ns, min(int(channel.stamps_ns[0]) for channel in channels) + offset_ns)
    last_ns = max(int(channel.stamps_ns[-1]) for channel in channels) + offset_ns
    count = max(1, round((last_ns - first_ns) / length_ns))
    edges = first_ns + np.arange(count + 1) * ((last_ns - first_ns) // count + 1)
    anchors = np.append(start_ns, np.maximum(edges[1:-1] - lead_ns, start_ns))
    momenta = problem.rotor_momentum(anchors)
    result = []
    for k, anchor_ns in enumerate(anchors.tolist()):
        rows = [slice(*np.searchsorted(channel.stamps_ns + offset_ns, [edges[k], edges[k + 1]]))
                for channel in channels]
        parts = [channel.rows(part) for channel, part in zip(channels, rows)]
        if not any(len(part) for part in parts):
            continue
        start = State(anchor_ns, rotor_momentum=momenta[k])
        result.append(Window(number, k == 0, problem.between(start, int(edges[k + 1]) + LEAD_NS),
                             parts, rows))
    return result
