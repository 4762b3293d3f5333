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

"""Start the node, with rviz2 and the Foxglove bridge if they are installed."""

from ament_index_python.packages import get_packages_with_prefixes
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare
from rigid_body_ros import launching

VIEW = PathJoinSubstitution([FindPackageShare(launching.NAME), 'config', 'rviz.rviz'])


def generate_launch_description():
    installed = get_packages_with_prefixes()
    publishes_tf = {'publish_tf': True} if 'tf2_msgs' in installed else {}
    return LaunchDescription([launching.scoped(
        DeclareLaunchArgument('space_frame', default_value='world',
                              description='fixed frame of rviz2: the space_frame of the scene'),
        lambda context: [launching.attitude_node(context, publishes_tf)],
        *(LogInfo(msg=f'{package} is not installed: {without}')
          for package, without in (('tf2_msgs', 'no /tf'), ('rviz2', 'no window'),
                                   ('foxglove_bridge', 'nothing for Foxglove to connect to'))
          if package not in installed),
        *(action for package, action in _viewers() if package in installed))])


def _viewers():
    yield 'rviz2', Node(
        package='rviz2', executable='rviz2', namespace=LaunchConfiguration('namespace'),
        arguments=['-d', VIEW, '-f', LaunchConfiguration('space_frame')],
        remappings=launching.RELATIVE_TF)
    yield 'foxglove_bridge', Node(
        package='foxglove_bridge', executable='foxglove_bridge', output='screen')
