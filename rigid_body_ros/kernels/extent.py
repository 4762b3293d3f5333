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

"""Find the earliest and the latest time in an array."""

from __future__ import annotations

from typing import Annotated

from rigid_body_ros.common.arrays import Ints
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.kernels.jit import njit


@njit
def extent(times_ns: Annotated[Ints, 'n']) -> tuple[bool, int, int]:
    """Return whether the times are in ascending order, the earliest time and the latest time."""
    ascends, first, last = True, NEVER_NS, -NEVER_NS
    for k in range(len(times_ns)):
        ascends = ascends and (k == 0 or times_ns[k] >= times_ns[k - 1])
        first, last = min(first, times_ns[k]), max(last, times_ns[k])
    return ascends, first, last
