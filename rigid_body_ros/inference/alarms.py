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
Raise alarms in a live check, by testing the errors of windows at a given false-alarm rate.

One test looks at each single window. Three more tests look at the residual torques of 4, 16 and 64
windows together, to find errors that are too small to show in a single window. The false-alarm
rate is divided equally among the four tests.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import as_json, Floats
from rigid_body_ros.inference.window_error import WindowError

OK, WARN, ERROR = range(3)
#: Numbers of windows that are tested together.
_TOGETHER = 1, 4, 16, 64
#: A test raises an alarm if the probability of its result is below a limit. The test warns if this
#: probability is below `_WARNING` times the limit.
_WARNING = 10.0


class Judgement(NamedTuple):
    """
    How the model was judged in one window.

    Attributes
    ----------
    error : WindowError
        The error of the model in the window.
    level : int
        OK, WARN or ERROR. ERROR is an alarm. For a correct model, WARN is about ten times as
        frequent as ERROR.
    sigma : float
        The significance of the most significant of the latest tests: the probability of its
        result, converted to a number of standard deviations of a normal distribution.
    windows : int
        Number of windows in the most significant test.
    axis : str
        The component of the error that deviates most, followed by the deviation of this component
        as a number of standard deviations.
    since_ns : int
        End of the first window at the present level.

    """

    error: WindowError
    level: int
    sigma: float
    windows: int
    axis: str
    since_ns: int

    def as_dict(self) -> dict[str, Any]:
        """Return the judgement as JSON types, with units in the names."""
        error = self.error
        return {'end_ns': error.end_ns, 'level': ('OK', 'WARN', 'ERROR')[self.level],
                'sigma': self.sigma, 'windows': self.windows, 'axis': self.axis,
                'attitude_error_rad': as_json(error.attitude),
                'rate_error_rad_s': as_json(error.rate),
                'residual_torque_N_m': as_json(error.torque), 'outliers': error.outliers}


class Alarms:
    """
    Judge one window after another.

    Parameters
    ----------
    window_s : float, s
        Length of a window.
    hours : float, h
        Average time between false alarms if the model is correct.

    """

    def __init__(self, window_s: float, hours: float) -> None:
        #: Probability below which the test of a single window raises an alarm.
        self._usual = window_s / (3600.0 * hours * len(_TOGETHER))
        #: For each number of windows tested together, the weights and the weighted residual
        #: torques of the windows of the group that is not complete yet.
        self._groups: dict[int, list[tuple[Any, Any]]] = {
            count: [] for count in _TOGETHER[1:]}
        #: For each number of windows tested together, the probability of the latest test result,
        #: divided by the probability below which the test raises an alarm.
        self._ratios = dict.fromkeys(_TOGETHER, np.inf)
        self._level, self._since_ns = OK, 0
        # Import now, so that the import does not delay the judgement of the first window.
        from scipy.special import chdtrc, ndtri
        self._tail, self._quantile = chdtrc, ndtri

    def judged(self, error: WindowError) -> Judgement:
        """Judge the next window."""
        first = 3 if np.isnan(error.attitude[0]) else 0
        change = np.concatenate([error.attitude, error.rate])[first:]
        covariance = error.covariance[first:, first:]
        square = change @ np.linalg.solve(covariance, change)
        self._ratios[1] = self._tail(len(change), square) / self._usual
        weight = np.linalg.inv(error.torque_covariance)
        for count, group in self._groups.items():
            group.append((weight, weight @ error.torque))
            if len(group) == count:
                total, product = (np.sum(each, axis=0) for each in zip(*group))
                found = product @ np.linalg.solve(total, product)
                self._ratios[count] = self._tail(3, found) / (count * self._usual)
                group.clear()
        windows = min(self._ratios, key=self._ratios.__getitem__)
        ratio = self._ratios[windows]
        level = ERROR if ratio < 1.0 else WARN if ratio < _WARNING else OK
        if level != self._level or not self._since_ns:
            self._level, self._since_ns = level, error.end_ns
        probability = min(ratio * windows * self._usual, 1.0)
        return Judgement(error, level, float(-self._quantile(0.5 * probability)), windows,
                         _axis(change, covariance), self._since_ns)


def _axis(change: Floats, covariance: Floats) -> str:
    """Return text that names the component that deviates most, with its deviation."""
    deviations = np.abs(change) / np.sqrt(np.diag(covariance))
    names = [f'{what} about {axis}' for what in ('attitude', 'rate') for axis in 'xyz']
    row = int(np.argmax(deviations))
    return f'{names[len(names) - len(change) + row]} ({deviations[row]:.1f} sigma)'
