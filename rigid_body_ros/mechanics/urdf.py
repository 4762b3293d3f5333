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

The format is specified in http://wiki.ros.org/urdf/XML/link and
http://wiki.ros.org/urdf/XML/joint. Where the specification leaves a choice, this module follows
urdfdom, ROS's parser (`parseInertial` in urdf_parser/src/link.cpp, `parseJoint` in
urdf_parser/src/joint.cpp).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
import math
import re
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted, shortened
from rigid_body_ros.mechanics import euler, so3
from rigid_body_ros.mechanics.frames import Frame, Frames, TurningFrame

#: The attributes of <inertia> that give the entries of the tensor, row by row.
_ENTRIES = ('ixx', 'ixy', 'ixz', 'ixy', 'iyy', 'iyz', 'ixz', 'iyz', 'izz')
_FIXED, _CONTINUOUS = 'fixed', 'continuous'
#: The joint types that allow motion between parent and child.
_MOVING = ('revolute', _CONTINUOUS, 'prismatic', 'floating', 'planar')
#: Largest absolute value of a coordinate, m. Sums of larger coordinates could overflow.
_FARTHEST = 1e300
#: A number that urdfdom accepts. `float` would also accept 1_000 and digits from other scripts.
_NUMBER = re.compile(r'[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?')
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
    name, inertial = _inertial_of_link(_parse_robot(text), link)
    where = f'URDF link {quoted(name)}'
    entries = _child(inertial, 'inertia')
    tensor = np.reshape([_numbers(entries, entry, 1, where) for entry in _ENTRIES], (3, 3))
    _, angles = _origin(inertial, where)
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
    robot = _parse_robot(text)
    body, inertial = _inertial_of_link(robot, link)
    centre, _ = _origin(inertial, f'URDF link {quoted(body)}')
    links = [element.get('name', '') for element in robot.findall('{*}link')]
    paths = _paths(body, _joints(robot, {*links}, body), [-x for x in centre])
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


class _Joint(NamedTuple):
    """
    A joint between two links.

    Attributes
    ----------
    name, parent, child : str
    shift : list of 3 floats, m
        Position of the child relative to the parent, in the axes of the parent.
    turn : list of 3 rows of 3 floats
        Rotation matrix from the axes of the child to those of the parent.
    barrier : str
        Why the joint does not fix the child to the parent, or '' if it does.
    axis : list of 3 floats
        For a continuous joint, the unit vector along the joint axis, in the axes of the child.
        Empty for any other joint.

    """

    name: str
    parent: str
    child: str
    shift: list[float]
    turn: list[list[float]]
    barrier: str
    axis: list[float]


class _Path(NamedTuple):
    """
    A chain of joints from the body to a link.

    Attributes
    ----------
    rotation : list of 3 rows of 3 floats
        Rotation matrix from the axes of the link to those of the body.
    position, rest : list of 3 floats, m, body axes
        `position` is the position of the link relative to the centre of mass, computed as a sum
        over the joints. `rest` is the rounding error of this sum.
    barrier : str
        Why forces at the link are not accepted, or '' if they are.
    turning : _Joint, optional
        The continuous joint whose child is this link. None if the link is fixed to the body.

    """

    rotation: list[list[float]]
    position: list[float]
    rest: list[float]
    barrier: str = ''
    turning: _Joint | None = None

    @property
    def frame(self) -> Frame:
        """Return the frame of the link."""
        rotation, position = np.array(self.rotation), np.add(self.position, self.rest)
        if self.turning:
            return TurningFrame(rotation, position, self.turning.name, np.array(self.turning.axis))
        return Frame(rotation, position)

    def across(self, joint: _Joint, to_child: bool) -> _Path:
        """Return this path, extended across a joint to the link on the joint's other side."""
        turning = joint if joint.axis and to_child and not self.turning else None
        barrier = self.barrier or ('' if turning else (self.turning or joint).barrier)
        if barrier:
            return self._replace(barrier=barrier)
        back = [list(row) for row in zip(*joint.turn)]
        rotation = _product(self.rotation, joint.turn if to_child else back)
        to_parent = self.rotation if to_child else rotation
        column = _product(to_parent, [[x if to_child else -x] for x in joint.shift])
        sums = [total + x for total, (x,) in zip(self.position, column)]
        rest = [rest + _rounding(total, x)
                for rest, total, (x,) in zip(self.rest, self.position, column)]
        if not all(abs(x) <= _FARTHEST for x in sums):
            barrier = f'expected a position of at most {_FARTHEST:g} m'
        return _Path(rotation, sums, rest, barrier, turning)


def _paths(body: str, joints: list[_Joint], start: list[float]) -> dict[str, _Path]:
    """Return the path to each link that joints connect to the body; the body is at `start`."""
    joints_of = defaultdict(list)
    for joint in joints:
        joints_of[joint.parent].append((joint, joint.child))
        joints_of[joint.child].append((joint, joint.parent))
    paths, reached = {body: _Path(np.eye(3).tolist(), start, [0.0] * 3)}, [body]
    for name in reached:  # the loop extends this list
        for joint, other in joints_of[name]:
            if other not in paths:
                paths[other] = paths[name].across(joint, other == joint.child)
                reached.append(other)
    if sum(joint.parent in paths for joint in joints) >= len(paths):
        loop = f'the joints between it and {quoted(body)} form a closed loop'
        return {name: path if name == body else path._replace(barrier=path.barrier or loop)
                for name, path in paths.items()}
    return paths


def _joints(robot: Element, links: set[str], body: str) -> list[_Joint]:
    """Return the joints whose parent and child are both among the links."""
    joints, angles = [], []
    for element in robot.findall('{*}joint'):
        parent, child = (_child(element, end).get('link', '') for end in ('parent', 'child'))
        if {parent, child} <= links:
            shift, turn, barrier, axis = _attachment(element, body)
            angles.append(turn)
            name = element.get('name', '')
            joints.append(_Joint(name, parent, child, shift, [], barrier, axis))
    turns = so3.matrix(euler.to_quaternion(np.reshape(angles, (-1, 3)), 'xyz'))  # all at once
    return [joint._replace(turn=turn) for joint, turn in zip(joints, turns.tolist())]


def _attachment(joint: Element,
                body: str) -> tuple[list[float], list[float], str, list[float]]:
    """Return the `shift`, rpy angles, `barrier` and `axis` of a joint; see `_Joint`."""
    name, kind = quoted(joint.get('name', '')), joint.get('type', '')
    zero, types, where = [0.0] * 3, (_FIXED, *_MOVING), f'URDF joint {name}'
    moves = f'joint {name} ({kind}) moves it relative to {quoted(body)}'
    try:
        if kind not in types:
            raise ValueError(f'{where}: type: expected one of {", ".join(types)}, '
                             f'found {quoted(kind)}')
        if kind == _FIXED:
            return *_origin(joint, where), '', []
        if kind == _CONTINUOUS:
            return *_origin(joint, where), moves, _axis(joint, f'{where}: axis')
        return zero, zero, moves, []
    except ValueError as error:
        return zero, zero, str(error), []


def _axis(joint: Element, where: str) -> list[float]:
    """Return the unit vector along the <axis> of a joint."""
    default = '1 0 0' if joint.find('{*}axis') is None else None
    numbers = _numbers(_child(joint, 'axis'), 'xyz', 3, where, default)
    largest = max(map(abs, numbers))
    if not largest:
        raise ValueError(f'{where}: xyz: expected a vector other than zero, found {numbers}')
    # Scale by a power of two, which is exact, so that the norm can neither overflow nor underflow.
    scaled = [math.ldexp(x, -math.frexp(largest)[1]) for x in numbers]
    return [x / math.hypot(*scaled) for x in scaled]


def _product(one: list[list[float]], other: list[list[float]]) -> list[list[float]]:
    """Return the product of a 3 by 3 matrix and a 3 by n matrix."""
    return [[a * x + b * y + c * z for x, y, z in zip(*other)] for a, b, c in one]


def _rounding(one: float, other: float) -> float:
    """Return the rounding error of a sum (Knuth, TAOCP 2, 4.2.2, theorem B)."""
    total = one + other
    part = total - one
    return (one - (total - part)) + (other - part)


def _listed(names: list[str]) -> str:
    return listed([*map(repr, names)])


def _child(parent: Element, name: str) -> Element:
    child = parent.find('{*}' + name)
    return Element(name) if child is None else child


def _origin(element: Element, where: str) -> tuple[list[float], list[float]]:
    """Return the xyz, m, and the rpy angles, rad, of an element's <origin>."""
    origin = _child(element, 'origin')
    if origin.get('quat_xyzw') is not None:
        raise ValueError(f'{where}: expected the rotation as rpy, found quat_xyzw')
    return _numbers(origin, 'xyz', 3, where, '0 0 0'), _numbers(origin, 'rpy', 3, where, '0 0 0')


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
