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
A group of runs, one in each lane, and the steps that they take together.

The workspace has a column for each lane.
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

#: Smallest number of steps in a segment, or of stamps before the next output, for which gathering
#: a group saves time.
FEWEST = 4
#: Number of steps after which to return, so that Python handles signals.
BUDGET = 20_000
#: Longest time that a group steps at once, ns. Up to this time, doubles represent the remaining
#: nanoseconds exactly.
FARTHEST = 2 ** 52
#: Offsets of the rows of a workspace: the states on the grid, the latest states, the coefficients
#: of Euler's equations, the factors of the torque, the torques, N m, the time left, ns, whether
#: more than one step is left, and the table of the series.
STATE, LATEST, CONSTANTS = 0, state_layout.SIZE, 2 * state_layout.SIZE
GAIN = CONSTANTS + body_layout.MOMENTS
TORQUE = GAIN + 1
REST, MOVES, TABLE = TORQUE + 3, TORQUE + 4, TORQUE + 5
ROWS = TABLE + series_table.WORKSPACE_OF_LANES


class Group(NamedTuple):
    """The arrays of all runs, and which runs are in the group."""

    #: intp (LANES,): the run in each lane. The last run may fill several lanes.
    rows: NDArray[np.intp]
    #: An element or row for each run; see `loop.run`.
    progress: NDArray[Any]
    motions: Floats
    constants: Floats
    #: Factors of the torque, an element for each run.
    gains: Floats
    #: Torques of the rows, shape (k, ...). Run i uses the torques at index i % k.
    torques: Floats
    #: The array that `workspace` returns.
    work: Floats
    #: bool (LANES,) and int64 (LANES,): whether the run in a lane steps, and up to which time, ns.
    going: NDArray[np.bool_]
    limits_ns: NDArray[np.int64]


def workspace(lanes: int) -> Floats:
    """Return an array, shape (n, lanes), in which each row is in one cache line."""
    line = 64 // 8
    buffer = np.empty(ROWS * lanes + line)
    start = -(buffer.ctypes.data // 8) % line
    return buffer[start:start + ROWS * lanes].reshape(ROWS, lanes)


@inlined
def load(group: Group, lane: int) -> None:
    """Copy the state on the grid, the body and the torque factor of a run to the lane."""
    row = group.rows[lane]
    group.work[GAIN, lane] = group.gains[row]
    grid = group.progress[row].grid
    for k in range(state_layout.SIZE):
        group.work[STATE + k, lane] = grid[k]
    for k in range(body_layout.MOMENTS):
        group.work[CONSTANTS + k, lane] = group.constants[row, k]


@inlined
def store(group: Group, lane: int) -> None:
    """Copy the state on the grid from a lane back to the run in this lane."""
    grid = group.progress[group.rows[lane]].grid
    for k in range(state_layout.SIZE):
        grid[k] = group.work[STATE + k, lane]


@inlined
def begin_segment(group: Group, lane: int, time_ns: int, row: int, done: int) -> None:
    """Copy the state on the grid from a lane back to the run, as the beginning of a segment."""
    store(group, lane)
    progress = group.progress[group.rows[lane]]
    for k in range(state_layout.SIZE):
        progress.begin[k] = progress.grid[k]
    progress.grid_ns, progress.begin_ns, progress.row, progress.done = time_ns, time_ns, row, done


@inlined
def torque(group: Group, lane: int, index: int) -> vector.Vector:
    """Return the torque of a run, N m, not multiplied by the factor of the run."""
    torques = group.torques
    slot = group.rows[lane] % len(torques)
    return vector.of(torques[slot, index, 0, 0], torques[slot, index, 0, 1],
                     torques[slot, index, 0, 2])


@inlined
def torques(work: Floats) -> vector.Vector:
    """Return the torques in the workspace, N m."""
    return vector.of(lanes.load(work, TORQUE), lanes.load(work, TORQUE + 1),
                     lanes.load(work, TORQUE + 2))


@inlined
def step(state: vector.KernelState, seconds: float, coefficients: vector.Coefficients,
         acceleration: vector.Vector, tolerance: float, table: Floats) -> vector.KernelState:
    """Return the states after a step of the series under a held torque."""
    none = four.zero(acceleration)
    bound = math.sqrt(vector.dot(acceleration, acceleration))
    drive = taylor.SeriesDrive((acceleration, none, none, none), 0, False, bound)
    return taylor.step(state, seconds, coefficients, drive, tolerance, table, None)


@inlined
def full_steps_ns(square: float, bound: float, method: Method) -> float:
    """Return, in each lane, the length of a step on the grid, ns, as `stepping.full_step_ns`."""
    seconds = 2.0 * method.angle / taylor.turning_rate(square, bound, method.angle)
    longest, step_ns = float(method.max_step_ns), seconds * 1e9
    step_ns = lanes.truncated(lanes.where(step_ns < longest, step_ns, longest))
    return lanes.where(step_ns < 1.0, 1.0, step_ns)


@inlined
def is_one_step(rest_ns: float, square: float, bound: float, method: Method) -> bool:
    """Return, in each lane, whether one step covers the time left, as `stepping.is_one_step`."""
    rest = rest_ns / 1e9
    return lanes.both(rest_ns <= float(method.max_step_ns),
                      rest * rest * (square + bound) < 0.01)
