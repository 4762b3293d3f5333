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
The steps between two torque changes.

A torque sample rules from its stamp to the next one; with a timeout, silence (no torque) follows
from some time after it. Sample -1 is the time before the first. Consecutive stretches without
torque are one *coast*.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import body as bodies
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import (
    euler_equations,
    four,
    free_motion,
    short_step,
    steppers,
    taylor,
    vector,
)
from rigid_body_ros.kernels.jit import inlined, internal, njit
from rigid_body_ros.propagation.options import EXACT, EXPLICIT_EULER, FASTEST, RK4, STRANG, TAYLOR

#: For `rows` of `run`: the times ascend.
IN_ORDER = np.empty(0, np.intp)
#: For `sample` of `run`: the one in force at the beginning, which is to be found.
IN_FORCE = -2
#: Cost of a full step, or a state in closed form, in units of the budget; anything else costs 1.
_FULL = 16
#: Units of work, at most about 0.1 s, after which a kernel returns so that Python handles signals.
BUDGET = 20_000 * _FULL
#: rad; `auto` answers a coast in closed form where it turns by more. Up to here the series is as
#: exact, and cheaper.
LONG_COAST = 16.0


class Origin(NamedTuple):
    """Where a state that lies between torque changes comes from; its own bits do not tell."""

    #: What rules there, as `Options.rule` returns it.
    rule: Hashable
    begin_ns: int
    begin: Floats
    grid_ns: int
    grid: Floats


def origin(start: bodies.State, rule: Hashable) -> Origin:
    """Return where steps go on from: the state itself, unless the same rule led up to it."""
    found = start._origin
    if isinstance(found, Origin) and found.rule == rule:
        return found
    return Origin(rule, start.time_ns, start._packed, start.time_ns, start._packed)


def working_states(grid: Floats, begin: Floats | None = None) -> Floats:
    """Return what `run` works on, from the state on the grid and at the segment's beginning."""
    states = np.empty(3 * bodies.SIZE)
    states[:bodies.SIZE] = grid
    if begin is not None:
        states[bodies.SIZE:2 * bodies.SIZE] = begin
    return states


@njit
def order(times_ns: NDArray[np.int64]) -> tuple[bool, int, int]:
    """Return whether times ascend, the first and the last of them."""
    ascends, first, last = True, times_ns[0], times_ns[0]
    for k in range(1, len(times_ns)):
        ascends = ascends and times_ns[k] >= times_ns[k - 1]
        first, last = min(first, times_ns[k]), max(last, times_ns[k])
    return ascends, first, last


@njit
def run(states: Floats, grid_ns: int, begin_ns: int, sample: int, silent: bool, done: int,
        at_ns: NDArray[np.int64], rows: NDArray[np.intp], motion: Floats,
        closed: NDArray[np.bool_], stamps_ns: NDArray[np.int64], torques: Floats,
        in_space: NDArray[np.bool_], first: int, stop: int, timeout_ns: int, constants: Floats,
        solver: int, tolerance: float, max_step_ns: int,
        budget: int) -> tuple[int, int, int, bool, int, bool]:
    """
    Go from torque to torque, and fill attitude and rates at sorted times.

    Parameters
    ----------
    states : float64 (3 bodies.SIZE,)
        The state on the grid of steps, and the one that the segment began with; changed. Last,
        filled, the state that was worked out last.
    grid_ns, begin_ns, sample, silent, done : int, int, int, bool, int
        Their times, the sample in force and whether it timed out, and how many times are filled.
        Or a sample of IN_FORCE: then only the first state and its time count.
    at_ns : int64 (m,)
        Times to answer for, none before the grid's.
    rows : int (m,) or (0,)
        Where each time's motion goes; empty if in their order.
    motion : float64 (7 m,)
        Filled with the attitudes, and then the angular velocities.
    closed : bool (n + 1,)
        Set where a coast was answered in closed form, by sample + 1.
    stamps_ns, in_space : int64 (n,), bool (n,)
        From when on each sample rules, and whether its torque is given in space axes.
    torques : float64 (k, 2 degree + 1, 3)
        Polynomials in the fraction of their time, for samples from `first` on, as of
        `TorqueLog.polynomials`.
    first, stop : int
        The sample that `torques` begins with, and the one not to begin with.
    timeout_ns : int
        How long after a sample the torque becomes zero; 0: never.
    constants : float64 (104,)
        The body, as of `tensor.packed`.
    solver : int
        Its place in `SOLVERS`.
    tolerance : float
        Bound on the truncation error of the attitude per radian turned.
    max_step_ns : int
        Upper limit of a step, or the step of a solver of fixed step.
    budget : int
        Units of work after which it returns, at least 1: `_FULL` for a full step or a state in
        closed form, 1 for a short step, an output or a torque change.

    Returns
    -------
    grid_ns, begin_ns, sample, silent, done
        Where it got until all was done, the budget used up, or the body too fast.
    fast : bool
        Whether it is: beyond FASTEST.

    """
    state, begin = _load(states, 0), _load(states, bodies.SIZE)
    if sample == IN_FORCE:
        sample = -1
        while sample + 1 < len(stamps_ns) and stamps_ns[sample + 1] <= grid_ns:
            sample += 1
        silent = sample >= 0 and 0 < timeout_ns <= grid_ns - stamps_ns[sample]
        begin, begin_ns = state, grid_ns
    equations, frame = _equations(constants), _frame(constants)
    form, angle = _form(equations, frame), taylor.step_angle(tolerance)
    table = np.empty(taylor.WORKSPACE)
    free, prepared = free_motion.start_only(begin, free_motion.NEAR_SEPARATRIX), False
    out = state
    degree = torques.shape[1] // 2
    while sample < stop and done < len(at_ns) and budget > 0:
        idle = silent or sample < 0
        next_ns = stamps_ns[sample + 1] if sample + 1 < len(stamps_ns) else NEVER_NS
        end_ns, falls_silent = next_ns, False
        if timeout_ns > 0 and not idle and stamps_ns[sample] + timeout_ns < next_ns:
            end_ns, falls_silent = stamps_ns[sample] + timeout_ns, True
        index = sample - first
        torque, space = _torque(torques, index, idle), not idle and in_space[sample]
        coasts = _is_zero(torque)
        goes_on = coasts and (falls_silent or (next_ns < NEVER_NS
                                               and not np.any(torques[index + 1])))
        row = done if len(rows) == 0 else rows[done]
        asked = at_ns[row] <= end_ns
        if asked or not goes_on:
            time_ns = at_ns[row] if asked else end_ns
            rest_ns, seconds = time_ns - grid_ns, (time_ns - grid_ns) / 1e9
            push = euler_equations.acceleration_from_torque(equations, form, torque[0])
            formula = coasts and _is_long(solver, begin, time_ns - begin_ns)
            if formula and not prepared:
                free, prepared = free_motion.prepare(begin, frame), True
            if formula and free.kind != free_motion.NEAR_SEPARATRIX:
                out = free_motion.at(free, time_ns - begin_ns)
                closed[sample + 1] = True
                budget -= _FULL
            elif rest_ns == 0:
                out = state
            elif (grid_ns == begin_ns and rest_ns < max_step_ns and solver <= EXACT
                  and (coasts or (degree == 0 and not space))
                  and short_step.is_accurate(state, seconds, push, tolerance)):
                if not asked and not coasts and not falls_silent:
                    last = min(sample + budget, len(stamps_ns) - 1)
                    budget += sample
                    state, grid_ns, sample, done = _stream(
                        state, grid_ns, sample, last, done, at_ns, rows, motion, stamps_ns,
                        torques, in_space, timeout_ns, equations, form, tolerance, max_step_ns)
                    begin, begin_ns, prepared = state, grid_ns, False
                    budget -= sample
                    continue
                out = short_step.step(state, seconds, equations, form, push, tolerance)
            else:
                origin_ns, span = _span(stamps_ns, sample)
                drive = torque
                if not space and not coasts:
                    drive = euler_equations.acceleration_polynomial(
                        equations, form, torque, _rests(torques, index))
                state, grid_ns, out, reached, budget = _move(
                    state, grid_ns, time_ns, drive, 0 if coasts else degree,
                    space and not coasts, origin_ns, span, equations, form, frame, solver,
                    tolerance, angle, max_step_ns, table, budget)
                if not reached:
                    break
            if asked:
                _fill(out, row, motion)
                done += 1
            if time_ns == end_ns and not goes_on:
                state, grid_ns, begin, begin_ns, prepared = out, end_ns, out, end_ns, False
        if not asked or begin_ns == end_ns:
            sample, silent = (sample, True) if falls_silent else (sample + 1, False)
        budget -= 1
    _store(state, states, 0)
    _store(begin, states, bodies.SIZE)
    _store(out, states, 2 * bodies.SIZE)
    return grid_ns, begin_ns, sample, silent, done, _is_too_fast(out)


@internal
def _stream(state: vector.KernelState, grid_ns: int, sample: int, last: int, done: int,
            at_ns: NDArray[np.int64], rows: NDArray[np.intp], motion: Floats,
            stamps_ns: NDArray[np.int64], torques: Floats, in_space: NDArray[np.bool_],
            timeout_ns: int, equations: vector.Coefficients, form: int, tolerance: float,
            max_step_ns: int) -> tuple[vector.KernelState, int, int, int]:
    # Go from stamp to stamp, at most to that of the sample `last`, under held body torques for as
    # long as one short step each will do, and nothing is asked for in between. Apart from `run`:
    # in a loop with nothing else in it the compiler keeps the state in registers. Returns state,
    # grid_ns, sample, done.
    while sample < last and done < len(at_ns):
        next_ns, torque = stamps_ns[sample + 1], _row(torques, sample, 0)
        row = done if len(rows) == 0 else rows[done]
        if at_ns[row] == grid_ns:
            _fill(state, row, motion)
            done += 1
            continue
        push = euler_equations.acceleration_from_torque(equations, form, torque)
        span_ns = next_ns - grid_ns
        seconds = span_ns / 1e9
        if (at_ns[row] < next_ns or span_ns >= max_step_ns or in_space[sample]
                or _is_nothing(torque) or 0 < timeout_ns < next_ns - stamps_ns[sample]
                or not short_step.is_accurate(state, seconds, push, tolerance)):
            break
        state = short_step.step(state, seconds, equations, form, push, tolerance)
        grid_ns = next_ns
        sample += 1
    return state, grid_ns, sample, done


@inlined
def _fill(state: vector.KernelState, row: int, motion: Floats) -> None:
    w, place = state[0], len(motion) // 7 * 4 + 3 * row
    four.store(motion, 4 * row, state[1])
    motion[place], motion[place + 1], motion[place + 2] = w[0], w[1], w[2]


@inlined
def _torque(torques: Floats, index: int, idle: bool) -> vector.Polynomial:
    # Inlined: to hand an array over costs half a short step.
    none = four.broadcast(0.0)
    if idle:
        return none, none, none, none
    if torques.shape[1] == 1:
        return _row(torques, index, 0), none, none, none
    if torques.shape[1] == 3:
        return _row(torques, index, 0), _row(torques, index, 1), none, none
    return (_row(torques, index, 0), _row(torques, index, 1), _row(torques, index, 2),
            _row(torques, index, 3))


@inlined
def _rests(torques: Floats, index: int) -> vector.Polynomial:
    # What rounding took from the coefficients.
    none = four.broadcast(0.0)
    if torques.shape[1] == 1:
        return none, none, none, none
    if torques.shape[1] == 3:
        return none, _row(torques, index, 2), none, none
    return (none, _row(torques, index, 4), _row(torques, index, 5),
            _row(torques, index, 6))


@inlined
def _row(torques: Floats, index: int, k: int) -> vector.Vector:
    return vector.of(torques[index, k, 0], torques[index, k, 1], torques[index, k, 2])


@inlined
def _is_zero(torque: vector.Polynomial) -> bool:
    a, b, c, d = torque
    return _is_nothing(a) and _is_nothing(b) and _is_nothing(c) and _is_nothing(d)


@inlined
def _is_nothing(a: vector.Vector) -> bool:
    return a[0] == 0.0 and a[1] == 0.0 and a[2] == 0.0


@inlined
def _is_long(solver: int, begin: vector.KernelState, span_ns: int) -> bool:
    # Whether a coast is answered in closed form.
    if span_ns == 0 or solver > EXACT or solver == TAYLOR:
        return False
    if solver == EXACT:
        return True
    angle = LONG_COAST * 1e9 / span_ns
    return vector.dot(begin[0], begin[0]) > angle * angle


@internal
def _span(stamps_ns: NDArray[np.int64], sample: int) -> tuple[int, float]:
    # Where the fraction of a polynomial is 0, and the time, s, to where it is 1.
    if sample < 0:
        return 0, 1.0
    if sample + 1 == len(stamps_ns):
        return stamps_ns[sample], 1.0
    return stamps_ns[sample], (stamps_ns[sample + 1] - stamps_ns[sample]) / 1e9


@internal
def _move(state: vector.KernelState, grid_ns: int, time_ns: int, drive: vector.Polynomial,
          degree: int, in_space: bool, origin_ns: int, span: float, equations: vector.Coefficients,
          form: int, frame: vector.PrincipalFrame, solver: int, tolerance: float, angle: float,
          max_step_ns: int, table: Floats,
          budget: int) -> tuple[vector.KernelState, int, vector.KernelState, bool, int]:
    # Go on to the last grid point before a time, and from there to the time. Returns the state
    # on the grid, when that is, the state at the time, whether it was reached before the budget
    # of steps was used up or the body too fast, and what is left of the budget.
    bound = euler_equations.acceleration_bound(drive, in_space, equations)
    out = state
    while grid_ns < time_ns:
        if budget <= 0:
            return state, grid_ns, out, False, budget
        budget -= _FULL
        rest_ns = time_ns - grid_ns
        step_ns = _natural_ns(state, rest_ns, bound, solver, angle, max_step_ns)
        last = step_ns >= rest_ns
        if last:
            step_ns = rest_ns
        seconds = step_ns / 1e9
        local = drive if degree == 0 else _local(
            drive, (grid_ns - origin_ns) / 1e9 / span, seconds / span)
        out = _step(state, seconds, equations, form, frame, local, degree, in_space, bound,
                    solver, tolerance, table)
        if last:
            break
        state = out
        grid_ns += step_ns
        if _is_too_fast(out):
            return state, grid_ns, out, False, budget
    return state, grid_ns, out, True, budget


@inlined
def _natural_ns(state: vector.KernelState, rest_ns: int, bound: float, solver: int, angle: float,
                max_step_ns: int) -> int:
    # Length of the next step on the grid, whatever is left to go, if it is not longer than that.
    if solver >= RK4:
        return max_step_ns
    square, rest = vector.dot(state[0], state[0]), rest_ns / 1e9
    if rest_ns <= max_step_ns and rest * rest * (square + bound) < 0.01:
        return rest_ns  # turns by about 0.1 rad at most
    seconds = taylor.step_seconds(square, bound, angle)
    return max(1, int(min(seconds * 1e9, float(max_step_ns))))


@inlined
def _step(state: vector.KernelState, seconds: float, equations: vector.Coefficients, form: int,
          frame: vector.PrincipalFrame, drive: vector.Polynomial, degree: int, in_space: bool,
          bound: float, solver: int, tolerance: float, table: Floats) -> vector.KernelState:
    if solver == RK4:
        return steppers.rk4(state, seconds, equations, drive, in_space)
    if solver == STRANG:
        return steppers.strang(state, seconds, equations, frame, drive, in_space)
    if solver == EXPLICIT_EULER:
        return steppers.explicit_euler(state, seconds, equations, drive, in_space)
    return taylor.step(state, seconds, equations, form, drive, degree, in_space, bound,
                       tolerance, table)


@internal
def _local(drive: vector.Polynomial, offset: float, ratio: float) -> vector.Polynomial:
    # From p(s) to p(offset + ratio s), by Horner's rule (a Taylor shift).
    a, b, c, d = drive
    a = vector.add_scaled(a, offset, vector.add_scaled(b, offset, vector.add_scaled(c, offset, d)))
    b = vector.add_scaled(b, offset, vector.add_scaled(vector.scale(2.0, c), 3.0 * offset, d))
    c = vector.add_scaled(c, 3.0 * offset, d)
    square = ratio * ratio
    return a, vector.scale(ratio, b), vector.scale(square, c), vector.scale(square * ratio, d)


@internal
def _equations(constants: Floats) -> vector.Coefficients:
    at = four.load
    c = constants
    return ((at(c, 0), at(c, 4), at(c, 8), at(c, 12), at(c, 16), at(c, 20), at(c, 24), at(c, 28),
             at(c, 32)),
            (at(c, 36), at(c, 40), at(c, 44), at(c, 48), at(c, 52), at(c, 56), at(c, 60),
             at(c, 64), at(c, 68)),
            vector.of(c[0], c[5], c[10]), vector.of(c[24], c[29], c[34]))


@internal
def _frame(constants: Floats) -> vector.PrincipalFrame:
    at, c = four.load, constants
    return (at(c, 72), at(c, 76), (at(c, 80), at(c, 84), at(c, 88)),
            (at(c, 92), at(c, 96), at(c, 100)))


@internal
def _form(equations: vector.Coefficients, frame: vector.PrincipalFrame) -> int:
    if _is_along_axes(equations):
        return euler_equations.DIAGONAL
    moments = frame[0]
    thin = moments[2] > euler_equations.THIN_RATIO * moments[0]
    return euler_equations.THIN if thin else euler_equations.FULL


@internal
def _is_along_axes(equations: vector.Coefficients) -> bool:
    a, b, c, d, e, f, _, _, _ = equations[0]
    return (a[1] == a[2] == b[0] == b[2] == c[0] == c[1] == 0.0
            and _is_nothing(d) and _is_nothing(e) and _is_nothing(f))


@inlined
def _is_too_fast(state: vector.KernelState) -> bool:
    return not vector.dot(state[0], state[0]) <= FASTEST * FASTEST  # nor NaN


@internal
def _load(packed: Floats, at: int) -> vector.KernelState:
    return (four.load(packed, at), four.load(packed, at + 4), four.load(packed, at + 8),
            four.load(packed, at + 12))


@internal
def _store(state: vector.KernelState, packed: Floats, at: int) -> None:
    four.store(packed, at, state[0])
    four.store(packed, at + 4, state[1])
    four.store(packed, at + 8, state[2])
    four.store(packed, at + 12, state[3])
