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

"""Validation of the times at which a motion is requested."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.times import instants, NEVER_NS
from rigid_body_ros.engine import kernels


def checked_times(at: ArrayLike, start_ns: int) -> tuple[NDArray[np.int64], bool, int]:
    """Return the times, whether the times ascend, and the latest time, or raise ValueError."""
    times = instants(at, 'at')
    if times.size > 1:
        ascends, first_ns, last_ns = kernels.extent(times)
    else:  # calling a kernel here would double the time that this function takes
        ascends, (first_ns, last_ns) = True, 2 * (times.tolist() or [start_ns])
    if first_ns < start_ns:
        raise ValueError(f'at: expected no time before the start ({start_ns} ns), '
                         f'found {first_ns} ns')
    if last_ns == NEVER_NS:
        raise ValueError(f'at: expected times before {NEVER_NS} ns, found {last_ns} ns')
    if last_ns - start_ns >= NEVER_NS:
        raise ValueError(f'at: expected times within 292 years of the start ({start_ns} ns), '
                         f'found {last_ns} ns')
    return times, ascends, int(last_ns)  # kernels that run as Python return numpy integers
