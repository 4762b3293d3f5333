"""SQLite files of rosbag2: their messages in blocks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
import sqlite3

import numpy as np
import zstandard

from rigid_body_ros.recording.bulk import Raw
from rigid_body_ros.scene import InputError

#: Messages of a block.
_BLOCK = 8192


class SqliteFile:
    """
    The messages of a SQLite file.

    Parameters
    ----------
    path : Path
    compressed : bool
        Whether each message is compressed by itself, with zstd.

    Attributes
    ----------
    damage : str
        What was lost and where, once the messages were read; '' if nothing.

    Raises
    ------
    InputError
        The file cannot be read, or is no bag.

    """

    def __init__(self, path: Path, compressed: bool = False) -> None:
        self.path = path
        self._compressed = compressed
        self.damage = ''
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
                             f'({error})') from error

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
                    yield self._raw(block)
                    count += len(block)
        except (sqlite3.Error, zstandard.ZstdError, TypeError, OverflowError) as error:
            self.damage = f'damaged behind {count} messages of {topic} ({error})'

    def _opened(self) -> sqlite3.Connection:
        return sqlite3.connect(f'{self.path.resolve().as_uri()}?mode=ro', uri=True)

    def _raw(self, block: list[tuple[int, bytes]]) -> Raw:
        times, messages = zip(*block)
        if self._compressed:
            unpack = zstandard.ZstdDecompressor().decompress
            messages = tuple(map(unpack, messages))
        sizes = np.array([len(message) for message in messages], np.int64)
        log_ns = np.array(times, np.int64)
        return Raw(np.frombuffer(b''.join(messages), np.uint8), np.cumsum(sizes) - sizes, sizes,
                   log_ns, log_ns)
