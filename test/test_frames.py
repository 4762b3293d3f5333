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

"""Wrenches in the frames of links and propellers: in URDF, in recordings and in commands."""

from dataclasses import replace
import pickle
import re

import bags
from conftest import EPOCH_NS, ROOT, SECOND
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics import urdf
from rigid_body_ros.recording.torques import torque_pieces
from rigid_body_ros.replay import replay
from robots import converted, JOINTS, ROBOT, robot, text, tree, wrenches
from scipy.spatial.transform import Rotation
import yaml

#: Doubles that any arithmetic would change.
ODD = [[-0.0, 0.0, -0.0], [5e-324, -5e-324, 1.7976931348623157e308], [0.1, -0.2, 0.3]]
#: A vector along the axis of the propeller of ROBOT, with norm 3.
AXIS = np.array([1.0, 2.0, 2.0])
CENTRE, EPS = np.array([0.25, 0.0, -0.5]), np.finfo(float).eps
TWO_PROPELLERS = robot(*JOINTS, ('continuous', 'mast', 'second', '0 0 1', '0 0 0', '0 0 1'))


@pytest.mark.parametrize('seed', range(4))
def test_frames_are_composed_along_fixed_joints_in_both_directions(seed):
    random = np.random.default_rng(seed)
    joints, places = tree(random, 7 * ['fixed'])
    body, centre = f'l{random.integers(8)}', random.normal(size=3)
    frames = urdf.fixed_frames(robot(*random.permutation(joints), body=body,
                                     origin=f' xyz="{text(centre)}" rpy="1 2 3"'))
    assert {*frames} == {*places}
    axes, place = places[body]
    for child, (turn, position) in places.items():
        found, rotation = frames[child], (axes.inv() * turn).as_matrix()
        position = axes.inv().apply(position - place) - centre
        np.testing.assert_allclose(found.rotation, rotation, rtol=0, atol=1e-14)
        np.testing.assert_allclose(found.position, position, rtol=0, atol=3e-14)
        force, torque = random.normal(size=(2, 10, 3))
        np.testing.assert_allclose(
            found.torque(force, torque),
            torque @ rotation.T + np.cross(position, force @ rotation.T), rtol=0, atol=1e-12)


def test_a_position_is_rounded_once():
    steps = (('base_link', 'a', '1e8'), ('a', 'b', '0.1'), ('b', 'c', '-1e8'))
    frames = urdf.fixed_frames(robot(
        *(('fixed', parent, child, f'{x} 0 0', '0 0 0') for parent, child, x in steps), origin=''))
    assert frames['c'].position.tolist() == [0.1, 0.0, 0.0]


@pytest.mark.parametrize('name', ['base_link', 'mast', 'footprint'])
def test_a_torque_in_an_aligned_frame_keeps_its_bits(name):
    frame, torques = urdf.fixed_frames(ROBOT)[name], np.array(ODD)
    forces = np.zeros_like(torques)
    assert frame.torque(forces, torques).tobytes() == torques.tobytes()
    forces[2] = 1.0  # must not change the bits of the others
    assert frame.torque(forces, torques)[:2].tobytes() == torques[:2].tobytes()


def test_one_wrench_has_the_bits_that_it_has_among_many():
    random, sizes = np.random.default_rng(5), 10.0 ** (np.arange(200)[:, None] % 6 - 3)
    forces, torques = random.normal(size=(2, 200, 3)) * sizes
    forces[::3] = 0.0
    for name, frame in urdf.fixed_frames(ROBOT).items():
        if name == 'propeller':
            forces, torques = forces[:, :1] * AXIS, torques[:, :1] * AXIS
        alone = [frame.torque(*wrench) for wrench in zip(forces, torques)]
        assert np.array(alone).tobytes() == frame.torque(forces, torques).tobytes()


def test_frames_survive_the_way_to_another_process():
    frames = pickle.loads(pickle.dumps(urdf.fixed_frames(ROBOT)))
    assert [*frames] == ['base_link', 'thruster', 'mast', 'footprint', 'lamp', 'propeller']
    with pytest.raises(KeyError, match='joint .to_arm. .revolute. moves it'):
        frames['hand']


def changed(old, new):
    assert old in ROBOT
    return ROBOT.replace(old, new)


@pytest.mark.parametrize(('robot', 'frame', 'reason'), [
    *((changed('revolute', kind), name, f"joint 'to_arm' ({kind}) moves it relative to the body")
      for kind, name in (('revolute', 'arm'), ('continuous', 'hand'), ('planar', 'arm'))),
    (ROBOT, 'label', "no joints connect it to 'base_link'"),
    (ROBOT, 'map', "expected a link of the URDF whose forces are accepted: 'base_link', "
                   "'thruster', 'mast', 'footprint', 'lamp', 'propeller'"),
    (changed('revolute', 'weld'), 'hand', "URDF joint 'to_arm': type: expected one of fixed, "
     "revolute, continuous, prismatic, floating, planar, found 'weld'"),
    (changed('xyz="0 0 0.5"', 'xyz="0 0"'), 'lamp',
     "URDF joint 'to_mast': xyz: expected 3 finite numbers, found '0 0'"),
    (changed('xyz="0 0.5 0"', 'xyz="0 1e308 0"'), 'lamp',
     'expected a position of at most 1e+300 m'),
    *((changed('<axis xyz="1 2 2"/>', axis), 'propeller',
       f"URDF joint 'to_propeller': axis: xyz: expected {expected}")
      for axis, expected in (
          ('<axis xyz="0 -0.0 0"/>', 'a vector other than zero, found [0.0, -0.0, 0.0]'),
          ('<axis xyz="0 0 inf"/>', "3 finite numbers, found '0 0 inf'"),
          ('<axis/>', '3 finite numbers, found nothing'))),
    (robot(*JOINTS, ('fixed', 'lamp', 'footprint', '0 0 0', '0 0 0')), 'lamp',
     "the joints between it and 'base_link' form a closed loop")])
def test_a_frame_that_is_not_fixed_is_rejected_with_the_reason(robot, frame, reason):
    frames = urdf.fixed_frames(robot, 'base_link')
    assert frame not in frames
    for error in (KeyError, ValueError):
        with pytest.raises(error, match=f"^{re.escape(f'frame {frame!r}: {reason}')}$"):
            frames[frame]


@pytest.fixture
def scene_file(tmp_path):
    """Return a function that writes a scene with a URDF and further parameters."""
    def write(description=ROBOT, **parameters):
        path = tmp_path / 'scene.yaml'
        path.write_text(yaml.dump({'/**': {'ros__parameters': {
            'robot_description': description, 'initial_angular_velocity': {'y': 0.6},
            **parameters}}}))
        return path
    return write


@pytest.mark.parametrize(('body_frame', 'position'), [
    ('base_link', [-0.25, 0.0, 0.5]), ('robot_1/base_link', [-0.25, 0.0, 0.5]),
    ('mast', [-0.25, 0.0, 1.0])])
def test_the_body_frame_is_the_link_or_one_with_the_same_axes(scene_file, body_frame, position):
    loaded = scene.load(scene_file(body_frame=body_frame))
    assert not loaded.warnings
    for frame_id in ('', body_frame):
        axes, frame = messages.wrench_frame(frame_id, body_frame, 'world', loaded.links)
        assert (axes, frame.position.tolist()) == ('body', position)


def test_a_frame_prefix_names_the_body_and_its_links_but_not_space(scene_file):
    plain, loaded = scene.load(scene_file()), scene.load(scene_file(frame_prefix='one/'))
    assert (loaded.body_frame, loaded.space_frame) == ('one/base_link', 'world')
    assert not loaded.warnings
    assert {*loaded.links} == {f'one/{name}' for name in plain.links}
    for name, frame in plain.links.items():
        assert loaded.links[f'one/{name}'] is not frame
        np.testing.assert_array_equal(loaded.links[f'one/{name}'].position, frame.position)
    for frame_id, axes in (('', 'body'), ('one/base_link', 'body'), ('one/mast', 'body'),
                           ('world', 'space')):
        assert messages.wrench_frame(frame_id, loaded.body_frame, 'world', loaded.links)[0] == axes
    for frame_id in ('base_link', 'mast', 'two/base_link', 'one/world'):
        with pytest.raises(ValueError, match="expected 'one/base_link' or '' .body axes."):
            messages.wrench_frame(frame_id, loaded.body_frame, 'world', loaded.links)
    with pytest.raises(ValueError, match="'one/hand': joint 'to_arm' .revolute. moves it"):
        messages.wrench_frame('one/hand', loaded.body_frame, 'world', loaded.links)


@pytest.mark.parametrize('body_frame', ['thruster', 'hand', 'label'])
def test_a_body_frame_with_other_axes_is_warned_of_and_means_the_link(scene_file, body_frame):
    loaded = scene.load(scene_file(body_frame=body_frame))
    assert loaded.warnings == [
        f"body_frame: '{body_frame}' is a link of robot_description, but its axes are not those "
        "of link 'base_link', whose axes are the body axes; expected 'base_link'"]
    _, frame = messages.wrench_frame(body_frame, body_frame, 'world', loaded.links)
    assert frame is loaded.links['base_link']


def test_the_scene_in_the_documentation_has_the_torques_that_it_states(tmp_path):
    page = (ROOT / 'docs' / 'node_howto.md').read_text(encoding='utf-8')
    example, = re.findall(r'```yaml\n(.*?)```', page, re.DOTALL)
    (tmp_path / 'drone.yaml').write_text(example)
    links = scene.load(tmp_path / 'drone.yaml').links
    for name, expected in (('left_thruster', -0.6), ('tail_thruster', -0.9)):
        np.testing.assert_allclose(links[name].torque([3.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
                                   [0.0, 0.0, expected], rtol=0, atol=1e-15)


def test_the_space_frame_is_no_link(scene_file):
    links = scene.load(scene_file(changed('footprint', 'world'))).links
    assert messages.wrench_frame('world', 'base_link', 'world', links) == ('space', None)


@pytest.mark.slow
@pytest.mark.parametrize('form', ['mcap-big-endian', 'rosbag2-sqlite3-none'])
def test_a_replay_of_wrenches_is_that_of_their_torques(tmp_path, scene_file, form):
    loaded, sent, ends = scene.load(scene_file()), wrenches(100), []
    for name, recorded in (('wrenches', sent), ('torques', converted(sent))):
        (tmp_path / name).mkdir()
        source = bags.FORMS[form](tmp_path / name, bags.traffic(recorded))
        output = tmp_path / name / 'motion.mcap'
        result, kept = replay(source, loaded, output), replay(source, loaded)
        assert kept.trajectory.attitude[-1].tolist() == result.last.attitude.tolist()
        ends.append([kept.problem.logs[0].torques.tobytes(), kept.trajectory.attitude.tobytes(), *(
            recording.read(output, topic, kind).values.tobytes() for topic, kind in (
                ('/attitude', messages.QUATERNION), ('/angular_velocity', messages.VECTOR3)))])
    assert ends[0] == ends[1]


def test_wrenches_that_do_not_fit_in_one_piece_are_converted_in_each(tmp_path, scene_file,
                                                                     monkeypatch):
    monkeypatch.setattr('rigid_body_ros.recording.torques._SAMPLES', 100)
    sent, loaded = wrenches(1000, ['thruster', 'base_link']), scene.load(scene_file())
    path = bags.ours(tmp_path, bags.traffic(sent))
    log = recording.torque_log(path, recording.read(path), 'base_link', 'world',
                               links=loaded.links)
    assert log.torques.tobytes() == np.ascontiguousarray(converted(sent).values[:, 3:]).tobytes()
    last = replay(path, loaded, tmp_path / 'motion.mcap').last
    assert replay(path, loaded).last.attitude.tolist() == last.attitude.tolist()


def write(path, *wrenches):
    """Write a recording of wrenches, each given as a frame and six numbers; return the path."""
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for number, (name, values) in enumerate(wrenches):
            stamp = EPOCH_NS + number * SECOND
            writer.write('/torque', stamp, messages.WRENCH.encode(stamp, name, values))
    return path


@pytest.mark.parametrize(('wrenches', 'message'), [
    ([('mast', [1.0] * 6), ('arm', [0, 0, 0, 0, 0, 1])],
     "message 2: frame 'arm': joint 'to_arm' (revolute) moves it relative to the body"),
    ([('mast', [1.0] * 6), ('map', [0, 0, 0, 0, 0, 1])],
     "message 2: frame_id: expected 'base_link' or '' (body axes) or 'world' (space axes), found "
     "'map'; links whose forces are accepted: 'thruster', 'mast', 'footprint', 'lamp', "
     "'propeller', 'second'"),
    ([('propeller', [*AXIS, *AXIS]), ('second', [0, 0, 1, 0, 0, 1]),
      ('second', [0, 0.5, 1, 0, 0, 2]), ('propeller', [*AXIS, 0, 0, 1])],
     "message 3: frame 'second': expected force and torque along the axis [0.0, 0.0, 1.0] of "
     "joint 'to_second' (continuous), found force [0.0, 0.5, 1.0] and torque [0.0, 0.0, 2.0]")])
@pytest.mark.parametrize('whole', [False, True])
def test_a_bad_wrench_ends_a_replay_with_one_line(tmp_path, scene_file, refusal, wrenches, message,
                                                  whole):
    path = write(tmp_path / 'log.mcap', *wrenches)
    more = ['--plot', tmp_path / 'motion.png'] if whole else []
    line = refusal('attitude_replay', path, '--scene', scene_file(TWO_PROPELLERS), '-o',
                   tmp_path / 'motion.mcap', *more)
    assert line.startswith(f'attitude_replay: error: {path}: /torque: {message}')
    assert sorted(file.name for file in tmp_path.iterdir()) == ['log.mcap', 'scene.yaml']


def test_messages_are_counted_from_the_first_of_a_recording_in_pieces(tmp_path, scene_file):
    blocks = []
    for across in (0.0, 1.0):
        path = write(tmp_path / f'{across}.mcap', ('second', [0, 0, 1, 0, 0, 1]),
                     ('second', [0, across, 1, 0, 0, 0]))
        blocks.append(replace(recording.read(path), before=2 * len(blocks)))
    links = scene.load(scene_file(TWO_PROPELLERS)).links
    with pytest.raises(InputError, match="^log: message 4: frame 'second': expected force"):
        list(torque_pieces('log', blocks, 'base_link', 'world', links))


def test_a_force_that_has_no_lever_arm_may_be_anything(tmp_path, scene_file):
    path = write(tmp_path / 'log.mcap', ('world', [np.nan, np.inf, 1.0, 0.0, 0.0, 0.5]))
    result = replay(path, scene.load(scene_file()), until=1.0)
    assert result.problem.logs[0].torques.tolist() == [[0.0, 0.0, 0.5]]


def propeller(axis, rpy='0.4 -0.1 0.3', xyz='0.1 0.2 0.3'):
    """Return the frame of a propeller on the body."""
    return urdf.fixed_frames(robot(
        ('continuous', 'base_link', 'propeller', xyz, rpy, *axis)))['propeller']


@pytest.mark.parametrize('seed', range(3))
def test_thrust_and_drag_along_a_skewed_axis_have_the_lever_arm_of_its_origin(seed):
    random = np.random.default_rng(seed)
    axis, position, angles = random.normal(size=(3, 3))
    along = axis / np.linalg.norm(axis)
    forces, torques = random.normal(size=(2, 30, 1)) * along
    found = propeller([text(axis)], text(angles), text(position)).torque(forces, torques)
    turn = Rotation.from_euler('xyz', angles)
    expected = turn.apply(torques) + np.cross(position - CENTRE, turn.apply(forces))
    np.testing.assert_allclose(found, expected, rtol=0, atol=64 * EPS)


@pytest.mark.parametrize('angle', [0.1, np.pi / 2, -2.5])
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
