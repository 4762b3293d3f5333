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
A PD controller with quaternion feedback, which closes the loop with a node in lockstep.

The controller answers every state on `odometry` with a torque that carries the same stamp, and
resends the torque if no new state arrives. The loop runs over DDS as fast as the two nodes can
compute. No messages are lost, and the nodes compute the same numbers in every run.

    attitude_node --ros-args --params-file config/tumbler.yaml -p mode:=lockstep -p step:=0.01
    attitude_controller --ros-args -p stop_after:=60.0

You can also start both nodes with `ros2 launch rigid_body_ros closed_loop.launch.py`.

The control law was published by Wie and Barba, "Quaternion feedback for spacecraft large angle
maneuvers", 1985. Because q and -q describe the same attitude, the law uses the sign of the scalar
part to turn the body the short way round.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
import time

from geometry_msgs.msg import Quaternion, Vector3, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rigid_body_ros.common.errors import listed
from rigid_body_ros.node.process import one_line_errors, run
from rigid_body_ros.runtime.parameters import is_foreign

#: How long the controller waits for a new state before it resends the torque, in seconds.
_PATIENCE = 0.2
#: The body counts as settled when its attitude error in rad and its angular velocity in rad/s are
#: both below this value.
_SETTLED = 1e-3


class AttitudeController(Node):
    """
    Turn the body of a node in lockstep to a target attitude.

    Raises
    ------
    InputError
        A parameter is unknown, but its name resembles that of a known parameter.

    """

    def __init__(self) -> None:
        with one_line_errors():
            super().__init__('attitude_controller')
            self._gains = [self.declare_parameter(name, default).value for name, default in (
                ('proportional_gain', 0.05), ('derivative_gain', 0.12))]
            self._target = [self.declare_parameter(f'target.{name}', default).value
                            for name, default in zip('xyzw', (0.0, 0.0, 0.0, 1.0))]
            self._stop_after = self.declare_parameter('stop_after', math.inf).value
        self._check_names()
        self._command = WrenchStamped()
        self._start_ns: int | None = None
        self._sent_at = math.inf
        self._began, self._settled = time.monotonic(), False
        self.done = False
        self._torque = self.create_publisher(WrenchStamped, 'torque', 10)
        self.create_subscription(Odometry, 'odometry', self._on_state, 10)
        self.create_timer(_PATIENCE, self._resend, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _check_names(self) -> None:
        own = self.get_parameters_by_prefix('')
        others = [name for name, parameter in self._parameter_overrides.items()
                  if is_foreign(name, parameter.value, own)]
        if others:
            self.get_logger().info(
                f'parameters that are not those of a controller are ignored: {listed(others)}')

    def _on_state(self, state: Odometry) -> None:
        stamp_ns = state.header.stamp.sec * 10 ** 9 + state.header.stamp.nanosec
        if self._start_ns is None:
            self._start_ns, self._began = stamp_ns, time.monotonic()
        elapsed = (stamp_ns - self._start_ns) * 1e-9
        error = _relative(self._target, state.pose.pose.orientation)
        rates = state.twist.twist.angular
        if elapsed >= self._stop_after:
            self.done = True
            return
        if not self._settled:
            self._report(elapsed, error, rates)
        self._command.header.stamp = state.header.stamp
        self._command.header.frame_id = state.child_frame_id
        torque = self._command.wrench.torque
        proportional, derivative = self._gains
        towards = -math.copysign(2.0 * proportional, error[3])
        torque.x = towards * error[0] - derivative * rates.x
        torque.y = towards * error[1] - derivative * rates.y
        torque.z = towards * error[2] - derivative * rates.z
        self._send()

    def _send(self) -> None:
        self._torque.publish(self._command)
        self._sent_at = time.monotonic()

    def _resend(self) -> None:
        if time.monotonic() - self._sent_at > _PATIENCE:
            self._send()

    def _report(self, elapsed: float, error: Sequence[float], rates: Vector3) -> None:
        angle = 2.0 * math.asin(min(1.0, math.hypot(*error[:3])))
        if max(angle, math.hypot(rates.x, rates.y, rates.z)) < _SETTLED:
            self._settled = True
            speed = elapsed / (time.monotonic() - self._began)
            self.get_logger().info(f'settled within {_SETTLED} rad after {elapsed:.3f} s, '
                                   f'at {speed:.3g} times real time')


def _relative(target: Sequence[float], attitude: Quaternion) -> tuple[float, ...]:
    """Return the rotation from the target to an attitude, as a quaternion x y z w in body axes."""
    a, b, c, d = target
    x, y, z, w = attitude.x, attitude.y, attitude.z, attitude.w
    return (d * x - a * w - b * z + c * y, d * y - b * w - c * x + a * z,
            d * z - c * w - a * y + b * x, d * w + a * x + b * y + c * z)


def main(arguments: Sequence[str] | None = None) -> None:
    """
    Run the controller until the maneuver ends, or until it receives SIGINT or SIGTERM.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    run(AttitudeController, 'attitude_controller', arguments,
        'Parameters (--ros-args -p NAME:=VALUE): target.x to target.w, proportional_gain '
        '(N m/rad), derivative_gain (N m s/rad), stop_after (s from the first state)',
        lambda controller: controller.done)
