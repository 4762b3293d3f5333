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
Read what varies in an ensemble, and draw values for each run.

This is either independent distributions of single parameters, from a YAML file, or the joint
distribution that `attitude_identify` estimated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from pathlib import Path
import re
from typing import TYPE_CHECKING
import zlib

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.errors import InputError, located, quoted
from rigid_body_ros.inference.noise import with_bound
from rigid_body_ros.mechanics import so3
from rigid_body_ros.runtime.limits import read_yaml
from rigid_body_ros.runtime.parameters import BIG, described, entries, number, resembled
from rigid_body_ros.scene import PARAMETERS
from rigid_body_ros.scene.parameters import FIELDS, of_names
from rigid_body_ros.scene.quantities import (
    along,
    components_of,
    MOMENT,
    OF_SENSORS,
    quantity_of,
    split_topic,
)
import yaml

if TYPE_CHECKING:
    from rigid_body_ros.identification.result import Saved


def units_of(*groups: str) -> dict[str, str]:
    """Return the units of all scene parameters in some groups, by name."""
    return {name: parameter.unit for name, parameter in PARAMETERS.items()
            if name.split('.')[0] in groups}


#: The keys that can have a normal or a uniform distribution, and their units. The keys of fields
#: are not included.
UNITS = {**units_of('inertia', 'damping', 'initial_angular_velocity', 'initial_rotor_momentum',
                    'orbit'),
         **{name: quantity_of(name).unit
            for name in ('torque_gain', *along('torque_bias'), 'clock_offset')}}
#: Keys for which each run draws three numbers. For `NOISE`, a run draws three numbers for each
#: torque sample.
INERTIA, ATTITUDE, NOISE = 'inertia', 'initial_attitude', 'torque_noise'
_EXAMPLE = 'torque_gain: {normal: 0.03}'
#: For each key that accepts only one kind of distribution, this kind and its unit.
_SPECIAL = {INERTIA: ('relative', ''), ATTITUDE: ('tilt', 'rad'), NOISE: ('normal', 'N m')}
#: Philox produces this many random numbers for each value of its counter.
_AT_ONCE = 4
#: The keys of the rotation vector that describes an estimated initial attitude.
_ROTATION = along(ATTITUDE)
#: Estimates that do not affect the motion: those of sensors, and the starts of further recordings.
_OF_SENSORS = {component for name in OF_SENSORS for component in components_of(name)}
_OF_LATER_START = re.compile(r'.*\[\d+\]')
#: The keys of an estimated weight, which the fitted scene describes as a field.
_WEIGHT = re.compile(r'^weight(\.[xyz])$')
#: Eigenvalues and pivots of a correlation matrix below this limit are taken to be rounding errors.
_ROUNDING = 1e-12
#: The scale of an estimate that has no spread.
_TINY = 1e-150


@dataclass(frozen=True)
class Dispersion:
    """
    The distribution of a parameter.

    Attributes
    ----------
    key : str
        The parameter: a key of `units_with`, 'inertia', 'initial_attitude' or 'torque_noise'.
    kind : str
        The kind of distribution: 'normal', 'uniform', 'relative' for principal moments of inertia,
        or 'tilt' for a rotation vector.
    bounds : tuple of float
        For a uniform distribution, the lowest and the highest number. For all other kinds, only
        the standard deviation.
    relative : bool
        Whether the numbers are relative. The nominal value is then multiplied by one plus the
        drawn number.

    """

    key: str
    kind: str
    bounds: tuple[float, ...]
    relative: bool = False

    def draw(self, seed: int, runs: Ints) -> Floats:
        """
        Draw the numbers for the given runs.

        Returns
        -------
        array, shape (n, 3) for 'relative' and 'tilt', otherwise (n, 1)
            The values of the parameter if the kind is 'uniform' and `relative` is False. In all
            other cases, deviations from the nominal value.

        """
        if self.kind == 'uniform':
            low, high = self.bounds
            return low + (high - low) * uniforms(seed, runs, self.key, 1)
        return self.bounds[0] * normals(seed, runs, self.key, len(self.moments))

    @property
    def moments(self) -> Floats:
        """Return the mean and the standard deviation of each number in a row of `draw`."""
        count = 3 if self.kind in ('relative', 'tilt') else 1
        moments = (0.0, *self.bounds) if self.kind != 'uniform' else (
            0.5 * sum(self.bounds), (self.bounds[1] - self.bounds[0]) / math.sqrt(12.0))
        return np.tile(moments, (count, 1))


@dataclass(frozen=True, eq=False)
class Fitted:
    """
    Estimated parameters and their joint normal distribution.

    Attributes
    ----------
    estimates : dict of str to float
        The estimates by key, in the units of `units_with`. The three keys `initial_attitude.x`,
        `.y` and `.z` are the components of a rotation vector in body axes, rad.
    guess_attitude : array, shape (4,)
        The attitude to which the rotation vector in `estimates` is relative, as a quaternion
        x y z w.
    covariance : array, shape (n, n)
        The covariance of the estimates, in the order of `estimates`. It is positive semidefinite.
    ignored : tuple of str
        The names of estimates that are ignored because they do not affect the motion.

    """

    estimates: Mapping[str, float]
    guess_attitude: Floats
    covariance: Floats
    ignored: tuple[str, ...] = ()

    @cached_property
    def nominal(self) -> dict[str, float]:
        """Return a mapping from scene keys to estimates, with the attitude as a quaternion."""
        return {key: float(column[0]) for key, column in self.values(self.mean[None]).items()}

    def draw(self, seed: int, runs: Ints) -> dict[str, Floats]:
        """Return values drawn for some runs, shape (n,), for each of the keys of `nominal`."""
        numbers = normals(seed, runs, 'fitted', len(self.mean))
        changes = np.zeros_like(numbers)
        # Add the terms one by one, because the order in which BLAS would add the terms depends on
        # the processor.
        for drawn, column in zip(numbers.T, self.factor.T):
            changes += np.multiply.outer(drawn, column)
        return self.values(self.mean + changes)

    @cached_property
    def mean(self) -> Floats:
        """Return the estimates as an array, shape (n,)."""
        return np.array([*self.estimates.values()])

    @cached_property
    def factor(self) -> Floats:
        """Return the Cholesky factor of the covariance, computed without BLAS."""
        scale, rest = _scaled(self.covariance)
        factor = np.zeros_like(rest)
        for k in range(len(rest)):
            if rest[k, k] > _ROUNDING:
                factor[k:, k] = rest[k:, k] / math.sqrt(rest[k, k])
                rest = rest - np.multiply.outer(factor[:, k], factor[:, k])
        return scale[:, None] * factor

    def values(self, numbers: Floats) -> dict[str, Floats]:
        """Return the values for each of the keys of `nominal` from estimates, shape (m, n)."""
        values = dict(zip(self.estimates, numbers.T))
        if _ROTATION[0] in values:
            rotation = np.stack([values[name] for name in _ROTATION], axis=-1)
            attitude = so3.multiply(self.guess_attitude, so3.exp(rotation))
            values.update(zip(along(ATTITUDE, 'xyzw'), attitude.T))
        return values


def draws(dispersions: Sequence[Dispersion], seed: int, runs: Ints) -> dict[str, Floats]:
    """
    Draw the numbers of all keys for the given runs.

    The numbers of a key depend only on the seed, the key and the run number. They stay the same
    when other keys are added or removed. Torque noise is not included, because it is drawn for
    each torque sample.
    """
    return {dispersion.key: dispersion.draw(seed, runs) for dispersion in dispersions
            if dispersion.key != NOISE}


def dispersed(dispersions: Sequence[Dispersion], nominal: Mapping[str, float],
              drawn: Mapping[str, Floats], count: int) -> dict[str, Floats]:
    """
    Return the values of each key in some runs, shape (count,).

    The values are dispersed if the key varies, and are then computed from the numbers in `drawn`.
    Otherwise, all of them equal the nominal value. For keys without a nominal value, such as the
    inertia, the result contains the drawn numbers.
    """
    values = {**{key: np.full(count, value) for key, value in nominal.items()}, **drawn}
    for dispersion in dispersions:
        key = dispersion.key
        if key in nominal:
            draw, value = drawn[key][:, 0], nominal[key]
            values[key] = value * (1.0 + draw) if dispersion.relative \
                else draw + (dispersion.kind == 'normal') * value
    return values


def uniforms(seed: int, runs: Ints, key: str, count: int) -> Floats:
    """
    Return uniform random numbers for each run, strictly between 0 and 1.

    The generator, Philox, computes random numbers directly from a key and a counter. Each run has
    its own range of the counter, so that the random numbers of a run can be computed without those
    of earlier runs.

    Parameters
    ----------
    seed : int
        The seed, from 0 to 2**64 - 1.
    runs : array of int, shape (n,)
        The run numbers. They should be close together, because random numbers are computed for all
        runs from the lowest to the highest number.
    key : str
        The name of the stream, for example the key of a parameter.
    count : int
        Number of random numbers for each run.

    Returns
    -------
    array, shape (n, count)
        Row i depends only on the seed, `runs[i]`, the key and the count.

    """
    first, counters = int(runs.min()), -(-count // _AT_ONCE)
    generator = np.random.Philox(key=zlib.crc32(key.encode()) << 64 | seed,
                                 counter=first * counters)
    bits = generator.random_raw((int(runs.max()) + 1 - first) * counters * _AT_ONCE)
    chosen = bits.reshape(-1, counters * _AT_ONCE)[runs - first, :count]
    return ((chosen >> np.uint64(12)).astype(float) + 0.5) * 2.0 ** -52


def normals(seed: int, runs: Ints, key: str, count: int) -> Floats:
    """Return standard normal random numbers for each run; see `uniforms` for the arguments."""
    from scipy.special import ndtri  # slow to import
    return np.asarray(ndtri(uniforms(seed, runs, key, count)))


def units_with(fields: Iterable[str]) -> dict[str, str]:
    """Return `UNITS` together with the keys and units of the uniform fields with these names."""
    return {**UNITS, **{name: parameter.unit
                        for name, parameter in of_names(FIELDS, fields).items()}}


def load(path: str | Path, fields: Iterable[str] = ()) -> tuple[Dispersion, ...]:
    """
    Read dispersions from a YAML file.

    Parameters
    ----------
    path : str or Path
        The file.
    fields : iterable of str
        The names of the uniform fields in the scene. Their values can vary as well.

    Raises
    ------
    InputError
        The file cannot be read, a key is unknown or occurs twice, or a distribution is invalid.

    """
    root, units = read_yaml(path, 'dispersions'), units_with(fields)
    with located(path, InputError):
        dispersions = tuple(_dispersion(key.value, value, units)
                            for key, value in entries(root, 'the file', _EXAMPLE))
        if not dispersions:
            raise InputError('expected a parameter that varies, found none')
        keys = [dispersion.key for dispersion in dispersions]
        for key in keys:
            if keys.count(key) > 1:
                raise InputError(f'{key}: expected each key once, found it twice')
            if INERTIA in keys and key.startswith(f'{INERTIA}.'):
                raise InputError(f'{key}: expected either {INERTIA} or its entries, found both')
    return dispersions


def load_fitted(path: str | Path, fields: Iterable[str] = (), force: bool = False) -> Fitted:
    """
    Read the estimates and their covariance from a JSON file written by `attitude_identify`.

    Parameters
    ----------
    path : str or Path
        The file.
    fields : iterable of str
        The names of the uniform fields in the scene.
    force : bool
        Whether to accept the fit even if its verdict is 'rejected'.

    Raises
    ------
    InputError
        The file cannot be read or was not written by `attitude_identify`; the fit did not
        converge, or was rejected and `force` is False; an estimate is not determined by the data
        or cannot vary; or the covariance is invalid.

    """
    from rigid_body_ros.identification import Identification  # slow to import
    saved = Identification.load(path)
    with located(path, InputError):
        return _fitted(saved, {**units_with(fields), **dict.fromkeys(_ROTATION, 'rad')}, force)


def load_varied(path: str | Path, fields: Iterable[str] = (), force: bool = False
                ) -> tuple[tuple[Dispersion, ...], Fitted | None]:
    """Read estimates from a JSON file (see `load_fitted`), or dispersions from a YAML file."""
    if Path(path).suffix == '.json':
        return (), load_fitted(path, fields, force)
    return load(path, fields), None


def _dispersion(key: str, node: yaml.Node, units: Mapping[str, str]) -> Dispersion:
    keys = (*units, *_SPECIAL)
    if key not in keys:
        close = resembled(key, keys)
        raise InputError(f'{key}: unknown key' + (f'; did you mean {close}?' if close else
                                                  f'; expected one of {", ".join(keys)}'))
    pairs = [(name.value, value) for name, value in entries(node, key, _EXAMPLE)]
    names, values = [name for name, _ in pairs], dict(pairs)
    kinds = [name for name in names if name != 'relative' or key == INERTIA]
    only, unit = _SPECIAL.get(key, ('', ''))
    expected = [only] if only else ['normal', 'uniform']
    if len(kinds) != 1 or kinds[0] not in expected or len(values) != len(names):
        raise InputError(f'{key}: expected {" or ".join(expected)}, found {quoted(names)}')
    if only and len(names) > 1:
        raise InputError(f'{key}: expected only {only}, found relative as well')
    return Dispersion(key, kinds[0], _bounds(key, kinds[0], values[kinds[0]],
                                             unit or units.get(key, '')),
                      not only and _flag(key, values.get('relative')))


def _bounds(key: str, kind: str, node: yaml.Node, unit: str) -> tuple[float, ...]:
    nodes = node.value if isinstance(node, yaml.SequenceNode) else [node]
    texts = [item.value if isinstance(item, yaml.ScalarNode) else described(item)
             for item in nodes]
    numbers = tuple(value for value in map(number, texts)
                    if value is not None and abs(value) < BIG)
    possible = len(numbers) == len(texts) and (
        len(numbers) == 2 and numbers[0] < numbers[1] if kind == 'uniform' else
        len(numbers) == 1 and numbers[0] > 0.0)
    if not possible:
        expected = 'two ascending numbers' if kind == 'uniform' else 'a number greater than 0'
        raise InputError(f'{key}: {kind}: expected {expected}{unit and f" ({unit})"}, '
                         f'found {quoted(texts)}')
    return numbers


def _flag(key: str, node: yaml.Node | None) -> bool:
    if node is None:
        return False
    if node.value not in ('true', 'false'):
        raise InputError(f'{key}: relative: expected true or false, found {described(node)}')
    return bool(node.value == 'true')


def _fitted(saved: Saved, units: Mapping[str, str], force: bool) -> Fitted:
    if saved.converged is not True:
        raise InputError('expected a fit that converged, found one that did not')
    if saved.level not in ('explained', 'approximate') and not force:
        raise InputError('expected a fit that explains the measurements, found one that is '
                         f'{saved.level} (attitude_ensemble --force takes it)')
    for name, unit in saved.units.items():
        if unit != units.get(name, unit):
            raise InputError(f'{name}: expected the unit {quoted(units[name])}, found '
                             f'{quoted(unit)}')
    ignored = tuple(name for name in saved.values if split_topic(name)[0] in _OF_SENSORS
                    or _OF_LATER_START.fullmatch(name))
    estimates = {_WEIGHT.sub(rf'weight.{MOMENT}\1', name): value
                 for name, value in saved.values.items() if name not in ignored}
    _check_estimates(estimates, units)
    # The intervals of a model that is a little wrong have a systematic part.
    with np.errstate(invalid='ignore', divide='ignore'):
        wider = with_bound(1.0, np.nan_to_num(
            saved.systematic / np.sqrt(np.diag(saved.covariance)), posinf=0.0))
    rows = [name not in ignored for name in saved.values]
    covariance = (saved.covariance * np.multiply.outer(wider, wider))[np.ix_(rows, rows)]
    _check_covariance([*estimates], covariance)
    return Fitted(estimates, saved.guess_attitude, covariance, ignored)


def _check_estimates(estimates: Mapping[str, float], keys: Collection[str]) -> None:
    if not estimates:
        raise InputError('expected estimates of inertia, start, torque or damping, found none')
    for name, value in estimates.items():
        if name not in keys:
            close = resembled(name, keys)
            raise InputError(f'{name}: expected an estimate that can vary, found another'
                             + (f'; did you mean {close}?' if close else ''))
        if not math.isfinite(value):
            raise InputError(f'{name}: expected a finite value, found {value}')
    if 0 < len({*_ROTATION} & {*estimates}) < 3:
        raise InputError(f'{ATTITUDE}: expected three components, found fewer')


def _check_covariance(names: Sequence[str], covariance: Floats) -> None:
    for name, row in zip(names, covariance):
        if np.isnan(row).all():
            raise InputError(f'{name}: expected an estimate that the recording determines, found '
                             'one that it does not')
    if not np.isfinite(covariance).all():
        raise InputError('covariance: expected finite numbers, found others')
    with np.errstate(over='ignore', invalid='ignore'):
        correlation = _scaled(covariance)[1].clip(-2.0, 2.0)
    if np.abs(correlation - correlation.T).max() > _ROUNDING:
        raise InputError('covariance: expected a symmetric matrix, found another')
    least = float(np.linalg.eigvalsh(correlation)[0])
    if least < -_ROUNDING:
        raise InputError('covariance: expected a positive semidefinite matrix, found correlations '
                         f'with the eigenvalue {least:.3g}')


def _scaled(covariance: Floats) -> tuple[Floats, Floats]:
    """
    Split a covariance matrix into standard deviations and a correlation matrix.

    Standard deviations that are 0 are returned as a tiny number.
    """
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, _TINY)
    return scale, covariance / np.multiply.outer(scale, scale)
