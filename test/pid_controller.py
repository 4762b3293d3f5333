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
A PID controller as users write it: it sends one torque for every state that it receives.

It knows nothing about lockstep. If it receives a state twice, its integral stays wrong.

    python pid_controller.py MEMORY --until NS [--first-step SECONDS] [--hang-at NS]

MEMORY is a file with the memory of the controller, from which a restarted one continues.
"""

import argparse
import json
from pathlib import Path
import time

#: Gains, N m/rad, N m s/rad and N m/(rad s), and step, s.
PROPORTIONAL, DERIVATIVE, INTEGRAL, STEP = 0.1, 0.12, 0.05, 0.01


class Pid:
    """Turns the body axes to the space axes."""

    def __init__(self):
        self.integral = [0.0, 0.0, 0.0]

    def torque(self, attitude, rates):
        """Return the torque, N m, for an attitude, x y z w, and rates, rad/s."""
        self.integral = [sum_ + angle * STEP for sum_, angle in zip(self.integral, attitude)]
        return [-PROPORTIONAL * angle - DERIVATIVE * rate - INTEGRAL * sum_
                for angle, rate, sum_ in zip(attitude, rates, self.integral)]


def main():
    """Control the body until a stamp."""
    # Imported here, so that a test can import the controller without ROS.
    from geometry_msgs.msg import WrenchStamped
    from nav_msgs.msg import Odometry
    import rclpy
    from rclpy.time import Time

    parser = argparse.ArgumentParser()
    parser.add_argument('memory', type=Path)
    parser.add_argument('--until', type=int, required=True)
    parser.add_argument('--first-step', type=float, default=0.0)
    parser.add_argument('--hang-at', type=int)
    options = parser.parse_args()
    law, stamps = Pid(), []
    if options.memory.exists():
        law.integral, stamps = json.loads(options.memory.read_text())
    rclpy.init(args=[])
    node = rclpy.create_node('pid_controller')
    publisher = node.create_publisher(WrenchStamped, 'torque', 10)

    def on_state(state):
        stamp_ns = Time.from_msg(state.header.stamp).nanoseconds
        if stamp_ns >= options.until:
            raise SystemExit
        if stamp_ns == options.hang_at:
            time.sleep(1e6)
        if not stamps:
            time.sleep(options.first_step)
        pose, twist = state.pose.pose.orientation, state.twist.twist.angular
        command = WrenchStamped()
        command.header.stamp = state.header.stamp
        torque = command.wrench.torque
        torque.x, torque.y, torque.z = law.torque([pose.x, pose.y, pose.z],
                                                  [twist.x, twist.y, twist.z])
        stamps.append(stamp_ns)
        part = options.memory.with_suffix('.part')
        part.write_text(json.dumps([law.integral, stamps]))
        part.replace(options.memory)
        publisher.publish(command)

    node.create_subscription(Odometry, 'odometry', on_state, 10)
    rclpy.spin(node)


if __name__ == '__main__':
    main()
