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

"""Open a recording, and read the messages on one topic, all at once or in blocks."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
import os
from pathlib import Path, PurePath
from typing import Any

from mcap.records import Channel, Schema
import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted, reason, shortened
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.messages import MessageType, PX4_TYPES, Px4Type, TORQUE_VECTOR
from rigid_body_ros.recording import bulk
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import File
from rigid_body_ros.recording.mcap_file import McapFile
from rigid_body_ros.recording.sqlite_file import SqliteFile
from rigid_body_ros.recording.text_files import CsvFile
from rigid_body_ros.recording.ulog_file import is_ulog, UlogFile
from rigid_body_ros.recording.unpack import temporary, unpack_each, unpack_file
from rigid_body_ros.recording.writer import Writer
from rigid_body_ros.runtime.files import reported
from rigid_body_ros.runtime.limits import open_file, read_yaml
from rigid_body_ros.runtime.terminal import no_progress, Track
import yaml
from yaml.constructor import BaseConstructor

#: The message types that carry a torque.
TORQUES = (messages.WRENCH, messages.BARE_WRENCH)
#: The first bytes of a ROS 1 bag.
_ROS1 = b'#ROSBAG V2.0'


@dataclass(frozen=True, eq=False)
class Messages:
    """
    Messages of one topic, in the order in which they were recorded.

    Attributes
    ----------
    topic : str
    stamps_ns : array of int64, shape (n,)
        The stamps, ns. By default they come from the message headers. If the type has no header,
        or if the caller chose another source, they are the times at which the messages were
        recorded or published.
    frames : array of int, shape (n,)
        For each message, the index of its frame_id in `names`.
    names : list of str
        The distinct frame_ids.
    values : array, shape (n, d)
        The doubles in each message, in field order.
    damage : str
        What was lost and where; '' if nothing was lost.
    before : int
        The number of earlier messages on the same topic.
    start : State, optional
        The start state, if the messages are one epoch of a node's log; see `torques.epochs`.
    pairs : tuple of (str, str)
        The first few distinct pairs of frame_id and child_frame_id. Set only if the message type
        has both names and the caller did not choose a pair.
    notes : tuple of str
        What was assumed about the messages, such as the unit of their times.

    """

    topic: str
    stamps_ns: NDArray[np.int64]
    frames: NDArray[np.intp]
    names: list[str]
    values: Floats
    damage: str = ''
    before: int = 0
    start: State | None = None
    pairs: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def rows(self, chosen: slice | NDArray[np.bool_]) -> Messages:
        """Return the chosen messages; `names` then lists only the frame_ids in these messages."""
        used, frames = np.unique(self.frames[chosen], return_inverse=True)
        return replace(self, stamps_ns=self.stamps_ns[chosen], frames=frames,
                       names=[self.names[code] for code in used], values=self.values[chosen])

    @property
    def frame_ids(self) -> list[str]:
        """Return the frame_id of each message."""
        return [self.names[code] for code in self.frames.tolist()]


class Source:
    """
    A reader for one topic of a recording.

    A `Source` is a context manager; iterate over it to read the messages in blocks of `Messages`.

    Parameters
    ----------
    path : str or Path
        An MCAP file; a SQLite file of rosbag2; a folder that contains MCAP or SQLite files and
        metadata.yaml; a PX4 log (.ulg); or a CSV file of torques. The first line of a CSV file may
        name the columns and their units; otherwise the columns are time (s), tx, ty, tz (N m).
    topic : str, optional
        The topic to read. You may omit it if only one topic has a type from `kinds`.
    kinds : sequence of MessageType
        The message types to accept. The types of PX4 that are converted to one of these types are
        also accepted. If `topic` is given and torques are accepted, so is a Vector3Stamped.
    time_source : str
        Where the stamps come from: 'header', 'log' (time of recording) or 'publish' (time of
        publishing).
    preferred : str
        The topic to read if `topic` is omitted and several topics have a type from `kinds`.
    frames : tuple of str, optional
        The frame and child frame of the transforms to read, if the messages contain transforms.
    columns : mapping of str to str, optional
        The columns of a CSV file; see `text_files.Table`.

    Attributes
    ----------
    topic : str
    kind : MessageType
        The type of the topic, or the type to which its messages are converted.
    types : dict
        The type of each topic of the recording.
    count : int
        The number of messages on the topic. The messages in a file that does not store their
        number are not counted.
    damage : str
        What was lost and where; '' if nothing was lost. This is complete only once all messages
        have been read.

    Raises
    ------
    InputError
        The recording cannot be read; the topic does not exist, has another type or is ambiguous;
        or, during iteration, a message does not match its type.

    """

    def __init__(self, path: str | Path, topic: str | None, kinds: Sequence[MessageType],
                 time_source: str = 'header', preferred: str = '',
                 frames: tuple[str, str] | None = None,
                 columns: Mapping[str, str] | None = None) -> None:
        self._path, self._frames = path, frames
        self._time_source = time_source
        self._longer = 0
        self._stack = ExitStack()
        with ExitStack() as stack:
            self._files, self._compressed, self._missing = _open_files(path, stack, columns)
            self.types = {name: kind for file in self._files for name, kind in file.types.items()}
            self.topic, self._encoding = _select_topic(path, self.types, topic, kinds,
                                                       preferred)
            self.kind = self._encoding.like or self._encoding
            self._stack = stack.pop_all()
        self._with_topic = [file for file in self._files if self.topic in file.types]
        self.count = sum(file.count(self.topic) for file in self._with_topic)

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def damage(self) -> str:
        """Return what data was lost and where; '' if nothing was lost."""
        lost = [f'{file.path}: {file.damage}' for file in self._files if file.damage]
        longer = f'{self._path}: {self.topic}: {self._longer} messages are longer than ' \
            f'{self.kind.name}; the bytes after its last field are ignored' if self._longer else ''
        return shortened('; '.join([*lost, *filter(None, [self._missing, longer])]))

    @property
    def notes(self) -> list[str]:
        """Return what was assumed about the messages; complete once all have been read."""
        return [note for file in self._files for note in file.notes]

    def read(self, track: Track = no_progress) -> Messages:
        """Read all messages; `track` wraps the iteration over blocks, to show progress."""
        blocks = [*track(self, self.count)]
        return replace(joined(self.topic, self.kind, blocks, self.damage),
                       notes=tuple(self.notes))

    def metadata(self, name: str) -> dict[str, str]:
        """Return the metadata record `name`, or {} if there is none."""
        return {key: value for file in self._files for key, value in file.metadata(name).items()}

    def pairs(self) -> list[tuple[str, str]]:
        """Return the pairs of frame_id and child_frame_id on a topic of transforms."""
        pairs, number = dict[tuple[str, str], None](), 0
        for file in self._with_topic:
            for raw in file.read(self.topic, self._encoding):
                plain = self._decompressed(raw, self.topic, number)
                try:
                    pairs |= dict.fromkeys(bulk.frame_pairs(self.kind, plain))
                except bulk.BadMessageError as error:
                    raise self._error(error, self.topic, number) from error
                number += len(raw.starts)
        return [*pairs]

    def check_copied(self, topics: Collection[str]) -> None:
        """Raise InputError if the recording cannot be copied to a file that has `topics`."""
        for file in self._files:
            if not isinstance(file, McapFile):
                raise InputError(f'{file.path}: expected an MCAP file, because only its messages '
                                 'can be copied')
        twice = sorted(self.types.keys() & set(topics))
        if twice:
            raise InputError(f'{self._path}: cannot copy topics that are also written: '
                             f'{listed(twice)}')

    def copy_to(self, writer: Writer) -> None:
        """Copy every message of the recording to `writer`, byte for byte."""
        numbers: dict[str, int] = {}
        for file in self._files:
            assert isinstance(file, McapFile)  # check_copied ensures this
            for channel, schema, raw in file.read_all():
                number = numbers.get(channel.topic, 0)
                writer.copy(channel, schema, self._decompressed(raw, channel.topic, number))
                numbers[channel.topic] = number + len(raw.starts)

    def __iter__(self) -> Iterator[Messages]:
        number = self._longer = 0
        for file in self._with_topic:
            for raw in file.read(self.topic, self._encoding):
                block = self._messages(raw, number, file.encodings.get(self.topic))
                number += len(raw.starts)
                if len(block):  # a block may have no transform between the chosen frames
                    yield block
            if file.damage:
                return

    def _messages(self, raw: Raw, number: int, encoding: MessageType | None) -> Messages:
        plain = self._decompressed(raw, self.topic, number)
        if self._time_source != 'header' and self.kind.has_header and not self.kind.is_list:
            plain = plain.without_stamps()
        pairs: list[tuple[str, str]] = []
        try:
            plain = bulk.converted(encoding, plain) if isinstance(encoding, Px4Type) else plain
            if self._frames and self.kind.has_child_frame:
                raw, decoded = bulk.decode_transforms(self.kind, plain, self._frames)
            else:
                kind = TORQUE_VECTOR if encoding is TORQUE_VECTOR else self.kind
                decoded = bulk.decode(kind, plain)
                pairs = bulk.frame_pairs(self.kind, plain) if self.kind.has_child_frame else []
        except bulk.BadMessageError as error:
            raise self._error(error, self.topic, number) from error
        self._longer += decoded.longer
        stamps_ns = decoded.stamps_ns
        if self._time_source == 'publish':
            stamps_ns = raw.publish_ns
        elif self._time_source == 'log' or not self.kind.has_header:
            stamps_ns = raw.log_ns
        return Messages(self.topic, stamps_ns, decoded.frames, decoded.names, decoded.values,
                        before=number, pairs=tuple(pairs))

    def _decompressed(self, raw: Raw, topic: str, number: int) -> Raw:
        """Decompress messages; `number` is the number of earlier messages on the same topic."""
        try:
            return unpack_each(raw) if self._compressed else raw
        except bulk.BadMessageError as error:
            raise self._error(error, topic, number) from error

    def _error(self, error: bulk.BadMessageError, topic: str, number: int) -> InputError:
        return InputError(f'{self._path}: {topic}: message {number + error.row + 1}: {error}')


def read(path: str | Path, topic: str | None = None,
         kind: MessageType | Sequence[MessageType] | None = None, track: Track = no_progress,
         time_source: str = 'header', preferred: str = '',
         columns: Mapping[str, str] | None = None) -> Messages:
    """
    Read all messages of a topic.

    Parameters
    ----------
    path : str or Path
        A recording: an MCAP file; a SQLite file of rosbag2; a folder that contains MCAP or SQLite
        files and metadata.yaml; a PX4 log (.ulg); or a CSV file of torques.
    topic : str, optional
        The topic to read. You may omit it if only one topic has the type `kind`.
    kind : MessageType or sequence of MessageType, optional
        The message type, such as `messages.QUATERNION`; by default WrenchStamped or Wrench or, if
        the topic is given, also Vector3Stamped.
    track : callable, optional
        Wraps the iteration over blocks of messages, to show progress.
    time_source : str
        Where the stamps come from: 'header', 'log' (time of recording) or 'publish' (time of
        publishing).
    preferred, columns
        See `Source`.

    Returns
    -------
    Messages

    Raises
    ------
    InputError
        The recording cannot be read; the topic does not exist, has another type or is ambiguous;
        or a message does not match its type.

    """
    kinds = torques(topic) if kind is None else (kind,) if isinstance(kind, MessageType) else kind
    with Source(path, topic, kinds, time_source, preferred, columns=columns) as source:
        return source.read(track)


def torques(topic: str | None) -> Sequence[MessageType]:
    """Return the types of torques on a topic: a vector may be anything, unless it is named."""
    return (*TORQUES, TORQUE_VECTOR) if topic else TORQUES


def topics(path: str | Path, kinds: Sequence[MessageType] | None = None) -> dict[str, str]:
    """
    Return the types of the topics whose type is in `kinds`, by default of all topics.

    Raise the same errors as `read`.
    """
    names = None if kinds is None else _by_name(kinds)
    with ExitStack() as stack:
        files, _, _ = _open_files(path, stack)
        return {topic: kind for file in files for topic, kind in file.types.items()
                if names is None or kind in names}


def read_all(path: str | Path) -> Iterator[tuple[Channel, Schema | None, Raw]]:
    """
    Generate the messages on all topics in blocks, each with its channel and its schema.

    Raise InputError if the recording is damaged, or is neither an MCAP file nor a bag of such
    files.
    """
    with ExitStack() as stack:
        files, compressed, missing = _open_files(path, stack)
        for file in files:
            if not isinstance(file, McapFile):
                raise InputError(f'{file.path}: expected an MCAP file, found another format')
            for channel, schema, raw in file.read_all():
                try:
                    yield channel, schema, unpack_each(raw) if compressed else raw
                except bulk.BadMessageError as error:
                    raise InputError(f'{file.path}: {channel.topic}: {error}') from error
            if lost := file.damage or missing:
                raise InputError(f'{file.path}: expected a complete recording, found: {lost}')


def _by_name(kinds: Sequence[MessageType]) -> dict[str, MessageType]:
    """Return the message types that can be read as one of `kinds`."""
    return {kind.name: kind for kind in (*kinds, *PX4_TYPES.values())
            if kind in kinds or kind.like in kinds}


def joined(topic: str, kind: MessageType, blocks: list[Messages], damage: str) -> Messages:
    """Join blocks of messages into a single `Messages` object."""
    names: dict[str, int] = {}
    frames = [np.array([names.setdefault(name, len(names)) for name in block.names],
                       np.intp)[block.frames] for block in blocks]
    return Messages(
        topic,
        np.concatenate([np.empty(0, np.int64), *(block.stamps_ns for block in blocks)]),
        np.concatenate([np.empty(0, np.intp), *frames]), [*names],
        np.concatenate([np.empty((0, kind.doubles)), *(block.values for block in blocks)]),
        damage, pairs=tuple(dict.fromkeys(pair for block in blocks for pair in block.pairs)))


def _select_topic(path: str | Path, types: dict[str, str], topic: str | None,
                  kinds: Sequence[MessageType], preferred: str) -> tuple[str, MessageType]:
    by_name = _by_name(kinds)
    expected = ' or '.join(kind.name for kind in kinds)
    fitting = [name for name, kind in types.items() if kind in by_name]
    if topic is None:
        if preferred in fitting:
            fitting = [preferred]
        if len(fitting) != 1:
            advice = '; choose one with --topic' if fitting else ''
            raise InputError(f'{path}: expected one topic of type {expected}, '
                             f'found {with_types(types, fitting or types)}{advice}')
        topic = fitting[0]
    if topic not in types:
        raise InputError(f'{path}: expected a topic {shortened(topic, 100)}, '
                         f'found {with_types(types, types)}')
    if topic not in fitting:
        raise InputError(f'{path}: {shortened(topic, 100)}: expected {expected}, '
                         f'found {shortened(types[topic], 100) or "no type"}')
    return topic, by_name[types[topic]]


def with_types(types: Mapping[str, str], topics: Iterable[str]) -> str:
    """List topics with their types."""
    return listed([f'{topic} ({types[topic] or "no type"})' for topic in topics])


def _open_files(name: str | Path, stack: ExitStack, columns: Mapping[str, str] | None = None
                ) -> tuple[list[File], bool, str]:
    """
    Open the files of a recording.

    Return three values: the files, whether their messages are compressed, and a text that says why
    files are missing ('' if none are missing). `columns` are those of a CSV file; see
    `text_files.Table`.
    """
    if name == '':  # Path('') would be the current folder
        raise InputError('expected a recording, found an empty name')
    path = Path(name)
    if not os.path.isdir(path):  # Path.is_dir raises an error if the name is too long
        return [_open_file(path, stack, columns)], False, ''
    about = _metadata(path / 'metadata.yaml')
    compressed = str(about.get('compression_mode', '')).lower() == 'message'
    files: list[File] = []
    for file in _bag_files(path, about.get('relative_file_paths')):
        try:
            files.append(_open_file(file, stack))
        except InputError as error:
            if not files:
                raise
            return files, compressed, f'{error}; only the files before it were read'
    return files, compressed, ''


def _bag_files(folder: Path, names: object) -> list[Path]:
    """Return the paths of a bag's files; raise InputError if a file is not in the bag's folder."""
    where = f'{folder}/metadata.yaml: relative_file_paths'
    if not names or not isinstance(names, list):
        raise InputError(f'{where}: expected file names, found {quoted(names)}')
    home = os.path.realpath(folder)
    paths: dict[str, Path] = {}
    for name in names:
        if not isinstance(name, str) or '\0' in name or not PurePath(name).name:
            raise InputError(f'{where}: expected file names, found {quoted(name)}')
        named = PurePath(name)
        if named.name in paths:
            raise InputError(f'{where}: expected each file once, found {quoted(name)} twice')
        # Early versions of rosbag2 put the folder name in front of the file name.
        path = paths[named.name] = folder / named.name
        if named.is_absolute() or '..' in named.parts \
                or os.path.dirname(os.path.realpath(path)) != home:
            raise InputError(f'{where}: expected files in the folder of the bag, '
                             f'found {quoted(name)}')
    return [*paths.values()]


def _metadata(path: Path) -> dict[str, Any]:
    if not os.path.lexists(path):
        raise InputError(f'{path}: file not found; a bag folder must contain it')
    root = read_yaml(path, 'metadata of the recording', aliases=True)
    try:
        content = BaseConstructor().construct_document(root) if root else None
    except yaml.YAMLError as error:  # for example, because a key is not a name
        raise InputError(f'{path}: expected names as keys ({reason(error)})') from error
    about = content.get('rosbag2_bagfile_information') if isinstance(content, dict) else None
    if not isinstance(about, dict):
        raise InputError(f'{path}: expected the key rosbag2_bagfile_information, found none')
    return about


def _open_file(path: Path, stack: ExitStack,
               columns: Mapping[str, str] | None = None) -> File:
    is_compressed = path.suffix in ('.zstd', '.zst')
    unpacked = unpack_file(path, temporary(stack)) if is_compressed else path
    with reported(path, 'read the recording'), open_file(unpacked, 'recording') as stream:
        if stream.read(len(_ROS1)) == _ROS1:
            raise InputError(f'{path}: expected MCAP or rosbag2, found a ROS 1 bag; convert it '
                             'with rosbags-convert --src IN.bag --dst OUT')
    if path.suffix.lower() == '.csv':
        return CsvFile(path, columns)
    if is_ulog(path):
        return UlogFile(path)
    return SqliteFile(path, unpacked, stack) if unpacked.suffix == '.db3' else \
        McapFile(path, unpacked)
