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
The elements of a URDF file, and the numbers in their attributes.

The format is specified in http://wiki.ros.org/urdf/XML. Where the specification leaves a choice,
this module follows urdfdom, ROS's parser.
"""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from rigid_body_ros.common.errors import quoted, shortened

#: A number that urdfdom accepts. `float` would also accept 1_000 and digits from other scripts.
_NUMBER = re.compile(r'[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?')


def parse_robot(text: str) -> Element:
    """
    Return the <robot> element of a URDF.

    Raises
    ------
    ValueError
        The text is not URDF, or has not been through xacro.

    """
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


def child_of(parent: Element, name: str) -> Element:
    """Return the first child with this name, in any namespace; without one, an empty element."""
    child = parent.find('{*}' + name)
    return Element(name) if child is None else child


def origin_of(element: Element, where: str) -> tuple[list[float], list[float]]:
    """
    Return the xyz, m, and the rpy angles, rad, of an element's <origin>; they default to zero.

    Raises
    ------
    ValueError
        The xyz or the rpy is not three finite numbers, or the rotation is a quaternion.

    """
    origin = child_of(element, 'origin')
    if origin.get('quat_xyzw') is not None:
        raise ValueError(f'{where}: expected the rotation as rpy, found quat_xyzw')
    xyz, rpy = (numbers_of(origin, name, 3, where, '0 0 0') for name in ('xyz', 'rpy'))
    return xyz, rpy


def numbers_of(element: Element, name: str, count: int, where: str,
               default: str | None = None) -> list[float]:
    """
    Return the numbers in an attribute of an element.

    Raises
    ------
    ValueError
        The attribute is missing and has no default, or is not `count` finite numbers. The message
        begins with `where`.

    """
    text = element.get(name, default)
    words = (text or '').split()
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    if not len(numbers) == len(words) == count or not all(map(math.isfinite, numbers)):
        expected = 'a finite number' if count == 1 else f'{count} finite numbers'
        found = 'nothing' if text is None else quoted(text)
        hint = '; run xacro first' if '${' in (text or '') else ''
        raise ValueError(f'{where}: {name}: expected {expected}, found {found}{hint}')
    return numbers
