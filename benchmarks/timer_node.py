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

"""A minimal rclpy node for comparison: it counts torques, and publishes an attitude at 100 Hz."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import QuaternionStamped, WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rigid_body_ros.live.events import APPLIED
from rigid_body_ros.node.process import main


class TimerNode(Node):
    """Also reports once a second how many torques it has received."""

    def __init__(self):
        super().__init__('timer_node')
        self._count = 0
        self._attitude = self.create_publisher(QuaternionStamped, 'attitude', 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_subscription(
            WrenchStamped, 'torque', self._on_torque,
            QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT), raw=True)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.01, self._publish, clock=steady)
        self.create_timer(1.0, self._report, clock=steady)

    def _on_torque(self, data):
        self._count += 1

    def _publish(self):
        attitude = QuaternionStamped()
        attitude.header.stamp = self.get_clock().now().to_msg()
        attitude.quaternion.x, attitude.quaternion.w = 0.6, 0.8
        self._attitude.publish(attitude)

    def _report(self):
        self._diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(
            name='/timer_node: torques',
            values=[KeyValue(key=APPLIED, value=str(self._count))])]))


if __name__ == '__main__':
    main(kind=TimerNode, command='timer_node')
