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
The node for launch files: its arguments, and the action that starts it.

A launch file declares the arguments in a scoped group, so that it can be included several times
and leaves no value to the file that includes it.
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
#: As in a stack with several robots: every robot has its own /tf, in its namespace.
RELATIVE_TF = (('/tf', 'tf'), ('/tf_static', 'tf_static'))
_FLAG = ('false', 'true')
#: Default of an argument that is not given: the scene decides.
_AS_IN_SCENE = ''
#: Arguments that are parameters of the node with a text, and with a flag.
_TEXTS, _FLAGS = ('frame_prefix', 'mode', 'checkpoint'), ('use_sim_time', 'autostart')


def scoped(*entities: Any, **defaults: str) -> GroupAction:
    """
    Return entities that can use the arguments of the node, in a scope of their own.

    Parameters
    ----------
    *entities : DeclareLaunchArgument, action or callable
        Further arguments, actions, and functions that receive the context and return actions.
    **defaults : str
        Defaults of arguments of the node that are not the usual ones.

    """
    return GroupAction([*_arguments(defaults), *(
        OpaqueFunction(function=entity) if callable(entity) else entity for entity in entities)])


def attitude_node(context: LaunchContext, more: Mapping[str, Any] | None = None) -> Node:
    """
    Return the action that starts the node as the arguments say.

    Parameters
    ----------
    context : LaunchContext
        The context of the launch file, with the values of the arguments.
    more : mapping, optional
        Parameters of the node that take precedence over the scene.

    Raises
    ------
    RuntimeError
        The scene is neither a file nor the name of an example, a remapping is malformed, the rate
        is not a number, or `autostart` is given for a node without a life cycle.

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
    """Return the parameter file of a scene: a file, or an example of the package."""
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
    """Return the remappings of the topics: of the torques, and those of the user."""
    rules = [rule.partition(':=') for rule in given['remappings'].split()]
    for name, sign, target in rules:
        if not (name and sign and target):
            raise RuntimeError(f"remappings: expected 'from:=to' with spaces between several, "
                               f'found {name + sign + target!r}')
    return [('torque', given['torque']), *((name, target) for name, _, target in rules)]


def _parameters(given: Mapping[str, str]) -> dict[str, Any]:
    """Return the parameters of the node that the arguments set."""
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
    """Return actions that end processes, as Ctrl-C does; those that have ended are ignored."""
    return [EmitEvent(event=ShutdownProcess(process_matcher=matches_action(process)))
            for process in processes]


def ending(ended: ExecuteLocal, *others: ExecuteLocal) -> RegisterEventHandler:
    """Return a handler that ends other processes when one has ended."""
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
        argument('frame_prefix', _AS_IN_SCENE, 'text before the frame_ids of the body and of the '
                 'links of robot_description (default: as in the scene)'),
        argument('use_sim_time', _AS_IN_SCENE, 'whether to follow /clock (default: as the scene '
                 'or the including launch file says)', (_AS_IN_SCENE, *_FLAG)),
        argument('mode', _AS_IN_SCENE, 'whether to publish the motion in real time, or to reply '
                 'to each torque (default: as in the scene)',
                 (_AS_IN_SCENE, 'realtime', 'lockstep')),
        argument('publish_rate', _AS_IN_SCENE, 'rate at which the motion is published, Hz '
                 '(default: as in the scene)'),
        argument('checkpoint', _AS_IN_SCENE, 'parameter checkpoint of the node, a file of its own '
                 '(default: as in the scene)'),
        argument('lifecycle', 'false', 'whether to start attitude_lifecycle_node, whose life a '
                 'manager controls', _FLAG),
        argument('autostart', _AS_IN_SCENE, 'with lifecycle: whether the node configures and '
                 'activates itself, without a manager (default: as in the scene, otherwise false)',
                 (_AS_IN_SCENE, *_FLAG)),
        argument('log_level', 'info', 'the least severe messages to log',
                 ('debug', 'info', 'warn', 'error', 'fatal')),
        argument('respawn', 'false', 'whether to start the node again 1 s after it ended', _FLAG),
    ]
