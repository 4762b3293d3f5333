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
The parameters for torques that depend on the attitude: named uniform fields, and an orbit.

The parameter `fields` lists the names of the uniform fields. Each of these fields has parameters
of its own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
import re
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import written
from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.mechanics.fields import Field, GravityGradient, UniformField
from rigid_body_ros.runtime.parameters import BIG, Parameter
from rigid_body_ros.scene.quantities import FIELD, FIELD_MOMENT, MOMENT

#: The parameter that lists the names of the fields.
FIELDS = 'fields'
_UNIFORM = {MOMENT: (FIELD_MOMENT.unit, 'moment on which the field acts, body axes; for a weight, '
                     'the mass times the vector from the pivot to the centre of mass'),
            FIELD: ('m/s^2 or T', 'the field, space axes')}
ORBIT = 'orbit'
_RATE, _POSITION, _NORMAL = f'{ORBIT}.mean_motion', f'{ORBIT}.position', f'{ORBIT}.normal'


def along(name: str, unit: str, text: str, largest: float = BIG,
          default: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Parameter]:
    """Return the parameters of the components of a vector or a quaternion."""
    return [Parameter(f'{name}.{axis}', value, unit, text, (-largest, largest))
            for axis, value in zip('xyzw', default)]


PARAMETERS = (
    Parameter(FIELDS, [], '', 'names of uniform fields; each field has the parameters NAME.moment '
              'and NAME.field, and exerts the torque NAME.moment x NAME.field (cross product) on '
              'the body'),
    Parameter(_RATE, 0.0, 'rad/s', 'mean motion of a circular orbit, in which the gravity '
              'gradient exerts a torque on the body; 0 means no orbit', (0.0, BIG)),
    *along(_POSITION, '', 'direction from the planet to the body, in space axes, at start_time '
           'or, if start_time is 0, at the start of each epoch', default=(1.0, 0.0, 0.0)),
    *along(_NORMAL, '', 'orbit normal, about which the body revolves, space axes',
           default=(0.0, 0.0, 1.0)),
)
_NAME = re.compile('[A-Za-z_][A-Za-z0-9_]*')
OF_FIELD = re.compile(f'(.+)[.]({MOMENT}|{FIELD})[.][xyz]')


def of_names(names: Iterable[str]) -> dict[str, Parameter]:
    """Return the parameters of the uniform fields with these names, keyed by full name."""
    return {parameter.name: parameter for name in names
            for group, (unit, text) in _UNIFORM.items()
            for parameter in along(f'{name}.{group}', unit, text)}


def check_names(names: Iterable[Any], others: Collection[str], key: str = FIELDS) -> None:
    """
    Check the names of uniform fields or wheels.

    Parameters
    ----------
    names : iterable
        The names to check.
    others : collection of str
        The names of all other parameters.
    key : str
        The parameter that lists the names.

    Raises
    ------
    InputError
        A name is not an identifier, is given twice, or is the first part of another parameter's
        name.

    """
    taken, known = {name.split('.')[0] for name in others}, set[str]()
    for name in names:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise InputError(f'{key}: expected names of letters, digits and _, found '
                             f'{quoted(name)}')
        if name in taken:
            raise InputError(f'{key}: expected a name with which no other parameter begins, '
                             f'found {name!r}')
        if name in known:
            raise InputError(f'{key}: expected each name once, found {name!r} twice')
        known.add(name)


def fields_of(values: Mapping[str, Any]) -> tuple[Field, ...]:
    """
    Create the fields from the parameters of a scene.

    The attribute `time_ns` of an orbit is set to `start_time`, or to None if `start_time` is 0.

    Raises
    ------
    InputError
        A field, a moment, or a direction that defines the orbit is zero; or the two directions
        that define the orbit are not at right angles.

    """
    found: list[Field] = [UniformField(vector(values, f'{name}.{MOMENT}'),
                                       vector(values, f'{name}.{FIELD}'), name)
                          for name in values[FIELDS]]
    if not values[_RATE]:
        return tuple(found)
    try:
        orbit = _orbit(values, values['start_time'] or None)
    except ValueError as error:
        raise InputError(f'orbit: {error}'.replace(' of an orbit', '')) from error
    return (*found, orbit)


def described(values: Mapping[str, Any]) -> list[str]:
    """Return a line of text for each field in a scene."""
    found = []
    for name in values[FIELDS]:
        moment, field = (written(np.array(vector(values, f'{name}.{group}')))
                         for group in (MOMENT, FIELD))
        found.append(f'{name}: moment {moment} in body axes, field {field} in space axes')
    if values[_RATE]:
        found.append(f'gravity gradient: mean motion {values[_RATE]:.9g} rad/s')
    return found


def values_of(one: Field) -> dict[str, float]:
    """
    Return a field's values, keyed by parameter name.

    The result is empty for a uniform field without a name.
    """
    if isinstance(one, GravityGradient):
        vectors = {_POSITION: one.position, _NORMAL: one.normal}
        return {_RATE: one.mean_motion, **_components(vectors)}
    return _components({f'{one.name}.{MOMENT}': one.moment, f'{one.name}.{FIELD}': one.field}) \
        if one.name else {}


def with_values(one: Field, values: Mapping[str, float]) -> Field:
    """Return a copy of a field with new parameter values; raise ValueError if they are invalid."""
    found = {**values_of(one), **values}
    if isinstance(one, GravityGradient):
        return _orbit(found, one.time_ns)
    moment, field = ([found[f'{one.name}.{group}.{axis}'] for axis in 'xyz']
                     for group in (MOMENT, FIELD))
    return UniformField(moment, field, one.name)


def at_start(values: Mapping[str, Any], time_ns: int) -> dict[str, float]:
    """
    Return the orbital position at the start of a motion, keyed by parameter.

    The result is empty if there is no orbit, or if the scene already gives the orbital position at
    this start time.
    """
    begin_ns = values['start_time']
    orbits = [one for one in fields_of(values) if isinstance(one, GravityGradient)]
    if not orbits or begin_ns in (0, time_ns):
        return {}
    position, = orbits[0].directions(np.array([time_ns])).tolist()
    return {f'{_POSITION}.{axis}': value for axis, value in zip('xyz', position)}


def _orbit(values: Mapping[str, Any], time_ns: int | None) -> GravityGradient:
    position, normal = ([values[f'{group}.{axis}'] for axis in 'xyz']
                        for group in (_POSITION, _NORMAL))
    return GravityGradient(values[_RATE], position, normal, time_ns)


def _components(vectors: Mapping[str, Any]) -> dict[str, float]:
    return {f'{group}.{axis}': float(value) for group, vector in vectors.items()
            for axis, value in zip('xyz', vector)}


def vector(values: Mapping[str, Any], group: str) -> list[float]:
    """Return the vector with the components GROUP.x, .y and .z; raise InputError if it is zero."""
    components = [values[f'{group}.{axis}'] for axis in 'xyz']
    if not any(components):
        raise InputError(f'{group}: expected {group}.x, .y or .z other than 0, found zeros')
    return components
