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

"""Advance a group of runs from stamp to stamp, as long as every run needs one step per stamp."""

from __future__ import annotations

import math

from rigid_body_ros.kernels import (
    body_layout,
    euler_equations,
    four,
    lanes,
    short_step,
    state_layout,
    vector,
)
from rigid_body_ros.kernels import group as runs
from rigid_body_ros.kernels.group import Group
from rigid_body_ros.kernels.jit import inlined, internal
from rigid_body_ros.kernels.lanes import LANES
from rigid_body_ros.kernels.layout import Body, Method, Place, Rows


@internal
def advance(group: Group, place: Place, limit_ns: int, rows: Rows, stop: int, body: Body,
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
