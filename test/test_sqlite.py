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

"""SQLite files of rosbag2: nothing is written beside them, and hostile files are rejected."""

from contextlib import closing
import itertools
import shutil
import sqlite3
import struct
from threading import Event, Thread

import bags
from hostile import outcome
import pytest
from rigid_body_ros import recording
from rigid_body_ros.scene import InputError

RECORDED = bags.torques(20)[6:]
RECORDED_MESSAGE = bags.traffic(RECORDED)[0].cdr()


def database(folder, *statements, **options):
    """Write a bag as a single file, run some SQL statements on it, and return its path."""
    path = bags.sqlite(folder, bags.traffic(RECORDED), **options)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executescript(';'.join(statements))
    return path


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def read(path):
    found = recording.read(path)
    return bags.Torques(found.stamps_ns, found.frame_ids, found.values).rows(), found.damage


@pytest.mark.parametrize(('left', 'writable'), [
    (('', '-wal', '-shm'), True), (('', '-wal', '-shm'), False), (('', '-wal'), False),
    (('',), True)])
def test_nothing_is_written_beside_a_bag_that_a_recorder_left(tmp_path, left, writable):
    live = tmp_path / 'live'
    live.mkdir()
    path = bags.sqlite(live, bags.traffic(RECORDED), killed=True)
    (live / 'bag_0.db3-shm').write_bytes(bytes(32768))
    folder = tmp_path / 'bag'
    folder.mkdir()
    for ending in left:
        shutil.copy(f'{path}{ending}', folder)
    before = content(folder)
    folder.chmod(0o755 if writable else 0o555)
    try:
        if '-wal' in left:
            assert read(folder / path.name) == (RECORDED.rows(), '')
        else:  # all messages were in the log
            assert 'bag_0.db3: expected a SQLite file of rosbag2' in outcome(folder / path.name)
    finally:
        folder.chmod(0o755)
    assert content(folder) == before


def test_a_bag_whose_log_was_applied_is_read_without_a_new_one(tmp_path):
    path = database(tmp_path, 'PRAGMA journal_mode=WAL')
    before = content(tmp_path)
    assert [*before] == ['bag_0.db3']
    blocks = iter(recording.Source(path, None, recording.TORQUES))
    assert len(next(blocks)) == len(RECORDED.rows())
    assert content(tmp_path) == before


def test_a_log_that_cannot_be_used_is_reported(tmp_path):
    path = database(tmp_path)
    shutil.copy(path, tmp_path / 'other.db3')
    (tmp_path / 'other.db3-wal').write_bytes(b'x' * 10_000)
    rows, damage = read(tmp_path / 'other.db3')
    assert rows == RECORDED.rows()
    assert 'other.db3-wal has no complete transaction and was not applied' in damage


def test_a_journal_beside_the_target_of_a_link_is_used(tmp_path):
    path = bags.sqlite(tmp_path, bags.traffic(RECORDED), killed=True)
    (tmp_path / 'link.db3').symlink_to(path)
    assert read(tmp_path / 'link.db3') == (RECORDED.rows(), '')


def test_a_rollback_journal_is_reported_and_left_alone(tmp_path):
    path = database(tmp_path)
    folder = tmp_path / 'bag'
    folder.mkdir()
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript('PRAGMA cache_size=1; BEGIN; CREATE TABLE big(data);'
                                 + 'INSERT INTO big VALUES (zeroblob(3000));' * 99)
        shutil.copy(path, folder)
        shutil.copy(f'{path}-journal', folder)
    before = content(folder)
    assert 'killed and left a -journal; apply it' in outcome(folder / path.name)
    assert content(folder) == before


ENDLESS = 'WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT '
COPY = 'ALTER TABLE {0} RENAME TO old_{0}'


@pytest.mark.parametrize('statements', [
    (COPY.format('topics'), 'CREATE VIEW topics AS SELECT * FROM old_topics'),
    (COPY.format('messages'), f'CREATE VIEW messages AS {ENDLESS} k AS id, 1 AS topic_id, '
                              '1 AS timestamp, zeroblob(1000000000) AS data FROM n'),
    (COPY.format('topics'), f"CREATE VIEW topics AS {ENDLESS} k AS id, '/t' || k AS name, "
                            "'a' AS type, 'cdr' AS serialization_format FROM n"),
    (COPY.format('messages'), 'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, '
     'timestamp INTEGER, data BLOB AS (zeroblob(1000000000)))',
     'INSERT INTO messages (topic_id, timestamp) SELECT topic_id, timestamp FROM old_messages'),
    (COPY.format('topics'), 'CREATE VIRTUAL TABLE topics USING fts5(id, name, type, '
                            'serialization_format)'),
    ('DROP TABLE topics',), ('DROP TABLE messages',), ('ALTER TABLE topics DROP COLUMN type',),
    (COPY.format('topics'), 'CREATE TABLE topics(id, name, type, serialization_format)',
     "INSERT INTO topics VALUES (1, x'00ff', NULL, 3.5)"),
    (COPY.format('topics'), 'CREATE TABLE topics(id, name, type, serialization_format)',
     "INSERT INTO topics VALUES (1, CAST(x'ff' AS TEXT), 'a', 'cdr')"),
    ("UPDATE topics SET name = 'x' || hex(zeroblob(1000000)) || char(27), type = 'y'",)],
    ids=itertools.count())
def test_a_hostile_schema_is_refused(tmp_path, statements):
    assert 'bag_0.db3: expected ' in outcome(database(tmp_path, *statements))


@pytest.mark.parametrize('change', ['data = zeroblob(50000000)', 'data = NULL',
                                    "timestamp = 'never'"])
def test_messages_before_one_that_is_none_are_used(tmp_path, change):
    path = database(
        tmp_path, COPY.format('messages'),
        'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)',
        'INSERT INTO messages SELECT * FROM old_messages',
        f'UPDATE messages SET {change} WHERE id = 9')
    assert outcome(path) == ''
    rows, damage = read(path)
    assert rows == RECORDED.rows()[:8]
    assert 'damaged after 8 messages of /torque (expected messages with an integer time' in damage


@pytest.mark.slow
def test_pages_that_refer_to_each_other_come_to_an_end(tmp_path):
    # Each inner page points 400 times to the only page of the next level, which gives 400^9 rows.
    path = database(tmp_path)
    with closing(sqlite3.connect(path)) as connection:
        root, = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
                                   ).fetchone()
    data = bytearray(path.read_bytes())
    size = struct.unpack_from('>H', data, 16)[0]
    first = len(data) // size + 1
    leaf = data[(root - 1) * size:root * size]
    for level in range(10):
        data += leaf if level == 9 else inner(size, first + level + 1)
    data[(root - 1) * size:root * size] = inner(size, first)
    struct.pack_into('>I', data, 28, len(data) // size)
    path.write_bytes(data)
    assert 'its pages are damaged' in outcome(path)


def inner(size, child):
    """Return a page of a table that points many times to another page."""
    cells = 400
    pointers = struct.pack(f'>{cells}H', *(size - 5 * (k + 1) for k in range(cells)))
    page = struct.pack('>B3HBI', 5, 0, cells, size - 5 * cells, 0, child) + pointers
    return page.ljust(size - 5 * cells, b'\0') + (struct.pack('>I', child) + b'\1') * cells


def test_a_temporary_copy_needs_room(tmp_path, monkeypatch):
    path = bags.sqlite(tmp_path, bags.traffic(RECORDED), killed=True)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, 'disk_usage', lambda folder: usage._replace(free=1000))
    before = content(tmp_path)
    assert 'bag_0.db3-wal: expected space for a copy in ' in outcome(path)
    assert content(tmp_path) == before


DEFINITION = 'UPDATE message_definitions SET encoded_message_definition = '


@pytest.mark.parametrize(('statements', 'told'), [
    (f"{DEFINITION} replace(encoded_message_definition, 'Vector3 force', 'Vector3 push')",
     "/torque: expected float64 wrench.force.x in .*, found 'float64 wrench.push.x'"),
    ("UPDATE message_definitions SET encoding = 'tape'",
     "/torque: expected a definition in ros2msg or ros2idl, found 'tape'"),
    (f'{DEFINITION} zeroblob(100000)', '/torque: expected a definition of at most'),
    ('ALTER TABLE message_definitions RENAME TO x; CREATE VIEW message_definitions AS SELECT * '
     'FROM x', '.*message_definitions to be an ordinary table'),
    (f"{DEFINITION} ''", '')])
def test_another_definition_of_the_type_is_refused(tmp_path, statements, told):
    path = bags.bare(tmp_path, bags.traffic(RECORDED), storage='SQLITE3')
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(statements)
    if told:
        with pytest.raises(InputError, match=f'{path.name}: {told}'):
            recording.read(path)
    else:
        assert len(recording.read(path)) == len(RECORDED.stamps_ns)


@pytest.mark.slow
@pytest.mark.parametrize('mode', ['WAL', 'DELETE'])
def test_a_file_is_read_while_it_is_written(tmp_path, mode):
    path = database(tmp_path, f'PRAGMA journal_mode={mode}')
    stop = Event()

    def record():
        with closing(sqlite3.connect(path)) as connection:
            while not stop.wait(0.002):
                with connection:
                    connection.executemany(
                        'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)',
                        [(1, RECORDED_MESSAGE)] * 50)
    recorder = Thread(target=record)
    recorder.start()
    counts = []
    try:
        while len(counts) < 8 or counts[-1] == counts[0]:
            try:
                found = recording.read(path)
            except InputError as error:
                assert 'a recorder is writing to this file' in str(error)
                continue
            assert found.damage == '' or found.damage.endswith('no complete transaction and was '
                                                               'not applied')
            assert len(found) % 50 == len(RECORDED.stamps_ns)
            counts.append(len(found))
    finally:
        stop.set()
        recorder.join()
    assert counts == sorted(counts)
