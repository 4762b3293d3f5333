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

"""The parameters of a fit: their names, their scales, and coordinates that need no bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import COLUMNS, entries, Floats, ROWS, symmetric
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import Field, UniformField
from rigid_body_ros.scene.quantities import (
    components_of,
    field_of,
    MOMENT,
    OF_SENSORS,
    QUANTITIES,
    quantity_of,
    SPACE,
    split_topic,
    START,
    WEIGHT,
)

#: Default acceleration of gravity in space axes, m/s^2.
GRAVITY = 0.0, 0.0, -9.80665
#: Smallest second moment that a body may have, as a fraction of the trace of its second moments.
_THINNEST = 1e-5
#: Smallest second moment with which a fit may start, as a fraction of the trace.
_FLATTEST = 0.02
#: Damping that is added to the guess of a fit, as a fraction of the scale of the damping. Because
#: of this addition, the Cholesky factor exists even if the body has no damping.
_LITTLE = 1e-3
#: The lag with which a fit starts, in seconds. It must not be zero, because at zero lag the
#: derivatives with respect to lag and delay are equal.
SHORT_LAG = 0.02
#: Values of the parameters that are not fitted. They are stored here because creating these arrays
#: at each use would take a tenth of the time of a fit.
_NEUTRAL = {name: np.broadcast_to(kind.neutral, len(kind.components))
            for name, kind in QUANTITIES.items()}
#: Largest magnitude of `torque_delay`, s. The fit does not leave these bounds.
LONGEST_DELAY = 2.0
#: Names of all parameters, in the order in which a fit lists them.
NAMES = (*(name for name in QUANTITIES if name != SPACE), START)
#: Parameters that shift the stamps of samples. The shifts are rounded to whole nanoseconds.
SHIFTS = 'clock_offset', 'clock_drift', 'torque_delay'


class Prior(NamedTuple):
    """Prior knowledge of a component: the expected value and the standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Physics:
    """
    Values of the parameters that all recordings share.

    Attributes
    ----------
    values : dict of str to array
        The inertia, the damping and all fitted parameters by name. If a parameter applies to only
        one sensor, its name ends in `@TOPIC`.
    gravity : array, shape (3,), m/s^2, space axes
        The acceleration of gravity that acts on the weight.

    """

    values: Mapping[str, Floats]
    gravity: Sequence[float] = GRAVITY

    @cached_property
    def inertia(self) -> Floats:
        """Return the inertia in body axes, kg m^2, shape (3, 3)."""
        return symmetric(self.value('inertia'))

    @cached_property
    def damping(self) -> Floats:
        """Return the damping in body axes, N m s/rad, shape (3, 3)."""
        return symmetric(self.value('damping'))

    @cached_property
    def body(self) -> RigidBody:
        """Return the body with the fitted inertia and damping."""
        return RigidBody(self.inertia, self.damping)

    def value(self, name: str, topic: str = '') -> Floats:
        """
        Return the value of a parameter for a topic, or else the value for all sensors.

        The value for all sensors is used if no topic is given, or if the topic has no value of its
        own. A parameter that is not fitted has the value that has no effect.

        The module `scene.quantities` defines the parameters.
        """
        value = self.values.get(f'{name}@{topic}') if topic else None
        value = self.values.get(name) if value is None else value
        return _NEUTRAL[name] if value is None else value

    def with_value(self, name: str, values: Floats) -> Physics:
        """Return the parameters with another value of one of them."""
        return replace(self, values={**self.values, name: values})

    def number(self, name: str, topic: str = '') -> float:
        """Return the value of a parameter with one component."""
        return float(self.value(name, topic)[0])

    def acting(self, fields: Sequence[Field], groups: Sequence[str] = ()) -> list[Field]:
        """Return `fields` with fitted moments, and the weight if it acts or is in `groups`."""
        acting: list[Field] = [
            replace(field, moment=self.values[f'{field.name}.{MOMENT}'])
            if isinstance(field, UniformField) and f'{field.name}.{MOMENT}' in self.values
            else field for field in fields]
        weight = self.value(WEIGHT)
        has_weight = weight.any() or WEIGHT in groups
        return [*acting, UniformField(weight, self.gravity, WEIGHT)] if has_weight else acting


class Magnitudes(NamedTuple):
    """
    Typical magnitudes, from which the scales of the parameters are computed.

    Attributes
    ----------
    rate : float, rad/s
    torque : float, N m
    span_s : float, s
        Duration of the longest channel.
    strengths : dict of str to float
        Magnitude of each uniform field, keyed by the name of the parameter for its moment.

    """

    rate: float
    torque: float
    span_s: float
    strengths: Mapping[str, float]


def second_moments(inertia: Floats) -> Floats:
    """Return the second moments of mass, which are positive definite for every possible body."""
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def inertia_of(moments: Floats) -> Floats:
    """Return the inertia of a body with the given second moments of mass."""
    return np.trace(moments) * np.eye(3) - moments


def lifted(inertia: Floats) -> Floats:
    """
    Return an inertia whose second moments are large enough to start a fit.

    A flat plate or a thin rod has at least one second moment that is almost zero, and derivatives
    with respect to its logarithm are too small to be useful. If necessary, this function adds the
    same amount to all three second moments. The products of inertia do not change.
    """
    moments = second_moments(inertia)
    lack = _FLATTEST * np.trace(moments) - np.linalg.eigvalsh(moments)[0]
    return inertia_of(moments + max(lack, 0.0) * np.eye(3))


class Parameters:
    """
    The fitted parameters that all recordings share.

    The fit uses coordinates in which every point describes a possible body. For the inertia, these
    come from the Cholesky factor of the scaled second moments of mass (Rucker and Wensing 2022):
    three coordinates are the logarithms of the diagonal entries of the factor, and the others are
    its off-diagonal entries. For the damping, the coordinates are the entries of the Cholesky
    factor of the damping. For all other parameters, the coordinates are the values divided by
    their scales.

    Parameters
    ----------
    names : sequence of str
        The names returned by `checked_names`.
    guess : Physics
    magnitudes : Magnitudes
    priors : dict of str to Prior
        Priors, keyed by component name, also those of suspects.

    """

    def __init__(self, names: Sequence[str], guess: Physics, magnitudes: Magnitudes,
                 priors: Mapping[str, Prior] = MappingProxyType({})) -> None:
        self.magnitudes, self.priors = magnitudes, priors
        self.groups = tuple(name for name in names if name != START)
        self.names = [name for group in self.groups for name in components_of(group)]
        self.guess, self.size = guess, len(self.names)
        self._moments = _possible(second_moments(guess.inertia))
        self._size = float(np.sqrt(np.trace(self._moments)))
        inertia = inertia_of(self._moments)
        self._scales = _scales(inertia, magnitudes)
        strengths = {WEIGHT: max(float(np.linalg.norm(guess.gravity)), 1e-9),
                     **magnitudes.strengths}
        for name, strength in strengths.items():
            weak = max(magnitudes.torque, float(inertia.max()) * magnitudes.rate ** 2) / strength
            moment = guess.values.get(name, np.zeros(3))
            self._scales[name] = np.full(3, max(weak, float(np.linalg.norm(moment))))
        #: The scale of each component, in the unit of the component.
        self.scales = self._joined(self._scale)
        #: The priors of the fitted components; the others are those of suspects.
        own = {name: prior for name, prior in priors.items() if name in self.names}
        self._rows = [*map(self.names.index, own)]
        self._means, self._sigmas = np.array([*own.values()], float).reshape(-1, 2).T
        #: The derivatives of `surprise` with respect to the values.
        self.known = np.eye(self.size)[self._rows] / self._sigmas[:, None]

    def with_priors(self, priors: Mapping[str, Prior]) -> Parameters:
        """Return the same parameters with the given priors."""
        return Parameters(self.groups, self.guess, self.magnitudes, priors)

    @property
    def plausible(self) -> Floats:
        """Return how far each component is plausibly from its guess if it is a suspect."""
        return np.array([
            self.priors[name].sigma if name in self.priors else
            quantity_of(name).plausible * scale for name, scale in zip(self.names, self.scales)])

    def surprise(self, physics: Physics) -> Floats:
        """Return how far each value is from its prior, in standard deviations of the prior."""
        return (self.values(physics)[self._rows] - self._means) / self._sigmas

    def columns(self, groups: Iterable[str]) -> list[int]:
        """Return the indices of the components of the given parameters."""
        wanted = {name for group in groups for name in components_of(group)}
        return [i for i, name in enumerate(self.names) if name in wanted]

    def values(self, physics: Physics) -> Floats:
        """Return the values of the components, in their units."""
        return self._joined(lambda name: _values(name, physics))

    def coordinates(self, physics: Physics) -> Floats:
        """Convert the values to the coordinates of the fit."""
        return self._joined(lambda name: self._coordinates(name, physics))

    def _joined(self, part: Callable[[str], Floats]) -> Floats:
        """Return the numbers of all components, from those of each parameter."""
        return np.concatenate([np.empty(0), *map(part, self.groups)])

    def physics(self, coordinates: Floats) -> Physics:
        """
        Convert coordinates of the fit to parameter values.

        Values may not be finite if the coordinates are far from the guess.
        """
        with np.errstate(over='ignore', invalid='ignore'):
            physics, first = self.guess, 0
            for name in self.groups:
                part = coordinates[first:first + len(components_of(name))]
                first += len(part)
                physics = physics.with_value('inertia' if name == 'inertia_diagonal' else name,
                                             self._value(name, part))
            return physics

    def slopes(self, coordinates: Floats) -> Floats:
        """
        Return the derivatives of the values with respect to the coordinates.

        There is a row for each coordinate. A step along the imaginary axis has no cancellation
        (Squire and Trapp, 1998).
        """
        return np.array([self.values(self.physics(coordinates + 1e-30j * unit)).imag / 1e-30
                         for unit in np.eye(self.size)]).reshape(self.size, self.size)

    def _scale(self, name: str) -> Floats:
        return self._scales[split_topic(name)[0]]

    def _coordinates(self, name: str, physics: Physics) -> Floats:
        if name.startswith('inertia'):
            factor = np.linalg.cholesky(_possible(second_moments(physics.inertia))) / self._size
            logarithms = np.log(np.diag(factor))
            return logarithms if name == 'inertia_diagonal' else np.append(
                logarithms, factor[[1, 2, 2], [0, 0, 1]])
        if name == 'damping':
            damping = physics.damping / self._scales[name][0]
            factor = np.linalg.cholesky(damping + _LITTLE * np.eye(3))
            return entries(factor.T)
        return _values(name, physics) / self._scale(name)

    def _value(self, name: str, part: Floats) -> Floats:
        if name == 'damping':
            factor = np.zeros((3, 3), part.dtype)
            factor[COLUMNS, ROWS] = part
            return (self._scales[name][0] * factor @ factor.T)[ROWS, COLUMNS]
        if not name.startswith('inertia'):
            part = -part if name == 'torque_lag' and part.real < 0.0 else part
            return part * self._scale(name)
        if name == 'inertia':
            factor = np.diag(np.exp(part[:3]))
            factor[[1, 2, 2], [0, 0, 1]] = part[3:]
            factor *= self._size
        else:
            factor = _with_products(self._size * np.exp(part), self._moments)
        return inertia_of(factor @ factor.T)[ROWS, COLUMNS]


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
        if kind != name and not (topic and kind in OF_SENSORS):
            raise InputError(f'estimate: expected @TOPIC after the parameter of a sensor '
                             f'({", ".join(OF_SENSORS)}), found {name!r}')
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


def moments_of(names: Iterable[str], fields: Sequence[Field]) -> dict[str, Floats]:
    """
    Return the given moments of the fields whose moments are fitted, keyed by parameter name.

    Raises
    ------
    InputError
        A field whose moment is fitted does not exist or has zero strength, or the weight is fitted
        and a field already has the name of the weight.

    """
    uniform = [field for field in fields if isinstance(field, UniformField)]
    moments = {f'{field.name}.{MOMENT}': np.asarray(field.moment) for field in uniform
               if field.name and np.any(field.field)}
    names = [*names]
    if WEIGHT in names and any(field.name == WEIGHT for field in uniform):
        raise InputError(f'estimate: {WEIGHT}: expected a scene without a field of that name, '
                         f'found one; estimate {WEIGHT}.{MOMENT}')
    wanted = [name for name in names if field_of(name)]
    for name in wanted:
        if name not in moments:
            raise InputError(f'estimate: expected {MOMENT}s of the fields of the scene '
                             f'({listed([*map(field_of, moments)])}), found {field_of(name)!r}')
    return {name: moments[name] for name in wanted}


def checked_priors(priors: Mapping[str, float | str], parameters: Parameters) -> dict[str, Prior]:
    """
    Check the priors given by the user, and return the prior of each component.

    Parameters
    ----------
    priors : dict of str to float or str
        Standard deviations, keyed by the name of a parameter or component. A number has the unit
        of the component. A string such as '5%' is relative to the guess.
    parameters : Parameters
        The fitted parameters and the suspects, with the guess given by the user.

    Raises
    ------
    InputError
        A name does not refer to any component of `parameters`, a number is not positive, or a
        percentage is given for a guess of 0.

    """
    values = dict(zip(parameters.names, parameters.values(parameters.guess)))
    result = {}
    for name, stated in priors.items():
        components = [name] if name in values else [
            component for component in values
            if {component, split_topic(component)[0]} & {*components_of(name)}]
        if not components:
            raise InputError(f'prior: expected parameters that are estimated or may be suspects '
                             f'({listed(parameters.groups)}), found {name!r}')
        text = str(stated)
        try:
            size = float(text.removesuffix('%'))
        except ValueError:
            size = np.nan
        for component in components:
            sigma = 0.01 * size * abs(values[component]) if text.endswith('%') else size
            if not (np.isfinite(sigma) and sigma > 0.0):
                raise InputError(f'prior: {component}: expected a standard deviation greater than '
                                 f'zero, found {text} of a guess of {values[component]:g}')
            result[component] = Prior(float(values[component]), float(sigma))
    return result


def _possible(moments: Floats) -> Floats:
    values, vectors = np.linalg.eigh(moments)
    return (vectors * np.maximum(values, _THINNEST * values.sum())) @ vectors.T


def _with_products(diagonal: Floats, moments: Floats) -> Floats:
    """
    Return the Cholesky factor that has the given diagonal.

    The off-diagonal entries of the factor times its transpose equal those of `moments`.
    """
    factor = np.diag(diagonal)
    factor[1, 0] = moments[1, 0] / diagonal[0]
    factor[2, 0] = moments[2, 0] / diagonal[0]
    factor[2, 1] = (moments[2, 1] - factor[1, 0] * factor[2, 0]) / diagonal[1]
    return factor


def _scales(inertia: Floats, magnitudes: Magnitudes) -> dict[str, Floats]:
    rate, torque, span_s, _ = magnitudes
    moments = np.diag(inertia)
    largest = float(moments.max())
    acting = max(torque, largest * rate / span_s)
    scales = {name: np.ones(len(kind.components)) for name, kind in QUANTITIES.items()}
    return {**scales,
            'inertia': np.sqrt(moments[list(ROWS)] * moments[list(COLUMNS)]),
            'inertia_diagonal': moments.copy(), 'torque_bias': np.full(3, acting),
            'clock_drift': np.ones(1) / span_s, 'gyro_bias': np.full(3, rate),
            'damping': np.full(6, acting / rate), 'rotor_momentum': np.full(3, largest * rate)}


def _values(name: str, physics: Physics) -> Floats:
    if name == 'inertia_diagonal':
        return physics.value('inertia')[:3]
    return physics.value(*split_topic(name))
