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

"""Straight lines and cubics through samples, with coefficients beyond double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import internal, njit

#: Number of samples that determine a slope of the cubic interpolation.
_NEAREST = 5


@njit
def slopes(times_ns: NDArray[np.int64], values: Floats) -> Floats:
    """
    Return the slopes of straight lines through samples, and zero for the last.

    Each line leads from where the rounded slopes before it end, not from the sample there.

    Parameters
    ----------
    times_ns : int64 (n,), ns
        When the samples were taken.
    values : float64 (n, 3)
        The samples.

    Returns
    -------
    float64 (n, 3), 1/s

    """
    result = np.zeros(values.shape)
    for axis in range(3 if len(values) else 0):
        reached = values[0, axis], 0.0
        for k in range(len(values) - 1):
            span = dd.seconds(times_ns[k + 1] - times_ns[k])
            rest = dd.subtract((values[k + 1, axis], 0.0), reached)
            result[k, axis] = dd.divide(rest, span)[0]
            reached = dd.add(reached, dd.multiply((result[k, axis], 0.0), span))
    return result


@njit
def hermite(times_ns: NDArray[np.int64], values: Floats, first: int, stop: int) -> Floats:
    """
    Return cubics through samples.

    At each sample, the slope is that of the polynomial through the nearest samples. The low-order
    parts matter for a thin rod, where torques may cancel.

    Parameters
    ----------
    times_ns, values
        As for `slopes`.
    first, stop : int
        The first sample, and the one after the last.

    Returns
    -------
    float64 (stop - first, 7, 3)
        See `TorqueLog.polynomials`.

    """
    last = len(times_ns) - 1
    count = min(_NEAREST, last + 1)
    result = np.empty((stop - first, 7, 3))
    weights, spacing = np.zeros((_NEAREST, 2)), np.zeros(_NEAREST, np.int64)
    start, end = np.zeros((3, 2)), np.zeros((3, 2))
    for node in range(first, stop + 1):
        start, end = end, start
        at = min(node, last)
        begin = min(max(at - count // 2, 0), last + 1 - count)
        _update_weights(times_ns, at, begin, count, weights, spacing)
        for axis in range(3):
            slope = (0.0, 0.0)
            for k in range(count):
                delta = dd.two_sum(values[begin + k, axis], -values[at, axis])
                slope = dd.add(slope, dd.multiply((weights[k, 0], weights[k, 1]), delta))
            end[axis, 0], end[axis, 1] = slope
            if node > first:
                _store_cubic(result[node - 1 - first, :, axis], values[node - 1, axis],
                             values[at, axis], dd.from_int(times_ns[at] - times_ns[node - 1]),
                             (start[axis, 0], start[axis, 1]), slope)
    return result


@internal
def _update_weights(times_ns: NDArray[np.int64], node: int, begin: int, count: int,
                    weights: Floats, spacing: NDArray[np.int64]) -> None:
    # Update the weights, 1/ns, with which the differences between the samples and a node add up to
    # the slope at the node: the derivatives of the Lagrange polynomials there. They depend on the
    # spacing only, and stay if it does.
    same = True
    for k in range(count):
        span = times_ns[begin + k] - times_ns[node]
        same = same and span == spacing[k]
        spacing[k] = span
    if same:
        return
    for k in range(count):
        above, below = (1.0, 0.0), dd.from_int(spacing[k])
        for m in range(count):
            if spacing[m] != 0 and m != k:
                above = dd.multiply(above, dd.from_int(-spacing[m]))
                below = dd.multiply(below, dd.from_int(spacing[k] - spacing[m]))
        weights[k, 0], weights[k, 1] = dd.divide(above, below) if spacing[k] != 0 else (0.0, 0.0)


@internal
def _store_cubic(row: Floats, here: float, following: float, span: DoubleDouble,
                 start: DoubleDouble, end: DoubleDouble) -> None:
    # Store the coefficients on one axis, from the values and the slopes, 1/ns, at both ends.
    delta = dd.two_sum(following, -here)
    start, end = dd.multiply(start, span), dd.multiply(end, span)
    curved = dd.subtract(delta, start)
    third = dd.subtract(dd.subtract(end, delta), curved)
    second = dd.subtract(curved, third)
    row[0], row[1], row[2], row[3] = here, start[0], second[0], third[0]
    row[4], row[5], row[6] = start[1], second[1], third[1]
