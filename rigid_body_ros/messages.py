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
ROS messages as bytes: the only module with message fields, CDR and message definitions.

All types here have one structure: a header, in some types a second name, then doubles. There are
three exceptions. A Wrench has no header. A TFMessage is a list of transforms, here always of one.
A Marker has other fields around its doubles, here with constant values.

The encoding is XCDR1 of the DDS-XTypes specification, section 7.4. Messages are written in little
endian and read in either byte order. Doubles are aligned to 8 bytes, counted from the end of the
4-byte encapsulation header.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
import re
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted
from rigid_body_ros.mechanics.frames import Frame, Frames
from rigid_body_ros.mechanics.imu import ImuErrors
from rigid_body_ros.mechanics.state import State

#: The frame_id of an epoch marker: this word, and the numbers of the start state.
_EPOCH = '/epoch'
_EPOCH_NUMBERS = re.compile(_EPOCH + ' attitude(' + 4 * r' \S+' + ') rates(' + 3 * r' \S+'
                            + ') rotors(' + 3 * r' \S+' + ')')
#: The latest time that a ROS stamp can represent, ns; it is in January 2038.
LAST_NS = 2 ** 31 * 10 ** 9 - 1

_FIELDS = {
    'builtin_interfaces/Time': 'int32 sec\nuint32 nanosec\n',
    'std_msgs/Header': 'builtin_interfaces/Time stamp\nstring frame_id\n',
    'geometry_msgs/Vector3': 'float64 x\nfloat64 y\nfloat64 z\n',
    'geometry_msgs/Point': 'float64 x\nfloat64 y\nfloat64 z\n',
    'geometry_msgs/Quaternion': 'float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n',
    'geometry_msgs/Wrench': 'Vector3 force\nVector3 torque\n',
    'geometry_msgs/Pose': 'Point position\nQuaternion orientation\n',
    'geometry_msgs/Twist': 'Vector3 linear\nVector3 angular\n',
    'geometry_msgs/PoseWithCovariance': 'Pose pose\nfloat64[36] covariance\n',
    'geometry_msgs/TwistWithCovariance': 'Twist twist\nfloat64[36] covariance\n',
    'geometry_msgs/Transform': 'Vector3 translation\nQuaternion rotation\n',
    'geometry_msgs/TransformStamped': 'std_msgs/Header header\nstring child_frame_id\n'
                                      'Transform transform\n',
    'geometry_msgs/PoseStamped': 'std_msgs/Header header\nPose pose\n',
    'geometry_msgs/PoseWithCovarianceStamped': 'std_msgs/Header header\n'
                                               'PoseWithCovariance pose\n',
    'geometry_msgs/WrenchStamped': 'std_msgs/Header header\nWrench wrench\n',
    'geometry_msgs/QuaternionStamped': 'std_msgs/Header header\nQuaternion quaternion\n',
    'geometry_msgs/Vector3Stamped': 'std_msgs/Header header\nVector3 vector\n',
    'geometry_msgs/Inertia': 'float64 m\ngeometry_msgs/Vector3 com\nfloat64 ixx\nfloat64 ixy\n'
                             'float64 ixz\nfloat64 iyy\nfloat64 iyz\nfloat64 izz\n',
    'geometry_msgs/InertiaStamped': 'std_msgs/Header header\nInertia inertia\n',
    'sensor_msgs/Imu': 'std_msgs/Header header\n'
                       'geometry_msgs/Quaternion orientation\n'
                       'float64[9] orientation_covariance\n'
                       'geometry_msgs/Vector3 angular_velocity\n'
                       'float64[9] angular_velocity_covariance\n'
                       'geometry_msgs/Vector3 linear_acceleration\n'
                       'float64[9] linear_acceleration_covariance\n',
    'tf2_msgs/TFMessage': 'geometry_msgs/TransformStamped[] transforms\n',
    'nav_msgs/Odometry': 'std_msgs/Header header\nstring child_frame_id\n'
                         'geometry_msgs/PoseWithCovariance pose\n'
                         'geometry_msgs/TwistWithCovariance twist\n',
    'builtin_interfaces/Duration': 'int32 sec\nuint32 nanosec\n',
    'std_msgs/ColorRGBA': 'float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n',
    'sensor_msgs/CompressedImage': 'std_msgs/Header header\nstring format\nuint8[] data\n',
    'visualization_msgs/UVCoordinate': 'float32 u\nfloat32 v\n',
    'visualization_msgs/MeshFile': 'string filename\nuint8[] data\n',
    'visualization_msgs/Marker': 'std_msgs/Header header\nstring ns\nint32 id\nint32 type\n'
                                 'int32 action\ngeometry_msgs/Pose pose\n'
                                 'geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n'
                                 'builtin_interfaces/Duration lifetime\nbool frame_locked\n'
                                 'geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n'
                                 'string texture_resource\n'
                                 'sensor_msgs/CompressedImage texture\n'
                                 'UVCoordinate[] uv_coordinates\nstring text\n'
                                 'string mesh_resource\nMeshFile mesh_file\n'
                                 'bool mesh_use_embedded_materials\n',
}

_HASHES = {name: f'RIHS01_{digits}' for name, digits in {
    'geometry_msgs/msg/Wrench':
        '018e8519d57c16adbe97c9fe1460ef21fec7e31bc541de3d653a35895677ce52',
    'geometry_msgs/msg/WrenchStamped':
        '8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77',
    'geometry_msgs/msg/QuaternionStamped':
        '381add86c6c3160644d228ca342182c7fd6c7fab11c7a85ad817a9cc22dbac6e',
    'geometry_msgs/msg/Vector3Stamped':
        'd4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a',
    'geometry_msgs/msg/InertiaStamped':
        '766be45976252babf7f9d8ac4ae7c912a7ceccf71035622529f27518b695aa09',
    'sensor_msgs/msg/Imu': '7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b',
    'nav_msgs/msg/Odometry': '3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0',
    'tf2_msgs/msg/TFMessage': 'e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
    'visualization_msgs/msg/Marker':
        '45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0',
}.items()}


class Stamped(NamedTuple):
    """A decoded message: stamp, frame, second name if it has one, doubles in field order."""

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    values: Floats


@dataclass(frozen=True)
class MessageType:
    """
    A ROS message type: its definition, and how its messages are encoded and decoded.

    Attributes
    ----------
    name : str
        The ROS name, such as 'geometry_msgs/msg/WrenchStamped'.
    doubles : int
        Number of doubles in a message.
    has_child_frame : bool
        Whether a second name follows the frame_id: a child frame or, in a Marker, a namespace.
    is_list : bool
        Whether a message is a list with one entry.
    has_header : bool
    before_doubles, after_doubles : bytes
        Constant CDR bytes between the names and the doubles, and after the doubles.

    """

    name: str
    doubles: int
    has_child_frame: bool = False
    is_list: bool = False
    has_header: bool = True
    before_doubles: bytes = b''
    after_doubles: bytes = b''

    @property
    def type_hash(self) -> str:
        """Return the hash by which ROS 2 identifies the type since Iron (REP-2011)."""
        return _HASHES[self.name]

    @property
    def definition(self) -> str:
        """Return the complete definition in MCAP's schema encoding 'ros2msg'."""
        name = self.name.replace('/msg/', '/')
        nested = [f'{"=" * 80}\nMSG: {part}\n{_FIELDS[part]}' for part in _nested(name)]
        return ''.join([_FIELDS[name], *nested])

    def encode(self, stamp_ns: int, frame_id: str, values: ArrayLike,
               child_frame_id: str = '') -> bytes:
        """Return a message as CDR bytes; values in field order, shape (doubles,)."""
        head, names = _around_stamp(self, frame_id, child_frame_id)
        stamp = struct.pack('<iI', *divmod(stamp_ns, 10 ** 9))
        doubles = np.asarray(values, '<f8').tobytes()
        return head + stamp + names + doubles + self.after_doubles

    def layout(self, frame_id: str, child_frame_id: str = '') -> np.dtype[np.void]:
        """Return the dtype of an array of messages with these frame names; `fill` fills it."""
        head, names = _around_stamp(self, frame_id, child_frame_id)
        return np.dtype([('head', f'V{len(head)}'), ('sec', '<i4'), ('nanosec', '<u4'),
                         ('names', f'V{len(names)}'), ('doubles', '<f8', (self.doubles,)),
                         ('after', f'V{len(self.after_doubles)}')])

    def fill(self, rows: NDArray[np.void], stamps_ns: NDArray[np.int64], values: Floats,
             frame_id: str, child_frame_id: str = '') -> None:
        """Fill messages, shape (n,), with values in field order, shape (n, doubles)."""
        head, names = _around_stamp(self, frame_id, child_frame_id)
        rows['head'], rows['names'] = np.void(head), np.void(names)
        rows['sec'], rows['nanosec'] = np.divmod(stamps_ns, 10 ** 9)
        rows['doubles'], rows['after'] = values, np.void(self.after_doubles)

    def decode(self, data: bytes) -> Stamped:
        """
        Return the contents of a CDR message.

        Raises
        ------
        ValueError
            The bytes are not a message of this type.

        """
        try:
            return self._decode(data)
        except (struct.error, UnicodeDecodeError, ValueError, IndexError) as error:
            raise ValueError(f'expected a {self.name} in CDR, found {len(data)} bytes that '
                             f'cannot be decoded ({error})') from error

    def _decode(self, data: bytes) -> Stamped:
        if data[0] != 0 or data[1] not in (0, 1):
            raise ValueError(f'unknown encapsulation {data[:4].hex(" ")}')
        order = '<' if data[1] else '>'
        body = memoryview(data)[4:]
        offset = 0
        if self.is_list:
            entries, = struct.unpack_from(order + 'I', body)
            if entries != 1:
                raise ValueError(f'expected a list of 1 entry, found {entries}')
            offset = 4
        if not self.has_header:
            return Stamped(0, '', '', self._doubles(body, offset, order))
        seconds, nanoseconds = struct.unpack_from(order + 'iI', body, offset)
        if seconds < 0 or nanoseconds >= 10 ** 9:
            raise ValueError(f'invalid stamp: {seconds} s and {nanoseconds} ns')
        frame_id, offset = _string(body, offset + 8, order)
        child_frame_id = ''
        if self.has_child_frame:
            child_frame_id, offset = _string(body, offset, order)
        offset += -offset % 4 + len(self.before_doubles)
        return Stamped(seconds * 10 ** 9 + nanoseconds, frame_id, child_frame_id,
                       self._doubles(body, offset, order))

    def _doubles(self, body: memoryview, offset: int, order: str) -> Floats:
        return np.frombuffer(body, order + 'f8', self.doubles, offset + -offset % 8).astype(float)


def _marker(shape: int, *color: float) -> MessageType:
    """Return a Marker type with a shape and color (r, g, b, a); its doubles are pose and scale."""
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
#: Types that are only read; doubles: position, orientation x y z w, 36 covariances (second type).
POSE = MessageType('geometry_msgs/msg/PoseStamped', 7)
POSE_WITH_COVARIANCE = MessageType('geometry_msgs/msg/PoseWithCovarianceStamped', 43)
TRANSFORM_STAMPED = MessageType('geometry_msgs/msg/TransformStamped', 7, has_child_frame=True)
#: The arrows also differ in lightness, for colour-blind readers.
BOX = _marker(1, 0.70, 0.75, 0.80, 0.8)
ORANGE_ARROW, BLUE_ARROW = _marker(0, 0.90, 0.62, 0.0, 1.0), _marker(0, 0.0, 0.27, 0.70, 1.0)
TYPES = {kind.name: kind for kind in (
    WRENCH, QUATERNION, VECTOR3, INERTIA, IMU, ODOMETRY, TRANSFORM, BOX)}

#: Position of the orientation in the doubles of an Odometry.
ORIENTATION = slice(3, 7)
#: Position of the angular velocity in the doubles of an Odometry.
ANGULAR_VELOCITY = slice(46, 49)
#: Position of the mass and the centre of mass in the doubles of an InertiaStamped.
MASS_AND_CENTRE = slice(0, 4)
#: m^2 and m^2/s^2; the variance of a position and a linear velocity that nobody has measured.
_UNKNOWN = 1e6
_NO_ERRORS = ImuErrors()
#: Positions of ixx, iyy, izz, ixy, ixz, iyz.
_ENTRIES = [4, 7, 9, 5, 6, 8]


def torque(wrench: Stamped) -> Floats:
    """Return the torque of a WrenchStamped, N m, shape (3,)."""
    return wrench.values[3:]


def wrench(stamp_ns: int, frame_id: str, torque: Iterable[float]) -> bytes:
    """Return a WrenchStamped with a torque, N m, shape (3,), and zero force."""
    return WRENCH.encode(stamp_ns, frame_id, [0.0, 0.0, 0.0, *torque])


def inertia_entries(values: Floats) -> Floats:
    """Return ixx, iyy, izz, ixy, ixz, iyz, shape (..., 6), of the doubles of an InertiaStamped."""
    return values[..., _ENTRIES]


def inertia(stamp_ns: int, frame_id: str, entries: ArrayLike) -> bytes:
    """Return an InertiaStamped with these entries, kg m^2, shape (6,), see `inertia_entries`."""
    values = np.zeros(INERTIA.doubles)
    values[_ENTRIES] = entries
    return INERTIA.encode(stamp_ns, frame_id, values)


def epoch_marker(start: State, kind: MessageType = WRENCH) -> bytes:
    """
    Return the marker that begins an epoch in the log of a node: a message of zeros.

    Its stamp is that of the start state, whose numbers its frame_id contains with all digits. No
    frame of tf2 has a name like that, because of the leading slash.
    """
    groups = {'attitude': start.attitude, 'rates': start.angular_velocity,
              'rotors': start.rotor_momentum}
    words = [f'{name} {" ".join(map(repr, values.tolist()))}' for name, values in groups.items()]
    return kind.encode(start.time_ns, f'{_EPOCH} {" ".join(words)}', np.zeros(kind.doubles))


def is_epoch_marker(frame_id: str) -> bool:
    """Return whether a message with this frame_id begins an epoch; see `epoch_marker`."""
    return frame_id.startswith(f'{_EPOCH} ')


def epoch_start(stamp_ns: int, frame_id: str) -> State:
    """
    Return the start state in the stamp and the frame_id of an epoch marker.

    Raises
    ------
    ValueError
        The frame_id is not one that `epoch_marker` writes.

    """
    found = _EPOCH_NUMBERS.fullmatch(frame_id)
    if not found:
        raise ValueError('frame_id: expected the start state of an epoch, '
                         f'found {quoted(frame_id)}')
    attitude, rates, rotors = ([float(number) for number in group.split()]
                               for group in found.groups())
    return State(stamp_ns, attitude, rates, rotors)


def torque_frame(frame_id: str, body_frame: str, space_frame: str) -> str:
    """
    Return the axes of the torque in a WrenchStamped: 'body' or 'space'.

    Raises
    ------
    ValueError
        The frame_id is neither empty nor one of the two frames.

    """
    if frame_id in ('', body_frame):
        return 'body'
    if frame_id == space_frame:
        return 'space'
    raise ValueError(f"frame_id: expected '{body_frame}' or '' (body axes) or "
                     f"'{space_frame}' (space axes), found {quoted(frame_id)}")


def wrench_frame(frame_id: str, body_frame: str, space_frame: str,
                 links: Frames) -> tuple[str, Frame | None]:
    """
    Return the axes, 'body' or 'space', of the torque of a WrenchStamped, and its frame.

    The frame is one of `links`; it converts the wrench to a torque about the centre of mass.
    Without a frame the torque is about the centre of mass already, and
    the force has no effect.

    Raises
    ------
    ValueError
        The frame_id is neither one that `torque_frame` accepts nor one of the links.

    """
    if frame_id not in ('', body_frame, space_frame) and (
            frame_id in links or frame_id in links.others):
        return 'body', links[frame_id]
    try:
        axes = torque_frame(frame_id, body_frame, space_frame)
    except ValueError as error:
        if links:
            others = listed([repr(name) for name in links if name != links.link])
            raise ValueError(f'{error}; links whose forces are accepted: {others}') from error
        raise
    return axes, links.of_body(body_frame) if axes == 'body' else None


def odometry(state: State, space_frame: str, body_frame: str, attitude_variance: float = 0.0,
             rate_variance: float = 0.0) -> bytes:
    """
    Return an Odometry at the origin with the attitude and the body rates of a state.

    A variance other than 0, rad^2 or rad^2/s^2, is on the diagonal of its covariance. Position and
    linear velocity, which are no estimates, then have one of 1e6 m^2 or m^2/s^2.
    """
    values = np.zeros(ODOMETRY.doubles)
    values[ORIENTATION] = state.attitude
    values[ANGULAR_VELOCITY] = state.angular_velocity
    for first, variance in ((7, attitude_variance), (49, rate_variance)):
        if variance:
            values[first:first + 36:7] = 3 * (_UNKNOWN,) + 3 * (variance,)
    return ODOMETRY.encode(state.time_ns, space_frame, values, body_frame)


def imu(time_ns: int, body_frame: str, state: State, errors: ImuErrors = _NO_ERRORS) -> bytes:
    """Return an Imu with a stamp, with what an IMU measures of a state; see `imu_values`."""
    values = imu_values(np.array([time_ns]), state.attitude[None], state.angular_velocity[None],
                        errors)
    return IMU.encode(time_ns, body_frame, values[0])


def imu_values(stamps_ns: NDArray[np.int64], attitude: Floats, angular_velocity: Floats,
               errors: ImuErrors = _NO_ERRORS) -> Floats:
    """
    Return the doubles of Imu messages with attitude and body rates, and no acceleration.

    Parameters
    ----------
    stamps_ns, attitude, angular_velocity : array
        As for `ImuErrors.measured`.
    errors : ImuErrors
        Covariances are those of its noise. Without noise they are zero, which means unknown.

    Returns
    -------
    array, shape (n, 37)

    """
    values = np.zeros((len(attitude), IMU.doubles))
    values[:, 0:4], values[:, 13:16] = errors.measured(stamps_ns, attitude, angular_velocity)
    values[:, 4:13:4], values[:, 16:25:4] = errors.attitude_variance, errors.rate_variance
    values[:, 28] = -1.0  # linear_acceleration_covariance[0]: no measurement
    return values


def transform(state: State, space_frame: str, body_frame: str) -> bytes:
    """Return the transform from body coordinates to space coordinates, as a TFMessage."""
    return TRANSFORM.encode(state.time_ns, space_frame, transform_values(state.attitude[None])[0],
                            body_frame)


def transform_values(attitude: Floats) -> Floats:
    """Return the doubles of transforms, (n, 7), for attitudes (n, 4)."""
    return np.pad(attitude, ((0, 0), (3, 0)))


@lru_cache
def _around_stamp(kind: MessageType, frame_id: str, child_frame_id: str) -> tuple[bytes, bytes]:
    # Return the bytes of a message before its stamp, and between its stamp and its doubles.
    head = b'\1\0\0\0' if kind.is_list else b''
    begin, body = len(head) + 8, b''
    for name in (frame_id, child_frame_id)[:1 + kind.has_child_frame]:
        text = name.encode() + b'\0'
        body += bytes(-(begin + len(body)) % 4) + struct.pack('<I', len(text)) + text
    body += bytes(-(begin + len(body)) % 4) + kind.before_doubles
    return b'\0\1\0\0' + head, body + bytes(-(begin + len(body)) % 8)


def _nested(name: str) -> list[str]:
    # Return the types that a definition uses, each once, after the type that uses it first.
    found: list[str] = []
    for line in _FIELDS[name].splitlines():
        field = line.split()[0].removesuffix('[]')
        part = field if '/' in field else f'{name.split("/")[0]}/{field}'
        if part in _FIELDS:
            found += [part, *_nested(part)]
    return list(dict.fromkeys(found))


def _string(body: memoryview, offset: int, order: str) -> tuple[str, int]:
    offset += -offset % 4
    size, = struct.unpack_from(order + 'I', body, offset)
    start, end = offset + 4, offset + 4 + size
    if not 1 <= size <= len(body) - start:
        raise ValueError(f'invalid string length: {size} bytes')
    return str(body[start:end - 1], 'utf-8'), end
