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
Define message types, and encode and decode messages of these types.

All types in this module have the same structure: a header, a second name in some types, and then
doubles. There are three exceptions. A Wrench has no header. A TFMessage is a list of transforms,
but here it always has exactly one entry. A Marker has other fields before and after its doubles,
but here the values of these other fields never change.

Messages are encoded in XCDR1, as specified in section 7.4 of DDS-XTypes. They are written in
little-endian byte order, and read in either byte order. Doubles are aligned to 8 bytes, counted
from the end of the 4-byte encapsulation header.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.messages import definitions

#: The latest time that fits in a ROS stamp, ns. It is in January 2038.
LAST_NS = 2 ** 31 * 10 ** 9 - 1


#: The formats of a length, a stamp and a double in the byte orders '>' and '<'.
_FORMATS = [(struct.Struct(f'{order}I'), struct.Struct(f'{order}iI'), np.dtype(f'{order}f8'))
            for order in '><']


class Stamped(NamedTuple):
    """A decoded message; `child_frame_id` is '' if the message type does not have one."""

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    values: Floats


class Cdr:
    """
    Read the parts of an encoded message, one after the other.

    Raise ValueError or struct.error if the message ends early, or if a part is not valid.
    """

    __slots__ = '_body', '_doubles', '_length', '_offset', '_stamp'

    def __init__(self, data: bytes) -> None:
        if len(data) < 4:
            raise ValueError('no encapsulation')
        if data[0] != 0 or data[1] not in (0, 1):
            raise ValueError(f'unknown encapsulation {data[:4].hex(" ")}')
        self._body, self._offset = memoryview(data)[4:], 0
        self._length, self._stamp, self._doubles = _FORMATS[data[1]]

    def count(self) -> int:
        """Read the length of a list or a string."""
        start = self._offset + -self._offset % 4
        self._offset = start + 4
        length: int = self._length.unpack_from(self._body, start)[0]
        return length

    def header(self) -> tuple[int, str]:
        """Read a header; return its stamp, ns, and its frame_id."""
        seconds, nanoseconds = self._stamp.unpack_from(self._body, self._offset)
        if seconds < 0 or nanoseconds >= 10 ** 9:
            raise ValueError(f'invalid stamp: {seconds} s and {nanoseconds} ns')
        self._offset += 8
        return seconds * 10 ** 9 + nanoseconds, self.text()

    def text(self) -> str:
        """Read a string."""
        size = self.count()
        start, self._offset = self._offset, self._offset + size
        if not 1 <= size <= len(self._body) - start:
            raise ValueError(f'invalid string length: {size} bytes')
        return str(self._body[start:self._offset - 1], 'utf-8')

    def skip(self, size: int, alignment: int = 4) -> None:
        """Skip the alignment and this many bytes."""
        self._offset += -self._offset % alignment + size

    def doubles(self, count: int) -> Floats:
        """Read doubles, shape (count,)."""
        start = self._offset + -self._offset % 8
        self._offset = start + 8 * count
        return np.frombuffer(self._body, self._doubles, count, start).astype(float)


@dataclass(frozen=True, eq=False)  # with eq, each cache lookup would hash all fields
class MessageType:
    """
    A ROS message type: its definition, and how its messages are encoded and decoded.

    Attributes
    ----------
    name : str
        The ROS name, such as 'geometry_msgs/msg/WrenchStamped'.
    doubles : int
        The number of doubles in a message.
    has_child_frame : bool
        Whether the frame_id is followed by a second name, which is a child frame or, in a Marker,
        a namespace.
    is_list : bool
        Whether a message is a list with one entry.
    has_header : bool
        Whether a message has a header.
    before_doubles, after_doubles : bytes
        The constant CDR bytes between the names and the doubles, and the constant CDR bytes after
        the doubles.
    like : MessageType, optional
        The type to which messages are converted when they are decoded, if that is another type.

    """

    name: str
    doubles: int
    has_child_frame: bool = False
    is_list: bool = False
    has_header: bool = True
    before_doubles: bytes = b''
    after_doubles: bytes = b''
    like: MessageType | None = None

    @property
    def type_hash(self) -> str:
        """Return the hash that identifies the type in ROS 2 Iron and later releases (REP-2011)."""
        return definitions.HASHES[self.name]

    @property
    def definition(self) -> str:
        """Return the complete definition in MCAP's schema encoding 'ros2msg'."""
        return definitions.definition(self.name)

    def encode(self, stamp_ns: int, frame_id: str, values: ArrayLike,
               child_frame_id: str = '') -> bytes:
        """
        Encode a message in CDR.

        `values`, shape (doubles,), are the message's doubles, in field order.
        """
        head, names = _around_stamp(self, frame_id, child_frame_id)
        stamp = struct.pack('<iI', *divmod(stamp_ns, 10 ** 9))
        doubles = np.asarray(values, '<f8').tobytes()
        return head + stamp + names + doubles + self.after_doubles

    def layout(self, frame_id: str, child_frame_id: str = '') -> np.dtype[np.void]:
        """Return the dtype of the array that `fill` needs for messages with these frame_ids."""
        head, names = _around_stamp(self, frame_id, child_frame_id)
        return np.dtype([('head', f'V{len(head)}'), ('sec', '<i4'), ('nanosec', '<u4'),
                         ('names', f'V{len(names)}'), ('doubles', '<f8', (self.doubles,)),
                         ('after', f'V{len(self.after_doubles)}')])

    def fill(self, rows: NDArray[np.void], stamps_ns: NDArray[np.int64], values: Floats,
             frame_id: str, child_frame_id: str = '') -> None:
        """
        Encode n messages into an array.

        Each row of `values`, shape (n, doubles), contains the doubles of a message, in field
        order.
        """
        head, names = _around_stamp(self, frame_id, child_frame_id)
        rows['head'], rows['names'] = np.void(head), np.void(names)
        rows['sec'], rows['nanosec'] = np.divmod(stamps_ns, 10 ** 9)
        rows['doubles'], rows['after'] = values, np.void(self.after_doubles)

    def decode(self, data: bytes) -> Stamped:
        """
        Decode a message from CDR.

        Raises
        ------
        ValueError
            The bytes are not a message of this type.

        """
        try:
            return self._decode(data)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise ValueError(f'expected a {self.name} in CDR, found {len(data)} bytes that '
                             f'cannot be decoded ({error})') from error

    def _decode(self, data: bytes) -> Stamped:
        cdr = Cdr(data)
        if self.is_list and (entries := cdr.count()) != 1:
            raise ValueError(f'expected a list of 1 entry, found {entries}')
        stamp_ns, frame_id = cdr.header() if self.has_header else (0, '')
        child_frame_id = cdr.text() if self.has_child_frame else ''
        if self.before_doubles:
            cdr.skip(len(self.before_doubles))
        return Stamped(stamp_ns, frame_id, child_frame_id, cdr.doubles(self.doubles))


def _marker(shape: int, *color: float) -> MessageType:
    """
    Return a type for Markers that all have the given shape and color (r, g, b, a).

    The doubles of such a Marker are its pose and its scale.
    """
    no_text, no_list = struct.pack('<I4x', 1), bytes(4)
    texture = bytes(8) + no_text + no_text + no_list
    after = [struct.pack('<4f8xB3x', *color, 0), no_list, no_list, no_text, texture, no_list,
             no_text, no_text, no_text, no_list, b'\0']
    return MessageType('visualization_msgs/msg/Marker', 10, has_child_frame=True,
                       before_doubles=struct.pack('<3i', 0, shape, 0),
                       after_doubles=b''.join(after))


#: geometry_msgs/msg/WrenchStamped; doubles: force x y z, torque x y z.
WRENCH = MessageType('geometry_msgs/msg/WrenchStamped', 6)
#: geometry_msgs/msg/Wrench; doubles: force x y z, torque x y z.
BARE_WRENCH = MessageType('geometry_msgs/msg/Wrench', 6, has_header=False)
#: geometry_msgs/msg/QuaternionStamped; doubles: x y z w.
QUATERNION = MessageType('geometry_msgs/msg/QuaternionStamped', 4)
#: geometry_msgs/msg/Vector3Stamped; doubles: x y z.
VECTOR3 = MessageType('geometry_msgs/msg/Vector3Stamped', 3)
#: A Vector3Stamped that contains a torque.
TORQUE_VECTOR = MessageType('geometry_msgs/msg/Vector3Stamped', 3, like=WRENCH)
#: geometry_msgs/msg/InertiaStamped; doubles: mass, centre of mass x y z, ixx ixy ixz iyy iyz izz.
INERTIA = MessageType('geometry_msgs/msg/InertiaStamped', 10)
#: sensor_msgs/msg/Imu; 37 doubles: orientation, angular velocity, acceleration, each followed by
#: its 9 covariances.
IMU = MessageType('sensor_msgs/msg/Imu', 37)
#: nav_msgs/msg/Odometry; 85 doubles: position, orientation, 36 covariances, linear and angular
#: velocity, 36 covariances.
ODOMETRY = MessageType('nav_msgs/msg/Odometry', 85, has_child_frame=True)
#: tf2_msgs/msg/TFMessage with one transform; doubles: translation x y z, rotation x y z w.
TRANSFORM = MessageType('tf2_msgs/msg/TFMessage', 7, has_child_frame=True, is_list=True)
#: These types are read but never written. Their doubles are the position, the orientation x y z w
#: and, in PoseWithCovarianceStamped, 36 covariances.
POSE = MessageType('geometry_msgs/msg/PoseStamped', 7)
POSE_WITH_COVARIANCE = MessageType('geometry_msgs/msg/PoseWithCovarianceStamped', 43)
TRANSFORM_STAMPED = MessageType('geometry_msgs/msg/TransformStamped', 7, has_child_frame=True)
#: The arrows differ in lightness as well as hue, so that colour-blind users can tell them apart.
BOX = _marker(1, 0.70, 0.75, 0.80, 0.8)
ORANGE_ARROW, BLUE_ARROW = _marker(0, 0.90, 0.62, 0.0, 1.0), _marker(0, 0.0, 0.27, 0.70, 1.0)
#: The types that the package writes, by name; the tests compare them with rosbags.
TYPES = {kind.name: kind for kind in (
    WRENCH, QUATERNION, VECTOR3, INERTIA, IMU, ODOMETRY, TRANSFORM, BOX)}


@lru_cache
def _around_stamp(kind: MessageType, frame_id: str, child_frame_id: str) -> tuple[bytes, bytes]:
    # Return two sequences of bytes: those before the stamp of a message, and those between the
    # stamp and the doubles.
    head = b'\1\0\0\0' if kind.is_list else b''
    begin, body = len(head) + 8, b''
    for name in (frame_id, child_frame_id)[:1 + kind.has_child_frame]:
        text = name.encode() + b'\0'
        body += bytes(-(begin + len(body)) % 4) + struct.pack('<I', len(text)) + text
    body += bytes(-(begin + len(body)) % 4) + kind.before_doubles
    return b'\0\1\0\0' + head, body + bytes(-(begin + len(body)) % 8)


def unstamped(data: bytes) -> bytes:
    """Return an encoded message that begins with a header, with the stamp 0."""
    return data[:4] + bytes(8) + data[12:]
