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

"""URDF links, compared with point masses, and links with an invalid inertia."""

import re

import numpy as np
import pytest
from rigid_body_ros import RigidBody
from rigid_body_ros.mechanics import urdf
import robots
from scipy.spatial.transform import Rotation

RANDOM = np.random.default_rng(31)
MASSES, POSITIONS = RANDOM.uniform(0.5, 2.0, 6), RANDOM.normal(size=(6, 3))
BODY = RigidBody.from_point_masses(MASSES, POSITIONS)
DIGITS = {'ixx': '0.1', 'ixy': '-1e-3', 'ixz': '.3e-2', 'iyy': '0.2000000000000000111',
          'iyz': '+0.007', 'izz': '0.30000000000000004'}
TURNS = [(0.3, 0.0, 0.0), (0.0, -1.1, 0.0), (0.0, 0.0, 2.5), (0.3, -1.1, 2.5), (-2.9, 1.5, -0.2),
         (1.5708, 0, 1.5707963267948966), (3.141592653589793, 1.5707963267948966, -1.5708),
         (100.0, -200.0, 300.0)]


def inertial(origin='', **entries):
    """Return an <inertial> element; entries that are None are left out."""
    attributes = ' '.join(f'{name}="{value}"' for name, value in {**DIGITS, **entries}.items()
                          if value is not None)
    return f'<inertial>{origin}<mass value="2"/><inertia {attributes}/></inertial>'


def robot(**links):
    """Return a URDF with the given links, a joint between them, and other common elements."""
    return ('<?xml version="1.0" encoding="utf-8"?>\n<!-- <xacro:link name="${old}"/> -->\n'
            '<robot name="it" xmlns:xacro="http://www.ros.org/wiki/xacro">'
            + ''.join(f'<link name="{name}"><visual/>{text}</link>'
                      for name, text in links.items())
            + '<joint name="j" type="fixed"><origin xyz="1 2 3" rpy="1 2 3"/></joint></robot>')


def part(mass=1.0, tensor=0.0, xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)):
    """Return an <inertial>; by default, that of a point mass of 1 kg."""
    if np.isscalar(tensor):
        tensor = tensor * np.eye(3)
    entries = {f'i{"xyz"[k]}{"xyz"[j]}': tensor[k, j] for j in range(3) for k in range(j + 1)}
    return inertial(f'<origin xyz="{robots.text(xyz)}" rpy="{robots.text(rpy)}"/>',
                    **entries).replace('value="2"', f'value="{mass}"')


def turned(rpy, xyz=(0.0, 0.0, 0.0)):
    """Return the body of the point masses, written as a URDF with an origin."""
    return RigidBody.from_urdf(robot(body=part(2.0, BODY.inertia, xyz, rpy)))


def about_fixed_axes(roll, pitch, yaw):
    """Return Rz(yaw) Ry(pitch) Rx(roll)."""
    product = np.eye(3)
    for axis, angle in enumerate((roll, pitch, yaw)):
        turn, (j, k) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
        turn[j, j] = turn[k, k] = np.cos(angle)
        turn[j, k], turn[k, j] = -np.sin(angle), np.sin(angle)
        product = turn @ product
    return product


@pytest.mark.parametrize('origin', [
    '', '<origin xyz="1 2 3"/>', '<origin rpy=" -0.0  0e0&#9;.0 " xyz="1 2 3"/>'])
def test_without_a_rotation_the_numbers_are_those_of_the_file(origin):
    body = RigidBody.from_urdf(robot(body=inertial(origin)), 'body')
    assert body.inertia.tolist() == [[0.1, -0.001, 0.003], [-0.001, 0.2, 0.007],
                                     [0.003, 0.007, 0.1 + 0.2]]


@pytest.mark.parametrize('rpy', TURNS)
def test_a_rotated_tensor_is_that_of_the_rotated_masses(rpy):
    shifted = POSITIONS @ about_fixed_axes(*rpy).T + (0.4, -0.2, 5.0)
    expected = RigidBody.from_point_masses(MASSES, shifted).inertia
    found = turned(rpy, (0.4, -0.2, 5.0)).inertia
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-15 * BODY.principal_moments[2])
    np.testing.assert_array_equal(found, found.T)
    np.testing.assert_array_equal(found, turned(rpy).inertia)  # the shift changes no bit


def test_a_link_is_found_by_its_name_or_as_the_only_one_with_an_inertial():
    text = robot(base_link='', first=inertial(ixx='0.15'), second=inertial())
    assert RigidBody.from_urdf(text, 'first').inertia[0, 0] == 0.15
    assert RigidBody.from_urdf(text, 'second').inertia[0, 0] == 0.1
    assert RigidBody.from_urdf(robot(base_link='', body=inertial())).inertia[0, 0] == 0.1


def test_a_default_namespace_is_as_good_as_none():
    text = robot(body=inertial('<origin rpy="3.141592653589793 0 0"/>'))
    spaced = text.replace('<robot', '<robot xmlns="http://www.ros.org"')
    np.testing.assert_array_equal(RigidBody.from_urdf(spaced).inertia,
                                  RigidBody.from_urdf(text).inertia)


@pytest.mark.parametrize('rpy', ['0 0 0', '0.3 -1.1 2.5', '100 -200 300'])
def test_a_moment_of_zero_is_refused_however_the_link_is_turned(rpy):
    origin, entries = f'<origin rpy="{rpy}"/>', {
        'ixx': 0, 'iyy': 1, 'izz': 1, 'ixy': 0, 'ixz': 0, 'iyz': 0}
    with pytest.raises(ValueError, match='positive definite'):
        RigidBody.from_urdf(robot(body=inertial(origin, **entries)))
    thin = RigidBody.from_urdf(robot(body=inertial(origin, **{**entries, 'ixx': 1e-12})))
    np.testing.assert_allclose(thin.principal_moments[0], 1e-12, rtol=0.01)


FULL = robot(base_link='', body=inertial())
XACRO = FULL.replace('<joint', '<xacro:include filename="arm.xacro"/><joint')


@pytest.mark.parametrize(('text', 'link', 'message'), [
    ('my_robot.urdf', '',
     "URDF: expected XML, found 'my_robot.urdf' (syntax error: line 1, column 0)"),
    ('', '', "URDF: expected XML, found '' (no element found: line 1, column 0)"),
    ('<sdf/>', '', 'URDF: expected the root element <robot>, found <sdf>'),
    (XACRO, 'body', 'URDF: expected the output of xacro, found <xacro:include>; run xacro first'),
    ('<xacro:macro xmlns:xacro="http://ros.org/wiki/xacro"/>', '',
     'URDF: expected the output of xacro, found <xacro:macro>; run xacro first'),
    (FULL, 'bodi', "URDF: expected one link 'bodi', found 'base_link', 'body'"),
    (FULL.replace('base_link', 'body'), 'body',
     "URDF: expected one link 'body', found 'body', 'body'"),
    (FULL, 'base_link',
     "URDF link 'base_link': expected an <inertial>, found none; links with <inertial>: 'body'"),
    (robot(base_link=''), '',
     'URDF: expected the name of a link, or a single body with <inertial>, found none'),
    (robot(base_link='', a=inertial(), b=inertial()), '',
     "URDF: expected the name of a link, or a single body with <inertial>, found 'a', 'b'")])
def test_what_is_no_link_with_an_inertia_is_refused(text, link, message):
    for function in (RigidBody.from_urdf, urdf.fixed_frames):
        with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
            function(text, link)


@pytest.mark.parametrize(('text', 'message'), [
    ('<inertial/>', 'ixx: expected a finite number, found nothing'),
    (inertial(iyz=None), 'iyz: expected a finite number, found nothing'),
    (inertial(ixx='0,1'), "ixx: expected a finite number, found '0,1'"),
    (inertial(ixy='nan'), "ixy: expected a finite number, found 'nan'"),
    (inertial(izz='-INF'), "izz: expected a finite number, found '-INF'"),
    (inertial(izz='1_0'), "izz: expected a finite number, found '1_0'"),
    (inertial(ixz='\u0661'), "ixz: expected a finite number, found '\u0661'"),
    (inertial(izz='a&#10;b'), r"izz: expected a finite number, found 'a\nb'"),
    (inertial('<origin rpy="0 0"/>'), "rpy: expected 3 finite numbers, found '0 0'"),
    (inertial('<origin xyz="0 0 inf"/>'), "xyz: expected 3 finite numbers, found '0 0 inf'"),
    (inertial('<origin rpy="0 0 ${pi}"/>'), "rpy: expected 3 finite numbers, found '0 0 ${pi}'"
     '; run xacro first'),
    (inertial('<origin quat_xyzw="0 0 0 1"/>'), 'expected the rotation as rpy, found quat_xyzw')])
def test_what_is_no_inertia_is_refused_in_one_line_with_its_link(text, message):
    message = f"URDF link 'body': {message}"
    for link in ('', 'body'):
        with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
            RigidBody.from_urdf(robot(base_link='', body=text), link)


@pytest.mark.parametrize('scale', [1e-30, 1e22])
def test_a_body_written_as_urdf_has_the_same_numbers(scale):
    tensor = scale * BODY.inertia
    text = urdf.robot(tensor, 'a"<&b', ['1 ---> 2', 'torque --gain'])
    np.testing.assert_array_equal(RigidBody.from_urdf(text).inertia, tensor)
    np.testing.assert_array_equal(RigidBody.from_urdf(text, 'a"<&b').inertia, tensor)


# Several links that fixed joints weld together

def fixed(parent, child, xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0), kind='fixed'):
    return kind, parent, child, robots.text(xyz), robots.text(rpy)


def of_point_masses(random):
    """Return an <inertial> of eight point masses, and the masses and positions in link axes."""
    masses, positions = random.uniform(0.5, 2.0, 8), random.normal(size=(8, 3))
    rpy = random.uniform(-7.0, 7.0, 3)
    axes = Rotation.from_euler('xyz', rpy)
    tensor = RigidBody.from_point_masses(masses, axes.inv().apply(positions)).inertia
    centre = masses @ positions / masses.sum()
    return part(masses.sum(), tensor, centre, rpy), masses, positions


@pytest.mark.parametrize('seed', range(3))
def test_fixed_links_have_the_inertia_of_all_their_point_masses(seed):
    random, welded = np.random.default_rng(seed), ['l0']
    joints, places = robots.tree(random, ['revolute' if random.random() < 0.2 else 'fixed'
                                          for _ in range(5)])
    for kind, parent, child, *_ in joints:
        if kind == 'fixed' and parent in welded:
            welded.append(child)
    parts = {name: of_point_masses(random) for name in places
             if name == 'l0' or random.random() < 0.7}
    url = robots.robot(*random.permutation(joints), body='l0',
                       inertials={name: inertial for name, (inertial, _, _) in parts.items()})
    solid = [(*parts[name][1:], *places[name]) for name in welded if name in parts]
    expected = RigidBody.from_point_masses(
        np.concatenate([masses for masses, *_ in solid]),
        np.concatenate([place + turn.apply(positions) for _, positions, turn, place in solid]))
    for name in welded:  # moving the root changes only the axes
        found, axes = RigidBody.from_urdf(url, name).inertia, places[name][0].as_matrix()
        np.testing.assert_allclose(axes @ found @ axes.T, expected.inertia, rtol=0,
                                   atol=8e-15 * expected.principal_moments[2])


def test_a_far_origin_costs_no_digits():
    far = (1e9, -1e9, 1e9)
    url = robots.robot(fixed('map', 'a', far), fixed('a', 'b', (0.5, 0.0, 0.0)), body='map',
                       inertials={'a': part(1.0, 0.25), 'b': part(3.0, 0.25, (0.0, 0.1, 0.0))})
    np.testing.assert_array_equal(urdf.inertia(url, 'map'), urdf.inertia(url, 'a'))
    np.testing.assert_array_equal(urdf.fixed_frames(url, 'map')['b'].position,
                                  urdf.fixed_frames(url, 'a')['b'].position)


@pytest.mark.parametrize('seed', range(3))
def test_welded_masses_on_a_line_are_no_body(seed):
    random = np.random.default_rng(seed)
    line, angles = random.normal(size=3), random.uniform(-7.0, 7.0, 3)
    url = robots.robot(fixed('a', 'b', line, angles), fixed('a', 'c', -2.5 * line), body='a',
                       inertials=dict.fromkeys('abc', part(0.7, rpy=(0.1, 0.2, 0.3))))
    with pytest.raises(ValueError, match="^URDF link 'a': inertia: expected a positive definite"):
        RigidBody.from_urdf(url)


SOLID = part(2.0, 0.25)


@pytest.mark.parametrize(('joints', 'solid', 'root'), [
    ([fixed('footprint', 'base'), fixed('base', 'imu')], ['base', 'imu'], 'base'),
    ([fixed('footprint', 'base'), fixed('base', 'imu')], ['imu', 'footprint'], 'footprint'),
    ([fixed('base', 'hull'), fixed('hull', 'rod'), fixed('base', 'top')], ['rod', 'top'], 'base'),
    ([fixed('arm', 'base', kind='revolute'), fixed('base', 'imu')], ['imu', 'base'], 'base')])
def test_without_a_name_the_root_of_the_masses_gives_the_axes(joints, solid, root):
    assert urdf.fixed_frames(robots.robot(
        *joints, inertials=dict.fromkeys(solid, SOLID))).link == root


QUADROTOR = [fixed('base', 'battery', (0.0, 0.0, -0.1)), fixed('battery', 'imu', (0.1, 0.0, 0.0)),
             fixed('base', 'prop_1', (0.2, 0.0, 0.1), kind='continuous'),
             fixed('base', 'prop_2', (-0.2, 0.0, 0.1), kind='continuous'),
             fixed('prop_2', 'cap', (0.0, 0.0, 0.1))]
LINKS = ['base', 'battery', 'imu', 'prop_1', 'prop_2', 'cap']


def quadrotor(joints=QUADROTOR, **changes):
    """Return a URDF in which each link weighs 0.5 kg; changes are texts of an <inertial>."""
    return robots.robot(*joints, body='base', loose=['label'], inertials={
        **dict.fromkeys(LINKS, part(0.5, 0.01)), **changes})


def test_several_bodies_are_named_by_their_roots():
    with pytest.raises(ValueError, match=" with <inertial>, found 'base', 'prop_1', 'prop_2'$"):
        RigidBody.from_urdf(quadrotor())


@pytest.mark.parametrize(('url', 'link', 'notes'), [
    (quadrotor(), 'base', ["welded to 'base' by fixed joints: battery, imu (total mass 1.5 kg)",
                           'left out, because joints move them: prop_1, prop_2, cap']),
    (quadrotor(), 'cap', ["welded to 'cap' by fixed joints: prop_2 (total mass 1 kg)",
                          'left out, because joints move them: base, battery, imu, prop_1']),
    (quadrotor(label=SOLID), 'base',
     ["welded to 'base' by fixed joints: battery, imu (total mass 1.5 kg)", 'left out, because '
      "fixed joints do not connect them to 'base': prop_1, prop_2, cap, label"]),
    (robots.ROBOT, '', []), (robots.ROBOT, 'mast', [])])
def test_notes_name_the_links_that_belong_to_the_body_and_those_that_do_not(url, link, notes):
    assert urdf.fixed_frames(url, link).notes == notes


def test_a_single_mass_is_not_read_and_turns_with_the_link():
    url = robots.robot(fixed('base', 'hull', (1.0, 2.0, 3.0), (0.0, 0.0, np.pi / 2)),
                       inertials={'hull': inertial().replace('value="2"', 'value="-1"')})
    np.testing.assert_array_equal(RigidBody.from_urdf(url).inertia,
                                  RigidBody.from_urdf(robot(hull=inertial())).inertia)
    np.testing.assert_allclose(
        RigidBody.from_urdf(url, 'base').inertia,
        [[0.2, 0.001, -0.007], [0.001, 0.1, 0.003], [-0.007, 0.003, 0.3]], rtol=0, atol=1e-16)


@pytest.mark.parametrize(('url', 'message'), [
    (quadrotor(imu='<inertial/>'), "'imu': mass: value: expected a finite number, found nothing"),
    (quadrotor(imu=part('1 kg')), "'imu': mass: value: expected a finite number, found '1 kg'"),
    (quadrotor(imu=part(0)), "'imu': mass: expected a number greater than 0 (kg), found 0.0"),
    (quadrotor(imu=part().replace('<inertia ', '<inertia_ ')),
     "'imu': ixx: expected a finite number, found nothing"),
    (quadrotor(imu=part(xyz=(1e301, 0, 0))), "'imu': expected a position of at most 1e+300 m"),
    (quadrotor(imu=part(xyz=(1e299, 0, 0))),
     "'base': inertia: expected moments that fit a double, found larger ones"),
    (quadrotor().replace('xyz="0.0 0.0 -0.1"', 'xyz="0.0 -0.1"'),
     "'battery': URDF joint 'to_battery': xyz: expected 3 finite numbers, found '0.0 -0.1'")])
def test_a_mass_that_cannot_be_welded_is_rejected_in_one_line_with_its_link(url, message):
    for function in (RigidBody.from_urdf, urdf.inertia):
        with pytest.raises(ValueError, match=f'^{re.escape(f"URDF link {message}")}$'):
            function(url, 'base')


def test_an_invalid_joint_of_a_link_that_moves_does_not_matter():
    invalid = quadrotor().replace('xyz="0.2 0.0 0.1"', 'xyz="0.2"')
    np.testing.assert_array_equal(urdf.inertia(invalid, 'base'),
                                  urdf.inertia(quadrotor(), 'base'))
