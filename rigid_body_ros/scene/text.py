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

"""Write a scene as the text of a parameter file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigid_body_ros.scene.fields import FIELDS
from rigid_body_ros.scene.parameters import Names, parameters_with
from rigid_body_ros.scene.scene import Scene
from rigid_body_ros.scene.wheels import WHEEL_NAMES
import yaml


def text_of(scene: Scene, changed: Mapping[str, Any]) -> str:
    """
    Return a scene as the text of a scene file, with some parameters changed.

    The inertia is written with all digits. If the inertia is among the changed values,
    `robot_description` is left out, because it would specify the old inertia.
    """
    parameters = parameters_with(Names(changed.get(FIELDS, scene.values[FIELDS]),
                                       scene.values[WHEEL_NAMES]))
    values = {name: value for name, value in scene.values.items()
              if value != parameters[name].default or name.startswith('inertia')}
    if any(name.startswith('inertia') for name in changed):
        values.pop('robot_description', None)
        values.pop('link', None)
    values.update(changed)
    tree: dict[str, Any] = {}
    for name in parameters:
        if name in values:
            group, _, key = name.rpartition('.')
            (tree.setdefault(group, {}) if group else tree)[key] = values[name]
    return yaml.safe_dump({'/**': {'ros__parameters': tree}}, sort_keys=False)
