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

"""Convert states, torques and inertias to messages and back; interpret the messages' frame_ids."""

from __future__ import annotations

from collections.abc import Iterable
import re

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted
from rigid_body_ros.mechanics.frames import Frame, Frames
from rigid_body_ros.mechanics.imu import ImuErrors
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.messages import kinds
from rigid_body_ros.messages.kinds import MessageType, Stamped

#: The first word in the frame_id of an epoch marker. The start state follows this word.
_EPOCH = '/epoch'
_EPOCH_NUMBERS = re.compile(_EPOCH + ' attitude(' + 4 * r' \S+' + ') rates(' + 3 * r' \S+'
                            + ') rotors(' + 3 * r' \S+' + r')(?: wheels((?: \S+)+))?')
#: The position of the orientation among the doubles of an Odometry message.
ORIENTATION = slice(3, 7)
#: The position of the angular velocity among the doubles of an Odometry message.
ANGULAR_VELOCITY = slice(46, 49)
#: The position of the mass and the centre of mass among the doubles of an InertiaStamped message.
MASS_AND_CENTRE = slice(0, 4)
#: The variance that marks a position (m^2) or linear velocity (m^2/s^2) as not measured.
_UNKNOWN = 1e6
_NO_ERRORS = ImuErrors()
#: The positions of ixx, iyy, izz, ixy, ixz, iyz among the doubles of an InertiaStamped message.
_ENTRIES = [4, 7, 9, 5, 6, 8]


def torque(wrench: Stamped) -> Floats:
    """Return the torque in a WrenchStamped message, N m, shape (3,)."""
    return wrench.values[3:]


def wrench(stamp_ns: int, frame_id: str, torque: Iterable[float]) -> bytes:
    """Encode a WrenchStamped message with a torque, N m, shape (3,), and no force."""
    return kinds.WRENCH.encode(stamp_ns, frame_id, [0.0, 0.0, 0.0, *torque])


def inertia_entries(values: Floats) -> Floats:
    """Return ixx, iyy, izz, ixy, ixz, iyz, shape (..., 6), from the doubles of InertiaStamped."""
    return values[..., _ENTRIES]


def inertia(stamp_ns: int, frame_id: str, entries: ArrayLike) -> bytes:
    """Encode an InertiaStamped message; `entries`, kg m^2, are ordered as in `inertia_entries`."""
    values = np.zeros(kinds.INERTIA.doubles)
    values[_ENTRIES] = entries
    return kinds.INERTIA.encode(stamp_ns, frame_id, values)


def epoch_marker(start: State, kind: MessageType = kinds.WRENCH) -> bytes:
    """
    Encode the marker of an epoch: a message that begins the epoch in a node's log.

    All values in the marker are zero. The stamp of the marker is the time of the start state, and
    its frame_id contains the numbers of that state, with all digits. The frame_id begins with a
    slash, because the name of a tf2 frame cannot begin with a slash.
    """
    groups = {'attitude': start.attitude, 'rates': start.angular_velocity,
              'rotors': start.rotor_momentum}
    if start.wheel_speeds.size:
        groups['wheels'] = start.wheel_speeds
    words = [f'{name} {" ".join(map(repr, values.tolist()))}' for name, values in groups.items()]
    return kind.encode(start.time_ns, f'{_EPOCH} {" ".join(words)}', np.zeros(kind.doubles))


def is_epoch_marker(frame_id: str) -> bool:
    """Return whether a message with this frame_id is an epoch marker (see `epoch_marker`)."""
    return frame_id.startswith(f'{_EPOCH} ')


def epoch_start(stamp_ns: int, frame_id: str) -> State:
    """
    Read the start state from the stamp and frame_id of an epoch marker.

    Raises
    ------
    ValueError
        The frame_id is not in the format written by `epoch_marker`.

    """
    numbers = _EPOCH_NUMBERS.fullmatch(frame_id)
    if not numbers:
        raise ValueError('frame_id: expected the start state of an epoch, '
                         f'found {quoted(frame_id)}')
    return State(stamp_ns, *([float(number) for number in group.split()]
                             for group in numbers.groups('')))


def torque_frame(frame_id: str, body_frame: str, space_frame: str) -> str:
    """
    Return the axes of the torque in a WrenchStamped message: 'body' or 'space'.

    Raises
    ------
    ValueError
        The frame_id is not '', `body_frame` or `space_frame`.

    """
    name = frame_id.removeprefix('/')  # as in ROS 1; names of tf2 have no leading slash
    if name in ('', body_frame):
        return 'body'
    if name == space_frame:
        return 'space'
    raise ValueError(f"frame_id: expected '{body_frame}' or '' (body axes) or "
                     f"'{space_frame}' (space axes), found {quoted(frame_id)}")


def wrench_frame(frame_id: str, body_frame: str, space_frame: str,
                 links: Frames) -> tuple[str, Frame | None]:
    """
    Return the axes of a WrenchStamped message, 'body' or 'space', and the message's link frame.

    The link frame is one of `links`; use it to convert the wrench to a torque about the centre of
    mass. The link frame is None if the torque is already about the centre of mass and the force
    has no effect.

    Raises
    ------
    ValueError
        The frame_id belongs to a link on which forces are not accepted; or it does not belong to
        any link, and `torque_frame` rejects it.

    """
    name = frame_id.removeprefix('/')
    if name not in ('', body_frame, space_frame) and (name in links or name in links.others):
        return 'body', links[name]
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
    Encode an Odometry message with a state's attitude and body rates, and a position of zero.

    If `attitude_variance`, rad^2, is not 0, it becomes the variance of the orientation in the
    message. The variance of the position is then 1e6 m^2, because the position is not an estimate.
    If `rate_variance`, rad^2/s^2, is not 0, it becomes the variance of the angular velocity, and
    the variance of the linear velocity is then 1e6 m^2/s^2.
    """
    values = np.zeros(kinds.ODOMETRY.doubles)
    values[ORIENTATION] = state.attitude
    values[ANGULAR_VELOCITY] = state.angular_velocity
    for first, variance in ((7, attitude_variance), (49, rate_variance)):
        if variance:
            values[first:first + 36:7] = 3 * (_UNKNOWN,) + 3 * (variance,)
    return kinds.ODOMETRY.encode(state.time_ns, space_frame, values, body_frame)


def imu(time_ns: int, body_frame: str, state: State, errors: ImuErrors = _NO_ERRORS) -> bytes:
    """
    Encode an Imu message with the attitude and rates that an IMU measures.

    See `imu_values` for the contents of the message.
    """
    values = imu_values(np.array([time_ns]), state.attitude[None], state.angular_velocity[None],
                        errors)
    return kinds.IMU.encode(time_ns, body_frame, values[0])


def imu_values(stamps_ns: NDArray[np.int64], attitude: Floats, angular_velocity: Floats,
               errors: ImuErrors = _NO_ERRORS) -> Floats:
    """
    Return the doubles for Imu messages with attitude and rates, but without acceleration.

    Parameters
    ----------
    stamps_ns, attitude, angular_velocity : array
        As for `ImuErrors.measured`.
    errors : ImuErrors
        The errors of the IMU. The messages contain the covariances of the IMU noise. If there is
        no noise, the covariances are zero, which means that they are unknown.

    Returns
    -------
    array, shape (n, 37)

    """
    values = np.zeros((len(attitude), kinds.IMU.doubles))
    values[:, 0:4], values[:, 13:16] = errors.measured(stamps_ns, attitude, angular_velocity)
    values[:, 4:13:4], values[:, 16:25:4] = errors.attitude_variance, errors.rate_variance
    values[:, 28] = -1.0  # linear_acceleration_covariance[0]: no measurement
    return values


def transform(state: State, space_frame: str, body_frame: str) -> bytes:
    """Encode the transform from body coordinates to space coordinates as a TFMessage."""
    values, = transform_values(state.attitude[None])
    return kinds.TRANSFORM.encode(state.time_ns, space_frame, values, body_frame)


def transform_values(attitude: Floats) -> Floats:
    """Convert attitudes, shape (n, 4), to the doubles of transforms, shape (n, 7)."""
    return np.pad(attitude, ((0, 0), (3, 0)))
