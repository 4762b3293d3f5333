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
Four doubles: a quaternion, or a vector and a zero.

The compiled kernels hold four doubles in one SIMD register. Operations act on each element and
round as operations on single doubles do, so results do not depend on the size of a machine's
registers. Kernels read the elements as a[0] to a[3]. In plain Python, four doubles are a tuple.

The compiled operations also take the quaternions or vectors of several bodies. Such an argument
fills four registers with a lane for each body; see `lanes`. If one argument has lanes, the result
has lanes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.kernels import lanes

Four = tuple[float, float, float, float]


def of(a: float, b: float, c: float, d: float) -> Four:
    """Return four doubles."""
    return a, b, c, d


def broadcast(value: float) -> Four:
    """Return the same double four times."""
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
    """Return Hamilton's product q i."""
    return q[3], q[2], -q[1], -q[0]


def times_j(q: Four) -> Four:
    """Return Hamilton's product q j."""
    return -q[2], q[3], q[0], -q[1]


def times_k(q: Four) -> Four:
    """Return Hamilton's product q k."""
    return q[1], -q[0], q[3], -q[2]


def load(values: NDArray[np.float64], start: int) -> Four:
    """
    Return four successive elements of an array, shape (n,), from an index on.

    With lanes, these are four rows of an array, shape (n, LANES).
    """
    a, b, c, d = values[start:start + 4].tolist()
    return a, b, c, d


def store(values: NDArray[np.float64], start: int, four: Four) -> None:
    """Write four elements to where `load` reads them."""
    values[start:start + 4] = four


def zero(like: Four) -> Four:
    """Return four zeros."""
    return 0.0, 0.0, 0.0, 0.0


def choose(condition: bool, one: Four, other: Four) -> Four:
    """Return, in each lane, the first of two fours if a condition holds, otherwise the second."""
    return one if condition else other


def has_lanes(values: NDArray[np.float64]) -> bool:
    """Return whether an array has lanes; the compiler leaves out the branch that is not taken."""
    return values.ndim == 2
