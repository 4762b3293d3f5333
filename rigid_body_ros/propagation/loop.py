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
The loop from one torque change to the next.

The contract of `run`, whatever the solver:

1. The motion is a function of the start, the torque and the options. No bit of it depends on the
   other requested times, on the number of calls of `run`, or on its budget.
2. A *segment* runs from one torque change to the next; consecutive intervals without torque are
   one segment, a *coast*. The state at the beginning of a segment is kept.
3. Steps end on a grid that begins with the segment and depends only on the state there, the
   torque and the method. The last grid point reached is kept, so that a later call computes only
   new steps. A state between grid points is one more step, and no later state depends on it.
4. A coast in closed form is always computed from its beginning.
5. `run` returns when it has filled all outputs, has reached the sample to stop at, has used up its
   budget, or finds that the body is too fast. Another call continues from the states and the
   progress that it leaves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import (
    euler_equations,
    free_motion,
    motion_layout,
    short_step,
    taylor,
    vector,
)
from rigid_body_ros.kernels.jit import inlined, internal, njit
from rigid_body_ros.kernels.linear_terms import Constants
from rigid_body_ros.propagation import intervals, layout, stepping
from rigid_body_ros.propagation.layout import Body, Log, Method, Outputs, Place, States

#: Results of `run`. FINISHED: all outputs are filled, or the sample to stop at is reached.
#: UNFINISHED: the budget is used up; another call continues. TOO_FAST: the body turns faster than
#: FASTEST.
FINISHED, UNFINISHED, TOO_FAST = range(3)
#: Value of `rows` of `run` if the times ascend.
IN_ORDER = np.empty(0, np.intp)
#: Units of work, at most about 0.1 s, after which a kernel returns so that Python handles signals.
BUDGET = 20_000 * stepping.STEP_COST


@njit
def run(states: Floats, progress: NDArray[np.int64], times_ns: NDArray[np.int64],
        rows: NDArray[np.intp], motion: Floats, closed: NDArray[np.bool_],
        stamps_ns: NDArray[np.int64], polynomials: Floats, in_space: NDArray[np.bool_],
        first: int, stop: int, constants: Floats, settings: Floats, budget: int,
        terms: Floats | None) -> int:
    """
    Compute the motion from torque change to torque change, and store it at the requested times.

    Parameters
    ----------
    states : float64 (48,)
        See `layout.pack_states`; changed.
    progress : int64 (5,)
        See `layout.pack_place`; changed.
    times_ns, rows, motion, closed
        See `layout.Outputs`.
    stamps_ns, polynomials, in_space, first, stop
        See `layout.Log`.
    constants : float64 (128,)
        See `body_layout.pack`.
    settings : float64 (7,)
        See `layout.pack_settings`.
    budget : int
        Units of work, at least 1, after which to return; see `stepping.STEP_COST`.
    terms : float64 (2, 3), (n, 2 degree + 4, 3) or (1, n, 2 degree + 4, 3), or None
        The momentum of the rotors, if it is constant, and its low-order part; otherwise the terms
        of `summation.Summed`, with one more axis if torques in space axes are among them. None if
        only a torque in one frame acts. The number of axes belongs to the type of an array, so
        the compiler leaves out the code for what a scene does not have.

    Returns
    -------
    int
        FINISHED, UNFINISHED or TOO_FAST.

    """
    log = Log(stamps_ns, polynomials, in_space, first, stop, layout.unpack_timeout(settings))
    place, reached = layout.load_place(progress), layout.load_states(states)
    if place.sample == layout.IN_FORCE:
        sample, timed_out = intervals.sample_in_force(log, place.grid_ns)
        place = Place(place.grid_ns, place.grid_ns, sample, timed_out, place.done)
        reached = States(reached.grid, reached.grid, reached.grid)
    place, reached = _run_segments(place, reached, Outputs(times_ns, rows, motion, closed), log,
                                   layout.unpack_body(constants),
                                   layout.unpack_method(settings), budget,
                                   layout.unpack_terms(terms), layout.two_frames(terms),
                                   layout.unpack_linear(terms, constants))
    layout.store_place(place, progress)
    layout.store_states(reached, states)
    if stepping.is_too_fast(reached.latest):
        return TOO_FAST
    return UNFINISHED if place.sample < stop and place.done < len(times_ns) else FINISHED


# Arrays are taken out of the records before the loop: otherwise numba counts references in each
# pass, which costs a third of a step.
@internal
def _run_segments(place: Place, reached: States, outputs: Outputs, log: Log, body: Body,
                  method: Method, budget: int, terms: Floats | None, two_frames: bool | None,
                  linear: Constants | None) -> tuple[Place, States]:
    grid, begin, latest = reached
    grid_ns, begin_ns, sample, timed_out, done = place
    times_ns, rows, motion, closed = outputs
    stamps_ns, polynomials, in_space, first, stop, timeout_ns = log
    table = np.empty(taylor.WORKSPACE)
    coast, prepared = free_motion.start_only(begin, free_motion.NEAR_SEPARATRIX), False
    while sample < stop and done < len(times_ns) and budget > 0:
        index, idle = sample - first, timed_out or sample < 0
        now = intervals.interval(
            intervals.torque_of(polynomials, index, idle), stamps_ns[sample] if sample >= 0 else 0,
            stamps_ns[sample + 1] if sample + 1 < len(stamps_ns) else NEVER_NS, idle, timeout_ns)
        extras = intervals.extras_of(
            terms, index, intervals.span(now, polynomials.shape[1] // 2), linear)
        coasts = now.is_zero and not intervals.acts(extras)
        continues = coasts and (now.times_out or (now.next_ns < NEVER_NS and intervals.coasts(
            polynomials, terms, index + 1, linear)))
        row = done if len(rows) == 0 else rows[done]
        asked = times_ns[row] <= now.end_ns
        if asked or not continues:
            time_ns = times_ns[row] if asked else now.end_ns
            degree = 0 if coasts else polynomials.shape[1] // 2
            space = not now.is_zero and in_space[sample]
            acceleration = euler_equations.acceleration_from_torque(
                body.coefficients, body.form, now.torque[0])
            seconds = (time_ns - grid_ns) / 1e9
            others = intervals.during_step(terms, two_frames, index, seconds, linear)
            by_formula = coasts and _is_closed(method, begin, time_ns - begin_ns)
            if by_formula and not prepared:
                coast, prepared = free_motion.prepare(begin, body.frame), True
            if by_formula and coast.kind != free_motion.NEAR_SEPARATRIX:
                latest = free_motion.at(coast, time_ns - begin_ns)
                closed[sample + 1] = True
                budget -= stepping.STEP_COST
            elif time_ns == grid_ns:
                latest = grid
            elif (grid_ns == begin_ns and degree == 0 and not space and _is_short(
                    grid, time_ns - grid_ns, acceleration, others, body, method)):
                if time_ns == now.end_ns and not (idle or coasts or now.times_out):
                    budget += sample
                    grid, grid_ns, sample, done = _run_short_steps(
                        grid, Place(grid_ns, begin_ns, sample, timed_out, done),
                        min(budget, stop, len(stamps_ns) - 1), outputs, log, body, method, terms,
                        two_frames, linear)
                    begin, latest, begin_ns, prepared = grid, grid, grid_ns, False
                    budget -= sample
                    continue
                latest = short_step.step(grid, seconds, body.coefficients, body.form, acceleration,
                                         method.tolerance, others)
            else:
                low = intervals.low_order_parts(polynomials, index)
                grid, grid_ns, latest, arrived, budget = stepping.advance(
                    grid, grid_ns, time_ns, intervals.drive(now, low, degree, space, body),
                    body, method, table, budget, extras)
                if not arrived:
                    break
            if asked:
                motion_layout.store(latest, row, motion)
                done += 1
            if time_ns == now.end_ns and not continues:
                grid, grid_ns, begin, begin_ns, prepared = latest, time_ns, latest, time_ns, False
        if not asked or begin_ns == now.end_ns:
            sample, timed_out = (sample, True) if now.times_out else (sample + 1, False)
        budget -= 1
    return Place(grid_ns, begin_ns, sample, timed_out, done), States(grid, begin, latest)


@inlined
def _is_closed(method: Method, begin: vector.KernelState, span_ns: int) -> bool:
    # Return whether a coast is computed in closed form.
    if span_ns == 0:
        return False
    speed = method.closed_form_beyond * 1e9 / span_ns
    return method.closed_form_beyond < 0.0 or vector.dot(begin[0], begin[0]) > speed * speed


@inlined
def _is_short(grid: vector.KernelState, rest_ns: int, acceleration: vector.Vector,
              extras: short_step.Extras | None, body: Body, method: Method) -> bool:
    # Return whether one short step is enough, if the torque is held in body axes.
    seconds = rest_ns / 1e9
    return (rest_ns < method.max_step_ns and not method.fixed_step
            and short_step.is_accurate(grid, seconds, acceleration, method.tolerance, extras))


@internal
def _run_short_steps(grid: vector.KernelState, place: Place, last: int, outputs: Outputs, log: Log,
                     body: Body, method: Method, terms: Floats | None, two_frames: bool | None,
                     linear: Constants | None) -> tuple[vector.KernelState, int, int, int]:
    # Step from stamp to stamp, at most to the stamp of the sample `last`, under held body torques,
    # as long as one short step is enough and no output lies between the stamps. Fill the outputs
    # at the stamps, except one at the last that is reached. Return state,
    # grid_ns, sample and done. In a function of its own, the compiler keeps the state in
    # registers.
    grid_ns, sample, done = place.grid_ns, place.sample, place.done
    times_ns, rows, motion, _ = outputs
    stamps_ns, polynomials, in_space, first, _, timeout_ns = log
    extras = intervals.during_step(terms, two_frames, sample - first, 1.0, linear)
    while sample < last and done < len(times_ns):
        row = done if len(rows) == 0 else rows[done]
        if times_ns[row] == grid_ns:
            motion_layout.store(grid, row, motion)
            done += 1
            continue
        index, next_ns = sample - first, stamps_ns[sample + 1]
        torque = intervals.coefficient(polynomials, index, 0)
        acceleration = euler_equations.acceleration_from_torque(
            body.coefficients, body.form, torque)
        span_ns = next_ns - grid_ns
        seconds = span_ns / 1e9
        if intervals.terms_vary(terms):
            extras = intervals.during_step(terms, two_frames, index, seconds, linear)
        if (times_ns[row] < next_ns or span_ns >= method.max_step_ns
                or (in_space[sample] and not layout.is_zero_vector(torque))
                or (layout.is_zero_vector(torque)
                    and intervals.coasts(polynomials, terms, index, linear))
                or 0 < timeout_ns < next_ns - stamps_ns[sample]
                or not short_step.is_accurate(grid, seconds, acceleration, method.tolerance,
                                              extras)):
            break
        grid = short_step.step(grid, seconds, body.coefficients, body.form, acceleration,
                               method.tolerance, extras)
        grid_ns = next_ns
        sample += 1
    return grid, grid_ns, sample, done
