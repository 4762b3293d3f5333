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
The node in lockstep with a controller: a maneuver as fast as both can run, with equal results.

Everything ends with the controller. `mode` and `step` of the scene take precedence.
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, SetParameter
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ATTITUDE_NODE = PathJoinSubstitution(
    [FindPackageShare('rigid_body_ros'), 'launch', 'attitude_node.launch.py'])


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument('stop_after', default_value='60.0',
                              description='duration of the maneuver in its own time, s'),
        RegisterEventHandler(OnProcessExit(on_exit=[Shutdown()], handle_once=True)),
        SetParameter('mode', 'lockstep'),
        SetParameter('step', 0.01),
        IncludeLaunchDescription(PythonLaunchDescriptionSource(ATTITUDE_NODE)),
        Node(package='rigid_body_ros', executable='attitude_controller.py',
             namespace=LaunchConfiguration('namespace'),
             parameters=[{'stop_after': ParameterValue(LaunchConfiguration('stop_after'),
                                                       value_type=float)}],
             remappings=[('torque', LaunchConfiguration('torque'))],
             output='screen'),
    ])
