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

"""Pick the transforms between two frames out of messages that may contain many others."""

from __future__ import annotations

import struct

import numpy as np
from rigid_body_ros.engine import kernels, RawMessages
from rigid_body_ros.messages import MessageType
from rigid_body_ros.messages.kinds import header_at, opened, text_at
from rigid_body_ros.recording.bulk import BadMessageError, Decoded, Raw

#: The doubles of a transform are preceded by at least this many bytes: a stamp and two empty
#: names.
_LEAST = 8 + 2 * 5
#: `pairs` stops when it has found this many pairs of frames.
_MOST_PAIRS = 1000


def decode(kind: MessageType, raw: Raw, frames: tuple[str, str]) -> tuple[Raw, Decoded]:
    """
    Decode the transforms from one frame to another, and find the messages that contain them.

    Parameters
    ----------
    kind : MessageType
        TFMessage or TransformStamped.
    raw : Raw
        The messages.
    frames : tuple of str
        The frame_id and the child_frame_id of the transforms to decode.

    Returns
    -------
    messages : Raw
        For each transform, the message that contains it.
    decoded : Decoded
        The transforms.

    Raises
    ------
    BadMessageError
        A message does not match its type.

    """
    most = int(raw.sizes.sum()) // (_LEAST + 8 * kind.doubles) + 1
    rows, stamps = np.zeros(most, np.int64), np.zeros(most, np.int64)
    bits = np.zeros((most, kind.doubles), np.int64)
    parent, child = (np.frombuffer(name.encode() + b'\0', np.uint8) for name in frames)
    found, bad = kernels.find_transforms(RawMessages(*raw[:3]), kind.is_list, parent, child, rows,
                                         stamps, bits)
    if bad >= 0:
        raise BadMessageError(bad, f'expected a {kind.name} in CDR, found undecodable bytes')
    rows = rows[:found]
    messages = Raw(raw.data, raw.starts[rows], raw.sizes[rows], raw.log_ns[rows],
                   raw.publish_ns[rows])
    return messages, Decoded(stamps[:found], np.zeros(found, np.intp), [frames[0]],
                             bits[:found].view(np.float64))


def pairs(kind: MessageType, raw: Raw) -> list[tuple[str, str]]:
    """
    Return the distinct pairs of frame_id and child_frame_id in messages.

    Messages of the same size that share a transform are assumed to contain the same transforms.

    Raises
    ------
    BadMessageError
        A message does not match its type.

    """
    found: dict[tuple[str, str], None] = {}
    rows = np.arange(len(raw.starts))
    while rows.size and len(found) < _MOST_PAIRS:
        try:
            names = _names(kind, raw.message(rows[0]))
        except (ValueError, struct.error) as error:
            raise BadMessageError(int(rows[0]), str(error)) from error
        found |= dict.fromkeys(names)
        alike = raw.sizes[rows] == raw.sizes[rows[0]]
        if names:
            same, _ = decode(kind, raw, names[0])
            alike &= np.isin(raw.starts[rows], same.starts)
            alike[0] = True
        rows = rows[~alike]
    return [*found]


def _names(kind: MessageType, data: bytes) -> list[tuple[str, str]]:
    """Return the frame_id and the child_frame_id of each transform in a message."""
    body, order = opened(data)
    count, offset, names = 1, 0, []
    if kind.is_list:
        (count,), offset = struct.unpack_from(order + 'I', body), 4
    for _ in range(count):
        _, frame_id, offset = header_at(body, offset, order)
        child_frame_id, offset = text_at(body, offset, order)
        names.append((frame_id, child_frame_id))
        offset += -offset % 8 + 8 * kind.doubles
    return names
