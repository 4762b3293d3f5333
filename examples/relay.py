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
Turn a message of your own into a torque: here the thrusts, N, of the four motors of a quadrotor.

    python examples/relay.py --ros-args -r torque:=/wrench

For your message, replace the type of the subscription and the function `torque_of`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from geometry_msgs.msg import WrenchStamped
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

#: m; x and y of the motors, which push along +z: front left, front right, rear left, rear right.
PLACES = [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)]
#: m (N m per N); drag torque about z per thrust. Its sign depends on how the motor turns.
DRAG = [0.01, -0.01, -0.01, 0.01]


def torque_of(thrusts: Sequence[float]) -> tuple[float, float, float]:
    """Return the torque about the centre of mass, N m, body axes: x front, y left, z up."""
    return (sum(y * thrust for (_, y), thrust in zip(PLACES, thrusts)),
            -sum(x * thrust for (x, _), thrust in zip(PLACES, thrusts)),
            sum(drag * thrust for drag, thrust in zip(DRAG, thrusts)))


class Relay(Node):
    """Publish the torque of each message on `thrusts`."""

    def __init__(self, **kwargs: object) -> None:
        super().__init__('relay', **kwargs)
        self._torque = self.create_publisher(WrenchStamped, 'torque', 10)
        self.create_subscription(Float64MultiArray, 'thrusts', self._on_thrusts, 10)

    def _on_thrusts(self, message: Float64MultiArray) -> None:
        wrench = WrenchStamped()
        # If your message has a header, use its stamp: wrench.header.stamp = message.header.stamp
        wrench.header.stamp = self.get_clock().now().to_msg()
        wrench.header.frame_id = 'base_link'
        torque = wrench.wrench.torque
        torque.x, torque.y, torque.z = torque_of(message.data)
        self._torque.publish(wrench)


def run(make: Callable[[], Node]) -> None:
    """Run a node until Ctrl-C."""
    rclpy.init()
    try:
        rclpy.spin(make())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    run(Relay)
