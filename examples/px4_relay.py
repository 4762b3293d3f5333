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
Connect a rate controller for PX4 to attitude_node, as PX4's bridge would.

    python examples/px4_relay.py

The relay publishes each state as /fmu/out/vehicle_attitude and /fmu/out/vehicle_angular_velocity,
and the answers on /fmu/in/vehicle_torque_setpoint as torques. The body frame of the scene is PX4's
(front, right, down), its space frame north, east, down. The node must run in lockstep.
"""

from __future__ import annotations

import sys

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from relay import run

try:
    from px4_msgs.msg import VehicleAngularVelocity, VehicleAttitude, VehicleTorqueSetpoint
except ImportError:
    sys.exit('px4_relay: expected the package px4_msgs: build PX4/px4_msgs in your workspace')

#: N m about front, right and down, at a setpoint of 1; the mixer and the motors decide it.
MAX_TORQUE = (2.0, 2.0, 0.5)


def torque_of(setpoint: VehicleTorqueSetpoint) -> WrenchStamped:
    """Return the torque of a normalized setpoint, at the time of the state that it answers."""
    wrench = WrenchStamped()
    wrench.header.frame_id = 'base_link'
    seconds, rest = divmod(setpoint.timestamp_sample, 10 ** 6)
    wrench.header.stamp.sec, wrench.header.stamp.nanosec = int(seconds), int(rest) * 1000
    torque = wrench.wrench.torque
    torque.x, torque.y, torque.z = (
        most * float(part) for most, part in zip(MAX_TORQUE, setpoint.xyz))
    return wrench


def messages_of(state: Odometry) -> tuple[VehicleAttitude, VehicleAngularVelocity]:
    """Return a state as PX4's messages, whose quaternion is w x y z, and whose time is in us."""
    stamp, q, w = state.header.stamp, state.pose.pose.orientation, state.twist.twist.angular
    # The node's step must be a whole number of microseconds.
    time = stamp.sec * 10 ** 6 + stamp.nanosec // 1000
    return (VehicleAttitude(timestamp=time, timestamp_sample=time, q=[q.w, q.x, q.y, q.z]),
            VehicleAngularVelocity(timestamp=time, timestamp_sample=time, xyz=[w.x, w.y, w.z]))


class Px4Relay(Node):
    """Relay states to the controller, and its setpoints to the node."""

    def __init__(self, **kwargs: object) -> None:
        super().__init__('px4_relay', **kwargs)
        self._torque = self.create_publisher(WrenchStamped, 'torque', 10)
        self._out = (self.create_publisher(VehicleAttitude, '/fmu/out/vehicle_attitude', 10),
                     self.create_publisher(VehicleAngularVelocity,
                                           '/fmu/out/vehicle_angular_velocity', 10))
        self.create_subscription(Odometry, 'odometry', self._on_state, 10)
        self.create_subscription(
            VehicleTorqueSetpoint, '/fmu/in/vehicle_torque_setpoint',
            lambda setpoint: self._torque.publish(torque_of(setpoint)), qos_profile_sensor_data)

    def _on_state(self, state: Odometry) -> None:
        for publisher, message in zip(self._out, messages_of(state)):
            publisher.publish(message)


if __name__ == '__main__':
    run(Px4Relay)
