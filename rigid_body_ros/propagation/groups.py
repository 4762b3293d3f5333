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

A group takes the common part of the loop, in the bits of `loop.run`: steps of the series on the
grid of a segment and to the outputs in it, and single steps from stamp to stamp, under held
torques in body axes. It leaves each run at a place from which `loop.run` continues, and that takes
all other cases.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels.jit import internal
from rigid_body_ros.propagation import group_segment, group_stamps, layout
from rigid_body_ros.propagation.group import Group
from rigid_body_ros.propagation.group_segment import Shared
from rigid_body_ros.propagation.layout import Log, Place


class Advanced(NamedTuple):
    """The result of `advance`."""

    #: The number of steps. After `group.BUDGET` of them there may be more.
    steps: int
    #: How many runs no longer wait.
    taken: int
    #: The sample to which `loop.run` brings the runs of the group before they step together again.
    until: int


@internal
def advance(group: Group, count: int, waiting: NDArray[np.intp], times_ns: NDArray[np.int64],
            order: NDArray[np.intp], log: Log, settings: Floats) -> Advanced:
    """
    Advance the runs of a group as far as they can step together.

    Parameters
    ----------
    group : Group
        Rows, states, progress and motions are changed.
    count : int
        How many lanes have a run of their own.
    waiting : intp (n,)
        Runs that have not begun, which take the place of those that end.
    times_ns, order : array
        As for `loop.run`, where `order` is `rows`.
    log : Log
        Of all runs.
    settings : float64 (7,)
        See `layout.pack_settings`.

    Returns
    -------
    Advanced

    """
    method = layout.unpack_method(settings)
    body = layout.unpack_body(group.constants[group.rows[0]])
    place = layout.load_place(group.progress[group.rows[0]])
    if (method.fixed_step or log.polynomials.shape[1] > 1 or place.done == len(times_ns)
            or not 0 <= place.sample < log.stop):
        return Advanced(0, 0, place.sample)
    steps, sample = 0, place.sample
    if _are_alike(group, place, body.form):
        limit_ns = times_ns[place.done if len(order) == 0 else order[place.done]]
        steps = group_stamps.advance(group, place, limit_ns, log, body, method)
        sample += steps
    if sample >= log.stop or log.in_space[sample]:
        return Advanced(steps, 0, sample + 1)
    end_ns = log.stamps_ns[sample + 1] if sample + 1 < len(log.stamps_ns) else NEVER_NS
    ends_at_stamp = end_ns < NEVER_NS
    if 0 < log.timeout_ns < end_ns - log.stamps_ns[sample]:
        end_ns, ends_at_stamp = log.stamps_ns[sample] + log.timeout_ns, False
    segment = Shared(sample, sample - log.first, end_ns, ends_at_stamp, times_ns, order)
    more, taken = group_segment.advance(group, count, waiting, segment, body, method)
    return Advanced(steps + more, taken, sample + 1)


@internal
def _are_alike(group: Group, place: Place, form: int) -> bool:
    # Return whether the runs have bodies of one form, the same next output, and the same sample
    # in force.
    for row in group.rows:
        other = layout.load_place(group.progress[row])
        if (other.sample != place.sample or other.timed_out or other.done != place.done
                or layout.unpack_form(group.constants[row]) != form):
            return False
    return True
