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

from collections.abc import Iterable, Iterator
import re
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import listed, quoted
from rigid_body_ros.mechanics import euler, so3
from rigid_body_ros.mechanics.elements import child_of, numbers_of, origin_of, parse_robot
from rigid_body_ros.mechanics.frames import Frames
from rigid_body_ros.mechanics.joints import fractions, Joint, joints_between, Path, paths_from

#: The attributes of <inertia> that give the entries of the tensor, row by row.
_ENTRIES = ('ixx', 'ixy', 'ixz', 'ixy', 'iyy', 'iyz', 'ixz', 'iyz', 'izz')
#: Upper bound on the rounding error of a rotated tensor, relative to the largest moment of that
#: tensor.
_ROTATION_ERROR = 16.0 * np.finfo(float).eps


def inertia(text: str, link: str = '') -> Floats:
    """
    Return the inertia of a body about its centre of mass, in the axes of a link.

    The body consists of the link and of all links that fixed joints connect to it, whichever of
    the two is the parent. Joints of other types move links; these links do not contribute. The
    result is the sum of R I R^T + m (d . d E - d d^T) over the links of the body that have an
    <inertial>. Here, I is the matrix with the entries of <inertia>, R is the rotation from its
    axes to the body axes, m is the mass, d is the position of the link's centre of mass relative
    to that of the body, and E is the identity (parallel-axis theorem: Goldstein, Classical
    Mechanics, 3rd edition, section 5.3). The sums are exact, and are rounded once.

    The roll, pitch and yaw of an <origin> are about the fixed axes x, y, z. A rotation adds
    rounding errors of about 1e-16 times the largest moment. If only the link itself has an
    <inertial>, its mass and its position are validated at most, and do not change the tensor:
    without a rotation, the entries are exactly those in the file.

    Parameters
    ----------
    text : str
        The contents of the file, after processing by xacro. All six entries of <inertia> are
        required, because neither the specification nor urdfdom defines defaults for them. The xyz
        and rpy of <origin> default to zero. A <mass> is required only if the body has several.
    link : str
        Name of any link of the body. It may be empty if all links with <inertial> belong to one
        body. The link is then the lowest one from which fixed joints lead down to all of them. For
        a single link with <inertial>, this is the link itself.

    Returns
    -------
    array, shape (3, 3), kg m^2, axes of the link
        The inertia tensor. Without a rotation, it is exactly symmetric. After a rotation, it is
        symmetric within rounding.

    Raises
    ------
    ValueError
        The text is not URDF, or has not been through xacro; the link does not exist, is not
        unique, or its body has no <inertial>; an attribute is missing or is not a list of finite
        numbers of the expected length; a rotation is a quaternion (URDF 1.1); a mass among several
        is not greater than zero; the joints do not determine the position of a link with an
        <inertial>; or a moment is zero within the rounding error of the rotations.

    """
    body = _body(text, link)
    is_single = [*body.points] == [body.link]
    tensors = [_tensor(body.inertials[name], name, is_single) for name in body.points]
    if is_single:
        return tensors[0]
    try:
        total = np.zeros((3, 3), object)
        for point, mass, tensor in zip(body.points.values(), body.masses, tensors):
            turn, d = fractions(point.rotation), point.position - body.centre
            total += turn @ fractions(tensor) @ turn.T
            total += mass * (d @ d * np.eye(3, dtype=int) - np.outer(d, d))
        rounded = total.astype(float)
    except (OverflowError, ValueError):
        raise ValueError(f'{_where(body.link)}: inertia: expected moments that fit a double, '
                         'found larger ones') from None
    _check_thickness(rounded, _where(body.link))
    return rounded


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
        Name of the link that represents the body; it may be empty, as in `inertia`. The body axes
        are the axes of this link. The positions of the frames are relative to the common centre of
        mass of all links of the body that have an <inertial>.

    Returns
    -------
    Frames
        The frames, keyed by link name, including the link that represents the body. The child of a
        continuous joint has a `frames.TurningFrame`. Looking up any other name raises
        UnknownFrameError, which is both a KeyError and a ValueError. Its message gives the reason:
        for example, a joint moves the link, a joint has no valid <origin> or <axis>, the joints
        form a closed loop, or no joints connect the link to the body. `Frames.notes` names the
        links whose masses belong to the body, and those whose masses do not.

    Raises
    ------
    ValueError
        The text is not URDF, or has not been through xacro; the link does not exist, is not
        unique, or its body has no <inertial>; the <origin> of an <inertial> is not valid; a mass
        among several is not greater than zero; or the joints do not determine the position of a
        link with an <inertial>.

    """
    body = _body(text, link)
    frames = {name: path.frame(body.centre)
              for name, path in body.paths.items() if not path.barrier}
    others = dict.fromkeys(body.links, f'no joints connect it to {quoted(body.link)}')
    others |= {name: path.barrier for name, path in body.paths.items()}
    others = {name: others[name] for name in body.links if name not in frames}
    return Frames(body.link, frames, others, [*_notes(body)])


class _Body(NamedTuple):
    """
    The links of a robot that fixed joints weld together.

    Attributes
    ----------
    link : str
        The link whose axes are the body axes.
    links : list of str
        All links of the robot.
    paths : dict
        The path to each link that joints connect to `link`.
    inertials : dict
        The <inertial> of each link of the robot that has one.
    points : dict
        For each link of the body that has an <inertial>, the path to its centre of mass.
    masses : array of Fractions, shape (n,), kg
        The mass at each point. A single mass is 1 kg, whatever the file says.
    centre : array of Fractions, shape (3,), m, body axes
        The common centre of mass, relative to the origin of `link`.

    """

    link: str
    links: list[str]
    paths: dict[str, Path]
    inertials: dict[str, Element]
    points: dict[str, Path]
    masses: NDArray[Any]
    centre: NDArray[Any]


def _notes(body: _Body) -> Iterator[str]:
    """Yield lines about the links with an <inertial>, unless there is only one."""
    if len(body.points) > 1:
        welded = [name for name in body.points if name != body.link]
        yield (f'welded to {quoted(body.link)} by fixed joints: {listed(welded)} '
               f'(total mass {sum(map(float, body.masses)):.6g} kg)')
    others = [name for name in body.inertials if name not in body.points]
    if others:
        reason = 'joints move them' if {*others} <= {*body.paths} else \
            f'fixed joints do not connect them to {quoted(body.link)}'
        yield f'left out, because {reason}: {listed(others)}'


def _check_thickness(tensor: Floats, where: str) -> None:
    """Raise ValueError if the rounding error of a rotation may exceed the smallest moment."""
    moments = np.linalg.eigvalsh(tensor)
    if abs(moments[0]) <= _ROTATION_ERROR * moments[2]:
        raise ValueError(f'{where}: inertia: expected a positive definite tensor, found principal '
                         f'moments {moments.tolist()} kg m^2')


def _body(text: str, link: str) -> _Body:
    """Return the body that a link belongs to; if `link` is empty, that of all links with mass."""
    robot = parse_robot(text)
    # `{*}` matches any namespace. One of urdfdom's examples has a namespace, and urdfdom ignores
    # the namespace.
    elements = [(element.get('name', ''), element.find('{*}inertial'))
                for element in robot.findall('{*}link')]
    links = [name for name, _ in elements]
    inertials = {name: inertial for name, inertial in elements if inertial is not None}
    joints = joints_between({*links}, robot)
    link = link or _root(joints, inertials)
    paths = paths_from(link, joints)
    points = {name: paths[name].to_point(origin_of(inertial, _where(name))[0])
              for name, inertial in inertials.items()
              if name in paths and not paths[name].mover}
    for name, point in {link: paths[link], **points}.items():
        if links.count(name) != 1:
            raise ValueError(f'URDF: expected one link {quoted(name)}, found {_listed(links)}')
        if point.barrier:
            raise ValueError(f'{_where(name)}: {point.barrier}')
    if not points:
        raise ValueError(f'{_where(link)}: expected an <inertial>, found none; '
                         f'links with <inertial>: {_listed([*inertials])}')
    masses = fractions([_mass(inertials[name], name) for name in points]
                       if len(points) > 1 else [1.0])
    places = np.array([point.position for point in points.values()])
    centre = masses @ places / masses.sum()
    return _Body(link, links, paths, inertials, points, masses, centre)


def _root(joints: Iterable[Joint], inertials: Iterable[str]) -> str:
    """Return the lowest link from which fixed joints lead down to all links with an <inertial>."""
    parents = {joint.child: joint.parent for joint in joints if not joint.moves}
    bodies: dict[str, list[str]] = {}  # the links above all masses of each body, lowest first
    for name in inertials:
        chain = {}
        while name not in chain:
            chain[name] = parents.get(name, name)
            name = chain[name]
        *_, top = chain
        bodies[top] = [link for link in bodies.get(top, chain) if link in chain]
    roots = [lowest for lowest, *_ in bodies.values()]
    if len(roots) != 1:
        raise ValueError('URDF: expected the name of a link, or a single body with <inertial>, '
                         f'found {_listed(roots)}')
    return roots[0]


def _tensor(inertial: Element, name: str, is_single: bool) -> Floats:
    """Return the tensor of an <inertial>, shape (3, 3), kg m^2, in the axes of its link."""
    entries, where = child_of(inertial, 'inertia'), _where(name)
    tensor = np.reshape([numbers_of(entries, entry, 1, where) for entry in _ENTRIES], (3, 3))
    _, angles = origin_of(inertial, where)
    if is_single and any(angles):
        _check_thickness(tensor, where)
    attitude = euler.to_quaternion(angles, 'xyz')
    return so3.rotate(attitude, so3.rotate(attitude, tensor).T)


def _mass(inertial: Element, name: str) -> float:
    """Return the mass of an <inertial>, kg."""
    where = f'{_where(name)}: mass'
    mass, = numbers_of(child_of(inertial, 'mass'), 'value', 1, where)
    if mass <= 0.0:
        raise ValueError(f'{where}: expected a number greater than 0 (kg), found {mass}')
    return mass


def _where(link: str) -> str:
    return f'URDF link {quoted(link)}'


def _listed(names: list[str]) -> str:
    return listed([*map(repr, names)])
