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

"""Write the errors of all samples of a comparison into a recording."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from rigid_body_ros import messages
from rigid_body_ros.comparison.errors import Errors
from rigid_body_ros.comparison.result import Comparison
from rigid_body_ros.recording import Column, Writer, writer_of
from rigid_body_ros.runtime.fingerprint import fingerprint, NAME

ROTATION_VECTOR, ANGULAR_VELOCITY = '/error/rotation_vector', '/error/angular_velocity'
RESIDUAL_TORQUE = '/residual_torque'


def write(path: str | Path, comparison: Comparison, body_frame: str) -> None:
    """
    Write the errors and the residual torque of a comparison to a recording.

    Parameters
    ----------
    path : str or Path
        The recording to write: an MCAP file if the name ends in .mcap, otherwise a new rosbag2
        folder.
    comparison : Comparison
        The comparison. Messages are stamped with the clock of the motion, and all sensors share
        the same error topics.
    body_frame : str
        The frame_id of all messages.

    Raises
    ------
    InputError
        The recording cannot be written.

    """
    with writer_of(path) as writer:
        for topic in (ROTATION_VECTOR, ANGULAR_VELOCITY):
            writer.add_topic(topic, messages.VECTOR3)
        writer.add_topic(RESIDUAL_TORQUE, messages.WRENCH)
        writer.add_metadata(NAME, {'fingerprint': json.dumps(fingerprint()),
                                   'alignment': json.dumps(comparison.alignment.as_dict()),
                                   'alignments': json.dumps({
                                       sensor.topic: one.of_sensor() for one, sensor in zip(
                                           comparison.alignments, comparison.measured)})})
        for errors in comparison.errors:
            _write_errors(writer, errors, body_frame)
        if comparison.residual_torque:
            torques = comparison.residual_torque.torques
            values = np.hstack([np.zeros_like(torques), torques])
            writer.write_columns(comparison.residual_torque.times_ns,
                                 [Column(RESIDUAL_TORQUE, body_frame, values)])


def _write_errors(writer: Writer, errors: Errors, body_frame: str) -> None:
    columns = [Column(topic, body_frame, values) for topic, values in
               ((ROTATION_VECTOR, errors.rotation_vectors), (ANGULAR_VELOCITY, errors.rates))
               if values is not None]
    writer.write_columns(errors.times_ns, columns)
