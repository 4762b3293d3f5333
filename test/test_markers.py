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

"""Markers: the shapes of a replay that rviz and Foxglove draw."""

from conftest import CONFIG, RECORDINGS
import numpy as np
import pytest
from rigid_body_ros import messages, propagate, recording, RigidBody, scene, State
from rigid_body_ros.mechanics import so3
from rigid_body_ros.replay import markers, replay
from rosbags.highlevel import AnyReader

SIDES = np.array([0.2, 0.5, 0.9])


def brick(sides, mass=3.0):
    squares = sides ** 2
    return RigidBody(np.diag(mass / 12.0 * (squares.sum() - squares)))


def vectors(values):
    """Return the directions and the lengths of arrows."""
    return so3.rotate(values[:, 3:7], [1.0, 0.0, 0.0]), values[:, 7]


def columns(body, start, seconds=(0, 1, 2, 3)):
    motion = propagate(body, start, at=np.array(seconds) * 10 ** 9)
    return motion, {column.topic: column.values for column in markers.columns(motion, 'world')}


def test_a_brick_is_drawn_in_its_own_proportions_and_a_rod_with_a_size_along_every_axis():
    np.testing.assert_allclose(np.sort(markers.box(brick(SIDES))), SIDES / 0.9, rtol=1e-14)
    assert (markers.box(RigidBody(np.diag([1e-30, 1.0, 1.0]))) > 0.0).all()


@pytest.mark.parametrize('turn', [(0, 0, 0, 1), (0.1, 0.7, -0.3, 0.6), (1, 0, 0, 0), (0, 1, 1, 0)])
def test_the_box_lies_where_the_body_does(turn):
    # The box is turned within the body, and the body in space. The moments of the box, in space
    # axes, must be those of the body.
    inner = so3.matrix(so3.normalize((0.3, -0.2, 0.5, 0.7)))
    body = RigidBody(inner @ brick(SIDES).inertia @ inner.T)
    motion, drawn = columns(body, State(0, turn, (0.3, 1.0, -0.2)))
    for values, attitude in zip(drawn[markers.BODY], motion.attitude):
        axes, rotation = so3.matrix(values[3:7]), so3.matrix(attitude)
        found = axes @ brick(0.9 * values[7:10]).inertia @ axes.T
        np.testing.assert_allclose(found, rotation @ body.inertia @ rotation.T, rtol=0, atol=2e-15)


@pytest.mark.parametrize('rates', [(0.3, 1.0, -0.2), (1, 0, 0), (-1, 0, 0), (0, 0, -2),
                                   (-2, 1e-9, 0)])
def test_arrows_lie_along_angular_momentum_and_velocity(rates):
    motion, drawn = columns(brick(SIDES), State(0, angular_velocity=rates))
    for topic, expected in (
            (markers.ANGULAR_MOMENTUM, motion.angular_momentum_space),
            (markers.ANGULAR_VELOCITY, so3.rotate(motion.attitude, motion.angular_velocity))):
        along, length = vectors(drawn[topic])
        np.testing.assert_allclose(
            along, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-6)
        assert (length == 1.0).all()


def test_a_body_at_rest_has_no_arrows_to_speak_of():
    _, drawn = columns(brick(SIDES), State())
    for topic in (markers.ANGULAR_MOMENTUM, markers.ANGULAR_VELOCITY):
        _, length = vectors(drawn[topic])
        assert np.isfinite(drawn[topic]).all()
        assert ((length > 0.0) & (length < 0.01)).all()  # rviz rejects a size of zero


def test_a_replay_writes_them_on_request(tmp_path):
    loaded, output = scene.load(CONFIG / 'tumbler.yaml'), tmp_path / 'motion.mcap'
    replay(RECORDINGS / 'tumbler.mcap', loaded, output, also=('markers',))
    attitude = recording.read(output, '/attitude', messages.QUATERNION)
    body = recording.read(output, markers.BODY, messages.BOX)
    np.testing.assert_array_equal(body.stamps_ns, attitude.stamps_ns)
    np.testing.assert_array_equal(body.values[:, 3:7], so3.multiply(
        attitude.values, so3.from_matrix(loaded.body.principal_axes)))
    assert set(body.frame_ids) == {'world'}
    with AnyReader([output]) as reader:
        names = {each.topic: each.msgtype for each in reader.connections}
        assert {names[topic] for topic in markers.TOPICS} == {'visualization_msgs/msg/Marker'}
        connection, = (each for each in reader.connections if each.topic == markers.BODY)
        _, _, data = next(reader.messages([connection]))
        first = reader.deserialize(data, connection.msgtype)
    assert first.ns == 'body'
    assert (first.color.a, first.type) == (pytest.approx(0.8), 1)
