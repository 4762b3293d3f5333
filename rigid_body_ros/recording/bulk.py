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

The messages are decoded in a compiled loop, which is a hundred times faster than Python. If the
loop fails on a message, that message is passed to `MessageType.decode`, which raises an error that
explains what is wrong with the message.
"""

from __future__ import annotations

from collections.abc import Sequence
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import Contents, kernels, RawMessages
from rigid_body_ros.messages import JointCommands, LAST_NS, MessageType, Px4Type
from rigid_body_ros.messages.kinds import Cdr
from rigid_body_ros.messages.px4 import layout, PX4_TYPES

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

#: Middleware may append up to this many bytes of padding to a message.
_PADDING = 3
#: The latest time that fits in a ROS stamp, us.
_LAST_US = LAST_NS // 1000
#: The doubles of a transform are preceded by at least this many bytes: a stamp and two empty
#: names.
_LEAST = 8 + 2 * 5
#: `frame_pairs` stops when it has found this many pairs of frames.
_MOST_PAIRS = 1000


class BadMessageError(ValueError):
    """Raised if a message does not match its type; `row` is the message's index."""

    def __init__(self, row: int, reason: str) -> None:
        super().__init__(reason)
        self.row = row


class Raw(NamedTuple):
    """
    The undecoded messages of one topic, stored in a single byte array.

    Attributes
    ----------
    data : array of uint8, shape (size,)
    starts, sizes : array of int64, shape (n,)
        The offset in `data` at which each message starts, and the length of each message, in
        bytes.
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
        """Join separate messages into one byte array."""
        sizes = np.array([len(message) for message in messages], np.int64)
        return cls(np.frombuffer(b''.join(messages), np.uint8), np.cumsum(sizes) - sizes, sizes,
                   log_ns, publish_ns)

    @classmethod
    def from_values(cls, kind: MessageType, stamps_ns: Ints, values: Floats,
                    logged_ns: Ints | None = None) -> Raw:
        """
        Encode each row of `values` as a message with an empty frame_id.

        A row contains the doubles of its message, in field order.
        """
        filled = np.empty(len(values), kind.layout(''))
        kind.fill(filled, stamps_ns, values, '')
        size = filled.dtype.itemsize
        times_ns = stamps_ns if logged_ns is None else logged_ns
        return cls(np.frombuffer(filled.tobytes(), np.uint8), np.arange(len(values)) * size,
                   np.full(len(values), size), times_ns, times_ns)

    def without_stamps(self) -> Raw:
        """Return messages whose headers have the stamp 0, so that no stamp is invalid."""
        data = self.data.copy()
        long_enough = self.starts[self.sizes >= 12]
        data[long_enough[:, None] + np.arange(4, 12)] = 0
        return self._replace(data=data)

    def rows(self, chosen: NDArray[np.intp] | Ints) -> Raw:
        """Return the chosen messages, in the same byte array."""
        return Raw(self.data, *(column[chosen] for column in self[1:]))

    def message(self, row: int) -> bytes:
        """Return the bytes of one message."""
        return self.data[self.starts[row]:self.starts[row] + self.sizes[row]].tobytes()


class Decoded(NamedTuple):
    """
    The decoded messages of one topic.

    Attributes
    ----------
    stamps_ns : array of int64, shape (n,)
        The stamps from the message headers, ns; all zero if the type has no header.
    frames : array of int, shape (n,)
        For each message, the index of its frame_id in `names`.
    names : list of str
        The distinct frame_ids.
    values : array, shape (n, doubles)
        The doubles in each message, in field order.
    longer : int
        Number of messages that have more bytes after the last field than padding can explain.

    """

    stamps_ns: Ints
    frames: NDArray[np.intp]
    names: list[str]
    values: Floats
    longer: int = 0


def converted(kind: Px4Type, raw: Raw) -> Raw:
    """
    Convert messages of PX4, in CDR, to messages of the type `kind.like` with an empty frame_id.

    Raise BadMessageError at the first invalid message.
    """
    body = layout(kind.fields)
    size = 4 + body.fields['end'][1]  # type: ignore[index]
    places = raw.starts[:, None] + np.arange(4 + body.itemsize)
    data = np.pad(raw.data, (0, 4 + body.itemsize))[places]  # may extend beyond the message
    fits = (raw.sizes >= size) & (raw.sizes <= size + _PADDING) & (data[:, :2] == [0, 1]).all(1)
    if not fits.all():
        row = int(np.argmin(fits))
        source = 'PX4 v1.14 to v1.17, because the recording does not,' \
            if kind in PX4_TYPES.values() else 'the recording'
        raise BadMessageError(row, f'expected {size} bytes that begin with 00 01, as {source} '
                              f'defines a {kind.name}, found {raw.sizes[row]} bytes that begin '
                              f'with {raw.message(row)[:2].hex(" ")}')
    stamps_us, values = kind.contents(data[:, 4:].copy().view(body)[:, 0])
    return Raw.from_values(kind.like, nanoseconds(stamps_us), values, raw.log_ns)


def nanoseconds(times_us: NDArray[np.uint64]) -> Ints:
    """Convert times; raise BadMessageError at the first that does not fit in a ROS stamp."""
    late = np.flatnonzero(times_us > _LAST_US)
    if late.size:
        raise BadMessageError(int(late[0]), f'expected a time up to {_LAST_US} us, '
                              f'found {times_us[late[0]]} us')
    return times_us.astype(np.int64) * 1000


def decode(kind: MessageType, raw: Raw) -> Decoded:
    """Decode messages, as `kind.like` if set; raise BadMessageError at the first invalid one."""
    if isinstance(kind, JointCommands):  # the compiled loop cannot decode joint names
        return _decode_each(kind, raw)
    count = len(raw.starts)
    contents = stamps, bits, texts, changes, after = Contents(
        np.zeros(count, np.int64), np.empty((count, kind.doubles), np.int64),
        np.zeros((count, 2), np.int64), np.zeros(count, np.bool_), np.zeros(count, np.int64))
    done = kernels.decode(RawMessages(*raw[:3]), kind.has_header, kind.is_list,
                          kind.has_child_frame, len(kind.before_doubles), contents)
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
    values = bits.view(np.float64)
    if kind.like:  # the doubles are the last ones of that type
        values = np.pad(values, ((0, 0), (kind.like.doubles - kind.doubles, 0)))
    return Decoded(stamps, codes, [*names], values, longer)


def _decode_each(kind: JointCommands, raw: Raw) -> Decoded:
    """Decode messages one at a time, for a type that the compiled loop does not support."""
    count, names = len(raw.starts), dict[str, int]()
    decoded = Decoded(np.empty(count, np.int64), np.empty(count, np.intp), [],
                      np.empty((count, kind.doubles)))
    for row in range(count):
        try:
            message = kind.decode(raw.message(row))
        except ValueError as error:
            raise BadMessageError(row, str(error)) from error
        decoded.frames[row] = names.setdefault(message.frame_id, len(names))
        decoded.stamps_ns[row], decoded.values[row] = message.stamp_ns, message.values
    return decoded._replace(names=[*names])


def decode_transforms(kind: MessageType, raw: Raw,
                      frames: tuple[str, str]) -> tuple[Raw, Decoded]:
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
    count, bad = kernels.find_transforms(RawMessages(*raw[:3]), kind.is_list, parent, child, rows,
                                         stamps, bits)
    if bad >= 0:
        raise BadMessageError(bad, f'expected a {kind.name} in CDR, found undecodable bytes')
    return raw.rows(rows[:count]), Decoded(stamps[:count], np.zeros(count, np.intp), [frames[0]],
                                           bits[:count].view(np.float64))


def frame_pairs(kind: MessageType, raw: Raw) -> list[tuple[str, str]]:
    """
    Return the distinct pairs of frame_id and child_frame_id in messages.

    Messages of the same size that share a transform are assumed to contain the same transforms.

    Raises
    ------
    BadMessageError
        A message does not match its type.

    """
    pairs: dict[tuple[str, str], None] = {}
    rows = np.arange(len(raw.starts))
    while rows.size and len(pairs) < _MOST_PAIRS:
        try:
            names = _names(kind, raw.message(rows[0]))
        except (ValueError, struct.error) as error:
            raise BadMessageError(int(rows[0]), f'expected a {kind.name} in CDR, found '
                                  f'undecodable bytes ({error})') from error
        pairs |= dict.fromkeys(names)
        alike = raw.sizes[rows] == raw.sizes[rows[0]]
        if names:
            same, _ = decode_transforms(kind, raw, names[0])
            alike &= np.isin(raw.starts[rows], same.starts)
            alike[0] = True
        rows = rows[~alike]
    return [*pairs]


def _names(kind: MessageType, data: bytes) -> list[tuple[str, str]]:
    """Return the frame_id and the child_frame_id of each transform in a message."""
    cdr, names = Cdr(data), []
    for _ in range(cdr.count() if kind.is_list else 1):
        _, frame_id = cdr.header()
        names.append((frame_id, cdr.text()))
        cdr.skip(8 * kind.doubles, 8)
    return names
