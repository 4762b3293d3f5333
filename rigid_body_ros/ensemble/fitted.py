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
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, located, quoted
from rigid_body_ros.ensemble import dispersions
from rigid_body_ros.ensemble.applied import components
from rigid_body_ros.ensemble.dispersions import ATTITUDE, Dispersion, normals, units_with
from rigid_body_ros.inference.noise import with_bound
from rigid_body_ros.mechanics import so3
from rigid_body_ros.runtime.parameters import resembled
from rigid_body_ros.scene.quantities import components_of, MOMENT, OF_SENSORS, split_topic

if TYPE_CHECKING:
    from rigid_body_ros.identification.result import Saved

#: The keys of the rotation vector that describes the initial attitude.
_ROTATION = tuple(f'{ATTITUDE}.{axis}' for axis in 'xyz')
#: Estimates that do not affect the motion: those of sensors, and the starts of further recordings.
_OF_SENSORS = {component for name in OF_SENSORS for component in components_of(name)}
_OF_LATER_START = re.compile(r'.*\[\d+\]')
#: The keys of an estimated weight, which the fitted scene describes as a field.
_WEIGHT = re.compile(r'^weight(\.[xyz])$')
#: Eigenvalues and pivots of a correlation matrix below this limit are taken to be rounding errors.
_ROUNDING = 1e-12
#: The scale of an estimate that has no spread.
_TINY = 1e-150


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

    def draw(self, seed: int, runs: NDArray[np.int64]) -> dict[str, Floats]:
        """Return values drawn for some runs, shape (n,), for each of the keys of `nominal`."""
        numbers = normals(seed, runs, 'fitted', len(self.mean))
        changes = np.zeros_like(numbers)
        # Add the terms one by one, because the order in which BLAS would add the terms depends on
        # the processor.
        for number, column in zip(numbers.T, self.factor.T):
            changes += np.multiply.outer(number, column)
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
    from rigid_body_ros.identification import Identification  # slow to import
    saved = Identification.load(path)
    with located(path, InputError):
        return _fitted(saved, {**units_with(fields), **dict.fromkeys(_ROTATION, 'rad')}, force)


def load_varied(path: str | Path, fields: Iterable[str] = (), force: bool = False
                ) -> tuple[tuple[Dispersion, ...], Fitted | None]:
    """Read estimates from a JSON file, as `load` does, or dispersions from a YAML file."""
    if Path(path).suffix == '.json':
        return (), load(path, fields, force)
    return dispersions.load(path, fields), None


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
