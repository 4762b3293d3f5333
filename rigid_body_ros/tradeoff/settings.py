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

"""The settings of the solvers, and which of them to measure."""

from __future__ import annotations

from typing import Any, NamedTuple

from rigid_body_ros.propagation import Options, Trajectory
from rigid_body_ros.propagation.solvers import RECORDS
from rigid_body_ros.tradeoff.problem import Case, TIGHTEST

_TOLERANCES = tuple(float(f'1e-{k}') for k in range(2, 16))
#: Angle through which the body turns in the longest fixed step, rad, and maximum number of steps
#: in a run. A run with that many steps takes about 0.1 s.
_LONGEST_ANGLE, _MOST_STEPS = 1.0, 1_000_000


class Setting(NamedTuple):
    """A solver, together with its tolerance or step."""

    solver: str
    tolerance: float | None = None
    #: Length of a step, s.
    max_step: float | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Return the setting as keyword arguments of `propagate`."""
        return {name: value for name, value in self._asdict().items() if value is not None}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the lines of a scene file that select this setting."""
        if self.max_step is not None:
            return f'solver: {self.solver}', f'max_step: {self.max_step!r}'
        return (f'solver: {self.solver}', f'tolerance: {self.tolerance or TIGHTEST!r}',
                'max_step: 0.0')


#: The setting that applies if a scene specifies neither a solver nor a tolerance.
DEFAULT = Setting(Options.solver, Options.tolerance)


def settings_of(case: Case, motion: Trajectory) -> list[Setting]:
    """Return all settings to measure for a case and its motion, from coarse to fine."""
    settings = [Setting(solver.name) for solver in RECORDS
                if case.conserves and not solver.takes_torque]
    settings += [Setting(solver.name, tolerance) for solver in RECORDS
                 if solver.takes_torque and not solver.fixed_step for tolerance in _TOLERANCES]
    longest = case.natural_step(motion, _LONGEST_ANGLE)
    for solver in [solver.name for solver in RECORDS if solver.fixed_step
                   and (solver.takes_linear_terms or not case.has_linear_terms)]:
        step = longest
        while step >= 1e-9 and case.seconds / step <= _MOST_STEPS:
            settings.append(Setting(solver, max_step=round(step * 1e9) / 1e9))
            step /= 2.0
    return settings
