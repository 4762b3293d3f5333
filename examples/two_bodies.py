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
Two bodies in one process, each a node with its own namespace and parameters.

    python examples/two_bodies.py

On Ctrl-C, the nodes publish their pending states, and the process ends.
"""

import signal
import sys

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rigid_body_ros.node import AttitudeNode

#: kg m^2
MOMENTS = {'cube': (0.01, 0.01, 0.01), 'rod': (0.002, 0.03, 0.03)}


def main():
    """Spin both nodes until a signal."""
    # The handlers of rclpy would shut ROS down before the last states are published.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    stop = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stop.append(number))
    executor = SingleThreadedExecutor()
    nodes = [AttitudeNode(namespace=name, parameter_overrides=[
        Parameter(f'inertia.{axis}', value=moment)
        for axis, moment in zip(('ixx', 'iyy', 'izz'), moments)])
        for name, moments in MOMENTS.items()]
    for node in nodes:
        executor.add_node(node)
    while not stop:
        executor.spin_once(timeout_sec=0.1)
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
