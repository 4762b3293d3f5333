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
Two bare rclpy nodes for comparison: they send the messages of `attitude_node` and a controller.

`benchmarks/loop.py` runs the controller. As a command, this file runs the other node.
"""

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rigid_body_ros.live.run import LOG_DEPTH
from rigid_body_ros.node.process import run

STEP_NS = 1_000_000
_LOG_QOS = QoSProfile(depth=LOG_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class BareNode(Node):
    """Responds to every torque with the same state, and logs both."""

    def __init__(self):
        super().__init__('attitude_node')
        self._state = Odometry(child_frame_id='base_link')
        self._state.header.frame_id = 'world'
        self._odometry = self.create_publisher(Odometry, 'odometry', 10)
        self._accepted = self.create_publisher(WrenchStamped, '~/accepted_torque', _LOG_QOS)
        self._committed = self.create_publisher(Odometry, '~/committed', _LOG_QOS)
        self.create_subscription(WrenchStamped, 'torque', self._on_torque, 1000)

    def _on_torque(self, torque):
        given, stamp = torque.header.stamp, self._state.header.stamp
        seconds, stamp.nanosec = divmod(given.nanosec + STEP_NS, 10 ** 9)
        stamp.sec = given.sec + seconds
        self._odometry.publish(self._state)
        self._accepted.publish(torque)
        self._committed.publish(self._state)


class BareController(Node):
    """Responds to every state with the same torque; until the first, sends it every second."""

    def __init__(self):
        super().__init__('attitude_controller')
        self._torque = WrenchStamped()
        self._torque.header.frame_id = 'base_link'
        self._publisher = self.create_publisher(WrenchStamped, 'torque', 10)
        self.create_subscription(Odometry, 'odometry', self._on_state, 10)
        self._start = self.create_timer(1.0, lambda: self._publisher.publish(self._torque),
                                        clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_state(self, state):
        self._start.cancel()
        self._torque.header.stamp = state.header.stamp
        self._publisher.publish(self._torque)


if __name__ == '__main__':
    run(BareNode, 'bare_loop')
