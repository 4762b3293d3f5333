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

"""Write an MCAP file from front to back: first the chunks and their indexes, then the summary."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
import struct
from typing import IO, NamedTuple
import zlib

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
import numpy as np
from numpy.typing import NDArray
import zstandard

#: The zstd level. Compression at level -3 is twice as fast as at level 1 and compresses doubles
#: nearly as well.
_LEVEL = -3
_INDEX = np.dtype([('time', '<u8'), ('offset', '<u8')])


class Indexed(NamedTuple):
    """The times and offsets of one channel's messages in a chunk."""

    channel: int
    times_ns: NDArray[np.int64]
    offsets: NDArray[np.int64]


class Container:
    """
    Write an MCAP file with the ROS 2 profile.

    Chunks are compressed in a second thread, so `add_chunk` returns before its chunk is
    compressed. The chunk is written and flushed at the beginning of the next call to `add_chunk`,
    `add_metadata` or `finish`.

    Attributes
    ----------
    channels : list of Channel
    chunks : list of ChunkIndex
        The chunks that have been written to the file.
    counts : dict
        The number of messages in each channel, by channel id.

    """

    def __init__(self, stream: IO[bytes], library: str) -> None:
        self._stream = stream
        self._position = 0
        #: The schemas, by their content, in the order of their numbers.
        self._schemas: dict[tuple[str, str, bytes], records.Schema] = {}
        self.channels: list[records.Channel] = []
        self.chunks: list[records.ChunkIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self.counts: dict[int, int] = {}
        self._compressor = ThreadPoolExecutor(1)
        self._compressed: Future[tuple[records.Chunk, list[Indexed]]] | None = None
        self._write(MCAP0_MAGIC)
        self._write(_record(records.Header('ros2', library)))

    def add_channel(self, topic: str, schema: records.Schema | None, metadata: dict[str, str],
                    encoding: str = 'cdr') -> int:
        """Add a topic, and its schema if the file does not have it yet; return the channel id."""
        schema_id = 0
        if schema:
            content = schema.name, schema.encoding, schema.data
            if content not in self._schemas:
                self._schemas[content] = replace(schema, id=len(self._schemas) + 1)
                self._write(_record(self._schemas[content]))
            schema_id = self._schemas[content].id
        channel = records.Channel(len(self.channels) + 1, topic, encoding, metadata, schema_id)
        self.channels.append(channel)
        self.counts[channel.id] = 0
        self._write(_record(channel))
        return channel.id

    def type_of(self, channel: records.Channel) -> str:
        """Return the message type of a channel, or '' if the channel has no schema."""
        return next((schema.name for schema in self._schemas.values()
                     if schema.id == channel.schema_id), '')

    def add_chunk(self, data: bytes, indexed: list[Indexed]) -> None:
        """Append a chunk of message records; `indexed` lists the chunk's messages by channel."""
        for channel, times_ns, _ in indexed:
            self.counts[channel] += len(times_ns)
        self._finish_chunk()
        self._compressed = self._compressor.submit(_compressed, data, indexed)

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """Append a metadata record."""
        self._finish_chunk()
        record = _record(records.Metadata(name, content))
        self._metadata.append(records.MetadataIndex(self._position, len(record), name))
        self._write(record)

    def finish(self) -> None:
        """Write the end of the file: index, statistics and footer."""
        self._finish_chunk()
        self._write(_record(records.DataEnd(data_section_crc=0)))
        first_ns, last_ns = self.span_ns
        statistics = records.Statistics(
            attachment_count=0, channel_count=len(self.channels),
            channel_message_counts=self.counts, chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()), metadata_count=len(self._metadata),
            message_start_time=first_ns, message_end_time=last_ns,
            schema_count=len(self._schemas))
        start, offsets = self._position, []
        for opcode, group in (
                (Opcode.SCHEMA, self._schemas.values()), (Opcode.CHANNEL, self.channels),
                (Opcode.STATISTICS, [statistics]), (Opcode.CHUNK_INDEX, self.chunks),
                (Opcode.METADATA_INDEX, self._metadata)):
            group_start = self._position
            for record in group:
                self._write(_record(record))
            if group:
                offsets.append(records.SummaryOffset(opcode, group_start,
                                                     self._position - group_start))
        offset_start = self._position
        for offset in offsets:
            self._write(_record(offset))
        self._write(_record(records.Footer(summary_start=start, summary_offset_start=offset_start,
                                           summary_crc=0)))
        self._write(MCAP0_MAGIC)
        self.close()

    def close(self) -> None:
        """Stop the thread that compresses chunks; a chunk that is not written yet is lost."""
        self._compressor.shutdown(cancel_futures=True)

    def _finish_chunk(self) -> None:
        if self._compressed is None:
            return
        chunk, indexed = self._compressed.result()
        self._compressed = None
        # Write the chunk and its index in one call. If the file gets cut off, this makes it
        # unlikely that the file ends between the chunk and its index.
        start, data = self._position, _record(chunk)
        length, index_offsets = len(data), {}
        for channel, times_ns, offsets in indexed:
            index_offsets[channel] = start + len(data)
            entries = np.empty(len(times_ns), _INDEX)
            entries['time'], entries['offset'] = times_ns, offsets
            data += struct.pack('<BQHI', Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel,
                                entries.nbytes) + entries.tobytes()
        self._write(data)
        self.chunks.append(records.ChunkIndex(
            chunk_length=length, chunk_start_offset=start, compression=chunk.compression,
            compressed_size=len(chunk.data), message_end_time=chunk.message_end_time,
            message_index_length=len(data) - length, message_index_offsets=index_offsets,
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size))
        self._stream.flush()

    @property
    def span_ns(self) -> tuple[int, int]:
        """Return the earliest and latest message times, ns; (0, 0) if there are no messages."""
        return (min((chunk.message_start_time for chunk in self.chunks), default=0),
                max((chunk.message_end_time for chunk in self.chunks), default=0))

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)


def _compressed(data: bytes, indexed: list[Indexed]) -> tuple[records.Chunk, list[Indexed]]:
    times = np.concatenate([part.times_ns for part in indexed])
    return records.Chunk(
        compression='zstd', data=zstandard.ZstdCompressor(_LEVEL).compress(data),
        message_start_time=int(times.min()), message_end_time=int(times.max()),
        uncompressed_crc=zlib.crc32(data), uncompressed_size=len(data)), indexed


def _record(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
