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
Torques that follow their commands with a first-order lag.

The torque y follows its command u with time constant T, according to T y' + y = u. Suppose that
the torque is y0 and that the command is held constant from now on. Then the torque after t seconds
is

    y = u + (y0 - u) exp(-t / T).

The rows contain the command u. The difference y - u is called the *excess*. It decays with time,
and it is expressed in the axes of the command, which are either body axes or space axes. After
EXPIRY time constants, the excess is set to zero.

The factor e = exp(-t / T) obeys e' = -e / T, so each term of the Taylor series of e follows from
the previous term. For an excess in space axes, the body components v obey v' = v x w - v / T.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.kernels import double_double, elementary, euler_equations, four, vector
from rigid_body_ros.kernels.jit import inlined, internal, njit, optional, WRITTEN
from rigid_body_ros.kernels.series_table import (
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    store_permuted,
    turned,
)

#: Number of time constants after which an excess is set to zero: exp(-40) is 4e-18.
EXPIRY = 40.0
#: A scene can have at most this many different time constants.
MOST = 4
#: Number of doubles for one order of the series. Each order stores the excesses in space axes, one
#: for each time constant.
_ORDER = PERMUTED * MOST
#: Where the latest terms of the excesses in body axes are stored. These terms come after the
#: vectors of all orders.
_BODY = _ORDER * (MAX_ORDER + 1)
WORKSPACE = _BODY + 4 * MOST


class RowLags(NamedTuple):
    """The excess torques that act on the body while one row is in force."""

    #: The excesses of all rows; see `layout.Lags`.
    excess: Floats
    time_constants: Floats
    row: int


@inlined
def excess(lags: RowLags, i: int, axes: int) -> vector.Vector:
    """
    Return the excess for time constant `i` at the time when the row begins, N m.

    `axes` is 0 for body axes and 1 for space axes.
    """
    excesses = lags.excess
    return vector.of(excesses[lags.row, i, axes, 0], excesses[lags.row, i, axes, 1],
                     excesses[lags.row, i, axes, 2])


@inlined
def acts(lags: RowLags | None) -> bool:
    """Return whether any excess acts on the body while a row is in force."""
    return square_rate(lags) > 0.0


@inlined
def square_rate(lags: RowLags | None) -> float:
    """Return the square of the fastest decay rate of the excesses, 1/s^2; 0 if there are none."""
    largest = 0.0
    if lags is None:
        return largest
    if lags.row < 0:
        return largest
    for i in range(len(lags.time_constants)):
        if not (vector.is_zero(excess(lags, i, 0))
                and vector.is_zero(excess(lags, i, 1))):
            rate = 1.0 / lags.time_constants[i]
            largest = max(largest, rate * rate)
    return largest


@inlined
def torque_bound(lags: RowLags | None) -> float:
    """Return an upper bound on the magnitude of the sum of a row's excesses, N m."""
    bound = 0.0
    if lags is None:
        return bound
    if lags.row < 0:
        return bound
    for i in range(len(lags.time_constants)):
        body, space = excess(lags, i, 0), excess(lags, i, 1)
        bound += math.sqrt(vector.dot(body, body)) + math.sqrt(vector.dot(space, space))
    return bound


@inlined
def decay(seconds: float, time_constant: float) -> float:
    """Return the factor by which an excess decays within the given number of seconds."""
    return elementary.exponential(-seconds / time_constant)


@internal
def torque(lags: RowLags, seconds: float, q: vector.Quaternion) -> vector.Vector:
    """Return the sum of the excesses in body axes, N m, `seconds` after the row begins."""
    body = space = vector.of(0.0, 0.0, 0.0)
    for i in range(len(lags.time_constants)):
        factor = decay(seconds, lags.time_constants[i])
        body = vector.add_scaled(body, factor, excess(lags, i, 0))
        space = vector.add_scaled(space, factor, excess(lags, i, 1))
    return vector.add(body, vector.to_body(q, space))


class CommandChanges(NamedTuple):
    """The commands from one source, and the torques that follow these commands."""

    #: The times at which the command changes, ns, ascending.
    times_ns: Annotated[Ints, 'm']
    #: The command that takes effect at each change, N m, as a row in body axes and a row in space
    #: axes. One of the two rows is zero.
    commands: Annotated[Floats, 'm 2 3']
    #: The torque at each change, N m, followed by its low-order part. The caller sets the torque
    #: at the first change.
    torques: Annotated[Floats, 'm 2 6', WRITTEN]


@njit
def add_lag(row_times_ns: Annotated[Ints, 'n'], source: CommandChanges, time_constant: float,
            expiry_ns: int, which: int, into: Annotated[Floats, 'n l 2 3', WRITTEN]) -> None:
    """
    Compute the excess of one source at the time of each row, and add it to an array.

    Parameters
    ----------
    row_times_ns : int64 (n,), ns
        The times of the rows, in ascending order.
    source : CommandChanges
        The commands of the source. The kernel fills in the torques after the first change.
    time_constant : float, s
        The time constant T of the source.
    expiry_ns : int, ns
        The duration of EXPIRY time constants.
    which : int
        Index of the time constant in `into`.
    into : float64 (n, l, 2, 3), N m
        The array to which the excess is added.

    """
    changes_ns, commands, torques = source
    last_ns, share = -1, 0.0
    for k in range(1, len(changes_ns)):
        span_ns = changes_ns[k] - changes_ns[k - 1]
        if span_ns != last_ns:
            last_ns, share = span_ns, _share(span_ns / 1e9, time_constant)
        for axes in range(2):
            for j in range(3):
                command = commands[k - 1, axes, j]
                high, low = command, 0.0
                if span_ns < expiry_ns:
                    high, low = torques[k - 1, axes, j], torques[k - 1, axes, j + 3]
                    # The torque moves toward the command by a share of the remaining difference.
                    # Because each change also shrinks earlier errors, the total error is only as
                    # large as the error of a single change.
                    high, lost = double_double.two_sum(high, share * ((command - high) - low))
                    high, low = double_double.quick_two_sum(high, lost + low)
                torques[k, axes, j], torques[k, axes, j + 3] = high, low
    k = -1
    for row in range(len(row_times_ns)):
        while k + 1 < len(changes_ns) and changes_ns[k + 1] <= row_times_ns[row]:
            k += 1
        if k < 0 or row_times_ns[row] - changes_ns[k] >= expiry_ns:
            continue
        factor = decay((row_times_ns[row] - changes_ns[k]) / 1e9, time_constant)
        for axes in range(2):
            for j in range(3):
                rest = (torques[k, axes, j] - commands[k, axes, j]) + torques[k, axes, j + 3]
                into[row, which, axes, j] += factor * rest


@njit
def lag_slopes(times_ns: Annotated[Ints, 'n'], excess: Annotated[Floats, 'n l 2 3'],
               time_constants: Annotated[Floats, 'l'],
               into: Annotated[Floats, 'n l 2 3', WRITTEN]) -> None:
    """
    Compute the derivatives of torques with respect to their time constants.

    The derivative z of the torque y obeys T z' + z = -y'. It is zero at the first of the times,
    ns, which include all changes of the commands. The excess is that at these times.
    """
    for row in range(1, len(times_ns)):
        seconds = (times_ns[row] - times_ns[row - 1]) / 1e9
        for i in range(len(time_constants)):
            factor = decay(seconds, time_constants[i])
            share = seconds / (time_constants[i] * time_constants[i])
            for axes in range(2):
                for j in range(3):
                    rest = excess[row - 1, i, axes, j]
                    into[row, i, axes, j] = factor * (into[row - 1, i, axes, j] + share * rest)


@internal
def _share(seconds: float, time_constant: float) -> float:
    # Return 1 - exp(-t / T), accurate to the last digits even if t is much shorter than T.
    growth = elementary.expm1(min(seconds / time_constant, 700.0))
    return double_double.divide(growth, double_double.add((1.0, 0.0), growth))[0]


class StepLags(NamedTuple):
    """The excesses that act during a step, and the terms of their series."""

    lags: RowLags
    #: The time from the beginning of the row to the beginning of the step, s.
    since: float
    #: Array of size WORKSPACE.
    vectors: Floats


@optional
def of_step(lags: RowLags, since: float, work: Floats) -> StepLags:
    """
    Return the excesses that act during a step, or None if the scene has no lags.

    The series of the returned excesses do not contain any terms yet.
    """
    return StepLags(lags, since, work)


@inlined
def begin(step: StepLags | None, state: vector.KernelState) -> None:
    """Store the first term of each excess's series, for a step that begins at the given state."""
    if step is None:
        return
    lags, since, vectors = step
    for i in range(len(lags.time_constants)):
        factor = decay(since, lags.time_constants[i])
        four.store(vectors, _BODY + 4 * i, vector.scale(factor, excess(lags, i, 0)))
        store_permuted(vectors, PERMUTED * i,
                       vector.to_body(state[1], vector.scale(factor, excess(lags, i, 1))))


@inlined
def add_acceleration(u: vector.Vector, step: StepLags | None, table: Floats, k: int,
                     seconds: float, coefficients: vector.Coefficients) -> vector.Vector:
    """
    Return a vector plus seconds^2 times the order-k term of the acceleration due to the lags.

    The arguments are the same as those of `fields.add_acceleration`.
    """
    if step is None:
        return u
    lags, vectors, torque = step.lags, step.vectors, four.broadcast(0.0)
    for i in range(len(lags.time_constants)):
        factor = -seconds / lags.time_constants[i] * float(RECIPROCALS[k])
        term = four.load(vectors, _BODY + 4 * i)
        torque = vector.add(torque, term)
        four.store(vectors, _BODY + 4 * i, vector.scale(factor, term))
        if vector.is_zero(excess(lags, i, 1)):
            continue
        term = four.load(vectors, _ORDER * k + PERMUTED * i)
        torque = vector.add(torque, term)
        store_permuted(vectors, _ORDER * (k + 1) + PERMUTED * i, vector.add_scaled(
            turned(vectors, PERMUTED * i, _ORDER, table, k), factor, term))
    return vector.add_scaled(u, seconds * seconds, euler_equations.acceleration_from_torque(
        coefficients, torque))


@inlined
def space_term(step: StepLags | None, k: int) -> vector.Vector:
    """Return the order-k term of the excess in space axes, in body axes."""
    total = four.broadcast(0.0)
    if step is None:
        return total
    for i in range(len(step.lags.time_constants)):
        if not vector.is_zero(excess(step.lags, i, 1)):
            total = vector.add(total, four.load(step.vectors, _ORDER * k + PERMUTED * i))
    return total
