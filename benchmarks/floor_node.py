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

"""A minimal rclpy node for comparison: it publishes three messages for each WrenchStamped."""

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


class FloorNode(Node):
    """Responds to every torque with messages that contain the same numbers."""

    def __init__(self):
        super().__init__('floor_node')
        self._attitude = self.create_publisher(QuaternionStamped, 'attitude', 10)
        self._euler_angles = self.create_publisher(Vector3Stamped, 'euler_angles', 10)
        self._angular_velocity = self.create_publisher(Vector3Stamped, 'angular_velocity', 10)
        self.create_subscription(WrenchStamped, 'torque', self._on_torque, 1000)

    def _on_torque(self, wrench):
        attitude = QuaternionStamped(header=wrench.header)
        attitude.quaternion.x, attitude.quaternion.w = 0.6, 0.8
        self._attitude.publish(attitude)
        for publisher in (self._euler_angles, self._angular_velocity):
            message = Vector3Stamped(header=wrench.header)
            message.vector.x, message.vector.y, message.vector.z = 0.1, 0.2, 0.3
            publisher.publish(message)


if __name__ == '__main__':
    rclpy.init()
    try:
        rclpy.spin(FloorNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()
