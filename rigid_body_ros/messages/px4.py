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

"""The messages of PX4 that contain attitudes, angular velocities and torques."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.messages.kinds import MessageType, ODOMETRY, QUATERNION, VECTOR3, WRENCH

#: Matches a field of a fixed size. The groups are the type of its numbers, the length of the array
#: (if it is one), and the name.
_FIELD = re.compile(r'(bool|u?int(?:8|16|32|64)|float(?:32|64))(?:\[(\d{1,3})\])? (\w+)')
_TIMES = 'timestamp', 'timestamp_sample'
_TIMED = 'uint64 timestamp, uint64 timestamp_sample, '


@dataclass(frozen=True, eq=False, kw_only=True)
class Px4Type(MessageType):
    """
    A message type of PX4, which logs (ULog) contain and which px4_msgs defines.

    The messages are converted to the type `like`, in the axes of PX4: front, right, down for the
    body, and north, east, down for space. An attitude q rotates from body to space axes; its
    components are reordered from scalar first to scalar last. Angular velocities are in rad/s, and
    torques are normalized: they are not in N m.

    Attributes
    ----------
    vectors : mapping of str to tuple of int
        For each field that is read, the positions of its components among the doubles of `like`.
    fields : str
        The types and names of all fields, as the recording or else PX4 v1.14 to v1.17 defines
        them; ActuatorControls is from v1.13. Fields that are not read may be joined.

    """

    like: MessageType
    vectors: Mapping[str, tuple[int, ...]]
    fields: str

    def defined(self, fields: Iterable[str]) -> Px4Type:
        """Return the type with fields from a recording; raise ValueError if they do not fit."""
        recorded = [*fields]
        for field in self.fields.split(', '):
            if field.split()[1] in (*_TIMES, *self.vectors) and field not in recorded:
                raise ValueError(f'expected {field} in the definition of {self.name}, found none')
        layout(', '.join(recorded))  # raises ValueError if the size of a field is not fixed
        return replace(self, fields=', '.join(recorded))

    def contents(self, fields: Any) -> tuple[NDArray[np.uint64], Floats]:
        """
        Return the stamps of n messages, us, and the doubles of `like`, shape (n, doubles).

        A measurement is stamped with the time at which it was sampled, and a torque with the time
        at which it was published. `fields` maps each name to an array, shape (n,) or (n, length).
        """
        stamps_us = fields['timestamp']
        if self.like is not WRENCH and _TIMES[1] in self.fields:
            stamps_us = np.where(fields[_TIMES[1]] > 0, fields[_TIMES[1]], stamps_us)
        values = np.zeros((len(stamps_us), self.like.doubles))
        for name, columns in self.vectors.items():
            values[:, columns] = fields[name][:, :len(columns)]
        return stamps_us, values


@lru_cache
def layout(fields: str) -> np.dtype[np.void]:
    """
    Return the dtype of a message in CDR, from the end of the encapsulation header.

    The message ends where the last field of the dtype, 'end', begins. Raise ValueError if the size
    of a field is not fixed.
    """
    parts: list[Any] = []
    for field in fields.split(', '):
        part = _FIELD.fullmatch(field)
        if not part:
            raise ValueError(f'expected fields of fixed sizes, found {quoted(field)}')
        number, length, name = part.groups()
        parts.append((name, np.dtype(number).newbyteorder('<'), (int(length),) if length else ()))
    return np.dtype([*parts, ('end', 'u1')], align=True)  # CDR aligns numbers as C does


#: The types, by the last part of their names. A SensorCombined message contains the angular
#: velocity that a gyro measures, including its bias. Before PX4 v1.14, an ActuatorControls message
#: contains the torque, followed by other controls.
PX4_TYPES = {name: Px4Type(f'px4_msgs/msg/{name}', like.doubles, like=like, vectors=vectors,
                           fields=fields)
             for name, like, vectors, fields in (
    ('VehicleAttitude', QUATERNION, {'q': (3, 0, 1, 2)},
     _TIMED + 'float32[4] q, float32[4] delta_q_reset, uint8 quat_reset_counter'),
    ('VehicleAngularVelocity', VECTOR3, {'xyz': (0, 1, 2)},
     _TIMED + 'float32[3] xyz, float32[3] xyz_derivative'),
    ('SensorCombined', VECTOR3, {'gyro_rad': (0, 1, 2)},
     'uint64 timestamp, float32[3] gyro_rad, float32[6] accelerometer, uint8[4] clipping'),
    ('VehicleTorqueSetpoint', WRENCH, {'xyz': (3, 4, 5)}, _TIMED + 'float32[3] xyz'),
    ('ActuatorControls', WRENCH, {'control': (3, 4, 5)}, _TIMED + 'float32[8] control'),
    ('VehicleOdometry', ODOMETRY, {'q': (6, 3, 4, 5), 'angular_velocity': (46, 47, 48)},
     _TIMED + 'uint8 pose_frame, float32[3] position, float32[4] q, uint8 velocity_frame, '
     'float32[3] velocity, float32[3] angular_velocity, float32[9] variances, uint8[2] quality'))}
