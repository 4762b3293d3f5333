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
Data and operations for a group of runs that take their steps together, one run per lane.

The workspace has one column per lane.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import (
    body_layout,
    four,
    lanes,
    series_table,
    state_layout,
    taylor,
    vector,
)
from rigid_body_ros.kernels.jit import inlined
from rigid_body_ros.kernels.layout import Method

#: Forming a group saves time only if the segment takes at least this many steps, or if there are
#: at least this many stamps before the next output.
FEWEST = 4
#: The kernels return after this many steps, so that Python can handle signals.
BUDGET = 20_000
#: A group steps only to a time that is at most this many nanoseconds away. Up to this limit, a
#: double can represent the remaining nanoseconds exactly.
FARTHEST = 2 ** 52
#: The rows at which the parts of the workspace begin. The parts are the states on the grid, the
#: latest states, the coefficients of Euler's equations, the torque factors, the torques in N m,
#: the time left in ns, whether more than one step is left, and the table of the series.
STATE, LATEST, CONSTANTS = 0, state_layout.SIZE, 2 * state_layout.SIZE
GAIN = CONSTANTS + body_layout.MOMENTS
TORQUE = GAIN + 1
REST, MOVES, TABLE = TORQUE + 3, TORQUE + 4, TORQUE + 5
ROWS = TABLE + series_table.WORKSPACE_OF_LANES


class Group(NamedTuple):
    """The arrays of all runs, and the indices of the runs in the group."""

    #: intp (LANES,): the run in each lane. The last run may occupy several lanes.
    rows: NDArray[np.intp]
    #: Arrays with one element or row per run; see `loop.run`.
    progress: NDArray[Any]
    motions: Floats
    constants: Floats
    #: The torque factor of each run.
    gains: Floats
    #: The torques of the rows, shape (k, ...). Run i uses the torques at index i % k.
    torques: Floats
    #: The array that `workspace` returns.
    work: Floats
    #: bool (LANES,) and int64 (LANES,): whether the run in each lane is stepping, and the time in
    #: ns up to which it steps.
    going: NDArray[np.bool_]
    limits_ns: NDArray[np.int64]


def workspace(lanes: int) -> Floats:
    """Return an array of shape (n, lanes), aligned so that no row is split between cache lines."""
    line = 64 // 8
    buffer = np.empty(ROWS * lanes + line)
    start = -(buffer.ctypes.data // 8) % line
    return buffer[start:start + ROWS * lanes].reshape(ROWS, lanes)


@inlined
def load(group: Group, lane: int) -> None:
    """Copy a run into its lane: the state on the grid, the body, and the torque factor."""
    row = group.rows[lane]
    group.work[GAIN, lane] = group.gains[row]
    grid = group.progress[row].grid
    for k in range(state_layout.SIZE):
        group.work[STATE + k, lane] = grid[k]
    for k in range(body_layout.MOMENTS):
        group.work[CONSTANTS + k, lane] = group.constants[row, k]


@inlined
def store(group: Group, lane: int) -> None:
    """Copy the state on the grid from a lane back to its run."""
    grid = group.progress[group.rows[lane]].grid
    for k in range(state_layout.SIZE):
        grid[k] = group.work[STATE + k, lane]


@inlined
def begin_segment(group: Group, lane: int, time_ns: int, row: int, done: int) -> None:
    """
    Copy the state on the grid back to the run in a lane, and begin a new segment of the run.

    The new segment begins at the copied state.
    """
    store(group, lane)
    progress = group.progress[group.rows[lane]]
    for k in range(state_layout.SIZE):
        progress.begin[k] = progress.grid[k]
    progress.grid_ns, progress.begin_ns, progress.row, progress.done = time_ns, time_ns, row, done


@inlined
def torque(group: Group, lane: int, index: int) -> vector.Vector:
    """Return the torque for a run in N m, before it is multiplied by the torque factor."""
    torques = group.torques
    slot = group.rows[lane] % len(torques)
    return vector.of(torques[slot, index, 0, 0], torques[slot, index, 0, 1],
                     torques[slot, index, 0, 2])


@inlined
def torques(work: Floats) -> vector.Vector:
    """Return the torques stored in the workspace, N m."""
    return vector.of(lanes.load(work, TORQUE), lanes.load(work, TORQUE + 1),
                     lanes.load(work, TORQUE + 2))


@inlined
def step(state: vector.KernelState, seconds: float, coefficients: vector.Coefficients,
         acceleration: vector.Vector, tolerance: float, table: Floats) -> vector.KernelState:
    """Return the states after one Taylor step in every lane, during which the torque is held."""
    none = four.zero(acceleration)
    bound = math.sqrt(vector.dot(acceleration, acceleration))
    drive = taylor.SeriesDrive((acceleration, none, none, none), 0, False, bound)
    return taylor.step(state, seconds, coefficients, drive, tolerance, table, None, None)[0]


@inlined
def full_steps_ns(square: float, bound: float, method: Method) -> float:
    """Return the length in ns of a grid step in each lane; see `stepping.full_step_ns`."""
    seconds = 2.0 * method.angle / taylor.turning_rate(square, bound, method.angle)
    longest, step_ns = float(method.max_step_ns), seconds * 1e9
    step_ns = lanes.truncated(lanes.where(step_ns < longest, step_ns, longest))
    return lanes.where(step_ns < 1.0, 1.0, step_ns)


@inlined
def is_one_step(rest_ns: float, square: float, bound: float, method: Method) -> bool:
    """
    Return for each lane whether one step covers the remaining time.

    The condition is the one that `stepping.is_one_step` checks.
    """
    rest = rest_ns / 1e9
    return lanes.both(rest_ns <= float(method.max_step_ns),
                      rest * rest * (square + bound) < 0.01)
