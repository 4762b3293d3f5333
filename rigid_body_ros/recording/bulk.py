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
Decode many messages at once, from bytes to arrays.

A compiled loop decodes the messages, a hundred times faster than Python. A message that it cannot
decode is passed to `MessageType.decode`, which raises an error with the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels.jit import inlined, njit
from rigid_body_ros.messages import MessageType

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

#: Most bytes with which middleware pads the end of a message.
_PADDING = 3


class BadMessageError(ValueError):
    """A message does not match its type; `row` is its index."""

    def __init__(self, row: int, reason: str) -> None:
        super().__init__(reason)
        self.row = row


class Raw(NamedTuple):
    """
    Messages of one topic as bytes.

    Attributes
    ----------
    data : array of uint8, shape (size,)
    starts, sizes : array of int64, shape (n,)
        Position and size of each message in the data.
    log_ns, publish_ns : array of int64, shape (n,)
        Times at which each message was recorded and published.

    """

    data: Bytes
    starts: Ints
    sizes: Ints
    log_ns: Ints
    publish_ns: Ints

    @classmethod
    def from_bytes(cls, messages: Sequence[bytes], log_ns: Ints,
                   publish_ns: Ints) -> Raw:
        """Concatenate separate messages."""
        sizes = np.array([len(message) for message in messages], np.int64)
        return cls(np.frombuffer(b''.join(messages), np.uint8), np.cumsum(sizes) - sizes, sizes,
                   log_ns, publish_ns)

    def message(self, row: int) -> bytes:
        """Return the bytes of one message."""
        return self.data[self.starts[row]:self.starts[row] + self.sizes[row]].tobytes()


class Decoded(NamedTuple):
    """
    The contents of messages of one topic.

    Attributes
    ----------
    stamps_ns : array of int64, shape (n,)
        Zero if the type has no header.
    frames : array of int, shape (n,)
        Index into `names` for each message.
    names : list of str
        The distinct frame_ids.
    values : array, shape (n, doubles)
        The doubles of each message in field order.
    longer : int
        Number of messages with bytes after the last field, other than padding.

    """

    stamps_ns: Ints
    frames: NDArray[np.intp]
    names: list[str]
    values: Floats
    longer: int = 0


def decode(kind: MessageType, raw: Raw) -> Decoded:
    """Return the contents of messages; raise BadMessageError at the first invalid one."""
    count = len(raw.starts)
    stamps, bits = np.zeros(count, np.int64), np.empty((count, kind.doubles), np.int64)
    texts, changes = np.zeros((count, 2), np.int64), np.zeros(count, np.bool_)
    after = np.zeros(count, np.int64)
    done = _decode(raw.data, raw.starts, raw.sizes, kind.has_header, kind.is_list,
                   kind.has_child_frame, len(kind.before_doubles), stamps, bits, texts, changes,
                   after)
    names: dict[str, int] = {}
    codes = np.zeros(count, np.intp)
    rows = np.flatnonzero(changes[:done])
    try:
        for row, end in zip(rows.tolist(), [*rows[1:].tolist(), done]):
            start, size = texts[row].tolist()
            name = str(raw.data[start:start + size].tobytes(), 'utf-8')
            codes[row:end] = names.setdefault(name, len(names))
        if done < count:
            row = done
            kind.decode(raw.message(row))
            raise ValueError(f'expected a {kind.name} in CDR, found undecodable bytes')
    except ValueError as error:
        raise BadMessageError(row, str(error)) from error
    longer = int(np.sum(after > len(kind.after_doubles) + _PADDING))
    return Decoded(stamps, codes, [*names], bits.view(np.float64), longer)


@njit
def _decode(data: Bytes, starts: Ints, sizes: Ints, has_header: bool, is_list: bool,
            has_child_frame: bool, before_doubles: int, stamps: Ints, bits: Ints, texts: Ints,
            changes: NDArray[np.bool_], after: Ints) -> int:
    # Fill `stamps`, `bits` (of the doubles), `texts` (start and size of each frame_id),
    # `changes` (whether the frame_id differs from the previous one), and `after` (bytes after the
    # doubles). Return the number of valid messages before the first invalid one.
    for row in range(len(starts)):
        start, end = starts[row], starts[row] + sizes[row]
        if sizes[row] < 4 or data[start] != 0 or data[start + 1] > 1:
            return row
        little, body = data[start + 1] == 1, start + 4
        offset = body
        if is_list:
            if offset + 4 > end or integer(data, offset, 4, little) != 1:
                return row
            offset += 4
        if has_header:
            if offset + 8 > end:
                return row
            seconds, rest = integer(data, offset, 4, little), integer(data, offset + 4, 4, little)
            if seconds >= 2 ** 31 or rest >= 10 ** 9:
                return row
            stamps[row] = seconds * 10 ** 9 + rest
            offset += 8
            for text in range(2 if has_child_frame else 1):
                offset += (body - offset) % 4
                size = integer(data, offset, 4, little) if offset + 4 <= end else 0
                if size < 1 or size > end - offset - 4:
                    return row
                if text == 0:
                    texts[row, 0], texts[row, 1] = offset + 4, size - 1
                    changes[row] = row == 0 or not _same_text(data, texts[row - 1], texts[row])
                offset += 4 + size
            offset += (body - offset) % 4 + before_doubles
            offset += (body - offset) % 8
        elif row == 0:
            changes[row] = True
        if offset + 8 * bits.shape[1] > end:
            return row
        for k in range(bits.shape[1]):
            bits[row, k] = integer(data, offset + 8 * k, 8, little)
        after[row] = end - offset - 8 * bits.shape[1]
    return len(starts)


@inlined
def integer(data: Bytes, start: int, size: int, little: bool) -> Any:
    """Return an integer, little or big endian; eight bytes are signed, fewer are unsigned."""
    value = np.int64(0)
    for k in range(size):
        place = size - 1 - k if little else k
        value = value << np.int64(8) | np.int64(data[start + place])
    return value


@inlined
def _same_text(data: Bytes, one: Ints, other: Ints) -> bool:
    # Compare two texts, each given by its start and size.
    if one[1] != other[1]:
        return False
    for k in range(one[1]):
        if data[one[0] + k] != data[other[0] + k]:
            return False
    return True


@njit
def scan(data: Bytes, position: int, count: int, channels: Ints, log_ns: Ints, publish_ns: Ints,
         starts: Ints, sizes: Ints) -> tuple[int, int]:
    """
    Find the messages in MCAP records, up to the first record that is not a message.

    Parameters
    ----------
    data : array of uint8, shape (size,)
        Consecutive records, as in a decompressed chunk.
    position, count : int
        Where to start in the data, and how many messages were found before.
    channels, log_ns, publish_ns, starts, sizes : array of int64
        Outputs, filled from index `count` on.

    Returns
    -------
    position, count : int
        Where the scan stopped, and how many messages have been found so far.

    """
    end = len(data)
    while position + 31 <= end and data[position] == 5:  # a message with all its fields
        length = integer(data, position + 1, 8, True)
        if length < 22 or length > end - position - 9:
            break
        channels[count] = integer(data, position + 9, 2, True)
        log_ns[count] = integer(data, position + 15, 8, True)
        publish_ns[count] = integer(data, position + 23, 8, True)
        starts[count], sizes[count] = position + 31, length - 22
        position += 9 + length
        count += 1
    return position, count
