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
Wheels that reach their largest speed.

A command that would drive a wheel beyond its largest speed acts as the effort of a motor that
cannot: below that speed, the motor gives the command; above it, nothing; and at that speed, what
holds the speed, as long as this is between nothing and the command. These are the modes FREE, OVER
and HELD. The equations with such a right-hand side have a unique solution (Filippov, Differential
Equations with Discontinuous Righthand Sides, 1988).

A mode ends where a polynomial, the series of a step, becomes negative: the distance to the largest
speed, or the distance of the effort to its bounds. `first_event` finds the first such time of a
step. `choose` finds the modes after it: with e the efforts in the direction of the commands, the
speeds change by s' = b + M e, where M is symmetric and positive definite. So the efforts minimize
e . M e / 2 + b . e between nothing and the commands.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import euler_equations, four, friction
from rigid_body_ros.kernels.friction import (
    axis_of,
    FREE,
    HELD,
    INVERSE,
    LARGEST,
    OVER,
    RowFriction,
    SIZE,
    StepFriction,
    UNKNOWN,
)
from rigid_body_ros.kernels.jit import inlined, internal, scratch
from rigid_body_ros.kernels.series_table import MAX_ORDER, row_of, U
from rigid_body_ros.kernels.state_layout import LOST_MOMENTA, MODES, MOMENTA, MOST_WHEELS
from rigid_body_ros.kernels.vector import Coefficients, dot, Vector

#: What counts as zero, relative to the sum of the magnitudes of the terms of a polynomial.
_ROUNDING = 16.0 * 2.0 ** -52
#: The most steps of the search for a root, and the sweeps over the efforts in `choose`.
_MOST_STEPS, _SWEEPS = 200, 100
_NEVER = 2.0


class Step(NamedTuple):
    """A step whose series are in a table."""

    wheels: StepFriction
    #: See `series_table`; it is filled up to `order`.
    table: Floats
    order: int
    #: The length of the step.
    seconds: float
    #: The angular velocity at the beginning of the step, rad/s.
    w: Vector


class Event(NamedTuple):
    """The first end of a mode in a step."""

    #: When, as a fraction of the step; above 1 if there is none in the step.
    fraction: float
    wheel: int


@inlined
def exist(wheels: RowFriction) -> bool:
    """Return whether any wheel has a command and a largest speed."""
    count = 0
    for k in range(wheels.efforts.shape[1]):
        count += is_limited(wheels, k)
    return count > 0


@inlined
def is_limited(wheels: RowFriction, k: int) -> bool:
    """Return whether a wheel has a command and a largest speed."""
    return wheels.wheels[k // 4 * SIZE + k % 4 + LARGEST] > 0.0 \
        and wheels.efforts[max(wheels.row, 0), k] != 0.0


@inlined
def _sign(wheels: RowFriction, k: int) -> float:
    return math.copysign(1.0, wheels.efforts[max(wheels.row, 0), k])


@internal
def classify(wheels: RowFriction, w: Vector, time_ns: int) -> None:
    """Set the modes of wheels at the beginning of a segment; those at their limit are free."""
    grid = wheels.states.grid
    for k in range(wheels.efforts.shape[1]):
        if grid[MODES + k] != UNKNOWN:
            continue
        grid[MODES + k] = FREE
        if is_limited(wheels, k):
            place = k // 4 * SIZE + k % 4
            inverse, largest = wheels.wheels[place + INVERSE], wheels.wheels[place + LARGEST]
            turning = dot(axis_of(wheels.wheels, k), w)
            excess = _sign(wheels, k) * (_speed(wheels, k) - turning) - largest
            size = abs(grid[MOMENTA + k]) * inverse + abs(turning) + largest
            if excess > _ROUNDING * size:
                grid[MODES + k] = OVER
                _record(wheels, k, time_ns, 0.0)


@inlined
def _speed(wheels: RowFriction, k: int) -> float:
    # Return the speed of a wheel on the grid relative to space, rad/s.
    grid, place = wheels.states.grid, k // 4 * SIZE + k % 4
    high, inverse = grid[MOMENTA + k], wheels.wheels[place + INVERSE]
    return (high * inverse + (high * wheels.wheels[place + INVERSE + 4]
                              + grid[LOST_MOMENTA + k] * inverse))


@internal
def _excess(step: Step, k: int, terms: Floats) -> None:
    # Store the series of the speed of a wheel beyond its limit, in the direction of its command.
    wheels = step.wheels.friction
    axis, sign = axis_of(wheels.wheels, k), _sign(wheels, k)
    place = k // 4 * SIZE + k % 4
    inverse = wheels.wheels[place + INVERSE]
    terms[0] = sign * (_speed(wheels, k) - dot(axis, step.w)) - wheels.wheels[place + LARGEST]
    for m in range(1, step.order + 1):
        u = four.load(step.table, row_of(step.table, m) + U)
        terms[m] = sign * (friction.term(step.wheels, k, m) * inverse
                           - dot(axis, u) / step.seconds)


@internal
def _effort(step: Step, k: int, terms: Floats) -> None:
    # Store the series of the effort that holds the speed of a wheel, in the direction of its
    # command.
    wheels = step.wheels.friction
    for m in range(step.order):
        terms[m] = _sign(wheels, k) * (m + 1) / step.seconds * friction.term(step.wheels, k, m + 1)
    terms[0] += _sign(wheels, k) * friction.resisting(wheels, k)
    terms[step.order] = 0.0


@internal
def first_event(step: Step) -> Event:
    """Return the first end of a mode in a step."""
    wheels, order, terms = step.wheels.friction, step.order, scratch(MAX_ORDER + 1)
    first, wheel = _NEVER, 0
    for k in range(wheels.efforts.shape[1]):
        if not is_limited(wheels, k):
            continue
        command = abs(wheels.efforts[max(wheels.row, 0), k])
        if wheels.states.grid[MODES + k] == HELD:
            _effort(step, k, terms)
            root = min(_root(terms, order, 1.0, 0.0, command),
                       _root(terms, order, -1.0, command, command))
        else:
            _excess(step, k, terms)
            sign = 1.0 if wheels.states.grid[MODES + k] == OVER else -1.0
            place = k // 4 * SIZE + k % 4
            root = _root(terms, order, sign, 0.0, wheels.wheels[place + LARGEST])
        if root < first:
            first, wheel = root, k
    return Event(first, wheel)


@internal
def _root(terms: Floats, order: int, sign: float, offset: float, size: float) -> float:
    # Return where offset + sign * (the polynomial) first becomes negative in [0, 1], or _NEVER.
    # Because the second derivative is bounded, no root is missed: from a value c and a slope d,
    # the polynomial stays positive up to the root of c + d x - bound x^2 / 2.
    start, first, bound, total = offset + sign * terms[0], sign * terms[1], 0.0, size
    for m in range(order + 1):
        total += abs(terms[m])
        bound += m * (m - 1) * abs(terms[m])
    tiny, x = _ROUNDING * total, 0.0
    rest = total - size - abs(terms[0])  # how much the polynomial can change in the step
    if start > rest + tiny or rest <= tiny:
        return _NEVER if start >= -tiny else 0.0
    if start < -tiny or (start <= tiny and first <= 0.0):
        return 0.0
    value, slope = max(start, 0.0), first
    for _ in range(_MOST_STEPS):
        x += _stride(value, slope, bound)
        if x > 1.0:
            return _NEVER
        value, slope = 0.0, 0.0
        for m in range(order, -1, -1):
            slope = slope * x + value
            value = value * x + terms[m]
        value, slope = offset + sign * value, sign * slope
        if value <= tiny and slope < 0.0:
            break
        value = max(value, 0.0)
    return min(max(x - value / slope, 0.0), 1.0) if slope < 0.0 else x


@inlined
def _stride(value: float, slope: float, bound: float) -> float:
    # Return the larger root of value + slope x - bound x^2 / 2.
    discriminant = math.sqrt(slope * slope + 2.0 * bound * value)
    if slope > 0.0:
        return (slope + discriminant) / bound if bound > 0.0 else _NEVER
    return 2.0 * value / (discriminant - slope) if discriminant > slope else _NEVER


@internal
def choose(step: Step, event: Event, coefficients: Coefficients, modes: Floats) -> None:
    """
    Compute the modes after an event of a step.

    Parameters
    ----------
    step : Step
        The step in which the event takes place.
    event : Event
        The event, with which the step ends.
    coefficients : Coefficients
        The coefficients of Euler's equations.
    modes : float64 (MOST_WHEELS,)
        The modes, which the function changes.

    """
    wheels, order, terms = step.wheels.friction, step.order, scratch(MAX_ORDER + 1)
    row, x, wheel = max(wheels.row, 0), event.fraction, event.wheel
    if modes[wheel] == HELD:
        _effort(step, wheel, terms)
        modes[wheel] = OVER if _value(terms, order, x) < 0.5 * abs(wheels.efforts[row, wheel]) \
            else FREE
        return
    count = wheels.efforts.shape[1]
    rates, before = scratch(MOST_WHEELS), scratch(MOST_WHEELS)
    efforts, matrix = scratch(MOST_WHEELS), scratch(MOST_WHEELS * MOST_WHEELS)
    for k in range(MOST_WHEELS):
        before[k] = efforts[k] = rates[k] = 0.0
    for k in range(count):
        if is_limited(wheels, k):
            before[k] = abs(wheels.efforts[row, k]) if modes[k] == FREE else 0.0
            if modes[k] == HELD:
                _effort(step, k, terms)
                before[k] = _value(terms, order, x)
            efforts[k] = before[k]
            _excess(step, k, terms)
            rates[k] = _slope(terms, order, x) / step.seconds
            size = wheels.wheels[k // 4 * SIZE + k % 4 + LARGEST]
            for m in range(order + 1):
                size += abs(terms[m])
            if (k == wheel or modes[k] == HELD
                    or abs(_value(terms, order, x)) <= 4.0 * _ROUNDING * size):
                modes[k] = UNKNOWN
    _fill_matrix(wheels, coefficients, matrix)
    for _ in range(_SWEEPS):
        for i in range(count):
            if modes[i] == UNKNOWN:
                rate = _rate(rates, matrix, efforts, before, i)
                efforts[i] = min(max(efforts[i] - rate / matrix[MOST_WHEELS * i + i], 0.0),
                                 abs(wheels.efforts[row, i]))
    for i in range(count):
        if modes[i] == UNKNOWN:
            command = abs(wheels.efforts[row, i])
            tiny = 1e-12 * matrix[MOST_WHEELS * i + i] * command
            rate, modes[i] = _rate(rates, matrix, efforts, before, i), HELD
            if efforts[i] >= command and rate < -tiny:
                modes[i] = FREE
            elif efforts[i] <= 0.0 and rate > tiny:
                modes[i] = OVER


@inlined
def _value(terms: Floats, order: int, x: float) -> float:
    value = 0.0
    for m in range(order, -1, -1):
        value = value * x + terms[m]
    return value


@inlined
def _slope(terms: Floats, order: int, x: float) -> float:
    slope = 0.0
    for m in range(order, 0, -1):
        slope = slope * x + m * terms[m]
    return slope


@inlined
def _rate(rates: Floats, matrix: Floats, efforts: Floats, before: Floats, i: int) -> float:
    rate = rates[i]
    for j in range(len(rates)):
        rate += matrix[MOST_WHEELS * i + j] * (efforts[j] - before[j])
    return rate


@internal
def _fill_matrix(wheels: RowFriction, coefficients: Coefficients, matrix: Floats) -> None:
    # Store the changes of the wheel speeds, rad/s^2 for each N m, in the directions of commands.
    count = wheels.efforts.shape[1]
    for i in range(MOST_WHEELS * MOST_WHEELS):
        matrix[i] = 0.0
    for j in range(count):
        reaction = euler_equations.acceleration_from_torque(
            coefficients, axis_of(wheels.wheels, j))
        for i in range(count):
            entry = dot(axis_of(wheels.wheels, i), reaction)
            if i == j:
                entry += wheels.wheels[j // 4 * SIZE + j % 4 + INVERSE]
            matrix[MOST_WHEELS * i + j] = _sign(wheels, i) * _sign(wheels, j) * entry


@internal
def set_modes(wheels: RowFriction, modes: Floats, time_ns: int, rest: float) -> None:
    """
    Set the modes of the wheels, and record which have changed; see `layout.Friction`.

    The event takes place at `rest` seconds before `time_ns`.
    """
    grid = wheels.states.grid
    for k in range(wheels.efforts.shape[1]):
        if grid[MODES + k] != modes[k]:
            grid[MODES + k] = modes[k]
            _record(wheels, k, time_ns, rest)


@internal
def _record(wheels: RowFriction, k: int, time_ns: int, rest: float) -> None:
    # Record the mode of a wheel from `rest` seconds before a time on, if there is room.
    events = wheels.states.events
    row = events[0, 0] + 1
    if row < len(events):
        events[0, 0], events[row, 0], events[row, 1] = row, time_ns, int(rest * 1e15)
        events[row, 2], events[row, 3] = k, int(wheels.states.grid[MODES + k])


@inlined
def is_full(wheels: RowFriction) -> bool:
    """Return whether there is room for events, but too little for those of another step."""
    events = wheels.states.events
    return len(events) > 1 and events[0, 0] + MOST_WHEELS >= len(events)
