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
Start the node in lockstep with the example controller; the loop runs as fast as possible.

Every run gives the same result. The node ends when the controller ends. The launch file ignores
`mode` and `step` of the scene.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch_ros.actions import Node
from rigid_body_ros import launching


def generate_launch_description():
    return LaunchDescription([launching.scoped(
        DeclareLaunchArgument('stop_after', default_value='60.0',
                              description='duration of the loop, measured by its stamps, s'),
        _closed_loop)])


def _closed_loop(context):
    given = context.launch_configurations
    if given['mode'] not in ('', 'lockstep'):
        raise RuntimeError("mode: expected 'lockstep' or no value, because the controller waits "
                           f"for the reply to each torque, found {given['mode']!r}")
    node = launching.attitude_node(context, {'mode': 'lockstep', 'step': 0.01})
    controller = Node(
        package=launching.NAME, executable='attitude_controller', namespace=given['namespace'],
        parameters=[{'stop_after': float(given['stop_after'])}],
        remappings=launching.remappings(given), output='screen')
    ends = [launching.ending(controller, node)]
    if given['respawn'] == 'false':
        ends.append(launching.ending(node, controller))
    return [*ends, node, controller]
