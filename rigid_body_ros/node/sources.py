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

"""The topics that a node reads, with their logs and status names."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import Any, NamedTuple

from rclpy.node import Node
from rigid_body_ros import messages
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.propagation.sources import BODY as BODY
from rigid_body_ros.propagation.sources import COMMANDS as COMMANDS
from rigid_body_ros.propagation.sources import WHEELS as WHEELS
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parameters import LOCKSTEP

#: The types that torques may have. In lockstep, a torque must have the stamp of the state to which
#: it responds.
_LOCKSTEP_TORQUES = messages.WRENCH, messages.TORQUE_VECTOR
_TORQUES = (messages.WRENCH, messages.BARE_WRENCH, messages.TORQUE_VECTOR,
            messages.PX4_TYPES['VehicleTorqueSetpoint'])


class TorqueTopic(NamedTuple):
    """A topic that carries torques, wheel commands, the inertia, or measurements."""

    #: The number of the source: a source number as in `Propagator.apply`, or COMMANDS, WHEELS or
    #: BODY.
    number: int
    topic: str
    #: The topic on which accepted messages from the source are logged, or '' for measurements.
    log: str
    #: The name of the source in diagnostics, followed by a word for the contents of a message.
    status: str
    what: str
    #: The types that publishers may have. Torques are converted to the first one.
    kinds: tuple[messages.MessageType, ...]

    @property
    def logged(self) -> messages.MessageType:
        """Return the type in which accepted torques are logged."""
        return self.kinds[0]


def sources_of(scene: Scene) -> tuple[TorqueTopic, ...]:
    """
    Return the torque and inertia sources of a scene.

    Torques are summed in the order of the sources.
    """
    suffixes = ['', *(f'_{number}' for number in range(1, len(scene.torque_topics)))]
    kinds = _LOCKSTEP_TORQUES if scene.mode == LOCKSTEP else _TORQUES
    sources = [TorqueTopic(number, topic, f'~/accepted_torque{suffix}', f'torques{suffix}',
                           'torque', kinds)
               for number, (topic, suffix) in enumerate(zip(scene.torque_topics, suffixes))]
    if scene.wheels:  # the torque that motors exert on the rotors
        sources.append(TorqueTopic(WHEELS, 'wheel_torque', '~/accepted_wheel_torque',
                                   'wheel torques', 'torque', kinds))
    if scene.inertia_topic:
        sources.append(TorqueTopic(BODY, 'inertia', '~/accepted_inertia', 'inertia', 'inertia',
                                   (messages.INERTIA,)))
    if scene.named_wheels:
        commands = messages.joint_commands([wheel.name for wheel in scene.named_wheels])
        sources.append(TorqueTopic(COMMANDS, 'wheel_command', '~/accepted_wheel_command',
                                   'wheel commands', 'command', (commands,)))
    return tuple(sources)


def class_of(kind: messages.MessageType) -> type[Any]:
    """Return the ROS class of a message type; raise ModuleNotFoundError without its package."""
    package, _, name = kind.name.split('/')
    return vars(import_module(f'{package}.msg'))[name]


def check_topics(node: Node, sources: Iterable[TorqueTopic], others: Iterable[str]) -> None:
    """
    Check that the node does not use the topic of a source for anything else.

    `others` contains the full names of the other topics that the node uses.

    Raises
    ------
    InputError
        Two topics have the same name after remapping.
    RuntimeError
        A topic name is not valid.

    """
    used = set(others)
    for source in sources:
        name = node.resolve_topic_name(source.topic)
        if name in used:
            raise InputError('torque_topics: expected topics that the node does not use for '
                             f'anything else, found {name} twice')
        used.add(name)
