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
Named wheels whose momenta depend on the motion: those with friction or a largest speed.

Along its axis a, a wheel feels the motor torque u minus the friction torque f W. Here f is the
friction coefficient, and W = H / I - a . w is the speed of the wheel relative to the body. So the
axial momentum H obeys H' = u - f W, and the body feels the torque -H' a. Because H depends on the
motion, we include it in the state, and compute its series from the series of the rates.

While the speed of a wheel is held at its limit (see `limits`), W is constant, so H' = I a . w'.

The computations treat four wheels at a time.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import euler_equations, four
from rigid_body_ros.kernels.four import Four
from rigid_body_ros.kernels.jit import inlined, internal, optional
from rigid_body_ros.kernels.series_table import (
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    row_of,
    store_permuted,
    turned,
    U,
)
from rigid_body_ros.kernels.state_layout import (
    EFFORTS,
    LOST_MOMENTA,
    MODES,
    MOMENTA,
    MOST_WHEELS,
    WITH_WHEELS,
)
from rigid_body_ros.kernels.vector import (
    accumulate,
    add,
    add_scaled,
    Coefficients,
    dot,
    KernelState,
    of,
    PrincipalFrame,
    scale,
    total,
    two_sum,
    Vector,
)

#: Number of doubles that describe four wheels. For each wheel, these are the three components of
#: the axis, 1 / I, the low-order part of 1 / I, f, and the largest speed (0 if there is none).
SIZE = 28
_X, _Y, _Z, INVERSE, _LOST_INVERSE, FRICTION, LARGEST = range(0, SIZE, 4)
#: What the motor of a wheel does: it gives its command, nothing, or what holds the speed. At the
#: beginning of a segment, this is not known yet.
UNKNOWN, FREE, OVER, HELD = 0.0, 1.0, 2.0, 3.0
#: Layout of the terms of one order: the momenta, followed by the sum of H a over all wheels in
#: three permutations. At order 0 the sum is zero, because the linear terms already include it.
_SUM, _ORDER = MOST_WHEELS, MOST_WHEELS + PERMUTED
#: After the series, the workspace contains the torques on the wheels at the beginning of the step,
#: the weights of the momenta, factors that are 0 for the wheels whose speed is held and 1 for the
#: others, the number of the held wheels, and for these the inverse of the matrix in `_prepare`.
_TORQUES = _ORDER * (MAX_ORDER + 1)
_WEIGHTS = _TORQUES + MOST_WHEELS
_NOT_HELD = _WEIGHTS + MOST_WHEELS
_COUNT, _RATES = _NOT_HELD + MOST_WHEELS, _NOT_HELD + MOST_WHEELS + 1
_MATRIX = _RATES + MOST_WHEELS
WORKSPACE = _MATRIX + MOST_WHEELS * MOST_WHEELS


class WheelStates(NamedTuple):
    """The three states of `layout.GridStates` as packed arrays that include the wheel momenta."""

    grid: Floats
    begin: Floats
    latest: Floats
    #: The wheel momenta and efforts at the requested times; see `layout.Friction`.
    requested: Floats
    #: See `layout.Friction`.
    events: NDArray[np.int64]


class RowFriction(NamedTuple):
    """The wheels with friction while a given row is in force."""

    #: See `layout.Friction`.
    efforts: Floats
    wheels: Floats
    row: int
    #: The states of the motion.
    states: WheelStates


class StepFriction(NamedTuple):
    """The wheels with friction during a step, and the series of their momenta."""

    friction: RowFriction
    #: The workspace, of size WORKSPACE, that contains the series.
    series: Floats


@optional
def states_of(friction: Any, progress: NDArray[Any]) -> WheelStates:
    """
    Return the packed states of a motion, or None if no wheel has friction.

    The argument `progress` is an array of `layout.PROGRESS`.
    """
    return WheelStates(progress[0].grid, progress[0].begin, progress[0].latest, friction.momenta,
                       friction.events)


@inlined
def accept(friction: RowFriction | None) -> None:
    """Copy the latest state of the wheels to the grid state."""
    if friction is None:
        return
    _copy(friction.states.latest, friction.states.grid)


@inlined
def continue_from(states: WheelStates | None, begins: bool) -> None:
    """Forget the modes at the beginning of a segment: its commands may be others than before."""
    if states is None:
        return
    if begins:
        _forget_modes(states.grid)


@inlined
def begin_segment(states: WheelStates | None) -> None:
    """
    Copy the latest wheel momenta to the grid state and to the state that begins the segment.

    The modes on the grid are unknown, because the commands may change.
    """
    if states is None:
        return
    _copy(states.latest, states.grid)
    _copy(states.latest, states.begin)
    _forget_modes(states.grid)


@inlined
def go_back(states: WheelStates | None) -> None:
    """Reset the latest wheel momenta to the wheel momenta of the grid state."""
    if states is None:
        return
    _copy(states.grid, states.latest)


@internal
def _copy(source: Floats, target: Floats) -> None:
    for k in range(MOMENTA, WITH_WHEELS):
        target[k] = source[k]


@internal
def _forget_modes(state: Floats) -> None:
    for k in range(MOST_WHEELS):
        state[MODES + k] = UNKNOWN


@inlined
def store(states: WheelStates | None, row: int) -> None:
    """Store the latest wheel momenta as the momenta at a requested time, in the given row."""
    if states is None:
        return
    count = states.requested.shape[1] // 2
    for k in range(count):
        states.requested[row, k] = states.latest[MOMENTA + k]
        states.requested[row, count + k] = states.latest[EFFORTS + k]


@inlined
def momentum(friction: RowFriction | None, others: Vector, low: Vector) -> tuple[Vector, Vector]:
    """
    Return the sum of the wheel momenta on the grid and the momentum of the other rotors.

    Both the argument and the result consist of a momentum and its low-order part.
    """
    if friction is None:
        return others, low
    high, grid = others, friction.states.grid
    for k in range(friction.efforts.shape[1]):
        axis = axis_of(friction.wheels, k)
        product = scale(grid[MOMENTA + k], axis)
        rest = add_scaled(four.negative(product), grid[MOMENTA + k], axis)
        high, lost = two_sum(high, product)
        low = add(low, add_scaled(add(rest, lost), grid[LOST_MOMENTA + k], axis))
    return high, low


@inlined
def axis_of(wheels: Floats, k: int) -> Vector:
    """Return the axis of a wheel."""
    place = k // 4 * SIZE + k % 4
    return of(wheels[place + _X], wheels[place + _Y], wheels[place + _Z])


@inlined
def square_rate(friction: RowFriction | None, frame: PrincipalFrame) -> float:
    """
    Return the square, in 1/s^2, of a body rate that would limit the step as much as friction does.

    This body rate is half of an upper bound on the rate at which the wheel speeds decay. The
    factor of one half is the same as in `linear_terms.square_rate`.
    """
    largest = coupled = 0.0
    if friction is None:
        return largest
    for k in range(friction.efforts.shape[1]):
        place = k // 4 * SIZE + k % 4
        coefficient = friction.wheels[place + FRICTION]
        largest = max(largest, coefficient * friction.wheels[place + INVERSE])
        coupled += coefficient / frame[0][0]
    return 0.25 * (largest + coupled) * (largest + coupled)


@inlined
def acceleration(friction: RowFriction | None, w: Vector, coefficients: Coefficients) -> float:
    """
    Return the magnitude of the body's acceleration due to the wheels, rad/s^2.

    The wheel momenta are those of the grid state.
    """
    if friction is None:
        return 0.0
    torque = four.broadcast(0.0)
    for place in range(0, friction.efforts.shape[1], 4):
        torque = add(torque, _along(friction.wheels, place, _torques(friction, w, place)))
    rate = euler_equations.acceleration_from_torque(coefficients, torque)
    return math.sqrt(dot(rate, rate))


@inlined
def _torques(friction: RowFriction, w: Vector, place: int) -> Four:
    # Return the torques on four wheels, computed from the wheel momenta of the grid state.
    pull = _friction(friction.wheels, place, w, four.load(friction.states.grid, MOMENTA + place))
    return add(pull, four.of(_given(friction, place), _given(friction, place + 1),
                             _given(friction, place + 2), _given(friction, place + 3)))


@inlined
def _given(friction: RowFriction, k: int) -> float:
    # Return the effort of a wheel that gives its command, and zero for another wheel.
    gives = friction.states.grid[MODES + k] <= FREE
    return friction.efforts[max(friction.row, 0), k] if gives else 0.0


@inlined
def _friction(wheels: Floats, place: int, w: Vector, momenta: Four) -> Four:
    # Return the friction torques on four wheels.
    first = place // 4 * SIZE
    rate = add_scaled(add_scaled(scale(w[2], four.load(wheels, first + _Z)), w[1],
                                 four.load(wheels, first + _Y)), w[0],
                      four.load(wheels, first + _X))
    whole = four.fma(momenta, four.load(wheels, first + _LOST_INVERSE),
                     four.multiply(momenta, four.load(wheels, first + INVERSE)))
    return four.multiply(four.load(wheels, first + FRICTION), four.subtract(rate, whole))


@inlined
def _along(wheels: Floats, place: int, amounts: Four) -> Vector:
    # Multiply the axes of four wheels by the given amounts, and return the sum of the products.
    first = place // 4 * SIZE
    return of(dot(amounts, four.load(wheels, first + _X)),
              dot(amounts, four.load(wheels, first + _Y)),
              dot(amounts, four.load(wheels, first + _Z)))


@optional
def of_step(friction: RowFriction, work: Floats) -> StepFriction:
    """
    Return the wheels with friction for a step, or None if there is no friction.

    The series of the wheel momenta do not contain any terms yet.
    """
    return StepFriction(friction, work)


@inlined
def begin(step: StepFriction | None, state: KernelState, coefficients: Coefficients) -> float:
    """Begin the series of the wheel momenta, and return the value that `acceleration` returns."""
    if step is None:
        return 0.0
    friction, series = step
    store_permuted(series, _SUM, four.broadcast(0.0))
    _prepare(friction, series, coefficients)
    for place in range(0, friction.efforts.shape[1], 4):
        four.store(series, place, four.load(friction.states.grid, MOMENTA + place))
        four.store(series, _TORQUES + place, four.multiply(
            four.load(series, _NOT_HELD + place), _torques(friction, state[0], place)))
    return acceleration(friction, state[0], coefficients)


@inlined
def weigh(step: StepFriction | None, angle: float, seconds: float) -> None:
    """Compute weights that make the wheel momenta comparable to the turn angle of the body."""
    if step is None:
        return
    friction, series = step
    for k in range(friction.efforts.shape[1]):
        inverse = friction.wheels[k // 4 * SIZE + k % 4 + INVERSE]
        size = abs(series[k]) + seconds * abs(series[_TORQUES + k])
        speed = inverse * size + angle / seconds
        series[_WEIGHTS + k] = angle * inverse / speed if speed > 0.0 else 0.0


@inlined
def add_acceleration(u: Vector, step: StepFriction | None, table: Floats, k: int, seconds: float,
                     coefficients: Coefficients) -> Vector:
    """
    Return a vector plus seconds^2 times the order-k term of the acceleration due to the wheels.

    The arguments are the same as for `fields.add_acceleration`. The function also computes
    the terms of order k + 1 of the wheel momenta.
    """
    if step is None:
        return u
    friction, series = step
    w = scale(1.0 / seconds, four.load(table, row_of(table, k) + U))
    factor, row = seconds * float(RECIPROCALS[k]), _ORDER * k
    torque = four.broadcast(0.0)
    for place in range(0, friction.efforts.shape[1], 4):
        torques = four.load(series, _TORQUES + place) if k == 0 else four.multiply(
            four.load(series, _NOT_HELD + place),
            _friction(friction.wheels, place, w, four.load(series, row + place)))
        torque = add(torque, _along(friction.wheels, place, torques))
        four.store(series, row + _ORDER + place, scale(factor, torques))
    # In body axes, the total wheel momentum changes because torques act and because the body
    # turns.
    turn = scale((k + 1) / seconds, turned(series, _SUM, _ORDER, table, k))
    u = add_scaled(u, seconds * seconds, euler_equations.acceleration_from_torque(
        coefficients, four.subtract(turn, torque)))
    if series[_COUNT] > 0.0:
        held = _hold(step, u, row + _ORDER, factor / (seconds * seconds))
        torque = add_scaled(torque, 1.0 / (seconds * seconds), held)
        u = four.subtract(u, euler_equations.acceleration_from_torque(coefficients, held))
    store_permuted(series, row + _ORDER + _SUM, scale(factor, torque))
    return u


@internal
def _prepare(friction: RowFriction, series: Floats, coefficients: Coefficients) -> None:
    # Invert the matrix of the equations for the torques T on the wheels whose speed is held. With
    # the acceleration b without these torques, a wheel needs T = I a . w', and the body reacts:
    #   T_i / I_i + sum of (a_i . J^-1 a_j) T_j = a_i . b
    count = friction.efforts.shape[1]
    series[_COUNT] = 0.0
    for i in range(count):
        held = friction.states.grid[MODES + i] == HELD
        series[_NOT_HELD + i] = 0.0 if held else 1.0
        series[_COUNT] += 1.0 if held else 0.0
    if series[_COUNT] == 0.0:
        return
    for i in range(count):
        reaction = euler_equations.acceleration_from_torque(
            coefficients, axis_of(friction.wheels, i))
        for j in range(count):
            both = (1.0 - series[_NOT_HELD + i]) * (1.0 - series[_NOT_HELD + j])
            entry = both * dot(axis_of(friction.wheels, j), reaction)
            if i == j:
                entry += friction.wheels[i // 4 * SIZE + i % 4 + INVERSE] if both > 0.0 else 1.0
            series[_MATRIX + MOST_WHEELS * i + j] = entry
    _invert(series, count)


@internal
def _invert(series: Floats, count: int) -> None:
    # Invert a symmetric positive definite matrix in its place, by Gauss and Jordan.
    for k in range(count):
        row = _MATRIX + MOST_WHEELS * k
        pivot = 1.0 / series[row + k]
        series[row + k] = 1.0
        for j in range(count):
            series[row + j] *= pivot
        for i in range(count):
            if i != k:
                other = _MATRIX + MOST_WHEELS * i
                factor = series[other + k]
                series[other + k] = 0.0
                for j in range(count):
                    series[other + j] -= factor * series[row + j]


@internal
def _hold(step: StepFriction, u: Vector, row: int, factor: float) -> Vector:
    # Return the term, in units of the step, of the torque on the wheels whose speed is held, and
    # store the terms of their momenta in a row. `u` is the term of the acceleration without it.
    friction, series = step
    count, torque = friction.efforts.shape[1], four.broadcast(0.0)
    for i in range(count):
        series[_RATES + i] = (1.0 - series[_NOT_HELD + i]) * dot(axis_of(friction.wheels, i), u)
    for i in range(count):
        if series[_NOT_HELD + i] == 0.0:
            term = 0.0
            for j in range(count):
                term += series[_MATRIX + MOST_WHEELS * i + j] * series[_RATES + j]
            series[row + i] = factor * term
            torque = add_scaled(torque, term, axis_of(friction.wheels, i))
    return torque


@inlined
def with_momenta(size: float, step: StepFriction | None, k: int) -> float:
    """
    Return the size of the terms of order k, including the terms of the wheel momenta.

    The terms of the wheel momenta are weighted; see `weigh`.
    """
    if step is None:
        return size
    friction, series = step
    for place in range(0, friction.efforts.shape[1], 4):
        size += total(four.multiply(four.load(series, _WEIGHTS + place), four.absolute(
            four.load(series, _ORDER * k + place))))
    return size


@inlined
def end(step: StepFriction | None, order: int, seconds: float) -> None:
    """Sum the series of the wheels up to an order, and store the latest momenta and efforts."""
    if step is None:
        return
    friction, series = step
    states = friction.states
    for k in range(friction.efforts.shape[1]):
        states.latest[MODES + k] = states.grid[MODES + k]
        states.latest[EFFORTS + k] = _given(friction, k)
        if series[_NOT_HELD + k] == 0.0:
            states.latest[EFFORTS + k] = held_effort(step, k, order, seconds)
    for place in range(0, friction.efforts.shape[1], 4):
        change = four.broadcast(0.0)
        for k in range(order, 0, -1):  # begin with the smallest terms
            change = add(change, four.load(series, _ORDER * k + place))
        high, low = accumulate(four.load(states.grid, MOMENTA + place),
                               four.load(states.grid, LOST_MOMENTA + place), change)
        four.store(states.latest, MOMENTA + place, high)
        four.store(states.latest, LOST_MOMENTA + place, low)


@inlined
def term(step: StepFriction, k: int, order: int) -> float:
    """Return a term of the momentum of a wheel, N m s."""
    return step.series[_ORDER * order + k]


@inlined
def held_effort(step: StepFriction, k: int, order: int, seconds: float) -> float:
    """Return the effort at the end of a step that holds the speed of a wheel, N m."""
    effort = 0.0
    for m in range(order, 0, -1):
        effort += m * step.series[_ORDER * m + k]
    return effort / seconds + resisting(step.friction, k)


@inlined
def resisting(friction: RowFriction, k: int) -> float:
    """Return the effort that friction takes at the largest speed, N m."""
    place = k // 4 * SIZE + k % 4
    return math.copysign(friction.wheels[place + FRICTION] * friction.wheels[place + LARGEST],
                         friction.efforts[max(friction.row, 0), k])
