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

"""JointState messages: commands of named joints, and their velocities and efforts."""

import numpy as np
import pytest
from rigid_body_ros import messages, recording
from rigid_body_ros.recording import Column
from rigid_body_ros.scene import InputError
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
NAME = 'sensor_msgs/msg/JointState'
STAMP_NS = 1_767_225_600_123_456_789
WHEELS = ('rw_x', 'rw_y', 'rw_skewed')
COMMANDS = messages.joint_commands(WHEELS)


def theirs(names, position=(), velocity=(), effort=(), little_endian=True):
    """Return the bytes that another library encodes."""
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(STAMP_NS, 10 ** 9))
    lists = [np.array(numbers, float) for numbers in (position, velocity, effort)]
    return bytes(STORE.serialize_cdr(types[NAME](
        types['std_msgs/msg/Header'](stamp, 'base_link'), [*names], *lists), NAME,
        little_endian=little_endian))


@pytest.mark.parametrize('little_endian', [True, False])
@pytest.mark.parametrize('names', [(), ('a',), ('wheel', 'b', 'ünïcode')])
@pytest.mark.parametrize('which', [(), (0, 2), (0, 1, 2)])
def test_we_read_and_write_what_others_do(names, which, little_endian):
    random = np.random.default_rng(len(names))
    lists = [random.normal(size=len(names)) if k in which else [] for k in range(3)]
    data = theirs(names, *lists, little_endian=little_endian)
    found = messages.decoded_joints(data)
    assert found[:3] == (STAMP_NS, 'base_link', names)
    for numbers, expected in zip(found[3:], lists):
        np.testing.assert_array_equal(numbers, expected)
    if little_endian:
        assert messages.encoded_joints(STAMP_NS, 'base_link', names, *lists) == data


def test_a_command_lists_some_of_the_joints_in_any_order():
    found = COMMANDS.decode(theirs(['rw_skewed', 'rw_x'], [], [], [3.0, 1.0]))
    assert found[:3] == (STAMP_NS, 'base_link', '')
    np.testing.assert_array_equal(found.values, [1.0, np.nan, 3.0])
    again = messages.decoded_joints(COMMANDS.encode(STAMP_NS, 'base_link', found.values))
    assert (again.names, again.effort.tolist()) == (('rw_x', 'rw_skewed'), [1.0, 3.0])
    assert np.isnan(COMMANDS.decode(theirs([])).values).all()
    # Positions and velocities do not change the command.
    more = theirs(['rw_y'], [7.0], [8.0], [9.0])
    np.testing.assert_array_equal(COMMANDS.decode(more).values, [np.nan, 9.0, np.nan])


@pytest.mark.parametrize(('data', 'error'), [
    (theirs(['rw_z'], effort=[1.0]), "name: expected some of 'rw_x', .* found 'rw_z'"),
    (theirs(['rw_x', 'rw_x'], effort=[1.0, 2.0]), "name: expected each once, found 'rw_x' twice"),
    (theirs(['rw_x', 'rw_y']), 'effort: expected 2, as there are names, found none'),
    (theirs(['rw_x', 'rw_y'], effort=[1.0]), 'effort: expected none or 2, .* found 1'),
    (theirs(['rw_x'], [1.0, 2.0], effort=[1.0]), 'position: expected none or 1, .*found 2'),
    (theirs(['rw_x'], effort=[np.nan]), r'effort: expected finite numbers, found \[nan\]'),
    *((data, 'expected a sensor_msgs/msg/JointState in CDR') for data in (
        b'', theirs(['rw_x'], effort=[1.0])[:-1], theirs(['rw_x'])[:30],
        b'\0\1\0\0' + bytes(12) + b'\xff' * 40))])
def test_a_command_that_makes_no_sense_is_refused(data, error):
    with pytest.raises(ValueError, match=error):
        COMMANDS.decode(data)


@pytest.mark.parametrize('names', [('a',), WHEELS])
@pytest.mark.parametrize('frame', ['', 'base_link'])
def test_states_have_velocities_and_efforts(names, frame):
    speeds, efforts = np.random.default_rng(1).normal(size=(2, 5, len(names)))
    kind = messages.joint_states(names)
    rows = np.empty(5, kind.layout(frame))
    kind.fill(rows, STAMP_NS + np.arange(5), messages.joint_values(speeds, efforts), frame)
    for k, row in enumerate(rows):
        data = row.tobytes()
        assert kind.encode(STAMP_NS + k, frame, messages.joint_values(
            speeds[k:k + 1], efforts[k:k + 1])[0]) == data
        found = STORE.deserialize_cdr(data, NAME)
        assert (found.header.frame_id, found.name, found.position.size) == (frame, [*names], 0)
        np.testing.assert_array_equal(found.velocity, speeds[k])
        np.testing.assert_array_equal(found.effort, efforts[k])


@pytest.mark.parametrize('kind', [COMMANDS, messages.joint_states(WHEELS)])
def test_the_definition_is_that_of_ros(kind):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(kind.definition, kind.name))
    assert store.hash_rihs01(kind.name) == STORE.hash_rihs01(kind.name) == kind.type_hash


def test_a_recording_has_commands_and_states(tmp_path):
    path, states = tmp_path / 'wheels.mcap', messages.joint_states(WHEELS)
    commands = [[1.0, np.nan, 3.0], [np.nan, 2.0, np.nan]]
    with recording.Writer(path) as writer:
        writer.add_topic('/wheel_command', COMMANDS)
        writer.add_topic('/wheel_states', states)
        for stamp_ns, efforts in enumerate(commands):
            writer.write('/wheel_command', stamp_ns, COMMANDS.encode(stamp_ns, '', efforts))
        writer.write_columns(np.arange(4), [Column('/wheel_states', 'base_link', (
            messages.joint_values(np.eye(4, 3), np.ones((4, 3)))))])
    found = recording.read(path, '/wheel_command', COMMANDS)
    np.testing.assert_array_equal(found.values, commands)
    assert found.stamps_ns.tolist() == [0, 1]
    written = recording.read(path, '/wheel_states', states).values
    np.testing.assert_array_equal(written[:, :3], np.eye(4, 3))
    np.testing.assert_array_equal(written[:, 4:], np.ones((4, 3)))
    with pytest.raises(InputError, match="message 1: name: .*'other', found 'rw_x'"):
        recording.read(path, '/wheel_command', messages.joint_commands(['other']))
