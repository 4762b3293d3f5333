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
Taylor series of the decaying torques described in `lags`.

The factor e = exp(-t / T) obeys e' = -e / T, so each term of the series of e follows from the
previous term. For an excess in space axes, the body components v obey v' = v x w - v / T.
"""

from __future__ import annotations

from typing import NamedTuple

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import euler_equations, four, lags
from rigid_body_ros.kernels.jit import inlined, optional
from rigid_body_ros.kernels.lags import RowLags
from rigid_body_ros.kernels.series_table import (
    MAX_ORDER,
    PERMUTED,
    RECIPROCALS,
    store_permuted,
    turned,
)
from rigid_body_ros.kernels.vector import (
    add,
    add_scaled,
    Coefficients,
    is_zero,
    KernelState,
    scale,
    to_body,
    Vector,
)

#: Number of doubles for one order of the series. Each order stores the excesses in space axes, one
#: for each time constant.
_ORDER = PERMUTED * lags.MOST
#: Where the latest terms of the excesses in body axes are stored. These terms come after the
#: vectors of all orders.
_BODY = _ORDER * (MAX_ORDER + 1)
WORKSPACE = _BODY + 4 * lags.MOST


class StepLags(NamedTuple):
    """The excesses that act during a step, and the terms of their series."""

    lags: RowLags
    #: The time from the beginning of the row to the beginning of the step, s.
    since: float
    #: Array of size WORKSPACE.
    vectors: Floats


@optional
def workspace(_found: RowLags, work: Floats) -> Floats:
    """Return the workspace, or None if the scene has no lags."""
    return work


@optional
def of_step(found: RowLags, since: float, work: Floats) -> StepLags:
    """
    Return the excesses that act during a step, or None if the scene has no lags.

    The series of the returned excesses do not contain any terms yet.
    """
    return StepLags(found, since, work)


@inlined
def begin(step: StepLags | None, state: KernelState) -> None:
    """Store the first term of each excess's series, for a step that begins at the given state."""
    if step is None:
        return
    found, since, vectors = step
    for i in range(len(found.time_constants)):
        factor = lags.decay(since, found.time_constants[i])
        four.store(vectors, _BODY + 4 * i, scale(factor, lags.excess(found, i, 0)))
        store_permuted(vectors, PERMUTED * i,
                       to_body(state[1], scale(factor, lags.excess(found, i, 1))))


@inlined
def add_acceleration(u: Vector, step: StepLags | None, table: Floats, k: int, seconds: float,
                     coefficients: Coefficients) -> Vector:
    """
    Return a vector plus seconds^2 times the order-k term of the acceleration due to the lags.

    The arguments are the same as those of `field_series.add_acceleration`.
    """
    if step is None:
        return u
    found, vectors, torque = step.lags, step.vectors, four.broadcast(0.0)
    for i in range(len(found.time_constants)):
        factor = -seconds / found.time_constants[i] * float(RECIPROCALS[k])
        term = four.load(vectors, _BODY + 4 * i)
        torque = add(torque, term)
        four.store(vectors, _BODY + 4 * i, scale(factor, term))
        if is_zero(lags.excess(found, i, 1)):
            continue
        term = four.load(vectors, _ORDER * k + PERMUTED * i)
        torque = add(torque, term)
        store_permuted(vectors, _ORDER * (k + 1) + PERMUTED * i, add_scaled(
            turned(vectors, PERMUTED * i, _ORDER, table, k), factor, term))
    return add_scaled(u, seconds * seconds, euler_equations.acceleration_from_torque(
        coefficients, torque))


@inlined
def space_term(step: StepLags | None, k: int) -> Vector:
    """Return the order-k term of the excess in space axes, in body axes."""
    total = four.broadcast(0.0)
    if step is None:
        return total
    for i in range(len(step.lags.time_constants)):
        if not is_zero(lags.excess(step.lags, i, 1)):
            total = add(total, four.load(step.vectors, _ORDER * k + PERMUTED * i))
    return total


@inlined
def lowest_order(step: StepLags | None) -> int:
    """
    Return an upper bound on how many consecutive terms may be zero by coincidence.

    `taylor.step` uses this bound so that it does not mistake such zeros for convergence.
    """
    return 0 if step is None else 1
