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
The time loop, which advances the motion from one torque change to the next.

With every solver, `run` guarantees the following:

1. The motion depends only on the start state, the torque and the options. Not a single bit of a
   state changes if you request other times as well, split the run into more calls of `run`, or
   change its budget.
2. A *segment* lasts from one torque change to the next. Consecutive intervals without torque form
   a single segment, which is called a *coast*. The loop keeps the state at the beginning of the
   segment.
3. Steps end at the points of a grid that starts at the beginning of the segment. The grid depends
   only on the state at that time, the torque and the method. The loop keeps the last grid point
   that it has reached, so a later call computes only the new steps. A state between two grid
   points is computed by one extra step, and no later state depends on this extra step.
4. If a coast is computed in closed form, every state is computed from the beginning of the coast.
5. `run` returns when it has filled all outputs, has reached the row at which to stop, has used up
   its budget, or finds that the body turns too fast. Before it returns, it stores its progress, so
   another call can continue from there.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import (
    body_layout,
    free_motion,
    friction,
    intervals,
    lanes,
    layout,
    motion_layout,
    short_step,
    stepping,
    tangents,
    vector,
)
from rigid_body_ros.kernels.euler_equations import acceleration_from_torque
from rigid_body_ros.kernels.intervals import BodyTerms, coasts
from rigid_body_ros.kernels.jit import inlined, internal, njit, scratch, WRITTEN
from rigid_body_ros.kernels.layout import (
    Body,
    FINISHED,
    GridStates,
    METHOD,
    Method,
    Place,
    PROGRESS,
    Requested,
    Rows,
    TOO_FAST,
    UNFINISHED,
)
from rigid_body_ros.kernels.series_table import WORKSPACE
from rigid_body_ros.kernels.stepping import Series


@njit
def run(progress: Annotated[NDArray[Any], '1', PROGRESS, WRITTEN], times_ns: Annotated[Ints, 'm'],
        order: Annotated[Ints, 'm|0'], motion: Annotated[Floats, '7m', WRITTEN],
        closed: Annotated[NDArray[np.bool_], 'n+1', WRITTEN], rows: Rows,
        constants: Annotated[Floats, f'{body_layout.SIZE}'],
        methods: Annotated[NDArray[Any], '1', METHOD]) -> int:
    """
    Advance the motion from row to row, and store it at the requested times.

    Parameters
    ----------
    progress : array of layout.PROGRESS, shape (1,)
        How far the motion has been computed. The kernel updates this record.
    times_ns, order, motion, closed
        See `layout.Requested`.
    rows : Rows
        What acts on the body. The kernel is compiled for each combination of terms.
    constants : float64 (128,)
        See `body_layout.pack`.
    methods : array of layout.METHOD, shape (1,)
        The solver.

    Returns
    -------
    int
        FINISHED, UNFINISHED or TOO_FAST.

    """
    stop = progress[0].stop
    place, reached = _run_segments(
        progress, Requested(times_ns, order, motion, closed), rows, layout.load_body(constants),
        layout.load_method(methods), intervals.load_terms(rows.terms, constants, progress))
    layout.store_place(place, progress)
    layout.store_states(reached, progress)
    if stepping.is_too_fast(reached.latest):
        return TOO_FAST
    return UNFINISHED if place.row < stop and place.done < len(times_ns) else FINISHED


# Each pass of the loop advances to the next requested time within the row, or to the end of the
# row if no requested time is left in it. Each pass falls into one of the following cases, which
# are marked by their names in the code below.
#   SKIP         the row belongs to a coast that the next row continues, and contains no output
#   CLOSED FORM  a coast is computed from its beginning
#   REACHED      the time is that of the last grid point, so there is nothing to compute
#   SHORT STEPS  several consecutive rows take one short step each
#   SHORT STEP   one short step leads to a time within such a row
#   STEPS        steps on the grid of the segment, by the series or by a solver with fixed steps
# The pass then stores the output, if there is one. A new segment begins at the end of a row,
# unless a coast continues. The arrays are read from the records once, before the loop, rather than
# in every pass.
@internal
def _run_segments(progress: NDArray[Any], outputs: Requested, rows: Rows, body: Body,
                  method: Method, terms: BodyTerms | None) -> tuple[Place, GridStates]:
    grid, begin, latest = layout.load_states(progress)
    grid_ns, begin_ns, row, done = layout.load_place(progress)
    stop, budget = progress[0].stop, progress[0].budget
    times_ns, _, motion, closed = outputs
    row_times_ns, torques, in_space, spans, _ = rows
    table, states = scratch(WORKSPACE), intervals.wheel_states(terms)
    friction.continue_from(states, grid_ns == begin_ns)
    coast, prepared = free_motion.start_only(begin, free_motion.NEAR_SEPARATRIX), False
    while row < stop and done < len(times_ns) and budget > 0:
        now = intervals.interval(row_times_ns, torques, spans, row)
        loads = intervals.loads_of(terms, row, now.span)
        coasting = now.is_zero and not intervals.acts(loads)
        continues = coasting and now.end_ns < NEVER_NS and coasts(torques, terms, row + 1)
        output, asked, time_ns = _next_time(outputs, done, now.end_ns)
        if continues and not asked:  # SKIP
            row, budget = row + 1, budget - 1
            continue
        seconds, degree = (time_ns - grid_ns) / 1e9, 0 if coasting else torques.shape[1] // 2
        turning = not now.is_zero and in_space[row]
        is_held = intervals.are_polynomials(terms) and degree == 0 and not turning
        acceleration = acceleration_from_torque(body.coefficients, now.torque[0])
        held = intervals.during_step(terms, row, seconds)
        by_formula = coasting and _is_closed(method, begin, time_ns - begin_ns)
        if by_formula and not prepared:
            coast, prepared = free_motion.prepare(begin, body.frame), True
        if by_formula and coast.kind != free_motion.NEAR_SEPARATRIX:
            latest = free_motion.at(coast, time_ns - begin_ns)  # CLOSED FORM
            closed[row + 1] = True
            budget -= layout.STEP_COST
        elif time_ns == grid_ns:  # REACHED
            latest = grid
            friction.go_back(states)
        elif is_held and grid_ns == begin_ns and _is_short(
                grid, time_ns - grid_ns, acceleration, held, method):
            if time_ns == now.end_ns and row >= 0 and not coasting:
                budget += row  # SHORT STEPS
                grid, grid_ns, row, done = _run_short_steps(
                    grid, Place(grid_ns, begin_ns, row, done), min(budget, stop), outputs, rows,
                    body, method, terms)
                begin, latest, begin_ns, prepared = grid, grid, grid_ns, False
                budget -= row
                continue
            latest = short_step.step(  # SHORT STEP
                grid, seconds, body.coefficients, acceleration, method.tolerance, held)
        else:  # STEPS
            drive = intervals.drive(now, torques, row, degree, turning, body, loads)
            grid, grid_ns, latest, arrived, budget = stepping.advance(
                grid, grid_ns, time_ns, drive, body, method, Series(table, None), budget, loads)
            if not arrived:
                break
        if asked:
            _store_output(latest, states, output, motion)
            done += 1
        if time_ns == now.end_ns and not continues:
            grid, grid_ns, begin, begin_ns, prepared = latest, time_ns, latest, time_ns, False
            friction.begin_segment(states)
            row += 1
        budget -= 1
    return Place(grid_ns, begin_ns, row, done), GridStates(grid, begin, latest)


@inlined
def _next_time(outputs: Requested, done: int, end_ns: int) -> tuple[int, bool, int]:
    # Return the next output, whether its time is at most `end_ns`, and the earlier of both times.
    output = done if len(outputs.order) == 0 else outputs.order[done]
    asked = outputs.times_ns[output] <= end_ns
    return output, asked, outputs.times_ns[output] if asked else end_ns


@inlined
def _store_output(latest: vector.KernelState, states: friction.WheelStates | None, output: int,
                  motion: Floats) -> None:
    motion_layout.store(latest, output, motion)
    friction.store(states, output)


@inlined
def _is_closed(method: Method, begin: vector.KernelState, span_ns: int) -> bool:
    # Return whether to compute a coast in closed form.
    if span_ns == 0:
        return False
    speed = method.closed_form_beyond * 1e9 / span_ns
    return method.closed_form_beyond < 0.0 or vector.dot(begin[0], begin[0]) > speed * speed


@inlined
def _is_short(grid: vector.KernelState, rest_ns: int, acceleration: vector.Vector,
              held: short_step.HeldLoads | None, method: Method) -> bool:
    # Return whether one short step is accurate enough. The torque must be held, and must be given
    # in body axes.
    return (rest_ns < method.max_step_ns and not method.fixed_step
            and short_step.is_accurate(grid, rest_ns / 1e9, acceleration, method.tolerance, held))


@internal
def _run_short_steps(grid: vector.KernelState, place: Place, last: int, outputs: Requested,
                     rows: Rows, body: Body, method: Method,
                     terms: BodyTerms | None) -> tuple[vector.KernelState, int, int, int]:
    # Step from row to row under held body torques. Stop at the beginning of the row `last`, or
    # earlier at a row that needs more than one short step or has an output within it. Outputs at
    # the beginning of a row are filled, except at the beginning of the row `last`. Return state,
    # grid_ns, row and done. This is a separate function so that the compiler keeps the state in
    # registers.
    grid_ns, row, done = place.grid_ns, place.row, place.done
    times_ns, order, motion, _ = outputs
    row_times_ns, torques, in_space, _, _ = rows
    held = intervals.during_step(terms, row, 1.0)
    last = min(last, len(row_times_ns) - 1)
    while row < last and done < len(times_ns):
        output = done if len(order) == 0 else order[done]
        if times_ns[output] == grid_ns:
            motion_layout.store(grid, output, motion)
            done += 1
            continue
        next_ns, torque = row_times_ns[row + 1], intervals.coefficient(torques, row, 0)
        acceleration = acceleration_from_torque(body.coefficients, torque)
        span_ns = next_ns - grid_ns
        seconds = span_ns / 1e9
        if intervals.vary(terms):
            held = intervals.during_step(terms, row, seconds)
        if (times_ns[output] < next_ns or span_ns >= method.max_step_ns
                or (in_space[row] and not vector.is_zero(torque))
                or (vector.is_zero(torque) and coasts(torques, terms, row))
                or not short_step.is_accurate(grid, seconds, acceleration, method.tolerance,
                                              held)):
            break
        grid = short_step.step(grid, seconds, body.coefficients, acceleration,
                               method.tolerance, held)
        grid_ns = next_ns
        row += 1
    return grid, grid_ns, row, done


@njit
def run_tangents(progress: Annotated[NDArray[Any], '1', PROGRESS, WRITTEN],
                 requested: tangents.RequestedTangents,
                 rows: Annotated[Rows, 'fields', 'lags', 'friction']
                 | Annotated[Rows, 'friction'],
                 constants: Annotated[Floats, f'{body_layout.SIZE}'],
                 methods: Annotated[NDArray[Any], '1', METHOD],
                 latest: Annotated[Floats, f'{tangents.SIZE}g L', WRITTEN], seeds: tangents.Seeds,
                 work: Annotated[Floats, f'{tangents.OF_VECTOR}v+{tangents.WORKSPACE} L',
                                 WRITTEN]) -> int:
    """
    Advance tangents from row to row, and store them at the requested times; see `tangents`.

    The motion is computed by the series only, with steps that end at the requested times, so it
    differs from that of `run` by rounding errors.

    Parameters
    ----------
    progress, rows, constants, methods
        See `run`.
    requested : RequestedTangents
        The requested times and the results.
    latest, seeds, work
        See `tangents.Tangents`. The kernel updates `latest`.

    Returns
    -------
    int
        FINISHED, UNFINISHED or TOO_FAST.

    """
    times_ns, outputs, motion = requested
    stop, budget, result = progress[0].stop, progress[0].budget, FINISHED
    body, method = layout.load_body(constants), layout.load_method(methods)
    terms = intervals.load_terms(rows.terms, constants, progress)
    grid, table = layout.load_states(progress).grid, scratch(WORKSPACE)
    stiffness = scratch(tangents.STIFFNESS)
    now_ns, _, row, done = layout.load_place(progress)
    while row < stop and done < len(times_ns) and result == FINISHED:
        now = intervals.interval(rows.times_ns, rows.torques, rows.spans, row)
        loads = intervals.loads_of(terms, row, now.span)
        asked = times_ns[done] <= now.end_ns
        time_ns = times_ns[done] if asked else now.end_ns
        turning = not now.is_zero and rows.in_space[row]
        degree = rows.torques.shape[1] // 2
        drive = intervals.drive(now, rows.torques, row, degree, turning, body, loads)
        following = tangents.Tangents(latest, seeds, work, stiffness, len(rows.times_ns), row)
        reached = stepping.advance(grid, now_ns, time_ns, drive, body, method,
                                   Series(table, following), budget, loads)
        budget = reached.budget
        if reached.arrived:
            grid, now_ns = reached.latest, time_ns
            if asked:
                for k in range(len(latest)):
                    lanes.store(outputs[done], k, lanes.load(latest, k))
                motion_layout.store(grid, done, motion)
                done += 1
            if time_ns == now.end_ns:
                row += 1
                tangents.enter(following, row, grid, body.coefficients)
        else:
            grid, now_ns = reached.grid, reached.grid_ns
            result = TOO_FAST if stepping.is_too_fast(grid) else UNFINISHED
    layout.store_place(Place(now_ns, now_ns, row, done), progress)
    layout.store_states(GridStates(grid, grid, grid), progress)
    return result
