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

"""The options of the time loop, and their validation."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property, lru_cache
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, instants, LONGEST, NEVER_NS
from rigid_body_ros.engine import FASTEST as FASTEST
from rigid_body_ros.engine import kernels, layout
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.torque import TorqueLog

TOLERANCES = (1e-15, 1.0)

#: `auto` uses the closed form if the body turns by more than this angle, rad, in a coast. Up to
#: this angle, the Taylor series is as accurate as the closed form, and faster.
LONG_COAST = 16.0


class Solver(NamedTuple):
    """What the loop, the options and the documentation need to know about a solver."""

    name: str
    #: The number that identifies the solver in the kernels.
    code: int
    #: Order of convergence of a solver with fixed steps. None if a tolerance bounds the truncation
    #: error instead.
    order: int | None = None
    #: Whether every step is `max_step` long.
    fixed_step: bool = False
    takes_torque: bool = True
    #: Whether the solver handles rotors and damping, whose terms are linear in the angular
    #: velocity.
    takes_linear_terms: bool = True
    #: A coast in which the body turns by more than this angle, rad, is computed in closed form. If
    #: the angle is negative, every coast is computed in closed form.
    closed_form_beyond: float = math.inf


AUTO = Solver('auto', layout.AUTO, closed_form_beyond=LONG_COAST)
TAYLOR = Solver('taylor', layout.TAYLOR)
EXACT = Solver('exact', layout.EXACT, takes_torque=False, takes_linear_terms=False,
               closed_form_beyond=-1.0)
RK4 = Solver('rk4', layout.RK4, order=4, fixed_step=True)
STRANG = Solver('strang', layout.STRANG, order=2, fixed_step=True, takes_linear_terms=False)
EXPLICIT_EULER = Solver('explicit_euler', layout.EXPLICIT_EULER, order=1, fixed_step=True)
RECORDS = (AUTO, TAYLOR, EXACT, RK4, STRANG, EXPLICIT_EULER)
#: The names of the solvers.
SOLVERS = tuple(solver.name for solver in RECORDS)


def solver_named(name: str) -> Solver:
    """Return the record of a solver, or raise ValueError."""
    if name not in SOLVERS:
        raise ValueError(f'solver: expected one of {", ".join(SOLVERS)}, found {name!r}')
    return RECORDS[SOLVERS.index(name)]


@dataclass(frozen=True)
class Options:
    """
    The options of `propagate`, `Propagator` and `Integration`.

    Parameters
    ----------
    solver : str
        'auto', 'taylor', 'exact' (torque-free motion only), 'rk4', 'strang' or 'explicit_euler'.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned, 1e-15 to 1.
    max_step : float, optional, s
        Upper limit on the length of a step. Solvers with fixed steps require `max_step`, which is
        then the length of their steps.
    torque_timeout : float, s
        If positive, a sample acts for at most this long. After this time, the torque is zero until
        the next sample.

    Raises
    ------
    ValueError
        An option is out of its range, or `max_step` is missing.

    """

    solver: str = AUTO.name
    tolerance: float = TOLERANCES[0]
    max_step: float | None = None
    torque_timeout: float = 0.0

    def __post_init__(self) -> None:
        record, tolerance, max_step = self.record, self.tolerance, self.max_step
        if not TOLERANCES[0] <= tolerance <= TOLERANCES[1]:
            raise ValueError('tolerance: expected a truncation error per radian turned from '
                             f'{TOLERANCES[0]:g} to {TOLERANCES[1]:g}, found {tolerance}')
        if max_step is not None and not max_step > 0.0:
            raise ValueError(f'max_step: expected seconds greater than zero, found {max_step}')
        if max_step is None and record.fixed_step:
            raise ValueError(f'max_step: solver {record.name!r} requires a step length, expected '
                             'seconds greater than zero, found none')
        duration_ns(self.torque_timeout, 'torque_timeout')

    @cached_property
    def record(self) -> Solver:
        """Return the `Solver` record of the solver that `solver` names."""
        return solver_named(self.solver)

    @cached_property
    def max_step_ns(self) -> int:
        """Return the longest step, ns, at least 1. A body at rest takes steps of this length."""
        longest = LONGEST if self.max_step is None else min(self.max_step, LONGEST)
        return max(1, duration_ns(longest, 'max_step'))

    @cached_property
    def timeout_ns(self) -> int:
        """Return the torque timeout, ns, or 0 if torques never time out."""
        return duration_ns(self.torque_timeout, 'torque_timeout')

    @cached_property
    def method(self) -> NDArray[Any]:
        """Return the solver and its step limits for the kernels, as a METHOD of shape (1,)."""
        record = self.record
        return np.array([(record.code, record.fixed_step, record.closed_form_beyond,
                          self.tolerance, kernels.step_angle(self.tolerance), self.max_step_ns)],
                        layout.METHOD)

    def check_terms(self, damping: bool, rotors: bool, fields: bool = False,
                    coupled: bool = False) -> None:
        """Raise ValueError if the scene has terms that the solver does not handle."""
        if fields and not self.record.takes_torque:
            raise ValueError(f'solver {self.solver!r} handles torque-free motion only, found '
                             'fields')
        if (damping or rotors) and not self.record.takes_linear_terms:
            raise ValueError(f'solver {self.solver!r} handles neither rotors nor damping, found '
                             + ('damping' if damping else 'rotors'))
        if coupled and self.record.fixed_step:
            raise ValueError(f'solver {self.solver!r} handles neither friction nor max_speed of '
                             'wheels, which auto and taylor do')

    def check_torque_free(self, log: TorqueLog) -> None:
        """Raise ValueError if a log contains a torque that is not zero."""
        if log.torques.any():
            row = int(np.flatnonzero(log.torques.any(axis=1))[0])
            raise ValueError(f'solver {self.solver!r} handles torque-free motion only, found a '
                             f'torque of {log.torques[row].tolist()} N m at '
                             f'{log.times_ns[row]} ns (sample {row})')

    def rule(self, body: RigidBody, fields: NDArray[Any] | None, torque: Floats, in_space: bool,
             *others: Floats) -> Hashable:
        """
        Return a key made of everything that determines a segment's motion except its start.

        If there are any `others`, the first one is a torque in space axes that acts in addition to
        a torque in body axes. The second one is the torque on the rotors. The keys of lags and
        friction follow.
        """
        return (body._constants.tobytes(), None if fields is None else fields.tobytes(),
                self.solver, float(self.tolerance), self.max_step_ns,
                tuple(torque.ravel().tolist()), in_space and bool(torque.any()),
                tuple(tuple(other.ravel().tolist()) for other in others)
                if others and any(other.any() for other in others) else None)

    def too_fast(self, time_ns: int) -> ValueError:
        """Return the error to raise if the body is too fast even for steps of a nanosecond."""
        cause = f'steps of {self.max_step_ns * 1e-9:g} s may be too long for {self.solver}' \
            if self.record.fixed_step else 'check the torque (N m) and the inertia (kg m^2)'
        return ValueError(f'at {time_ns} ns the body turns faster than {FASTEST:g} rad/s: {cause}')


def validated(*values: Any) -> Options:
    """Return options with the given values, in the order of the fields of `Options`."""
    try:
        return _cached_options(*values)
    except TypeError:  # an unhashable value is invalid; `Options` reports why
        return Options(*values)


@lru_cache
def _cached_options(*values: Any) -> Options:
    return Options(*values)  # cached, because validation takes a tenth of the time of a short run


def checked_times(at: ArrayLike, start_ns: int) -> tuple[NDArray[np.int64], bool, int]:
    """Return the times, whether the times ascend, and the latest time, or raise ValueError."""
    times = instants(at, 'at')
    if times.size > 1:
        ascends, first_ns, last_ns = kernels.extent(times)
    else:  # calling a kernel here would double the time that this function takes
        ascends, (first_ns, last_ns) = True, 2 * (times.tolist() or [start_ns])
    if first_ns < start_ns:
        raise ValueError(f'at: expected no time before the start ({start_ns} ns), '
                         f'found {first_ns} ns')
    if last_ns == NEVER_NS:
        raise ValueError(f'at: expected times before {NEVER_NS} ns, found {last_ns} ns')
    if last_ns - start_ns >= NEVER_NS:
        raise ValueError(f'at: expected times within 292 years of the start ({start_ns} ns), '
                         f'found {last_ns} ns')
    return times, ascends, int(last_ns)  # kernels that run as Python return numpy integers
