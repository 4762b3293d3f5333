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
Arithmetic on four doubles at once.

The four doubles are a quaternion, or a vector followed by a zero. The compiled kernels keep them
in one SIMD register, and read them as a[0] to a[3]. In plain Python, four doubles are a tuple.
Operations act element by element, with the same rounding as operations on single doubles, so the
results do not depend on how large the registers of a machine are.

The compiled operations can also process the quaternions or vectors of several bodies at once. Then
an argument consists of four registers, each with one lane per body; see `lanes`. The result has
lanes if any of the arguments does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.kernels import lanes

Four = tuple[float, float, float, float]


def of(a: float, b: float, c: float, d: float) -> Four:
    """Return four separate doubles combined into one `Four`."""
    return a, b, c, d


def broadcast(value: float) -> Four:
    """Return four copies of a double."""
    return value, value, value, value


def add(a: Four, b: Four) -> Four:
    """Return the sum, element by element."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]


def subtract(a: Four, b: Four) -> Four:
    """Return the difference, element by element."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]


def multiply(a: Four, b: Four) -> Four:
    """Return the product, element by element."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]


def negative(a: Four) -> Four:
    """Return each element with its sign changed."""
    return -a[0], -a[1], -a[2], -a[3]


def absolute(a: Four) -> Four:
    """Return the magnitude of each element."""
    return abs(a[0]), abs(a[1]), abs(a[2]), abs(a[3])


def fma(a: Four, b: Four, c: Four) -> Four:
    """Return a b + c, element by element, rounded once."""
    return (lanes.fma(a[0], b[0], c[0]), lanes.fma(a[1], b[1], c[1]),
            lanes.fma(a[2], b[2], c[2]), lanes.fma(a[3], b[3], c[3]))


def yzx(a: Four) -> Four:
    """Return the components of a vector in the order y, z, x."""
    return a[1], a[2], a[0], a[3]


def zxy(a: Four) -> Four:
    """Return the components of a vector in the order z, x, y."""
    return a[2], a[0], a[1], a[3]


def times_i(q: Four) -> Four:
    """Return the quaternion product q i, as Hamilton defined it."""
    return q[3], q[2], -q[1], -q[0]


def times_j(q: Four) -> Four:
    """Return the quaternion product q j, as Hamilton defined it."""
    return -q[2], q[3], q[0], -q[1]


def times_k(q: Four) -> Four:
    """Return the quaternion product q k, as Hamilton defined it."""
    return q[1], -q[0], q[3], -q[2]


def load(values: NDArray[np.float64], start: int) -> Four:
    """
    Load four consecutive elements of an array of shape (n,), beginning at the index `start`.

    If the array has lanes, and thus shape (n, LANES), load four consecutive rows.
    """
    a, b, c, d = values[start:start + 4].tolist()
    return a, b, c, d


def store(values: NDArray[np.float64], start: int, four: Four) -> None:
    """Store four doubles in the elements from which `load` would load them."""
    values[start:start + 4] = four


def zero(like: Four) -> Four:
    """Return four zeros, with lanes if the argument has lanes."""
    return 0.0, 0.0, 0.0, 0.0


def choose(condition: bool, one: Four, other: Four) -> Four:
    """Return `one` where the condition holds, and `other` where the condition does not hold."""
    return one if condition else other


def has_lanes(values: NDArray[np.float64]) -> bool:
    """
    Return whether an array has lanes.

    The result is known at compile time. If you branch on it, the compiler drops the branch that is
    never taken.
    """
    return values.ndim == 2
