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

"""Bodies that change at given times, for example when a payload is dropped or an arm deploys."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instants, NEVER_NS
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State

#: The quantities that can stay the same when a body changes: its angular velocity ('rate') or its
#: angular momentum ('momentum'). See `BodyLog`.
KEEPS = RATE, MOMENTUM = 'rate', 'momentum'


class BodyLog:
    """
    The bodies that replace the first body of a motion, each at its own stamp.

    Parameters
    ----------
    times_ns : array of int, shape (n,), ns
        The stamps of the bodies, in any order. If several bodies have the same stamp, only the
        last one is used.
    bodies : sequence of n RigidBody
        The new body at each stamp.
    keep : str
        What stays the same when the body changes. With 'rate', the angular velocity stays the
        same. This describes a dropped payload, which takes its momentum with it. With 'momentum',
        the momentum J w of the body stays the same and the angular velocity jumps. This describes
        an arm that deploys in an instant. Either way, the rotors keep their momentum. Named wheels
        keep their axial momentum, which is I (Omega + a . w) for a wheel with axial inertia I,
        axis a and speed Omega.

    Attributes
    ----------
    times_ns : array of int64, shape (m,), ns
        The stamps, strictly ascending.
    bodies : tuple of m RigidBody
    keep : str

    Raises
    ------
    ValueError
        The numbers of stamps and bodies differ, a stamp is not an integer that fits in int64, or
        `keep` is neither 'rate' nor 'momentum'.

    """

    def __init__(self, times_ns: ArrayLike, bodies: Sequence[RigidBody],
                 keep: str = RATE) -> None:
        stamps_ns = instants(times_ns)
        if stamps_ns.size != len(bodies):
            raise ValueError(f'bodies: expected {stamps_ns.size}, one for each stamp, '
                             f'found {len(bodies)}')
        self.keep = checked_keep(keep)
        body_at = dict(zip(stamps_ns.tolist(), bodies))
        self.times_ns: NDArray[np.int64] = np.array(sorted(body_at), np.int64)
        self.times_ns.flags.writeable = False
        self.bodies = tuple(body_at[stamp_ns] for stamp_ns in self.times_ns.tolist())

    def __len__(self) -> int:
        return len(self.bodies)

    def __repr__(self) -> str:
        return f"BodyLog({len(self)} changes, keep '{self.keep}')"

    def in_force(self, time_ns: int) -> int:
        """Return the index of the last change at or before a given time; -1 if there is none."""
        return int(self.times_ns.searchsorted(time_ns, 'right')) - 1

    def next_ns(self, time_ns: int) -> int:
        """Return the stamp of the first change after a given time; NEVER_NS if there is none."""
        later_ns = self.times_ns[self.in_force(time_ns) + 1:]
        return int(later_ns[0]) if len(later_ns) else NEVER_NS


def checked_keep(keep: str) -> str:
    """Return `keep`, or raise ValueError if it is neither 'rate' nor 'momentum'."""
    if keep not in KEEPS:
        raise ValueError(f"keep: expected 'rate' or 'momentum', found {keep!r}")
    return keep


def changed(state: State, before: RigidBody, after: RigidBody, keep: str) -> State:
    """
    Return the state right after a change of the body.

    Parameters
    ----------
    state : State
        The state right before the change.
    before, after : RigidBody
        The body before and after the change.
    keep : str
        See `BodyLog`.

    """
    rates, attitude, lost_rates, lost_attitude, *momenta = state._packed.reshape(-1, 4)
    if keep == MOMENTUM:
        rates, lost_rates = _rates_that_keep_momentum(rates, lost_rates, before, after)
    packed = np.concatenate([rates, attitude, lost_rates, lost_attitude, *momenta])
    return State._as_computed(state.time_ns, packed, None, state._rotors)


def _rates_that_keep_momentum(rates: Floats, lost_rates: Floats, before: RigidBody,
                              after: RigidBody) -> tuple[Floats, Floats]:
    # Solve J' w' = J w by Cramer's rule. Exact fractions avoid rounding errors.
    w = [Fraction(high) + Fraction(low) for high, low in zip(rates[:3], lost_rates[:3])]
    momentum = [_dot(row, w) for row in _exact(before)]
    x, y, z = _exact(after)
    volume = _dot(x, _cross(y, z))
    exact = [_dot(momentum, column) / volume for column in (
        _cross(y, z), _cross(z, x), _cross(x, y))]
    high = [float(rate) for rate in exact]
    low = [float(rate - Fraction(rounded)) for rate, rounded in zip(exact, high)]
    return np.array([*high, 0.0]), np.array([*low, 0.0])


def _exact(body: RigidBody) -> list[list[Fraction]]:
    return [[Fraction(entry) for entry in row] for row in body._exact.tolist()]


def _cross(a: Sequence[Fraction], b: Sequence[Fraction]) -> list[Fraction]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    return sum((p * q for p, q in zip(a, b)), Fraction(0))
