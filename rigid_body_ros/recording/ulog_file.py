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
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import File
from rigid_body_ros.runtime.limits import open_file

_SUFFIXES = '.ulg', '.ulog'
_XYZ = 'xyz[0]', 'xyz[1]', 'xyz[2]'
#: For each PX4 topic: the type that its messages are converted to, and the ULog fields that
#: provide the last doubles of each message.
_QUATERNION = messages.QUATERNION, ('q[1]', 'q[2]', 'q[3]', 'q[0]')
_RATE, _TORQUE = (messages.VECTOR3, _XYZ), (messages.WRENCH, _XYZ)
_TOPICS: dict[str, tuple[MessageType, tuple[str, ...]]] = {
    'vehicle_attitude': _QUATERNION, 'vehicle_attitude_groundtruth': _QUATERNION,
    'vehicle_angular_velocity': _RATE, 'vehicle_angular_velocity_groundtruth': _RATE,
    'vehicle_torque_setpoint': _TORQUE}
#: Number of messages in a block.
_BLOCK = 8192
#: The latest time that a log may contain, us.
_LAST_US = messages.LAST_NS // 1000
#: Errors that pyulog raises for a damaged file.
_ERRORS = (AttributeError, LookupError, OSError, RecursionError, TypeError, ValueError,
           struct.error)


def is_ulog(path: str | Path) -> bool:
    """Return whether a file is a PX4 log, according to its suffix."""
    return Path(path).suffix.lower() in _SUFFIXES


class _Topic(NamedTuple):
    """The messages on a topic: their type, stamps, logging times, and doubles, shape (n, d)."""

    kind: MessageType
    stamps_ns: NDArray[np.int64]
    logged_ns: NDArray[np.int64]
    values: Floats


class UlogFile(File):
    """
    A PX4 log, read as messages in the frames that PX4 uses.

    The body axes are front, right, down, and the space axes are north, east, down. An attitude q
    rotates from body to space axes, as in PX4, but its components are reordered from scalar first
    to scalar last. Torques are normalized; they are not in N m. Times are counted from the boot
    of the autopilot. Measurements are stamped with the time at which they were sampled, and
    torques with the time at which they were published.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with open_file(path, 'recording') as stream:
            about = os.fstat(stream.fileno())
        identity = about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns
        self._topics, self.damage = _parsed(path, identity)
        self.types = {name: topic.kind.name for name, topic in self._topics.items()}

    def count(self, topic: str) -> int:
        """Return the number of messages on a topic."""
        return len(self._topics[topic].stamps_ns)

    def read(self, topic: str, kind: MessageType) -> Iterator[Raw]:
        """Generate the messages of a topic in blocks; see `File.read`."""
        found = self._topics[topic]
        for first in range(0, len(found.stamps_ns), _BLOCK):
            rows = slice(first, first + _BLOCK)
            yield Raw.from_values(kind, found.stamps_ns[rows], found.values[rows],
                                  found.logged_ns[rows])


@lru_cache(1)  # a command reads several topics, and pyulog reads the whole file each time
def _parsed(path: Path, identity: tuple[int, ...]) -> tuple[Mapping[str, _Topic], str]:
    """
    Return the topics in a file, and a description of the data that was lost.

    `identity` is part of the cache key, so that a file is read again if it changes.
    """
    from pyulog import ULog
    from pyulog.exceptions import ULogException
    try:
        with open_file(path, 'recording') as stream, redirect_stdout(StringIO()):
            log = ULog(stream, [*_TOPICS])
    except (ULogException, *_ERRORS) as error:
        raise InputError(f'{path}: expected a log of PX4 (ULog): {reason(error)}') from error
    found = {}
    for each in log.data_list:
        kind, fields = _TOPICS[each.name]
        if {'timestamp', *fields} <= each.data.keys():
            name = f'{each.name}_{each.multi_id}' if each.multi_id else each.name
            found[name] = _topic(f'{path}: {name}', each.data, kind, fields)
    lost = [f'{len(log.dropouts)} dropouts of the logger, together '
            f'{sum(each.duration for each in log.dropouts)} ms'] if log.dropouts else []
    return found, '; '.join(lost + ['damaged: parts cannot be read'] * bool(log.file_corruption))


def _topic(where: str, data: Mapping[str, NDArray[Any]], kind: MessageType,
           fields: tuple[str, ...]) -> _Topic:
    logged_ns = _nanoseconds(where, data['timestamp'])
    stamps_ns = logged_ns
    if kind is not messages.WRENCH and 'timestamp_sample' in data:
        sampled_ns = _nanoseconds(where, data['timestamp_sample'])
        stamps_ns = np.where(sampled_ns > 0, sampled_ns, logged_ns)
    values = np.zeros((len(logged_ns), kind.doubles))
    values[:, -len(fields):] = np.column_stack([data[name] for name in fields])
    return _Topic(kind, stamps_ns, logged_ns, values)


def _nanoseconds(where: str, times_us: NDArray[np.uint64]) -> NDArray[np.int64]:
    late = np.flatnonzero(times_us > _LAST_US)
    if late.size:
        raise InputError(f'{where}: message {late[0] + 1}: expected a time up to {_LAST_US} us, '
                         f'found {times_us[late[0]]} us')
    return times_us.astype(np.int64) * 1000
