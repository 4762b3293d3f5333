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

"""The torques of a scene with several torque topics, rotors or damping, in each epoch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages, recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.recording import Messages
from rigid_body_ros.replay.epochs import aligned
from rigid_body_ros.runtime.terminal import Track
from rigid_body_ros.scene import Scene

#: The topic of the torque on the rotors.
_WHEEL_TORQUE = 'wheel_torque'
#: Relative difference up to which two momenta of the rotors count as equal.
_SAME_MOMENTUM = 1e-6


@dataclass(frozen=True)
class Topics:
    """
    The topics of the torques.

    Attributes
    ----------
    torques : tuple of str
        Their torques add up. Empty: those of the scene.
    wheel_torque, wheel_momentum : str, optional
        Topic of the torque on the rotors, or of their momentum.

    Raises
    ------
    InputError
        A topic is given twice, or a name is empty.

    """

    torques: tuple[str, ...] = ()
    wheel_torque: str | None = None
    wheel_momentum: str | None = None

    def __post_init__(self) -> None:
        if self.wheel_torque and self.wheel_momentum:
            raise InputError('expected one of --wheel-torque and --wheel-momentum, found both')
        if '' in (self.wheel_torque, self.wheel_momentum):
            option = '--wheel-torque' if self.wheel_torque == '' else '--wheel-momentum'
            raise InputError(f'{option}: expected a topic, found an empty name')
        names = [*self.torques, *filter(None, [self.wheel_torque])]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f'expected each topic once, found {name!r} twice')

    @property
    def wheel_source(self) -> str:
        """Return where the torque on the rotors comes from, for a summary."""
        if self.wheel_momentum:
            return f'momentum on {self.wheel_momentum}, linear between samples'
        return f'torque on {self.wheel_torque}' if self.wheel_torque else 'constant momentum'

    def is_plain(self, scene: Scene) -> bool:
        """
        Return whether the motion has one torque, and neither rotors nor damping.

        Raises
        ------
        InputError
            The rotors have a topic, but the scene has no rotors with motors.

        """
        for option, topic in (('--wheel-torque', self.wheel_torque),
                              ('--wheel-momentum', self.wheel_momentum)):
            if topic and not scene.wheels:
                raise InputError(f'{option}: expected a scene with wheels: true, found '
                                 'wheels: false')
        return len(self.torques or scene.torque_topics) == 1 and not (
            scene.has_rotors or scene.body.is_damped)

    def found_in(self, path: str | Path, scene: Scene) -> Topics:
        """
        Return the topics with those of the scene where none are given.

        Raises
        ------
        InputError
            The recording cannot be read, or lacks a topic of the scene.

        """
        recorded = recording.topics(path, recording.TORQUES)
        wheel_torque = self.wheel_torque
        if scene.wheels and not self.wheel_momentum:
            wheel_torque = wheel_torque or _match(_WHEEL_TORQUE, recorded)
        torques = self.torques
        if not torques:
            others = [topic for topic in recorded if topic != wheel_torque]
            optional = bool(wheel_torque or self.wheel_momentum)
            torques = _torques_of(path, scene.torque_topics, others, optional)
        return Topics(torques, wheel_torque, self.wheel_momentum)


class Sources(NamedTuple):
    """The torques of a motion, or of an epoch of a node, as recorded, and its initial state."""

    #: Their torques add up.
    logs: tuple[TorqueLog, ...]
    #: Torque on the rotors.
    wheels: TorqueLog | None
    #: Whether that comes from the momentum of the rotors, so it is never interpolated.
    is_measured: bool
    start: State
    messages: int
    #: Number of messages whose stamp is not later than the stamp of the previous message.
    unordered: int
    #: Whether the start is that of an epoch, and not that of the scene.
    is_epoch: bool
    damage: str

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """Return the stamps of all samples in ascending order; that of the start if none."""
        stamps = _stamps(self.logs, self.wheels)
        return stamps if stamps.size else np.array([self.start.time_ns])

    def interpolated(self, interpolation: str) -> Sources:
        """Return the same torques with another interpolation between the samples."""
        def changed(log: TorqueLog) -> TorqueLog:
            return TorqueLog(log.times_ns, log.torques, log.in_space, interpolation)
        wheels = self.wheels
        if wheels and not self.is_measured:
            wheels = changed(wheels)
        return self._replace(logs=tuple(changed(log) for log in self.logs), wheels=wheels)


def topics_of(topic: str | Sequence[str] | None, wheel_torque: str | None = None,
              wheel_momentum: str | None = None) -> Topics:
    """Return the given topics; raise InputError if a topic is given twice."""
    names = (topic,) if isinstance(topic, str) else tuple(topic or ())
    return Topics(names, wheel_torque, wheel_momentum)


def absolute(topic: str) -> str:
    """Return the name of a topic in a recording, for a node without a namespace."""
    return topic if topic.startswith('/') else f'/{topic}'


def read_sources(path: str | Path, scene: Scene, topics: Topics, interpolation: str,
                 track: Track, time_source: str = 'header', skip: float = 0.0) -> list[Sources]:
    """
    Read the torques of a motion, or of each epoch of a node, and the initial state.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : Scene
        The names of the frames, and the initial state.
    topics : Topics
        As `Topics.found_in` returns them.
    interpolation : str
        Interpolation between samples.
    track : callable
        Wraps the iteration over blocks of messages, to show progress.
    time_source, skip
        As for `recording.read`; `skip` only for one topic.

    Returns
    -------
    list of Sources
        In the order of the recording.

    Raises
    ------
    InputError
        The recording cannot be read, does not fit the scene, or the topics have other epochs.

    """
    names = [*topics.torques, *filter(None, [topics.wheel_torque])]
    torques = [recording.read(path, topic, None, track, time_source, skip) for topic in names]
    momentum = recording.read(path, topics.wheel_momentum, messages.VECTOR3, track, time_source) \
        if topics.wheel_momentum else None
    found = aligned(path, [recording.epochs(path, one) for one in torques],
                    time_source == 'header')
    if momentum is not None and len(found) > 1:
        raise InputError(f'{path}: --wheel-momentum: expected one epoch, found {len(found)}')
    return [_sources(path, scene, parts, momentum, bool(topics.wheel_torque), interpolation)
            for parts in found]


def _sources(path: str | Path, scene: Scene, torques: Sequence[Messages],
             momentum: Messages | None, has_wheels: bool, interpolation: str) -> Sources:
    """Return the torques of a motion; those on the rotors are the last ones, if there are any."""
    body = torques[:-1] if has_wheels else torques
    logs = tuple(_log(path, one, scene, interpolation) for one in body)
    every, measured = [*torques, *([] if momentum is None else [momentum])], None
    wheels = _wheel_log(path, torques[-1], scene, interpolation) if has_wheels else None
    if momentum is not None:
        measured = _momentum(path, momentum, scene)
        wheels = _from_momentum(path, momentum, measured, scene)
    damage = '; '.join(dict.fromkeys(one.damage for one in every if one.damage))
    stamps = _stamps(logs, wheels)
    begin = next((one.start for one in torques if one.start), None)
    if not stamps.size and not begin:
        lost = f' ({damage})' if damage else ''
        raise InputError(f'{path}: expected torques, found no messages on '
                         f'{listed([one.topic for one in every])}{lost}')
    start = begin or replace(scene.start, time_ns=scene.start.time_ns or int(stamps[0]))
    if measured is not None:
        start = _started(start, measured)
    unordered = sum(int(np.sum(np.diff(one.stamps_ns) <= 0)) for one in every)
    return Sources(logs, wheels, measured is not None, start, sum(len(one) for one in every),
                   unordered, begin is not None, damage)


def _match(name: str, recorded: Sequence[str]) -> str | None:
    return next((topic for topic in recorded if topic in (name, absolute(name))), None)


def _torques_of(path: str | Path, names: Sequence[str], recorded: list[str],
                optional: bool) -> tuple[str, ...]:
    """Return the topics of the scene in a recording; a single topic may have any name."""
    found = [_match(name, recorded) for name in names]
    missing = [name for name, topic in zip(names, found) if topic is None]
    for topic in found:
        if topic and found.count(topic) > 1:
            raise InputError(f'{path}: torque_topics: expected each topic once, found {topic!r} '
                             'twice')
    if not missing:
        return tuple(filter(None, found))
    if len(names) == len(recorded) == 1:
        return recorded[0],
    if optional and not recorded:
        return ()
    raise InputError(f'{path}: expected the torque_topics of the scene, found no topic '
                     f'{listed(missing)} among {listed(recorded)}; choose topics with --topic')


def _stamps(logs: Sequence[TorqueLog], wheels: TorqueLog | None) -> NDArray[np.int64]:
    every = [*logs, *([wheels] if wheels else [])]
    return np.unique(np.concatenate([np.empty(0, np.int64), *(log.times_ns for log in every)]))


def _log(path: str | Path, recorded: Messages, scene: Scene, interpolation: str) -> TorqueLog:
    """Return the log of a topic; a source without messages has no torque."""
    if not len(recorded):
        return TorqueLog([], [], interpolation=interpolation)
    return recording.torque_log(path, recorded, scene.body_frame, scene.space_frame,
                                interpolation, scene.links)


def _wheel_log(path: str | Path, recorded: Messages, scene: Scene,
               interpolation: str) -> TorqueLog:
    _check_axes(path, recorded, scene)
    return _log(path, recorded, scene, interpolation)


def _check_axes(path: str | Path, recorded: Messages, scene: Scene) -> None:
    """Raise InputError if a vector of the rotors is not in body axes."""
    body = scene.body_frame
    for code, name in enumerate(recorded.names):
        if name not in ('', body):
            number = recorded.before + int(np.argmax(recorded.frames == code)) + 1
            raise InputError(f'{path}: {recorded.topic}: message {number}: frame_id: '
                             f"expected '{body}' or '' (body axes), found {quoted(name)}")


def _momentum(path: str | Path, recorded: Messages, scene: Scene) -> TorqueLog:
    """Return the measured momenta, N m s, between whose samples the momentum is linear."""
    where = f'{path}: {recorded.topic}'
    if not len(recorded):
        raise InputError(f'{where}: expected the momentum of the rotors, found no messages')
    _check_axes(path, recorded, scene)
    unstamped = int(np.sum(recorded.stamps_ns == 0))
    if unstamped > 1:
        raise InputError(f'{where}: expected stamps in the headers, found 0 in {unstamped} of '
                         f'{len(recorded)} messages; use --time-source log for the times of the '
                         'recording')
    bad = np.flatnonzero(~np.isfinite(recorded.values).all(axis=1))
    if bad.size:
        raise InputError(f'{where}: message {bad[0] + 1} at {recorded.stamps_ns[bad[0]]} ns: '
                         'expected a finite momentum, found '
                         f'{recorded.values[bad[0]].tolist()}')
    return TorqueLog(recorded.stamps_ns, recorded.values, interpolation='linear')


def _from_momentum(path: str | Path, recorded: Messages, measured: TorqueLog,
                   scene: Scene) -> TorqueLog:
    where = f'{path}: {recorded.topic}'
    longest = int(np.diff(measured.times_ns).max(initial=0))
    if 0 < scene.timeout_ns < longest:
        raise InputError(f'{where}: expected samples at most torque_timeout '
                         f'({scene.torque_timeout} s) apart, found a gap of '
                         f'{longest * 1e-9:.9g} s')
    try:
        return TorqueLog.from_momentum(measured.times_ns, measured.torques)
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error


def _started(start: State, measured: TorqueLog) -> State:
    """Return the start with the measured momentum, which is constant before the first sample."""
    time_ns = max(start.time_ns, int(measured.times_ns[0]))
    momentum: Floats = measured.at([time_ns])[0][0]
    given = start.rotor_momentum
    if given.any() and np.linalg.norm(given - momentum) > _SAME_MOMENTUM * np.linalg.norm(given):
        raise InputError(f'initial_rotor_momentum: expected {momentum.tolist()} N m s as '
                         f'measured at the start, or no value, found {given.tolist()}')
    return replace(start, rotor_momentum=momentum)
