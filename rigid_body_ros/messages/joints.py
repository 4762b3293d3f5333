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

"""JointState messages, which contain the velocities and efforts of named wheels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted
from rigid_body_ros.messages.kinds import Cdr, MessageType, Stamped

_NAME = 'sensor_msgs/msg/JointState'
_NONE = np.empty(0)


class JointState(NamedTuple):
    """A decoded JointState message; each array is empty or contains one number per joint name."""

    stamp_ns: int
    frame_id: str
    names: tuple[str, ...]
    position: Floats
    velocity: Floats
    effort: Floats


def decoded_joints(data: bytes) -> JointState:
    """
    Decode a JointState message from CDR.

    Raises
    ------
    ValueError
        The bytes are not a JointState message, or a list of numbers in it is neither empty nor as
        long as the list of names.

    """
    try:
        cdr = Cdr(data)
        stamp_ns, frame_id = cdr.header()
        names = tuple([cdr.text() for _ in range(cdr.count())])
        lists = [cdr.doubles(size) if (size := cdr.count()) else _NONE for _ in range(3)]
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f'expected a {_NAME} in CDR, found {len(data)} bytes that cannot be '
                         f'decoded ({error})') from error
    for what, numbers in zip(('position', 'velocity', 'effort'), lists):
        if len(numbers) not in (0, len(names)):
            raise ValueError(f'{what}: expected none or {len(names)}, as there are names, found '
                             f'{len(numbers)}')
    return JointState(stamp_ns, frame_id, names, *lists)


def encoded_joints(stamp_ns: int, frame_id: str, names: Sequence[str],
                   position: ArrayLike = _NONE, velocity: ArrayLike = _NONE,
                   effort: ArrayLike = _NONE) -> bytes:
    """Encode a JointState message in CDR."""
    data = struct.pack('<iI', *divmod(stamp_ns, 10 ** 9)) + _text(frame_id)
    data = _padded(data) + _names(names)
    for numbers in (position, velocity, effort):
        doubles = np.asarray(numbers, '<f8')
        data = _padded(data) + struct.pack('<I', doubles.size)
        data = _padded(data, 8 if doubles.size else 4) + doubles.tobytes()
    return b'\0\1\0\0' + data


@dataclass(frozen=True)
class JointCommands(MessageType):
    """
    The type of JointState messages that command the efforts of joints.

    The doubles of a message are the efforts, in the order of `joints`. The effort of a joint that
    the message does not list is NaN.

    Attributes
    ----------
    joints : tuple of str
        The names of all joints that a message may list.

    """

    joints: tuple[str, ...] = ()

    def encode(self, stamp_ns: int, frame_id: str, values: ArrayLike,
               child_frame_id: str = '') -> bytes:
        """Encode a message in CDR, leaving out the joints whose values are NaN."""
        efforts = np.asarray(values, float)
        present = ~np.isnan(efforts)
        names = [name for name, is_present in zip(self.joints, present.tolist()) if is_present]
        return encoded_joints(stamp_ns, frame_id, names, effort=efforts[present])

    def decode(self, data: bytes) -> Stamped:
        """
        Decode a message from CDR.

        Raises
        ------
        ValueError
            The bytes are not a JointState message; a name is not one of the joints or occurs
            twice; or an effort is missing or not finite.

        """
        state = decoded_joints(data)
        names, efforts = state.names, state.effort.tolist()
        efforts_of = dict.fromkeys(self.joints, np.nan)
        for row, name in enumerate(names):
            if name not in efforts_of:
                raise ValueError(f'name: expected some of {listed([*map(repr, self.joints)])}, '
                                 f'found {quoted(name)}')
            if name in names[:row]:
                raise ValueError(f'name: expected each once, found {name!r} twice')
        if len(efforts) != len(names):
            raise ValueError(f'effort: expected {len(names)}, as there are names, found none')
        if not np.isfinite(state.effort).all():
            raise ValueError(f'effort: expected finite numbers, found {efforts}')
        values = np.array([*(efforts_of | dict(zip(names, efforts))).values()])
        return Stamped(state.stamp_ns, state.frame_id, '', values)


def joint_commands(joints: Sequence[str]) -> JointCommands:
    """Return the type of messages that command the efforts of the joints with these names."""
    return JointCommands(_NAME, len(joints), joints=tuple(joints))


def joint_states(joints: Sequence[str]) -> MessageType:
    """
    Return the type for JointState messages with the velocity and effort of each joint.

    `joint_values` returns the numbers that a writer needs for messages of this type.
    """
    lists = _padded(_names(joints)) + struct.pack('<2I', 0, len(joints))
    return MessageType(_NAME, 2 * len(joints) + 1, before_doubles=lists)


def joint_values(velocities: Floats, efforts: Floats) -> Floats:
    """
    Arrange velocities and efforts as the numbers of JointState messages.

    The type of the messages must come from `joint_states`. A writer copies each row into a
    message as 64-bit floats (doubles).

    Parameters
    ----------
    velocities, efforts : array, shape (n, k)
        The velocities, rad/s, and efforts, N m, of k joints, with one row per message.

    Returns
    -------
    array, shape (n, 2 k + 1)
        Each row has the velocities, one column for the encoding, and the efforts. In a message,
        the length of the list of efforts and its padding lie between both lists, and fill as many
        bytes as a double. The middle column has these bytes, and has no meaning as a number.

    """
    rows, joints = velocities.shape
    # In CDR, the length of the effort list and the padding after it together fill one double.
    length = np.full((rows, 1), joints, '<u8').view('<f8')
    return np.hstack([velocities, length, efforts])


def _names(names: Sequence[str]) -> bytes:
    data = struct.pack('<I', len(names))
    for name in names:
        data = _padded(data) + _text(name)
    return data


def _text(text: str) -> bytes:
    encoded = text.encode() + b'\0'
    return struct.pack('<I', len(encoded)) + encoded


def _padded(data: bytes, size: int = 4) -> bytes:
    return data + bytes(-len(data) % size)
