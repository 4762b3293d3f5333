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

"""Interpolate samples by straight lines or cubics, with more than double precision."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import internal, njit, WRITTEN

#: The cubic interpolation determines each slope from this many samples.
_NEAREST = 5
#: The workspace of `fill_cubics` has the shape `WORKSPACE`. It begins with the weights of the
#: nearest samples. The slopes at two nodes begin at row `_SLOPES`.
_SLOPES, WORKSPACE = _NEAREST, (_NEAREST + 2 * 3, 2)


@njit
def fill_slopes(times_ns: Annotated[Ints, 'n'], values: Annotated[Floats, 'n 3'],
                slopes: Annotated[Floats, 'n 3', WRITTEN]) -> None:
    """
    Compute the slopes of the straight lines that connect samples.

    Because its slope is rounded, a line does not end exactly at the next sample. Each line begins
    where the previous line ends, so that rounding errors do not accumulate. The slope after the
    last sample is zero.

    Parameters
    ----------
    times_ns : int64 (n,), ns
        The times of the samples.
    values : float64 (n, 3)
        The samples.
    slopes : float64 (n, 3), 1/s
        The output, which the caller must initialize to zero.

    """
    for axis in range(3 if len(values) else 0):
        reached = values[0, axis], 0.0
        for k in range(len(values) - 1):
            span = dd.seconds(times_ns[k + 1] - times_ns[k])
            rest = dd.subtract((values[k + 1, axis], 0.0), reached)
            slopes[k, axis] = dd.divide(rest, span)[0]
            reached = dd.add(reached, dd.multiply((slopes[k, axis], 0.0), span))


@njit
def fill_cubics(times_ns: Annotated[Ints, 'n'], values: Annotated[Floats, 'n 3'], first: int,
                stop: int, work: Annotated[Floats, '11 2', WRITTEN],
                cubics: Annotated[Floats, 'm 7 3', WRITTEN]) -> None:
    """
    Compute the cubics that connect samples.

    At each sample, the slope of the cubics is the slope of the polynomial through the nearest
    samples. The low-order parts of the coefficients are needed for thin rods, where torques may
    cancel.

    Parameters
    ----------
    times_ns, values
        See `fill_slopes`.
    first, stop : int
        The range of samples for which to compute cubics: from index `first` up to, but not
        including, index `stop`. Each cubic begins at its sample.
    work : float64, shape WORKSPACE
        Workspace.
    cubics : float64 (stop - first, 7, 3)
        The output. Each cubic is a polynomial in the fraction of the time to the next sample. The
        cubic is stored as four coefficients, followed by the low-order parts of all coefficients
        but the first.

    """
    last = len(times_ns) - 1
    count = min(_NEAREST, last + 1)
    for node in range(first, stop + 1):
        at, begin = min(node, last), _first_of(node, count, last)
        if node == first or not _are_alike(times_ns, node, count, last):
            _fill_weights(times_ns, at, begin, count, work)
        for axis in range(3):
            slope = (0.0, 0.0)
            for k in range(count):
                delta = dd.two_sum(values[begin + k, axis], -values[at, axis])
                slope = dd.add(slope, dd.multiply((work[k, 0], work[k, 1]), delta))
            here, before = _SLOPES + 3 * (node % 2) + axis, _SLOPES + 3 * ((node + 1) % 2) + axis
            work[here, 0], work[here, 1] = slope
            if node > first:
                _store_cubic(cubics[node - 1 - first, :, axis], values[node - 1, axis],
                             values[at, axis], dd.from_int(times_ns[at] - times_ns[node - 1]),
                             (work[before, 0], work[before, 1]), slope)


@internal
def _first_of(node: int, count: int, last: int) -> int:
    # Return the index of the first of the `count` samples nearest to a node.
    return min(max(min(node, last) - count // 2, 0), last + 1 - count)


@internal
def _are_alike(times_ns: NDArray[np.int64], node: int, count: int, last: int) -> bool:
    # Return whether the samples nearest to a node are spaced like those nearest to the previous
    # node.
    here, before = min(node, last), node - 1
    begin, begin_before = _first_of(node, count, last), _first_of(before, count, last)
    for k in range(count):
        if times_ns[begin + k] - times_ns[here] != times_ns[begin_before + k] - times_ns[before]:
            return False
    return True


@internal
def _fill_weights(times_ns: NDArray[np.int64], node: int, begin: int, count: int,
                  weights: Floats) -> None:
    # Compute weights in 1/ns for the samples nearest to a node. To get the slope at the node,
    # subtract the value at the node from each sample, and sum the weighted differences. The
    # weights are the derivatives of the Lagrange polynomials at the node, so the weights depend
    # only on the spacing of the samples.
    for k in range(count):
        distance = times_ns[begin + k] - times_ns[node]
        above, below = (1.0, 0.0), dd.from_int(distance)
        for m in range(count):
            other = times_ns[begin + m] - times_ns[node]
            if other != 0 and m != k:
                above = dd.multiply(above, dd.from_int(-other))
                below = dd.multiply(below, dd.from_int(distance - other))
        weights[k, 0], weights[k, 1] = dd.divide(above, below) if distance != 0 else (0.0, 0.0)


@internal
def _store_cubic(row: Floats, here: float, following: float, span: DoubleDouble,
                 start: DoubleDouble, end: DoubleDouble) -> None:
    # Store the coefficients for one axis, given the values and the slopes (1/ns) at both ends.
    delta = dd.two_sum(following, -here)
    start, end = dd.multiply(start, span), dd.multiply(end, span)
    curved = dd.subtract(delta, start)
    third = dd.subtract(dd.subtract(end, delta), curved)
    second = dd.subtract(curved, third)
    row[0], row[1], row[2], row[3] = here, start[0], second[0], third[0]
    row[4], row[5], row[6] = start[1], second[1], third[1]
