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
Write logs of PX4, and messages of px4_msgs.

Logs are as docs.px4.io/main/en/dev_log/ulog_file_format specifies them.
"""

import struct

from bags import Sent, STORE
import numpy as np
from rosbags.typesys import get_types_from_msg

FORMATS = {
    'vehicle_attitude': 'uint64_t timestamp;uint64_t timestamp_sample;float[4] q;'
                        'float[4] delta_q_reset;uint8_t quat_reset_counter;uint8_t[7] _padding0;',
    'vehicle_angular_velocity': 'uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;'
                                'float[3] xyz_derivative;',
    'vehicle_torque_setpoint': 'uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;'
                               'uint8_t[4] _padding0;',
    'actuator_controls_0': 'uint64_t timestamp;uint64_t timestamp_sample;float[8] control;',
    'sensor_combined': 'uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;',
    'vehicle_land_detected': 'uint64_t timestamp;bool landed;uint8_t[7] others;',
    'battery_status': 'uint64_t timestamp;float voltage_v;'}
#: Bytes after the vectors, without the padding at the end.
_AFTER = {'vehicle_attitude': struct.pack('<4fB', 0, 0, 0, 0, 0),
          'vehicle_angular_velocity': bytes(12), 'vehicle_torque_setpoint': b'',
          'actuator_controls_0': bytes(20), 'sensor_combined': bytes(4),
          'vehicle_land_detected': b'', 'battery_status': b''}


def message(kind, content):
    return struct.pack('<HB', len(content), ord(kind)) + content


def dropout(milliseconds):
    return message('O', struct.pack('<H', milliseconds))


def write(path, topics, more=()):
    """
    Write a log.

    A topic is a name, or a name and the number of an instance. Its rows contain the time of
    logging (us), the time of sampling (us, if the topic has it) or whether the vehicle has landed,
    and the numbers.
    """
    parts = [b'ULog\x01\x12\x35\x01', struct.pack('<Q', 0), message('B', bytes(40)),
             *(message('F', f'{name}:{fields}'.encode()) for name, fields in FORMATS.items())]
    rows = []
    for number, (topic, samples) in enumerate(topics.items()):
        name, instance = topic if isinstance(topic, tuple) else (topic, 0)
        parts.append(message('A', struct.pack('<BH', instance, number) + name.encode()))
        for *times, vector in samples:
            data = struct.pack(f'<H{len(times)}Q{len(vector)}f', number, *times, *vector)
            rows.append((times[0], message('D', data + _AFTER[name])))
    rows.sort(key=lambda row: row[0])
    path.write_bytes(b''.join([*parts, *(data for _, data in rows), *more]))
    return path


#: The definitions of px4_msgs, as in PX4 v1.14 to v1.17, with comments and constants.
_TIMES = 'uint64 timestamp # time since system start (microseconds)\nuint64 timestamp_sample\n'
DEFINITIONS = {
    'VehicleAttitude': 'uint32 MESSAGE_VERSION = 0\n' + _TIMES + 'float32[4] q # w, x, y, z\n'
                       'float32[4] delta_q_reset\nuint8 quat_reset_counter\n# TOPICS a b\n',
    'VehicleAngularVelocity': _TIMES + 'float32[3] xyz\nfloat32[3] xyz_derivative\n',
    'VehicleTorqueSetpoint': _TIMES + 'float32[3] xyz\n',
    'SensorCombined': 'uint64 timestamp\nint32 RELATIVE_TIMESTAMP_INVALID = 2147483647\n'
                      'float32[3] gyro_rad\nuint32 gyro_integral_dt\n'
                      'int32 accelerometer_timestamp_relative\nfloat32[3] accelerometer_m_s2\n'
                      'uint32 accelerometer_integral_dt\nuint8 accelerometer_clipping\n'
                      'uint8 gyro_clipping\nuint8 accel_calibration_count\n'
                      'uint8 gyro_calibration_count\n',
    'VehicleOdometry': _TIMES + 'uint8 pose_frame\nuint8 POSE_FRAME_NED = 1\n'
                       'float32[3] position\nfloat32[4] q\nuint8 velocity_frame\n'
                       'float32[3] velocity\nfloat32[3] angular_velocity\n'
                       'float32[3] position_variance\nfloat32[3] orientation_variance\n'
                       'float32[3] velocity_variance\nuint8 reset_counter\nint8 quality\n',
    # Another version: more fields, one of them before those that are read.
    'ActuatorControls': 'uint8 group\n' + _TIMES + 'bool is_saturated\nfloat32[8] control\n'
                        'float64[3] others\n'}
for _name, _text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(_text, f'px4_msgs/msg/{_name}'))


def sent(topic, name, times, **vectors):
    """
    Return messages of px4_msgs; the fields that are not given contain other numbers.

    `times` contains pairs of the times of publication and sampling, us, and `vectors` contains
    arrays of shape (n, length).
    """
    kind = f'px4_msgs/msg/{name}'
    others = {field: _other(*node) for field, node in STORE.fielddefs[kind][1]}
    return [Sent(topic, STORE.types[kind](**others | {
        field: each for field, each in zip(('timestamp', 'timestamp_sample'), time)
        if field in others} | {field: rows[number] for field, rows in vectors.items()}),
        1000 * time[0]) for number, time in enumerate(times)]


def _other(nodetype, content):
    if nodetype.name == 'ARRAY':
        (_, (number, _)), length = content
        return np.full(length, 3, number)
    return content[0] == 'bool' or 3
