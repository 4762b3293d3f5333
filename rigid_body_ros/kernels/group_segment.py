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
Advance a group of runs through a segment, stopping at each output and at the end of the segment.

Every lane has its own grid and its own outputs. When a run has filled all its outputs, a waiting
run takes over the lane.
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
from rigid_body_ros.kernels.layout import Body, FASTEST, Method

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


@internal
def advance(group: Group, count: int, waiting: NDArray[np.intp], segment: Shared, body: Body,
            method: Method) -> tuple[int, int]:
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
            _leave(group, lane, group.limits_ns[lane])
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
    grid_ns, done = _grid_ns(group, lane, limit_ns), progress.done
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
def _grid_ns(group: Group, lane: int, limit_ns: int) -> int:
    # Return the time in ns of the state on the grid.
    return limit_ns - int(group.work[runs.REST, lane])


@inlined
def _leave(group: Group, lane: int, limit_ns: int) -> None:
    # Copy the state on the grid and its time back to the run.
    runs.store(group, lane)
    group.progress[group.rows[lane]].grid_ns = _grid_ns(group, lane, limit_ns)


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
