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

"""Find out which parameters the data does not determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels
from rigid_body_ros.inference.parameters import field_of, LONGEST_DELAY
from rigid_body_ros.scene.fields import MOMENT

#: Derivatives whose relative size is below these limits are rounding errors. `_ZERO` is the limit
#: for derivatives with respect to a single parameter, and `_ROUNDING` is the limit for derivatives
#: with respect to a combination of parameters.
_ZERO, _ROUNDING = 1e-9, 1e-6
#: The data does not determine a combination of parameters if the standard deviation along this
#: combination, relative to the scales of the parameters, exceeds this number.
_WIDEST = 0.5
#: Limits for the components of a `Direction`. A component above `_COUNTS` matters, a component
#: above `_LISTED` is listed in the result, and a component below `_EXACT` is a rounding error, as
#: is the distance of a parameter from its bound, as a fraction of the bound.
_COUNTS, _LISTED, _EXACT = 0.3, 0.05, 1e-3
#: Relative changes of the moments of inertia count as equal if they differ by less than this
#: fraction.
_SAME = 0.1


@dataclass(frozen=True)
class Direction:
    """
    A combination of parameters that the data does not determine.

    Attributes
    ----------
    components : dict of str to float
        How much each parameter changes along this combination, relative to its scale.
    reason : str
        Why the data does not determine this combination.

    """

    components: dict[str, float]
    reason: str


def certainty(factor: Floats, names: Sequence[str], values: Floats
              ) -> tuple[Floats, NDArray[np.bool_], list[Direction]]:
    """
    Compute from the information matrix how well the data determines the parameters.

    Parameters
    ----------
    factor : array, shape (m, n)
        A matrix F such that F^T F is the information matrix of the parameters divided by their
        scales.
    names : sequence of str, length n
        The names of the parameters.
    values : array, shape (n,)
        The parameters, divided by their scales. The data does not determine a parameter that is at
        its bound, and the other parameters are judged as if it were known.

    Returns
    -------
    covariance : array, shape (n, n)
        Covariance of the parameters after each has been divided by its scale.
    identifiable : array of bool, shape (n,)
        Whether the data determines each parameter.
    directions : list of Direction
        The combinations of parameters that the data does not determine.

    """
    null, rest = _split(np.where(_at_bound(names, values), 0.0, factor))
    _, singular, rows = np.linalg.svd(factor @ rest, full_matrices=False)
    vectors = rest @ rows.T
    covariance = (vectors / singular ** 2) @ vectors.T
    weak = vectors[:, singular * _WIDEST < 1.0]
    identifiable = np.sqrt(np.diag(covariance)) <= _WIDEST
    identifiable &= (np.abs(null) <= _EXACT).all(axis=1) & (np.abs(weak) <= _COUNTS).all(axis=1)
    for vector in (*null.T, *weak.T):
        identifiable[np.argmax(np.abs(vector))] = False
    directions = [_direction(names, values, vector) for vector in (*null.T, *weak.T)]
    if any(direction.reason == _RATIOS for direction in directions):
        identifiable &= ~_chosen(names, 'inertia')
    return covariance, identifiable, directions


def _at_bound(names: Sequence[str], values: Floats) -> NDArray[np.bool_]:
    """Return which parameters are at a bound. Only the torque delay has bounds."""
    return np.array([name == 'torque_delay' for name in names], bool) & (
        np.abs(values) >= (1.0 - _EXACT) * LONGEST_DELAY)


def _split(factor: Floats) -> tuple[Floats, Floats]:
    """
    Split the space of the parameters into directions without and with an effect.

    Return two matrices, one for each subspace. The columns are an orthonormal basis of the
    subspace.
    """
    norms = np.linalg.norm(factor, axis=0)
    zero = norms <= _ZERO * norms.max(initial=1e-300)
    norms = np.where(zero, 1.0, norms)
    _, singular, rows = np.linalg.svd(np.where(zero, 0.0, factor / norms))
    singular = np.append(singular, np.zeros(len(norms) - len(singular)))
    vectors = (rows[singular < _ROUNDING] / norms).T
    basis = np.linalg.qr(vectors, mode='complete')[0]
    count = vectors.shape[1]
    return basis[:, :count], basis[:, count:]


_RATIOS = ('neither a torque nor a rotor acts, so only the ratios of the moments of inertia enter '
           'the motion')


def _direction(names: Sequence[str], values: Floats, vector: Floats) -> Direction:
    vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
    components = {name: round(float(part), 4) for name, part in zip(names, vector)
                  if abs(part) >= _LISTED}
    return Direction(components, _reason(names, values, vector))


def _reason(names: Sequence[str], values: Floats, vector: Floats) -> str:
    inertia = _chosen(names, 'inertia')
    ratios = vector[inertia][:3] / values[inertia][:3]  # relative changes of the moments
    if vector[_at_bound(names, values)].any():
        return f'at its bound of {LONGEST_DELAY:g} s: the errors are smallest at or ' \
               'beyond it; check the stamps of the torques'
    scales_inertia = ratios.size > 0 and np.ptp(ratios) < _SAME * np.abs(ratios).max()
    parts, wider = ({MOMENT if field_of(name[:-2]) else name.split('.')[0]
                     for name, part in zip(names, vector) if abs(part) >= least}
                    for least in (_COUNTS, _LISTED))
    if scales_inertia and wider & {'torque_gain', 'torque_bias', 'damping',
                                   'initial_rotor_momentum', MOMENT}:
        return 'only the ratio of torque to inertia enters the motion'
    if scales_inertia and wider == {'inertia'}:
        return _RATIOS
    if parts == {'inertia'}:
        return ('the motion excites these moments too little: turn the body about all three axes, '
                'at changing rates')
    if 'gyro_bias' in parts:
        return 'a bias of the gyro cannot be told from a slow rotation'
    if 'mount' in parts and 'initial_attitude' in parts:
        return 'a rotation of the sensor cannot be told from one of the body'
    if 'clock_offset' in parts:
        return 'the motion changes too little for a shift in time to show'
    if 'torque_gain' in parts:
        return 'the torque is too small to show'
    return 'these parameters change the prediction too little, or in the same way'


def _chosen(names: Sequence[str], prefix: str) -> NDArray[np.bool_]:
    return np.array([name.split('.')[0] == prefix for name in names], bool)


def triangle(columns: Floats) -> Floats:
    """
    Return the triangular factor of the QR decomposition of a matrix.

    Parameters
    ----------
    columns : array, shape (n, m)
        The transpose of the matrix. This array is overwritten.

    Returns
    -------
    array, shape (n, n)
        An upper triangular matrix. Some rows are zero if m is less than n.

    """
    result = np.zeros((len(columns), len(columns)))
    kernels.fill_triangle(columns, result)
    return result
