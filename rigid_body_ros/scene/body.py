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

"""The body in a scene: its links, and its inertia, which a robot description may provide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.mechanics import urdf
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.frames import Frames
from rigid_body_ros.runtime.parameters import checked
from rigid_body_ros.scene.parameters import PARAMETERS


def inertia_of_robot(given: Mapping[str, Any]) -> dict[str, float]:
    """
    Return the entries of the inertia tensor that `robot_description` specifies.

    The result is {} if `robot_description` is empty.

    Raises
    ------
    InputError
        The URDF is not valid; a given `inertia.*` parameter differs from the URDF; or `link` is
        set but `robot_description` is not.

    """
    text, link = (checked(PARAMETERS[name], given.get(name, ''))
                  for name in ('robot_description', 'link'))
    if not text:
        if link:
            raise InputError(f'link: expected an empty text, because robot_description is empty, '
                             f'found {quoted(link)}; set robot_description, or remove link')
        return {}
    try:
        tensor = RigidBody.from_urdf(text, link).inertia
    except ValueError as error:
        raise InputError(f'robot_description: {error}') from error
    entries = {f'inertia.i{"xyz"[i]}{"xyz"[j]}': float(tensor[i, j])
               for i in range(3) for j in range(i, 3)}
    for name, entry in entries.items():
        # A parameter dump of a running node contains both the URDF and all tensor entries. Entries
        # that were not given are zero in the dump.
        if given.get(name, 0.0) not in (0.0, entry):
            raise InputError(f'{name}: expected {entry!r} as in robot_description, or no '
                             f'value, found {quoted(given[name])}')
    return entries


def group(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """Return the values whose names are `prefix`.KEY, as a dictionary with the keys KEY."""
    return {name.split('.')[1]: value for name, value in values.items()
            if name.startswith(prefix + '.')}


def links_of(values: Mapping[str, Any]) -> Frames:
    """Return the frames in `robot_description`, with `frame_prefix` in front of their names."""
    robot = values['robot_description']
    links = urdf.fixed_frames(robot, values['link']) if robot else Frames()
    return links.prefixed(values['frame_prefix'])


def body_of(values: Mapping[str, Any]) -> RigidBody:
    """Return the body; raise InputError if no body can have its inertia and damping."""
    try:
        return RigidBody(_tensor(values, 'inertia'), _tensor(values, 'damping'))
    except ValueError as error:
        keys = 'damping.dxx ... damping.dyz:'
        raise InputError(str(error).replace('damping:', keys, 1)) from error


def _tensor(values: Mapping[str, Any], prefix: str) -> list[list[float]]:
    """Build a symmetric tensor from the group of its entries xx, yy, zz, xy, xz and yz."""
    xx, yy, zz, xy, xz, yz = group(values, prefix).values()
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
