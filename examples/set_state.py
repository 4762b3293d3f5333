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
Set the attitude and the angular velocity of a running node, and print the answer of the node.

    python examples/set_state.py

The state applies from now on. The script waits until the node runs.
"""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
import rclpy
from rclpy.node import Node

#: x y z w, body to space, and rad/s, body axes.
ATTITUDE, RATES = (0.0, 0.0, 0.6, 0.8), (0.0, 0.0, 0.1)


def set_state(node: Node) -> DiagnosticStatus:
    """Send a state to the node attitude_node, and return its answer."""
    answers = []
    node.create_subscription(DiagnosticStatus, '/attitude_node/initial_state_result',
                             answers.append, 10)
    publisher = node.create_publisher(Odometry, 'initial_state', 10)
    while not publisher.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.1)
    state = Odometry()
    turn, rates = state.pose.pose.orientation, state.twist.twist.angular
    turn.x, turn.y, turn.z, turn.w = ATTITUDE
    rates.x, rates.y, rates.z = RATES
    state.header.stamp = node.get_clock().now().to_msg()
    while not answers:  # the node may not know this publisher yet
        publisher.publish(state)
        rclpy.spin_once(node, timeout_sec=1.0)
    return answers[0]


if __name__ == '__main__':
    rclpy.init()
    print(set_state(rclpy.create_node('setter')).message)
    rclpy.try_shutdown()
