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

"""The node alone: torques from a topic in, attitude out."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

TUMBLER = PathJoinSubstitution([FindPackageShare('rigid_body_ros'), 'config', 'tumbler.yaml'])


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument('scene', default_value=TUMBLER,
                              description='parameter file with inertia, initial state and frames'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='namespace of the node and its topics'),
        DeclareLaunchArgument('use_sim_time', default_value='false', choices=['false', 'true'],
                              description='whether to follow /clock'),
        DeclareLaunchArgument('torque', default_value='torque',
                              description='topic of the torques (geometry_msgs/WrenchStamped)'),
        Node(package='rigid_body_ros', executable='attitude_node',
             namespace=LaunchConfiguration('namespace'),
             parameters=[LaunchConfiguration('scene'),
                         {'use_sim_time': LaunchConfiguration('use_sim_time')}],
             remappings=[('torque', LaunchConfiguration('torque'))],
             output='screen'),
    ])
