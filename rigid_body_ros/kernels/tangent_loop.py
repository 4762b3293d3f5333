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

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
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
from rigid_body_ros.kernels.tangents import (
    CONSTANTS,
    enter,
    Forcing,
    OF_VECTOR,
    SIZE,
    STIFFNESS,
    Tangents,
    WORKSPACE,
)


@njit
def run_tangents(progress: Annotated[NDArray[Any], '1', PROGRESS, WRITTEN],
                 times_ns: Annotated[Ints, 'm'],
                 rows: Annotated[Rows, 'fields', 'lags', 'friction']
                 | Annotated[Rows, 'friction'],
                 constants: Annotated[Floats, f'{body_layout.SIZE}'],
                 methods: Annotated[NDArray[Any], '1', METHOD],
                 latest: Annotated[Floats, f'{SIZE}g L', WRITTEN],
                 derivatives: Annotated[Floats, f'{CONSTANTS}g L'],
                 have_constants: Annotated[NDArray[np.bool_], 'g'],
                 forcing: Forcing,
                 requested: Annotated[Floats, f'm {SIZE}g L', WRITTEN],
                 motion: Annotated[Floats, '7m', WRITTEN],
                 work: Annotated[Floats, f'{OF_VECTOR}v+{WORKSPACE} L', WRITTEN]) -> int:
    """
    Advance tangents from row to row, and store them at the requested times.

    The motion is computed by the series only, with steps that end at the requested times, so it
    differs from that of `loop.run` by rounding errors.

    Parameters
    ----------
    progress, times_ns, rows, constants, methods
        See `loop.run`. The times are in ascending order.
    latest, derivatives, have_constants, forcing, work
        See `tangents.Tangents`. The kernel updates `latest`.
    requested : float64 (m, 6 g, lanes)
        The tangents at the requested times.
    motion : float64 (7 m,)
        The attitudes and the angular velocities at the requested times; see `motion_layout`.

    Returns
    -------
    int
        FINISHED, UNFINISHED or TOO_FAST.

    """
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
        drive = intervals.drive(now, intervals.low_order_parts(rows.torques, row), degree, turning,
                                body, loads)
        found = Tangents(latest, derivatives, have_constants, forcing, work, stiffness,
                         len(rows.times_ns), row)
        reached = stepping.advance(grid, now_ns, time_ns, drive, body, method, table, budget,
                                   loads, found)
        budget = reached.budget
        if reached.arrived:
            grid, now_ns = reached.latest, time_ns
            if asked:
                for k in range(len(latest)):
                    lanes.store(requested[done], k, lanes.load(latest, k))
                motion_layout.store(grid, done, motion)
                done += 1
            if time_ns == now.end_ns:
                row += 1
                enter(found, row, grid, body.coefficients)
        else:
            grid, now_ns = reached.grid, reached.grid_ns
            result = TOO_FAST if stepping.is_too_fast(grid) else UNFINISHED
    layout.store_place(Place(now_ns, now_ns, row, done), progress)
    layout.store_states(GridStates(grid, grid, grid), progress)
    return result
