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

"""Decide what to read from a recording: the topics with torques and other inputs of a scene."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import re
from typing import Any

from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.messages import INERTIA, joint_commands, MessageType
from rigid_body_ros.recording import source
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.recording.measurements import MeasuredOptions, read_all
from rigid_body_ros.recording.source import TORQUES
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.scene import Scene

#: Default names of the topics for the rotor torque, the commands to named wheels, and the inertia.
_WHEEL_TORQUE, _WHEEL_COMMAND, _INERTIA = 'wheel_torque', 'wheel_command', 'inertia'
#: For each option that names a topic: the scene parameter that enables the topic, and the value
#: that this parameter must have.
_NEEDED = {'wheel_torque': ('wheels', 'true'), 'wheel_momentum': ('wheels', 'true'),
           'wheel_command': ('wheel_names', 'names'), 'inertia': ('inertia_topic', 'true')}
#: Matches the topics on which a node logs the torques that it accepts. A number at the end of the
#: name is the index of the torque topic whose torques are logged. A name without a number belongs
#: to the first torque topic.
_ACCEPTED = re.compile('.*/accepted_torque(?:_([0-9]+))?')


@dataclass(frozen=True)
class Topics:
    """
    The topics to read: torques, rotor data, inertia, and commands to named wheels.

    Attributes
    ----------
    torques : tuple of str
        The topics whose torques are added up. If the tuple is empty, they are the torque topics of
        the scene.
    wheel_torque, wheel_momentum : str, optional
        The rotor torque topic and the rotor momentum topic. At most one of the two is given.
    inertia : str, optional
        The inertia topic, if the inertia changes.
    wheel_command : str, optional
        The topic with the commands to named wheels.
    columns : mapping of str to str, optional
        The columns to read from CSV files; see `text_files.Table`.
    preferred : str
        If `preferred` is set and the recording has only one torque topic, the torques are read
        from that topic. If `preferred` is set and the recording has several torque topics, the
        torques are read from the topic called `preferred`.

    Raises
    ------
    InputError
        A topic is given twice, or the name of a topic is empty.

    """

    torques: tuple[str, ...] = ()
    wheel_torque: str | None = None
    wheel_momentum: str | None = None
    inertia: str | None = None
    preferred: str = ''
    wheel_command: str | None = None
    columns: Mapping[str, str] | None = None

    def __post_init__(self) -> None:
        if self.wheel_torque and self.wheel_momentum:
            raise InputError('expected one of --wheel-torque and --wheel-momentum, found both')
        for name in _NEEDED:
            if getattr(self, name) == '':
                raise InputError(f'{_option(name)}: expected a topic, found an empty name')
        names = [*self.torques, *filter(None, [self.wheel_torque])]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f'expected each topic once, found {name!r} twice')

    @classmethod
    def given(cls, topic: str | Sequence[str] | None = None, **others: Any) -> Topics:
        """Return the topics that the caller has named: torque topics, and other attributes."""
        return cls((topic,) if isinstance(topic, str) else tuple(topic or ()), **others)

    @property
    def wheel_source(self) -> str:
        """Return a phrase that says where the rotor torque comes from, for use in a summary."""
        if self.wheel_momentum:
            return f'momentum on {self.wheel_momentum}, linear between samples'
        if self.wheel_command:
            return f'efforts on {self.wheel_command}'
        return f'torque on {self.wheel_torque}' if self.wheel_torque else 'constant momentum'

    def found_in(self, path: str | Path, scene: Scene) -> Topics:
        """
        Return the topics to read from a recording, by default the torque topics of the scene.

        Raises
        ------
        InputError
            The recording cannot be read, or lacks a topic of the scene; or the scene does not
            enable a given rotor, wheel or inertia topic.

        """
        self.check(scene)
        names, wheel_torque, inertia = self.torques, self.wheel_torque, self.inertia
        if scene.inertia_topic:
            inertia = inertia or self._topic_called(_INERTIA, source.topics(path, [INERTIA]))
        command = self.command_in(path, scene)
        if len(names or scene.torque_topics) == 1 and not (scene.wheels or command):
            preferred = '' if names else absolute(scene.torque_topics[0])
            return replace(self, inertia=inertia, preferred=preferred)
        recorded = source.topics(path, TORQUES)
        if scene.wheels and not self.wheel_momentum:
            wheel_torque = wheel_torque or self._topic_called(_WHEEL_TORQUE, recorded)
        if not names:
            others = [topic for topic in recorded if topic != wheel_torque]
            optional = bool(wheel_torque or self.wheel_momentum or command)
            names = _torques_of(path, scene.torque_topics, others, optional)
        return replace(self, torques=names, wheel_torque=wheel_torque, inertia=inertia,
                       wheel_command=command)

    def command_in(self, path: str | Path, scene: Scene) -> str | None:
        """Return the topic with the commands to named wheels, or None if there is none."""
        if self.wheel_command or not scene.named_wheels:
            return self.wheel_command
        return self._topic_called(_WHEEL_COMMAND, source.topics(path, [joint_commands(())]))

    def _topic_called(self, name: str, recorded: Collection[str]) -> str | None:
        """Return the topic called `name` or a node's log of that topic; None if neither exists."""
        logs = [topic for topic in recorded if topic.endswith(f'/accepted_{name}')]
        nodes = {topic.rpartition('/')[0] for topic in self.torques if _ACCEPTED.fullmatch(topic)}
        if nodes:
            logs = [topic for topic in logs if topic.rpartition('/')[0] in nodes]
        elif topic := _match(name, recorded):
            return topic
        if len(logs) > 1:
            raise InputError(f'expected the {name} of one node, found {listed(logs)}; choose one '
                             f'with {_option(name)}')
        # Read this log too, because the motion depends on everything that the node received. If
        # the torques were recorded by another node, `aligned` rejects the log.
        return logs[0] if logs else None

    def check(self, scene: Scene) -> None:
        """Raise InputError if the scene does not enable a given rotor, wheel or inertia topic."""
        for name, (parameter, expected) in _NEEDED.items():
            if getattr(self, name) and not (value := scene.values[parameter]):
                raise InputError(f'{_option(name)}: expected a scene with {parameter}: {expected}'
                                 f', found {parameter}: {str(value).lower()}')

    def actuators(self, scene: Scene) -> tuple[Actuator | None, ...] | None:
        """
        Return the actuator for each torque topic, or None if the scene has no actuators.

        A scene assigns its actuators to topic names. A node's log of a topic gets the actuator of
        that topic. If the recording and the scene have only one topic each, the names of the two
        topics need not agree.
        """
        names = [absolute(name) for name in scene.torque_topics]
        if scene.actuators is None or self.preferred or len(self.torques) == len(names) == 1:
            return scene.actuators
        return tuple([_actuator_of(topic, names, scene.actuators) for topic in self.torques])

    @property
    def wrenches(self) -> list[str | None]:
        """
        Return the torque topics, with the rotor torque topic last.

        None stands for the torque topic that `preferred` selects.
        """
        return [*([None] if self.preferred else self.torques),
                *filter(None, [self.wheel_torque])]

    def kinds(self, name: str | None) -> Sequence[MessageType]:
        """Return the types of messages that one of `wrenches` may have."""
        return TORQUES if name == self.wheel_torque else source.torques(name)


@dataclass(frozen=True)
class Reading:
    """
    What to read from a recording, and how.

    Attributes
    ----------
    measured : tuple of str
        The measured topics. The tuple can be empty if the recording has only one measured topic,
        because `read_measured` finds this topic.
    topics : Topics
        The torque topics and those of other inputs.
    interpolation : str, optional
        How to interpolate the torques between samples. By default, the scene decides.
    time_source : str
        Where the stamps of torques and measurements come from, as for `recording.read`.
    start : float, s
        If positive, the motion starts this long after the first sample, as for `read_observed`.
    until : float, optional, s
        The length of the motion. By default, the motion ends at the last sample.
    frames : tuple of str, optional
        The parent frame and the child frame to read, as for `read_measured`.
    track : callable
        A function that wraps the iteration over blocks of messages, to show progress.

    """

    measured: tuple[str, ...] = ()
    topics: Topics = Topics()
    interpolation: str | None = None
    time_source: str = 'header'
    frames: tuple[str, str] | None = None
    start: float = 0.0
    until: float | None = None
    track: Track = no_progress

    def sensors(self, path: str | Path, scene: Scene | None) -> list[Measured]:
        """
        Read the measurements, raising the same errors as `read_all`.

        Without a scene, the frames of the messages are not compared with any others.
        """
        options = MeasuredOptions(self.frames, time_source=self.time_source,
                                  columns=self.topics.columns, track=self.track)
        if scene is None:
            return [replace(sensor, frames='')
                    for sensor in read_all(path, self.measured, options)]
        return read_all(path, self.measured, options._replace(
            body_frame=scene.body_frame, space_frame=scene.space_frame, links=scene.links))


def _option(name: str) -> str:
    """Return the option of the commands that sets an attribute of `Topics`."""
    return f'--{name.replace("_", "-")}'


def absolute(topic: str) -> str:
    """Return the full name of a topic, as resolved by a node without a namespace."""
    return topic if topic.startswith('/') else f'/{topic}'


def _actuator_of(topic: str, names: Sequence[str],
                 actuators: Sequence[Actuator | None]) -> Actuator | None:
    logged = _ACCEPTED.fullmatch(topic)
    number = int(logged[1] or 0) if logged else \
        names.index(absolute(topic)) if absolute(topic) in names else len(names)
    return actuators[number] if number < len(names) else None


def _match(name: str, recorded: Collection[str]) -> str | None:
    return next((topic for topic in recorded if topic in (name, absolute(name))), None)


def _torques_of(path: str | Path, names: Sequence[str], recorded: list[str],
                optional: bool) -> tuple[str, ...]:
    """Find the scene's torque topics in a recording; a single topic may have any name."""
    topics = [_match(name, recorded) for name in names]
    missing = [name for name, topic in zip(names, topics) if topic is None]
    for topic in topics:
        if topic and topics.count(topic) > 1:
            raise InputError(f'{path}: torque_topics: expected each topic once, found {topic!r} '
                             'twice')
    if not missing:
        return tuple(filter(None, topics))
    if len(names) == len(recorded) == 1:
        return recorded[0],
    if optional and not recorded:
        return ()
    raise InputError(f'{path}: expected the torque_topics of the scene, found no topic '
                     f'{listed(missing)} among {listed(recorded)}; choose topics with --topic')
