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

"""Compute a histogram of angles or other nonnegative numbers."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats

#: Maximum number of bars in a histogram.
_BARS = 60
#: The axis is logarithmic if the 99th percentile exceeds the 5th by more than this factor.
_DECADES = 100.0


def histogram(angles: Floats, percentiles: Mapping[str, float]) -> dict[str, Any]:
    """
    Return a histogram of angles, as JSON types.

    Parameters
    ----------
    angles : array, shape (n,), rad
        The angle of each run. There must be at least one.
    percentiles : mapping
        The percentiles 'p1', 'p5', 'p99' and 'p100' of the angles, rad.

    Returns
    -------
    dict
        'edges_rad', shape (m + 1,), contains the edges of the intervals, and 'runs', shape (m,),
        the number of runs in each interval. Normally, the intervals have equal widths and range
        from 0 to the largest angle. If the angles span several decades, the intervals instead have
        equal widths on a logarithmic axis. The first of these intervals begins at a tenth of the
        first percentile or at the smallest angle, whichever is larger, and also counts all smaller
        angles.

    """
    bars = min(math.isqrt(angles.size), _BARS)
    largest = max(percentiles['p100'], float(np.finfo(float).tiny))
    if percentiles['p1'] > 0.0 and _DECADES * percentiles['p5'] < percentiles['p99']:
        edges = np.geomspace(max(0.1 * percentiles['p1'], angles.min()), largest, bars + 1)
    else:
        edges = np.linspace(0.0, largest, bars + 1)
    counts, _ = np.histogram(np.maximum(angles, edges[0]), edges)
    return {'edges_rad': edges.tolist(), 'runs': counts.tolist()}
