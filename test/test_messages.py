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

"""Messages have the bytes and definitions that other tools expect."""

import numpy as np
import pytest
from rigid_body_ros import messages, State
from rigid_body_ros.messages import TYPES
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)
STAMP_NS = 1_767_225_600_123_456_789
KINDS = list(TYPES.values())


def values(kind):
    return np.random.default_rng(kind.doubles).normal(size=kind.doubles)


def doubles(message):
    """Return the doubles of a rosbags message in field order; for a Marker, those that vary."""
    if isinstance(message, float):
        return [message]
    if isinstance(message, np.ndarray):
        return list(message)
    if isinstance(message, list):
        message, = message
    if message.__msgtype__ == messages.BOX.name:
        return doubles(message.pose) + doubles(message.scale)
    fields = [value for name, value in vars(message).items()
              if name not in ('header', 'child_frame_id', '__msgtype__')]
    return [number for field in fields for number in doubles(field)]


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize('frame', ['', 'a', 'world', 'base_link', 'ünïcode'])
def test_others_read_what_we_encode(kind, frame):
    message = STORE.deserialize_cdr(kind.encode(STAMP_NS, frame, values(kind), 'child'), kind.name)
    if kind.is_list:
        message, = message.transforms
    assert message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec == STAMP_NS
    assert message.header.frame_id == frame
    assert getattr(message, 'child_frame_id', getattr(message, 'ns', 'child')) == 'child'
    assert doubles(message) == list(values(kind))


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize('little_endian', [True, False])
def test_we_read_what_others_encode(kind, little_endian):
    ours = kind.encode(STAMP_NS, 'base_link', values(kind), 'other')
    theirs = bytes(STORE.serialize_cdr(STORE.deserialize_cdr(ours, kind.name), kind.name,
                                       little_endian=little_endian))
    decoded = kind.decode(theirs)
    assert decoded[:2] == (STAMP_NS, 'base_link')
    assert decoded.child_frame_id == ('other' if kind.has_child_frame else '')
    np.testing.assert_array_equal(decoded.values, values(kind))


@pytest.mark.parametrize('kind', [*KINDS, messages.joint_commands(['a'])],
                         ids=lambda kind: kind.name)
def test_definitions_are_those_of_ros(kind):
    ours = get_types_from_msg(kind.definition, kind.name)
    for name, (_, fields) in ours.items():
        assert [field[0] for field in fields] == [field[0] for field in STORE.fielddefs[name][1]]
    store = get_typestore(Stores.EMPTY)
    store.register(ours)
    assert store.hash_rihs01(kind.name) == STORE.hash_rihs01(kind.name) == kind.type_hash


@pytest.mark.parametrize('data', [b'', b'\0', b'\0\1\0\0', b'\0\7\0\0' + bytes(80), bytes(200),
                                  messages.wrench(STAMP_NS, 'world', [1, 2, 3])[:-1],
                                  b'\0\1\0\0' + b'\xff' * 4 + bytes(80),
                                  b'\0\1\0\0' + bytes(4) + b'\0\x28\x6b\xee' + bytes(80),
                                  b'\0\1\0\0' + bytes(8) + b'\xff\xff\xff\x7f' + bytes(80)])
def test_bytes_that_are_no_message_are_refused(data):
    with pytest.raises(ValueError, match=f'expected a geometry_msgs/msg/WrenchStamped in CDR, '
                                         f'found {len(data)} bytes'):
        messages.WRENCH.decode(data)


def test_a_wrench_carries_a_torque_and_no_force():
    wrench = messages.WRENCH.decode(messages.wrench(STAMP_NS, 'world', [1.0, 2.0, 3.0]))
    assert wrench.values.tolist() == [0, 0, 0, 1, 2, 3]
    assert messages.torque(wrench).tolist() == [1, 2, 3]


def test_odometry_carries_attitude_and_body_rates():
    state = State(STAMP_NS, (0.5, -0.5, 0.5, 0.5), (1.0, 2.0, 3.0))
    message = STORE.deserialize_cdr(messages.odometry(state, 'world', 'base_link'),
                                    'nav_msgs/msg/Odometry')
    assert (message.header.frame_id, message.child_frame_id) == ('world', 'base_link')
    assert doubles(message.pose.pose.orientation) == [0.5, -0.5, 0.5, 0.5]
    assert doubles(message.twist.twist.angular) == [1.0, 2.0, 3.0]
    assert np.count_nonzero(doubles(message)) == 7


def test_an_imu_measures_attitude_and_body_rates_and_no_acceleration():
    state = State(STAMP_NS, (0.5, -0.5, 0.5, 0.5), (1.0, 2.0, 3.0))
    message = STORE.deserialize_cdr(messages.imu(STAMP_NS, 'base_link', state),
                                    'sensor_msgs/msg/Imu')
    assert message.header.frame_id == 'base_link'
    assert doubles(message.orientation) == [0.5, -0.5, 0.5, 0.5]
    assert doubles(message.angular_velocity) == [1.0, 2.0, 3.0]
    assert message.linear_acceleration_covariance[0] == -1.0
    assert np.count_nonzero(doubles(message)) == 8


def test_a_transform_takes_body_to_space():
    state = State(STAMP_NS, (0.5, -0.5, 0.5, 0.5), (1.0, 2.0, 3.0))
    message, = STORE.deserialize_cdr(messages.transform(state, 'world', 'base_link'),
                                     'tf2_msgs/msg/TFMessage').transforms
    assert (message.header.frame_id, message.child_frame_id) == ('world', 'base_link')
    assert doubles(message.transform) == [0, 0, 0, 0.5, -0.5, 0.5, 0.5]


@pytest.mark.parametrize(('frame_id', 'frame'), [('', 'body'), ('b', 'body'), ('s', 'space')])
def test_the_frame_id_tells_the_axes(frame_id, frame):
    assert messages.torque_frame(frame_id, 'b', 's') == frame


def test_another_frame_id_is_refused():
    with pytest.raises(ValueError, match="frame_id: expected 'b' or '' .*'s' .*found 'map'"):
        messages.torque_frame('map', 'b', 's')


@pytest.mark.parametrize(('kind', 'shape', 'color'), [
    (messages.BOX, 1, (0.70, 0.75, 0.80, 0.8)), (messages.ORANGE_ARROW, 0, (0.90, 0.62, 0, 1)),
    (messages.BLUE_ARROW, 0, (0.0, 0.27, 0.70, 1))])
def test_a_marker_is_a_shape_of_a_colour_and_nothing_else(kind, shape, color):
    marker = STORE.deserialize_cdr(kind.encode(STAMP_NS, 'world', values(kind), 'body'), kind.name)
    assert (marker.id, marker.type, marker.action, marker.frame_locked) == (0, shape, 0, False)
    found = [marker.color.r, marker.color.g, marker.color.b, marker.color.a]
    np.testing.assert_allclose(found, color, rtol=1e-7)
    assert (marker.lifetime.sec, marker.lifetime.nanosec) == (0, 0)
    for empty in (marker.text, marker.mesh_resource, marker.texture_resource, marker.points,
                  marker.colors, marker.texture.data, marker.mesh_file.data,
                  marker.uv_coordinates):
        assert len(empty) == 0


# JointState: commands of named joints, and their velocities and efforts

NAME = 'sensor_msgs/msg/JointState'
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
