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

"""Convert between the clock and axes of a sensor and the clock and axes of a motion."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import as_json, Floats
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.recording.measured import Measured


def _identity() -> Floats:
    return np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Alignment:
    """
    The clock offset and the rotations that relate the measurements of a sensor to a motion.

    The measured attitude equals `space` * (attitude of the motion) * `mount`.

    Attributes
    ----------
    clock_offset_s : float, s
        The time to add to the measured stamps to convert them to the clock of the motion.
    mount, space : array, shape (4,)
        Quaternions x y z w. `mount` rotates vectors from the axes of the sensor to the body axes.
        `space` rotates vectors from the space axes of the motion to the space axes of the
        measurements. All sensors share the same `space`.
    start : State, optional
        The fitted start; None if the start was not fitted.
    sigma : dict, optional
        Standard deviations of the fitted values. A standard deviation is infinite if the
        measurement does not determine the value. The entry 'clock_offset_s' is a number, s. The
        other entries are arrays of shape (3,): 'mount_rad', about the axes of the sensor;
        'space_rad', about the space axes of the measurements; 'initial_attitude_rad', about the
        body axes; and 'initial_angular_velocity_rad_s'.

    """

    clock_offset_s: float = 0.0
    mount: Floats = field(default_factory=_identity)
    space: Floats = field(default_factory=_identity)
    start: State | None = None
    sigma: dict[str, Any] | None = None

    def of_sensor(self) -> dict[str, Any]:
        """Return the clock offset and the mounting of the sensor as JSON types."""
        return {'clock_offset_s': self.clock_offset_s, 'mount_xyzw': _upper(self.mount).tolist()}

    def as_dict(self) -> dict[str, Any]:
        """Return the alignment as JSON types, with None for infinite standard deviations."""
        found: dict[str, Any] = {
            **self.of_sensor(), 'space_xyzw': _upper(self.space).tolist(),
            'start': 'fitted' if self.start else 'scene'}
        if self.start:
            found['initial_attitude_xyzw'] = self.start.attitude.tolist()
            found['initial_angular_velocity_rad_s'] = self.start.angular_velocity.tolist()
        if self.sigma:
            found['sigma'] = {name: as_json(value) for name, value in self.sigma.items()}
        return found

    def applied(self, sensor: Measured) -> Measured:
        """Convert the measurements of a sensor to the clock and the axes of the motion."""
        attitude, rate = sensor.attitude, sensor.angular_velocity
        if attitude is not None:
            attitude = so3.multiply(so3.multiply(so3.conjugate(self.space), attitude),
                                    so3.conjugate(self.mount))
        if rate is not None:
            rate = so3.rotate(self.mount, rate)
        turn = so3.matrix(self.mount)

        def turned(covariance: Floats | None) -> Floats | None:
            return None if covariance is None else turn @ covariance @ turn.T
        return replace(sensor, stamps_ns=sensor.stamps_ns + round(1e9 * self.clock_offset_s),
                       attitude=attitude, angular_velocity=rate,
                       attitude_covariance=turned(sensor.attitude_covariance),
                       rate_covariance=turned(sensor.rate_covariance))


def _upper(quaternion: Floats) -> Floats:
    return -quaternion if quaternion[3] < 0.0 else quaternion
