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

"""Create the parts of a scene from its parameters: body, fields, wheels and actuators."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import entries, symmetric, written
from rigid_body_ros.common.errors import InputError, listed, located, quoted
from rigid_body_ros.mechanics import urdf
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import Field, GravityGradient, UniformField
from rigid_body_ros.mechanics.frames import Frames
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.runtime.parameters import checked
from rigid_body_ros.scene.parameters import ACTUATOR, FIELDS, NAMED, PARAMETERS, WHEEL_NAMES
from rigid_body_ros.scene.quantities import along, components_of, FIELD, MOMENT

_TOPICS = 'actuator.topics'
_RATE, _POSITION, _NORMAL = 'orbit.mean_motion', 'orbit.position', 'orbit.normal'


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
    with located('robot_description'):
        tensor = RigidBody.from_urdf(text, link).inertia
    specified = dict(zip(components_of('inertia'), entries(tensor).tolist()))
    for name, entry in specified.items():
        # A parameter dump of a running node contains both the URDF and all tensor entries. Entries
        # that were not given are zero in the dump.
        if given.get(name, 0.0) not in (0.0, entry):
            raise InputError(f'{name}: expected {entry!r} as in robot_description, or no '
                             f'value, found {quoted(given[name])}')
    return specified


def numbers(values: Mapping[str, Any], group: str) -> list[float]:
    """Return the values whose names are GROUP and a component, such as GROUP.x, in order."""
    return [value for name, value in values.items() if name.rpartition('.')[0] == group]


def links_of(values: Mapping[str, Any]) -> Frames:
    """Return the frames in `robot_description`, with `frame_prefix` in front of their names."""
    robot = values['robot_description']
    links = urdf.fixed_frames(robot, values['link']) if robot else Frames()
    return links.prefixed(values['frame_prefix'])


def body_of(values: Mapping[str, Any]) -> RigidBody:
    """Return the body; raise InputError if no body can have its inertia and damping."""
    try:
        return RigidBody(*(symmetric(numbers(values, name)) for name in ('inertia', 'damping')))
    except ValueError as error:
        keys = 'damping.dxx ... damping.dyz:'
        raise InputError(str(error).replace('damping:', keys, 1)) from error


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
    fields = tuple([UniformField(vector(values, f'{name}.{MOMENT}'),
                                 vector(values, f'{name}.{FIELD}'), name)
                    for name in values[FIELDS]])
    if not values[_RATE]:
        return fields
    try:
        orbit = _orbit(values, values['start_time'] or None)
    except ValueError as error:
        raise InputError(f'orbit: {error}'.replace(' of an orbit', '')) from error
    return (*fields, orbit)


def values_of(field: Field) -> dict[str, float]:
    """
    Return a field's values, keyed by parameter name.

    The result is empty for a uniform field without a name.
    """
    if isinstance(field, GravityGradient):
        vectors = {_POSITION: field.position, _NORMAL: field.normal}
        return {_RATE: field.mean_motion, **_components(vectors)}
    return _components({f'{field.name}.{MOMENT}': field.moment,
                        f'{field.name}.{FIELD}': field.field}) if field.name else {}


def with_values(field: Field, values: Mapping[str, float]) -> Field:
    """Return a copy of a field with new parameter values; raise ValueError if they are invalid."""
    values = {**values_of(field), **values}
    if isinstance(field, GravityGradient):
        return _orbit(values, field.time_ns)
    return UniformField(numbers(values, f'{field.name}.{MOMENT}'),
                        numbers(values, f'{field.name}.{FIELD}'), field.name)


def at_start(values: Mapping[str, Any], time_ns: int) -> dict[str, float]:
    """
    Return the orbital position at the start of a motion, keyed by parameter.

    The result is empty if there is no orbit, or if the scene already gives the orbital position at
    this start time.
    """
    begin_ns = values['start_time']
    orbits = [field for field in fields_of(values) if isinstance(field, GravityGradient)]
    if not orbits or begin_ns in (0, time_ns):
        return {}
    position, = orbits[0].directions(np.array([time_ns])).tolist()
    return dict(zip(along(_POSITION), position))


def _orbit(values: Mapping[str, Any], time_ns: int | None) -> GravityGradient:
    return GravityGradient(values[_RATE], numbers(values, _POSITION),
                           numbers(values, _NORMAL), time_ns)


def _components(vectors: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for group, vector in vectors.items()
            for name, value in zip(along(group), vector)}


def vector(values: Mapping[str, Any], group: str) -> list[float]:
    """Return the vector with the components GROUP.x, .y and .z; raise InputError if it is zero."""
    components = numbers(values, group)
    if not any(components):
        raise InputError(f'{group}: expected {group}.x, .y or .z other than 0, found zeros')
    return components


def wheels_of(values: Mapping[str, Any]) -> tuple[Wheel, ...]:
    """Create the wheels from a scene's parameters; raise InputError if a wheel has no axis."""
    return tuple(Wheel(name, vector(values, f'{name}.axis'), *(
        values[f'{name}.{parameter.name}'] for parameter in NAMED[WHEEL_NAMES][3:]))
        for name in values[WHEEL_NAMES])


def actuators_of(values: Mapping[str, Any]) -> tuple[Actuator | None, ...] | None:
    """
    Return the actuator for each topic in `torque_topics`, or None if no topic has one.

    Raises
    ------
    InputError
        A topic in `actuator.topics` is not a torque topic, or is given twice; `actuator.topics`
        is empty although other `actuator` parameters are set; or the time constant is too short.

    """
    topics, commands = values[_TOPICS], [name.removeprefix('/') if isinstance(name, str) else name
                                         for name in values[_TOPICS]]
    torques = [str(name).removeprefix('/') for name in values['torque_topics']]
    for number, name in enumerate(commands):
        if name not in torques:
            raise InputError(f'{_TOPICS}: expected topics among torque_topics '
                             f'({listed(values["torque_topics"])}), found '
                             f'{quoted(topics[number])}')
        if name in commands[:number]:
            raise InputError(f'{_TOPICS}: expected each topic once, found {topics[number]!r} '
                             'twice')
    for parameter in ACTUATOR[1:]:
        name, value = parameter.name, values[parameter.name]
        if value and not topics:
            raise InputError(f'{_TOPICS}: expected at least one topic, because {name} is '
                             f'{value:g}, found an empty list')
    if not topics:
        return None
    with located('actuator.time_constant'):
        actuator = Actuator(values['actuator.delay'], values['actuator.time_constant'],
                            numbers(values, 'actuator.limit'))
    return tuple(actuator if name in commands else None for name in torques)


def described(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Generate a row (name, text) for each field and each wheel in a scene."""
    for name in values[FIELDS]:
        moment, field = (written(np.array(vector(values, f'{name}.{group}')))
                         for group in (MOMENT, FIELD))
        yield 'fields', f'{name}: moment {moment} in body axes, field {field} in space axes'
    if values[_RATE]:
        yield 'fields', f'gravity gradient: mean motion {values[_RATE]:.9g} rad/s'
    for wheel in wheels_of(values):
        yield 'wheels', (f'{wheel.name}: wheel of {wheel.inertia:.9g} kg m^2 about '
                         f'{written(np.asarray(wheel.axis))}, initially at '
                         f'{wheel.initial_speed:.9g} rad/s')
