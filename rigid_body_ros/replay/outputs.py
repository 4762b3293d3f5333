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

"""Write the topics and the messages of a replayed motion."""

from __future__ import annotations

from collections.abc import Collection
import json
from pathlib import Path

from rigid_body_ros import messages, recording
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording import ANGULAR_VELOCITY, ATTITUDE, Column
from rigid_body_ros.replay import markers
from rigid_body_ros.replay.batches import Batch, IMU, INPUT, MARKERS, Request, TF
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME

_EULER_ANGLES, _ROTOR_MOMENTUM = '/euler_angles', '/rotor_momentum'
_WHEEL_STATES = '/wheel_states'
_TOPICS = {ATTITUDE: messages.QUATERNION, _EULER_ANGLES: messages.VECTOR3,
           ANGULAR_VELOCITY: messages.VECTOR3}
_IMU_DATA, _TF = '/imu/data', '/tf'
_ALSO = {IMU: {_IMU_DATA: messages.IMU}, TF: {_TF: messages.TRANSFORM}, MARKERS: markers.TOPICS}


def check_names(also: Collection[str]) -> None:
    """Raise InputError if `also` contains a name that is not the name of an additional output."""
    known = *_ALSO, INPUT
    for name in also:
        if name not in known:
            raise InputError(f'also: expected some of {", ".join(known)}, found {name!r}')


def topics(request: Request) -> dict[str, MessageType]:
    """Return the topics that the output will contain, with their types."""
    found = dict(_TOPICS)
    if request.scene.has_rotors:
        found[_ROTOR_MOMENTUM] = messages.VECTOR3
    if names := [wheel.name for wheel in request.scene.named_wheels]:
        found[_WHEEL_STATES] = messages.joint_states(names)
    for name in request.also:
        found.update(_ALSO.get(name, {}))  # 'input' copies existing topics
    return found


def add_topics(writer: recording.Writer, request: Request) -> None:
    """Add the topics of the motion and its metadata to a recording."""
    for topic, kind in topics(request).items():
        writer.add_topic(topic, kind)
    writer.add_metadata(NAME, {
        'fingerprint': json.dumps(fingerprint()), 'scene': json.dumps(dict(request.scene.values)),
        'interpolation': request.interpolation,
        # A file name may contain bytes that cannot be decoded to text.
        'torques': Path(request.path).name.encode(errors='replace').decode()})


def write(writer: recording.Writer, request: Request, batch: Batch, delay_ns: int = 0) -> None:
    """Write a part of a motion; the log times are `delay_ns` later than the stamps."""
    scene, trajectory = request.scene, batch.trajectory
    space, body, sequence = scene.space_frame, scene.body_frame, scene.euler_sequence
    attitude, rates = trajectory.attitude, trajectory.angular_velocity
    columns = [Column(ATTITUDE, space, attitude),
               Column(_EULER_ANGLES, space, trajectory.euler_angles(sequence)),
               Column(ANGULAR_VELOCITY, body, rates)]
    if scene.has_rotors:
        columns.append(Column(_ROTOR_MOMENTUM, body, trajectory.rotor_momentum))
    if scene.named_wheels:
        columns.append(Column(_WHEEL_STATES, '', messages.joint_values(
            trajectory.wheel_speeds, trajectory.wheel_efforts)))
    if IMU in request.also:
        columns.append(Column(_IMU_DATA, body, messages.imu_values(
            trajectory.times_ns, batch.sensed.attitude, batch.sensed.angular_velocity,
            scene.imu)))
    if TF in request.also:
        columns.append(Column(_TF, space, messages.transform_values(attitude), body))
    if MARKERS in request.also:
        columns += markers.columns(trajectory, space)
    writer.write_columns(trajectory.times_ns, columns, delay_ns)
