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

"""The inputs of a fit, and the windows that they can be divided into."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.identification.parameters import Parameters, Physics
from rigid_body_ros.identification.windows import AxialInertia, LEAD_NS, Window, windows_of
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.sensing.measured import Measured

#: rad; the body turns by about this much in the first windows.
_FIRST = 8.0
#: Fewest and most samples of a channel in a window.
_SHORTEST, _LONGEST = 20, 60_000


@dataclass(frozen=True, eq=False)
class Setup:
    """The inputs of a fit: see `identify`."""

    problems: Sequence[Problem]
    channels: list[list[Measured]]
    parameters: Parameters
    rate: float
    fits_start: bool
    attitude_noise: float | None
    rate_noise: float | None
    axial: Sequence[AxialInertia | None]

    @property
    def given(self) -> Physics:
        """Return the guess as it was given: a fit may begin with a thicker body."""
        return replace(self.parameters.guess, inertia=self.problems[0].body.inertia)

    @property
    def axial_tensor(self) -> Floats:
        """Return the inertia of the body minus the inertia that is fitted, (3, 3)."""
        return self.axial[0].tensor if self.axial[0] else np.zeros((3, 3))

    def body(self, physics: Physics) -> RigidBody:
        """Return the body with its wheels."""
        return RigidBody(physics.inertia + self.axial_tensor, physics.damping) \
            if self.axial[0] else physics.body

    def start(self, number: int) -> State:
        """Return the start of a recording as it was given."""
        axial = self.axial[number]
        return axial.start if axial else self.problems[number].start

    @property
    def fits_attitude(self) -> list[bool]:
        """Return whether attitudes are measured, for each recording."""
        return [any(channel.is_attitude for channel in channels) for channels in self.channels]

    @property
    def span_ns(self) -> int:
        """Return the length of the longest recording, ns."""
        return max(max(int(channel.stamps_ns[-1]) for channel in channels)
                   - min(int(channel.stamps_ns[0]) for channel in channels)
                   for channels in self.channels) + 1

    @property
    def longest_ns(self) -> int:
        """Return the longest length of a window, ns."""
        most = max(len(channel) for channels in self.channels for channel in channels)
        return max(int(self.span_ns * min(1.0, _LONGEST / most)), 1)

    @property
    def shortest_ns(self) -> int:
        """Return the length of the first windows, ns."""
        spacing = max(float(np.median(np.diff(channel.stamps_ns))) for channels in self.channels
                      for channel in channels)
        return int(min(max(1e9 * _FIRST / self.rate, _SHORTEST * spacing), self.longest_ns))

    def windows(self, length_ns: int, physics: Physics, parts: int = 1) -> list[Window]:
        """Return all recordings in windows of about this length, each divided into parts."""
        lead_ns = LEAD_NS if self.parameters.shifts else 0
        return [window for number, (problem, channels, axial)
                in enumerate(zip(self.problems, self.channels, self.axial))
                for window in windows_of(number, problem, channels, length_ns, physics, lead_ns,
                                         parts, axial)]
