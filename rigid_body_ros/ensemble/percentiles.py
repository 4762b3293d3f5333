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

"""Compute percentiles without interpolation, so that each percentile is one of the numbers."""

from __future__ import annotations

from collections.abc import Sequence

from rigid_body_ros.common.arrays import Floats


def percentiles(numbers: Floats, wanted: Sequence[int]) -> Floats:
    """
    Return percentiles of some numbers, as `numpy.percentile` does with method='inverted_cdf'.

    NumPy has supported this method since version 1.22, but `numpy.percentile` is several times
    slower than this function.

    Parameters
    ----------
    numbers : array, shape (..., n)
        The numbers. The last axis must have at least one element. The array is sorted in place
        along this axis.
    wanted : sequence of int
        The percentiles to compute, from 1 to 100.

    Returns
    -------
    array, shape (..., len(wanted))
        For each percentile k, the smallest number x in the array such that at least k percent of
        the numbers are less than or equal to x.

    """
    ranks = [-(-k * numbers.shape[-1] // 100) - 1 for k in wanted]
    numbers.sort(axis=-1)
    return numbers[..., ranks]
