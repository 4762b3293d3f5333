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

"""Read the requirements on the runs of an ensemble, and judge single runs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
import math
import operator
import re

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, quoted
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem, Trajectory

ANGLE = 'angle_from_nominal'
#: The units in which a quantity can be limited, and their sizes in rad or rad/s. The first unit of
#: each quantity is the default.
_ANGLES, _RATES = {'rad': 1.0, 'deg': math.pi / 180.0}, {'rad/s': 1.0, 'deg/s': math.pi / 180.0}
_UNITS = {'rate': _RATES, 'angle': _ANGLES, ANGLE: _ANGLES}
_RELATIONS = {'<': operator.lt, '<=': operator.le, '>': operator.gt, '>=': operator.ge}
_EXPRESSION = re.compile(r'\s*(\w+)\s*(<=|>=|<|>)\s*(\S+?)(?:\s*([a-z]+(?:/s)?))?'
                         r'(?:\s+after\s+(\S+?)\s*s)?\s*')


@dataclass(frozen=True)
class Requirement:
    """
    A limit on a quantity at the end of a run, or from some time on.

    Attributes
    ----------
    quantity : str
        What is limited. 'rate' is the angular speed of the body. 'angle' is the angle between the
        space axes and the body axes. 'angle_from_nominal' is the angle between the body axes in
        this run and in the nominal run.
    relation : str
        '<', '<=', '>' or '>='.
    limit : float
    unit : str
        The unit of the limit: 'rad', 'deg', 'rad/s' or 'deg/s'.
    after : float, optional, s
        The time since the start from which on the limit holds at every instant. By default, it
        holds at the end only.

    """

    quantity: str
    relation: str
    limit: float
    unit: str
    after: float | None = None

    @classmethod
    def read(cls, text: str) -> Requirement:
        """Parse a requirement such as 'rate < 0.05'; raise InputError if the text is invalid."""
        match = _EXPRESSION.fullmatch(text)
        with suppress(ValueError):
            if match and match[1] in _UNITS:
                units = _UNITS[match[1]]
                unit = match[4] or next(iter(units))
                after = float(match[5]) if match[5] else None
                if unit in units and math.isfinite(limit := float(match[3])) \
                        and 0.0 <= (after or 0.0) < math.inf:
                    return cls(match[1], match[2], limit, unit, after)
        raise InputError(f'expected one of {", ".join(_UNITS)}, then <, <=, > or >=, a number, '
                         "and possibly a unit (rad, deg, rad/s, deg/s) and 'after T s', such as "
                         f"'rate < 0.05' or 'angle < 1 deg after 60 s', found {quoted(text)}")

    def __str__(self) -> str:
        return f'{self.quantity} {self.relation} {self.limit:.12g}'

    @property
    def columns(self) -> dict[str, str]:
        """Return the names and units of the columns with the results of `measured`."""
        text = f'{self} {self.unit} after {self.after:.12g} s'
        return {f'settling_time: {text}': 's', f'overshoot: {text}': self.unit}

    @property
    def size(self) -> float:
        """Return the unit of the limit in rad or rad/s."""
        return _UNITS[self.quantity][self.unit]

    def is_met(self, values: Floats, limit: float) -> NDArray[np.bool_]:
        """Return whether values are on the right side of a limit."""
        return np.asarray(_RELATIONS[self.relation](values, limit))

    def measured(self, problem: Problem, end_ns: int, nominal: Problem) -> tuple[float, float]:
        """
        Return when a run settles, and by how much it exceeds the limit from `after` on.

        Parameters
        ----------
        problem, nominal : Problem
            The run and the nominal run.
        end_ns : int, ns
            The end of the run.

        Returns
        -------
        settling_time : float, s
            When the requirement is violated for the last time, since the start. Zero if it never
            is, and NaN if it still is at the end.
        overshoot : float
            The largest excess over the limit, in the unit of the limit. Negative if there is none.

        """
        sign = 1.0 if self.relation[0] == '<' else -1.0

        def excess(motion: Trajectory) -> Floats:
            if self.quantity == 'rate':
                values = np.linalg.norm(motion.angular_velocity, axis=1)
            else:
                values = so3.angle_between(motion.attitude, [0.0, 0.0, 0.0, 1.0] if (
                    self.quantity == 'angle') else nominal.propagate(at=motion.times_ns).attitude)
            return np.asarray(sign * (values / self.size - self.limit))

        start_ns, motion = problem.start.time_ns, problem.propagate(at=[end_ns])
        overshoot = motion.maximum(excess, start_ns + duration_ns(self.after or 0.0, 'after'))
        crossed = motion.crossings(excess)
        last = np.flatnonzero(crossed.directions)[-1:]
        settled_ns = float((crossed.times_ns[last] - start_ns + crossed.fractions[last]).sum())
        is_met = self.is_met(sign * excess(motion), 0.0)[0]
        return settled_ns / 1e9 if is_met else math.nan, overshoot
