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

"""Names, components and units of the parameters that a fit can estimate."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import re
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import ENTRIES, Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.mechanics.fields import Field, UniformField
from rigid_body_ros.scene.fields import MOMENT, moment_unit


class Kind(NamedTuple):
    """A parameter: its component names, their unit, and the value at which it has no effect."""

    components: tuple[str, ...]
    unit: str
    neutral: float = 0.0
    #: Plausible deviation from the neutral value, as a fraction of the scale of the parameter.
    plausible: float = 1.0
    #: Whether each sensor can have a separate value of this parameter.
    is_of_sensor: bool = False


def _axes(name: str) -> tuple[str, ...]:
    return tuple(f'{name}.{axis}' for axis in 'xyz')


#: Name of the weight parameter, and also of the field that represents the weight.
WEIGHT = 'weight'
#: Name of the rotation between two space axes, which only an alignment fits.
SPACE = 'space'
#: All parameters by name, except `start` and the moments of fields.
KINDS = {
    'inertia': Kind(tuple(f'inertia.i{entry}' for entry in ENTRIES), 'kg m^2'),
    'inertia_diagonal': Kind(tuple(f'inertia.i{entry}' for entry in [*ENTRIES][:3]), 'kg m^2'),
    'torque_gain': Kind(('torque_gain',), '', 1.0, 0.1),
    'torque_gains': Kind(_axes('torque_gains'), '', 1.0, 0.1),
    'torque_bias': Kind(_axes('torque_bias'), 'N m', 0.0, 0.1),
    'torque_delay': Kind(('torque_delay',), 's', 0.0, 0.05),
    'torque_lag': Kind(('torque_lag',), 's', 0.0, 0.05),
    WEIGHT: Kind(_axes(WEIGHT), 'kg m', 0.0, 0.1),
    'clock_offset': Kind(('clock_offset',), 's', 0.0, 0.02, is_of_sensor=True),
    'clock_drift': Kind(('clock_drift',), '', 0.0, 0.02, is_of_sensor=True),
    SPACE: Kind(_axes(SPACE), 'rad'),
    'mount': Kind(_axes('mount'), 'rad', 0.0, 0.05, is_of_sensor=True),
    'gyro_bias': Kind(_axes('gyro_bias'), 'rad/s', 0.0, 0.02, is_of_sensor=True),
    'gyro_scale': Kind(_axes('gyro_scale'), '', 1.0, 0.02, is_of_sensor=True),
    'damping': Kind(tuple(f'damping.d{entry}' for entry in ENTRIES), 'N m s/rad', 0.0, 0.05),
    'rotor_momentum': Kind(_axes('initial_rotor_momentum'), 'N m s', 0.0, 0.02),
}
#: Largest magnitude of `torque_delay`, s. The fit does not leave these bounds.
LONGEST_DELAY = 2.0
#: Name of the parameter for the initial attitude and angular velocity.
START = 'start'
#: Names of all parameters, in the order in which a fit lists them.
NAMES = (*(name for name in KINDS if name != SPACE), START)
#: The parameters and the two parts of the start, by the part of a component before the dot.
_KINDS = {one.components[0].split('.')[0]: one for one in (
    *KINDS.values(), Kind(_axes('initial_attitude'), 'rad'),
    Kind(_axes('initial_angular_velocity'), 'rad/s'))}
#: Parameters that shift the stamps of samples. The shifts are rounded to whole nanoseconds.
SHIFTS = 'clock_offset', 'clock_drift', 'torque_delay'
_OF_FIELD = re.compile(rf'([A-Za-z_][A-Za-z0-9_]*)[.]{MOMENT}')


def components_of(name: str) -> tuple[str, ...]:
    """Return the names of the components of a parameter or of the moment of a field."""
    kind, topic = split_topic(name)
    if kind not in KINDS:
        return _axes(name)
    return tuple(f'{component}@{topic}' if topic else component
                 for component in KINDS[kind].components)


def kind_of(component: str) -> Kind:
    """Return the parameter of a component; the moment of a field is as plausible as a weight."""
    component = split_topic(component)[0]
    return KINDS[WEIGHT]._replace(unit=moment_unit()) if field_of(component[:-2]) else \
        _KINDS[component.split('.')[0]]


def split_topic(name: str) -> tuple[str, str]:
    """Split a name `NAME@TOPIC` into `NAME` and `TOPIC`; without `@`, the topic is empty."""
    kind, _, topic = name.partition('@')
    return kind, topic


def field_of(name: str) -> str:
    """Return the field's name if the parameter is `NAME.moment`, or an empty string otherwise."""
    found = _OF_FIELD.fullmatch(name)
    return found[1] if found else ''


def checked_names(names: Sequence[str]) -> tuple[str, ...]:
    """
    Return the given names in the order of `NAMES`.

    Raise InputError if the parameters with these names cannot be fitted.
    """
    for name in names:
        kind, topic = split_topic(name)
        if kind not in NAMES and not field_of(name):
            raise InputError(f'estimate: expected names among {", ".join(NAMES)}, and '
                             f'NAME.{MOMENT} of a field, found {name!r}')
        if kind != name and not (topic and kind in of_sensors()):
            raise InputError(f'estimate: expected @TOPIC after the parameter of a sensor '
                             f'({", ".join(of_sensors())}), found {name!r}')
        if list(names).count(name) > 1:
            raise InputError(f'estimate: expected each name once, found {name!r} twice')
        if topic and kind in names:
            raise InputError(f'estimate: expected {kind} for all sensors or for each, found '
                             f'{kind!r} and {name!r}')
    if not names:
        raise InputError('estimate: expected at least one name, found none')
    for pair in (('inertia', 'inertia_diagonal'), ('torque_gain', 'torque_gains')):
        if {*pair} <= {*names}:
            raise InputError(f'estimate: expected one of {pair[0]} and {pair[1]}, found both')
    order = [*NAMES, '']
    return tuple(sorted(names, key=lambda name: order.index(
        '' if field_of(name) else split_topic(name)[0])))


def is_of_sensor(name: str) -> bool:
    """Return whether a parameter changes what a sensor measures, but not the motion."""
    kind = split_topic(name)[0]
    return kind == SPACE or (kind in KINDS and KINDS[kind].is_of_sensor)


def of_sensors() -> tuple[str, ...]:
    """Return the names of the parameters that can have a separate value for each sensor."""
    return tuple(name for name, kind in KINDS.items() if kind.is_of_sensor)


def moments_of(names: Iterable[str], fields: Sequence[Field]) -> dict[str, Floats]:
    """
    Return the given moments of the fields whose moments are fitted, keyed by parameter name.

    Raises
    ------
    InputError
        A field whose moment is fitted does not exist or has zero strength, or the weight is fitted
        and a field already has the name of the weight.

    """
    given = {f'{one.name}.{MOMENT}': np.asarray(one.moment) for one in fields
             if isinstance(one, UniformField) and one.name and np.any(one.field)}
    names = [*names]
    if WEIGHT in names and any(isinstance(one, UniformField) and one.name == WEIGHT
                               for one in fields):
        raise InputError(f'estimate: {WEIGHT}: expected a scene without a field of that name, '
                         f'found one; estimate {WEIGHT}.{MOMENT}')
    wanted = [name for name in names if field_of(name)]
    for name in wanted:
        if name not in given:
            raise InputError(f'estimate: expected {MOMENT}s of the fields of the scene '
                             f'({listed([*map(field_of, given)])}), found {field_of(name)!r}')
    return {name: given[name] for name in wanted}
