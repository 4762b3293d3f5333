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

"""The inputs of a fit, and how its recordings are divided into windows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from rigid_body_ros.common.arrays import entries, Floats
from rigid_body_ros.inference.coordinates import Parameters, Physics
from rigid_body_ros.inference.motion import span_of
from rigid_body_ros.inference.parameters import LONGEST_DELAY, SPACE
from rigid_body_ros.inference.sensors import clocked
from rigid_body_ros.inference.windows import AxialInertia, Window
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report.thinning import thinned

#: Approximate angle through which the body turns in each window of the first fit, rad.
_FIRST = 8.0
#: Minimum and maximum number of samples per channel in a window.
_SHORTEST, _LONGEST = 20, 60_000
#: Time by which a window begins before the first of its samples, ns, if a parameter shifts stamps.
_LEAD_NS = 200_000_000
#: Time for which torques from before a window are kept if a lag is fitted, ns, in addition to the
#: longest delay. A lag of a quarter of a second remembers a torque for this long.
_MEMORY_OF_LAG_NS = 10_000_000_000


@dataclass(frozen=True, eq=False)
class Setup:
    """
    All inputs of a fit, derived from the arguments of `identify`.

    If the windows share no parameters, `most` may limit the number of windows, to save time.
    """

    problems: Sequence[Problem]
    channels: list[list[Measured]]
    parameters: Parameters
    rate: float
    fits_start: bool
    attitude_noise: float | None
    rate_noise: float | None
    axial: Sequence[AxialInertia | None]
    most: int | None = None

    @property
    def given(self) -> Physics:
        """
        Return the guess given by the user.

        The fit may start from a different inertia if the given body is too flat.
        """
        return self.parameters.guess.with_value('inertia', entries(
            self.problems[0].body.inertia))

    @property
    def axial_tensor(self) -> Floats:
        """
        Return the axial inertia of the named wheels, as a tensor.

        The fitted inertia does not include this tensor.
        """
        return self.axial[0].tensor if self.axial[0] else np.zeros((3, 3))

    def body(self, physics: Physics) -> RigidBody:
        """Return the fitted body including its wheels."""
        return RigidBody(physics.inertia + self.axial_tensor, physics.damping) \
            if self.axial[0] else physics.body

    def start(self, number: int) -> State:
        """Return the initial state given by the user for a recording."""
        axial = self.axial[number]
        return axial.start if axial else self.problems[number].start

    @property
    def is_computed(self) -> bool:
        """Return whether the motion is computed, from states that may be unknown."""
        return isinstance(self.problems[0], Problem)

    @property
    def fits_attitude(self) -> list[bool]:
        """
        Return, for each recording, whether the initial attitude is fitted.

        It is not fitted if no attitude is measured, or if `space` is, which has the same effect.
        """
        return [SPACE not in self.parameters.groups and any(
            channel.is_attitude for channel in channels) for channels in self.channels]

    @property
    def span_ns(self) -> int:
        """Return the length of the longest recording, ns."""
        return max(max(int(channel.stamps_ns[-1]) for channel in channels)
                   - min(int(channel.stamps_ns[0]) for channel in channels)
                   for channels in self.channels) + 1

    @property
    def longest_ns(self) -> int:
        """Return the maximum length of a window, ns."""
        most = max(len(channel) for channels in self.channels for channel in channels)
        return max(int(self.span_ns * min(1.0, _LONGEST / most)), 1)

    @property
    def shortest_ns(self) -> int:
        """Return the length of the windows of the first fit, ns; all of a recorded motion."""
        if not self.is_computed:
            return self.longest_ns
        spacing = max(float(np.median(np.diff(channel.stamps_ns))) for channels in self.channels
                      for channel in channels)
        return int(min(max(1e9 * _FIRST / self.rate, _SHORTEST * spacing), self.longest_ns))

    def windows(self, length_ns: int, physics: Physics, parts: int = 1,
                few: int | None = None) -> list[Window]:
        """Divide all recordings into windows, and return at most `most` of them, or `few`."""
        lead_ns = _LEAD_NS if self.parameters.shifts else 0
        makers = [one for number, channels in enumerate(self.channels) for one in self.makers_of(
            number, channels, length_ns, physics, lead_ns, parts)]
        for most in (self.most, few):
            makers = makers[thinned(len(makers), most)] if most else makers
        return [make() for make in makers]

    def makers_of(self, number: int, channels: Sequence[Measured], length_ns: int,
                  physics: Physics, lead_ns: int = 0, parts: int = 1
                  ) -> list[Callable[[], Window]]:
        """
        Divide a recording into windows.

        Parameters
        ----------
        number : int
            Index of the recording.
        channels : sequence of Measured
            The channels of the recording.
        length_ns : int
            Approximate length of a window.
        physics : Physics
            The parameters, including the clocks of the sensors.
        lead_ns : int
            How long each window except the first begins before its samples.
        parts : int
            Number of windows to make from each `length_ns` of the recording.

        Returns
        -------
        list of callable
            A function for each window with samples, in chronological order, that makes the window.

        """
        problem, axial = self.problems[number], self.axial[number]
        start_ns = problem.start.time_ns
        stamps = [clocked(channel, physics, start_ns) for channel in channels]
        first_ns = max(start_ns, min(int(each[0]) for each in stamps))
        last_ns = min(max(int(each[-1]) for each in stamps), span_of(problem)[1])
        count = parts * max(1, round((last_ns - first_ns) / length_ns))
        edges = first_ns + np.arange(count + 1) * ((last_ns - first_ns) // count + 1)
        anchors = np.append(start_ns, np.maximum(edges[1:-1] - lead_ns, start_ns))
        momenta = problem.rotor_momentum(anchors)
        if axial:
            momenta = momenta + np.where(anchors > start_ns, 1.0, 0.0)[:, None] * (
                axial.tensor @ axial.rate)
        memory_ns = round(1e9 * LONGEST_DELAY) \
            + _MEMORY_OF_LAG_NS * ('torque_lag' in self.parameters.groups)
        ends = np.array([np.searchsorted(each, edges) for each in stamps])

        def made(k: int) -> Window:
            rows = [slice(*each[k:k + 2].tolist()) for each in ends]
            start = State(int(anchors[k]), rotor_momentum=momenta[k])
            near = problem.between(start, int(edges[k + 1]) + _LEAD_NS, memory_ns)
            return Window(number, k == 0, near,
                          [channel.rows(part) for channel, part in zip(channels, rows)], rows,
                          start_ns, axial.tensor if axial and anchors[k] == start_ns else None)
        filled = np.flatnonzero((np.diff(ends, axis=1) > 0).any(axis=0))
        return [partial(made, k) for k in filled.tolist()]
