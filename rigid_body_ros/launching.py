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
Launch arguments of the node, and the action that starts it.

Each launch file declares the arguments in a scoped group. You can therefore include a launch file
several times in another one, and the values of its arguments do not leak into the file that
includes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteLocal,
    GroupAction,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch_ros.actions import Node

NAME = 'rigid_body_ros'
#: Remappings that move /tf into the namespace of each robot, as is usual with several robots.
RELATIVE_TF = (('/tf', 'tf'), ('/tf_static', 'tf_static'))
_FLAG = ('false', 'true')
#: The default of all arguments that override a value in the scene. If such an argument is empty,
#: the value from the scene applies.
_AS_IN_SCENE = ''
#: The arguments that set string parameters of the node, and those that set Boolean parameters.
_TEXTS, _FLAGS = ('frame_prefix', 'mode', 'checkpoint'), ('use_sim_time', 'autostart')


def scoped(*entities: Any, **defaults: str) -> GroupAction:
    """
    Return a scoped group that declares the launch arguments of the node.

    Parameters
    ----------
    *entities : DeclareLaunchArgument, action or callable
        The contents of the group, which can use the arguments of the node. A callable is called
        with the launch context and returns a list of actions.
    **defaults : str
        The new default of each argument whose default you want to change.

    """
    return GroupAction([*_arguments(defaults), *(
        OpaqueFunction(function=entity) if callable(entity) else entity for entity in entities)])


def attitude_node(context: LaunchContext, more: Mapping[str, Any] | None = None) -> Node:
    """
    Return the action that starts the node with the values of the launch arguments.

    Parameters
    ----------
    context : LaunchContext
        The launch context, which contains the values of the arguments.
    more : mapping, optional
        Node parameters that take precedence over the scene.

    Raises
    ------
    RuntimeError
        The scene is neither a file nor the name of an example, a remapping is malformed, the
        publish rate is not a number, or `autostart` is given for a node without a life cycle.

    """
    is_managed = context.launch_configurations['lifecycle'] == 'true'
    return _node(context, 'attitude_lifecycle_node' if is_managed else 'attitude_node', more or {})


def attitude_monitor(context: LaunchContext) -> Node:
    """Return the action that starts the node `attitude_monitor`; see `attitude_node`."""
    if context.launch_configurations['lifecycle'] == 'true':
        raise RuntimeError('lifecycle: expected false, because attitude_monitor has no life '
                           "cycle, found 'true'")
    return _node(context, 'attitude_monitor', {})


def _node(context: LaunchContext, executable: str, more: Mapping[str, Any]) -> Node:
    given = context.launch_configurations
    parameters = {**more, **_parameters(given)}
    return Node(
        package=NAME, executable=executable, name=given['name'], namespace=given['namespace'],
        parameters=[str(scene(given['scene'])), *([parameters] if parameters else [])],
        remappings=[*remappings(given), *RELATIVE_TF],
        ros_arguments=['--log-level', given['log_level']],
        respawn=given['respawn'] == 'true', respawn_delay=1.0, output='screen')


def scene(name: str) -> Path:
    """Return the path of a scene file. `name` is either the path or the name of an example."""
    examples = Path(get_package_share_directory(NAME), 'config')
    example, file = examples / f'{name}.yaml', Path(name).expanduser()
    if Path(name).name == name and example.is_file():
        return example
    if not file.is_file():
        names = ', '.join(sorted(path.stem for path in examples.glob('*.yaml')))
        raise RuntimeError(f'scene: expected a parameter file or the name of an example ({names}),'
                           f' found {name!r}')
    return file


def remappings(given: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the remapping of the torque topic, followed by the remappings from the user."""
    rules = [rule.partition(':=') for rule in given['remappings'].split()]
    for name, sign, target in rules:
        if not (name and sign and target):
            raise RuntimeError(f"remappings: expected 'from:=to' with spaces between several, "
                               f'found {name + sign + target!r}')
    return [('torque', given['torque']), *((name, target) for name, _, target in rules)]


def _parameters(given: Mapping[str, str]) -> dict[str, Any]:
    """Return the node parameters that are set by launch arguments."""
    if given['autostart'] and given['lifecycle'] == 'false':
        raise RuntimeError('autostart: expected no value without lifecycle:=true, because a plain '
                           f'node always starts by itself, found {given["autostart"]!r}')
    texts = {name: given[name] for name in _TEXTS if given[name]}
    flags = {name: given[name] == 'true' for name in _FLAGS if given[name]}
    rate = {'publish_rate': _rate(given['publish_rate'])} if given['publish_rate'] else {}
    return {**texts, **flags, **rate}


def _rate(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise RuntimeError(f'publish_rate: expected a number, Hz, found {text!r}') from None


def end(*processes: ExecuteLocal) -> list[EmitEvent]:
    """Return actions that stop processes as Ctrl-C would, ignoring processes that have ended."""
    return [EmitEvent(event=ShutdownProcess(process_matcher=matches_action(process)))
            for process in processes]


def ending(ended: ExecuteLocal, *others: ExecuteLocal) -> RegisterEventHandler:
    """Return an event handler that stops all other processes once the process `ended` exits."""
    return RegisterEventHandler(OnProcessExit(target_action=ended, on_exit=end(*others)))


def _arguments(defaults: Mapping[str, str]) -> list[DeclareLaunchArgument]:
    def argument(name: str, default: str | None, description: str,
                 choices: tuple[str, ...] | None = None) -> DeclareLaunchArgument:
        return DeclareLaunchArgument(name, default_value=defaults.get(name, default),
                                     description=description, choices=choices)
    return [
        argument('scene', None, 'parameter file with inertia, initial state and frames, or the '
                 'name of an example, such as tumbler'),
        argument('namespace', '', 'namespace of the node and its topics'),
        argument('name', 'attitude_node', 'name of the node'),
        argument('torque', 'torque', 'topic of the torques (geometry_msgs/WrenchStamped)'),
        argument('remappings', '', 'further remappings, such as "odometry:=odom imu/data:=imu"'),
        argument('frame_prefix', _AS_IN_SCENE, 'prefix of the frame_ids of the body and of the '
                 'links of robot_description (default: as in the scene)'),
        argument('use_sim_time', _AS_IN_SCENE, 'whether the time of the node follows /clock '
                 '(default: as in the scene or in the launch file that includes this one)',
                 (_AS_IN_SCENE, *_FLAG)),
        argument('mode', _AS_IN_SCENE, 'realtime, to publish the motion in real time, '
                 'lockstep, to reply to each torque, or clock, to publish /clock as well '
                 '(default: as in the scene)',
                 (_AS_IN_SCENE, 'realtime', 'lockstep', 'clock')),
        argument('publish_rate', _AS_IN_SCENE, 'rate at which the node publishes the motion, '
                 'Hz (default: as in the scene)'),
        argument('checkpoint', _AS_IN_SCENE, 'parameter checkpoint of the node: a file that no '
                 'other node uses (default: as in the scene)'),
        argument('lifecycle', 'false', 'whether to start attitude_lifecycle_node, whose lifecycle '
                 'a manager controls', _FLAG),
        argument('autostart', _AS_IN_SCENE, 'with lifecycle:=true, whether the node configures '
                 'and activates itself, without a manager (default: as in the scene; false if the '
                 'scene does not set it)',
                 (_AS_IN_SCENE, *_FLAG)),
        argument('log_level', 'info', 'lowest severity of the messages that the node logs',
                 ('debug', 'info', 'warn', 'error', 'fatal')),
        argument('respawn', 'false', 'whether launch starts the node again 1 s after it ends',
                 _FLAG),
    ]
