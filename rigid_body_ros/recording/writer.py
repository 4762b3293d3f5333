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

"""Write MCAP files that `ros2 bag play`, Foxglove and PlotJuggler can read."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
import struct
from types import TracebackType
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Schema
import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.container import Container, Indexed
from rigid_body_ros.runtime.files import FOLDER, Part, reported
import yaml

#: The topics on which a motion is recorded.
ATTITUDE, ANGULAR_VELOCITY = '/attitude', '/angular_velocity'
#: Messages are collected and written as a chunk once they reach this total size, bytes.
_CHUNK = 2 ** 20
#: How a message record starts: opcode, length, channel, sequence, log time, publish time.
_HEAD = struct.Struct('<BQHIQQ')
_HEAD_FIELDS = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'),
                         ('sequence', '<u4'), ('log', '<u8'), ('publish', '<u8')])
#: The QoS with which a player publishes: reliable, volatile, keep last 10. Policies are given as
#: numbers, because the rosbag2 of ROS 2 Humble cannot read their names; later versions read both.
_QOS = '\n'.join([
    '- history: 1', '  depth: 10', '  reliability: 1', '  durability: 2',
    '  deadline:', '    sec: 9223372036', '    nsec: 854775807',
    '  lifespan:', '    sec: 9223372036', '    nsec: 854775807',
    '  liveliness: 1',
    '  liveliness_lease_duration:', '    sec: 9223372036', '    nsec: 854775807',
    '  avoid_ros_namespace_conventions: false',
])
#: Format version of metadata.yaml. ROS 2 Humble cannot read newer versions.
_VERSION = 5


class Column(NamedTuple):
    """
    The messages on one topic, which all have the same frame_id.

    The array `values`, shape (n, d), holds the doubles of each message.
    """

    topic: str
    frame_id: str
    values: Floats
    child_frame_id: str = ''


class Writer:
    """
    Write an MCAP file; a context manager.

    The file gets its final name only when it is complete. If writing fails, an existing file with
    that name is left unchanged, and no partial file remains unless `keep_partial` is set.

    Parameters
    ----------
    path : str or Path
        The file to write.
    keep_partial : bool
        If writing fails or is interrupted, keep the chunks written so far in a new file whose name
        ends in `.partial.mcap`. The last argument of the KeyboardInterrupt, or the message of the
        InputError, names this file.

    Raises
    ------
    InputError
        The file cannot be written.

    """

    _suffix = '.mcap'

    def __init__(self, path: str | Path, keep_partial: bool = False) -> None:
        self._path = Path(path)
        self._keep_partial = keep_partial
        self._channels: dict[str, int] = {}
        self._kinds: dict[str, MessageType] = {}
        self._sequence: dict[str, int] = {}
        #: The messages for the next chunk: their records, and the channel, time and offset of each
        #: record.
        self._records = bytearray()
        self._waiting: list[tuple[int, int, int]] = []

    def __enter__(self) -> Writer:
        with reported(self._path):
            self._part = Part(self._path, self._suffix)
            self._file = self._file_of(self._part)
            try:
                self._stream = open(self._file, 'wb')
                self._container = Container(self._stream, 'rigid_body_ros')
            except OSError:
                self._part.discard()
                raise
        return self

    def _file_of(self, part: Part) -> Path:
        """Return the path of the MCAP file inside the temporary output."""
        return part.path

    def add_topic(self, topic: str, kind: MessageType) -> None:
        """Add a topic; call this once per topic, before you write its first message."""
        schema = Schema(id=0, name=kind.name, encoding='ros2msg', data=kind.definition.encode())
        self._channels[topic] = self._container.add_channel(
            topic, schema, {'offered_qos_profiles': _QOS, 'topic_type_hash': kind.type_hash})
        self._kinds[topic] = kind
        self._sequence[topic] = 0

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """Append a metadata record."""
        self._container.add_metadata(name, content)

    def write(self, topic: str, log_ns: int, data: bytes, publish_ns: int | None = None) -> None:
        """Append a CDR message to a topic; by default, it is published when it is logged."""
        channel = self._channels[topic]
        self._waiting.append((channel, log_ns, len(self._records)))
        self._records += _HEAD.pack(
            Opcode.MESSAGE, _HEAD.size - 9 + len(data), channel, self._sequence[topic] % 2 ** 32,
            log_ns, log_ns if publish_ns is None else publish_ns) + data
        self._sequence[topic] += 1
        if len(self._records) > _CHUNK:
            self._flush()

    def copy(self, channel: Channel, schema: Schema | None, raw: Raw) -> None:
        """Append messages that were read from another file, with the same channel and schema."""
        topic = channel.topic
        if topic not in self._channels:
            self._channels[topic] = self._container.add_channel(
                topic, schema, channel.metadata, channel.message_encoding)
            self._sequence[topic] = 0
        times_ns = zip(raw.log_ns.tolist(), raw.publish_ns.tolist())
        for row, (log_ns, publish_ns) in enumerate(times_ns):
            self.write(topic, log_ns, raw.message(row), publish_ns)

    def write_columns(self, stamps_ns: NDArray[np.int64], columns: Sequence[Column],
                      delay_ns: int = 0) -> None:
        """
        Append one message from each column at every stamp, ns.

        The log time and publish time of a message are `delay_ns` later than its stamp.
        """
        self._flush()
        messages = [self._kinds[column.topic].layout(column.frame_id, column.child_frame_id)
                    for column in columns]
        fields = [(str(k), np.dtype([('head', _HEAD_FIELDS), ('message', message)]))
                  for k, message in enumerate(messages)]
        layout = np.dtype(fields)
        step = max(1, _CHUNK // layout.itemsize)
        for first in range(0, len(stamps_ns), step):
            block = slice(first, first + step)
            part_ns = stamps_ns[block]
            logged_ns = part_ns + delay_ns
            rows = np.empty(len(part_ns), layout)
            indexed, position = [], 0
            for (name, field), column in zip(fields, columns):
                self._fill(rows[name], part_ns, logged_ns, column, column.values[block])
                offsets = position + np.arange(len(part_ns)) * layout.itemsize
                indexed.append(Indexed(self._channels[column.topic], logged_ns, offsets))
                position += field.itemsize
            self._container.add_chunk(rows.tobytes(), indexed)

    def _fill(self, rows: NDArray[np.void], stamps_ns: NDArray[np.int64],
              times_ns: NDArray[np.int64], column: Column, values: Floats) -> None:
        head, message = rows['head'], rows['message']
        first = self._sequence[column.topic]
        self._sequence[column.topic] += len(times_ns)
        head['opcode'] = Opcode.MESSAGE
        head['length'] = rows.dtype.itemsize - 9
        head['channel'] = self._channels[column.topic]
        head['sequence'] = np.arange(first, first + len(times_ns))
        head['log'] = head['publish'] = times_ns
        self._kinds[column.topic].fill(message, stamps_ns, values, column.frame_id,
                                       column.child_frame_id)

    def _flush(self) -> None:
        if self._waiting:
            waiting = np.array(self._waiting)
            indexed = [Indexed(channel, *waiting[waiting[:, 0] == channel, 1:].T)
                       for channel in np.unique(waiting[:, 0]).tolist()]
            self._container.add_chunk(bytes(self._records), indexed)
            self._records.clear()
            self._waiting.clear()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        failure: OSError | InputError | None = error if isinstance(error, OSError) else None
        kept = ''
        try:
            if error is None:
                self._finish()
                self._part.complete()
        except (OSError, InputError) as failed:
            failure = failed
        finally:
            self._container.close()
            with suppress(OSError):  # closing flushes, which fails again if the disk is full
                self._stream.close()
            if failure or isinstance(error, KeyboardInterrupt):
                kept = self._kept_partial()
            self._part.discard()
        if isinstance(error, KeyboardInterrupt) and kept:
            error.args += (kept,)
        if isinstance(failure, OSError):
            raise InputError(f'{self._path}: cannot write: {failure.strerror}{kept}') from failure
        if failure:
            raise InputError(f'{failure}{kept}') from failure

    def _finish(self) -> None:
        """Write the remaining messages and the end of the file, and close it."""
        self._flush()
        self._container.finish()
        self._stream.close()

    def _kept_partial(self) -> str:
        if self._keep_partial and self._container.chunks:
            with suppress(OSError):
                return f'; what was written so far is in {self._part.keep(self._file, ".mcap")}'
        return ''


class FolderWriter(Writer):
    """
    Write a rosbag2 bag: a folder that contains an MCAP file and metadata.yaml.

    The methods and parameters are the same as for `Writer`, except that `path` is the folder.

    Raises
    ------
    InputError
        A file or folder with that name already exists, or the folder cannot be written.

    """

    _suffix = FOLDER

    def _file_of(self, part: Part) -> Path:
        return part.path / f'{part.target.name}_0.mcap'

    def _finish(self) -> None:
        super()._finish()
        text = yaml.safe_dump({'rosbag2_bagfile_information': self._about()}, sort_keys=False)
        self._file.with_name('metadata.yaml').write_text(text, encoding='utf-8')

    def _about(self) -> dict[str, Any]:
        counts, first_ns, last_ns = self._container.counts, *self._container.span_ns
        span = {'starting_time': {'nanoseconds_since_epoch': first_ns},
                'duration': {'nanoseconds': last_ns - first_ns},
                'message_count': sum(counts.values())}
        name = self._file.name
        return {
            'version': _VERSION, 'storage_identifier': 'mcap', **span,
            'topics_with_message_count': [
                {'topic_metadata': {'name': channel.topic,
                                    'type': self._container.type_of(channel),
                                    'serialization_format': channel.message_encoding,
                                    'offered_qos_profiles':
                                        channel.metadata.get('offered_qos_profiles', '')},
                 'message_count': counts[channel.id]}
                for channel in self._container.channels],
            'compression_format': '', 'compression_mode': '', 'relative_file_paths': [name],
            'files': [{'path': name, **span}],
        }


def suffix_of(output: str | Path) -> str:
    """Return the format of an output: '.mcap', or `files.FOLDER` for a rosbag2 folder."""
    name = Path(output).name.lower()  # ignore case, like rosbag2
    return '.mcap' if name.endswith('.mcap') else FOLDER


def writer_of(output: str | Path) -> Writer:
    """Return a writer for an output, in the format that its name implies."""
    kind = FolderWriter if suffix_of(output) == FOLDER else Writer
    return kind(output, keep_partial=True)
