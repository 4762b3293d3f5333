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

"""Recordings: we read files of other tools, other tools read ours, and damage is reported."""

from functools import partial
import itertools
import os
import re
import sys

import bags
from conftest import EPOCH_NS, files_up_to, RECORDINGS, SECOND, write_torques
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rigid_body_ros import messages, recording, State
from rigid_body_ros.scene import InputError
import yaml
import zstandard

TORQUES = np.random.default_rng(3).normal(size=(50, 3))
TORQUES[0] = [5e-324, -0.0, 1.7976931348623157e308]
STAMPS = EPOCH_NS + np.arange(50) * SECOND // 100


def torque_log(path):
    return recording.torque_log(path, recording.read(path), 'base_link', 'world')


def interrupted_at(moment, action):
    """Perform an action, and interrupt it at one of the moments at which signals are checked."""
    left = moment

    def trace(frame, event, argument):
        nonlocal left
        if frame.f_globals.get('__name__') != recording.Writer.__module__:
            return None
        left -= 1
        if left == 0:
            raise KeyboardInterrupt
        return trace
    before = sys.gettrace()
    sys.settrace(trace)
    try:
        action()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


@pytest.mark.slow
# After an interrupted write, Python closes the file.
@pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')
def test_an_interrupt_at_any_moment_leaves_a_whole_file_or_none(tmp_path):
    path, rows = tmp_path / 'torque.mcap', [(EPOCH_NS, '', TORQUES[0])]
    for moment in itertools.count(1):
        path.unlink(missing_ok=True)
        interrupted = interrupted_at(moment, lambda: write_torques(path, rows))
        assert [*tmp_path.iterdir()] in ([], [path])
        if path.exists():
            np.testing.assert_array_equal(torque_log(path).torques, TORQUES[:1])
        if not interrupted:
            break
    assert moment > 20
    assert path.exists()


def test_the_file_has_what_ros2_bag_play_and_foxglove_need(tmp_path):
    path = write_torques(tmp_path / 'torque.mcap', [
        (stamp, 'base_link', torque) for stamp, torque in zip(STAMPS, TORQUES)])
    with open(path, 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        read = [(stamp.log_time, data.wrench.torque) for _, _, stamp, data in
                reader.iter_decoded_messages()]
    assert [time_ns for time_ns, _ in read] == STAMPS.tolist()
    np.testing.assert_array_equal([(t.x, t.y, t.z) for _, t in read], TORQUES)
    assert summary.statistics.message_count == 50
    channel, = summary.channels.values()
    schema = summary.schemas[channel.schema_id]
    assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
        STAMPS[0], STAMPS[-1])
    assert all(chunk.message_index_length > 0 for chunk in summary.chunk_indexes)
    profile, = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    assert (profile['history'], profile['depth'], profile['reliability'],
            profile['durability']) == (1, 10, 1, 2)


def test_frames_come_from_each_message(tmp_path):
    path = write_torques(tmp_path / 'mixed.mcap', [
        (1, '', [1, 0, 0]), (2, 'world', [0, 1, 0]), (3, 'base_link', [0, 0, 1])])
    assert torque_log(path).in_space.tolist() == [False, True, False]
    with pytest.raises(InputError, match='mixed.mcap: /torque: interpolation linear: expected '
                                         'torques in one frame'):
        recording.torque_log(path, recording.read(path), 'base_link', 'world', 'linear')


def test_torques_are_sorted_and_of_equal_stamps_the_later_in_the_file_counts(tmp_path):
    year_ns = 365 * 86400 * SECOND  # a log of simulated time may begin at zero
    path = write_torques(tmp_path / 'twice.mcap', [
        (0, '', [1, 0, 0]), (year_ns, '', [2, 0, 0]), (7, '', [3, 0, 0]),
        (year_ns, '', [4, 0, 0])])
    log = torque_log(path)
    assert log.times_ns.tolist() == [0, 7, year_ns]
    assert log.torques[:, 0].tolist() == [1.0, 3.0, 4.0]


def test_the_log_of_a_node_is_divided_at_its_markers(tmp_path):
    starts = State(5, (0.5, 0.5, 0.5, 0.5), (1e-300, -0.0, 0.1), (1.0, 2.0, 3.0)), State(2)
    first, last = (messages.WRENCH.decode(messages.epoch_marker(start)) for start in starts)
    path = write_torques(tmp_path / 'epochs.mcap', [
        (5, first.frame_id, [0, 0, 0]), (4, 'world', [1, 0, 0]), (8, '', [2, 0, 0]),
        (2, last.frame_id, [0, 0, 0]), (0, '', [3, 0, 0]), (9, '', [4, 0, 0]), (0, '', [5, 0, 0]),
        (2, last.frame_id, [0, 0, 0])])
    parts = recording.epochs(path, recording.read(path))
    assert [part.before for part in parts] == [1, 4, 8]
    for part, start in zip(parts, (*starts, starts[1])):
        assert messages.epoch_marker(part.start) == messages.epoch_marker(start)
    logs = [recording.torque_log(path, part, 'base_link', 'world') for part in parts]
    assert [log.times_ns.tolist() for log in logs] == [[4, 8], [0, 9], []]
    assert [log.torques[:, 0].tolist() for log in logs] == [[1.0, 2.0], [5.0, 4.0], []]
    assert logs[0].in_space.tolist() == [True, False]
    # The complete file is not the log of a node.
    with pytest.raises(InputError, match="message 1: frame_id: expected .*, found '/epoch "):
        torque_log(path)


@pytest.mark.parametrize(('rows', 'message'), [
    ([], 'bad.mcap: /torque: expected torques, found no message'),
    ([(1, '', [np.inf, 0, 0]), (2, '', [0, np.nan, 0])],
     'bad.mcap: /torque: expected a finite torque, found none among 2 messages$'),
    ([(1, '', [0, 0, 0]), (2, 'map', [0, 0, 0])],
     "bad.mcap: /torque: message 2: frame_id: expected 'base_link' .*found 'map'"),
    ([(0, '', [0, 0, 0]), (0, '', [1, 0, 0])], 'message 1: expected a stamp .*in 2 of 2'),
    ([(EPOCH_NS, '', [0, 0, 0]), (0, '', [1, 0, 0])], 'message 2: .* found 0, as in 1 of 2')])
def test_torques_that_cannot_be_used_are_refused_by_number(tmp_path, rows, message):
    with pytest.raises(InputError, match=message):
        torque_log(write_torques(tmp_path / 'bad.mcap', rows))


@pytest.mark.parametrize(('topic', 'message'), [
    ('/none', 'expected a topic /none, found /torque (geometry_msgs/msg/WrenchStamped), '
              '/truth/attitude (geometry_msgs/msg/QuaternionStamped), '
              '/truth/angular_velocity (geometry_msgs/msg/Vector3Stamped)'),
    ('/truth/attitude', '/truth/attitude: expected geometry_msgs/msg/WrenchStamped or '
                        'geometry_msgs/msg/Wrench or geometry_msgs/msg/Vector3Stamped, found '
                        'geometry_msgs/msg/QuaternionStamped')])
def test_a_topic_that_does_not_fit_is_named(topic, message):
    with pytest.raises(InputError, match=f'iss.mcap: {re.escape(message)}'):
        recording.read(RECORDINGS / 'iss.mcap', topic)


def test_a_message_that_is_not_what_its_schema_says_is_named(tmp_path):
    path = tmp_path / 'short.mcap'
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        writer.write('/torque', 1, messages.wrench(1, '', [1, 2, 3]))
        writer.write('/torque', 2, b'\0\1\0\0' + bytes(20))
    with pytest.raises(InputError, match='/torque: message 2: expected a .*WrenchStamped in CDR'):
        recording.read(path)


@pytest.mark.parametrize(('content', 'found'), [
    (b'', ', found an empty file'),
    (b'text', ", found another format, which begins with b'text'"),
    (bytes(1000), f', found another format, which begins with {bytes(8)}'),
    (b'\x89MCAP0\r\n', ' with messages')])
def test_what_is_no_mcap_file_is_refused(tmp_path, content, found):
    (tmp_path / 'other.bag').write_bytes(content)
    with pytest.raises(InputError, match=re.escape(f'other.bag: expected an MCAP file{found}')):
        recording.read(tmp_path / 'other.bag')


@pytest.mark.parametrize('path', ['none.mcap', 'none.db3', 'none.mcap.zstd',
                                  'x' * 300 + '.csv'], ids=lambda path: path[-9:])
def test_a_file_that_cannot_be_opened_is_named(tmp_path, path):
    with pytest.raises(InputError, match='cannot read the recording: '):
        recording.read(tmp_path / path)


def test_an_empty_name_is_no_folder():
    with pytest.raises(InputError, match='^expected a recording, found an empty name$'):
        recording.read('')


@pytest.mark.parametrize('count', [1, 10_000])
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path, count):
    # The damage is at the end, or somewhere before.
    torques = np.random.default_rng(1).normal(size=(count, 3))
    with files_up_to(512), pytest.raises(InputError,
                                         match='full.mcap: cannot write: File too large'):
        write_torques(tmp_path / 'full.mcap', ((1, '', torque) for torque in torques))
    assert not list(tmp_path.iterdir())


def test_a_full_disk_at_the_last_byte_leaves_all_torques_under_another_name(tmp_path):
    rows = [(stamp, '', torque) for stamp, torque in zip(STAMPS, TORQUES)]
    size = os.path.getsize(write_torques(tmp_path / 'whole.mcap', rows))
    with files_up_to(size - 1), pytest.raises(InputError, match=(
            'motion.mcap: cannot write: File too large; what was written so far is in .*/motion')):
        write_torques(tmp_path / 'motion.mcap', rows,
                      kind=partial(recording.Writer, keep_partial=True))
    assert {path.name for path in tmp_path.iterdir()} == {'whole.mcap', 'motion.partial.mcap'}
    assert torque_log(tmp_path / 'motion.partial.mcap').torques.tobytes() == TORQUES.tobytes()


def channels(path, *channels, encoding='cdr'):
    """Write channels: the topic, the name, encoding and text of the type, and a message."""
    with open(path, 'wb') as stream:
        writer = McapWriter(stream)
        writer.start('ros2')
        for topic, name, schema_encoding, text, message in channels:
            schema = writer.register_schema(name, schema_encoding, text.encode()) if name else 0
            channel = writer.register_channel(topic, encoding, schema)
            if message:
                writer.add_message(channel, EPOCH_NS, message, EPOCH_NS)
        writer.finish()
    return path


def registered(path, definition, encoding='ros2msg', kind=messages.WRENCH, message=None,
               name=None, message_encoding='cdr'):
    """Write a torque whose schema has the given definition and, if it is not None, name."""
    message = message or messages.wrench(EPOCH_NS, '', [1.0, 2.0, 3.0])
    return channels(path, ('/torque', name or kind.name, encoding, definition, message),
                    encoding=message_encoding)


def test_if_no_topic_fits_all_topics_are_listed_with_their_types(tmp_path):
    path = channels(tmp_path / 'other.mcap', ('/imu', 'sensor_msgs/msg/Imu', 'ros2msg', '', b''),
                    ('/raw', None, '', '', b''))
    with pytest.raises(InputError, match=re.escape(
            'WrenchStamped or geometry_msgs/msg/Wrench, found /imu (sensor_msgs/msg/Imu), '
            '/raw (no type)')):
        recording.read(path)


STANDARD = messages.WRENCH.definition
IDL = ''.join(bags.idl(kind) for kind in reversed(bags.IDL))
#: Changed definitions of a WrenchStamped, the last two in IDL, and the first difference that is
#: reported.
CHANGES = {
    'float32': ('float64 x', 'float32 x', 'float64 wrench.force.x', "'float32 wrench.force.x'"),
    'more': ('Wrench wrench\n', 'Wrench wrench\nuint8 quality\n', 'no more fields',
             "'uint8 quality'"),
    'fewer': ('float64 z\n', '', 'float64 wrench.force.z', "'float64 wrench.torque.x'"),
    'unknown': ('Wrench wrench\n', 'other_msgs/Wrench wrench\n', 'float64 wrench.force.x',
                "'other_msgs/Wrench wrench'"),
    'array': ('float64 x', 'float64[1] x', 'float64 wrench.force.x',
              "'float64[1] wrench.force.x'"),
    'idl-float': ('double x', 'float x', 'float64 wrench.force.x', "'float32 wrench.force.x'"),
    'idl-unknown': ('struct Vector3', 'struct Vector', 'float64 wrench.force.x',
                    'no more fields')}


@pytest.mark.parametrize(('standard', 'other', 'expected', 'found'), CHANGES.values(), ids=CHANGES)
def test_another_definition_of_a_type_is_refused(tmp_path, standard, other, expected, found):
    text, encoding = (STANDARD, 'ros2msg') if standard in STANDARD else (IDL, 'ros2idl')
    assert standard in text
    path = registered(tmp_path / 'other.mcap', text.replace(standard, other), encoding)
    name = messages.WRENCH.name
    with pytest.raises(InputError, match=re.escape(
            f'{path}: /torque: expected {expected} in the definition of {name}, found {found}')):
        recording.read(path)


@pytest.mark.parametrize(('kind', 'name'), [(kind, kind.name.replace('/msg/', '/')) for kind in (
    messages.WRENCH, messages.QUATERNION, messages.TRANSFORM)])
def test_the_name_of_a_type_may_lack_msg(tmp_path, kind, name):
    message = kind.encode(EPOCH_NS, '', np.arange(float(kind.doubles)))
    path = registered(tmp_path / 'ros1.mcap', kind.definition, kind=kind, message=message,
                      name=name)
    assert [*recording.topics(path, [kind])] == ['/torque']
    assert recording.read(path, kind=kind).values.tolist() == [[*range(kind.doubles)]]
    registered(path, kind.definition.replace('float64 z', 'float32 z'), kind=kind,
               message=message, name=name)
    with pytest.raises(InputError, match=f'in the definition of {name}, found .float32'):
        recording.read(path, kind=kind)


@pytest.mark.parametrize(('options', 'message'), [
    ({'encoding': 'ros1msg', 'name': 'geometry_msgs/WrenchStamped', 'message_encoding': 'ros1'},
     "/torque: expected message encoding cdr, found 'ros1'$"),
    ({'message_encoding': 'json'}, "message encoding cdr, found 'json'"),
    ({'encoding': 'jsonschema'}, "ros2msg or ros2idl, found 'jsonschema'")])
def test_another_encoding_is_refused(tmp_path, options, message):
    with pytest.raises(InputError, match=message):
        recording.read(registered(tmp_path / 'other.mcap', '{}', **options))


@pytest.mark.parametrize('name', ['log', 'log.db3', 'log.csv', 'log.ulg', 'log.bag.zst'])
def test_a_bag_of_ros_1_is_refused_with_advice(tmp_path, name):
    path, data = tmp_path / name, b'#ROSBAG V2.0\n' + bytes(100)
    path.write_bytes(zstandard.compress(data) if name.endswith('zst') else data)
    with pytest.raises(InputError, match=re.escape(
            f'{name}: expected MCAP or rosbag2, found a ROS 1 bag; convert it with '
            'rosbags-convert --src IN.bag --dst OUT')):
        recording.read(path)


#: The same definition, written in another way.
COMMENTED = re.sub(r'(?m)^(?!=|MSG)(\S+) (.*)$', r'\n# float32 y\n  \1\t\2 # z\r', STANDARD)
SAME = {
    'comments': COMMENTED, 'empty': '', 'blank': ' \n', 'root only': STANDARD.split('=')[0],
    'constants': STANDARD.replace('float64 x', 'uint8 ONE=1\nstring TWO = "x"\nfloat64 x 1.5'),
    'full names': STANDARD.replace('MSG: geometry_msgs/', 'MSG: geometry_msgs/msg/')
    .replace('Wrench wrench', 'geometry_msgs/msg/Wrench wrench')
    .replace('std_msgs/Header header', 'Header header')}


@pytest.mark.parametrize('definition', SAME.values(), ids=SAME)
def test_the_same_definition_may_be_written_in_other_ways(tmp_path, definition):
    path = registered(tmp_path / 'same.mcap', definition)
    assert recording.read(path).values[0, 3:].tolist() == [1.0, 2.0, 3.0]


#: The definition as rosidl writes it.
ROSIDL = """{equals}
IDL: geometry_msgs/msg/PoseWithCovarianceStamped
// generated from rosidl_adapter/resource/msg.idl.em
#include "geometry_msgs/msg/PoseWithCovariance.idl"
#include "std_msgs/msg/Header.idl"

module geometry_msgs {{
  module msg {{
    @verbatim (language="comment", text=
      "This expresses an \\"estimated\\" pose; // with" "\\n"
      "a covariance {{float32 x;}}")
    struct PoseWithCovarianceStamped {{
      std_msgs::msg::Header header;

      geometry_msgs::msg::PoseWithCovariance pose;
    }};
  }};
}};
{equals}
IDL: geometry_msgs/msg/PoseWithCovariance
module geometry_msgs {{
  module msg {{
    typedef double double__36[36];
    module PoseWithCovariance_Constants {{ const long SIX = 6; }};
    struct PoseWithCovariance {{
      geometry_msgs::msg::Pose pose;

      @verbatim (language="comment", text="Row-major; see (x, y)")
      @default (value=0.0)
      double__36 covariance;  // it's 36
    }};
  }};
}};
""".format(equals='=' * 80)


def test_a_definition_of_rosidl_is_the_standard_one(tmp_path):
    kind = messages.POSE_WITH_COVARIANCE
    message = kind.encode(EPOCH_NS, 'world', np.arange(43.0))
    path = registered(tmp_path / 'pose.mcap', ROSIDL, 'ros2idl', kind, message)
    assert recording.read(path, kind=kind).values.tolist() == [[*range(43)]]
    path = registered(path, ROSIDL.replace('[36]', '[9]'), 'ros2idl', kind, message)
    with pytest.raises(InputError, match=r"float64\[36\] pose.covariance in .*'float64\[9\] pose"):
        recording.read(path, kind=kind)


def test_channels_of_a_topic_must_have_one_type(tmp_path):
    path = channels(tmp_path / 'two.mcap', *(
        ('/torque', kind.name, 'ros2msg', '', bytes([0, 1]) + bytes(98))
        for kind in (messages.BARE_WRENCH, messages.WRENCH)))
    with pytest.raises(InputError, match='/torque: expected the type geometry_msgs/msg/WrenchSt'
                                         "amped, found 'geometry_msgs/msg/Wrench'"):
        recording.read(path)


def test_messages_that_are_longer_than_their_type_are_counted(tmp_path):
    path, message = tmp_path / 'long.mcap', messages.wrench(EPOCH_NS, '', [1.0, 2.0, 3.0])
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for k, more in enumerate([0, 3, 4, 100]):  # middleware pads to 4 bytes
            writer.write('/torque', EPOCH_NS + k, message + bytes(more))
    found = recording.read(path)
    assert len(found) == 4
    assert found.damage == (f'{path}: /torque: 2 messages are longer than geometry_msgs/msg/'
                            'WrenchStamped; the bytes after its last field are ignored')
