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
Steps on the grid of one segment.

A step can rely on the following:

1. A step never crosses a torque change. So the torque is a single polynomial of the given degree
   throughout the step, and the bound on the acceleration holds throughout the interval.
2. The length of the step is positive. For the series, it is at most about `taylor.step_seconds`.
3. The angular velocity is at most FASTEST. The loop checks this after every step on the grid.

In return, a step guarantees the following:

1. Every bit of the final state depends only on the initial state, the torque, the length of the
   step and the method.
2. The attitude has unit norm. The quaternion follows the motion continuously, so its sign never
   flips.
3. The low-order parts of the angular velocity and the attitude are either computed or set to zero.
4. The initial state is left unchanged. After a step to an output, the loop discards the final
   state and continues from the initial state.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels import (
    fields,
    friction,
    intervals,
    lags,
    layout,
    limits,
    linear_terms,
    steppers,
    taylor,
    vector,
)
from rigid_body_ros.kernels.intervals import Drive, Loads
from rigid_body_ros.kernels.jit import inlined, internal, optional, scratch
from rigid_body_ros.kernels.layout import Body, FASTEST, Method
from rigid_body_ros.kernels.state_layout import MODES, MOST_WHEELS
from rigid_body_ros.kernels.tangents import follow, least_order, SeriesStep, Tangents

_RK4, _STRANG, _EXPLICIT_EULER = layout.RK4, layout.STRANG, layout.EXPLICIT_EULER


class Reached(NamedTuple):
    """The result of `advance`."""

    #: The last state on the grid, and its time, ns.
    grid: vector.KernelState
    grid_ns: int
    #: The state at the requested time, if that time was reached.
    latest: vector.KernelState
    #: Whether the requested time was reached. If not, the budget was used up or the body became
    #: too fast.
    arrived: bool
    #: How many units of work are left of the budget.
    budget: int


class Series(NamedTuple):
    """What a step of the series fills and advances."""

    #: float64 (series_table.WORKSPACE,): workspace of `taylor.step`.
    table: Floats
    #: The tangents that every step advances, if any.
    tangents: Tangents | None


class LocalLoads(NamedTuple):
    """The linear terms and the step limits that apply during steps from a given grid point."""

    #: The rotor momentum, N m s, as a polynomial in the fraction of the interval.
    momentum: linear_terms.Momentum
    linear: linear_terms.Linear
    #: The sum of four squared rates, 1/s^2: `linear_terms.square_rate` of the matrix, the square
    #: of the rate of the fields, `lags.square_rate` and `friction.square_rate`.
    square_rate: float
    #: Upper bound on how fast the rotors, the fields and friction can change the rates that limit
    #: a step, 1/s^2.
    growth: float
    #: The workspace of the fields; see `fields.prepared`.
    field_work: Floats | None
    #: The workspace of the lags, or None if there are no lags.
    lag_work: Floats | None
    #: The workspace of the wheels with friction, or None if there are no such wheels.
    friction_work: Floats | None


@inlined
def advance(grid: vector.KernelState, grid_ns: int, time_ns: int, drive: Drive, body: Body,
            method: Method, series: Series, budget: int, loads: Loads | None) -> Reached:
    """
    Step along the grid to the last grid point before `time_ns`, and then to `time_ns` itself.

    Parameters
    ----------
    grid, grid_ns : KernelState, int
        The state at the last grid point reached so far, and its time, ns.
    time_ns : int
        The time to reach, ns, which must be within the segment.
    drive, body, method : Drive, Body, Method
        The drive during the interval, the body, and the solver with its step limits.
    series : Series
        The workspace of the series, and the tangents.
    budget : int
        Number of units of work after which to return. Each step costs `layout.STEP_COST`.
    loads : Loads or None
        What acts besides the drive.

    Returns
    -------
    Reached

    """
    # The workspaces must be created in this function, because an array from `scratch` is valid
    # only within the function that creates it.
    work, wheels = scratch(fields.WORKSPACE), _friction_of(loads)
    works = work, scratch(lags.WORKSPACE), scratch(friction.WORKSPACE)
    if wheels is not None:  # noqa: SIM102 (the compiler decides the first condition)
        if limits.exist(wheels):
            return _advance_limited(grid, grid_ns, time_ns, drive, body, method, series, budget,
                                    loads)
    latest, now = grid, _local(loads, drive, grid, grid_ns, body, works)
    while grid_ns < time_ns:
        if budget <= 0:
            return Reached(grid, grid_ns, latest, False, budget)
        budget -= layout.STEP_COST
        rest_ns = time_ns - grid_ns
        step_ns = _natural_ns(grid, rest_ns, drive.bound, method, now)
        last = step_ns >= rest_ns
        if last:
            step_ns = rest_ns
        latest = _step(grid, step_ns / 1e9, grid_ns, drive, body, method, series, loads, now)
        if last:
            break
        grid = latest
        friction.accept(wheels)
        grid_ns += step_ns
        if is_too_fast(latest):
            return Reached(grid, grid_ns, latest, False, budget)
        if intervals.rotors_change(loads):
            now = _local(loads, drive, grid, grid_ns, body, works)
    return Reached(grid, grid_ns, latest, True, budget)


@internal
def _advance_limited(grid: vector.KernelState, grid_ns: int, time_ns: int, drive: Drive,
                     body: Body, method: Method, series: Series, budget: int,
                     loads: Any) -> Reached:
    # Advance like `advance`, and end steps where wheels reach or leave their largest speed. These
    # events are those of full steps, so they do not depend on the requested times. A second, short
    # step leads from an event to the next nanosecond.
    work, wheels, latest = scratch(fields.WORKSPACE), loads.friction, grid
    works = work, scratch(lags.WORKSPACE), scratch(friction.WORKSPACE)
    modes, stuck = scratch(MOST_WHEELS), 0
    limits.classify(wheels, grid[0], grid_ns)
    while grid_ns < time_ns:
        if budget <= 0 or limits.is_full(wheels):
            return Reached(grid, grid_ns, latest, False, 0)
        budget -= layout.STEP_COST
        now = _local(loads, drive, grid, grid_ns, body, works)
        step_ns, rest_ns = _natural_ns(grid, NEVER_NS, drive.bound, method, now), time_ns - grid_ns
        latest, order = _series_step(grid, step_ns / 1e9, grid_ns, drive, body, method, series,
                                     loads, now)
        step = limits.Step(friction.of_step(wheels, now.friction_work), series.table, order,
                           step_ns / 1e9, grid[0])
        event = limits.first_event(step)
        seconds = event.fraction * (step_ns / 1e9)
        event_ns = -math.floor(-1e9 * seconds)
        stuck = stuck + 1 if event_ns == 0 else 0
        if stuck > 2 * MOST_WHEELS:  # rounding errors decide at this time: go on
            latest, order = _series_step(grid, 1e-9, grid_ns, drive, body, method, series, loads,
                                         now)
            step_ns, stuck = 1, 0
        elif event.fraction <= 1.0 and event_ns <= rest_ns:
            for k in range(MOST_WHEELS):
                modes[k] = wheels.states.grid[MODES + k]
            limits.choose(step, event, body.coefficients, modes)
            step_ns, rest = event_ns, event_ns / 1e9 - seconds
            latest = grid
            if seconds > 0.0:
                latest, order = _series_step(grid, seconds, grid_ns, drive, body, method, series,
                                             loads, now)
                friction.accept(wheels)
            limits.set_modes(wheels, modes, grid_ns + event_ns, rest)
            friction.go_back(wheels.states)
            if rest > 0.0:
                before_ns = grid_ns + event_ns - 1  # what else acts changes little until the event
                now = _local(loads, drive, latest, before_ns, body, works)
                latest, order = _series_step(latest, rest, before_ns, drive, body, method, series,
                                             loads, now)
        elif step_ns >= rest_ns:
            if step_ns > rest_ns:
                latest, order = _series_step(grid, rest_ns / 1e9, grid_ns, drive, body, method,
                                             series, loads, now)
            break
        grid = latest
        friction.accept(wheels)
        grid_ns += step_ns
        if is_too_fast(latest):
            return Reached(grid, grid_ns, latest, False, budget)
    return Reached(grid, grid_ns, latest, True, budget)


@optional
def _friction_of(loads: Loads) -> friction.RowFriction | None:
    return loads.friction


@inlined
def is_too_fast(state: vector.KernelState) -> bool:
    """Return whether the angular speed is above FASTEST or not a number."""
    return not vector.dot(state[0], state[0]) <= FASTEST * FASTEST


@inlined
def _natural_ns(state: vector.KernelState, rest_ns: int, bound: float, method: Method,
                now: LocalLoads | None) -> int:
    # Return the length of the next step on the grid, ns. This length does not depend on the
    # remaining time `rest_ns`, unless a single step covers the remaining time.
    if method.fixed_step:
        return method.max_step_ns
    square = vector.dot(state[0], state[0])
    if now is not None:  # treat the loads as a rotation that would limit the step as much
        square, bound = square + now.square_rate, bound + now.growth
    if is_one_step(rest_ns, square, bound, method):
        return rest_ns
    return full_step_ns(taylor.step_seconds(square, bound, method.angle), method)


@inlined
def is_one_step(rest_ns: int, square: float, bound: float, method: Method) -> bool:
    """
    Return whether a single step covers the remaining time `rest_ns`.

    A single step is enough if it is short enough for the method, and if the body turns by less
    than 0.1 rad during the step.
    """
    rest = rest_ns / 1e9
    return rest_ns <= method.max_step_ns and rest * rest * (square + bound) < 0.01


@inlined
def full_step_ns(seconds: float, method: Method) -> int:
    """Convert a step length from seconds to ns, limiting it to between 1 ns and `max_step_ns`."""
    return max(1, int(min(seconds * 1e9, float(method.max_step_ns))))


@optional
def _local(loads: Loads, drive: Drive, grid: vector.KernelState, grid_ns: int, body: Body,
           works: tuple[Floats, Floats, Floats]) -> LocalLoads:
    # Return the linear terms of Euler's equations and the step limits that apply from a grid point
    # onward.
    orbit, lag_rate = fields.rate_bound(loads.fields), lags.square_rate(loads.lags)
    lagged = _if_given(loads.lags, works[1])
    by_fields = fields.acceleration_bound(loads.fields, body.coefficients)
    prepared = fields.prepared(loads.fields, works[0], body.coefficients)
    slowed = _if_given(loads.friction, works[2])
    if loads.linear_degree <= 0:
        linear = linear_terms.at(loads.constants, *friction.momentum(
            loads.friction, loads.momentum[0], loads.low_momentum))
        return LocalLoads(loads.momentum, linear,
                          linear_terms.square_rate(linear.matrix) + orbit * orbit + lag_rate
                          + friction.square_rate(loads.friction, body.frame),
                          by_fields + friction.acceleration(
                              loads.friction, grid[0], body.coefficients),
                          prepared, lagged, slowed)
    change, momentum = _rotors_from(loads.momentum,
                                    (grid_ns - drive.origin_ns) / 1e9 / drive.span)
    first, low = vector.two_sum(loads.momentum[0], change)
    linear = linear_terms.at(loads.constants, first, vector.add(low, loads.low_momentum))
    growth = 0.0
    for i in range(1, loads.linear_degree + 1):
        growth += i * math.sqrt(linear_terms.square_rate(
            linear_terms.rotor_matrix(loads.constants, momentum[i])))
    return LocalLoads(momentum, linear,
                      linear_terms.square_rate(linear.matrix) + orbit * orbit + lag_rate,
                      growth / drive.span + by_fields, prepared, lagged, slowed)


@optional
def _if_given(_term: Any, work: Floats) -> Floats:
    # Return the workspace of a term, or None if there is no such term.
    return work


@inlined
def _rotors_from(momentum: linear_terms.Momentum,
                 offset: float) -> tuple[vector.Vector, linear_terms.Momentum]:
    # Return p(offset) - p(0), and the polynomial p(offset + s) in s, for the polynomial p(s).
    a, b, c, d, e = momentum
    change = vector.scale(offset, vector.add_scaled(b, offset, vector.add_scaled(
        c, offset, vector.add_scaled(d, offset, e))))
    b = vector.add_scaled(b, offset, vector.add_scaled(
        vector.scale(2.0, c), offset, vector.add_scaled(
            vector.scale(3.0, d), 4.0 * offset, e)))
    c = vector.add_scaled(c, offset, vector.add_scaled(vector.scale(3.0, d), 6.0 * offset, e))
    d = vector.add_scaled(d, 4.0 * offset, e)
    return change, (vector.add(a, change), b, c, d, e)


@optional
def _stage_loads(loads: Loads, now: LocalLoads, drive: Drive, grid_ns: int,
                 seconds: float) -> steppers.StageLoads:
    # Return what acts besides the drive, expressing all polynomials in the fraction of the step.
    offset, ratio = (grid_ns - drive.origin_ns) / 1e9 / drive.span, seconds / drive.span
    space = loads.space_torque
    if loads.space_degree > 0:
        space = vector.shifted(space, offset, ratio)
    a, b, c, d, e = now.momentum
    square = ratio * ratio
    return steppers.StageLoads(
        (a, vector.scale(ratio, b), vector.scale(square, c), vector.scale(square * ratio, d),
         vector.scale(square * square, e)), loads.constants.damping.matrix, space, loads.fields,
        fields.angle_at(loads.fields, grid_ns), seconds, loads.lags,
        max(grid_ns - drive.origin_ns, 0) / 1e9)  # a coast may begin before this row


@optional
def _series_loads(loads: Loads, now: LocalLoads, stage: steppers.StageLoads,
                  seconds: float) -> taylor.SeriesLoads:
    # Return what acts besides the drive, in the form that a step of the series needs.
    zero = vector.of(0.0, 0.0, 0.0)
    none = zero, zero, zero
    changes = none, none, none, none
    if loads.linear_degree > 0:
        _, b, c, d, e = stage.momentum
        changes = (_change(loads.constants, seconds, b), _change(loads.constants, seconds, c),
                   _change(loads.constants, seconds, d), _change(loads.constants, seconds, e))
    return taylor.SeriesLoads(linear_terms.scaled(now.linear, seconds), changes,
                              loads.linear_degree, stage.space_torque, loads.space_degree,
                              fields.of_step(loads.fields, stage.field_angle,
                                             now.field_work),
                              lags.of_step(loads.lags, stage.since, now.lag_work),
                              friction.of_step(loads.friction, now.friction_work))


@inlined
def _change(constants: linear_terms.Constants, seconds: float,
            momentum: vector.Vector) -> linear_terms.Matrix:
    return linear_terms.rotor_matrix(constants, vector.scale(seconds, momentum))


@optional
def _turn_of(now: LocalLoads, seconds: float) -> float:
    # Return by how much the loads turn a tangent in a step, rad.
    return seconds * math.sqrt(now.square_rate + now.growth)


@inlined
def _step(state: vector.KernelState, seconds: float, grid_ns: int, drive: Drive, body: Body,
          method: Method, series: Series, loads: Loads | None,
          now: LocalLoads | None) -> vector.KernelState:
    local = drive.polynomial
    offset, ratio = (grid_ns - drive.origin_ns) / 1e9 / drive.span, seconds / drive.span
    if drive.degree != 0:
        local = vector.shifted(local, offset, ratio)
    stage = _stage_loads(loads, now, drive, grid_ns, seconds)
    if method.solver == _RK4:
        return steppers.rk4(state, seconds, body.coefficients, local, drive.in_space, stage)
    if method.solver == _STRANG:
        return steppers.strang(state, seconds, body.coefficients, body.frame, local,
                               drive.in_space, stage)
    if method.solver == _EXPLICIT_EULER:
        return steppers.explicit_euler(state, seconds, body.coefficients, local, drive.in_space,
                                       stage)
    latest, _ = _series_step(state, seconds, grid_ns, drive, body, method, series, loads, now)
    return latest


@inlined
def _series_step(state: vector.KernelState, seconds: float, grid_ns: int, drive: Drive, body: Body,
                 method: Method, series: Series, loads: Loads | None,
                 now: LocalLoads | None) -> tuple[vector.KernelState, int]:
    # Return the state after a step of the series, and the order up to which the table is filled.
    local = drive.polynomial
    if drive.degree != 0:
        local = vector.shifted(local, (grid_ns - drive.origin_ns) / 1e9 / drive.span,
                               seconds / drive.span)
    driving = taylor.SeriesDrive(local, drive.degree, drive.in_space, drive.bound)
    stage = _stage_loads(loads, now, drive, grid_ns, seconds)
    acting, turn = _series_loads(loads, now, stage, seconds), _turn_of(now, seconds)
    latest, order = taylor.step(
        state, seconds, body.coefficients, driving, method.tolerance, series.table, acting,
        least_order(series.tangents, turn))
    follow(series.tangents, state,
           SeriesStep(series.table, order, seconds, max(grid_ns - drive.origin_ns, 0) / 1e9),
           body.coefficients, driving, acting)
    return latest, order
