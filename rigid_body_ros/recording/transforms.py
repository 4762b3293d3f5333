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

"""Decode the transforms between two frames from messages that can hold many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.kernels.jit import inlined, njit
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import BadMessageError, Bytes, Decoded, integer, Ints, Raw

#: Fewest bytes of a transform before its doubles: a stamp and two empty names.
_LEAST = 8 + 2 * 5
#: Most pairs of frames that are listed.
_PAIRS = 7


def decode(kind: MessageType, raw: Raw, frames: tuple[str, str]) -> tuple[Raw, Decoded]:
    """
    Return the transforms from one frame to another, and the messages that hold them.

    Parameters
    ----------
    kind : MessageType
        TFMessage or TransformStamped.
    raw : Raw
        The messages.
    frames : tuple of str
        The frame_id and the child_frame_id.

    Returns
    -------
    messages : Raw
        The message of each transform.
    decoded : Decoded

    Raises
    ------
    BadMessageError
        A message does not match its type.

    """
    most = int(raw.sizes.sum()) // (_LEAST + 8 * kind.doubles) + 1
    rows, stamps = np.zeros(most, np.int64), np.zeros(most, np.int64)
    bits = np.zeros((most, kind.doubles), np.int64)
    parent, child = (np.frombuffer(name.encode() + b'\0', np.uint8) for name in frames)
    found, bad = _find(raw.data, raw.starts, raw.sizes, kind.is_list, parent, child, rows, stamps,
                       bits)
    if bad >= 0:
        raise BadMessageError(bad, f'expected a {kind.name} in CDR, found undecodable bytes')
    rows = rows[:found]
    messages = Raw(raw.data, raw.starts[rows], raw.sizes[rows], raw.log_ns[rows],
                   raw.publish_ns[rows])
    return messages, Decoded(stamps[:found], np.zeros(found, np.intp), [frames[0]],
                             bits[:found].view(np.float64))


def pairs(kind: MessageType, raw: Raw) -> list[tuple[str, str]]:
    """
    Return the first few pairs of frame_id and child_frame_id of messages, each once.

    Raises
    ------
    BadMessageError
        A message does not match its type.

    """
    found: list[tuple[str, str]] = []
    rows = np.arange(len(raw.starts))
    while rows.size and len(found) < _PAIRS:
        try:
            first = kind.decode(raw.message(rows[0]))
        except ValueError as error:
            raise BadMessageError(int(rows[0]), str(error)) from error
        found.append((first.frame_id, first.child_frame_id))
        same, _ = decode(kind, raw, found[-1])
        rows = rows[1:][~np.isin(raw.starts[rows[1:]], same.starts)]
    return found


@inlined
def _is_name(data: Bytes, start: int, size: int, name: Bytes) -> bool:
    same = size == len(name)
    for k in range(size if same else 0):
        same = same and data[start + k] == name[k]
    return same


@njit
def _find(data: Bytes, starts: Ints, sizes: Ints, is_list: bool, parent: Bytes, child: Bytes,
          rows: Ints, stamps: Ints, bits: NDArray[np.int64]) -> tuple[int, int]:
    # Fill `rows` (of the messages), `stamps` and `bits` (of the doubles). Return the number of
    # transforms found, and the first invalid message or -1.
    found = 0
    for row in range(len(starts)):
        start, end = starts[row], starts[row] + sizes[row]
        if sizes[row] < 8 or data[start] != 0 or data[start + 1] > 1:
            return found, row
        little, body = data[start + 1] == 1, start + 4
        offset, count = body, 1
        if is_list:
            offset, count = body + 4, integer(data, body, 4, little)
        for _ in range(count):
            if offset + 8 > end:
                return found, row
            seconds, rest = integer(data, offset, 4, little), integer(data, offset + 4, 4, little)
            if seconds >= 2 ** 31 or rest >= 10 ** 9:
                return found, row
            offset, wanted = offset + 8, True
            for number in range(2):
                offset += (body - offset) % 4
                size = integer(data, offset, 4, little) if offset + 4 <= end else 0
                if size < 1 or size > end - offset - 4:
                    return found, row
                name = parent if number == 0 else child
                wanted = wanted and _is_name(data, offset + 4, size, name)
                offset += 4 + size
            offset += (body - offset) % 8
            if offset + 8 * bits.shape[1] > end:
                return found, row
            if wanted:
                rows[found], stamps[found] = row, seconds * 10 ** 9 + rest
                for k in range(bits.shape[1]):
                    bits[found, k] = integer(data, offset + 8 * k, 8, little)
                found += 1
            offset += 8 * bits.shape[1]
    return found, -1
