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
Advance a group of runs together, one run per lane.

Under held torques in body axes, a group does part of the work of `loop.run`, with bit-identical
results. A group takes two kinds of steps: Taylor steps within a segment, to grid points and
outputs, and single steps from stamp to stamp. All other steps are left to `loop.run`, which
continues each run from the point where the group stopped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import (
    body_layout,
    euler_equations,
    four,
    lanes,
    layout,
    motion_layout,
    short_step,
    state_layout,
    stepping,
    taylor,
    vector,
)
from rigid_body_ros.kernels import group as runs
from rigid_body_ros.kernels.group import Group
from rigid_body_ros.kernels.jit import inlined, internal
from rigid_body_ros.kernels.lanes import LANES
from rigid_body_ros.kernels.layout import Body, FASTEST, Method, Place, Rows

#: One step of a group takes about as long as this many steps of single runs.
_FEWEST_RUNS = 3
#: Once one lane has been idle for this many steps, all idle lanes get new runs. Several runs then
#: begin together, and similar runs that begin together need series of similar orders.
_PATIENCE = 64


class Shared(NamedTuple):
    """The inputs that all runs of a group share during a segment."""

    #: The row in force, and the time in ns when the next row begins. The time is NEVER_NS if there
    #: is no next row.
    row: int
    end_ns: int
    #: The requested times; see `layout.Requested`.
    times_ns: NDArray[np.int64]
    order: NDArray[np.intp]
    #: The form of the inertia tensors; see `vector.Coefficients`.
    form: int


class Advanced(NamedTuple):
    """The result of `advance`."""

    #: The number of steps taken. If it reaches `group.BUDGET`, there may be more steps to take.
    steps: int
    #: The number of waiting runs that were given a lane or skipped.
    taken: int
    #: The row up to which `loop.run` must advance the runs before they can step together again.
    until: int


@internal
def advance(group: Group, count: int, waiting: NDArray[np.intp], times_ns: NDArray[np.int64],
            order: NDArray[np.intp], rows: Rows, method: Method) -> Advanced:
    """
    Advance the runs of a group for as long as they can step together.

    Parameters
    ----------
    group : Group
        The runs. The kernel updates their rows, progress and motions.
    count : int
        Number of distinct runs in the group. They are in the first `count` lanes.
    waiting : intp (n,)
        Runs that have not begun. They take over the lanes of runs that end.
    times_ns, order : array
        See `loop.run`.
    rows : Rows
        The rows, which are the same for all runs.
    method : Method
        The method for computing a step.

    Returns
    -------
    Advanced

    """
    first = group.rows[0]
    body = layout.load_body(group.constants[first])
    place, stop = layout.load_place(group.progress[first:first + 1]), group.progress[first].stop
    if (method.fixed_step or rows.torques.shape[1] > 1 or place.done == len(times_ns)
            or not 0 <= place.row < stop):
        return Advanced(0, 0, place.row)
    steps, row = 0, place.row
    if _are_alike(group, place, body.coefficients.form):
        limit_ns = times_ns[place.done if len(order) == 0 else order[place.done]]
        steps = _advance_rows(group, place, limit_ns, rows, stop, body, method)
        row += steps
    if row >= stop or rows.in_space[row]:
        return Advanced(steps, 0, row + 1)
    end_ns = rows.times_ns[row + 1] if row + 1 < len(rows.times_ns) else NEVER_NS
    segment = Shared(row, end_ns, times_ns, order, body.coefficients.form)
    more, taken = _advance_segment(group, count, waiting, segment, body, method)
    return Advanced(steps + more, taken, row + 1)


@internal
def _are_alike(group: Group, place: Place, form: int) -> bool:
    # Return whether all runs have inertia tensors of the same form, the same next output, and the
    # same row in force.
    for row in group.rows:
        other = group.progress[row]
        if (other.row != place.row or other.done != place.done
                or layout.form_of(group.constants[row]) != form):
            return False
    return True


@internal
def _advance_rows(group: Group, place: Place, limit_ns: int, rows: Rows, stop: int, body: Body,
                  method: Method) -> int:
    """
    Advance from row to row, as long as one step is enough to reach the next row.

    Parameters
    ----------
    group : Group
        The runs, which must have the same next output and the same row in force.
    place : Place
        The progress of the first run.
    limit_ns : int
        The time of the next output, beyond which the group does not step.
    rows : Rows
        The rows, which are the same for all runs.
    stop : int
        The row at which to stop.
    body : Body
        The body of the first run. The inertia tensors of all runs must have the same form.
    method : Method
        The method for computing a step.

    Returns
    -------
    int
        The number of steps taken.

    """
    times_ns, row, grid_ns = rows.times_ns, place.row, place.grid_ns
    if (row + runs.FEWEST >= len(times_ns) or times_ns[row + runs.FEWEST] > limit_ns
            or not _begin_together(group, grid_ns)):
        return 0
    for lane in range(LANES):
        runs.load(group, lane)
    lanes.align_stack()
    coefficients = body_layout.coefficients(group.work[runs.CONSTANTS:], body.coefficients.form)
    state = state_layout.load(group.work, runs.STATE)
    gain, table = lanes.load(group.work, runs.GAIN), group.work[runs.TABLE:]
    while row < min(stop, len(times_ns) - 1, place.row + runs.BUDGET):
        next_ns, torque = times_ns[row + 1], _torques(group, row, gain)
        acceleration = euler_equations.acceleration_from_torque(coefficients, torque)
        span_ns = next_ns - grid_ns
        seconds = span_ns / 1e9
        if (limit_ns < next_ns or span_ns >= min(method.max_step_ns, runs.FARTHEST)
                or rows.in_space[row] or not _acts_in_every_lane(torque)):
            break
        short = short_step.is_accurate(state, seconds, acceleration, method.tolerance, None)
        if lanes.every(short):
            state = short_step.step(state, seconds, coefficients, acceleration,
                                    method.tolerance, None)
        elif lanes.some(short) or not _is_full_step(state, span_ns, acceleration, method):
            break
        else:
            state = runs.step(state, lanes.zero(gain) + seconds, coefficients,
                              acceleration, method.tolerance, table)
        grid_ns = next_ns
        row += 1
    state_layout.store(state, group.work, runs.STATE)
    for lane in range(LANES):
        runs.begin_segment(group, lane, grid_ns, row, place.done)
    return row - place.row


@inlined
def _begin_together(group: Group, time_ns: int) -> bool:
    # Return whether every run is at the beginning of a segment that begins at `time_ns`.
    for row in group.rows:
        progress = group.progress[row]
        if progress.grid_ns != time_ns or progress.begin_ns != time_ns:
            return False
    return True


@inlined
def _torques(group: Group, index: int, gain: float) -> vector.Vector:
    # Return the torques of a row, with one lane per run.
    if len(group.torques) == 1:
        return vector.scale(gain, runs.torque(group, 0, index))
    for lane in range(LANES):
        torque = runs.torque(group, lane, index)
        for k in range(3):
            group.work[runs.TORQUE + k, lane] = torque[k]
    return vector.scale(gain, runs.torques(group.work))


@inlined
def _acts_in_every_lane(torque: vector.Vector) -> bool:
    # Return whether there is a torque in every lane. If a run has no torque, `loop.run` may use
    # the closed form for this run.
    return lanes.every(vector.total(four.absolute(torque)) > 0.0)


@inlined
def _is_full_step(state: vector.KernelState, span_ns: int, acceleration: vector.Vector,
                  method: Method) -> bool:
    # Return whether one Taylor step covers the span for every run.
    square, rest_ns = vector.dot(state[0], state[0]), lanes.zero(state[0][0]) + float(span_ns)
    bound = math.sqrt(vector.dot(acceleration, acceleration))
    left = lanes.where(runs.is_one_step(rest_ns, square, bound, method), 0.0, rest_ns)
    return lanes.every(runs.full_steps_ns(square, bound, method) >= left)


@internal
def _advance_segment(group: Group, count: int, waiting: NDArray[np.intp], segment: Shared,
                     body: Body, method: Method) -> tuple[int, int]:
    """
    Advance the runs of a group, and then the runs that wait for a lane, through a segment.

    Parameters
    ----------
    group : Group
        The runs. When a waiting run takes over a lane, the kernel updates `group.rows`.
    count : int
        Number of distinct runs in the group. They are in the first `count` lanes.
    waiting : intp (n,)
        Runs that have not begun.
    segment : Shared
        The inputs that all runs share.
    body : Body
        The body of the first run. Other runs take part only if their inertia tensors have the same
        form.
    method : Method
        The method for computing a step.

    Returns
    -------
    int, int
        The number of steps taken, and the number of waiting runs that were given a lane or
        skipped.

    """
    if not _are_many(group, segment, body, method):
        return 0, 0
    going = group.going
    for lane in range(LANES):
        going[lane] = lane < count and _enter(group, lane, segment, method)
        if not going[lane]:
            runs.load(group, lane)
            _idle(group.work, lane)
    taken, steps, replace_at = 0, 0, runs.BUDGET
    while steps < runs.BUDGET:
        if steps >= replace_at or _count(going) == 0:
            taken += _replace(group, waiting[taken:], segment, method)
            replace_at = runs.BUDGET
        if _count(going) < (1 if taken < len(waiting) else _FEWEST_RUNS):
            break
        more, is_slow = _step_together(group.work, segment.form, method, replace_at - steps)
        steps += more
        if not is_slow:
            break  # leave it to `loop.run` to report the body that is too fast
        for lane in range(LANES):
            if going[lane] and group.work[runs.MOVES, lane] == 0.0:
                going[lane] = _arrive(group, lane, segment, method)
                if not going[lane]:
                    _idle(group.work, lane)
                    replace_at = min(replace_at, steps + _PATIENCE)
    for lane in range(LANES):
        if going[lane]:
            runs.store(group, lane)
            group.progress[group.rows[lane]].grid_ns = _grid_ns(group, lane)
    return steps, taken


@inlined
def _count(going: NDArray[np.bool_]) -> int:
    count = 0
    for lane in range(LANES):
        count += going[lane]
    return count


@inlined
def _are_many(group: Group, segment: Shared, body: Body, method: Method) -> bool:
    # Return whether the first run has so many steps left that forming a group is worthwhile.
    first = group.rows[0]
    place = layout.load_place(group.progress[first:first + 1])
    acceleration = euler_equations.acceleration_from_torque(
        body.coefficients, _torque(group, 0, segment))
    w = state_layout.load(group.progress[group.rows[0]].grid, 0)[0]
    seconds = taylor.step_seconds(
        vector.dot(w, w), math.sqrt(vector.dot(acceleration, acceleration)), method.angle)
    rest_ns = min(segment.end_ns, _output_ns(len(segment.times_ns) - 1, segment)) - place.grid_ns
    return runs.FEWEST * stepping.full_step_ns(seconds, method) < rest_ns


@inlined
def _output_ns(k: int, segment: Shared) -> int:
    # Return the requested time that comes k-th in ascending order.
    return segment.times_ns[_row(k, segment)]


@inlined
def _row(k: int, segment: Shared) -> int:
    return k if len(segment.order) == 0 else segment.order[k]


@inlined
def _torque(group: Group, lane: int, segment: Shared) -> vector.Vector:
    gain = group.gains[group.rows[lane]]
    return vector.scale(gain, runs.torque(group, lane, segment.row))


@internal
def _enter(group: Group, lane: int, segment: Shared, method: Method) -> bool:
    # If a run can step together with the other runs, load it into its lane and return True.
    row = group.rows[lane]
    place, torque = layout.load_place(group.progress[row:row + 1]), _torque(group, lane, segment)
    if (_is_done(group, row, segment) or place.row != segment.row
            or layout.form_of(group.constants[row]) != segment.form
            or vector.is_zero(torque)):  # without torque, `loop.run` may use the closed form
        return False
    runs.load(group, lane)
    for k in range(3):
        group.work[runs.TORQUE + k, lane] = torque[k]
    return _aim(group, lane, segment, method)


@inlined
def _aim(group: Group, lane: int, segment: Shared, method: Method) -> bool:
    # Set the time up to which a run steps: the time of the next output or the end of the segment,
    # whichever comes first. Return False if the run is finished, or if `loop.run` has to continue
    # it.
    row = group.rows[lane]
    progress = group.progress[row]
    grid_ns, done = progress.grid_ns, progress.done
    while done < len(segment.times_ns) and _output_ns(done, segment) == grid_ns:
        motion_layout.store_packed(group.work[runs.STATE:, lane], _row(done, segment),
                                   group.motions[row])
        done += 1
    progress.done = done
    if done == len(segment.times_ns):
        return False
    group.limits_ns[lane] = min(_output_ns(done, segment), segment.end_ns)
    rest_ns = group.limits_ns[lane] - grid_ns
    group.work[runs.REST, lane] = rest_ns
    return rest_ns <= runs.FARTHEST and not (grid_ns == progress.begin_ns and _is_short(
        group, lane, rest_ns, segment, method))


@inlined
def _is_short(group: Group, lane: int, rest_ns: int, segment: Shared, method: Method) -> bool:
    # Return whether `loop.run` would take a short step from the beginning of the segment.
    row = group.rows[lane]
    acceleration = euler_equations.acceleration_from_torque(
        body_layout.coefficients(group.constants[row], segment.form),
        _torque(group, lane, segment))
    return short_step.is_accurate(state_layout.load(group.progress[row].grid, 0), rest_ns / 1e9,
                                  acceleration, method.tolerance, None)


@inlined
def _idle(work: Floats, lane: int) -> None:
    # Put a body at rest into a lane. The terms of this body's series are zero, and the lane never
    # reaches its time limit.
    for k in range(3):
        work[runs.STATE + state_layout.RATES + k, lane] = 0.0
        work[runs.TORQUE + k, lane] = 0.0
    work[runs.REST, lane] = math.inf


@internal
def _step_together(work: Floats, form: int, method: Method, budget: int) -> tuple[int, bool]:
    # Step until a run reaches its time limit, until a body spins faster than `FASTEST`, or until
    # `budget` steps have been taken. Return the number of steps, and whether no body is too fast.
    lanes.align_stack()
    coefficients = body_layout.coefficients(work[runs.CONSTANTS:], form)
    acceleration = euler_equations.acceleration_from_torque(
        coefficients, runs.torques(work))
    bound = math.sqrt(vector.dot(acceleration, acceleration))
    state, rest = state_layout.load(work, runs.STATE), lanes.load(work, runs.REST)
    table, steps, arrives, is_slow = work[runs.TABLE:], 0, False, True
    while steps < budget and not arrives:
        square = vector.dot(state[0], state[0])
        step_ns = runs.full_steps_ns(square, bound, method)
        moves = step_ns < lanes.where(runs.is_one_step(rest, square, bound, method), 0.0, rest)
        latest = runs.step(state, lanes.where(moves, step_ns, rest) / 1e9, coefficients,
                           acceleration, method.tolerance, table)
        steps += 1
        is_slow = lanes.every(vector.dot(latest[0], latest[0]) <= FASTEST * FASTEST)
        if not is_slow:
            break
        state, rest = _choose(moves, latest, state), lanes.where(moves, rest - step_ns, rest)
        arrives = not lanes.every(moves)
        lanes.store(work, runs.MOVES, lanes.where(moves, 1.0, 0.0))
        if arrives:
            state_layout.store(latest, work, runs.LATEST)
    state_layout.store(state, work, runs.STATE)
    lanes.store(work, runs.REST, rest)
    return steps, is_slow


@inlined
def _choose(condition: bool, one: vector.KernelState,
            other: vector.KernelState) -> vector.KernelState:
    # Return the state `one` in each lane in which the condition holds, and the state `other` in
    # all other lanes.
    return (four.choose(condition, one[0], other[0]), four.choose(condition, one[1], other[1]),
            four.choose(condition, one[2], other[2]), four.choose(condition, one[3], other[3]))


@inlined
def _arrive(group: Group, lane: int, segment: Shared, method: Method) -> bool:
    # Fill the output of a run that has reached its time limit. Return True if the run can go on in
    # its lane. Otherwise return False, and copy the state of the lane back to the run unless the
    # run is finished.
    row, limit_ns = group.rows[lane], group.limits_ns[lane]
    progress = group.progress[row]
    grid_ns, done = _grid_ns(group, lane), progress.done
    ends = limit_ns == segment.end_ns
    if _output_ns(done, segment) == limit_ns and (not ends or segment.end_ns < NEVER_NS):
        motion_layout.store_packed(group.work[runs.LATEST:, lane], _row(done, segment),
                                   group.motions[row])
        done += 1
    progress.grid_ns, progress.done = grid_ns, done
    if ends and segment.end_ns < NEVER_NS:
        for k in range(state_layout.SIZE):
            group.work[runs.STATE + k, lane] = group.work[runs.LATEST + k, lane]
        runs.begin_segment(group, lane, limit_ns, segment.row + 1, done)
        return False
    if not ends and _aim(group, lane, segment, method):
        return True
    if done < len(segment.times_ns):
        runs.store(group, lane)
    return False


@inlined
def _grid_ns(group: Group, lane: int) -> int:
    # Return the time in ns of the state on the grid.
    return group.limits_ns[lane] - int(group.work[runs.REST, lane])


@internal
def _replace(group: Group, waiting: NDArray[np.intp], segment: Shared, method: Method) -> int:
    # When a run has filled all its outputs, give its lane to the next waiting run that can step
    # with the others. Waiting runs that cannot step with the others are skipped, and left to
    # another group. Return the number of waiting runs that were given a lane or skipped.
    taken, going = 0, group.going
    for lane in range(LANES):
        row = group.rows[lane]
        if not going[lane] and _is_done(group, row, segment):
            while taken < len(waiting) and not going[lane]:
                group.rows[lane] = waiting[taken]
                taken += 1
                going[lane] = _enter(group, lane, segment, method)
            if not going[lane]:
                group.rows[lane] = row
                _idle(group.work, lane)
    return taken


@inlined
def _is_done(group: Group, row: int, segment: Shared) -> bool:
    return group.progress[row].done == len(segment.times_ns)
