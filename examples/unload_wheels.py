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
Hold an attitude with reaction wheels, and unload them with magnetic torque rods, in lockstep.

Disturbances of one sign speed the wheels up until they saturate. The rods exert a torque against
the part of the wheel momentum that is perpendicular to the field of the Earth (Camillo and
Markley, "Orbit-averaged behavior of magnetic control laws for momentum unloading", 1980). The
wheels hold the attitude against this torque and slow down. Along an orbit the direction of the
field changes, so in time the rods remove all of the momentum.

    attitude_regress examples/unload_wheels.mcap --scene examples/unload_wheels.yaml \
        --tolerance 1e-9 -- python3 examples/unload_wheels.py

The command needs a tolerance because the sine of another C library may differ in the last bit.
"""

from __future__ import annotations

import math

from geometry_msgs.msg import Vector3Stamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from relay import run
from torque_rods import measured_field, state, torque, wrench

#: N m/rad, N m s/rad; gains of the wheels.
_PROPORTIONAL, _DERIVATIVE = 3.5e-4, 5e-3
#: 1/s; how fast the rods remove momentum.
_UNLOADING = 2e-3


def of_wheels(attitude: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the torque on the rotors, N m, that turns the body axes to the space axes."""
    return math.copysign(2.0 * _PROPORTIONAL, attitude[3]) * attitude[:3] + _DERIVATIVE * rates


def of_rods(seconds: float, attitude: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """Return the torque of the rods, N m, against a momentum of the wheels, N m s."""
    field = measured_field(seconds, attitude)
    return torque(_UNLOADING * np.cross(momentum, field) / np.dot(field, field), field)


class Unloader(Node):
    """Reply to every state with a torque of the rods and a torque on the wheels."""

    def __init__(self) -> None:
        super().__init__('unloader')
        self._rods = self.create_publisher(WrenchStamped, 'torque', 10)
        self._wheels = self.create_publisher(WrenchStamped, 'wheel_torque', 10)
        #: By stamp, ns: the messages of a state, until both have arrived.
        self._states: dict[int, Odometry] = {}
        self._momenta: dict[int, Vector3Stamped] = {}
        for kind, topic, waiting in ((Odometry, 'odometry', self._states),
                                     (Vector3Stamped, 'rotor_momentum', self._momenta)):
            self.create_subscription(kind, topic, lambda message, waiting=waiting:
                                     self._on_message(message, waiting), 10)

    def _on_message(self, message: Odometry | Vector3Stamped, waiting: dict) -> None:
        stamp = message.header.stamp
        key = stamp.sec * 10 ** 9 + stamp.nanosec
        waiting[key] = message
        if key in self._states and key in self._momenta:
            self._respond(self._states.pop(key), self._momenta.pop(key).vector)

    def _respond(self, odometry: Odometry, momentum: object) -> None:
        seconds, attitude, rates = state(odometry)
        momentum = np.array([momentum.x, momentum.y, momentum.z])
        self._rods.publish(wrench(odometry.header, of_rods(seconds, attitude, momentum)))
        self._wheels.publish(wrench(odometry.header, of_wheels(attitude, rates)))


if __name__ == '__main__':
    run(Unloader)
