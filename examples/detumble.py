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
Detumble a satellite with magnetic torque rods: the B-dot law, for a node in lockstep.

The rods oppose the change of the measured field (Stickler and Alfriend, "Elementary magnetic
attitude control system", 1976). The law needs no measured rates: the body turns much faster than
the field along the orbit, so the change of the measured field shows the rates.

    attitude_regress examples/detumble.mcap --scene examples/detumble.yaml --tolerance 1e-9 \
        -- python3 examples/detumble.py

The command needs a tolerance because the sine of another C library may differ in the last bit.
"""

from __future__ import annotations

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from relay import run
from torque_rods import measured_field, state, torque, wrench

#: A m^2 s/T.
_GAIN = 5e4


class BDot:
    """The B-dot law: a torque, N m, from time, s, and attitude."""

    def __init__(self) -> None:
        self._seconds, self._field, self._torque = -np.inf, np.zeros(3), np.zeros(3)

    def torque(self, seconds: float, attitude: np.ndarray) -> np.ndarray:
        """Return the torque; a second call for the same time returns the same torque."""
        if seconds > self._seconds:
            field = measured_field(seconds, attitude)
            change = (field - self._field) / (seconds - self._seconds)  # zero in the first call
            self._torque = torque(-_GAIN * change, field)
            self._seconds, self._field = seconds, field
        return self._torque


class Detumbler(Node):
    """Reply to every state with a torque."""

    def __init__(self) -> None:
        super().__init__('detumbler')
        self._law = BDot()
        self._rods = self.create_publisher(WrenchStamped, 'torque', 10)
        self.create_subscription(Odometry, 'odometry', self._on_state, 10)

    def _on_state(self, odometry: Odometry) -> None:
        seconds, attitude, _ = state(odometry)
        self._rods.publish(wrench(odometry.header, self._law.torque(seconds, attitude)))


if __name__ == '__main__':
    run(Detumbler)
