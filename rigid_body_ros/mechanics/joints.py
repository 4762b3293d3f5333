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
from fractions import Fraction
import math
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.mechanics import euler, so3
from rigid_body_ros.mechanics.elements import child_of, numbers_of, origin_of
from rigid_body_ros.mechanics.frames import Frame, TurningFrame

_FIXED, _CONTINUOUS = 'fixed', 'continuous'
#: The joint types that allow motion between parent and child.
_MOVING = ('revolute', _CONTINUOUS, 'prismatic', 'floating', 'planar')
#: Largest absolute value of a coordinate, m. Sums of larger coordinates could overflow.
_FARTHEST = 1e300
#: Converts finite numbers to an array of Fractions, whose sums and products are exact.
fractions = np.vectorize(Fraction, [object])


class Joint(NamedTuple):
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
    moves : bool
        Whether the type of the joint allows motion between parent and child.

    """

    name: str
    parent: str
    child: str
    shift: list[float]
    turn: list[list[float]]
    barrier: str
    axis: list[float]
    moves: bool


class Path(NamedTuple):
    """
    A chain of joints from the body to a link, or to a point of that link.

    Attributes
    ----------
    rotation : list of 3 rows of 3 floats
        Rotation matrix from the axes of the link to those of the body.
    position : array of Fractions, shape (3,), m, body axes
        The position of the link relative to the origin of the body axes. The sum over the joints
        is exact.
    barrier : str
        Why forces at the link are not accepted, or '' if they are.
    mover : Joint, optional
        The first joint that moves the link relative to the body. None if fixed joints connect the
        two. If there is no barrier, it is a continuous joint whose child is this link.

    """

    rotation: list[list[float]]
    position: NDArray[Any]
    barrier: str = ''
    mover: Joint | None = None

    def frame(self, centre: NDArray[Any]) -> Frame:
        """Return the frame of the link; the centre of mass is at `centre`, in Fractions, m."""
        rotation, position = np.array(self.rotation), (self.position - centre).astype(float)
        if self.mover:
            return TurningFrame(rotation, position, self.mover.name, np.array(self.mover.axis))
        return Frame(rotation, position)

    def across(self, joint: Joint, to_child: bool) -> Path:
        """Return this path, extended across a joint to the link on the joint's other side."""
        mover = self.mover or (joint if joint.moves else None)
        is_turning = mover is joint and joint.axis and to_child
        barrier = self.barrier or ('' if is_turning else (mover or joint).barrier)
        if barrier:
            return self._replace(barrier=barrier, mover=mover)
        if to_child:
            rotation = _product(self.rotation, joint.turn)
            return self.to_point(joint.shift)._replace(rotation=rotation, mover=mover)
        rotation = _product(self.rotation, [list(row) for row in zip(*joint.turn)])
        return self._replace(rotation=rotation).to_point([-x for x in joint.shift])

    def to_point(self, shift: list[float]) -> Path:
        """Return this path, extended by a `shift`, m, in the axes of the link."""
        steps = [x for x, in _product(self.rotation, [[x] for x in shift])]
        if not all(abs(x) <= _FARTHEST for x in steps):
            text = f'expected a position of at most {_FARTHEST:g} m'
            return self._replace(barrier=self.barrier or text)
        return self._replace(position=self.position + fractions(steps))


def paths_from(body: str, joints: list[Joint]) -> dict[str, Path]:
    """Return the path to each link that joints connect to the body, including the body."""
    joints_of = defaultdict(list)
    for joint in joints:
        joints_of[joint.parent].append((joint, joint.child))
        joints_of[joint.child].append((joint, joint.parent))
    paths, reached = {body: Path(np.eye(3).tolist(), fractions([0.0] * 3))}, [body]
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


def joints_between(links: set[str], robot: Element) -> list[Joint]:
    """Return the joints whose parent and child are both among the links."""
    joints, angles = [], []
    for element in robot.findall('{*}joint'):
        parent, child = (child_of(element, end).get('link', '') for end in ('parent', 'child'))
        if {parent, child} <= links:
            shift, turn, barrier, axis = _attachment(element)
            angles.append(turn)
            name, moves = element.get('name', ''), element.get('type') in _MOVING
            joints.append(Joint(name, parent, child, shift, [], barrier, axis, moves))
    turns = so3.matrix(euler.to_quaternion(np.reshape(angles, (-1, 3)), 'xyz'))  # all at once
    return [joint._replace(turn=turn) for joint, turn in zip(joints, turns.tolist())]


def _attachment(joint: Element) -> tuple[list[float], list[float], str, list[float]]:
    """Return the `shift`, rpy angles, `barrier` and `axis` of a joint; see `Joint`."""
    name, kind = quoted(joint.get('name', '')), joint.get('type', '')
    zero, types, where = [0.0] * 3, (_FIXED, *_MOVING), f'URDF joint {name}'
    moves = f'joint {name} ({kind}) moves it relative to the body'
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
