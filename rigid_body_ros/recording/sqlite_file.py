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

"""Read rosbag2's SQLite files in blocks of messages, without writing to their folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, ExitStack
from itertools import count
import os
from pathlib import Path
import sqlite3

import numpy as np
from rigid_body_ros.common.errors import InputError, quoted, reason, shortened
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.recording.file import File, LONGEST
from rigid_body_ros.recording.unpack import copy_file, temporary
from rigid_body_ros.runtime.files import real_path
from rigid_body_ros.runtime.limits import open_file

#: Largest number of messages in a block, and approximate amount of data in a block, bytes.
_BLOCK, _BYTES = 8192, 2 ** 24
#: Size of the largest message that is read, bytes. A message is smaller than 1 kB unless its
#: frame_id is very long.
_LARGEST = 2 ** 24
#: The offset at which a database file stores its journal mode, and the value that means that the
#: database uses a write-ahead log.
_MODE_OFFSET, _WRITE_AHEAD = 18, b'\2\2'
#: Size of the header of a write-ahead log, bytes.
_LOG_HEAD = 32
#: SQLite may execute at most _STEPS_A_BYTE instructions per byte of the file. The number of
#: instructions is checked every _STEPS instructions. A message of 30 bytes takes about 30
#: instructions. Without the limit, reading would never end if damaged pages referred to each
#: other.
_STEPS, _STEPS_A_BYTE = 100_000, 100
_TOO_MUCH = 'its pages are damaged: they yield more data than the file can hold'
#: Explanations of SQLite errors. A rollback journal (-journal) is never applied, because applying
#: it could delete any file that is named in the journal.
_REASONS = {'interrupted': _TOO_MUCH, 'attempt to write a readonly database':
            'the recorder was killed and left a -journal; apply it with: sqlite3 FILE .tables'}
_MESSAGES = """
    SELECT timestamp, CASE WHEN typeof(timestamp) = 'integer' AND typeof(data) = 'blob'
                            AND length(data) <= ? THEN data END
    FROM messages JOIN topics ON topic_id = topics.id WHERE name = ? ORDER BY messages.id"""
_DEFINITIONS = """
    SELECT CAST(encoding AS TEXT), CAST(substr(encoded_message_definition, 1, ?) AS BLOB)
    FROM message_definitions WHERE topic_type = ?"""


class SqliteFile(File):
    """
    A SQLite file written by rosbag2.

    The file is opened read-only, and nothing is written to its folder. A recorder that was killed
    may have left a write-ahead log. In that case, both the file and the log are copied to a
    temporary folder, which is removed when `stack` is closed.
    """

    def __init__(self, path: Path, unpacked: Path, stack: ExitStack) -> None:
        super().__init__(path, unpacked)
        try:
            self._lost = self._apply_log(stack)
            with closing(self._open()) as database:
                self.types, self._formats = self._topics(database)
                self._counts = dict(database.execute(
                    'SELECT name, COUNT(*) FROM messages JOIN topics ON topic_id = topics.id '
                    'GROUP BY name'))
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise InputError(f'{path}: expected a SQLite file of rosbag2 '
                             f'({_reason(error)})') from error

    def count(self, topic: str) -> int:
        """Return the number of messages on a topic."""
        return int(self._counts.get(topic, 0))

    def read(self, topic: str, kind: MessageType) -> Iterator[Raw]:
        """Generate the messages of a topic in blocks; see `File.read`."""
        if self._formats[topic] != 'cdr':
            raise InputError(f'{self.path}: {topic}: expected message encoding cdr, '
                             f'found {quoted(self._formats[topic])}')
        self.damage, number, block, size, lost = self._lost, 0, list[tuple[int, bytes]](), 0, ''
        try:
            with closing(self._open()) as database:
                self._check_definitions(database, topic, kind)
                for row in self._rows(database, topic):
                    block.append(row)
                    size += len(row[1])
                    if len(block) == _BLOCK or size > _BYTES:
                        yield _raw(block)
                        number, block, size = number + len(block), [], 0
        except sqlite3.Error as error:
            lost = _reason(error)
        if block:
            yield _raw(block)
        if lost:
            self.damage = f'damaged after {number + len(block)} messages of ' \
                          f'{shortened(topic, 100)} ({lost})'

    def _check_definitions(self, database: sqlite3.Connection, topic: str,
                           kind: MessageType) -> None:
        # Early versions of rosbag2 do not store definitions.
        has_table = database.execute('PRAGMA table_info(message_definitions)').fetchone()
        rows = database.execute(_DEFINITIONS, (LONGEST + 1, kind.name)) if has_table else ()
        for definition in [*rows] or [('', b'')]:
            self._check_definition(topic, kind, kind.name, *definition)

    def _apply_log(self, stack: ExitStack) -> str:
        """Apply the write-ahead log, if any, to a copy of the file; return which data was lost."""
        path = Path(real_path(self._content))  # SQLite puts the log next to this file
        log = Path(f'{path}-wal')
        if not os.path.exists(log) or not os.path.getsize(log):
            return ''
        folder, begin = temporary(stack), _begin(log)
        self._content = copy_file(path, folder)
        if _begin(copy_file(log, folder)) != begin:  # a checkpoint changed the file
            raise InputError(f'{self.path}: a recorder is writing to this file; stop it, or try '
                             'again')
        with closing(sqlite3.connect(self._content)) as database:
            _, pages, _ = database.execute('PRAGMA wal_checkpoint(FULL)').fetchone()
            database.execute('PRAGMA journal_mode=DELETE').fetchone()
        return '' if pages > 0 else \
            f'the write-ahead log {log.name} has no complete transaction and was not applied'

    def _open(self) -> sqlite3.Connection:
        with open_file(self._content, 'recording') as stream:
            size = self._size = os.fstat(stream.fileno()).st_size
            stream.seek(_MODE_OFFSET)
            # Without immutable=1, SQLite would create a write-ahead log in the folder of the file.
            options = '&immutable=1' if stream.read(2) == _WRITE_AHEAD else ''
        address = f'{self._content.resolve().as_uri()}?mode=ro{options}'
        database = sqlite3.connect(address, uri=True)
        database.execute('PRAGMA trusted_schema=OFF')
        steps = count(0, _STEPS)
        database.set_progress_handler(
            lambda: next(steps) > _STEPS + size * _STEPS_A_BYTE, _STEPS)
        return database

    def _topics(self, database: sqlite3.Connection) -> tuple[dict[str, str], dict[str, str]]:
        """Return two dictionaries: the type of each topic, and the encoding of each topic."""
        for table in ('topics', 'messages', 'message_definitions'):
            # An ordinary column is marked by 0 in `hidden`. Any other value means that the column
            # is computed or belongs to a virtual table.
            hidden = [row[-1] for row in database.execute(f'PRAGMA table_xinfo({table})')]
            # `kinds` is empty before SQLite 3.37, which introduced table_list.
            kinds = {row[2] for row in database.execute(f'PRAGMA table_list({table})')}
            if any(hidden) or not kinds <= {'table'}:
                raise sqlite3.DatabaseError(f'expected {table} to be an ordinary table, found '
                                            'a view, a virtual table or a computed column')
        types, formats, size = {}, {}, 0
        for row in database.execute('SELECT name, type, serialization_format FROM topics'):
            if not all(isinstance(value, str) for value in row):
                raise sqlite3.DatabaseError('expected name, type and encoding of a topic as '
                                            f'text, found {quoted(row)}')
            name, types[row[0]], formats[row[0]] = row
            size += len(name)
            self._check_size(size)
        return types, formats

    def _rows(self, database: sqlite3.Connection, topic: str) -> Iterator[tuple[int, bytes]]:
        size = 0
        for time_ns, data in database.execute(_MESSAGES, (_LARGEST, topic)):
            if data is None:
                raise sqlite3.DatabaseError('expected messages with an integer time and at most '
                                            f'{_LARGEST} bytes of data, found another')
            size += len(data)
            self._check_size(size)
            yield time_ns, data

    def _check_size(self, size: int) -> None:
        # Check the size again, because the file may have grown since it was opened.
        if size > self._size and size > os.path.getsize(self._content):
            raise sqlite3.DatabaseError(_TOO_MUCH)


def _begin(log: Path) -> bytes:
    """
    Return a write-ahead log's header.

    SQLite changes this header whenever it starts to overwrite the log from the beginning.
    """
    with open_file(log, 'write-ahead log') as stream:
        return stream.read(_LOG_HEAD)


def _reason(error: Exception) -> str:
    return _REASONS.get(str(error)) or reason(error)


def _raw(block: list[tuple[int, bytes]]) -> Raw:
    times, messages = zip(*block)
    log_ns = np.array(times, np.int64)
    return Raw.from_bytes(messages, log_ns, log_ns)
