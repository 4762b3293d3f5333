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

"""The solvers, with one record for each."""

from __future__ import annotations

import math
from typing import NamedTuple

from rigid_body_ros.engine import CLASSICAL, layout

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
RK4 = Solver('rk4', layout.RK4, order=CLASSICAL.order, fixed_step=True)
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
