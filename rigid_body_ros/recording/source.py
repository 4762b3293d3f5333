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

"""A topic of a recording of any kind, message by message or block by block."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
import os
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted, reason, shortened
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording import bulk
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.csv_file import CsvFile
from rigid_body_ros.recording.file import File
from rigid_body_ros.recording.mcap_file import McapFile
from rigid_body_ros.recording.sqlite_file import SqliteFile
from rigid_body_ros.recording.unpack import LARGEST, temporary, unpack, unpack_file
from rigid_body_ros.recording.writer import Writer
from rigid_body_ros.runtime.reading import read_yaml
import yaml
from yaml.constructor import BaseConstructor
import zstandard

#: Where the time of a message is taken from.
TIME_SOURCES = ('header', 'log', 'publish')
#: What torques come as.
TORQUES = (messages.WRENCH, messages.BARE_WRENCH)
#: Wraps an iterable of blocks of messages, so many in all, to show progress.
Track = Callable[[Iterable[Any], int], Iterable[Any]]


@dataclass(frozen=True, eq=False)
class Messages:
    """
    Messages of a topic, in the order of the recording.

    Attributes
    ----------
    topic : str
    stamps_ns : array of int64, shape (n,)
        From the headers, unless another source of time was asked for or there are none.
    frames : array of int, shape (n,)
        Indices of `names`.
    names : list of str
        The frame_ids.
    values : array, shape (n, d)
        The doubles of each message in field order.
    damage : str
        What was lost and where; '' if nothing.

    """

    topic: str
    stamps_ns: NDArray[np.int64]
    frames: NDArray[np.intp]
    names: list[str]
    values: Floats
    damage: str = ''

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def rows(self, chosen: NDArray[np.bool_]) -> Messages:
        """Return some of the messages."""
        return replace(self, stamps_ns=self.stamps_ns[chosen], frames=self.frames[chosen],
                       values=self.values[chosen])

    @property
    def frame_ids(self) -> list[str]:
        """Return the frame_id of each message."""
        return [self.names[code] for code in self.frames.tolist()]


class Source:
    """
    A topic of a recording; as a context manager, and iterated for blocks of `Messages`.

    Parameters
    ----------
    path : str or Path
        An MCAP file, a SQLite file of rosbag2, a folder of either with metadata.yaml, or a CSV
        file whose first line names time and torques, or of time (s), tx, ty, tz (N m).
    topic : str, optional
        May be left out where only one topic has one of the types.
    kinds : sequence of MessageType
    time_source : str
        'header', 'log' or 'publish'.
    skip : float, s
        Leave out messages from before this long after the first.

    Attributes
    ----------
    topic : str
    kind : MessageType
    types : dict
        The type of each topic of the recording.
    count : int
        Messages of the topic, as far as the files tell.
    damage : str
        What was lost and where, once the messages were read; '' if nothing.

    Raises
    ------
    InputError
        The recording cannot be read, has no such topic, one of another type, or several that
        are meant, or, when iterated, a message is not what its type says.

    """

    def __init__(self, path: str | Path, topic: str | None, kinds: Sequence[MessageType],
                 time_source: str = 'header', skip: float = 0.0) -> None:
        self._path = path
        self._skip_ns = round(skip * 1e9)
        self._time_source = time_source
        self._stack = ExitStack()
        with ExitStack() as stack:
            self._files, self._packed, self._lost = _files(Path(path), stack)
            self.types = {name: kind for file in self._files for name, kind in file.types.items()}
            self.topic, self.kind = _chosen(path, self.types, topic, kinds)
            self._stack = stack.pop_all()
        self._holders = [file for file in self._files if self.topic in file.types]
        self.count = sum(file.count(self.topic) for file in self._holders)

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def damage(self) -> str:
        """Return what was lost, and where; '' if nothing was."""
        found = [f'{file.path}: {file.damage}' for file in self._files if file.damage]
        return shortened('; '.join([*found, *filter(None, [self._lost])]))

    def metadata(self, name: str) -> dict[str, str]:
        """Return what the recording says under a name, or nothing."""
        return {key: value for file in self._files for key, value in file.metadata(name).items()}

    def check_copied(self, topics: Collection[str]) -> None:
        """Raise InputError where `copy_to` cannot be, into a file that has these topics."""
        for file in self._files:
            if not isinstance(file, McapFile):
                raise InputError(f'{file.path}: expected MCAP to copy messages from')
        twice = sorted(self.types.keys() & set(topics))
        if twice:
            raise InputError(f'{self._path}: expected other topics in the recording to copy than '
                             f'those written, found {listed(twice)}')

    def copy_to(self, writer: Writer) -> None:
        """Write every message of the recording, byte for byte."""
        numbers: dict[str, int] = {}
        for file in self._files:
            assert isinstance(file, McapFile)  # checked before
            for channel, schema, raw in file.read_all():
                number = numbers.get(channel.topic, 0)
                writer.copy(channel, schema, self._plain(raw, channel.topic, number))
                numbers[channel.topic] = number + len(raw.starts)

    def __iter__(self) -> Iterator[Messages]:
        number, first_ns = 0, None
        for file in self._holders:
            for raw in file.read(self.topic):
                block = self._messages(raw, number)
                number += len(raw.starts)
                first_ns = int(block.stamps_ns.min()) if first_ns is None else first_ns
                rows = block.stamps_ns >= first_ns + self._skip_ns
                if not self._skip_ns or rows.all():
                    yield block
                elif rows.any():
                    yield block.rows(rows)
            if file.damage:
                return

    def _messages(self, raw: Raw, number: int) -> Messages:
        plain = self._plain(raw, self.topic, number)
        try:
            decoded = bulk.decode(self.kind, plain)
        except bulk.BadMessageError as error:
            raise self._refusal(error, self.topic, number) from error
        stamps = decoded.stamps_ns
        if self._time_source == 'publish':
            stamps = raw.publish_ns
        elif self._time_source == 'log' or not self.kind.has_header:
            stamps = raw.log_ns
        return Messages(self.topic, stamps, decoded.frames, decoded.names, decoded.values)

    def _plain(self, raw: Raw, topic: str, number: int) -> Raw:
        """Return messages of a topic, of which so many came before, as they were published."""
        try:
            return _unpacked_each(raw) if self._packed else raw
        except bulk.BadMessageError as error:
            raise self._refusal(error, topic, number) from error

    def _refusal(self, error: bulk.BadMessageError, topic: str, number: int) -> InputError:
        return InputError(f'{self._path}: {topic}: message {number + error.row + 1}: {error}')


def read(path: str | Path, topic: str | None = None, kind: MessageType | None = None,
         track: Track = lambda items, total: items, time_source: str = 'header') -> Messages:
    """
    Read the messages of a topic.

    Parameters
    ----------
    path : str or Path
        A recording, see `Source`.
    topic : str, optional
        May be left out where only one topic has the type.
    kind : MessageType, optional
        Torques are looked for otherwise.
    track : callable, optional
        Wraps the iteration over blocks of messages, to show progress.
    time_source : str
        Where stamps are taken from: 'header', 'log' or 'publish'.

    Raises
    ------
    InputError
        The recording cannot be read, has no such topic, one of another type, or several that
        are meant, or a message is not what its type says.

    """
    with Source(path, topic, TORQUES if kind is None else (kind,), time_source) as source:
        return joined(source.topic, source.kind, list(track(source, source.count)), source.damage)


def joined(topic: str, kind: MessageType, blocks: list[Messages], damage: str) -> Messages:
    """Return the messages of blocks as one."""
    names: dict[str, int] = {}
    frames = [np.array([names.setdefault(name, len(names)) for name in block.names],
                       np.intp)[block.frames] for block in blocks]
    return Messages(
        topic,
        np.concatenate([np.empty(0, np.int64), *(block.stamps_ns for block in blocks)]),
        np.concatenate([np.empty(0, np.intp), *frames]), [*names],
        np.concatenate([np.empty((0, kind.doubles)), *(block.values for block in blocks)]),
        damage)


def _chosen(path: str | Path, types: dict[str, str], topic: str | None,
            kinds: Sequence[MessageType]) -> tuple[str, MessageType]:
    by_name = {kind.name: kind for kind in kinds}
    expected = ' or '.join(by_name)
    fitting = [name for name, kind in types.items() if kind in by_name]
    if topic is None:
        if len(fitting) != 1:
            raise InputError(f'{path}: expected one topic of {expected}, or the name of one '
                             f'with --topic; found {listed(fitting)}')
        topic = fitting[0]
    if topic not in types:
        raise InputError(f'{path}: no topic {shortened(topic, 100)}; found {listed(types)}')
    if topic not in fitting:
        raise InputError(f'{path}: {shortened(topic, 100)}: expected {expected}, '
                         f'found {shortened(types[topic], 100) or "no type"}')
    return topic, by_name[types[topic]]


def _files(path: Path, stack: ExitStack) -> tuple[list[File], bool, str]:
    # The files, whether each message is compressed by itself, and why the last ones are missing.
    if not os.path.isdir(path):  # of a Path the question fails where the name is too long
        return [_file(path, stack)], False, ''
    about = _metadata(path / 'metadata.yaml')
    packed = str(about.get('compression_mode', '')).lower() == 'message'
    files: list[File] = []
    for place in _places(path, about.get('relative_file_paths')):
        try:
            files.append(_file(place, stack))
        except InputError as error:
            if not files:
                raise
            return files, packed, f'{error}; the files before it are used'
    return files, packed, ''


def _places(folder: Path, names: object) -> list[Path]:
    """Return the files of a bag, which lie in its folder."""
    where = f'{folder}/metadata.yaml: relative_file_paths'
    if not names or not isinstance(names, list):
        raise InputError(f'{where}: expected names of files, found {quoted(names)}')
    home = os.path.realpath(folder)
    places: dict[str, Path] = {}
    for name in names:
        if not isinstance(name, str) or '\0' in name or not PurePath(name).name:
            raise InputError(f'{where}: expected names of files, found {quoted(name)}')
        path = PurePath(name)
        if path.name in places:
            raise InputError(f'{where}: expected each file once, found {quoted(name)} twice')
        # Early rosbag2 put the name of the folder before that of the file.
        place = places[path.name] = folder / path.name
        if path.is_absolute() or '..' in path.parts \
                or os.path.dirname(os.path.realpath(place)) != home:
            raise InputError(f'{where}: expected files in the folder of the bag, '
                             f'found {quoted(name)}')
    return [*places.values()]


def _metadata(path: Path) -> dict[str, Any]:
    if not os.path.lexists(path):
        raise InputError(f'{path}: not found, and without it a folder is not a recording')
    root = read_yaml(path, 'description of the recording', aliases=True)
    try:
        found = BaseConstructor().construct_document(root) if root else None
    except yaml.YAMLError as error:  # a group as a key
        raise InputError(f'{path}: expected names as keys: {reason(error)}') from error
    about = found.get('rosbag2_bagfile_information') if isinstance(found, dict) else None
    if not isinstance(about, dict):
        raise InputError(f'{path}: expected rosbag2_bagfile_information, found none')
    return about


def _file(path: Path, stack: ExitStack) -> File:
    if path.suffix.lower() == '.csv':
        return CsvFile(path)
    is_packed = path.suffix in ('.zstd', '.zst')
    unpacked = unpack_file(path, temporary(stack)) if is_packed else path
    return SqliteFile(path, unpacked, stack) if unpacked.suffix == '.db3' else \
        McapFile(path, unpacked)


def _unpacked_each(raw: Raw) -> Raw:
    messages, room, unpacker = [], LARGEST, zstandard.ZstdDecompressor()
    for row in range(len(raw.starts)):
        try:
            messages.append(unpack(raw.message(row), room, unpacker))
        except (zstandard.ZstdError, ValueError) as error:
            raise bulk.BadMessageError(row, f'cannot unpack: {reason(error)}') from error
        room -= len(messages[-1])
    return Raw.of(messages, raw.log_ns, raw.publish_ns)
