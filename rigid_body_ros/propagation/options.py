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

"""What the time loop is set to, checked."""

from __future__ import annotations

from collections.abc import Hashable

from rigid_body_ros.body import RigidBody
from rigid_body_ros.common.arrays import Floats

SOLVERS = ('auto', 'taylor', 'exact', 'rk4', 'strang', 'explicit_euler')
AUTO, TAYLOR, EXACT, RK4, STRANG, EXPLICIT_EULER = range(len(SOLVERS))
#: Those that take steps of a given length.
FIXED_STEP = SOLVERS[RK4:]
TOLERANCES = (1e-15, 1.0)
#: rad/s; the series converges in a step of a nanosecond up to here.
FASTEST = 1e9
#: Seconds that fit int64 nanoseconds at any epoch.
LONGEST = 1e9
#: A body at rest has no natural step.
_LONGEST_NS = 10 ** 18


class Options:
    """The options of `propagate` and `Propagator`, checked, in the units of the kernels."""

    def __init__(self, solver: str, tolerance: float, max_step: float | None,
                 torque_timeout: float) -> None:
        if solver not in SOLVERS:
            raise ValueError(f'solver: expected one of {", ".join(SOLVERS)}, found {solver!r}')
        if not TOLERANCES[0] <= tolerance <= TOLERANCES[1]:
            raise ValueError('tolerance: expected a truncation error per radian turned from '
                             f'{TOLERANCES[0]:g} to {TOLERANCES[1]:g}, found {tolerance}')
        if max_step is not None and not max_step > 0.0:
            raise ValueError(f'max_step: expected seconds greater than zero, found {max_step}')
        if max_step is None and solver in FIXED_STEP:
            raise ValueError(f'max_step: solver {solver!r} takes steps of this length, expected '
                             'seconds greater than zero, found none')
        self.solver = solver
        self.code = SOLVERS.index(solver)
        self.tolerance = float(tolerance)
        longest = _LONGEST_NS if max_step is None else min(max_step * 1e9, _LONGEST_NS)
        self.max_step_ns = max(1, round(longest))
        self.timeout_ns = duration_ns(torque_timeout, 'torque_timeout')

    def kernel_arguments(self, body: RigidBody) -> tuple[Floats, int, float, int]:
        """Return what every kernel needs to know."""
        return body._constants, self.code, self.tolerance, self.max_step_ns

    def rule(self, body: RigidBody, torque: Floats, in_space: bool) -> Hashable:
        """Return what the motion under a held torque depends on, besides its start."""
        return (body._constants.tobytes(), self.solver, self.tolerance, self.max_step_ns,
                tuple(torque.ravel().tolist()), in_space and bool(torque.any()))

    def too_fast(self, time_ns: int) -> ValueError:
        """Return what to raise where a nanosecond, the shortest step, is too long."""
        cause = f'steps of {self.max_step_ns * 1e-9:g} s may be too long for {self.solver}' \
            if self.solver in FIXED_STEP else \
            'expected a torque and an inertia in N m and kg m^2 that do not lead there'
        return ValueError(f'at {time_ns} ns the body turns faster than {FASTEST:g} rad/s: {cause}')


def duration_ns(seconds: float, name: str) -> int:
    """Return a duration as integer nanoseconds, or raise ValueError with its name."""
    if not 0.0 <= seconds <= LONGEST:
        raise ValueError(f'{name}: expected seconds from 0 to {LONGEST:g}, found {seconds}')
    return round(seconds * 1e9)
