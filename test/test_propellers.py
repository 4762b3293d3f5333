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

"""Wrenches in the frames of propellers, which continuous joints rotate about an axis."""

from dataclasses import replace
import re

from conftest import EPOCH_NS, SECOND
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics import urdf
from rigid_body_ros.recording.torques import torque_pieces
from robots import ROBOT, robot
from scipy.spatial.transform import Rotation
import yaml

#: A vector along the axis of the propeller of ROBOT, with norm 3.
AXIS = np.array([1.0, 2.0, 2.0])
CENTRE = np.array([0.25, 0.0, -0.5])
EPS = np.finfo(float).eps


def text(numbers):
    return ' '.join(map(repr, numbers.tolist()))


def propeller(axis, rpy='0.4 -0.1 0.3', xyz='0.1 0.2 0.3'):
    """Return the frame of a propeller on the body."""
    return urdf.fixed_frames(robot(
        ('continuous', 'base_link', 'propeller', xyz, rpy, *axis)))['propeller']


def test_the_propellers_of_a_quadrotor_roll_pitch_and_yaw_it():
    arm, height = 0.2, 0.05
    places = {'front_left': (1, 1, -1), 'back_left': (-1, 1, 1),
              'back_right': (-1, -1, -1), 'front_right': (1, -1, 1)}
    frames = urdf.fixed_frames(robot(*(
        ('continuous', 'base_link', name, f'{x * arm} {y * arm} {height}', '0 0 0', '0 0 1')
        for name, (x, y, _) in places.items()), origin=' xyz="0 0 0.03"'))
    thrusts, drags = np.random.default_rng(2).uniform(1.0, 3.0, (2, 4))
    total = sum(frames[name].torque([0.0, 0.0, thrust], [0.0, 0.0, turn * drag])
                for (name, (_, _, turn)), thrust, drag in zip(places.items(), thrusts, drags))
    front_left, back_left, back_right, front_right = thrusts
    np.testing.assert_allclose(total, [
        arm * (front_left + back_left - back_right - front_right),
        arm * (back_left + back_right - front_left - front_right),
        drags[1] + drags[3] - drags[0] - drags[2]], rtol=0, atol=4 * EPS)


@pytest.mark.parametrize('seed', range(10))
def test_thrust_and_drag_along_a_skewed_axis_have_the_lever_arm_of_its_origin(seed):
    random = np.random.default_rng(seed)
    axis, position, angles = random.normal(size=(3, 3))
    along = axis / np.linalg.norm(axis)
    forces, torques = random.normal(size=(2, 30, 1)) * along
    found = propeller([text(axis)], text(angles), text(position)).torque(forces, torques)
    turn = Rotation.from_euler('xyz', angles)
    expected = turn.apply(torques) + np.cross(position - CENTRE, turn.apply(forces))
    np.testing.assert_allclose(found, expected, rtol=0, atol=64 * EPS)


@pytest.mark.parametrize('angle', [0.1, 1.0, np.pi / 2, np.pi, -2.5])
def test_the_angle_of_a_propeller_changes_no_torque(angle):
    force, torque = 2.0 * AXIS, -0.3 * AXIS
    start = Rotation.from_euler('xyz', [0.4, -0.1, 0.3])
    turned = (start * Rotation.from_rotvec(angle * AXIS / 3.0)).as_euler('xyz')
    np.testing.assert_allclose(propeller(['1 2 2'], text(turned)).torque(force, torque),
                               propeller(['1 2 2']).torque(force, torque), rtol=0, atol=64 * EPS)


@pytest.mark.parametrize(('axis', 'expected'), [
    ([], [1, 0, 0]), (['0 0 -5'], [0, 0, -1]), (['1e308 0 1e308'], [0.5 ** 0.5, 0, 0.5 ** 0.5]),
    (['0 5e-324 0'], [0, 1, 0])])
def test_an_axis_is_a_unit_vector_and_x_by_default(axis, expected):
    np.testing.assert_allclose(propeller(axis).axis, expected, rtol=EPS, atol=0)


def test_a_thrust_along_an_axis_of_the_frame_has_the_bits_of_a_fixed_frame():
    turning = propeller(['0 0 1'])
    fixed = urdf.fixed_frames(robot(
        ('fixed', 'base_link', 'f', '0.1 0.2 0.3', '0.4 -0.1 0.3')))['f']
    wrenches = np.random.default_rng(4).normal(size=(100, 6)) * [0, 0, 1, 0, 0, 1]
    assert (turning.torque(wrenches[:, :3], wrenches[:, 3:])
            == fixed.torque(wrenches[:, :3], wrenches[:, 3:])).all()


def test_one_wrench_along_the_axis_has_the_bits_that_it_has_among_many():
    wrenches = np.random.default_rng(5).normal(size=(200, 2)) * 10.0 ** np.arange(-5, 5, 0.05)[
        :, None]
    forces, torques = wrenches[:, :1] * AXIS, wrenches[:, 1:] * AXIS
    forces[::3] = 0.0
    frame = urdf.fixed_frames(ROBOT)['propeller']
    alone = [frame.torque(force, torque) for force, torque in zip(forces, torques)]
    assert np.array(alone).tobytes() == frame.torque(forces, torques).tobytes()


@pytest.mark.parametrize('scale', [1.0, 1e-308, 1e300])
def test_rounding_across_the_axis_is_accepted_and_has_no_effect(scale):
    subnormal = 5e-324 * np.arange(1, 200)[:, None] * AXIS
    assert np.isfinite(propeller(['1 2 2']).torque(subnormal, -subnormal)).all()
    frame, exact = propeller(['0 0 1'], '0 0 0'), np.array([0.0, 0.0, scale])
    rounded = [8 * EPS * scale, 0.0, scale]
    assert frame.torque(rounded, rounded).tolist() == frame.torque(exact, exact).tolist()


@pytest.mark.parametrize('size', [1e-12, 1e-3, 1.0])
@pytest.mark.parametrize('part', ['force', 'torque'])
def test_a_wrench_with_a_part_across_the_axis_is_rejected(size, part):
    frame, across = propeller(['1 2 2']), size * np.array([2.0, -1.0, 0.0])
    wrench = {'force': AXIS, 'torque': np.zeros(3)} | {part: AXIS + across}
    with pytest.raises(ValueError, match='^' + re.escape(
            f'expected force and torque along the axis {frame.axis.tolist()} of joint '
            f"'to_propeller' (continuous), found force {wrench['force'].tolist()} and torque "
            f"{wrench['torque'].tolist()}") + '$'):
        frame.torque(**wrench)
    many = {name: np.tile(vector, (5, 1)) for name, vector in wrench.items()}
    many[part][:3] = AXIS
    with pytest.raises(ValueError, match=re.escape(f'{part} {wrench[part].tolist()}')) as found:
        frame.torque(**many)
    assert found.value.row == 3


def test_what_a_propeller_carries_or_hangs_from_is_rejected():
    frames = urdf.fixed_frames(robot(
        ('fixed', 'frame', 'base_link', '0 0 1', '0 0 0'),
        ('continuous', 'frame', 'hub', '1 0 0', '0 0 0', '0 0 1'),
        ('fixed', 'hub', 'blade', '0 0 0', '0 0 0'),
        ('continuous', 'hub', 'pitch', '0 0 0', '0 0 0', '0 0 1'),
        ('continuous', 'stand', 'base_link', '0 0 0', '0 0 0', '0 0 1')))
    assert {*frames} == {'base_link', 'frame', 'hub'}
    for name, joint in (('blade', 'to_hub'), ('pitch', 'to_hub'), ('stand', 'to_base_link')):
        with pytest.raises(KeyError, match=f"{name}': joint '{joint}' .continuous. moves it"):
            frames[name]
    position = frames['hub'].position
    np.testing.assert_allclose(position, [0.75, 0.0, -0.5], rtol=0, atol=EPS)
    assert {*urdf.fixed_frames(robot(  # a closed loop
        ('continuous', 'base_link', 'hub', '1 0 0', '0 0 0', '0 0 1'),
        ('fixed', 'hub', 'rod', '0 0 0', '0 0 0'),
        ('fixed', 'base_link', 'rod', '0 0 0', '0 0 0')))} == {'base_link'}


def test_the_axes_of_a_propeller_are_not_those_of_the_body_although_they_may_be_aligned():
    frames = urdf.fixed_frames(robot(('continuous', 'base_link', 'hub', '0 0 1', '0 0 0')))
    assert frames.of_body('hub') is frames['base_link']


@pytest.fixture
def described(tmp_path):
    """Return the path of a scene with ROBOT and another propeller."""
    path = tmp_path / 'scene.yaml'
    second = robot(('continuous', 'mast', 'second', '0 0 1', '0 0 0', '0 0 1'))
    joint = re.search('<joint.*</joint>', second).group()
    path.write_text(yaml.dump({'/**': {'ros__parameters': {
        'robot_description': ROBOT.replace('</robot>', f'<link name="second"/>{joint}</robot>'),
        'frame_prefix': 'one/'}}}))
    return path


def write(path, *wrenches):
    """Write a recording of wrenches, each given as a frame and six numbers."""
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for number, (name, values) in enumerate(wrenches):
            stamp = EPOCH_NS + number * SECOND
            writer.write('/torque', stamp, messages.WRENCH.encode(stamp, name, values))


@pytest.mark.parametrize('whole', [False, True])
def test_a_replay_names_the_first_wrench_across_the_axis_of_its_frame(tmp_path, described, capsys,
                                                                      whole):
    path = tmp_path / 'log.mcap'
    write(path, ('one/propeller', [*AXIS, *AXIS]), ('one/second', [0, 0, 1, 0, 0, 1]),
          ('one/second', [0, 0.5, 1, 0, 0, 2]), ('one/propeller', [*AXIS, 0, 0, 1]))
    more = ['--plot', str(tmp_path / 'motion.png')] if whole else []
    assert main.attitude_replay([str(path), '--scene', str(described), '-o',
                                str(tmp_path / 'motion.mcap'), *more]) == 2
    assert capsys.readouterr().err == (
        f"attitude_replay: error: {path}: /torque: message 3: frame 'one/second': expected force "
        "and torque along the axis [0.0, 0.0, 1.0] of joint 'to_second' (continuous), found force "
        '[0.0, 0.5, 1.0] and torque [0.0, 0.0, 2.0]\n')
    assert sorted(file.name for file in tmp_path.iterdir()) == ['log.mcap', 'scene.yaml']


def test_messages_are_counted_from_the_first_of_a_recording_in_pieces(tmp_path, described):
    blocks = []
    for across in (0.0, 1.0):
        path = tmp_path / f'{across}.mcap'
        write(path, ('one/second', [0, 0, 1, 0, 0, 1]), ('one/second', [0, across, 1, 0, 0, 0]))
        blocks.append(replace(recording.read(path), before=2 * len(blocks)))
    with pytest.raises(InputError, match="^log: message 4: frame 'one/second': expected force"):
        list(torque_pieces('log', blocks, 'base_link', 'world', scene.load(described).links))
