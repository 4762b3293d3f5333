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

"""Decode serialized messages into arrays, and find the messages in MCAP records."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Ints
from rigid_body_ros.kernels.jit import inlined, njit, WRITTEN

Bytes = NDArray[np.uint8]


class RawMessages(NamedTuple):
    """Serialized messages, and where to find each of them in the data."""

    data: Annotated[Bytes, 's']
    #: The position and the size of each message in the data, in bytes.
    starts: Annotated[Ints, 'n']
    sizes: Annotated[Ints, 'n']


class Contents(NamedTuple):
    """The decoded contents of messages."""

    #: The stamp of each message, ns. The caller sets all stamps to zero beforehand.
    stamps: Annotated[Ints, 'n', WRITTEN]
    #: The bits of the doubles in each message, stored as integers.
    bits: Annotated[Ints, 'n d', WRITTEN]
    #: The position and the size of each frame_id in the data, in bytes.
    texts: Annotated[Ints, 'n 2', WRITTEN]
    #: Whether the frame_id of each message differs from that of the previous message. The caller
    #: sets all elements to False beforehand.
    changes: Annotated[NDArray[np.bool_], 'n', WRITTEN]
    #: The number of bytes that follow the doubles in each message.
    after: Annotated[Ints, 'n', WRITTEN]


@njit
def decode(messages: RawMessages, has_header: bool, is_list: bool, has_child_frame: bool,
           before_doubles: int, contents: Contents) -> int:
    """
    Decode messages that are serialized in CDR.

    Parameters
    ----------
    messages : RawMessages
        Messages of one type.
    has_header, is_list, has_child_frame, before_doubles : bool, bool, bool, int
        The attributes of the `MessageType`, except that `before_doubles` is given as a number of
        bytes.
    contents : Contents
        The output.

    Returns
    -------
    int
        The number of messages decoded before the first invalid message.

    """
    data, starts, sizes = messages
    stamps, bits, texts, changes, after = contents
    for row in range(len(starts)):
        start, end = starts[row], starts[row] + sizes[row]
        if sizes[row] < 4 or data[start] != 0 or data[start + 1] > 1:
            return row
        little, body = data[start + 1] == 1, start + 4
        offset = body
        if is_list:
            if offset + 4 > end or _integer(data, offset, 4, little) != 1:
                return row
            offset += 4
        if has_header:
            if offset + 8 > end:
                return row
            seconds = _integer(data, offset, 4, little)
            rest = _integer(data, offset + 4, 4, little)
            if seconds >= 2 ** 31 or rest >= 10 ** 9:
                return row
            stamps[row] = seconds * 10 ** 9 + rest
            offset += 8
            for text in range(2 if has_child_frame else 1):
                offset += (body - offset) % 4
                size = _integer(data, offset, 4, little) if offset + 4 <= end else 0
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
            bits[row, k] = _integer(data, offset + 8 * k, 8, little)
        after[row] = end - offset - 8 * bits.shape[1]
    return len(starts)


@njit
def find_transforms(messages: RawMessages, is_list: bool, parent: Annotated[Bytes, 'p'],
                    child: Annotated[Bytes, 'c'], rows: Annotated[Ints, 'm', WRITTEN],
                    stamps: Annotated[Ints, 'm', WRITTEN],
                    bits: Annotated[Ints, 'm d', WRITTEN]) -> tuple[int, int]:
    """
    Decode the transforms from one frame to another.

    Parameters
    ----------
    messages, is_list
        See `decode`.
    parent, child : uint8 (size,)
        The frame_id and the child_frame_id, each followed by a zero byte.
    rows, stamps, bits : int64 (m,), (m,), (m, doubles)
        The output, with one row for each transform. `rows` receives the index of the message that
        contains the transform, `stamps` receives the stamp of the transform in ns, and `bits`
        receives the bits of the transform's doubles.

    Returns
    -------
    int, int
        The number of transforms found, and the index of the first invalid message, or -1 if all
        messages are valid.

    """
    (data, starts, sizes), filled = messages, 0
    for row in range(len(starts)):
        start, end = starts[row], starts[row] + sizes[row]
        if sizes[row] < 8 or data[start] != 0 or data[start + 1] > 1:
            return filled, row
        little, body = data[start + 1] == 1, start + 4
        offset, count = body, 1
        if is_list:
            offset, count = body + 4, _integer(data, body, 4, little)
        for _ in range(count):
            if offset + 8 > end:
                return filled, row
            seconds = _integer(data, offset, 4, little)
            rest = _integer(data, offset + 4, 4, little)
            if seconds >= 2 ** 31 or rest >= 10 ** 9:
                return filled, row
            offset, wanted = offset + 8, True
            for number in range(2):
                offset += (body - offset) % 4
                size = _integer(data, offset, 4, little) if offset + 4 <= end else 0
                if size < 1 or size > end - offset - 4:
                    return filled, row
                name = parent if number == 0 else child
                wanted = wanted and _is_name(data, offset + 4, size, name)
                offset += 4 + size
            offset += (body - offset) % 8
            if offset + 8 * bits.shape[1] > end:
                return filled, row
            if wanted:
                rows[filled], stamps[filled] = row, seconds * 10 ** 9 + rest
                for k in range(bits.shape[1]):
                    bits[filled, k] = _integer(data, offset + 8 * k, 8, little)
                filled += 1
            offset += 8 * bits.shape[1]
    return filled, -1


@njit
def scan(data: Annotated[Bytes, 's'], position: int, count: int,
         found: Annotated[Ints, '5 n', WRITTEN]) -> tuple[int, int]:
    """
    Find the messages in MCAP records, stopping at the first record that is not a message.

    Parameters
    ----------
    data : array of uint8, shape (size,)
        Consecutive records, as in a decompressed chunk.
    position, count : int
        `position` is where to start in the data, and `count` is the number of messages that have
        been found already.
    found : int64 (5, n)
        The output, with one column for each message, filled from column `count` onward. The five
        rows are the channel, the log time (ns), the publish time (ns), the position of the message
        content in the data, and the size of this content.

    Returns
    -------
    position, count : int
        The position at which the scan stopped, and the number of messages found up to there.

    """
    end = len(data)
    while position + 31 <= end and data[position] == 5:  # a complete message record
        length = _integer(data, position + 1, 8, True)
        if length < 22 or length > end - position - 9:
            break
        found[0, count] = _integer(data, position + 9, 2, True)
        found[1, count] = _integer(data, position + 15, 8, True)
        found[2, count] = _integer(data, position + 23, 8, True)
        found[3, count], found[4, count] = position + 31, length - 22
        position += 9 + length
        count += 1
    return position, count


@inlined
def _integer(data: Bytes, start: int, size: int, little: bool) -> Any:
    # Decode a little-endian or big-endian integer. An eight-byte integer is signed, and a shorter
    # integer is unsigned.
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


@inlined
def _is_name(data: Bytes, start: int, size: int, name: Bytes) -> bool:
    same = size == len(name)
    for k in range(size if same else 0):
        same = same and data[start + k] == name[k]
    return same
