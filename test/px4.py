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

"""Write logs of PX4, as docs.px4.io/main/en/dev_log/ulog_file_format specifies them."""

import struct

FORMATS = {
    'vehicle_attitude': 'uint64_t timestamp;uint64_t timestamp_sample;float[4] q;'
                        'float[4] delta_q_reset;uint8_t quat_reset_counter;uint8_t[7] _padding0;',
    'vehicle_angular_velocity': 'uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;'
                                'float[3] xyz_derivative;',
    'vehicle_torque_setpoint': 'uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;'
                               'uint8_t[4] _padding0;',
    'battery_status': 'uint64_t timestamp;float voltage_v;'}
#: Bytes after the vectors, without the padding at the end.
_AFTER = {'vehicle_attitude': struct.pack('<4fB', 0, 0, 0, 0, 0),
          'vehicle_angular_velocity': bytes(12), 'vehicle_torque_setpoint': b'',
          'battery_status': b''}


def message(kind, content):
    return struct.pack('<HB', len(content), ord(kind)) + content


def dropout(milliseconds):
    return message('O', struct.pack('<H', milliseconds))


def write(path, topics, more=()):
    """
    Write a log.

    A topic is a name, or a name and the number of an instance. Its rows contain the time of
    logging (us), the time of sampling (us, not for a battery), and the numbers.
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
