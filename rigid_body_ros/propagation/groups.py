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
grid of a segment, and single steps from stamp to stamp, under held torques in body axes. It leaves
each run at a place from which `loop.run` continues, and that takes all other cases.
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
    short_step,
    state_layout,
    taylor,
    vector,
)
from rigid_body_ros.kernels.jit import inlined, internal
from rigid_body_ros.kernels.lanes import LANES
from rigid_body_ros.propagation import layout, stepping
from rigid_body_ros.propagation.layout import Body, Log, Method, Place
from rigid_body_ros.propagation.options import FASTEST

#: Steps in a segment, or stamps before the next output, from which it pays to gather a group.
_FEWEST = 4
#: Steps after which to return, so that Python handles signals.
BUDGET = 20_000
#: ns; the group steps no further at once, so that doubles count the time left.
_FARTHEST = 2 ** 52
#: Rows of a workspace: the states, the constants of the bodies, the factors of the torque, the
#: torques, N m, the time left, ns, and the table of the series.
_STATE, _CONSTANTS = 0, state_layout.SIZE
_GAIN = _CONSTANTS + body_layout.SIZE
_TORQUE = _GAIN + 1
_REST, _TABLE = _TORQUE + 3, _TORQUE + 4
_ROWS = _TABLE + taylor.WORKSPACE_OF_LANES


class Group(NamedTuple):
    """The arrays of all runs, and which of them are in the group."""

    #: intp (LANES,); a run may fill several lanes.
    rows: NDArray[np.intp]
    #: See `loop.run`; a row for each run.
    states: Floats
    progress: NDArray[np.int64]
    constants: Floats
    #: Factors of the torque, an element for each run.
    gains: Floats
    #: Polynomials of the torque, shape (k, ...): of all runs if k is 1, otherwise of each.
    polynomials: Floats
    #: intp (LANES,): the row of them for each lane.
    slots: NDArray[np.intp]
    #: See `workspace`.
    work: Floats


@internal
def workspace() -> Floats:
    """Return an array, shape (n, LANES), with each row in one cache line."""
    line = 64 // 8
    buffer = np.empty(_ROWS * LANES + line)
    start = -(buffer.ctypes.data // 8) % line
    return buffer[start:start + _ROWS * LANES].reshape(_ROWS, LANES)


@internal
def advance(group: Group, times_ns: NDArray[np.int64], order: NDArray[np.intp], log: Log,
            settings: Floats) -> int:
    """
    Advance the runs of a group as far as they can step together.

    Parameters
    ----------
    group : Group
        States and progress are changed.
    times_ns, order : array
        As for `loop.run`, where `order` is `rows`.
    log : Log
        Of all runs.
    settings : float64 (7,)
        See `layout.pack_settings`.

    Returns
    -------
    int
        The number of steps taken. After `BUDGET` of them there may be more.

    """
    method = layout.unpack_method(settings)
    body = layout.unpack_body(group.constants[group.rows[0]])
    place = layout.load_place(group.progress[group.rows[0]])
    if (method.fixed_step or log.polynomials.shape[1] > 1 or place.done == len(times_ns)
            or not _are_alike(group, place, log, body.form)):
        return 0
    limit_ns = times_ns[place.done if len(order) == 0 else order[place.done]]
    steps = _advance_stamps(group, place, limit_ns, log, body, method)
    sample = place.sample + steps
    if sample >= log.stop or log.in_space[sample]:
        return steps
    next_ns = log.stamps_ns[sample + 1] if sample + 1 < len(log.stamps_ns) else NEVER_NS
    if log.timeout_ns > 0:
        next_ns = min(next_ns, log.stamps_ns[sample] + log.timeout_ns)
    return steps + _advance_grids(group, min(limit_ns, next_ns), sample - log.first, body, method)


@inlined
def _acts_in_every_lane(torque: vector.Vector) -> bool:
    # Return whether no torque is zero: without torque, `loop.run` may use the closed form.
    return lanes.every(vector.total(four.absolute(torque)) > 0.0)


@inlined
def _torques(group: Group, index: int, gain: float) -> vector.Vector:
    # Return the torque in every lane.
    if len(group.polynomials) == 1:
        return vector.scale(gain, _torque(group, 0, index))
    for lane in range(LANES):
        for k in range(3):
            group.work[_TORQUE + k, lane] = group.polynomials[group.slots[lane], index, 0, k]
    return vector.scale(gain, vector.of(lanes.load(group.work, _TORQUE),
                                        lanes.load(group.work, _TORQUE + 1),
                                        lanes.load(group.work, _TORQUE + 2)))


@inlined
def _torque(group: Group, slot: int, index: int) -> vector.Vector:
    torque = group.polynomials
    return vector.of(torque[slot, index, 0, 0], torque[slot, index, 0, 1],
                     torque[slot, index, 0, 2])


@internal
def _are_alike(group: Group, place: Place, log: Log, form: int) -> bool:
    # Return whether the runs have bodies of one form, the same next output, and the same sample
    # in force.
    if not 0 <= place.sample < log.stop:
        return False
    for row in group.rows:
        other = layout.load_place(group.progress[row])
        if (other.sample != place.sample or other.timed_out or other.done != place.done
                or layout.unpack_body(group.constants[row]).form != form):
            return False
    return True


@internal
def _advance_stamps(group: Group, place: Place, limit_ns: int, log: Log, body: Body,
                    method: Method) -> int:
    # Step from stamp to stamp, up to a time, as long as one step is enough. Return their number.
    stamps_ns, sample, grid_ns = log.stamps_ns, place.sample, place.grid_ns
    if (sample + _FEWEST >= len(stamps_ns) or stamps_ns[sample + _FEWEST] > limit_ns
            or not _begin_together(group, grid_ns)):
        return 0
    _load(group)
    coefficients = body_layout.coefficients(group.work[_CONSTANTS:])
    state, gain = state_layout.load(group.work, _STATE), lanes.load(group.work, _GAIN)
    while sample < min(log.stop, len(stamps_ns) - 1, place.sample + BUDGET):
        next_ns, torque = stamps_ns[sample + 1], _torques(group, sample - log.first, gain)
        acceleration = euler_equations.acceleration_from_torque(coefficients, body.form, torque)
        span_ns = next_ns - grid_ns
        seconds = span_ns / 1e9
        if (limit_ns < next_ns or span_ns >= min(method.max_step_ns, _FARTHEST)
                or log.in_space[sample] or not _acts_in_every_lane(torque)
                or 0 < log.timeout_ns < next_ns - stamps_ns[sample]):
            break
        short = short_step.is_accurate(state, seconds, acceleration, method.tolerance, None)
        if lanes.every(short):
            state = short_step.step(state, seconds, coefficients, body.form, acceleration,
                                    method.tolerance, None)
        elif lanes.some(short) or not _is_full_step(state, span_ns, acceleration, method):
            break
        else:
            state = _step(state, lanes.zero(gain) + seconds, coefficients, body.form,
                          acceleration, method.tolerance, group.work)
        grid_ns = next_ns
        sample += 1
    state_layout.store(state, group.work, _STATE)
    _store(group)
    for row in group.rows:
        group.states[row, state_layout.SIZE:2 * state_layout.SIZE] = \
            group.states[row, :state_layout.SIZE]
        layout.store_place(Place(grid_ns, grid_ns, sample, False, place.done),
                           group.progress[row])
    return sample - place.sample


@inlined
def _is_full_step(state: vector.KernelState, span_ns: int, acceleration: vector.Vector,
                  method: Method) -> bool:
    # Return whether one step of the series is enough for every run.
    square, rest_ns = vector.dot(state[0], state[0]), lanes.zero(state[0][0]) + float(span_ns)
    bound = math.sqrt(vector.dot(acceleration, acceleration))
    left = lanes.where(_is_one_step(rest_ns, square, bound, method), 0.0, rest_ns)
    return lanes.every(_full_steps_ns(square, bound, method) >= left)


@inlined
def _step(state: vector.KernelState, seconds: float, coefficients: vector.Coefficients, form: int,
          acceleration: vector.Vector, tolerance: float, work: Floats) -> vector.KernelState:
    # Return the states after a step of the series.
    none = four.zero(acceleration)
    bound = math.sqrt(vector.dot(acceleration, acceleration))
    return taylor.step(state, seconds, coefficients, form, (acceleration, none, none, none), 0,
                       False, bound, tolerance, work[_TABLE:], None)


@inlined
def _begin_together(group: Group, time_ns: int) -> bool:
    # Return whether all runs are at the beginning of a segment, at the same time.
    for row in group.rows:
        if (group.progress[row, layout.GRID_NS] != time_ns
                or group.progress[row, layout.BEGIN_NS] != time_ns):
            return False
    return True


@internal
def _advance_grids(group: Group, limit_ns: int, index: int, body: Body, method: Method) -> int:
    # Take all steps on the grid but the last before a time within the segment. Return how many.
    if not _are_many(group, limit_ns, _torque(group, group.slots[0], index), body, method):
        return 0
    limit_ns = min(limit_ns, group.progress[group.rows[0], layout.GRID_NS] + _FARTHEST)
    _load(group)
    for lane in range(LANES):
        group.work[_REST, lane] = limit_ns - group.progress[group.rows[lane], layout.GRID_NS]
    coefficients = body_layout.coefficients(group.work[_CONSTANTS:])
    torques = _torques(group, index, lanes.load(group.work, _GAIN))
    if not _acts_in_every_lane(torques):
        return 0
    acceleration = euler_equations.acceleration_from_torque(coefficients, body.form, torques)
    bound = math.sqrt(vector.dot(acceleration, acceleration))
    state, rest = state_layout.load(group.work, _STATE), lanes.load(group.work, _REST)
    square, steps = vector.dot(state[0], state[0]), 0
    while steps < BUDGET:
        step_ns = _full_steps_ns(square, bound, method)
        moves = step_ns < lanes.where(_is_one_step(rest, square, bound, method), 0.0, rest)
        if not lanes.some(moves):
            break
        # For a run whose next step is its last, a step of a nanosecond is computed in vain.
        latest = _step(state, lanes.where(moves, step_ns, 1.0) / 1e9, coefficients, body.form,
                       acceleration, method.tolerance, group.work)
        square = vector.dot(latest[0], latest[0])
        if not lanes.every(square <= FASTEST * FASTEST):
            break  # `loop.run` reports it
        state = (four.choose(moves, latest[0], state[0]), four.choose(moves, latest[1], state[1]),
                 four.choose(moves, latest[2], state[2]), four.choose(moves, latest[3], state[3]))
        rest = lanes.where(moves, rest - step_ns, rest)
        square = vector.dot(state[0], state[0])
        steps += 1
    state_layout.store(state, group.work, _STATE)
    lanes.store(group.work, _REST, rest)
    _store(group)
    for lane in range(LANES):
        group.progress[group.rows[lane], layout.GRID_NS] = limit_ns - int(
            group.work[_REST, lane])
    return steps


@inlined
def _full_steps_ns(square: float, bound: float, method: Method) -> float:
    # `stepping.full_step_ns` in lanes.
    seconds = 2.0 * method.angle / taylor.turning_rate(square, bound, method.angle)
    longest, step_ns = float(method.max_step_ns), seconds * 1e9
    step_ns = lanes.truncated(lanes.where(step_ns < longest, step_ns, longest))
    return lanes.where(step_ns < 1.0, 1.0, step_ns)


@inlined
def _is_one_step(rest_ns: float, square: float, bound: float, method: Method) -> bool:
    # `stepping.is_one_step` in lanes.
    rest = rest_ns / 1e9
    return lanes.both(rest_ns <= float(method.max_step_ns),
                      rest * rest * (square + bound) < 0.01)


@internal
def _are_many(group: Group, limit_ns: int, torque: vector.Vector, body: Body,
              method: Method) -> bool:
    # Return whether so many steps are left that it pays to gather the group.
    row = group.rows[0]
    acceleration = euler_equations.acceleration_from_torque(body.coefficients, body.form, torque)
    w = state_layout.load(group.states[row], 0)[0]
    seconds = taylor.step_seconds(
        vector.dot(w, w), math.sqrt(vector.dot(acceleration, acceleration)), method.angle)
    rest_ns = limit_ns - group.progress[row, layout.GRID_NS]
    return _FEWEST * stepping.full_step_ns(seconds, method) < rest_ns


@internal
def _load(group: Group) -> None:
    # Gather the states on the grid, the constants of the bodies and the factors of the torque.
    for lane in range(LANES):
        row = group.rows[lane]
        group.work[_GAIN, lane] = group.gains[row]
        for k in range(state_layout.SIZE):
            group.work[_STATE + k, lane] = group.states[row, k]
        for k in range(body_layout.SIZE):
            group.work[_CONSTANTS + k, lane] = group.constants[row, k]


@internal
def _store(group: Group) -> None:
    # Put the states on the grid back.
    for lane in range(LANES):
        for k in range(state_layout.SIZE):
            group.states[group.rows[lane], k] = group.work[_STATE + k, lane]
