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

"""Read MCAP files in blocks, from front to back, up to the end or the first damaged record."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from io import BytesIO
import os
from pathlib import Path
import struct
from typing import IO
import zlib

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema, Statistics
from mcap.stream_reader import MAGIC_SIZE, StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC
import numpy as np
from rigid_body_ros.common.errors import InputError, listed, quoted, reason
from rigid_body_ros.engine import kernels
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import Bytes, Ints, Raw
from rigid_body_ros.recording.file import File, full_name
from rigid_body_ros.recording.unpack import LARGEST, unpack
from rigid_body_ros.runtime.limits import open_file
import zstandard

#: Records outside chunks are collected until their total size exceeds this number of bytes. The
#: collected records are then passed on as one block.
_BLOCK = 2 ** 20
_RECORD = struct.Struct('<BQ')
#: The types of the records that must be read to find and decode messages.
_MESSAGES = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
#: Total size, in bytes, of the footer and the magic bytes after it.
_ENDING = 37


class DamageError(Exception):
    """Raised if the rest of the file cannot be read."""


class McapFile(File):
    """
    An MCAP file.

    If the summary is missing or unusable, the whole file is scanned to find the topics.
    """

    def __init__(self, path: Path, unpacked: Path | None = None) -> None:
        super().__init__(path, unpacked)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        try:
            with open_file(self._content, 'recording') as stream:
                self._size = os.fstat(stream.fileno()).st_size
                begin = stream.read(MAGIC_SIZE)
                if begin != MCAP0_MAGIC:
                    content = f'another format, which begins with {quoted(begin)}' if begin else \
                        'an empty file'
                    raise InputError(f'{path}: expected an MCAP file, found {content}')
                summary = _summary(stream)
        except OSError as error:
            raise InputError(f'{path}: cannot read the recording: {reason(error)}') from error
        if summary is None:
            for _ in self._blocks():
                pass
            if self.damage and not self._channels:
                raise InputError(f'{path}: expected an MCAP file with messages, found none '
                                 f'({self.damage})')
        else:
            self._schemas, self._channels = summary.schemas, summary.channels
            self._counts = dict(summary.statistics.channel_message_counts) \
                if summary.statistics else {}
        self.types = {channel.topic: full_name(self._schemas[channel.schema_id].name)
                      if channel.schema_id in self._schemas else ''
                      for channel in self._channels.values()}

    def metadata(self, name: str) -> dict[str, str]:
        """Return the last metadata record called `name`, or {} if there is none."""
        content: dict[str, str] = {}
        with suppress(DamageError), open_file(self._content, 'recording') as stream:
            stream.seek(MAGIC_SIZE)
            for offset, _, record in self._records(stream, (Opcode.METADATA,)):
                try:
                    metadata = Metadata.read(_stream(record))
                except Exception as error:  # damaged bytes make mcap raise a dozen types of errors
                    raise InputError(f'{self.path}: damaged metadata record at byte {offset} '
                                     f'({reason(error)})') from error
                if metadata.name == name:
                    content = metadata.metadata
        return content

    def count(self, topic: str) -> int:
        """Return the number of messages on a topic."""
        return sum(self._counts.get(number, 0) for number, channel in self._channels.items()
                   if channel.topic == topic)

    def read(self, topic: str, kind: MessageType) -> Iterator[Raw]:
        """Generate the messages of a topic in blocks; see `File.read`."""
        for numbers, messages in self._blocks():
            channels = [channel for channel in self._channels.values() if channel.topic == topic]
            for channel in channels:
                if channel.message_encoding != 'cdr':
                    raise InputError(f'{self.path}: {topic}: expected message encoding cdr, '
                                     f'found {quoted(channel.message_encoding)}')
                if schema := self._schemas.get(channel.schema_id):
                    self._check_definition(topic, kind, schema.name, schema.encoding, schema.data)
            rows = np.flatnonzero(np.isin(numbers, [channel.id for channel in channels]))
            if rows.size:
                yield messages.rows(rows)

    def read_all(self) -> Iterator[tuple[Channel, Schema | None, Raw]]:
        """Generate blocks of messages from all topics, each with its channel and its schema."""
        for numbers, messages in self._blocks():
            for number in np.unique(numbers).tolist():
                channel = self._channels[number]
                yield (channel, self._schemas.get(channel.schema_id),
                       messages.rows(np.flatnonzero(numbers == number)))

    def _blocks(self) -> Iterator[tuple[Ints, Raw]]:
        # Generate blocks of messages, each with the numbers of their channels.
        self.damage, self._counts, count = '', {}, 0
        try:
            with open_file(self._content, 'recording') as stream:
                self._size = os.fstat(stream.fileno()).st_size  # a recorder may still be writing
                stream.seek(MAGIC_SIZE)
                for offset, data in self._record_blocks(stream):
                    numbers, messages = self._scan(offset, data)
                    count += len(numbers)
                    yield numbers, messages
                stream.seek(-MAGIC_SIZE, os.SEEK_END)
                if stream.read() != MCAP0_MAGIC:
                    self.damage = 'cut off after the last message; no message is lost'
        except DamageError as error:
            self.damage = f'{error}; {count} messages (all topics) before it were read'
        except OSError as error:
            raise InputError(f'{self.path}: cannot read the recording: '
                             f'{reason(error)}') from error

    def _record_blocks(self, stream: IO[bytes]) -> Iterator[tuple[int, Bytes]]:
        # Generate the offset and the records of each chunk, and of each run of records outside
        # chunks.
        loose, begin, damage = bytearray(), 0, None
        try:
            for offset, opcode, record in self._records(stream):
                is_chunk = opcode == Opcode.CHUNK
                if loose and (is_chunk or len(loose) > _BLOCK):
                    yield begin, np.frombuffer(bytes(loose), np.uint8)
                    loose.clear()
                if is_chunk:
                    yield offset, _decompressed(offset, record)
                else:
                    begin = begin if loose else offset
                    loose += _RECORD.pack(opcode, len(record)) + record
        except DamageError as error:
            damage = error
        if loose:
            yield begin, np.frombuffer(bytes(loose), np.uint8)
        if damage:
            raise damage

    def _records(self, stream: IO[bytes],
                 wanted: Collection[int] = _MESSAGES) -> Iterator[tuple[int, int, bytes]]:
        # Generate the offset, opcode and content of every record whose opcode is in `wanted`.
        offset = MAGIC_SIZE
        while True:
            if offset + _RECORD.size > self._size:
                raise DamageError(f'cut off at byte {offset}')
            opcode, length = _RECORD.unpack(stream.read(_RECORD.size))
            if opcode == Opcode.DATA_END:
                return
            if opcode == 0:
                raise DamageError(f'damaged at byte {offset}: no record starts there')
            if length > self._size - offset - _RECORD.size:
                raise DamageError(f'cut off or damaged at byte {offset}: expected a record of '
                                  f'{length} bytes, found {self._size - offset - _RECORD.size}')
            if opcode in wanted:
                if length > LARGEST:
                    raise DamageError(f'damaged at byte {offset}: expected a record of at most '
                                      f'{LARGEST} bytes, found {length}')
                yield offset, opcode, stream.read(length)
            else:
                stream.seek(length, os.SEEK_CUR)
            offset += _RECORD.size + length

    def _scan(self, offset: int, data: Bytes) -> tuple[Ints, Raw]:
        columns = np.empty((5, len(data) // 31 + 1), np.int64)
        position = count = 0
        while position < len(data):
            position, count = kernels.scan(data, position, count, columns)
            if position < len(data):
                position = self._register(offset, data, position)
        channels, log_ns, publish_ns, starts, sizes = columns[:, :count]
        numbers, counts = np.unique(channels, return_counts=True)
        unknown = set(numbers.tolist()) - self._channels.keys()
        if unknown:
            raise DamageError(f'damaged at byte {offset}: messages of unknown channels: '
                              f'{listed([*map(str, sorted(unknown))])}')
        for number, more in zip(numbers.tolist(), counts.tolist()):
            self._counts[number] = self._counts.get(number, 0) + more
        return channels, Raw(data, starts, sizes, log_ns, publish_ns)

    def _register(self, offset: int, data: Bytes, position: int) -> int:
        # Store a schema or channel record, and return the position where the record ends.
        if position + _RECORD.size > len(data):
            raise DamageError(f'damaged at byte {offset}: incomplete record')
        opcode, length = _RECORD.unpack(data[position:position + _RECORD.size].tobytes())
        position += _RECORD.size
        if length > len(data) - position or opcode in (0, Opcode.MESSAGE):
            raise DamageError(f'damaged at byte {offset}: invalid record of {length} bytes')
        content = _stream(data[position:position + length].tobytes())
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(content)
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(content)
                self._channels[channel.id] = channel
        except Exception as error:  # damaged bytes make mcap raise a dozen types of errors
            raise DamageError(f'damaged at byte {offset}: {reason(error)}') from error
        return position + length


def _stream(record: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(record))


def _decompressed(offset: int, record: bytes) -> Bytes:
    try:
        chunk = Chunk.read(_stream(record))
        size = chunk.uncompressed_size
        if size > LARGEST:
            raise ValueError(f'expected at most {LARGEST} bytes, found {size}')
        data = chunk.data
        if chunk.compression == 'zstd':
            data = unpack(data, size, zstandard.ZstdDecompressor())
        elif chunk.compression == 'lz4':
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
        elif chunk.compression:
            raise ValueError(f'unknown compression {quoted(chunk.compression)}')
        if len(data) != size:
            raise ValueError(f'expected {size} bytes, found {len(data)}')
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise ValueError('wrong checksum')
        return np.frombuffer(data, np.uint8)
    except Exception as error:  # from mcap, zstandard or lz4
        raise DamageError(f'damaged chunk at byte {offset} ({reason(error)})') from error


def _summary(stream: IO[bytes]) -> Summary | None:
    # Parse the summary in memory, so that mcap cannot allocate more memory than the size of the
    # file, even if a length in the summary is wrong.
    try:
        end = stream.seek(-_ENDING, os.SEEK_END)
        _, _, start, _, _, magic = struct.unpack('<BQQQI8s', stream.read())
        if not 0 < end - start < LARGEST:
            return None
        stream.seek(start)
        content = BytesIO(stream.read())
        summary = Summary()
        # emit_chunks keeps mcap from decompressing the chunks, whose content could have any size.
        for record in StreamReader(content, skip_magic=True, emit_chunks=True).records:
            if isinstance(record, Schema):
                summary.schemas[record.id] = record
            elif isinstance(record, Channel):
                summary.channels[record.id] = record
            elif isinstance(record, Statistics):
                summary.statistics = record
    except Exception:  # the summary is cut off or damaged, so `McapFile` scans the file
        return None
    return summary if start and summary.channels and magic == MCAP0_MAGIC else None
