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

"""Read attitude, angular velocity and torque from PX4 logs (ULog), using pyulog."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from functools import lru_cache
from io import StringIO
import os
from pathlib import Path
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.messages import MessageType, PX4_TYPES, Px4Type
from rigid_body_ros.recording.bulk import BadMessageError, nanoseconds, Raw
from rigid_body_ros.recording.file import File
from rigid_body_ros.runtime.limits import open_file

_SUFFIXES = '.ulg', '.ulog'
#: The type of each topic, as in px4_msgs.
_TOPICS = {
    'vehicle_attitude': 'VehicleAttitude', 'vehicle_attitude_groundtruth': 'VehicleAttitude',
    'vehicle_angular_velocity': 'VehicleAngularVelocity',
    'vehicle_angular_velocity_groundtruth': 'VehicleAngularVelocity',
    'sensor_combined': 'SensorCombined', 'vehicle_torque_setpoint': 'VehicleTorqueSetpoint',
    'actuator_controls_0': 'ActuatorControls'}
#: Topics that are read only if a log lacks another topic, which older versions of PX4 do not log.
_REPLACED = {'sensor_combined': 'vehicle_angular_velocity',
             'actuator_controls_0': 'vehicle_torque_setpoint'}
_LANDED = 'vehicle_land_detected'
#: Number of messages in a block.
_BLOCK = 8192
#: Errors that pyulog raises for a damaged file.
_ERRORS = (AttributeError, LookupError, OSError, RecursionError, TypeError, ValueError,
           struct.error)


def is_ulog(path: str | Path) -> bool:
    """Return whether a file is a PX4 log, according to its suffix."""
    return Path(path).suffix.lower() in _SUFFIXES


class _Topic(NamedTuple):
    """The messages on a topic: their type, stamps, logging times, and doubles, shape (n, d)."""

    kind: Px4Type
    stamps_ns: NDArray[np.int64]
    logged_ns: NDArray[np.int64]
    values: Floats


class UlogFile(File):
    """
    A PX4 log, read as messages in the frames that PX4 uses.

    `messages.Px4Type` describes the frames and units. Times are counted from the boot of the
    autopilot. Measurements are stamped with the time at which they were sampled, and torques with
    the time at which they were published.

    Attributes
    ----------
    flight_ns : tuple of int, optional
        The begin and the end of the longest flight, ns, as the land detector reports them. A
        flight that does not end in the log ends at the last message that is read. None if the log
        has no reports, or if the vehicle was never or always in the air.

    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with open_file(path, 'recording') as stream:
            about = os.fstat(stream.fileno())
        identity = about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns
        self._topics, self.damage, self.flight_ns = _parsed(path, identity)
        self.types = {name: topic.kind.name for name, topic in self._topics.items()}

    def count(self, topic: str) -> int:
        """Return the number of messages on a topic."""
        return len(self._topics[topic].stamps_ns)

    def read(self, topic: str, kind: MessageType) -> Iterator[Raw]:
        """Generate the messages of a topic in blocks; see `File.read`."""
        px4, stamps_ns, logged_ns, values = self._topics[topic]
        for first in range(0, len(stamps_ns), _BLOCK):
            rows = slice(first, first + _BLOCK)
            yield Raw.from_values(px4.like, stamps_ns[rows], values[rows], logged_ns[rows])


@lru_cache(1)  # a command reads several topics, and pyulog reads the whole file each time
def _parsed(path: Path, identity: tuple[int, ...]
            ) -> tuple[Mapping[str, _Topic], str, tuple[int, int] | None]:
    """
    Return the topics in a file, a description of the data that was lost, and the longest flight.

    `identity` is part of the cache key, so that a file is read again if it changes.
    """
    from pyulog import ULog
    from pyulog.exceptions import ULogException
    try:
        with open_file(path, 'recording') as stream, redirect_stdout(StringIO()):
            log = ULog(stream, [*_TOPICS, _LANDED])
    except (ULogException, *_ERRORS) as error:
        raise InputError(f'{path}: expected a log of PX4 (ULog): {reason(error)}') from error
    topics, flight_ns = {}, None
    names = {dataset.name for dataset in log.data_list}
    for dataset in log.data_list:
        name, data = dataset.name, dataset.data
        if name == _LANDED and {'timestamp', 'landed'} <= data.keys():
            flight_ns = _flight(data, log.last_timestamp)
        elif name in _TOPICS and _REPLACED.get(name) not in names:
            kind = PX4_TYPES[_TOPICS[name]]
            name += f'_{dataset.multi_id}' if dataset.multi_id else ''
            last = {f'{vector}[{len(columns) - 1}]' for vector, columns in kind.vectors.items()}
            if {'timestamp', *last} <= data.keys():
                topics[name] = _topic(f'{path}: {name}', data, kind)
    lost = [f'{len(log.dropouts)} dropouts of the logger, together '
            f'{sum(dropout.duration for dropout in log.dropouts)} ms'] if log.dropouts else []
    lost += ['damaged: parts cannot be read'] * bool(log.file_corruption)
    return topics, '; '.join(lost), flight_ns


def _topic(where: str, data: Mapping[str, NDArray[Any]], kind: Px4Type) -> _Topic:
    vectors = {name: np.column_stack([data[f'{name}[{k}]'] for k in range(len(columns))])
               for name, columns in kind.vectors.items()}
    unknown = {'timestamp_sample': np.zeros_like(data['timestamp'])}  # before v1.11
    stamps_us, values = kind.contents(unknown | {**data} | vectors)
    try:
        return _Topic(kind, nanoseconds(stamps_us), nanoseconds(data['timestamp']), values)
    except BadMessageError as error:
        raise InputError(f'{where}: message {error.row + 1}: {error}') from error


def _flight(data: Mapping[str, NDArray[Any]], end_us: int) -> tuple[int, int] | None:
    """Return the begin and the end of the longest flight, ns; see `UlogFile.flight_ns`."""
    landed = data['landed'].astype(bool)
    if landed.all() or not landed.any():
        return None
    changes = np.flatnonzero(np.diff(landed, prepend=True, append=True))
    times_us = np.append(data['timestamp'], end_us).astype(np.int64)[changes].reshape(-1, 2)
    begin_us, end_us = times_us[np.argmax(times_us[:, 1] - times_us[:, 0])].tolist()
    return begin_us * 1000, end_us * 1000
