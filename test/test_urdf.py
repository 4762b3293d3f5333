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


def turned(rpy, xyz=(0.0, 0.0, 0.0)):
    """Return the body of the point masses, written as a URDF with an origin."""
    (ixx, ixy, ixz), (_, iyy, iyz), (*_, izz) = BODY.inertia.tolist()
    text = inertial('<origin xyz="{} {} {}" rpy="{} {} {}"/>'.format(*xyz, *rpy),
                    ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)
    return RigidBody.from_urdf(robot(body=text))


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
    '', '<origin/>', '<origin xyz="1 2 3"/>', '<origin rpy="0 0 0"/>',
    '<origin rpy=" -0.0  0e0&#9;.0 " xyz="1 2 3"/>'])
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


@pytest.mark.slow
@pytest.mark.parametrize('rpy', TURNS)
def test_a_rotation_leaves_the_principal_moments(rpy):
    np.testing.assert_allclose(turned(rpy).principal_moments, BODY.principal_moments,
                               rtol=0, atol=1e-15 * BODY.principal_moments[2])


def test_a_quarter_turn_swaps_the_entries():
    # Yaw takes the x axis of the inertial frame to the y axis of the link.
    text = inertial('<origin rpy="0 0 1.5707963267948966"/>')
    np.testing.assert_allclose(
        RigidBody.from_urdf(robot(body=text)).inertia,
        [[0.2, 0.001, -0.007], [0.001, 0.1, 0.003], [-0.007, 0.003, 0.3]], rtol=0, atol=1e-16)


@pytest.mark.parametrize('rpy', TURNS)
def test_the_shift_changes_no_bit(rpy):
    np.testing.assert_array_equal(turned(rpy, (1e3, -2.0, 1e-3)).inertia, turned(rpy).inertia)


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


@pytest.mark.parametrize('rpy', ['0 0 0', *(' '.join(map(str, rpy)) for rpy in TURNS)])
def test_a_moment_of_zero_is_refused_however_the_link_is_turned(rpy):
    entries = {'ixx': 0, 'iyy': 1, 'izz': 1, 'ixy': 0, 'ixz': 0, 'iyz': 0}
    with pytest.raises(ValueError, match='positive definite'):
        RigidBody.from_urdf(robot(body=inertial(f'<origin rpy="{rpy}"/>', **entries)))


def test_a_turned_thin_rod_is_a_body():
    text = inertial('<origin rpy="0.3 -1.1 2.5"/>', ixx=1e-12, iyy=1, izz=1, ixy=0, ixz=0, iyz=0)
    np.testing.assert_allclose(RigidBody.from_urdf(robot(body=text)).principal_moments[0], 1e-12,
                               rtol=0.01)


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
    ('<robot/>', 'body', "URDF: expected one link 'body', found none"),
    (FULL.replace('base_link', 'body'), 'body',
     "URDF: expected one link 'body', found 'body', 'body'"),
    (FULL, 'base_link',
     "URDF link 'base_link': expected an <inertial>, found none; links with <inertial>: 'body'"),
    (robot(base_link=''), 'base_link',
     "URDF link 'base_link': expected an <inertial>, found none; links with <inertial>: none"),
    (robot(base_link=''), '',
     'URDF: expected the name of a link, or a single link with <inertial>, found none'),
    (robot(base_link='', a=inertial(), b=inertial()), '',
     "URDF: expected the name of a link, or a single link with <inertial>, found 'a', 'b'")])
def test_what_is_no_link_with_an_inertia_is_refused(text, link, message):
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        RigidBody.from_urdf(text, link)


@pytest.mark.parametrize('link', ['', 'body'])
@pytest.mark.parametrize(('text', 'message'), [
    ('<inertial/>', 'ixx: expected a finite number, found nothing'),
    *((inertial(**{name: None}), f'{name}: expected a finite number, found nothing')
      for name in DIGITS),
    (inertial(ixx='0,1'), "ixx: expected a finite number, found '0,1'"),
    (inertial(ixx='0.1 0.2'), "ixx: expected a finite number, found '0.1 0.2'"),
    (inertial(iyy=''), "iyy: expected a finite number, found ''"),
    (inertial(ixy='nan'), "ixy: expected a finite number, found 'nan'"),
    (inertial(izz='-INF'), "izz: expected a finite number, found '-INF'"),
    (inertial(izz='1e999'), "izz: expected a finite number, found '1e999'"),
    (inertial(izz='1_0'), "izz: expected a finite number, found '1_0'"),
    (inertial(ixz='\u0661'), "ixz: expected a finite number, found '\u0661'"),
    (inertial(izz='a&#10;b'), r"izz: expected a finite number, found 'a\nb'"),
    (inertial('<origin rpy="0 0"/>'), "rpy: expected 3 finite numbers, found '0 0'"),
    (inertial('<origin rpy="0 0 0 1"/>'), "rpy: expected 3 finite numbers, found '0 0 0 1'"),
    (inertial('<origin rpy="0 0 9 deg"/>'), "rpy: expected 3 finite numbers, found '0 0 9 deg'"),
    (inertial('<origin rpy="0 0 inf"/>'), "rpy: expected 3 finite numbers, found '0 0 inf'"),
    (inertial('<origin xyz=""/>'), "xyz: expected 3 finite numbers, found ''"),
    (inertial('<origin xyz="0 0 x"/>'), "xyz: expected 3 finite numbers, found '0 0 x'"),
    (inertial('<origin rpy="0 0 ${pi}"/>'), "rpy: expected 3 finite numbers, found '0 0 ${pi}'"
     '; run xacro first'),
    (inertial('<origin quat_xyzw="0 0 0 1"/>'), 'expected the rotation as rpy, found quat_xyzw')])
def test_what_is_no_inertia_is_refused_in_one_line_with_its_link(text, link, message):
    message = f"URDF link 'body': {message}"
    with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
        RigidBody.from_urdf(robot(base_link='', body=text), link)


def test_a_tensor_of_no_body_is_refused_as_ever():
    with pytest.raises(ValueError, match='sum of the other two'):
        RigidBody.from_urdf(robot(body=inertial(izz='3.0')))


@pytest.mark.parametrize('scale', [1.0, 1e-30, 1e22])
def test_a_body_written_as_urdf_has_the_same_numbers(scale):
    tensor = scale * BODY.inertia
    text = urdf.robot(tensor, 'a"<&b', ['1 ---> 2', 'torque --gain'])
    np.testing.assert_array_equal(RigidBody.from_urdf(text).inertia, tensor)
    np.testing.assert_array_equal(RigidBody.from_urdf(text, 'a"<&b').inertia, tensor)
