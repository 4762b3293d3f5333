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

"""The parameters of a fit: names, scales, and coordinates without bounds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
import re
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import COLUMNS, ENTRIES, entries, Floats, ROWS, symmetric
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import Field, UniformField
from rigid_body_ros.scene.fields import MOMENT, moment_unit

#: Component names by name of the parameter; for the moment of a field see `components_of`.
COMPONENTS = {
    'inertia': tuple(f'inertia.i{entry}' for entry in ENTRIES),
    'inertia_diagonal': tuple(f'inertia.i{entry}' for entry in [*ENTRIES][:3]),
    'torque_gain': ('torque_gain',),
    'torque_bias': tuple(f'torque_bias.{axis}' for axis in 'xyz'),
    'clock_offset': ('clock_offset',),
    'mount': tuple(f'mount.{axis}' for axis in 'xyz'),
    'gyro_bias': tuple(f'gyro_bias.{axis}' for axis in 'xyz'),
    'damping': tuple(f'damping.d{entry}' for entry in ENTRIES),
    'rotor_momentum': tuple(f'initial_rotor_momentum.{axis}' for axis in 'xyz'),
}
#: The name of the initial attitude and angular velocity.
START = 'start'
#: Units by the beginning of a component name.
UNITS = {'inertia': 'kg m^2', 'torque_gain': '', 'torque_bias': 'N m', 'clock_offset': 's',
         'mount': 'rad', 'gyro_bias': 'rad/s', 'damping': 'N m s/rad',
         'initial_rotor_momentum': 'N m s', 'initial_attitude': 'rad',
         'initial_angular_velocity': 'rad/s'}
_OF_FIELD = re.compile(rf'([A-Za-z_][A-Za-z0-9_]*)[.]{MOMENT}')
#: The second moments of a guess are at least this fraction of their trace.
_THINNEST = 1e-5
#: Damping from which a fit starts if the scene has none, relative to the scale.
_LITTLE = 1e-3
#: Tensors without negative eigenvalues whose sums are all damping tensors nearby: n n^T.
_DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float)
#: Column i has the entries xx ... yz of the tensor of direction i.
_OF_DIRECTIONS = np.array([[n[i] * n[j] for n in _DIRECTIONS] for i, j in zip(ROWS, COLUMNS)])


@dataclass(frozen=True, eq=False)
class Physics:
    """
    What the motions and the sensors of all recordings have in common.

    Attributes
    ----------
    inertia : array, shape (3, 3), kg m^2, body axes
    damping : array, shape (3, 3), N m s/rad, body axes
    torque_gain : float
        The torque that acts is this gain times the logged torque, plus the bias.
    torque_bias : array, shape (3,), N m, body axes
    clock_offset : float, s
        Added to the stamps of the measurements.
    mount : array, shape (3,), rad
        Rotation vector of the sensor axes in body axes.
    gyro_bias : array, shape (3,), rad/s
        Added to the angular velocity by the sensor.
    rotor_momentum : array, shape (3,), N m s, body axes
        Added to the momentum of the rotors at the start.
    moments : dict of str to array, shape (3,), kg m, A m^2, ..., body axes
        By name of a uniform field, the moment on which it acts, if that is fitted.

    """

    inertia: Floats
    damping: Floats
    torque_gain: float = 1.0
    torque_bias: Floats = field(default_factory=lambda: np.zeros(3))
    clock_offset: float = 0.0
    mount: Floats = field(default_factory=lambda: np.zeros(3))
    gyro_bias: Floats = field(default_factory=lambda: np.zeros(3))
    rotor_momentum: Floats = field(default_factory=lambda: np.zeros(3))
    moments: Mapping[str, Floats] = field(default_factory=dict)

    @cached_property
    def body(self) -> RigidBody:
        """Return the body."""
        return RigidBody(self.inertia, self.damping)

    def acting(self, fields: Sequence[Field]) -> list[Field]:
        """Return fields with the moments that are fitted."""
        return [replace(one, moment=self.moments[one.name])
                if isinstance(one, UniformField) and one.name in self.moments else one
                for one in fields]


def second_moments(inertia: Floats) -> Floats:
    """Return the second moments of mass; they are positive definite for every possible body."""
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def inertia_of(moments: Floats) -> Floats:
    """Return the inertia of a body with these second moments of mass."""
    return np.trace(moments) * np.eye(3) - moments


def components_of(name: str) -> tuple[str, ...]:
    """Return the component names of a parameter, or of NAME.moment, that of a field."""
    return COMPONENTS.get(name) or tuple(f'{name}.{axis}' for axis in 'xyz')


def unit_of(component: str) -> str:
    """Return the unit of a component."""
    return moment_unit() if field_of(component[:-2]) else UNITS[component.split('.')[0]]


def field_of(name: str) -> str:
    """Return the name of the field whose moment a parameter is; empty if it is no moment."""
    found = _OF_FIELD.fullmatch(name)
    return found[1] if found else ''


def checked_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of parameters; raise InputError if they cannot be fitted together."""
    known = (*COMPONENTS, START)
    for name in names:
        if name not in known and not field_of(name):
            raise InputError(f'estimate: expected names among {", ".join(known)}, and NAME.moment '
                             f'of a field, found {name!r}')
        if list(names).count(name) > 1:
            raise InputError(f'estimate: expected each name once, found {name!r} twice')
    if not names:
        raise InputError('estimate: expected at least one name, found none')
    if {'inertia', 'inertia_diagonal'} <= {*names}:
        raise InputError('estimate: expected one of inertia and inertia_diagonal, found both')
    return (*(name for name in known if name in names), *filter(field_of, names))


def moments_of(names: Iterable[str], fields: Sequence[Field]) -> dict[str, Floats]:
    """
    Return the moments to fit, by name of the field, as they are given.

    Raises
    ------
    InputError
        There is no field of that name other than zero.

    """
    given = {one.name: np.asarray(one.moment) for one in fields
             if isinstance(one, UniformField) and one.name and np.any(one.field)}
    wanted = [field_of(name) for name in names if field_of(name)]
    for name in wanted:
        if name not in given:
            raise InputError(f'estimate: expected {MOMENT}s of the fields of the scene '
                             f'({listed(given)}), found {name!r}')
    return {name: given[name] for name in wanted}


class Parameters:
    """
    The fitted parameters that all recordings share.

    In the coordinates of the fit, every point is a possible body: they are the logarithms and the
    relative off-diagonal entries of the Cholesky factor of the second moments of mass (Rucker and
    Wensing 2022), the entries of a Cholesky factor of the damping, and other values divided by
    their scale. Close to a solution, the *plain* coordinates are all values divided by their
    scale; those of the damping are the weights of six tensors whose sums need no bounds.

    Parameters
    ----------
    names : sequence of str
        As `checked_names` returns them.
    guess : Physics
    rate, torque, span_s : float
        Magnitude of the angular velocity (rad/s) and of the torque (N m), and length (s) of the
        recordings.
    strengths : dict of str to float
        Magnitude of each field whose moment is fitted.

    """

    def __init__(self, names: Sequence[str], guess: Physics, rate: float, torque: float,
                 span_s: float, strengths: Mapping[str, float]) -> None:
        self.groups = tuple(name for name in names if name != START)
        self.names = [name for group in self.groups for name in components_of(group)]
        self.guess = guess
        self._moments = _possible(second_moments(guess.inertia))
        self._size = float(np.sqrt(np.trace(self._moments)))
        inertia = inertia_of(self._moments)
        self._scales = _scales(inertia, rate, torque, span_s)
        for name, strength in strengths.items():
            weak = max(torque, float(inertia.max()) * rate ** 2) / strength
            scale = max(weak, float(np.linalg.norm(guess.moments[name])))
            self._scales[f'{name}.{MOMENT}'] = np.full(3, scale)

    @property
    def size(self) -> int:
        """Return the number of components."""
        return len(self.names)

    @property
    def scales(self) -> Floats:
        """Return the magnitude of each component, in its unit."""
        return np.concatenate([np.empty(0), *(self._scales[name] for name in self.groups)])

    @property
    def clock(self) -> list[int]:
        """Return the number of the clock offset, if it is fitted."""
        return [i for i, name in enumerate(self.names) if name == 'clock_offset']

    @property
    def steps(self) -> Floats:
        """Return steps for finite differences; that of the clock is a number of nanoseconds."""
        return np.array([1e-5 if name == 'clock_offset' else 1e-7 for name in self.names])

    def values(self, physics: Physics) -> Floats:
        """Return the components, in their units."""
        return np.concatenate([np.empty(0), *(_values(name, physics) for name in self.groups)])

    def coordinates(self, physics: Physics) -> Floats:
        """Return the coordinates of the fit."""
        return np.concatenate([np.empty(0), *(self._coordinates(name, physics)
                                              for name in self.groups)])

    def physics(self, coordinates: Floats) -> Physics:
        """Return the values at a point."""
        return self._at(coordinates, False, self.guess)

    def near(self, physics: Physics, steps: Floats) -> Physics:
        """Return the values a small, positive step in plain coordinates from a solution."""
        return self._at(steps, True, physics)

    def from_plain(self, jacobian: Floats) -> Floats:
        """Return derivatives by values divided by their scale, from those in plain coordinates."""
        result = jacobian.copy()
        if 'damping' in self.groups:
            first = self.names.index('damping.dxx')
            result[:, first:first + 6] = jacobian[:, first:first + 6] @ np.linalg.inv(
                _OF_DIRECTIONS)
        return result

    def _at(self, point: Floats, plain: bool, physics: Physics) -> Physics:
        first = 0
        for name in self.groups:
            part = point[first:first + len(components_of(name))]
            first += len(part)
            change = self._plain if plain else self._value
            physics = replace(physics, **change(name, part, physics))
        return physics

    def _coordinates(self, name: str, physics: Physics) -> Floats:
        if name.startswith('inertia'):
            factor = np.linalg.cholesky(_possible(second_moments(physics.inertia))) / self._size
            logarithms = np.log(np.diag(factor))
            return logarithms if name == 'inertia_diagonal' else np.append(
                logarithms, factor[[1, 2, 2], [0, 0, 1]])
        if name == 'damping':
            scale = self._scales[name][0]
            damping = physics.damping / scale
            factor = np.linalg.cholesky(damping + _LITTLE * np.eye(3))
            return entries(factor.T)
        return _values(name, physics) / self._scales[name]

    def _value(self, name: str, part: Floats, physics: Physics) -> dict[str, Any]:
        if name == 'inertia':
            factor = np.diag(np.exp(part[:3]))
            factor[[1, 2, 2], [0, 0, 1]] = part[3:]
            factor *= self._size
            return {'inertia': inertia_of(factor @ factor.T)}
        if name == 'inertia_diagonal':
            factor = _with_products(self._size * np.exp(part), self._moments)
            return {'inertia': inertia_of(factor @ factor.T)}
        if name == 'damping':
            factor = np.zeros((3, 3))
            factor[COLUMNS, ROWS] = part
            return {'damping': self._scales[name][0] * factor @ factor.T}
        return _attribute(name, part * self._scales[name], physics)

    def _plain(self, name: str, part: Floats, physics: Physics) -> dict[str, Any]:
        scaled = part * self._scales[name]
        if name.startswith('inertia'):
            rest = np.zeros(6 - len(part))
            return {'inertia': physics.inertia + symmetric(np.append(scaled, rest))}
        if name == 'damping':
            return {'damping': physics.damping + symmetric(_OF_DIRECTIONS @ scaled)}
        return _attribute(name, _values(name, physics) + scaled, physics)


def _possible(moments: Floats) -> Floats:
    values, vectors = np.linalg.eigh(moments)
    return (vectors * np.maximum(values, _THINNEST * values.sum())) @ vectors.T


def _with_products(diagonal: Floats, moments: Floats) -> Floats:
    """Return the Cholesky factor with this diagonal of a tensor with the products of another."""
    factor = np.diag(diagonal)
    factor[1, 0] = moments[1, 0] / diagonal[0]
    factor[2, 0] = moments[2, 0] / diagonal[0]
    factor[2, 1] = (moments[2, 1] - factor[1, 0] * factor[2, 0]) / diagonal[1]
    return factor


def _scales(inertia: Floats, rate: float, torque: float, span_s: float) -> dict[str, Floats]:
    moments = np.diag(inertia)
    largest = float(moments.max())
    acting = max(torque, largest * rate / span_s)
    return {'inertia': np.sqrt(moments[list(ROWS)] * moments[list(COLUMNS)]),
            'inertia_diagonal': moments.copy(),
            'torque_gain': np.ones(1), 'torque_bias': np.full(3, acting),
            'clock_offset': np.ones(1), 'mount': np.ones(3), 'gyro_bias': np.full(3, rate),
            'damping': np.full(6, acting / rate), 'rotor_momentum': np.full(3, largest * rate)}


def _values(name: str, physics: Physics) -> Floats:
    if name.startswith('inertia'):
        return entries(physics.inertia)[:len(COMPONENTS[name])]
    if name == 'damping':
        return entries(physics.damping)
    if field_of(name):
        return physics.moments[field_of(name)]
    return np.atleast_1d(getattr(physics, name))


def _attribute(name: str, values: Floats, physics: Physics) -> dict[str, Any]:
    if field_of(name):
        return {'moments': {**physics.moments, field_of(name): values}}
    return {name: values if len(values) > 1 else float(values[0])}
