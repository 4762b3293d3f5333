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

"""Record the step grid of a state, so that a restarted run continues with the same bits."""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics.state import State


class Origin(NamedTuple):
    """
    The step grid from which a state between two torque changes was computed.

    A state alone does not determine its grid. Without this record, a restart would begin a new
    grid.
    """

    #: The `Options.rule` of the segment.
    rule: Hashable
    #: The time and the state at the beginning of the segment.
    begin_ns: int
    begin: Floats
    #: The time and the state of the last grid point before the state to which this record belongs.
    grid_ns: int
    grid: Floats
    #: Rotor momentum at the beginning of the segment, N m s, and its low-order part, shape (2, 3).
    rotors: Floats
    #: The start of the motion, at which lagging torques are zero. None if no torques lag.
    rest_ns: int | None = None


def origin_of(start: State, rule: Hashable) -> Origin:
    """
    Return the step grid that continues from a state.

    If the state was computed under the same rule, the function returns the grid from which the
    state was computed. Otherwise it returns a new grid that begins at the state.
    """
    origin = start._origin
    if isinstance(origin, Origin) and origin.rule == rule:
        return origin
    return Origin(rule, start.time_ns, start._packed, start.time_ns, start._packed, start._rotors)


def rest_ns_of(start: State) -> int:
    """Return the time, ns, at which lagging torques are zero in a motion from `start`."""
    origin = start._origin
    rest_ns = origin.rest_ns if isinstance(origin, Origin) else None
    return start.time_ns if rest_ns is None else rest_ns


def with_rest(state: State, rest_ns: int) -> State:
    """Return the state, with a record of the time `rest_ns` at which lagging torques were zero."""
    origin = state._origin
    assert isinstance(origin, Origin)
    return State._as_computed(state.time_ns, state._packed, origin._replace(rest_ns=rest_ns),
                              state._rotors)


def without_origin(state: State) -> State:
    """Return the same state without its step grid, so that it begins a new segment."""
    return State._as_computed(state.time_ns, state._packed, None, state._rotors)
