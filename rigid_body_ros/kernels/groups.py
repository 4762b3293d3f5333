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
    # Return whether all runs have inertia tensors of the same form, the same next output, and the
    # same row in force.
    for row in group.rows:
        other = group.progress[row]
        if (other.row != place.row or other.done != place.done
                or layout.form_of(group.constants[row]) != form):
            return False
    return True
