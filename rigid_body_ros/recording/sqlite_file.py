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

"""SQLite files of rosbag2: their messages in blocks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
import sqlite3

import numpy as np
from rigid_body_ros.recording import bulk
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import File
from rigid_body_ros.scene import InputError

#: Messages of a block.
_BLOCK = 8192


class SqliteFile(File):
    """A SQLite file of rosbag2."""

    def __init__(self, path: Path, unpacked: Path | None = None) -> None:
        super().__init__(path, unpacked)
        try:
            with closing(self._opened()) as database:
                self.types = dict(database.execute('SELECT name, type FROM topics'))
                self._formats = dict(database.execute(
                    'SELECT name, serialization_format FROM topics'))
                self._counts = dict(database.execute(
                    'SELECT name, COUNT(*) FROM messages JOIN topics ON topic_id = topics.id '
                    'GROUP BY name'))
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise InputError(f'{path}: expected a bag of rosbag2 in SQLite, found none '
                             f'({bulk.one_line(error)})') from error

    def count(self, topic: str) -> int:
        """Return how many messages a topic has."""
        return int(self._counts.get(topic, 0))

    def read(self, topic: str) -> Iterator[Raw]:
        """Generate the messages of a topic, in the order of the file."""
        if self._formats[topic] != 'cdr':
            raise InputError(f'{self.path}: {topic}: expected the message encoding cdr, '
                             f'found {self._formats[topic]!r}')
        count = 0
        try:
            with closing(self._opened()) as database:
                rows = database.execute(
                    'SELECT timestamp, data FROM messages JOIN topics ON topic_id = topics.id '
                    'WHERE name = ? ORDER BY messages.id', (topic,))
                while block := rows.fetchmany(_BLOCK):
                    yield _raw(block)
                    count += len(block)
        except (sqlite3.Error, TypeError, OverflowError) as error:
            self.damage = f'damaged behind {count} messages of {topic} ' \
                          f'({bulk.one_line(error)})'

    def _opened(self) -> sqlite3.Connection:
        return sqlite3.connect(f'{self._place.resolve().as_uri()}?mode=ro', uri=True)


def _raw(block: list[tuple[int, bytes]]) -> Raw:
    times, messages = zip(*block)
    log_ns = np.array(times, np.int64)
    return Raw.of(messages, log_ns, log_ns)
