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
Start several bodies, each with a node in a separate namespace: body_1, body_2 and so on.

This is an example of a launch file that includes another launch file several times. Here all
bodies have the same scene; for different bodies, pass a different scene to each node.
"""

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

ATTITUDE_NODE = PathJoinSubstitution(
    [FindPackageShare('rigid_body_ros'), 'launch', 'attitude_node.launch.py'])
#: On one machine, DDS has ports for about this many processes in a domain.
MOST = 100


def generate_launch_description():
    return LaunchDescription([GroupAction([
        DeclareLaunchArgument('scene', description='parameter file, or the name of an example, '
                              'such as tumbler'),
        DeclareLaunchArgument('bodies', default_value='8', description='number of bodies'),
        OpaqueFunction(function=_fleet)])])


def _fleet(context):
    given = context.launch_configurations
    count, checkpoint = given['bodies'], given.get('checkpoint', '')
    if count not in map(str, range(1, MOST + 1)):
        raise RuntimeError(f'bodies: expected a whole number from 1 to {MOST}, found {count!r}')
    if checkpoint:
        raise RuntimeError('checkpoint: expected no value, because each body needs a file of its '
                           f'own, found {checkpoint!r}')
    return [_body(f'body_{number}') for number in range(1, int(count) + 1)]


def _body(namespace):
    # Without the group, the arguments of an included launch file would remain set.
    return GroupAction([IncludeLaunchDescription(
        PythonLaunchDescriptionSource(ATTITUDE_NODE),
        launch_arguments={'scene': LaunchConfiguration('scene'),
                          'namespace': namespace,
                          'frame_prefix': f'{namespace}/'}.items())])
