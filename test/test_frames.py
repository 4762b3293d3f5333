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

"""Wrenches in link frames: from URDF to torque, in Python, in recordings and in commands."""

import pickle
import re

import bags
from conftest import CONFIG, EPOCH_NS, ROOT, SECOND
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import urdf
from rigid_body_ros.replay import replay
from robots import converted, JOINTS, ROBOT, robot, wrenches
from scipy.spatial.transform import Rotation
import yaml

#: Doubles that any arithmetic would change.
ODD = [[-0.0, 0.0, -0.0], [5e-324, -5e-324, 1.7976931348623157e308], [0.1, -0.2, 0.3]]


def text(numbers):
    return ' '.join(map(repr, numbers.tolist()))


@pytest.mark.parametrize('seed', range(4))
def test_frames_are_composed_along_fixed_joints_in_both_directions(seed):
    random = np.random.default_rng(seed)
    count, centre = 8, random.normal(size=3)
    parents = [0, *(int(random.integers(child)) for child in range(1, count))]
    shifts, angles = random.normal(size=(count, 3)), random.uniform(-7.0, 7.0, (count, 3))
    body = f'l{random.integers(count)}'
    transforms = [np.eye(4)]
    for child in range(1, count):
        step = np.eye(4)
        step[:3, :3] = Rotation.from_euler('xyz', angles[child]).as_matrix()
        step[:3, 3] = shifts[child]
        transforms.append(transforms[parents[child]] @ step)
    frames = urdf.fixed_frames(robot(
        *(('fixed', f'l{parents[child]}', f'l{child}', text(shifts[child]), text(angles[child]))
          for child in random.permutation(range(1, count))),
        body=body, origin=f' xyz="{text(centre)}" rpy="1 2 3"'))
    assert len(frames) == count
    for child, transform in enumerate(transforms):
        expected = np.linalg.inv(transforms[int(body[1:])]) @ transform
        rotation, position = expected[:3, :3], expected[:3, 3] - centre
        found = frames[f'l{child}']
        np.testing.assert_allclose(found.rotation, rotation, rtol=0, atol=1e-14)
        np.testing.assert_allclose(found.position, position, rtol=0, atol=3e-14)
        force, torque = random.normal(size=(2, 10, 3))
        np.testing.assert_allclose(
            found.torque(force, torque),
            torque @ rotation.T + np.cross(position, force @ rotation.T), rtol=0, atol=1e-12)


def test_a_force_has_the_torque_of_its_lever_arm():
    frames = urdf.fixed_frames(ROBOT)
    assert frames['base_link'].torque([0.0, 0.0, 2.0], [0.0, 0.0, 0.0]).tolist() == [0.0, 0.5, 0.0]
    np.testing.assert_allclose(frames['thruster'].torque([2.0, 0.0, 0.0], [0.0, 3.0, 0.0]),
                               [-3.0, 0.0, 1.5], rtol=0, atol=1e-15)
    # The joint goes from footprint to base_link, so its position is reversed.
    assert frames['footprint'].position.tolist() == [-0.25, 0.0, -1.5]


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
    wrenches = np.random.default_rng(5).normal(size=(200, 6)) * 10.0 ** np.arange(-3, 3)
    wrenches[::3, :3] = 0.0
    for frame in [*urdf.fixed_frames(ROBOT).values()][:-1]:  # the last is the propeller
        alone = [frame.torque(row[:3], row[3:]) for row in wrenches]
        together = frame.torque(wrenches[:, :3], wrenches[:, 3:])
        assert np.array(alone).tobytes() == together.tobytes()


def test_frames_survive_the_way_to_another_process():
    frames = pickle.loads(pickle.dumps(urdf.fixed_frames(ROBOT)))
    assert [*frames] == ['base_link', 'thruster', 'mast', 'footprint', 'lamp', 'propeller']
    with pytest.raises(KeyError, match='joint .to_arm. .revolute. moves it'):
        frames['hand']


def changed(old, new):
    assert old in ROBOT
    return ROBOT.replace(old, new)


@pytest.mark.parametrize(('robot', 'frame', 'reason'), [
    *((changed('revolute', kind), name,
       f"joint 'to_arm' ({kind}) moves it relative to the body")
      for kind, name in (('revolute', 'arm'), ('continuous', 'hand'), ('prismatic', 'arm'),
                         ('floating', 'hand'), ('planar', 'arm'))),
    (ROBOT, 'label', "no joints connect it to 'base_link'"),
    (ROBOT, 'map', "expected a link of the URDF whose forces are accepted: 'base_link', "
                   "'thruster', 'mast', 'footprint', 'lamp', 'propeller'"),
    (changed('revolute', 'weld'), 'hand', "URDF joint 'to_arm': type: expected one of fixed, "
     "revolute, continuous, prismatic, floating, planar, found 'weld'"),
    (changed('xyz="0 0 0.5"', 'xyz="0 0"'), 'lamp',
     "URDF joint 'to_mast': xyz: expected 3 finite numbers, found '0 0'"),
    (changed('rpy="0.1 0.2 0.3"', 'rpy="0 0 nan"'), 'lamp',
     "URDF joint 'to_lamp': rpy: expected 3 finite numbers, found '0 0 nan'"),
    (changed('xyz="0 0.5 0"', 'xyz="0 1e308 0"'), 'lamp',
     'expected a position of at most 1e+300 m'),
    *((changed('<axis xyz="1 2 2"/>', axis), 'propeller',
       f"URDF joint 'to_propeller': axis: xyz: expected {expected}")
      for axis, expected in (
          ('<axis xyz="0 -0.0 0"/>', 'a vector other than zero, found [0.0, -0.0, 0.0]'),
          ('<axis xyz="0 0 inf"/>', "3 finite numbers, found '0 0 inf'"),
          ('<axis/>', '3 finite numbers, found nothing'))),
    (changed('rpy="0.1 0.2 0.3"', 'quat_xyzw="0 0 0 1"'), 'lamp',
     "URDF joint 'to_lamp': expected the rotation as rpy, found quat_xyzw"),
    (robot(*JOINTS, ('fixed', 'lamp', 'footprint', '0 0 0', '0 0 0')), 'lamp',
     "the joints between it and 'base_link' form a closed loop")])
def test_a_frame_that_is_not_fixed_is_rejected_with_the_reason(robot, frame, reason):
    frames = urdf.fixed_frames(robot, 'base_link')
    assert frame not in frames
    for error in (KeyError, ValueError):
        with pytest.raises(error, match=f"^{re.escape(f'frame {frame!r}: {reason}')}$"):
            frames[frame]


@pytest.mark.parametrize(('robot', 'link', 'message'), [
    (ROBOT, 'hand', "URDF link 'hand': expected an <inertial>, found none; links with <inertial>: "
                    "'base_link'"),
    (ROBOT, 'map', "URDF: expected one link 'map', found 'base_link', 'thruster', 'mast', 'lamp', "
                   "'footprint', 'arm' and 3 more"),
    (changed('0.25 0 -0.5', '0.25 0'), '',
     "URDF link 'base_link': xyz: expected 3 finite numbers, found '0.25 0'")])
def test_frames_need_a_link_with_a_centre_of_mass(robot, link, message):
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        urdf.fixed_frames(robot, link)


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
    description = changed('footprint', 'world')
    loaded = scene.load(scene_file(description))
    assert messages.wrench_frame('world', 'base_link', 'world', loaded.links) == ('space', None)


def test_without_a_urdf_the_body_frame_is_at_the_centre_of_mass():
    links = scene.load(CONFIG / 'tumbler.yaml').links
    assert [messages.wrench_frame(name, 'b', 's', links) for name in ('', 'b', 's')] == [
        ('body', None), ('body', None), ('space', None)]
    with pytest.raises(ValueError, match=r"^frame_id: .* 's' \(space axes\), found 'arm'$"):
        messages.wrench_frame('arm', 'b', 's', links)


def motion(output):
    """Return the motion that a replay writes, as bytes."""
    return [recording.read(output, topic, kind).values.tobytes()
            for topic, kind in (('/attitude', messages.QUATERNION),
                                ('/angular_velocity', messages.VECTOR3))]


@pytest.mark.slow
@pytest.mark.parametrize('form', ['mcap-big-endian', 'rosbag2-sqlite3-none'])
def test_a_replay_of_wrenches_is_that_of_their_torques(tmp_path, scene_file, form):
    loaded, sent = scene.load(scene_file()), wrenches(100)
    ends = []
    for name, recorded in (('wrenches', sent), ('torques', converted(sent))):
        (tmp_path / name).mkdir()
        source = bags.FORMS[form](tmp_path / name, bags.traffic(recorded))
        output = tmp_path / name / 'motion.mcap'
        result = replay(source, loaded, output)
        kept = replay(source, loaded)
        assert kept.trajectory.attitude[-1].tolist() == result.last.attitude.tolist()
        ends.append([*motion(output), kept.problem.logs[0].torques.tobytes(),
                     kept.trajectory.attitude.tobytes()])
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


@pytest.mark.parametrize(('frame_id', 'wrench', 'message'), [
    ('arm', [0, 0, 0, 0, 0, 1],
     "message 2: frame 'arm': joint 'to_arm' (revolute) moves it relative to the body"),
    ('map', [0, 0, 0, 0, 0, 1],
     "message 2: frame_id: expected 'base_link' or '' (body axes) or 'world' (space axes), found "
     "'map'; links whose forces are accepted: 'thruster', 'mast', 'footprint', 'lamp', "
     "'propeller'"),
    ])
@pytest.mark.parametrize('whole', [False, True])
def test_a_bad_wrench_ends_a_replay_with_one_line(tmp_path, scene_file, capsys, frame_id, wrench,
                                                  message, whole):
    path, output = tmp_path / 'log.mcap', tmp_path / 'motion.mcap'
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        for number, (name, values) in enumerate((('mast', np.ones(6)), (frame_id, wrench))):
            stamp = EPOCH_NS + number * SECOND
            writer.write('/torque', stamp, messages.WRENCH.encode(stamp, name, values))
    more = ['--plot', str(tmp_path / 'motion.png')] if whole else []
    assert main.attitude_replay([str(path), '--scene', str(scene_file()), '-o', str(output),
                                *more]) == 2
    line, = capsys.readouterr().err.splitlines()
    assert line.startswith(f'attitude_replay: error: {path}: /torque: {message}')
    assert sorted(file.name for file in tmp_path.iterdir()) == ['log.mcap', 'scene.yaml']


def test_a_force_that_has_no_lever_arm_may_be_anything(tmp_path, scene_file):
    path = tmp_path / 'log.mcap'
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        writer.write('/torque', EPOCH_NS, messages.WRENCH.encode(
            EPOCH_NS, 'world', [np.nan, np.inf, 1.0, 0.0, 0.0, 0.5]))
    result = replay(path, scene.load(scene_file()), until=1.0)
    assert result.problem.logs[0].torques.tolist() == [[0.0, 0.0, 0.5]]
