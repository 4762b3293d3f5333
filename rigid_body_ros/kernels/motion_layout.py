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
The memory layout of a motion at m times: a block of 7 m doubles.

The block contains m attitudes (x y z w), followed by m angular velocities (rad/s, body axes).
Using one block instead of two saves time: when two blocks are freed together, the operating system
reclaims their memory, and the next run then spends as much time on getting this memory back as on
its arithmetic.
"""

from __future__ import annotations

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import four, state_layout, vector
from rigid_body_ros.kernels.jit import inlined, internal

_ATTITUDE, _RATES = 4, 3
#: Number of doubles for each time.
SIZE = _ATTITUDE + _RATES


def allocate(count: int) -> Floats:
    """Return an uninitialized block for a motion at `count` times."""
    return np.empty(SIZE * count)


def attitude(motion: Floats) -> Floats:
    """Return a view of the attitudes, shape (m, 4), x y z w."""
    return motion[:len(motion) // SIZE * _ATTITUDE].reshape(-1, _ATTITUDE)


def angular_velocity(motion: Floats) -> Floats:
    """Return a view of the angular velocities, shape (m, 3), rad/s, body axes."""
    return motion[len(motion) // SIZE * _ATTITUDE:].reshape(-1, _RATES)


@inlined
def store(state: vector.KernelState, row: int, motion: Floats) -> None:
    """Write the attitude and the angular velocity of a state to one row of a motion."""
    rates, start = state[0], len(motion) // SIZE * _ATTITUDE + _RATES * row
    four.store(motion, _ATTITUDE * row, state[1])
    motion[start], motion[start + 1], motion[start + 2] = rates[0], rates[1], rates[2]


@internal
def store_packed(packed: Floats, row: int, motion: Floats) -> None:
    """Write the attitude and the angular velocity of a packed state to one row of a motion."""
    start = len(motion) // SIZE * _ATTITUDE + _RATES * row
    for k in range(_ATTITUDE):
        motion[_ATTITUDE * row + k] = packed[state_layout.ATTITUDE + k]
    for k in range(_RATES):
        motion[start + k] = packed[state_layout.RATES + k]
