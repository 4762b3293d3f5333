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

"""Histogram of angles, or of other numbers that are not negative."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats

#: Largest number of bars.
_BARS = 60
#: Ratio of percentiles from which the bars are equally wide on a logarithmic axis.
_DECADES = 100.0


def histogram(angles: Floats, percentiles: Mapping[str, float]) -> dict[str, Any]:
    """
    Return the number of runs with an angle in each of some intervals, as JSON.

    Parameters
    ----------
    angles : array, shape (n,), rad
        At least one.
    percentiles : mapping
        Their percentiles 'p1', 'p5', 'p99' and 'p100', rad.

    Returns
    -------
    dict
        'edges_rad', shape (m + 1,), and 'runs', shape (m,). The intervals are equally wide from 0
        to the largest angle. If the angles span decades, they are equally wide on a logarithmic
        axis, from a tenth of the first percentile or the smallest angle, whichever is larger. The
        first interval also has all smaller angles.

    """
    bars = min(math.isqrt(angles.size), _BARS)
    largest = max(percentiles['p100'], float(np.finfo(float).tiny))
    if percentiles['p1'] > 0.0 and _DECADES * percentiles['p5'] < percentiles['p99']:
        edges = np.geomspace(max(0.1 * percentiles['p1'], angles.min()), largest, bars + 1)
    else:
        edges = np.linspace(0.0, largest, bars + 1)
    counts, _ = np.histogram(np.maximum(angles, edges[0]), edges)
    return {'edges_rad': edges.tolist(), 'runs': counts.tolist()}
