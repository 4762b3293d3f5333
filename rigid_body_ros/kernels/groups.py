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
Steps of a group of runs, one in each lane.

Under held torques in body axes, a group takes two kinds of steps in place of `loop.run`, with the
same bits: steps of the series on the grid of a segment and to the outputs in the segment, and
single steps from stamp to stamp. All other steps are left to `loop.run`, which continues each run
from where the group leaves the run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import group_segment, group_stamps, layout
from rigid_body_ros.kernels.group import Group
from rigid_body_ros.kernels.group_segment import Shared
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.kernels.layout import Method, Place, Rows


class Advanced(NamedTuple):
    """The result of `advance`."""

    #: The number of steps. If this number reaches `group.BUDGET`, there may be more steps to do.
    steps: int
    #: The number of runs that no longer wait.
    taken: int
    #: The row to which `loop.run` must bring the runs before they step together again.
    until: int


@internal
def advance(group: Group, count: int, waiting: NDArray[np.intp], times_ns: NDArray[np.int64],
            order: NDArray[np.intp], rows: Rows, method: Method) -> Advanced:
    """
    Advance the runs of a group as far as they can step together.

    Parameters
    ----------
    group : Group
        The runs. The kernel updates their rows, progress and motions.
    count : int
        The number of lanes that contain distinct runs: the first `count` lanes.
    waiting : intp (n,)
        Runs that have not begun. They replace runs that end.
    times_ns, order : array
        See `loop.run`.
    rows : Rows
        The rows of all runs.
    method : Method
        The method of a step.

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
        steps = group_stamps.advance(group, place, limit_ns, rows, stop, body, method)
        row += steps
    if row >= stop or rows.in_space[row]:
        return Advanced(steps, 0, row + 1)
    end_ns = rows.times_ns[row + 1] if row + 1 < len(rows.times_ns) else NEVER_NS
    segment = Shared(row, end_ns, times_ns, order, body.coefficients.form)
    more, taken = group_segment.advance(group, count, waiting, segment, body, method)
    return Advanced(steps + more, taken, row + 1)


@internal
def _are_alike(group: Group, place: Place, form: int) -> bool:
    # Return whether the runs have inertia tensors of the same form, the same next output, and the
    # same row in force.
    for row in group.rows:
        other = group.progress[row]
        if (other.row != place.row or other.done != place.done
                or layout.form_of(group.constants[row]) != form):
            return False
    return True
