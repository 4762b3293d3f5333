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

"""Read measured attitudes and angular velocities from a recording."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted, shortened
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.frames import Frame, Frames, NO_FRAMES, TurningFrame
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording import quantities, source
from rigid_body_ros.recording.account import SLASH
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.recording.quantities import KINDS, MeasuredSamples, QUANTITIES
from rigid_body_ros.recording.source import Messages, Source, with_types
from rigid_body_ros.recording.text_files import is_text_file
from rigid_body_ros.runtime.terminal import no_progress, Track

#: Message types that always contain a measured attitude or angular velocity.
_CERTAIN = tuple(kind for kind in KINDS if kind is not messages.VECTOR3)
#: Message types whose frames can be chosen.
_TRANSFORMS = tuple(kind for kind in KINDS if kind.has_child_frame)
#: Message types whose frame_id names the axes of a sensor.
_OF_SENSOR = (messages.IMU, messages.VECTOR3)


#: What the name of a topic of fixed transforms ends in.
_STATIC = '_static'
_ROTATION = slice(3, 7)
#: A frame_id and a child_frame_id.
_Pair = tuple[str, str]


class MeasuredOptions(NamedTuple):
    """
    How to read measured topics.

    Attributes
    ----------
    frames : tuple of str, optional
        The parent frame and the child frame of the messages to read, if the topic contains
        transforms or Odometry messages. The default for a TFMessage topic is to read the
        transforms from the space frame to the body frame, or to compose them from a chain of
        transforms; see `_chained`. The default for a TransformStamped or Odometry topic is
        to read all messages, which must have the same pair of frames.
    body_frame, space_frame : str
        The frames of the scene.
    links : Frames
        The links that are fixed to the body; see `urdf.fixed_frames`. Measurements in the axes of
        a link are converted to body axes.
    time_source : str
        Where the stamps come from: 'header', 'log' (the time of recording) or 'publish' (the time
        of publishing).
    columns : mapping of str to str, optional
        The columns of CSV files; see `text_files.Table`.
    track : callable
        A function that wraps the iteration over blocks of messages, to show progress.

    """

    frames: tuple[str, str] | None = None
    body_frame: str = 'base_link'
    space_frame: str = 'world'
    links: Frames = NO_FRAMES
    time_source: str = 'header'
    columns: Mapping[str, str] | None = None
    track: Track = no_progress

    def link(self, frame_id: str) -> Frame | None:
        """Return the frame of a link that is fixed to the body; None if there is no such link."""
        frame = self.links.get(frame_id.removeprefix('/'))
        return None if isinstance(frame, TurningFrame) else frame

    def other_frames(self, kind: MessageType, frame_id: str, child_frame_id: str) -> str:
        """
        Describe the frames of a message if `in_body_axes` cannot convert it.

        Return an empty string if the frames are those of the scene or can be converted.
        """
        space, body = ['', self.space_frame], ['', self.body_frame]
        if kind in (messages.IMU, messages.ODOMETRY):
            body.append(self.space_frame)
        names = [frame_id] if kind in _OF_SENSOR else [frame_id, child_frame_id]
        expected = [body] if kind in _OF_SENSOR else [space, body]
        if all(name.removeprefix('/') in accepted or (accepted is body and self.link(name))
               for name, accepted in zip(names, expected)):
            return ''
        if kind.has_child_frame:
            return f'expected frames {quoted(space[1])} to {quoted(body[1])}, found ' \
                   f'{quoted(frame_id)} to {quoted(child_frame_id)}'
        return f'expected frame_id {quoted(expected[0][1])}, found {quoted(frame_id)}'


def read_measured(path: str | Path, topic: str | None = None, **options: Any) -> Measured:
    """
    Read a measured topic: attitudes, angular velocities, or both.

    A message is rejected if its quaternion is zero or not finite, or if its angular velocity is
    not finite or above 1e9 rad/s. A value is treated as not measured if its covariance in an Imu
    message begins with -1, or if one of its variances is at least 1000 rad^2 or 1000 rad^2/s^2, or
    if it never changes although the other value of the same messages says that the body turns. A
    covariance that is zero or not positive definite is treated as unknown. An angular velocity in
    space axes is converted to body axes if the message also contains an attitude.

    Parameters
    ----------
    path : str or Path
        A recording, as for `recording.read`.
    topic : str, optional
        A topic of type QuaternionStamped, PoseStamped, PoseWithCovarianceStamped,
        TransformStamped, TFMessage, Odometry, Imu, or Vector3Stamped (an angular velocity), or the
        name of a text file; see `text_files.Table`. Only its attitudes or angular velocities are
        read if ':attitude' or ':rates' follows. A topic of another recording is named
        FILE:TOPIC. If no topic is given, the path is a text file, or the recording contains
        exactly one topic of these types, not counting Vector3Stamped.
    options
        The attributes of `MeasuredOptions`.

    Returns
    -------
    Measured
        The samples, sorted by stamp. If several messages have the same stamp, the last one in the
        recording is used; `Measured.account` counts the others.

    Raises
    ------
    InputError
        The recording cannot be read; the topic is missing, ambiguous or of an unsupported type, or
        lacks the chosen quantity; the messages have several pairs of frames, or none has the
        requested pair; attitudes and angular velocities are in different messages; or the topic
        contains fewer than four usable messages with different stamps.

    """
    sensors = _read(path, topic, MeasuredOptions(**options))
    if len(sensors) > 1:
        raise InputError(f'{path}: {topic}: expected attitudes and angular velocities in the same '
                         f'messages, found {len(sensors[0])} and {len(sensors[1])} with one of '
                         f'them; choose {sensors[0].topic} or {sensors[1].topic}')
    return sensors[0]


def read_all(path: str | Path, topics: Iterable[str], options: MeasuredOptions) -> list[Measured]:
    """
    Read several measured topics, each as `read_measured` does.

    Attitudes and angular velocities that are in different messages of a topic become two sensors.

    Raises
    ------
    InputError
        `read_measured` raised this error, or a topic was given twice.

    """
    names: list[str | None] = [*topics]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f'--measured: expected each topic once, found {name!r} twice')
    # The frames apply only to those of the given topics whose message type has two frames. If no
    # given topic has such a type, the frames apply to all topics.
    chosen = {*source.topics(path, _TRANSFORMS)} & {*names} if options.frames else set()
    return [sensor for name in names or [None] for sensor in _read(
        path, name, options._replace(frames=options.frames
                                     if name in chosen or not chosen else None))]


def parts_of(path: str | Path, name: str) -> tuple[str | Path, str, str]:
    """
    Split the name of measurements into a file, a topic of this file, and a quantity.

    The name is [FILE:]TOPIC[:QUANTITY], or FILE[:QUANTITY] for a text file, whose topic is ''. The
    quantity is 'attitude', 'rates', or '' for both. The default file is `path`, also if no file is
    called FILE.
    """
    head, _, quantity = name.rpartition(':')
    name, quantity = (head, quantity) if quantity in QUANTITIES and head else (name, '')
    if is_text_file(name):
        return name, '', quantity
    file, _, topic = name.rpartition(':')
    return (file, topic, quantity) if os.path.exists(file) else (path, name, quantity)


def _read(path: str | Path, name: str | None, options: MeasuredOptions) -> list[Measured]:
    """Read one topic or text file; the result has two sensors if their messages differ."""
    name = name or (str(path) if is_text_file(str(path)) else _only_topic(path))
    file, topic, quantity = parts_of(path, name)
    where = f'{file}: {topic}' if topic else str(file)
    parts = [Path(file).name if file != path or not topic else '', topic, quantity]
    frames = ''
    if topic:
        recorded, kind = _messages(file, topic, options)
        # First, because only an attitude that is measured can convert rates in space axes.
        samples = quantities.of_messages(recorded, kind).without_unmeasured()
        frames = _other_frames(where, recorded, kind, options)
        samples = in_body_axes(where, samples, recorded, kind, options)
        if any(name[:1] == '/' for names in (recorded.names, *recorded.pairs) for name in names):
            samples = replace(samples, notes=(*samples.notes, SLASH))
    else:
        samples = quantities.of_table(file, options.columns).without_unmeasured()
    if quantity:
        if not samples.given[:, QUANTITIES.index(quantity)].any():
            raise InputError('; '.join([f'{where}:{quantity}: expected samples of this quantity, '
                                        'found none', *samples.notes]))
        samples = samples.without({*QUANTITIES} - {quantity})
    sensors = samples.sensors(where, ':'.join(filter(None, parts)),
                              bool(topic) and options.time_source == 'header')
    return [replace(sensor, frames=frames) for sensor in sensors]


def _messages(path: str | Path, topic: str,
              options: MeasuredOptions) -> tuple[Messages, MessageType]:
    """Read the messages of a topic; compose transforms if none is between the frames."""
    frames, time_source = options.frames, options.time_source
    with Source(path, topic, KINDS, time_source) as opened:
        kind = opened.kind
    if frames and not kind.has_child_frame:
        raise InputError(f'{path}: {topic}: --frames: expected a topic of transforms or '
                         f'odometry, found {kind.name}')
    if kind is messages.TRANSFORM:
        frames = frames or (options.space_frame, options.body_frame)
    with Source(path, topic, (kind,), time_source, frames=frames) as opened:
        recorded = opened.read(options.track)
    if not len(recorded) and frames:
        if kind is messages.TRANSFORM:
            return _chained(path, topic, frames, time_source), kind
        raise InputError(f'{path}: {topic}: expected transforms from {quoted(frames[0])} to '
                         f'{quoted(frames[1])}, found none; choose other frames with --frames')
    return recorded, kind


def _only_topic(path: str | Path) -> str:
    topics = [topic for topic in source.topics(path, _CERTAIN) if not topic.endswith(_STATIC)]
    if len(topics) != 1:
        types = source.topics(path)
        advice = '; choose one with --measured' if topics else ''
        raise InputError(f'{path}: expected one topic of a measured attitude (QuaternionStamped, '
                         'PoseStamped, PoseWithCovarianceStamped, TransformStamped, TFMessage, '
                         f'Odometry, Imu), found {with_types(types, topics or types)}{advice}')
    return topics[0]


def in_body_axes(where: str, samples: MeasuredSamples, recorded: Messages, kind: MessageType,
                 options: MeasuredOptions) -> MeasuredSamples:
    """
    Convert measurements whose frame is the space frame or a link to body axes, with a note.

    Parameters
    ----------
    where : str
        The file and the topic, for error messages.
    samples : MeasuredSamples
        The samples in the messages.
    recorded : Messages
        The messages.
    kind : MessageType
        Their type.
    options : MeasuredOptions
        The frames of the scene, and the frames that were chosen.

    Raises
    ------
    InputError
        An angular velocity is in space axes, and the messages contain no attitude.

    """
    parent, child = options.frames or next(iter(recorded.pairs), ('', ''))
    if kind.has_child_frame:
        axes = [(child, np.full(len(recorded), True))]
    else:
        axes = [(name, recorded.frames == code) for code, name in enumerate(recorded.names)
                if kind in _OF_SENSOR]
    for name, rows in axes:
        frame = name.removeprefix('/')
        is_space = frame == options.space_frame or (
            kind is messages.ODOMETRY and frame == parent.removeprefix('/'))
        if frame in ('', options.body_frame):
            continue
        has_attitude, has_rates = samples.usable[rows].any(axis=0).tolist()
        if has_rates and is_space:
            if not has_attitude:
                number = recorded.before + int(np.argmax(rows)) + 1
                raise InputError(f'{where}: message {number}: frame_id: expected an angular '
                                 f'velocity in body axes, found {shortened(quoted(name))} (space '
                                 'axes)')
            samples = samples.rates_from_space(rows, quoted(name))
        elif (link := options.link(name)) and not link.is_aligned:
            samples = samples.from_link(rows, link.rotation, quoted(name))
    return samples


def _other_frames(where: str, recorded: Messages, kind: MessageType,
                  options: MeasuredOptions) -> str:
    """
    Describe the frames of messages that are not those of the scene and cannot be converted.

    Return an empty string if there are no such frames.
    """
    if len(recorded.pairs) > 1:
        texts = [f'{quoted(parent)} to {quoted(child)}' for parent, child in recorded.pairs]
        raise InputError(f'{where}: expected one pair of frames, found {listed(texts)}; choose '
                         'one with --frames')
    pairs = [*recorded.pairs] if kind.has_child_frame else [(name, '') for name in recorded.names]
    return '; '.join(filter(None, (options.other_frames(kind, *pair) for pair in pairs)))


def _chained(path: str | Path, topic: str, ends: _Pair, time_source: str) -> Messages:
    """
    Compose the rotations between two frames that no message connects directly.

    They are composed at the stamps of the fastest transform in the chain. The rotations of the
    others are interpolated with a constant angular velocity (slerp) between their samples. A
    transform on a topic whose name ends in _static holds at all times.

    Parameters
    ----------
    path : str or Path
        The recording.
    topic : str
        A topic of type TFMessage.
    ends : tuple of str
        The first and the last frame of the chain.
    time_source : str
        As for `Source`.

    Returns
    -------
    Messages
        In the order of the recording. The rotation is NaN at stamps at which one of the other
        transforms is not known.

    Raises
    ------
    InputError
        No chain of transforms connects the frames, or all of its transforms are fixed.

    """
    homes: dict[_Pair, str] = {}
    transforms = source.topics(path, [messages.TRANSFORM])
    for name in sorted({topic, topic + _STATIC}.intersection(transforms)):
        with Source(path, name, [messages.TRANSFORM], time_source) as opened:
            homes |= dict.fromkeys(opened.pairs(), name)
    pairs = _chain(homes, *ends)
    described = [f'{quoted(parent)} to {quoted(child)}' for parent, child in homes]
    if not pairs:
        raise InputError(f'{path}: {topic}: expected transforms from {quoted(ends[0])} to '
                         f'{quoted(ends[1])}, directly or in a chain, found '
                         f'{listed(described)}; choose other frames with --frames')
    links = []
    for pair in pairs:
        recorded = pair if pair in homes else pair[::-1]
        with Source(path, homes[recorded], [messages.TRANSFORM], time_source,
                    frames=recorded) as opened:
            link = opened.read()
        rotations = so3.normalize(link.values[:, _ROTATION])
        link.values[:, _ROTATION] = rotations if pair in homes else so3.conjugate(rotations)
        links.append(replace(link, stamps_ns=link.stamps_ns[:0], values=link.values[-1:])
                     if homes[recorded].endswith(_STATIC) else link)
    fastest = max(links, key=lambda link: len(link.stamps_ns))
    if not len(fastest):
        raise InputError(f'{path}: {topic}: expected a transform that changes between '
                         f'{quoted(ends[0])} and {quoted(ends[1])}, found fixed ones only')
    values = fastest.values.copy()
    values[:, _ROTATION] = [0.0, 0.0, 0.0, 1.0]
    for link in links:
        rotations = link.values[:, _ROTATION] if link is fastest else _at(fastest.stamps_ns, link)
        values[:, _ROTATION] = so3.multiply(values[:, _ROTATION], rotations)
    return replace(fastest, values=values)


def _chain(pairs: Collection[_Pair], first: str, last: str) -> list[_Pair]:
    """Return the shortest chain of pairs of frames, in either direction; [] if there is none."""
    chains: dict[str, list[_Pair]] = {first: []}
    waiting = [first]
    for frame in waiting:  # the loop extends this list
        for pair in [*pairs, *(pair[::-1] for pair in pairs)]:
            if pair[0] == frame and pair[1] not in chains:
                chains[pair[1]] = [*chains[frame], pair]
                waiting.append(pair[1])
    return chains.get(last, [])


def _at(times_ns: NDArray[np.int64], link: Messages) -> Floats:
    """Return the rotations of a link at the given times; NaN before and after its samples."""
    rotations = link.values[:, _ROTATION]
    if not len(link):  # fixed
        return rotations
    stamps_ns, rows = np.unique(link.stamps_ns[::-1], return_index=True)
    rotations = rotations[::-1][rows]
    before = np.clip(np.searchsorted(stamps_ns, times_ns, 'right') - 1, 0,
                     max(len(stamps_ns) - 2, 0))
    after = np.minimum(before + 1, len(stamps_ns) - 1)
    share = (times_ns - stamps_ns[before]) / np.maximum(stamps_ns[after] - stamps_ns[before], 1)
    turns = so3.difference(rotations[before], rotations[after])
    is_known = (times_ns >= stamps_ns[0]) & (times_ns <= stamps_ns[-1])
    return np.where(is_known[:, None], so3.multiply(
        rotations[before], so3.exp(share[:, None] * turns)), np.nan)
