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

"""Write a replayed motion to a recording or a CSV file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import partial
import json
from pathlib import Path
from typing import TextIO

import numpy as np
from rigid_body_ros import messages, recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.messages import MessageType
from rigid_body_ros.propagation import Trajectory
from rigid_body_ros.recording.text_files import csv_lines
from rigid_body_ros.recording.writer import ANGULAR_VELOCITY, ATTITUDE, Column
from rigid_body_ros.replay import markers
from rigid_body_ros.replay.batches import Batch, IMU, INPUT, MARKERS, Request, TF
from rigid_body_ros.report.text import euler_names
from rigid_body_ros.runtime import files, interrupts
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME
from rigid_body_ros.scene import Scene

#: The suffix of CSV files.
_CSV = '.csv'

_EULER_ANGLES, _ROTOR_MOMENTUM = '/euler_angles', '/rotor_momentum'
_WHEEL_STATES = '/wheel_states'
_TOPICS = {ATTITUDE: messages.QUATERNION, _EULER_ANGLES: messages.VECTOR3,
           ANGULAR_VELOCITY: messages.VECTOR3}
_IMU_DATA, _TF = '/imu/data', '/tf'
_ALSO = {IMU: {_IMU_DATA: messages.IMU}, TF: {_TF: messages.TRANSFORM}, MARKERS: markers.TOPICS}


def suffix_of(output: str | Path) -> str:
    """Return the format of a motion: '.csv', or the format that `recording.suffix_of` returns."""
    return _CSV if files.format_of(output) == _CSV else recording.suffix_of(output)


def check_also(also: Collection[str], output: str | Path | None) -> None:
    """Raise InputError if `also` names an unknown topic, or if the output is a CSV file."""
    names = *_ALSO, INPUT
    for name in also:
        if name not in names:
            raise InputError(f'also: expected some of {", ".join(names)}, found {name!r}')
    if also and output is not None and suffix_of(output) == _CSV:
        raise InputError('--also: expected an MCAP file or a rosbag2 folder as output, because a '
                         f'CSV file has no topics, found {output}')


def topics(request: Request) -> dict[str, MessageType]:
    """Return the topics that the output will contain, with their types."""
    kinds = dict(_TOPICS)
    if request.scene.has_rotors:
        kinds[_ROTOR_MOMENTUM] = messages.VECTOR3
    if names := [wheel.name for wheel in request.scene.named_wheels]:
        kinds[_WHEEL_STATES] = messages.joint_states(names)
    for name in request.also:
        kinds.update(_ALSO.get(name, {}))  # 'input' copies existing topics
    return kinds


@contextmanager
def writing(output: str | Path, request: Request,
            copied: recording.Source | None) -> Iterator[Callable[[Batch, int], None]]:
    """
    Open an output, and give it its final name at the end.

    Yield a function that writes a batch. The second argument of this function is the delay from
    the stamps to the log times, ns. The messages of `copied` are written after the last batch.

    Raises
    ------
    InputError
        The output cannot be written.

    """
    if suffix_of(output) == _CSV:
        with files.atomic_output(output, _CSV) as path, open(path, 'w', encoding='ascii') as text:
            yield lambda batch, _: _write_lines(text, request.scene, batch.trajectory)
            interrupts.check()
        return
    with recording.writer_of(output) as writer:
        for topic, kind in topics(request).items():
            writer.add_topic(topic, kind)
        writer.add_metadata(NAME, {
            'fingerprint': json.dumps(fingerprint()),
            'scene': json.dumps(dict(request.scene.values)),
            'interpolation': request.interpolation,
            # A file name may contain bytes that cannot be decoded to text.
            'torques': Path(request.path).name.encode(errors='replace').decode()})
        yield partial(_write_messages, writer, request)
        if copied:
            copied.copy_to(writer)
        interrupts.check()  # last chance before the output gets its final name


def _write_lines(text: TextIO, scene: Scene, motion: Trajectory) -> None:
    """Write a line for each state of a motion, after a line of headings at the beginning."""
    columns = _columns(scene, motion)
    if not text.tell():
        text.write(f'{",".join(["time_ns", *columns])}\n')
    text.writelines(csv_lines(motion.times_ns, np.hstack([*columns.values()])))


def _columns(scene: Scene, motion: Trajectory) -> dict[str, Floats]:
    """
    Return groups of columns of a CSV file: their headings, and their values, shape (n, d).

    No reader of CSV files takes the additional columns for a time, torque, attitude or rate. The
    spelling `N m` would be ambiguous, because `m` is also the name of a torque.
    """
    sequence = scene.euler_sequence
    angles = ('phi', 'theta', 'psi') if sequence == 'ZXZ' else euler_names(sequence)
    columns = {'qx,qy,qz,qw': motion.attitude,
               ','.join(f'{name} (rad)' for name in angles): motion.euler_angles(sequence),
               'wx (rad/s),wy (rad/s),wz (rad/s)': motion.angular_velocity}
    if scene.has_rotors:
        columns['hx (Nms),hy (Nms),hz (Nms)'] = motion.rotor_momentum
    for number, wheel in enumerate(scene.named_wheels):
        columns[f'speed_{wheel.name} (rad/s),effort_{wheel.name} (Nm)'] = np.column_stack(
            [motion.wheel_speeds[:, number], motion.wheel_efforts[:, number]])
    return columns


def _write_messages(writer: recording.Writer, request: Request, batch: Batch,
                    delay_ns: int) -> None:
    """Write a batch; the log times are `delay_ns` later than the stamps."""
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
