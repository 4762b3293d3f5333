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
The memory layout of a state: four vectors of four doubles, and the wheel momenta.

The first vector is the angular velocity (rad/s, body axes) followed by a zero, and the second is
the attitude x y z w. The third and fourth vectors are the low-order parts of the first two.
Because the state includes these low-order parts, a run that is stopped and resumed gives the same
bits as an uninterrupted run. After the vectors come the axial momenta of the wheels with friction
or a largest speed (N m s), the low-order parts of these momenta, the modes of the wheels (see
`limits`), and the efforts that their motors apply (N m). If there are no such wheels, zeros take
their place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import four, vector
from rigid_body_ros.kernels.jit import internal

#: The offsets of the four vectors.
RATES, ATTITUDE, _LOST_RATES, _LOST_ATTITUDE = range(0, 16, 4)
SIZE = 16
#: The largest number of wheels in a scene in which any wheel has friction or a largest speed.
MOST_WHEELS = 8
MOMENTA, LOST_MOMENTA = SIZE, SIZE + MOST_WHEELS
MODES, EFFORTS = LOST_MOMENTA + MOST_WHEELS, LOST_MOMENTA + 2 * MOST_WHEELS
WITH_WHEELS = EFFORTS + MOST_WHEELS


def pack(rates: ArrayLike, attitude: ArrayLike,
         lost_rates: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
    """
    Return a state as an array of shape (WITH_WHEELS,), with zeros for the wheel momenta.

    Parameters
    ----------
    rates : array, shape (3,), rad/s, body axes
        The angular velocity.
    attitude : array, shape (4,)
        The attitude, x y z w.
    lost_rates : array, shape (3,), rad/s, body axes
        The low-order part of the angular velocity.

    """
    packed = np.zeros(WITH_WHEELS)
    packed[RATES:RATES + 3] = rates
    packed[ATTITUDE:ATTITUDE + 4] = attitude
    packed[_LOST_RATES:_LOST_RATES + 3] = lost_rates
    return packed


def angular_velocity(packed: Floats) -> Floats:
    """Return a view of the angular velocity, shape (3,), rad/s, body axes."""
    return packed[RATES:RATES + 3]


def attitude(packed: Floats) -> Floats:
    """Return a view of the attitude, shape (4,), x y z w."""
    return packed[ATTITUDE:ATTITUDE + 4]


def momenta(packed: Floats) -> Floats:
    """
    Return a view of the axial wheel momenta and their low-order parts, N m s.

    The shape is (2, MOST_WHEELS).
    """
    return packed[MOMENTA:MODES].reshape(2, MOST_WHEELS)


def efforts(packed: Floats) -> Floats:
    """Return a view of the efforts that the motors apply, N m, shape (MOST_WHEELS,)."""
    return packed[EFFORTS:]


@internal
def load(packed: Floats, start: int) -> vector.KernelState:
    """Return the state that begins at the index `start` of an array."""
    return (four.load(packed, start + RATES), four.load(packed, start + ATTITUDE),
            four.load(packed, start + _LOST_RATES), four.load(packed, start + _LOST_ATTITUDE))


@internal
def store(state: vector.KernelState, packed: Floats, start: int) -> None:
    """Write a state to an array, beginning at the index `start`."""
    four.store(packed, start + RATES, state[0])
    four.store(packed, start + ATTITUDE, state[1])
    four.store(packed, start + _LOST_RATES, state[2])
    four.store(packed, start + _LOST_ATTITUDE, state[3])
