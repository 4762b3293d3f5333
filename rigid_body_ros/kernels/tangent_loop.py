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

"""The time loop of the tangents; see `tangents`."""

from __future__ import annotations

from typing import Annotated, Any

from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import (
    body_layout,
    intervals,
    lanes,
    layout,
    motion_layout,
    series_table,
    stepping,
)
from rigid_body_ros.kernels.jit import njit, scratch, WRITTEN
from rigid_body_ros.kernels.layout import (
    FINISHED,
    GridStates,
    METHOD,
    Place,
    PROGRESS,
    Rows,
    TOO_FAST,
    UNFINISHED,
)
from rigid_body_ros.kernels.stepping import Series
from rigid_body_ros.kernels.tangents import (
    Derivatives,
    enter,
    OF_VECTOR,
    RequestedTangents,
    SIZE,
    STIFFNESS,
    Tangents,
    WORKSPACE,
)


@njit
def run_tangents(progress: Annotated[NDArray[Any], '1', PROGRESS, WRITTEN],
                 requested: RequestedTangents,
                 rows: Annotated[Rows, 'fields', 'lags', 'friction']
                 | Annotated[Rows, 'friction'],
                 constants: Annotated[Floats, f'{body_layout.SIZE}'],
                 methods: Annotated[NDArray[Any], '1', METHOD],
                 latest: Annotated[Floats, f'{SIZE}g L', WRITTEN], derivatives: Derivatives,
                 work: Annotated[Floats, f'{OF_VECTOR}v+{WORKSPACE} L', WRITTEN]) -> int:
    """
    Advance tangents from row to row, and store them at the requested times.

    The motion is computed by the series only, with steps that end at the requested times, so it
    differs from that of `loop.run` by rounding errors.

    Parameters
    ----------
    progress, rows, constants, methods
        See `loop.run`.
    requested : RequestedTangents
        The requested times and the results.
    latest, derivatives, work
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
    grid, table = layout.load_states(progress).grid, scratch(series_table.WORKSPACE)
    stiffness = scratch(STIFFNESS)
    now_ns, _, row, done = layout.load_place(progress)
    while row < stop and done < len(times_ns) and result == FINISHED:
        now = intervals.interval(rows.times_ns, rows.torques, rows.spans, row)
        loads = intervals.loads_of(terms, row, now.span)
        asked = times_ns[done] <= now.end_ns
        time_ns = times_ns[done] if asked else now.end_ns
        turning = not now.is_zero and rows.in_space[row]
        degree = rows.torques.shape[1] // 2
        drive = intervals.drive(now, rows.torques, row, degree, turning, body, loads)
        tangents = Tangents(latest, derivatives, work, stiffness, len(rows.times_ns), row)
        reached = stepping.advance(grid, now_ns, time_ns, drive, body, method,
                                   Series(table, tangents), budget, loads)
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
                enter(tangents, row, grid, body.coefficients)
        else:
            grid, now_ns = reached.grid, reached.grid_ns
            result = TOO_FAST if stepping.is_too_fast(grid) else UNFINISHED
    layout.store_place(Place(now_ns, now_ns, row, done), progress)
    layout.store_states(GridStates(grid, grid, grid), progress)
    return result
