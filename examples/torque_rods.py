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

"""
Functions for controllers of magnetic torque rods: the field, the torque, and the messages.

Rods with the dipole m (A m^2, body axes) in the field B (T) exert the torque m x B on a satellite.
This torque has no component along the field.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from rigid_body_ros import so3

#: A m^2; the largest dipole of a rod. There is one rod on each body axis.
LARGEST = 0.2
#: T; the field of the Earth above the equator at 500 km, for a dipole along its axis.
_FIELD = 2.46e-5
#: rad/s and rad; a nearly polar orbit at 500 km.
_MEAN_MOTION, _INCLINATION = 1.1068e-3, 1.7


def measured_field(seconds: float, attitude: Sequence[float]) -> np.ndarray:
    """Return the field, T, body axes, shape (3,), that a magnetometer measures on the orbit."""
    phase = _MEAN_MOTION * seconds
    across, up = math.cos(_INCLINATION), math.sin(_INCLINATION)
    position = np.array([math.cos(phase), across * math.sin(phase), up * math.sin(phase)])
    field = _FIELD * (np.array([0.0, 0.0, 1.0]) - 3.0 * position[2] * position)
    return so3.rotate(so3.conjugate(attitude), field)


def torque(dipole: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Return the torque, N m, of a desired dipole, A m^2, clipped to what the rods can exert."""
    return np.cross(np.clip(dipole, -LARGEST, LARGEST), field)


def state(odometry: Odometry) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the time (s), the attitude (x y z w) and the rates (rad/s, body axes) of a state."""
    stamp, turn = odometry.header.stamp, odometry.pose.pose.orientation
    rates = odometry.twist.twist.angular
    return (stamp.sec + 1e-9 * stamp.nanosec, np.array([turn.x, turn.y, turn.z, turn.w]),
            np.array([rates.x, rates.y, rates.z]))


def wrench(header: object, values: np.ndarray) -> WrenchStamped:
    """Return a message with a torque, N m, body axes, and with the stamp of a state."""
    message = WrenchStamped()
    message.header.stamp = header.stamp
    message.wrench.torque.x, message.wrench.torque.y, message.wrench.torque.z = values.tolist()
    return message
