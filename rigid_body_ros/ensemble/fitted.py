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

"""Draw parameter values from the joint distribution estimated by `attitude_identify`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted, reason, shortened
from rigid_body_ros.ensemble.applied import components
from rigid_body_ros.ensemble.dispersions import ATTITUDE, normals, units_with
from rigid_body_ros.inference.noise import with_bound
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.runtime.limits import read_json
from rigid_body_ros.runtime.parameters import resembled
from rigid_body_ros.scene.fields import MOMENT

#: The keys of the rotation vector that describes the initial attitude.
_ROTATION = tuple(f'{ATTITUDE}.{axis}' for axis in 'xyz')
#: Estimates that do not affect the motion: sensor errors, and the starts of further recordings.
_NOT_IN_MOTION = re.compile(r'((mount|gyro_bias|gyro_scale)\.[xyz]|clock_offset|clock_drift)(@.*)?'
                            r'|.*\[\d+\]')
#: The keys of an estimated weight, which the fitted scene describes as a field.
_WEIGHT = re.compile(r'^weight(\.[xyz])$')
#: Eigenvalues and pivots of a correlation matrix below this limit are taken to be rounding errors.
_ROUNDING = 1e-12
_KINDS = {bool: 'true or false', dict: 'names and values', float: 'a number', list: 'a list',
          str: 'a text'}


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
        return {key: float(column[0]) for key, column in self._values(self._mean[None]).items()}

    def draw(self, seed: int, runs: NDArray[np.int64]) -> dict[str, Floats]:
        """Return values drawn for some runs, shape (n,), for each of the keys of `nominal`."""
        numbers = normals(seed, runs, 'fitted', len(self._mean))
        changes = np.zeros_like(numbers)
        # Add the terms one by one, because the order in which BLAS would add the terms depends on
        # the processor.
        for number, column in zip(numbers.T, self._factor.T):
            changes += np.multiply.outer(number, column)
        return self._values(self._mean + changes)

    @cached_property
    def _mean(self) -> Floats:
        return np.array([*self.estimates.values()])

    @cached_property
    def _factor(self) -> Floats:
        """Return the Cholesky factor of the covariance, computed without BLAS."""
        scale, rest = _scaled(self.covariance)
        factor = np.zeros_like(rest)
        for k in range(len(rest)):
            if rest[k, k] > _ROUNDING:
                factor[k:, k] = rest[k:, k] / math.sqrt(rest[k, k])
                rest = rest - np.multiply.outer(factor[:, k], factor[:, k])
        return scale[:, None] * factor

    def _values(self, numbers: Floats) -> dict[str, Floats]:
        values = dict(zip(self.estimates, numbers.T))
        if _ROTATION[0] in values:
            rotation = np.stack([values[name] for name in _ROTATION], axis=-1)
            values.update(components(ATTITUDE, so3.multiply(self.guess_attitude,
                                                            so3.exp(rotation))))
        return values


def load(path: str | Path, fields: Iterable[str] = (), force: bool = False) -> Fitted:
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
    data = read_json(path, 'estimates')
    try:
        return _fitted(data, {**units_with(fields), **dict.fromkeys(_ROTATION, 'rad')}, force)
    except InputError as error:
        raise InputError(f'{path}: {error}') from error


def _fitted(data: Any, units: Mapping[str, str], force: bool) -> Fitted:
    if not isinstance(data, dict) or 'estimates' not in data:
        raise InputError('expected a JSON file of attitude_identify, found another')
    if not _typed(data.get('converged'), bool, 'converged'):
        raise InputError('expected a fit that converged, found one that did not')
    verdict = _typed(data.get('verdict'), dict, 'verdict')
    if _typed(verdict.get('level'), str, 'verdict.level') == 'rejected' and not force:
        raise InputError('expected a fit that explains the measurements, found one that is '
                         'rejected (--force takes it)')
    estimates, covariance = _read(data, units)
    ignored = tuple(filter(_NOT_IN_MOTION.fullmatch, estimates))
    varied = {_WEIGHT.sub(rf'weight.{MOMENT}\1', name): value
              for name, value in estimates.items() if name not in ignored}
    _check_estimates(varied, units)
    rows = [name not in ignored for name in estimates]
    covariance = covariance[np.ix_(rows, rows)]
    _check_covariance([*varied], covariance)
    return Fitted(varied, _guess(data), covariance, ignored)


def _read(data: Mapping[str, Any], units: Mapping[str, str]) -> tuple[dict[str, float], Floats]:
    """Return all estimates and their covariance; raise InputError for an incorrect unit."""
    estimates, covariance = (_typed(data.get(key), dict, key) for key in ('estimates',
                                                                          'covariance'))
    names, units_again, rows = (_list(covariance.get(key), len(estimates), f'covariance.{key}')
                                for key in ('names', 'units', 'matrix'))
    if names != [*estimates]:
        raise InputError('covariance.names: expected the names of the estimates in their order, '
                         f'found {quoted(names)}')
    values = {}
    for (name, estimate), unit_again in zip(estimates.items(), units_again):
        unit = _typed(estimate, dict, f'estimates: {name}').get('unit')
        for written, where in ((unit, 'estimates'), (unit_again, 'covariance.units')):
            if written != units.get(name, written):
                raise InputError(f'{name}: expected the unit {quoted(units[name])}, found '
                                 f'{quoted(written)} in {where}')
        values[name] = _typed(estimate.get('value'), float, f'estimates: {name}: value')
    matrix = np.array([_numbers(row, len(rows), f'covariance.matrix[{k}]')
                       for k, row in enumerate(rows)])
    # The intervals of a model that is a little wrong have a systematic part.
    parts = [_typed(one.get('systematic', 0.0), float, f'estimates: {name}: systematic')
             for name, one in estimates.items()]
    with np.errstate(invalid='ignore', divide='ignore'):
        wider = with_bound(1.0, np.nan_to_num(np.array(parts) / np.sqrt(np.diag(matrix)),
                                              posinf=0.0))
    return values, matrix * np.multiply.outer(wider, wider)


def _typed(value: Any, kind: type, where: str) -> Any:
    """
    Return a value that has the type `kind`; raise InputError if it has another type.

    An int is accepted as a float.
    """
    value = float(value) if type(value) is int and kind is float else value
    if not isinstance(value, kind):
        raise InputError(f'{shortened(where, 100)}: expected {_KINDS[kind]}, found '
                         f'{"none" if value is None else quoted(value)}')
    return value


def _list(value: Any, length: int, where: str) -> list[Any]:
    found: list[Any] = _typed(value, list, where)
    if len(found) != length:
        raise InputError(f'{where}: expected a list of length {length}, found {len(found)}')
    return found


def _numbers(value: Any, length: int, where: str) -> list[float]:
    """Return the numbers in a list, with NaN in place of null."""
    return [math.nan if one is None else _typed(one, float, where)
            for one in _list(value, length, where)]


def _guess(data: Mapping[str, Any]) -> Floats:
    key = 'guess_attitude_xyzw'
    quaternion = _numbers(data.get(key), 4, key)
    try:
        return State(attitude=quaternion).attitude
    except ValueError as error:
        raise InputError(f'{key}: {reason(error)}') from error


def _check_estimates(estimates: Mapping[str, float], known: Collection[str]) -> None:
    if not estimates:
        raise InputError('expected estimates of inertia, start, torque or damping, found none')
    for name, value in estimates.items():
        if name not in known:
            close = resembled(name, known)
            raise InputError(f'{name}: expected an estimate that can vary, found another'
                             + (f'; did you mean {close}?' if close else ''))
        if not math.isfinite(value):
            raise InputError(f'{name}: expected a finite value, found {value}')
    if 0 < len({*_ROTATION} & {*estimates}) < 3:
        raise InputError(f'{ATTITUDE}: expected three components, found fewer')


def _check_covariance(names: Sequence[str], covariance: Floats) -> None:
    for name, row, variance in zip(names, covariance, np.diag(covariance).tolist()):
        if np.isnan(row).all():
            raise InputError(f'{name}: expected an estimate that the recording determines, found '
                             'one that it does not')
        if variance < 0.0:
            raise InputError(f'covariance: {name}: expected a variance of at least 0, found '
                             f'{quoted(variance)}')
    if not np.isfinite(covariance).all():
        raise InputError('covariance: expected finite numbers, found others')
    with np.errstate(over='ignore'):
        _, correlation = _scaled(covariance)
    no_spread = covariance[np.diag(covariance) == 0.0]
    largest = math.inf if no_spread.any() else float(np.abs(correlation).max())
    if largest > 1.0 + _ROUNDING:
        raise InputError('covariance: expected a positive semidefinite matrix, found a '
                         f'correlation of {largest:.13g}')
    if np.abs(correlation - correlation.T).max() > _ROUNDING:
        raise InputError('covariance: expected a symmetric matrix, found another')
    least = float(np.linalg.eigvalsh(correlation)[0])
    if least < -_ROUNDING:
        raise InputError('covariance: expected a positive semidefinite matrix, found correlations '
                         f'with the eigenvalue {least:.3g}')


def _scaled(covariance: Floats) -> tuple[Floats, Floats]:
    """
    Split a covariance matrix into standard deviations and a correlation matrix.

    Standard deviations that are 0 are returned as 1.
    """
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0.0, sigma, 1.0)
    return scale, covariance / np.multiply.outer(scale, scale)
