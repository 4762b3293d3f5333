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

"""Disperse the recorded torques, and the torque of a controller, in the runs of an ensemble."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rigid_body_ros.ensemble.applied import Applied, later, later_commands
from rigid_body_ros.ensemble.loop import Actuated
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem


@dataclass(frozen=True)
class Torques:
    """
    The dispersed torques in the runs of an ensemble.

    Parameters
    ----------
    problem : Problem
        The nominal motion.
    end_ns : int, ns
        The end of every run.
    seed : int
        The seed of the random numbers.
    noise : float, N m
        Standard deviation of the noise in each component of the torque.

    """

    problem: Problem
    end_ns: int
    seed: int
    noise: float

    def recorded(self, applied: Applied, row: int) -> tuple[list[TorqueLog], TorqueLog | None]:
        """
        Return the recorded torques in a run: first those on the body, then those on the rotors.

        Raises
        ------
        ValueError
            A torque is not finite, or a stamp does not fit into 64 bits.

        """
        gain, offset = applied.torque_gain[row], float(applied.clock_offset[row])
        torques = [gain * log.torques for log in self.problem.logs]
        if self.noise:
            random = self._random(int(applied.runs[row]))
            torques = [torque + random.normal(0.0, self.noise, torque.shape)
                       for torque in torques]
        logs = [later(log, offset, torque) for log, torque in zip(self.problem.logs, torques)]
        bias, wheels = applied.torque_bias[row], self.problem.wheels
        if bias.any():
            logs.append(TorqueLog.constant(bias, self.problem.start.time_ns, self.end_ns,
                                           self.problem.options.timeout_ns))
        return logs, wheels and later(wheels, offset)

    def commands(self, applied: Applied, row: int) -> EffortLog | None:
        """Return the commands for named wheels in a run; raise the same errors as `recorded`."""
        efforts = self.problem.efforts
        return efforts and later_commands(efforts, float(applied.clock_offset[row]))

    def actuated(self, applied: Applied, row: int) -> Actuated:
        """Return a function that applies the gain and noise of a run to a controller's torque."""
        gain, noise = applied.torque_gain[row], self.noise
        if not noise:
            return lambda torque: np.asarray(gain * torque)
        random = self._random(int(applied.runs[row]), 1)
        return lambda torque: np.asarray(gain * torque + random.normal(0.0, noise, 3))

    def _random(self, *key: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))
