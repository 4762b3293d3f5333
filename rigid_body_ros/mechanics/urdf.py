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

"""
Read the inertia of a link, and the frames in which forces are accepted, from a URDF file.

The format is specified in http://wiki.ros.org/urdf/XML/link. Where the specification leaves a
choice, this module follows urdfdom, ROS's parser (`parseInertial` in urdf_parser/src/link.cpp).
"""

from __future__ import annotations

from collections.abc import Iterable
import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted
from rigid_body_ros.mechanics import euler, so3
from rigid_body_ros.mechanics.elements import child_of, numbers_of, origin_of, parse_robot
from rigid_body_ros.mechanics.frames import Frames
from rigid_body_ros.mechanics.joints import paths_from

#: The attributes of <inertia> that give the entries of the tensor, row by row.
_ENTRIES = ('ixx', 'ixy', 'ixz', 'ixy', 'iyy', 'iyz', 'ixz', 'iyz', 'izz')
#: Upper bound on the rounding error of a rotated tensor, relative to the largest moment of that
#: tensor.
_ROTATION_ERROR = 16.0 * np.finfo(float).eps


def inertia(text: str, link: str = '') -> Floats:
    """
    Return the inertia of a link about its centre of mass, in the axes of the link.

    The result is R I R^T, where I is the matrix with the entries of <inertia>, and R is the
    rotation by the roll, pitch and yaw of <origin> about the fixed axes x, y, z. Without a
    rotation, the entries are exactly those in the file. A rotation adds rounding errors of about
    1e-16 times the largest moment. The position xyz of the centre of mass is validated, but does
    not change the tensor. The mass is ignored.

    Parameters
    ----------
    text : str
        The contents of the file, after processing by xacro. All six entries of <inertia> are
        required, because neither the specification nor urdfdom defines defaults for them. The xyz
        and rpy of <origin> default to zero.
    link : str
        Name of the link. It may be empty if only one link has an <inertial>.

    Returns
    -------
    array, shape (3, 3), kg m^2, axes of the link
        The inertia tensor. Without a rotation, it is exactly symmetric. After a rotation, it is
        symmetric within rounding.

    Raises
    ------
    ValueError
        The text is not URDF, or has not been through xacro; the link does not exist, is not
        unique, or has no <inertial>; an attribute is missing or is not a list of finite numbers
        of the expected length; the rotation is a quaternion (URDF 1.1); or a moment is zero within
        the rounding error of the rotation.

    """
    name, inertial = _inertial_of_link(parse_robot(text), link)
    where = f'URDF link {quoted(name)}'
    entries = child_of(inertial, 'inertia')
    tensor = np.reshape([numbers_of(entries, entry, 1, where) for entry in _ENTRIES], (3, 3))
    _, angles = origin_of(inertial, where)
    if any(angles):
        _check_thickness(tensor, where)
    attitude = euler.to_quaternion(angles, 'xyz')
    return so3.rotate(attitude, so3.rotate(attitude, tensor).T)


def robot(tensor: Floats, link: str, comments: Iterable[str] = ()) -> str:
    """
    Return the URDF of a robot with one link, from which `inertia` reads back the same numbers.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        The inertia in the axes of the link. The mass of the link is written as 1 kg, because the
        rotation does not depend on the mass.
    link : str
        Name for both the link and the robot.
    comments : iterable of str
        Lines of text, each of which becomes an XML comment before the <robot>.

    """
    entries = {_ENTRIES[k]: float(tensor.flat[k]) for k in (0, 4, 8, 1, 2, 5)}
    root = Element('robot', name=link)
    inertial = SubElement(SubElement(root, 'link', name=link), 'inertial')
    SubElement(inertial, 'mass', value='1')
    SubElement(inertial, 'inertia', {name: repr(entry) for name, entry in entries.items()})
    ElementTree.indent(root)
    lines = [f'<!-- {re.sub("-(?=-)", "- ", line)} -->' for line in comments]
    return '\n'.join([*lines, ElementTree.tostring(root, 'unicode'), ''])


def fixed_frames(text: str, link: str = '') -> Frames:
    """
    Return the frames of all links that are fixed to the body.

    A link is fixed to the body if fixed joints connect the link and the body, whichever of the two
    is the parent. If a continuous joint connects one of these links to a child link, such as a
    propeller, the child link has a frame as well, but only for forces and torques along the joint
    axis. Links attached to this child link have no frame.

    Parameters
    ----------
    text : str
        The contents of the file, after processing by xacro.
    link : str
        Name of the link that represents the body. It may be empty if only one link has an
        <inertial>. The body axes are the axes of this link, and the centre of mass is at the xyz
        of its <inertial>.

    Returns
    -------
    Frames
        The frames, keyed by link name, including the link that represents the body. The child of a
        continuous joint has a `frames.TurningFrame`. Looking up any other name raises
        UnknownFrameError, which is both a KeyError and a ValueError. Its message gives the reason:
        for example, a joint moves the link, a joint has no valid <origin> or <axis>, the joints
        form a closed loop, or no joints connect the link to the body.

    Raises
    ------
    ValueError
        The text is not URDF, or has not been through xacro; the link does not exist, is not
        unique, or has no <inertial>; or the <origin> of its <inertial> is not valid.

    """
    robot = parse_robot(text)
    body, inertial = _inertial_of_link(robot, link)
    centre, _ = origin_of(inertial, f'URDF link {quoted(body)}')
    links = [element.get('name', '') for element in robot.findall('{*}link')]
    paths = paths_from(body, [-x for x in centre], robot, {*links})
    frames = {name: path.frame for name, path in paths.items() if not path.barrier}
    others = dict.fromkeys(links, f'no joints connect it to {quoted(body)}')
    others |= {name: path.barrier for name, path in paths.items()}
    return Frames(body, frames, {name: others[name] for name in links if name not in frames})


def _check_thickness(tensor: Floats, where: str) -> None:
    """Raise ValueError if the rounding error of a rotation may exceed the smallest moment."""
    moments = np.linalg.eigvalsh(tensor)
    if abs(moments[0]) <= _ROTATION_ERROR * moments[2]:
        raise ValueError(f'{where}: inertia: expected a positive definite tensor, found principal '
                         f'moments {moments.tolist()} kg m^2')


def _inertial_of_link(robot: Element, link: str) -> tuple[str, Element]:
    # `{*}` matches any namespace. One of urdfdom's examples has a namespace, and urdfdom ignores
    # the namespace.
    links = [(element.get('name', ''), element.find('{*}inertial'))
             for element in robot.findall('{*}link')]
    with_inertial = [name for name, inertial in links if inertial is not None]
    if not link and len(with_inertial) != 1:
        raise ValueError('URDF: expected the name of a link, or a single link with <inertial>, '
                         f'found {_listed(with_inertial)}')
    name = link or with_inertial[0]
    found = [inertial for other, inertial in links if other == name]
    if len(found) != 1:
        raise ValueError(f'URDF: expected one link {quoted(name)}, '
                         f'found {_listed([other for other, _ in links])}')
    if found[0] is None:
        raise ValueError(f'URDF link {quoted(name)}: expected an <inertial>, found none; '
                         f'links with <inertial>: {_listed(with_inertial)}')
    return name, found[0]


def _listed(names: list[str]) -> str:
    return listed([*map(repr, names)])
