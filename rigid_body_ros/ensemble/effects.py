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

"""Measure how much each dispersed parameter contributes to the variation of the final states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.requirements import final
from rigid_body_ros.ensemble.runs import ANGLE, Ensemble
from rigid_body_ros.mechanics import so3

#: The effects are computed from at most this many runs, beginning with the first run.
_SAMPLE = 100_000
#: A term of the quadratic is ignored as a rounding error if its mean square is below this fraction
#: of the square of the largest deviation.
_ROUNDING = 1e-20


def correlations(ensemble: Ensemble, folder: Folder) -> dict[str, float]:
    """
    Return the rank correlation between the deviation of each parameter and the final angle.

    The final angle is the angle between the final attitude and the nominal final attitude. This
    angle is correlated with the absolute deviation of the parameter from its nominal value.
    """
    from scipy.stats import spearmanr  # slow to import
    angles = folder.numbers(ANGLE, _SAMPLE)
    return {name: float(spearmanr(np.abs(deviation[known]), angles[known])[0])
            for name, deviation in _deviations(ensemble, folder)
            if _vary(known := _known(angles, deviation), np.abs(deviation), angles)}


def effects(ensemble: Ensemble, folder: Folder, quantity: str) -> dict[str, float]:
    """
    Return the fraction of the variance of a quantity that each parameter explains.

    The fraction is the adjusted R^2 of a quadratic in the parameter, fitted to the ranks of the
    quantity. The fraction shows effects that change sign with the deviation, such as the effect of
    a gain on a final rate. The fraction also shows effects that depend only on the size of the
    deviation, such as the effect of an initial rate that varies about zero. A rank correlation
    with the deviation would miss effects of this second kind.
    """
    numbers = final(folder, quantity, _SAMPLE)
    return {name: _explained(deviation[known], numbers[known])
            for name, deviation in _deviations(ensemble, folder)
            if _vary(known := _known(numbers, deviation), deviation, numbers)}


def _known(numbers: Floats, deviation: Floats) -> NDArray[np.bool_]:
    return np.isfinite(numbers) & np.isfinite(deviation)


def _vary(known: NDArray[np.bool_], *columns: Floats) -> bool:
    return int(known.sum()) > 3 and all(np.ptp(column[known]) > 0.0 for column in columns)


def _explained(deviation: Floats, numbers: Floats) -> float:
    from scipy.stats import rankdata  # slow to import
    ranks = rankdata(numbers) - 0.5 * (1.0 + len(numbers))
    linear = deviation - deviation.mean()
    linear /= np.abs(linear).max()
    square = linear ** 2 - (linear ** 2).mean()
    square -= linear * ((square * linear).sum() / (linear ** 2).sum())
    found = sum(float((one * ranks).sum() ** 2 / ((one ** 2).sum() * (ranks ** 2).sum()))
                for one in (linear, square) if (one ** 2).sum() > _ROUNDING * len(ranks))
    return max(1.0 - (1.0 - found) * (len(ranks) - 1) / (len(ranks) - 3), 0.0)


def _deviations(ensemble: Ensemble, folder: Folder) -> Iterator[tuple[str, Floats]]:
    """
    Generate the name of each parameter, with its deviations from the nominal value.

    The deviations are an array with one number for each run.
    """
    nominal = ensemble.nominal
    attitude = [f'initial_attitude.{axis}' for axis in 'xyzw']
    tilted = np.stack([folder.numbers(name, _SAMPLE) for name in attitude], axis=-1)
    with np.errstate(invalid='ignore'):  # the values of failed runs are NaN
        yield 'initial_attitude', np.asarray(
            so3.angle_between(tilted, [nominal[name] for name in attitude]))
    for name in ensemble.columns:
        if name in nominal and name not in attitude:
            yield name, folder.numbers(name, _SAMPLE) - nominal[name]
