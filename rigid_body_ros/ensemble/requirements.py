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

"""Judge requirements on the final states: how many runs meet them, and which runs are worst."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
import operator
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.histogram import histogram
from rigid_body_ros.ensemble.percentiles import percentiles
from rigid_body_ros.ensemble.runs import ANGLE
from rigid_body_ros.mechanics import so3

#: The quantities that a requirement can limit, and their units.
UNITS = {'rate': 'rad/s', 'angle': 'rad', ANGLE: 'rad'}
#: The percentiles that are reported for the quantity of a requirement.
PERCENTILES = (1, 5, 25, 50, 75, 95, 99, 100)
#: How many of the worst runs are reported.
_WORST = 5
_RELATIONS: dict[str, Callable[[Floats, float], NDArray[np.bool_]]] = {
    '<': operator.lt, '<=': operator.le, '>': operator.gt, '>=': operator.ge}
_EXPRESSION = re.compile(r'\s*(\w+)\s*(<=|>=|<|>)\s*(\S+)\s*')
#: The probability of each tail of a confidence interval.
_TAIL = 0.025


@dataclass(frozen=True)
class Requirement:
    """
    A limit on a quantity at the end of a run.

    Attributes
    ----------
    quantity : str
        What is limited. 'rate' is the angular speed of the body, rad/s. 'angle' is the angle
        between the space axes and the body axes, rad. 'angle_from_nominal' is the angle between
        the body axes in this run and in the nominal run, rad.
    relation : str
        '<', '<=', '>' or '>='.
    limit : float

    """

    quantity: str
    relation: str
    limit: float

    @classmethod
    def read(cls, text: str) -> Requirement:
        """Parse a requirement such as 'rate < 0.05'; raise InputError if the text is invalid."""
        found = _EXPRESSION.fullmatch(text)
        try:
            limit = float(found[3]) if found else math.nan
        except ValueError:
            limit = math.nan
        if not found or found[1] not in UNITS or not math.isfinite(limit):
            raise InputError(f'expected one of {", ".join(UNITS)}, then <, <=, > or >=, and a '
                             f"number, such as 'rate < 0.05', found {quoted(text)}")
        return cls(found[1], found[2], limit)

    def __str__(self) -> str:
        return f'{self.quantity} {self.relation} {self.limit:.12g}'

    def judged(self, folder: Folder) -> dict[str, Any]:
        """
        Judge how well the runs of a complete folder meet the requirement.

        Returns
        -------
        dict
            The result as JSON types. 'met' is the number of runs that meet the requirement; failed
            runs never meet it. 'share' is 'met' divided by the number of all runs, and
            'interval_95' is the 95 % confidence interval of 'share'. 'percentiles' and 'histogram'
            describe the quantity, and are empty if all runs failed. 'worst' lists the worst runs.

        """
        numbers = final(folder, self.quantity)
        with np.errstate(invalid='ignore'):  # the values of failed runs are NaN
            met = int(_RELATIONS[self.relation](numbers, self.limit).sum())
        found: dict[str, Any] = {
            'require': str(self), 'unit': UNITS[self.quantity], 'met': met,
            'share': met / folder.runs, 'interval_95': interval(met, folder.runs),
            'percentiles': {}, 'histogram': {}, 'worst': self._worst(numbers)}
        numbers = numbers[np.isfinite(numbers)]
        if numbers.size:
            names = [f'p{k}' for k in PERCENTILES]
            found['percentiles'] = dict(zip(names, percentiles(numbers, PERCENTILES).tolist()))
            bars = histogram(numbers, found['percentiles'])
            found['histogram'] = {'edges': bars['edges_rad'], 'runs': bars['runs']}
        return found

    def _worst(self, numbers: Floats) -> list[dict[str, Any]]:
        """
        Return the worst runs, beginning with the worst run.

        Runs with equal numbers are in the order of their run numbers.
        """
        order = np.argsort(-numbers if self.relation in ('<', '<=') else numbers, kind='stable')
        return [{'run': run, 'value': float(numbers[run])} for run in order[:_WORST].tolist()
                if math.isfinite(numbers[run])]


def final(folder: Folder, quantity: str, stop: int | None = None) -> Floats:
    """
    Return the final value of a quantity in each run before `stop`.

    The values of failed runs are NaN.
    """
    def columns(name: str, axes: str) -> Floats:
        return np.stack([folder.numbers(f'{name}.{axis}', stop or folder.runs)
                         for axis in axes], axis=-1)
    if quantity == ANGLE:
        return folder.numbers(ANGLE, stop or folder.runs)
    if quantity == 'rate':
        return np.asarray(np.sqrt((columns('angular_velocity', 'xyz') ** 2).sum(axis=-1)))
    with np.errstate(invalid='ignore'):
        return np.asarray(so3.angle_between(columns('attitude', 'xyzw'), [0.0, 0.0, 0.0, 1.0]))


def interval(met: int, runs: int) -> list[float]:
    """Return the Clopper-Pearson 95 % confidence interval for a probability."""
    from scipy.special import betaincinv  # slow to import
    return [float(betaincinv(met, runs - met + 1, _TAIL)) if met else 0.0,
            float(betaincinv(met + 1, runs - met, 1.0 - _TAIL)) if met < runs else 1.0]
