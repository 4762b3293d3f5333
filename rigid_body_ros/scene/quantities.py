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
The quantities that a scene gives, a fit estimates and an ensemble varies: names, units, effects.

A logged torque is multiplied by `torque_gain` and `torque_gains`, delayed by `torque_delay`, and
passed through a first-order lag with time constant `torque_lag`. The result plus `torque_bias`
acts on the body. A gyro measures the angular velocity in sensor axes, times `gyro_scale`, plus
`gyro_bias`. The rotation vector `mount` rotates the body axes into the sensor axes. A sample was
taken at its stamp, plus `clock_offset`, plus `clock_drift` times the time since the start. (In an
ensemble, which has no sensors, `clock_offset` is added to the stamps of the torques.)
"""

from __future__ import annotations

import re
from typing import NamedTuple

from rigid_body_ros.common.arrays import ENTRIES


class Quantity(NamedTuple):
    """A quantity: its component names, their unit, and the value at which it has no effect."""

    components: tuple[str, ...]
    unit: str
    neutral: float = 0.0
    #: Plausible deviation from the neutral value, as a fraction of the scale in a fit.
    plausible: float = 1.0
    #: Whether each sensor can have a separate value of this quantity.
    is_of_sensor: bool = False


def along(name: str, axes: str = 'xyz') -> tuple[str, ...]:
    """Return the names of the components of a vector."""
    return tuple(f'{name}.{axis}' for axis in axes)


#: The parameters of a uniform field, NAME.moment and NAME.field.
MOMENT, FIELD = 'moment', 'field'
#: Name of the weight in a fit, and also of the field that represents the weight.
WEIGHT = 'weight'
#: Name of the rotation between two space axes, which only an alignment fits.
SPACE = 'space'
#: Name of the initial attitude and angular velocity together, in a fit.
START = 'start'
#: All quantities by name, except the two parts of the start and the parameters of fields.
QUANTITIES = {
    'inertia': Quantity(tuple(f'inertia.i{entry}' for entry in ENTRIES), 'kg m^2'),
    'inertia_diagonal': Quantity(tuple(f'inertia.i{entry}' for entry in [*ENTRIES][:3]), 'kg m^2'),
    'torque_gain': Quantity(('torque_gain',), '', 1.0, 0.1),
    'torque_gains': Quantity(along('torque_gains'), '', 1.0, 0.1),
    'torque_bias': Quantity(along('torque_bias'), 'N m', 0.0, 0.1),
    'torque_delay': Quantity(('torque_delay',), 's', 0.0, 0.05),
    'torque_lag': Quantity(('torque_lag',), 's', 0.0, 0.05),
    WEIGHT: Quantity(along(WEIGHT), 'kg m', 0.0, 0.1),
    'clock_offset': Quantity(('clock_offset',), 's', 0.0, 0.02, is_of_sensor=True),
    'clock_drift': Quantity(('clock_drift',), '', 0.0, 0.02, is_of_sensor=True),
    SPACE: Quantity(along(SPACE), 'rad'),
    'mount': Quantity(along('mount'), 'rad', 0.0, 0.05, is_of_sensor=True),
    'gyro_bias': Quantity(along('gyro_bias'), 'rad/s', 0.0, 0.02, is_of_sensor=True),
    'gyro_scale': Quantity(along('gyro_scale'), '', 1.0, 0.02, is_of_sensor=True),
    'damping': Quantity(tuple(f'damping.d{entry}' for entry in ENTRIES), 'N m s/rad', 0.0, 0.05),
    'rotor_momentum': Quantity(along('initial_rotor_momentum'), 'N m s', 0.0, 0.02),
}
#: The parts of the start in a fit, where the attitude is a rotation vector in body axes.
ATTITUDE, RATE = (Quantity(along('initial_attitude'), 'rad'),
                  Quantity(along('initial_angular_velocity'), 'rad/s'))
#: A uniform field's moment, which is as plausible as a weight.
FIELD_MOMENT = QUANTITIES[WEIGHT]._replace(unit='kg m or A m^2')
#: The names of the quantities that can have a separate value for each sensor.
OF_SENSORS = tuple(name for name, quantity in QUANTITIES.items() if quantity.is_of_sensor)
#: The quantities by the part of a component before the dot.
_BY_COMPONENT = {quantity.components[0].split('.')[0]: quantity
                 for quantity in (*QUANTITIES.values(), ATTITUDE, RATE)}
_OF_FIELD = re.compile(rf'([A-Za-z_][A-Za-z0-9_]*)[.]{MOMENT}')


def components_of(name: str) -> tuple[str, ...]:
    """Return the names of the components of a quantity or of the moment of a field."""
    kind, topic = split_topic(name)
    if kind not in QUANTITIES:
        return along(name)
    return tuple(f'{component}@{topic}' if topic else component
                 for component in QUANTITIES[kind].components)


def quantity_of(component: str) -> Quantity:
    """Return the quantity of a component."""
    component = split_topic(component)[0]
    return FIELD_MOMENT if field_of(component[:-2]) else _BY_COMPONENT[component.split('.')[0]]


def split_topic(name: str) -> tuple[str, str]:
    """Split a name `NAME@TOPIC` into `NAME` and `TOPIC`; without `@`, the topic is empty."""
    kind, _, topic = name.partition('@')
    return kind, topic


def field_of(name: str) -> str:
    """Return the field's name if the quantity is `NAME.moment`, or an empty string otherwise."""
    match = _OF_FIELD.fullmatch(name)
    return match[1] if match else ''


def is_of_sensor(name: str) -> bool:
    """Return whether a quantity changes what a sensor measures, but not the motion."""
    return split_topic(name)[0] in (*OF_SENSORS, SPACE)
