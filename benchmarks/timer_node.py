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
A minimal rclpy node for comparison: it counts torques, and publishes states at a rate.

Its parameters are `rate`, Hz; `all_topics`, whether it publishes all topics of a robot and not
only the attitude; and `log`, whether it publishes the messages of the log for each torque.
"""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rigid_body_ros.live.events import APPLIED
from rigid_body_ros.node.process import run
from sensor_msgs.msg import Imu

TOPICS = {'attitude': QuaternionStamped, 'odometry': Odometry, 'euler_angles': Vector3Stamped,
          'angular_velocity': Vector3Stamped, 'imu/data': Imu, 'applied_torque': WrenchStamped}


class TimerNode(Node):
    """Also reports once a second how many torques it has received."""

    def __init__(self):
        super().__init__('attitude_node')
        rate, all_topics, self._logs = (
            self.declare_parameter(name, default).value for name, default in (
                ('rate', 100.0), ('all_topics', False), ('log', False)))
        self._count = 0
        topics = TOPICS if all_topics else {'attitude': QuaternionStamped}
        self._states = [(kind, self.create_publisher(kind, topic, 10))
                        for topic, kind in topics.items()]
        self._accepted = self.create_publisher(WrenchStamped, '~/accepted_torque', 10_000)
        self._committed = self.create_publisher(Odometry, '~/committed', 10_000)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_subscription(
            WrenchStamped, 'torque', self._on_torque,
            QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / rate, self._publish, clock=steady)
        self.create_timer(1.0, self._report, clock=steady)

    def _on_torque(self, torque):
        self._count += 1
        if self._logs:
            self._accepted.publish(torque)
            self._committed.publish(Odometry(header=torque.header))

    def _publish(self):
        stamp = self.get_clock().now().to_msg()
        for kind, publisher in self._states:
            message = kind()
            message.header.stamp = stamp
            publisher.publish(message)

    def _report(self):
        self._diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(
            name='/attitude_node: torques',
            values=[KeyValue(key=APPLIED, value=str(self._count))])]))


if __name__ == '__main__':
    run(TimerNode, 'timer_node')
