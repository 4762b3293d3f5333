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

"""The parameters for named wheels: `wheel_names`, and the parameters of each wheel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import re
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import written
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.runtime.parameters import BIG, Parameter, TINY
from rigid_body_ros.scene.fields import vector

#: The parameter that lists the names of the wheels.
WHEEL_NAMES = 'wheel_names'
PARAMETERS = (
    Parameter(WHEEL_NAMES, [], '', 'names of the wheels, in the order in which outputs list their '
              'speeds; each wheel has the parameters NAME.axis, NAME.inertia, NAME.initial_speed, '
              'NAME.friction, NAME.max_torque and NAME.max_speed'),
)
_AXIS = 'axis'
_INERTIA = Parameter('inertia', None, 'kg m^2', 'axial inertia of the wheel, which is included in '
                     'the inertia of the body', (TINY, BIG))
_OTHERS = (
    Parameter('initial_speed', 0.0, 'rad/s', 'initial speed of the wheel relative to the body',
              (-1e9, 1e9)),
    Parameter('friction', 0.0, 'N m s/rad', 'viscous friction of the wheel: a torque equal to '
              'friction times speed slows the wheel, and the opposite torque acts on the body',
              (0.0, BIG)),
    Parameter('max_torque', 0.0, 'N m', 'largest motor torque; larger commands are clipped to it; '
              '0 means no limit', (0.0, BIG)),
    Parameter('max_speed', 0.0, 'rad/s', 'at this speed or above, a command that would speed up '
              'the wheel acts as zero; the node checks the speed only when the command takes '
              'effect; 0 means no limit', (0.0, BIG)),
)
#: Matches the full names of all wheel parameters except the inertia, whether or not the wheel is
#: listed in `wheel_names`.
OF_WHEEL = re.compile('(.+)[.](axis[.][xyz]|initial_speed|friction|max_torque|max_speed)')


def of_names(names: Iterable[str]) -> dict[str, Parameter]:
    """Return the parameters of the wheels with these names, keyed by full name."""
    return {parameter.name: parameter for name in names for parameter in (
        *(Parameter(f'{name}.{_AXIS}.{axis}', 0.0, '', 'wheel axis, in body axes; the length of '
                    'this vector has no effect', (-BIG, BIG)) for axis in 'xyz'),
        *(each._replace(name=f'{name}.{each.name}') for each in (_INERTIA, *_OTHERS)))}


def wheels_of(values: Mapping[str, Any]) -> tuple[Wheel, ...]:
    """Create the wheels from a scene's parameters; raise InputError if a wheel has no axis."""
    return tuple(Wheel(name, vector(values, f'{name}.{_AXIS}'), *(
        values[f'{name}.{each.name}'] for each in (_INERTIA, *_OTHERS)))
        for name in values[WHEEL_NAMES])


def described(values: Mapping[str, Any]) -> list[str]:
    """Return a line of text for each wheel in a scene."""
    return [f'{wheel.name}: wheel of {wheel.inertia:.9g} kg m^2 about '
            f'{written(np.asarray(wheel.axis))}, initially at {wheel.initial_speed:.9g} rad/s'
            for wheel in wheels_of(values)]
