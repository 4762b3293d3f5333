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
Start the node, and play the torques of a bag to it, with a clock.

Playback starts when the node responds, so the node does not miss the first torques. The node ends
when the bag ends.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, RegisterEventHandler
from launch.event_handlers import OnProcessExit, OnProcessStart
from launch_ros.substitutions import FindPackagePrefix
from rigid_body_ros import launching


def generate_launch_description():
    return LaunchDescription([launching.scoped(
        DeclareLaunchArgument('bag', description='folder or file for `ros2 bag play`'),
        DeclareLaunchArgument('rate', default_value='1.0',
                              description='speed of the playback, relative to real time'),
        LogInfo(msg=['ros2 bag is in ', FindPackagePrefix('ros2bag')]),  # fails if not installed
        _replay,
        torque='/torque', use_sim_time='true')])


def _replay(context):
    given = context.launch_configurations
    node = launching.attitude_node(context)
    bag = ExecuteProcess(
        cmd=['ros2', 'bag', 'play', given['bag'], '--topics', given['torque'],
             '--rate', given['rate'], '--clock', '100', '--start-paused',
             '--disable-keyboard-controls'],
        output='screen')
    resume = _call('resume', '/rosbag2_player/resume', 'rosbag2_interfaces/srv/Resume')

    def wait(event, context):
        # node_name includes the namespaces of the launch files that include this one.
        ready = _call('ready', f'{node.node_name}/get_parameters',
                      'rcl_interfaces/srv/GetParameters')
        return [_then(ready, resume, bag, node), launching.ending(node, bag, ready), ready]
    return [
        RegisterEventHandler(OnProcessStart(target_action=node, on_start=wait, handle_once=True)),
        _then(resume, None, bag, node), launching.ending(bag, node), node, bag]


def _call(name, service, kind):
    return ExecuteProcess(cmd=['ros2', 'service', 'call', service, kind], name=name)


def _then(process, following, *others):
    """Return a handler: if a process succeeds, start an action, otherwise end other processes."""
    def start(event, context):
        return following if event.returncode == 0 else launching.end(*others)
    return RegisterEventHandler(OnProcessExit(target_action=process, on_exit=start))
