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
The inertia of a link in a URDF file.

The format is specified in http://wiki.ros.org/urdf/XML/link. Where the specification leaves a
choice, this module follows urdfdom, the parser of ROS (`parseInertial` in
urdf_parser/src/link.cpp).
"""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from rigid_body_ros import euler, so3
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted, shortened

#: Attributes of <inertia>, row by row.
_ENTRIES = ('ixx', 'ixy', 'ixz', 'ixy', 'iyy', 'iyz', 'ixz', 'iyz', 'izz')
#: Numbers as urdfdom reads them; `float` also accepts 1_000 and digits of other scripts.
_NUMBER = re.compile(r'[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?')
#: Bound on the rounding error of a rotated tensor, relative to its largest moment.
_ROTATION_ERROR = 16.0 * np.finfo(float).eps


def inertia(text: str, link: str = '') -> Floats:
    """
    Return the inertia of a link about its centre of mass, in the axes of the link.

    The result is R I R^T, where I has the entries of <inertia>, and R is the rotation by the roll,
    pitch and yaw of <origin> about the fixed axes x, y, z. Without a rotation the entries are
    those of the file; a rotation rounds them by about 1e-16 of the largest moment. The position
    xyz of the centre of mass is checked, but does not change the tensor. The mass is ignored.

    Parameters
    ----------
    text : str
        Contents of the file, after xacro. All six entries of <inertia> are required: neither the
        specification nor urdfdom has defaults for them. The xyz and rpy of <origin> default to
        zero.
    link : str
        Name of the link; may be empty if only one link has an <inertial>.

    Returns
    -------
    array, shape (3, 3), kg m^2, axes of the link
        Symmetric; after a rotation, within rounding.

    Raises
    ------
    ValueError
        The text is not URDF, or has not been through xacro; the link does not exist, is not
        unique, or has no <inertial>; an attribute is missing or is not a list of finite numbers
        of the expected length; the rotation is a quaternion (URDF 1.1); a moment is zero within
        the rounding error of the rotation.

    """
    name, inertial = _inertial_of_link(_parse_robot(text), link)
    where = f'URDF link {quoted(name)}'
    entries, origin = _child(inertial, 'inertia'), _child(inertial, 'origin')
    tensor = np.reshape([_numbers(entries, entry, 1, where) for entry in _ENTRIES], (3, 3))
    if origin.get('quat_xyzw') is not None:
        raise ValueError(f'{where}: expected the rotation as rpy, found quat_xyzw')
    _numbers(origin, 'xyz', 3, where, '0 0 0')
    angles = _numbers(origin, 'rpy', 3, where, '0 0 0')
    if any(angles):
        _check_thickness(tensor, where)
    attitude = euler.to_quaternion(angles, 'xyz')
    return so3.rotate(attitude, so3.rotate(attitude, tensor).T)


def _check_thickness(tensor: Floats, where: str) -> None:
    """Raise ValueError if the smallest moment may be a rounding error after a rotation."""
    moments = np.linalg.eigvalsh(tensor)
    if abs(moments[0]) <= _ROTATION_ERROR * moments[2]:
        raise ValueError(f'{where}: inertia: expected a positive definite tensor, found principal '
                         f'moments {moments.tolist()} kg m^2')


def _parse_robot(text: str) -> Element:
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f'URDF: expected XML, found {quoted(text)} ({error})') from None
    for element in robot.iter():
        namespace, _, name = element.tag.rpartition('}')
        if 'xacro' in namespace:
            raise ValueError('URDF: expected the output of xacro, '
                             f'found <xacro:{shortened(name, 60)}>; run xacro first')
    root = robot.tag.rpartition('}')[2]
    if root != 'robot':
        raise ValueError(f'URDF: expected the root element <robot>, '
                         f'found <{shortened(root, 60)}>')
    return robot


def _inertial_of_link(robot: Element, link: str) -> tuple[str, Element]:
    # {*}: an example of urdfdom has a default namespace, which its parser ignores.
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


def _child(parent: Element, name: str) -> Element:
    child = parent.find('{*}' + name)
    return Element(name) if child is None else child


def _numbers(element: Element, name: str, count: int, where: str,
             default: str | None = None) -> list[float]:
    text = element.get(name, default)
    words = (text or '').split()
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    if not len(numbers) == len(words) == count or not all(map(math.isfinite, numbers)):
        expected = 'a finite number' if count == 1 else f'{count} finite numbers'
        found = 'nothing' if text is None else quoted(text)
        hint = '; run xacro first' if '${' in (text or '') else ''
        raise ValueError(f'{where}: {name}: expected {expected}, found {found}{hint}')
    return numbers
