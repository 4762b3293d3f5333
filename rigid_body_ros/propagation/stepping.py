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
Steps on the grid of one segment.

A step may assume:

1. The torque is one polynomial over the whole step, of the degree given, and the bound on the
   acceleration holds over the whole interval: a step never crosses a torque change.
2. The step is positive and, for the series, at most about `taylor.step_seconds` long.
3. The angular velocity is at most FASTEST. It is checked after each step on the grid.

A step must leave:

1. A state at the end of the step that depends on the state at its beginning, the torque, the
   length and the method only, bit for bit.
2. A unit attitude on the continuous path from the start: no change of sign.
3. The low-order parts of both, or zeros.
4. The state that it starts from unchanged: a step to an output is discarded afterwards.
"""

from __future__ import annotations

from typing import NamedTuple

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import euler_equations, steppers, taylor, vector
from rigid_body_ros.kernels.jit import inlined, internal
from rigid_body_ros.propagation import solvers
from rigid_body_ros.propagation.intervals import Drive
from rigid_body_ros.propagation.layout import Body, Method
from rigid_body_ros.propagation.options import FASTEST

_RK4, _STRANG = solvers.RK4.code, solvers.STRANG.code
_EXPLICIT_EULER = solvers.EXPLICIT_EULER.code
#: Cost of a full step, or a state in closed form, in units of the budget; anything else costs 1.
STEP_COST = 16


class Reached(NamedTuple):
    """The result of `advance`."""

    #: The last state on the grid, and its time.
    grid: vector.KernelState
    grid_ns: int
    #: The state at the requested time, if that was reached.
    latest: vector.KernelState
    #: Whether the time was reached before the budget was used up or the body became too fast.
    arrived: bool
    #: The budget that is left.
    budget: int


@internal
def advance(grid: vector.KernelState, grid_ns: int, time_ns: int, drive: Drive, body: Body,
            method: Method, table: Floats, budget: int) -> Reached:
    """
    Step to the last grid point before a time, and from there to the time.

    Parameters
    ----------
    grid, grid_ns : KernelState, int
        The last grid point reached, and its time.
    time_ns : int
        Within the segment.
    drive, body, method : Drive, Body, Method
        The drive of the interval, the body and the method of a step.
    table : float64 (taylor.WORKSPACE,)
        Workspace.
    budget : int
        Units of work after which to return; a step costs `STEP_COST`.

    Returns
    -------
    Reached

    """
    bound = euler_equations.acceleration_bound(drive.polynomial, drive.in_space, body.coefficients)
    latest = grid
    while grid_ns < time_ns:
        if budget <= 0:
            return Reached(grid, grid_ns, latest, False, budget)
        budget -= STEP_COST
        rest_ns = time_ns - grid_ns
        step_ns = _step_length_ns(grid, rest_ns, bound, method)
        last = step_ns >= rest_ns
        if last:
            step_ns = rest_ns
        latest = _step(grid, step_ns / 1e9, grid_ns, drive, bound, body, method, table)
        if last:
            break
        grid = latest
        grid_ns += step_ns
        if is_too_fast(latest):
            return Reached(grid, grid_ns, latest, False, budget)
    return Reached(grid, grid_ns, latest, True, budget)


@inlined
def is_too_fast(state: vector.KernelState) -> bool:
    """Return whether the speed is above FASTEST, or not a number."""
    return not vector.dot(state[0], state[0]) <= FASTEST * FASTEST


@inlined
def _step_length_ns(state: vector.KernelState, rest_ns: int, bound: float, method: Method) -> int:
    # Return the length of the next step on the grid. It depends on the time left only if the step
    # would be longer than that.
    if method.fixed_step:
        return method.max_step_ns
    square, rest = vector.dot(state[0], state[0]), rest_ns / 1e9
    if rest_ns <= method.max_step_ns and rest * rest * (square + bound) < 0.01:
        return rest_ns  # turns by about 0.1 rad at most
    seconds = taylor.step_seconds(square, bound, method.angle)
    return max(1, int(min(seconds * 1e9, float(method.max_step_ns))))


@inlined
def _step(state: vector.KernelState, seconds: float, grid_ns: int, drive: Drive, bound: float,
          body: Body, method: Method, table: Floats) -> vector.KernelState:
    local = drive.polynomial
    if drive.degree != 0:
        local = _shifted(local, (grid_ns - drive.origin_ns) / 1e9 / drive.span,
                         seconds / drive.span)
    if method.solver == _RK4:
        return steppers.rk4(state, seconds, body.coefficients, local, drive.in_space)
    if method.solver == _STRANG:
        return steppers.strang(state, seconds, body.coefficients, body.frame, local,
                               drive.in_space)
    if method.solver == _EXPLICIT_EULER:
        return steppers.explicit_euler(state, seconds, body.coefficients, local, drive.in_space)
    return taylor.step(state, seconds, body.coefficients, body.form, local, drive.degree,
                       drive.in_space, bound, method.tolerance, table)


@internal
def _shifted(polynomial: vector.Polynomial, offset: float, ratio: float) -> vector.Polynomial:
    # Return p(offset + ratio s) for a polynomial p(s), by Horner's rule (a Taylor shift).
    a, b, c, d = polynomial
    a = vector.add_scaled(a, offset, vector.add_scaled(b, offset, vector.add_scaled(c, offset, d)))
    b = vector.add_scaled(b, offset, vector.add_scaled(vector.scale(2.0, c), 3.0 * offset, d))
    c = vector.add_scaled(c, 3.0 * offset, d)
    square = ratio * ratio
    return a, vector.scale(ratio, b), vector.scale(square, c), vector.scale(square * ratio, d)
