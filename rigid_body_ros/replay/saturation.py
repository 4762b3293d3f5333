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

"""Find efforts and wheel speeds that exceed the limits of named wheels."""

from __future__ import annotations

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.wheels import Wheels
from rigid_body_ros.propagation import Trajectory


class Saturation:
    """
    Speeds and efforts of named wheels, compared with `max_speed` and `max_torque`.

    Parameters
    ----------
    wheels : Wheels

    Attributes
    ----------
    speeds : array, shape (n,), rad/s
        The largest speed of each wheel at any output; zeros if no wheel has a `max_speed`.
    clipped, refused : int
        How many efforts were clipped to `max_torque`, and how many acted as zero because the wheel
        was at `max_speed` or above.

    """

    def __init__(self, wheels: Wheels) -> None:
        self._wheels = wheels
        self.speeds: Floats = np.zeros(len(wheels))
        self.clipped = self.refused = 0
        #: The number of rows of the log that have been counted.
        self._counted = 0

    def add(self, motion: Trajectory, log: EffortLog | None, refused: int) -> None:
        """
        Add a part of the motion.

        Parameters
        ----------
        motion : Trajectory
            The part.
        log : EffortLog, optional
            All commands to the wheels, for the whole motion.
        refused : int
            How many efforts acted as zero from the start of the motion to the end of this part.

        """
        if self._wheels.is_limited:
            speeds = np.abs(motion.wheel_speeds).max(axis=0, initial=0.0)
            self.speeds = np.maximum(self.speeds, speeds)
        self.refused = refused
        if log and motion.times_ns.size:
            stop = int(np.searchsorted(log.times_ns, motion.times_ns[-1], 'right'))
            self.clipped += self._wheels.count_clipped(log.efforts[self._counted:stop])
            self._counted = stop

    @property
    def warnings(self) -> list[str]:
        """Return warnings about wheels that were too fast and about efforts that were changed."""
        found = [f'{wheel.name}: the wheel turned at up to {speed:.6g} rad/s, faster than its '
                 f'max_speed of {wheel.max_speed:.9g} rad/s, which is checked only when a command '
                 'takes effect'
                 for wheel, speed in zip(self._wheels.wheels, self.speeds.tolist())
                 if 0.0 < wheel.max_speed < speed]
        if self.clipped:
            found.append(f'efforts clipped to max_torque: {self.clipped}')
        if self.refused:
            found.append(f'efforts that acted as zero at max_speed: {self.refused}')
        return found
