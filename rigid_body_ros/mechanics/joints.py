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
The joints of a URDF file, and the paths of joints that connect links to a body.

The format is specified in http://wiki.ros.org/urdf/XML/joint. Where the specification leaves a
choice, this module follows urdfdom, ROS's parser (`parseJoint` in urdf_parser/src/joint.cpp).
"""

from __future__ import annotations

from collections import defaultdict
import math
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.mechanics import euler, so3
from rigid_body_ros.mechanics.elements import child_of, numbers_of, origin_of
from rigid_body_ros.mechanics.frames import Frame, TurningFrame

_FIXED, _CONTINUOUS = 'fixed', 'continuous'
#: The joint types that allow motion between parent and child.
_MOVING = ('revolute', _CONTINUOUS, 'prismatic', 'floating', 'planar')
#: Largest absolute value of a coordinate, m. Sums of larger coordinates could overflow.
_FARTHEST = 1e300


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


class Path(NamedTuple):
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

    def across(self, joint: _Joint, to_child: bool) -> Path:
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
        return Path(rotation, sums, rest, barrier, turning)


def paths_from(body: str, start: list[float], robot: Element, links: set[str]) -> dict[str, Path]:
    """
    Return the path to each of the links that joints of the robot connect to the body.

    The body is at `start`, m. A joint is ignored unless both its parent and its child are among
    the links.
    """
    joints, joints_of = _joints(robot, links, body), defaultdict(list)
    for joint in joints:
        joints_of[joint.parent].append((joint, joint.child))
        joints_of[joint.child].append((joint, joint.parent))
    paths, reached = {body: Path(np.eye(3).tolist(), start, [0.0] * 3)}, [body]
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
        parent, child = (child_of(element, end).get('link', '') for end in ('parent', 'child'))
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
            return *origin_of(joint, where), '', []
        if kind == _CONTINUOUS:
            return *origin_of(joint, where), moves, _axis(joint, f'{where}: axis')
        return zero, zero, moves, []
    except ValueError as error:
        return zero, zero, str(error), []


def _axis(joint: Element, where: str) -> list[float]:
    """Return the unit vector along the <axis> of a joint."""
    default = '1 0 0' if joint.find('{*}axis') is None else None
    numbers = numbers_of(child_of(joint, 'axis'), 'xyz', 3, where, default)
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
