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

"""Estimate for how long a motion can be predicted at all."""

from __future__ import annotations

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.comparison.result import Comparison
from rigid_body_ros.inference.evidence import LOST
from rigid_body_ros.inference.noise import FEWEST, spread_of
from rigid_body_ros.propagation import Problem
from rigid_body_ros.scene.quantities import START

#: The start is assumed to be estimated from this many seconds of the measurement, but from at
#: least `FEWEST` samples.
_SPAN = 1.0
#: Number of times at which the uncertainty is computed.
_INSTANTS = 1000


def predictable_s(comparison: Comparison) -> float | None:
    """
    Return the time after which the uncertainty of the start alone causes an error of 0.1 rad.

    The start is assumed to be estimated from one second of the measurement, whose noise is
    estimated from the errors of the comparison.

    Returns
    -------
    float, s, or None
        The time since the start; None if the motion is predictable up to the last sample.

    """
    problem = comparison.motion
    assert isinstance(problem, Problem)
    start = problem.start
    end = 1e-9 * max(int(one.times_ns[-1]) - start.time_ns for one in comparison.errors
                     if len(one.times_ns))
    deviations = _deviations(comparison)
    if end <= 0.0 or not np.isfinite(deviations).all():
        return None
    seconds = np.linspace(0.0, end, _INSTANTS + 1)[1:]
    times_ns = start.time_ns + np.round(1e9 * seconds).astype(np.int64)
    derivatives = problem.derivatives([START], at=times_ns).both
    variances = np.sum((deviations * derivatives[:, :3]) ** 2, axis=(1, 2))
    lost = np.flatnonzero(variances > LOST ** 2)
    return float(seconds[lost[0]]) if lost.size else None


def _deviations(comparison: Comparison) -> Floats:
    """
    Return the standard deviations of the start.

    The first three values are for the attitude, rad, and the last three for the angular velocity,
    rad/s. If the attitude is not measured, the first three values are 0.
    """
    found: Floats = np.full(6, np.inf)
    for errors in comparison.errors:
        if len(errors.times_ns) < FEWEST:
            continue
        times_ns = errors.times_ns
        spacing = 1e-9 * float(np.median(np.diff(times_ns)))
        count = max(FEWEST, round(_SPAN / spacing))
        if errors.rotation_vectors is not None:
            mean = spread_of(times_ns, errors.rotation_vectors, True) / np.sqrt(count)
            found[:3] = np.minimum(found[:3], mean)
            # The rate is the slope of a line fitted to the attitudes, so compute the standard
            # deviation of this slope.
            found[3:] = np.minimum(found[3:], mean * np.sqrt(12.0) / (count * spacing))
        if errors.rates is not None:
            found[3:] = np.minimum(found[3:], spread_of(times_ns, errors.rates) / np.sqrt(count))
    if not comparison.of('rotation_vectors'):
        found[:3] = 0.0
    return found
