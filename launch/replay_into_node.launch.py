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
The torques of a bag into the node, with the clock of the bag.

The bag starts when the node responds, so that no torque is lost. Everything ends with the bag.
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    LogInfo,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackagePrefix, FindPackageShare

ATTITUDE_NODE = PathJoinSubstitution(
    [FindPackageShare('rigid_body_ros'), 'launch', 'attitude_node.launch.py'])
ANY_SERVICE = PathJoinSubstitution(
    ['/', LaunchConfiguration('namespace'), 'attitude_node', 'get_parameters'])


def generate_launch_description():
    bag = ExecuteProcess(
        cmd=['ros2', 'bag', 'play', LaunchConfiguration('bag'),
             '--topics', LaunchConfiguration('torque'), '--rate', LaunchConfiguration('rate'),
             '--clock', '100', '--start-paused', '--disable-keyboard-controls'],
        output='screen')
    ready = ExecuteProcess(
        cmd=['ros2', 'service', 'call', ANY_SERVICE, 'rcl_interfaces/srv/GetParameters'],
        name='ready')
    resume = ExecuteProcess(
        cmd=['ros2', 'service', 'call', '/rosbag2_player/resume', 'rosbag2_interfaces/srv/Resume'],
        name='resume')

    def resume_once_ready(event, context):
        if event.action is ready and event.returncode == 0:
            return resume
        return None if event.action is resume and event.returncode == 0 else Shutdown()

    return LaunchDescription([
        DeclareLaunchArgument('bag', description='folder or file for `ros2 bag play`'),
        DeclareLaunchArgument('torque', default_value='/torque',
                              description='topic of the torques in the bag'),
        DeclareLaunchArgument('rate', default_value='1.0',
                              description='speed relative to real time'),
        DeclareLaunchArgument('use_sim_time', default_value='true',
                              description='true, because the bag publishes /clock'),
        LogInfo(msg=['ros2 bag is in ', FindPackagePrefix('ros2bag')]),  # fails without it
        RegisterEventHandler(OnProcessExit(on_exit=resume_once_ready)),
        IncludeLaunchDescription(PythonLaunchDescriptionSource(ATTITUDE_NODE)),
        bag,
        ready,
    ])
