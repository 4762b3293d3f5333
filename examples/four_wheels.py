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
Hold an attitude with four wheels, one of them skewed, in lockstep.

A PD law gives the torque on the body. Many efforts of the four wheels exert this torque; the
controller commands those with the least sum of squares.

    attitude_regress four_wheels.mcap --scene examples/four_wheels.yaml --update --duration 20 \
        -- python3 examples/four_wheels.py
"""

from __future__ import annotations

import math

from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from relay import run
from sensor_msgs.msg import JointState
from torque_rods import state

NAMES = ['rw_x', 'rw_y', 'rw_z', 'rw_skewed']
_SKEWED = 1.0 / math.sqrt(3.0)
#: Columns: the axes of the wheels, in body axes.
AXES = np.column_stack([np.eye(3), 3 * [_SKEWED]])
#: N m/rad, N m s/rad; gains of the PD law.
_PROPORTIONAL, _DERIVATIVE = 5e-3, 4e-2


def efforts(attitude: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the efforts, N m, that turn the body axes to the space axes."""
    wheels = math.copysign(2.0 * _PROPORTIONAL, attitude[3]) * attitude[:3] + _DERIVATIVE * rates
    # Written out, with the inverse of I + a a^T for |a| = 1, which is I - a a^T / 2. A linear
    # algebra library could give other digits on another machine.
    skewed = AXES[:, 3]
    first = wheels - 0.5 * skewed * (skewed[0] * wheels[0] + skewed[1] * wheels[1]
                                     + skewed[2] * wheels[2])
    return np.append(first, skewed[0] * first[0] + skewed[1] * first[1] + skewed[2] * first[2])


class Holder(Node):
    """Reply to every state with a command to the wheels."""

    def __init__(self) -> None:
        super().__init__('holder')
        self._wheels = self.create_publisher(JointState, 'wheel_command', 10)
        self.create_subscription(Odometry, 'odometry', self._respond, 10)

    def _respond(self, odometry: Odometry) -> None:
        _, attitude, rates = state(odometry)
        command = JointState(name=NAMES, effort=efforts(attitude, rates).tolist())
        command.header.stamp = odometry.header.stamp
        self._wheels.publish(command)


if __name__ == '__main__':
    run(Holder)
