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

"""Percentiles that are among the numbers."""

from __future__ import annotations

from collections.abc import Sequence

from rigid_body_ros.common.arrays import Floats


def percentiles(numbers: Floats, wanted: Sequence[int]) -> Floats:
    """
    Return percentiles of numbers, as `numpy.percentile` with the method 'inverted_cdf'.

    NumPy has that method from 1.22 on; it takes several times as long as a sort.

    Parameters
    ----------
    numbers : array, shape (..., n)
        At least one along the last axis, along which they are sorted on return.
    wanted : sequence of int
        From 1 to 100.

    Returns
    -------
    array, shape (..., len(wanted))
        For each k the smallest number that at least k percent of the numbers do not exceed.

    """
    ranks = [-(-k * numbers.shape[-1] // 100) - 1 for k in wanted]
    numbers.sort(axis=-1)
    return numbers[..., ranks]
