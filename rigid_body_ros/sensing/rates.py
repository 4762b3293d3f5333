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

"""Get angular velocities from a sensor, either measured or computed from its attitudes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.measured import Measured


def measured_rates(sensor: Measured) -> tuple[NDArray[np.int64], Floats]:
    """
    Return the angular velocities of a sensor.

    If the sensor does not measure angular velocities, they are computed from its attitudes.

    Each computed value is the mean angular velocity between two adjacent samples, and its time is
    halfway between their stamps.

    Returns
    -------
    times_ns : array of int64, shape (n,) or (n - 1,)
    rates : array, shape (n, 3) or (n - 1, 3), rad/s, body axes

    """
    stamps_ns, attitude = sensor.stamps_ns, sensor.attitude
    if sensor.angular_velocity is not None:
        return stamps_ns, sensor.angular_velocity
    assert attitude is not None
    spans = np.diff(stamps_ns)
    turned = so3.log(so3.multiply(so3.conjugate(attitude[:-1]), attitude[1:]))
    return stamps_ns[:-1] + spans // 2, turned / (1e-9 * spans)[:, None]
