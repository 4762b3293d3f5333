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

"""Hostile files give a result, or one short line and exit status 2, within limits."""

from contextlib import closing
import itertools
import os
import re
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile

import bags
from conftest import at_night, files_up_to, RECORDINGS
from hostile import LAUGHS, outcome, TUMBLER, zeros
from mcap.opcode import Opcode
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.recording import bulk, unpack
from rigid_body_ros.replay import replay
from rigid_body_ros.scene import InputError
import yaml
import zstandard


def bag(folder, **options):
    return bags.rosbag2(folder, bags.traffic(bags.torques(20)[6:]), **options)


def described(folder, about):
    """Return a bag whose metadata.yaml has another text, or wrong values."""
    path = bag(folder)
    file = path / 'metadata.yaml'
    if isinstance(about, dict):
        whole = yaml.safe_load(file.read_text())
        whole['rosbag2_bagfile_information'].update(about)
        about = yaml.safe_dump(whole)
    file.write_text(about)
    return path


def scene_file(folder, text):
    path = folder / 'scene.yaml'
    path.write_text('/**:\n  ros__parameters:\n    inertia: {ixx: 1.0, iyy: 2.0, izz: 2.5}\n'
                    + text)
    return path


# The metadata of a bag

@pytest.mark.parametrize('text', ['2020-13-45', '!!int x', '!!set {a, a}',
                                  '!!python/name:os.abort', '9' * 5000])
def test_values_of_no_meaning_may_be_anything(tmp_path, text):
    path = bag(tmp_path)
    file = path / 'metadata.yaml'
    file.write_text(re.sub('version: .*', f'version: {text}', file.read_text(), count=1))
    assert outcome(path) == ''


SPAN = {'nanoseconds': 3}
REFUSED = 'metadata.yaml: expected '
OUTSIDE = 'metadata.yaml: relative_file_paths: expected '


@pytest.mark.parametrize(('about', 'expected'), [
    ({'duration': SPAN, 'other': [SPAN] * 99}, ''),  # Python writes aliases
    *((text, REFUSED) for text in ('', '[]', '\0', '{', 'rosbag2_bagfile_information: 3',
                                   '!!python/object/apply:os.abort []', 'a: &a [1, *a]')),
    ('rosbag2_bagfile_information: {version: 99}', OUTSIDE),
    *((f'{LAUGHS}rosbag2_bagfile_information: {{{before}}}', REFUSED) for before in (
        'relative_file_paths: *i', 'compression_mode: *i', 'relative_file_paths: [*a, *a]')),
    ('a: &a [' + 'x,' * 1000 + ']\nb: [' + '*a,' * 1000 + ']', 'at most 100000 values'),
    *(({'relative_file_paths': [name]}, OUTSIDE) for name in (
        '../bag/bag.mcap', '/etc/passwd', 'a/../../bag.mcap', '..', 'bag\0.mcap', '', '.',
        ['bag.mcap'])),
    ({'relative_file_paths': ['old_name/bag.mcap']}, ''),  # the folder was renamed
    ({'relative_file_paths': ['bag.mcap'] * 1000}, 'expected each file once')],
    ids=lambda value: str(value)[:40])
def test_a_description_is_read_within_bounds(tmp_path, about, expected):
    path = described(tmp_path, about)
    found = outcome(path)
    assert expected in found
    assert expected or not found


def test_a_path_out_of_the_bag_is_refused_and_a_link_within_it_is_followed(tmp_path):
    absolute = tmp_path / 'absolute'
    assert OUTSIDE in outcome(described(absolute, {
        'relative_file_paths': [str(absolute / 'bag' / 'bag.mcap')]}))
    path = described(tmp_path, {'relative_file_paths': ['link.mcap']})
    (path / 'link.mcap').symlink_to('bag.mcap')
    assert outcome(path) == ''
    (path / 'bag.mcap').rename(tmp_path / 'elsewhere.mcap')
    (path / 'link.mcap').unlink()
    (path / 'link.mcap').symlink_to('../elsewhere.mcap')
    assert "expected files in the folder of the bag, found 'link.mcap'" in outcome(path)
    (tmp_path / 'alias').symlink_to(path)
    (path / 'link.mcap').unlink()
    (tmp_path / 'elsewhere.mcap').rename(path / 'link.mcap')
    assert outcome(tmp_path / 'alias') == ''


@pytest.mark.parametrize('text', ['x' * 2 ** 23, '[a,' * 2 ** 17, '{a: ' * 9999,
                                  '%TAG !a! b\n' * 9999, *at_night('[' + 'a,' * 2 ** 20)])
def test_a_yaml_file_has_bounds(tmp_path, text):
    (tmp_path / 'scene.yaml').write_text(text)
    assert 'scene.yaml: expected ' in outcome(RECORDINGS / 'tumbler.mcap', tmp_path / 'scene.yaml')
    assert 'metadata.yaml: expected ' in outcome(described(tmp_path, text))


@pytest.mark.slow
def test_without_libyaml_the_same_is_refused(tmp_path):
    for number, text in enumerate(['a: [', 'a: *b', '[' * 2000, 'x: &x 1', '/**: 3']):
        (tmp_path / f'{number}.yaml').write_text(text)
    script = '\n'.join([
        'import sys', "sys.modules['yaml._yaml'] = None", 'import yaml',
        'assert not yaml.__with_libyaml__', 'from rigid_body_ros import scene',
        f'scene.load({str(TUMBLER)!r})', 'for number in range(5):', '    try:',
        f'        scene.load({str(tmp_path)!r} + f"/{{number}}.yaml")',
        '    except scene.InputError as error:', '        print(error)'])
    result = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                            check=True)
    for number, line in enumerate(result.stdout.splitlines()):
        assert re.search(f'{number}.yaml: .*expected ', line)
    assert number == 4


# Scenes

@pytest.mark.slow
@pytest.mark.parametrize(('text', 'message'), [
    ('    tolerance: ' + '1' * 200_000 + 'x',
     r"tolerance: expected a number, found '1+\.\.\.1+x'"),
    ('    body_frame: ' + '[' * 20 + 'a' + ']' * 20, 'body_frame: expected text'),
    ('    ? ' + 'x' * 2 ** 20 + '\n    : {' + ','.join(f'a{k}: 1' for k in range(9999)) + '}',
     'expected full names of at most 500'),
    ('    "inertia.\\e[2J": 1', re.escape(r'inertia.\x1b[2J: unknown key')),
    ('    robot_description: "<' + 'x' * 5000 + '>"', 'URDF: expected XML, found'),
    ('    robot_description: "<robot><link name=\'a\'><inertial><inertia ixx=\''
     + '1' * 100_000 + 'x\'/></inertial></link></robot>"',
     'ixx: expected a finite number, found')])
def test_what_is_quoted_of_a_scene_is_short(tmp_path, text, message):
    found = outcome(RECORDINGS / 'tumbler.mcap', scene_file(tmp_path, text))
    assert re.search(message, found)


# Paths that are not regular files, and files that are too large

MAKE = {'pipe': os.mkfifo, 'folder': os.mkdir, 'zeros': lambda path: path.symlink_to('/dev/zero'),
        'gigabytes': lambda path: (path.touch(), os.truncate(path, 2 ** 33))}


@pytest.mark.parametrize(('name', 'kind'), [
    ('a.csv', 'pipe'), ('a.mcap', 'folder'), ('a.db3', 'pipe'), ('a.mcap.zstd', 'zeros'),
    ('a.db3.zst', 'folder'), ('a', 'zeros'), ('a.mcap', 'pipe'), ('a.csv', 'zeros'),
    ('a.db3', 'zeros'), *((name, 'gigabytes') for name in ('a.csv', 'a.mcap', 'a.db3',
                                                           'a.mcap.zstd'))])
def test_what_is_no_file_or_too_large_is_refused_as_recording_and_scene(tmp_path, name, kind):
    path, held = tmp_path / name, tmp_path / 'bag'
    MAKE[kind](path)
    assert name in outcome(path)
    is_large = kind == 'gigabytes'
    assert f'{name}: {"expected " if is_large else "cannot read the scene: expected a regular"}' \
        in outcome(RECORDINGS / 'tumbler.mcap', path)
    described(tmp_path, {'relative_file_paths': [name]})
    path.rename(held / name)
    assert name in outcome(held)


@pytest.mark.parametrize('make', [os.mkfifo, os.mkdir])
def test_a_description_that_is_no_file_is_refused(tmp_path, make):
    path = bag(tmp_path)
    (path / 'metadata.yaml').unlink()
    make(path / 'metadata.yaml')
    assert 'metadata.yaml: cannot read the metadata' in outcome(path)


def test_a_summary_that_claims_the_whole_of_a_large_file_is_not_read(tmp_path):
    path = tmp_path / 'large.mcap'
    with open(path, 'wb') as stream:
        stream.write(b'\x89MCAP0\r\n')
        stream.seek(2 ** 33)
        stream.write(bytes([Opcode.FOOTER]) + struct.pack('<QQQI', 20, 8, 0, 0))
        stream.write(b'\x89MCAP0\r\n')
    assert 'expected an MCAP file with messages' in outcome(path)


# Compressed data

def with_messages(path, *sent):
    """Return a bag whose messages are compressed one by one, with these messages instead."""
    if (path / 'bag.db3').exists():
        with closing(sqlite3.connect(path / 'bag.db3')) as database, database:
            database.execute('UPDATE messages SET data = ?', sent[0][1:])
    else:
        with recording.Writer(path / 'bag.mcap') as writer:
            for topic in dict(sent):
                writer.add_topic(topic, messages.WRENCH)
            for stamp, (topic, data) in enumerate(sent, 1):
                writer.write(topic, stamp, data)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(('storage', 'says_its_size'), [('MCAP', True), ('SQLITE3', False)])
def test_a_message_may_not_be_larger_than_a_chunk_may(tmp_path, monkeypatch, storage,
                                                      says_its_size):
    monkeypatch.setattr(unpack, 'LARGEST', 2 ** 24)
    path = bag(tmp_path, storage=storage, compression='MESSAGE')
    assert outcome(path) == ''
    found = outcome(with_messages(path, ('/torque', zeros(2 ** 26, 'zstd', says_its_size))))
    assert '/torque: message 1: cannot decompress: ' in found


def test_the_messages_of_a_block_may_not_be_larger_together_than_a_chunk_may(monkeypatch):
    packed = zstandard.ZstdCompressor().compress(bytes(2 ** 20))
    times = np.zeros(9, np.int64)
    raw = bulk.Raw.from_bytes([packed] * 9, times, times)
    assert unpack.unpack_each(raw).sizes.tolist() == [2 ** 20] * 9
    monkeypatch.setattr(unpack, 'LARGEST', 2 ** 23)
    with pytest.raises(bulk.BadMessageError, match='expected at most 0 bytes') as error:
        unpack.unpack_each(raw)
    assert error.value.row == 8


@pytest.mark.parametrize('size', [0, 1, 150, 2 ** 18])
@pytest.mark.parametrize('content', [bytes, os.urandom], ids=['zeros', 'noise'])
@pytest.mark.parametrize('says_its_size', [True, False])
def test_what_is_dense_is_unpacked_whole(size, content, says_its_size):
    data = content(size)
    compressor = zstandard.ZstdCompressor(22, write_content_size=says_its_size)
    packed, unpacker = compressor.compress(data), zstandard.ZstdDecompressor()
    assert unpack.unpack(packed, max(size, 1), unpacker) == data
    if size > 1:
        with pytest.raises((ValueError, zstandard.ZstdError)):
            unpack.unpack(packed, size - 1, unpacker)


@pytest.fixture
def packed(tmp_path, monkeypatch):
    """Return a compressed file of 64 MB; the folder for temporary files is empty in the end."""
    path, folder = tmp_path / 'a.mcap.zstd', tmp_path / 'temporary'
    path.write_bytes(zeros(2 ** 26))
    folder.mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(folder))
    yield path
    assert not list(folder.iterdir())


def test_a_compressed_file_may_not_be_many_times_larger(packed, monkeypatch):
    monkeypatch.setattr(unpack, 'LARGEST', 2 ** 24)
    assert 'a.mcap.zstd: expected at most 16777216 bytes after decompression' in outcome(packed)


def test_a_compressed_file_may_not_fill_the_temporary_folder(packed, monkeypatch):
    usage = shutil.disk_usage(packed.parent)
    left = iter(range(2 ** 24, 0, -2 ** 20))
    monkeypatch.setattr(shutil, 'disk_usage', lambda folder: usage._replace(free=next(left)))
    found = outcome(packed)
    assert f'a.mcap.zstd: expected space for a copy in {tempfile.tempdir}, ' in found
    assert found.endswith('set TMPDIR to another folder')


def test_a_temporary_folder_that_is_full_or_cannot_be_made_is_named(packed, monkeypatch):
    with files_up_to(2 ** 20):
        assert (f'a.mcap.zstd: cannot write a copy to {tempfile.tempdir}: File too large'
                in outcome(packed))
    monkeypatch.setattr(tempfile, 'tempdir', str(packed.with_name('none')))
    assert 'cannot create a temporary folder: No such file' in outcome(packed)


def test_several_frames_are_one_file(packed):
    data = (RECORDINGS / 'tumbler.mcap').read_bytes()
    path = packed.with_name('a.mcap.zst')
    path.write_bytes(b''.join(zstandard.ZstdCompressor().compress(data[start:start + 50_000])
                              for start in range(0, len(data), 50_000)))
    assert outcome(path) == ''


# Parts that are copied and compared

def test_a_message_that_cannot_be_copied_is_named(tmp_path, refusal):
    wrenches = [zstandard.ZstdCompressor().compress(messages.wrench(stamp, '', [0.0] * 3))
                for stamp in (1, 2)]
    path = with_messages(bag(tmp_path, compression='MESSAGE'), ('/torque', wrenches[0]),
                         ('/other', b'no zstd'), ('/torque', wrenches[1]))
    assert '/other: message 1: cannot decompress: ' in refusal(
        'attitude_replay', path, '--scene', TUMBLER, '-o', tmp_path / 'out.mcap', '--also',
        'input', '--topic', '/torque')
    assert not (tmp_path / 'out.mcap').exists()


def test_a_damaged_metadata_record_is_named(tmp_path, refusal):
    path = tmp_path / 'motion.mcap'
    replay(RECORDINGS / 'tumbler.mcap', scene.load(TUMBLER), path)
    data = path.read_bytes()
    place, = (start for code, start, _ in bags.records(data) if code == Opcode.METADATA)
    path.write_bytes(data[:place + 9] + b'\xff' * 8 + data[place + 17:])
    assert f'motion.mcap: damaged metadata record at byte {place} (' in refusal(
        'attitude_replay', RECORDINGS / 'tumbler.mcap', '--scene', TUMBLER, '--verify', path)


# SQLite files of rosbag2

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


@pytest.mark.parametrize('mode', ['WAL', 'DELETE'])
def test_a_file_is_read_while_it_is_written(tmp_path, mode):
    path, rows = database(tmp_path, f'PRAGMA journal_mode={mode}'), [(1, RECORDED_MESSAGE)] * 50
    with closing(sqlite3.connect(path)) as recorder:
        for count in range(len(RECORDED.stamps_ns), 150, 50):
            recorder.executemany(
                'INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)', rows)
            try:
                assert len(recording.read(path)) == count  # without the open transaction
            except InputError as error:
                assert 'a recorder is writing to this file' in str(error)
            recorder.commit()
            assert len(recording.read(path)) == count + 50
