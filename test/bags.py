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

"""Write the same torques in every recording format in use."""

from collections import Counter
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
import shutil
import sqlite3
import struct

from conftest import EPOCH_NS
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
import numpy as np
from rigid_body_ros import messages, recording
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.interfaces import QosTime as Time
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_typestore, Stores
import yaml

STORE = get_typestore(Stores.ROS2_JAZZY)
WRENCH, BARE = 'geometry_msgs/msg/WrenchStamped', 'geometry_msgs/msg/Wrench'
#: Delay from the stamp of a message to its publication, and to its log time, ns.
PUBLISHED, LOGGED = 500_000, 1_000_000
#: The QoS that a publisher offers, as in any recording of rosbag2.
QOS = Qos(QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE,
          Time(9223372036, 854775807), Time(9223372036, 854775807), QosLiveliness.AUTOMATIC,
          Time(9223372036, 854775807), False)
#: Frames that need every length of padding, some of them with non-ASCII letters.
FRAMES = ['base_link', 'world', '', 'a', 'ab', 'abc', 'abcd', 'abcde', 'abcdef', 'Flügel/機体',
          'robot_1/arm_left/wrist_force_torque_sensor_frame']
#: Options for a file without summary and index.
UNINDEXED = {'index_types': IndexType.NONE, 'repeat_channels': False, 'repeat_schemas': False,
             'use_statistics': False, 'use_summary_offsets': False}

#: The fields of each message type in IDL.
IDL = {
    'builtin_interfaces/msg/Time': 'int32 sec; unsigned long nanosec;',
    'std_msgs/msg/Header': 'builtin_interfaces::msg::Time stamp; string frame_id;',
    'geometry_msgs/msg/Vector3': 'double x; double y; double z;',
    BARE: 'geometry_msgs::msg::Vector3 force; geometry_msgs::msg::Vector3 torque;',
    WRENCH: 'std_msgs::msg::Header header; geometry_msgs::msg::Wrench wrench;',
}


@dataclass(frozen=True, eq=False)
class Torques:
    """The messages of a recording."""

    stamps_ns: np.ndarray  # int64, shape (n,)
    frame_ids: list[str]
    values: np.ndarray  # force, N, and torque, N m, shape (n, 6)

    def __getitem__(self, rows):
        frame_ids = np.array(self.frame_ids, object)[rows].tolist()
        return Torques(self.stamps_ns[rows], frame_ids, self.values[rows])

    def rows(self):
        """Return the messages as tuples that are equal only if all bits are."""
        return [(stamp, frame_id, row.tobytes()) for stamp, frame_id, row in
                zip(self.stamps_ns.tolist(), self.frame_ids, np.ascontiguousarray(self.values))]


@dataclass(frozen=True)
class Sent:
    """A message to record."""

    topic: str
    message: object
    stamp_ns: int

    @property
    def kind(self):
        return self.message.__msgtype__

    def cdr(self, little_endian=True):
        return bytes(STORE.serialize_cdr(self.message, self.kind, little_endian=little_endian))


def big_endian(one):
    return one.cdr(little_endian=False)


def dirty(one):
    """Return a message as middleware may send it, with nonzero padding, also at the end."""
    data = one.cdr()
    if one.kind != WRENCH:
        return data
    end = 16 + struct.unpack_from('<I', data, 12)[0]
    padding = (4 - end) % 8
    return (data[:2] + b'\0\3' + data[4:end] + b'\xaa' * padding + data[end + padding:]
            + b'\xaa' * 3)


def torques(count=200, frames=('base_link',), seed=1):
    """Return random torques at irregular times, including zeros, infinities and NaN."""
    random = np.random.default_rng(seed)
    stamps = EPOCH_NS + np.cumsum(random.integers(1_000, 10_000_000, count))
    values = random.normal(size=(count, 6))
    values[:5, 3] = [-0.0, 5e-324, 1.7976931348623157e308, np.inf, np.nan]
    values[5, 5] = np.array(0x7FF8_0000_DEAD_BEEF).view(float)  # another nan
    return Torques(stamps, random.choice(frames, count).tolist(), values)


def traffic(recorded, topic='/torque', others=False, header=True):
    """Return torques as messages; with `others`, begin with messages of other types."""
    random = np.random.default_rng(2)
    sent = []
    for number, (stamp, frame_id, values) in enumerate(
            zip(recorded.stamps_ns.tolist(), recorded.frame_ids, recorded.values.tolist())):
        if others:
            sent += [_string(stamp - 300, random) for _ in range(40 if not number else 1)]
            sent += [_attitude(stamp - 200, random)] * int(random.integers(3))
        wrench = _made(BARE, force=_vector(*values[:3]), torque=_vector(*values[3:]))
        sent.append(Sent(topic, _made(WRENCH, header=_header(stamp, frame_id), wrench=wrench)
                         if header else wrench, stamp))
    return sent


def mcap(folder, sent, cdr=Sent.cdr, encoding='ros2msg', profile='ros2', channels=1,
         chunk_size=4096, **options):
    """Write with the mcap package; a topic is registered with its first message."""
    path, schemas, ids = folder / 'recording.mcap', {}, {}
    with open(path, 'wb') as stream:
        writer = McapWriter(stream, chunk_size, **options)
        writer.start(profile=profile)
        for number, one in enumerate(sent):
            key = one.topic, number % channels
            if one.kind not in schemas:
                schemas[one.kind] = writer.register_schema(
                    one.kind, *_schema(one.kind, encoding if one.kind in IDL else 'ros2msg'))
            if key not in ids:
                ids[key] = writer.register_channel(one.topic, 'cdr', schemas[one.kind])
            log_ns = one.stamp_ns + LOGGED
            writer.add_message(ids[key], log_ns, cdr(one), one.stamp_ns + PUBLISHED, number)
            if number == len(sent) // 2:
                writer.add_metadata('robot', {'name': 'tumbler'})
                writer.add_attachment(log_ns, log_ns, 'a.txt', 'text/plain', b'MCAP' * 99)
        writer.finish()
    return path


def ours(folder, sent):
    """Write with this package, which omits strings and writes one time for each message."""
    path, added = folder / 'recording.mcap', set()
    with recording.Writer(path) as writer:
        for one in sent:
            if one.kind in messages.TYPES:
                if one.topic not in added:
                    writer.add_topic(one.topic, messages.TYPES[one.kind])
                    added.add(one.topic)
                writer.write(one.topic, one.stamp_ns + LOGGED, one.cdr())
    return path


def rosbag2(folder, sent, storage='MCAP', compression='NONE', version=9, name='bag'):
    """Write a directory with rosbags, which writes one time for each message."""
    writer = Rosbag2Writer(folder / name, version=version, storage_plugin=StoragePlugin[storage])
    writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    topics = {}
    with writer:
        for one in sent:
            if one.topic not in topics:
                topics[one.topic] = writer.add_connection(
                    one.topic, one.kind, typestore=STORE, offered_qos_profiles=[QOS])
            writer.write(topics[one.topic], one.stamp_ns + LOGGED, one.cdr())
    return folder / name


def bare(folder, sent, **options):
    """Write a rosbag2 directory, and return the path of the file in it."""
    bag = rosbag2(folder, sent, **options)
    data, = bag.glob('bag.*')
    return data.rename(folder / data.name)


def split(folder, sent, parts=3, prefix='', **options):
    """Write a rosbag2 directory with several files, named and described as by rosbag2."""
    bag = folder / 'bag'
    bag.mkdir()
    bounds = np.linspace(0, len(sent), parts + 1).astype(int)
    infos = []
    for number, (first, last) in enumerate(pairwise(bounds)):
        part = rosbag2(folder / 'parts', sent[first:last], name=f'bag_{number}', **options)
        info = yaml.safe_load((part / 'metadata.yaml').read_text())
        infos.append(info['rosbag2_bagfile_information'])
        shutil.move(part / infos[-1]['relative_file_paths'][0], bag)
    topics = {topic['topic_metadata']['name']: topic['topic_metadata']
              for info in infos for topic in info['topics_with_message_count']}
    counts = Counter(one.topic for one in sent)
    whole = {
        **infos[0],
        'relative_file_paths': [prefix + info['relative_file_paths'][0] for info in infos],
        'files': [info['files'][0] for info in infos],
        'compression_mode': infos[0]['compression_mode'].upper(),  # as rosbag2 itself writes it
        'duration': {'nanoseconds': sent[-1].stamp_ns - sent[0].stamp_ns},
        'message_count': len(sent),
        'topics_with_message_count': [{'topic_metadata': topic, 'message_count': counts[name]}
                                      for name, topic in topics.items()],
    }
    (bag / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': whole}))
    return bag


def sqlite(folder, sent, schema=3, killed=False):
    """
    Write a .db3 file with the schema of an older ROS: 1 Dashing, 2 Foxy, 3 Humble.

    With `killed`, write the file as a recorder in 'resilient' mode leaves it when it is killed:
    all rows are in the journal.
    """
    live = folder / 'live.db3'
    qos = ', offered_qos_profiles TEXT NOT NULL' * (schema > 1)
    connection = sqlite3.connect(live)
    if killed:
        connection.executescript('PRAGMA journal_mode=WAL; PRAGMA wal_autocheckpoint=0;')
    connection.executescript(
        'CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, '
        f'serialization_format TEXT NOT NULL{qos});'
        'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, '
        'timestamp INTEGER NOT NULL, data BLOB NOT NULL);'
        'CREATE INDEX timestamp_idx ON messages (timestamp ASC);')
    if schema > 2:
        connection.executescript(
            'CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);'
            'CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, '
            "metadata TEXT NOT NULL); INSERT INTO schema VALUES (3, 'humble');")
    ids = {}
    for one in sent:
        if one.topic not in ids:
            ids[one.topic] = len(ids) + 1
            row = [ids[one.topic], one.topic, one.kind, 'cdr', ''][:4 + (schema > 1)]
            connection.execute(f'INSERT INTO topics VALUES ({", ".join("?" * len(row))})', row)
        connection.execute('INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)',
                           [ids[one.topic], one.stamp_ns + LOGGED, one.cdr()])
    connection.commit()
    for file in folder.glob('live.db3*'):
        if not file.name.endswith('-shm'):
            shutil.copy(file, folder / file.name.replace('live', 'bag_0'))
    connection.close()
    live.unlink()
    return folder / 'bag_0.db3'


_ZSTD, _LZ4, _PLAIN = CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE

#: Functions that write messages to a folder, and return the path to read.
FORMS = {
    **{f'mcap-{compression.name.lower()}{chunks}{index}': partial(
        mcap, compression=compression, use_chunking=not chunks, **(UNINDEXED if index else {}))
       for compression, chunks in [(_PLAIN, ''), (_LZ4, ''), (_ZSTD, ''), (_PLAIN, '-unchunked')]
       for index in ('', '-unindexed')},
    'mcap-one-chunk': partial(mcap, chunk_size=2 ** 20),
    'mcap-idl': partial(mcap, encoding='ros2idl'),
    'mcap-big-endian': partial(mcap, cdr=big_endian),
    'mcap-dirty': partial(mcap, cdr=dirty),
    'mcap-no-profile': partial(mcap, profile=''),
    'mcap-no-crc': partial(mcap, enable_crcs=False),
    'mcap-data-crc': partial(mcap, enable_data_crcs=True, use_chunking=False),
    'mcap-two-channels': partial(mcap, channels=2),
    'mcap-two-channels-unindexed': partial(mcap, channels=2, **UNINDEXED),
    'mcap-chunk-index-only': partial(mcap, index_types=IndexType.CHUNK),
    'mcap-summary-without-index': partial(mcap, index_types=IndexType.NONE),
    'ours': ours,
    **{f'rosbag2-{storage.lower()}-{compression.lower()}': partial(
        rosbag2, storage=storage, compression=compression)
       for storage, compression in [
           ('MCAP', 'NONE'), ('MCAP', 'STORAGE'), ('MCAP', 'MESSAGE'), ('MCAP', 'FILE'),
           ('SQLITE3', 'NONE'), ('SQLITE3', 'MESSAGE'), ('SQLITE3', 'FILE')]},
    'rosbag2-mcap-v8': partial(rosbag2, version=8),
    'rosbag2-sqlite3-v8': partial(rosbag2, storage='SQLITE3', version=8),
    'split-mcap': partial(split, parts=12),  # bag_10 precedes bag_2 in alphabetical order only
    'split-mcap-storage': partial(split, compression='STORAGE'),
    'split-mcap-message': partial(split, compression='MESSAGE'),
    'split-mcap-file': partial(split, compression='FILE'),
    'split-sqlite3': partial(split, storage='SQLITE3', parts=12, version=8),
    'split-sqlite3-message': partial(split, storage='SQLITE3', compression='MESSAGE'),
    'split-sqlite3-file': partial(split, storage='SQLITE3', compression='FILE'),
    'split-with-folder': partial(split, storage='SQLITE3', prefix='bag/'),  # until Eloquent
    'bare-mcap': bare,
    'bare-mcap-storage': partial(bare, compression='STORAGE'),
    'bare-sqlite3': partial(bare, storage='SQLITE3'),
    'sqlite3-dashing': partial(sqlite, schema=1),
    'sqlite3-foxy': partial(sqlite, schema=2),
    'sqlite3-humble': sqlite,
    'sqlite3-killed': partial(sqlite, killed=True),
}
#: Bags that rosbags does not read. It requires a profile, finds no messages without an index of
#: messages if there is one of chunks, and does not open a journal.
UNREAD = {'mcap-no-profile', 'mcap-chunk-index-only', 'sqlite3-killed'}


def read_by_rosbags(path, topic='/torque'):
    """Return torques and log times, read with rosbags, sorted by log time."""
    with AnyReader([path], default_typestore=STORE) as reader:
        found = [connection for connection in reader.connections if connection.topic == topic]
        read = [(time_ns, reader.deserialize(data, connection.msgtype))
                for connection, time_ns, data in reader.messages(found)]
    headers = [message.header for _, message in read]
    stamps = [header.stamp.sec * 10 ** 9 + header.stamp.nanosec for header in headers]
    wrenches = [(message.wrench.force, message.wrench.torque) for _, message in read]
    values = np.array([(f.x, f.y, f.z, t.x, t.y, t.z) for f, t in wrenches])
    return (Torques(np.array(stamps), [header.frame_id for header in headers], values),
            np.array([time_ns for time_ns, _ in read]))


def read_by_mcap(path):
    """Return torques, read with mcap, in the order of the file."""
    with open(path, 'rb') as stream:
        read = [messages.WRENCH.decode(message.data) for _, _, message in
                NonSeekingReader(stream, validate_crcs=True).iter_messages(
                    ['/torque'], log_time_order=False)]
    return Torques(np.array([one.stamp_ns for one in read]), [one.frame_id for one in read],
                   np.array([one.values for one in read]))


def records(data):
    """Yield the opcode, start and end of each MCAP record; a chunk is one record."""
    start = 8
    while start < len(data) - 8:
        opcode, size = struct.unpack_from('<BQ', data, start)
        yield Opcode(opcode), start, start + 9 + size
        start += 9 + size


def _schema(kind, encoding='ros2msg'):
    # Its encoding and its text.
    if encoding == 'ros2msg':
        return encoding, STORE.generate_msgdef(kind, ros_version=2)[0].encode()
    kinds = [*IDL]
    return encoding, ''.join(map(idl, kinds[kinds.index(kind)::-1])).encode()


def idl(kind):
    package, _, name = kind.split('/')
    return (f'{"=" * 80}\nIDL: {kind}\n// generated from rosidl_adapter/resource/msg.idl.em\n'
            f'module {package} {{ module msg {{\n  struct {name} {{ {IDL[kind]} }};\n}}; }};\n')


def _made(kind, **fields):
    return STORE.types[kind](**fields)


def _header(stamp_ns, frame_id):
    sec, nanosec = divmod(stamp_ns, 10 ** 9)
    stamp = _made('builtin_interfaces/msg/Time', sec=sec, nanosec=nanosec)
    return _made('std_msgs/msg/Header', stamp=stamp, frame_id=frame_id)


def _vector(x, y, z):
    return _made('geometry_msgs/msg/Vector3', x=x, y=y, z=z)


def _string(stamp_ns, random):
    text = 'x' * int(random.integers(300))
    return Sent('/chatter', _made('std_msgs/msg/String', data=text), stamp_ns)


def _attitude(stamp_ns, random):
    x, y, z, w = random.normal(size=4).tolist()
    return Sent('/attitude', _made(
        'geometry_msgs/msg/QuaternionStamped', header=_header(stamp_ns, 'map'),
        quaternion=_made('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)), stamp_ns)
