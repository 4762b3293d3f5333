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

"""The node, with rviz2 and the Foxglove bridge if they are installed."""

from ament_index_python.packages import get_packages_with_prefixes
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, LogInfo
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, SetParameter
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare('rigid_body_ros')
ATTITUDE_NODE = PathJoinSubstitution([SHARE, 'launch', 'attitude_node.launch.py'])
VIEW = PathJoinSubstitution([SHARE, 'config', 'rviz.rviz'])


def generate_launch_description():
    return LaunchDescription([
        DeclareLaunchArgument('space_frame', default_value='world',
                              description='fixed frame of rviz; use the space_frame of the scene'),
        _if_installed('tf2_msgs', SetParameter('publish_tf', True), 'no /tf'),
        IncludeLaunchDescription(PythonLaunchDescriptionSource(ATTITUDE_NODE)),
        _if_installed('rviz2', Node(
            package='rviz2', executable='rviz2', namespace=LaunchConfiguration('namespace'),
            arguments=['-d', VIEW, '-f', LaunchConfiguration('space_frame')]), 'no window'),
        _if_installed('foxglove_bridge', Node(
            package='foxglove_bridge', executable='foxglove_bridge', output='screen'),
            'nothing for Foxglove to connect to'),
    ])


def _if_installed(package, action, otherwise):
    """Return an action, or one that logs what its missing package would provide."""
    if package in get_packages_with_prefixes():
        return action
    return LogInfo(msg=f'{package} is not installed: {otherwise}')
