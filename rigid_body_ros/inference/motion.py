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

"""Propagated and recorded motions that measurements can be compared with."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.mechanics import hermite
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.propagation import Problem, Trajectory
from rigid_body_ros.recording.measured import Measured


class Recorded:
    """
    A recorded motion, interpolated between its samples.

    Parameters
    ----------
    samples : Measured
        The samples of the motion. They must contain both attitudes and angular velocities.

    Attributes
    ----------
    start : State
        The earliest state.
    end_ns : int
        Time of the latest state.

    """

    def __init__(self, samples: Measured) -> None:
        stamps_ns, attitude, rates = samples.stamps_ns, samples.attitude, samples.angular_velocity
        assert attitude is not None
        assert rates is not None
        self._stamps_ns, self._poses = stamps_ns, Poses(attitude, rates)
        self.start = State(int(stamps_ns[0]), attitude[0], rates[0])
        self.end_ns = int(stamps_ns[-1])

    def propagate(self, *, at: NDArray[np.int64]) -> Poses:
        """Return the states at the given times, interpolated by `hermite.between`."""
        stamps_ns, (attitude, rates) = self._stamps_ns, self._poses
        rows = np.clip(np.searchsorted(stamps_ns, at, 'right') - 1, 0, len(stamps_ns) - 2)
        span = np.diff(stamps_ns)[rows] * 1e-9
        part = (at - stamps_ns[rows]) * 1e-9 / span
        return Poses(*hermite.between((attitude[rows], rates[rows]),
                                      (attitude[rows + 1], rates[rows + 1]), span, part))


#: `Motion` is the type of a motion that measurements can be compared with. `States` is the type of
#: the states of the motion.
Motion = Problem | Recorded
States = Trajectory | Poses


def span_of(motion: Motion) -> tuple[int, int]:
    """Return the times of the earliest and the latest state, ns."""
    return motion.start.time_ns, motion.end_ns if isinstance(motion, Recorded) else NEVER_NS // 2


def inside(motion: Motion, times_ns: NDArray[np.int64], margin_ns: int = 0) -> NDArray[np.bool_]:
    """
    Return a mask of the times that are inside a motion.

    These times are at least `margin_ns` after the start and before the end of the motion.
    """
    first_ns, last_ns = span_of(motion)
    return (times_ns >= first_ns + margin_ns) & (times_ns <= last_ns - margin_ns)


def divided(states: States, sensors: Sequence[Measured]) -> list[Poses]:
    """
    Divide states among sensors, and return one set of states for each sensor.

    The argument `states` holds the states at the samples of the first sensor, followed by those of
    the other sensors.
    """
    ends = np.cumsum([0, *map(len, sensors)]).tolist()
    every = Poses(states.attitude, states.angular_velocity)
    return [every.rows(slice(*part)) for part in pairwise(ends)]
