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
from contextlib import closing, ExitStack
from itertools import count
import os
from pathlib import Path
import sqlite3

import numpy as np
from rigid_body_ros.common.errors import InputError, quoted, reason, shortened
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import File
from rigid_body_ros.recording.unpack import copy_file, temporary
from rigid_body_ros.runtime.reading import open_file

#: Messages of a block, and bytes of their data.
_BLOCK, _BYTES = 8192, 2 ** 24
#: Bytes of a message: only a frame_id makes one longer than 1 kB.
_LARGEST = 2 ** 24
#: Where in a file its journal mode is, and that of a write-ahead log.
_MODE_PLACE, _WRITE_AHEAD = 18, b'\2\2'
#: Instructions of SQLite between two checks, and for each byte of a file: reading a message of
#: 30 bytes takes about 30. Damaged pages that refer to each other could keep it busy for ever.
_STEPS, _STEPS_A_BYTE = 100_000, 100
_ENTANGLED = 'its pages refer to each other: they would give more than the file can hold'
#: By what SQLite says. It could delete any file that a -journal names: none is applied here.
_REASONS = {'interrupted': _ENTANGLED, 'attempt to write a readonly database':
            'its recorder was killed and left a -journal; repair it with: sqlite3 FILE .tables'}
_MESSAGES = """
    SELECT timestamp, CASE WHEN typeof(timestamp) = 'integer' AND typeof(data) = 'blob'
                            AND length(data) <= ? THEN data END
    FROM messages JOIN topics ON topic_id = topics.id WHERE name = ? ORDER BY messages.id"""


class SqliteFile(File):
    """
    A SQLite file of rosbag2.

    It is opened for reading only, and nothing is written beside it: if a recorder that was killed
    left a write-ahead log, both are copied to a temporary folder, which the stack removes.
    """

    def __init__(self, path: Path, unpacked: Path, stack: ExitStack) -> None:
        super().__init__(path, unpacked)
        try:
            self._lost = self._settled(stack)
            with closing(self._opened()) as database:
                self.types, self._formats = self._topics(database)
                self._counts = dict(database.execute(
                    'SELECT name, COUNT(*) FROM messages JOIN topics ON topic_id = topics.id '
                    'GROUP BY name'))
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise InputError(f'{path}: expected a bag of rosbag2 in SQLite, found none '
                             f'({_reason(error)})') from error

    def count(self, topic: str) -> int:
        """Return how many messages a topic has."""
        return int(self._counts.get(topic, 0))

    def read(self, topic: str) -> Iterator[Raw]:
        """Generate the messages of a topic, in the order of the file."""
        if self._formats[topic] != 'cdr':
            raise InputError(f'{self.path}: {topic}: expected the message encoding cdr, '
                             f'found {quoted(self._formats[topic])}')
        number, self.damage = 0, self._lost
        try:
            with closing(self._opened()) as database:
                for block in self._blocks(database, topic):
                    yield _raw(block)
                    number += len(block)
        except sqlite3.Error as error:
            self.damage = f'damaged after {number} messages of {shortened(topic, 100)} ' \
                          f'({_reason(error)})'

    def _settled(self, stack: ExitStack) -> str:
        """Copy a file that has a write-ahead log, and apply that; return what was lost."""
        place = Path(os.path.realpath(self._place))  # SQLite looks for its log there
        log = Path(f'{place}-wal')
        if not os.path.exists(log) or not os.path.getsize(log):
            return ''
        folder = temporary(stack)
        copy_file(log, folder)
        self._place = copy_file(place, folder)
        with closing(sqlite3.connect(self._place)) as database:
            _, pages, _ = database.execute('PRAGMA wal_checkpoint(FULL)').fetchone()
            database.execute('PRAGMA journal_mode=DELETE').fetchone()
        return '' if pages > 0 else f'nothing of {log.name} could be used'

    def _opened(self) -> sqlite3.Connection:
        with open_file(self._place, 'recording') as stream:
            size = self._size = os.fstat(stream.fileno()).st_size
            stream.seek(_MODE_PLACE)
            # Otherwise SQLite would create a log in the folder of the file.
            options = '&immutable=1' if stream.read(2) == _WRITE_AHEAD else ''
        database = sqlite3.connect(f'{self._place.resolve().as_uri()}?mode=ro{options}', uri=True)
        database.execute('PRAGMA trusted_schema=OFF')
        steps = count(0, _STEPS)
        database.set_progress_handler(
            lambda: next(steps) > _STEPS + size * _STEPS_A_BYTE, _STEPS)
        return database

    def _topics(self, database: sqlite3.Connection) -> tuple[dict[str, str], dict[str, str]]:
        """Return the type and the encoding of each topic."""
        for table in ('topics', 'messages'):
            # 0 is an ordinary column; others are computed, or those of a virtual table.
            hidden = [row[-1] for row in database.execute(f'PRAGMA table_xinfo({table})')]
            # Before version 3.37, SQLite does not list tables.
            kinds = {row[2] for row in database.execute(f'PRAGMA table_list({table})')}
            if any(hidden) or not kinds <= {'table'}:
                raise sqlite3.DatabaseError(f'{table} is not an ordinary table')
        types, formats, size = {}, {}, 0
        for row in database.execute('SELECT name, type, serialization_format FROM topics'):
            if not all(isinstance(value, str) for value in row):
                raise sqlite3.DatabaseError('expected name, type and encoding of a topic, found '
                                            f'{quoted(row)}')
            name, types[row[0]], formats[row[0]] = row
            size += len(name)
            self._check_size(size)
        return types, formats

    def _blocks(self, database: sqlite3.Connection,
                topic: str) -> Iterator[list[tuple[int, bytes]]]:
        block: list[tuple[int, bytes]] = []
        size, problem = 0, None
        try:
            for row in self._rows(database, topic):
                block.append(row)
                size += len(row[1])
                if len(block) == _BLOCK or size > _BYTES:
                    yield block
                    block, size = [], 0
        except sqlite3.Error as error:
            problem = error
        if block:
            yield block
        if problem:
            raise problem

    def _rows(self, database: sqlite3.Connection, topic: str) -> Iterator[tuple[int, bytes]]:
        size = 0
        for time_ns, data in database.execute(_MESSAGES, (_LARGEST, topic)):
            if data is None:
                raise sqlite3.DatabaseError('expected a message with an integer as its time and '
                                            f'at most {_LARGEST} bytes, found another')
            size += len(data)
            self._check_size(size)
            yield time_ns, data

    def _check_size(self, size: int) -> None:
        if size > self._size:
            raise sqlite3.DatabaseError(_ENTANGLED)


def _reason(error: Exception) -> str:
    return _REASONS.get(str(error)) or reason(error)


def _raw(block: list[tuple[int, bytes]]) -> Raw:
    times, messages = zip(*block)
    log_ns = np.array(times, np.int64)
    return Raw.of(messages, log_ns, log_ns)
