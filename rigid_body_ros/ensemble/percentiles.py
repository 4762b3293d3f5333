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

"""Percentiles without interpolation: each percentile is one of the numbers."""

from __future__ import annotations

from collections.abc import Sequence

from rigid_body_ros.common.arrays import Floats


def percentiles(numbers: Floats, wanted: Sequence[int]) -> Floats:
    """
    Return percentiles of numbers, like `numpy.percentile` with the method 'inverted_cdf'.

    NumPy provides this method from version 1.22 on, but takes several times as long as this
    function.

    Parameters
    ----------
    numbers : array, shape (..., n)
        At least one number along the last axis. The array is sorted in place along this axis.
    wanted : sequence of int
        The percentiles, from 1 to 100.

    Returns
    -------
    array, shape (..., len(wanted))
        For each percentile k, the smallest number x such that at least k percent of the numbers
        are at most x.

    """
    ranks = [-(-k * numbers.shape[-1] // 100) - 1 for k in wanted]
    numbers.sort(axis=-1)
    return numbers[..., ranks]
