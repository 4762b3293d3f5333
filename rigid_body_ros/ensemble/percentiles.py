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

"""Percentiles of more numbers than fit into memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from rigid_body_ros.common.arrays import Floats

#: Bits of a number that a pass over all numbers determines.
_DIGIT = 16


def percentiles(chunks: Callable[[], Iterable[Floats]], wanted: Sequence[int]) -> list[float]:
    """
    Return percentiles of many numbers, each one of the numbers itself.

    Parameters
    ----------
    chunks : callable
        Returns all numbers in chunks, the same at each of five calls; NaN is left out. The others
        are not negative.
    wanted : sequence of int
        From 1 to 100.

    Returns
    -------
    list of float
        For each k the smallest number that at least k percent of the numbers do not exceed, as
        `numpy.percentile` with the method 'inverted_cdf'. Empty if there are no numbers.

    """
    count = sum(int(np.isfinite(chunk).sum()) for chunk in chunks())
    if not count:
        return []
    # The bits of a number that is not negative are in the order of the numbers. A pass finds the
    # next digit of all results, from the most significant one.
    ranks = np.array([-(-k * count // 100) - 1 for k in wanted])
    found = np.zeros(len(wanted), np.uint64)
    for shift in range(64 - _DIGIT, -1, -_DIGIT):
        counts = np.zeros((len(wanted), 2 ** _DIGIT), np.int64)
        for chunk in chunks():
            bits = chunk[np.isfinite(chunk)].view(np.uint64) >> np.uint64(shift)
            for row, prefix in zip(counts, found):
                digits = bits - (prefix << np.uint64(_DIGIT))  # wraps to a large one if below
                row += np.bincount(digits[digits < 2 ** _DIGIT].astype(np.intp),
                                   minlength=2 ** _DIGIT)
        ends = counts.cumsum(axis=1)
        digit = np.array([np.searchsorted(end, rank, 'right') for end, rank in zip(ends, ranks)])
        ranks -= (ends - counts)[np.arange(len(wanted)), digit]
        found = found << np.uint64(_DIGIT) | digit.astype(np.uint64)
    return [float(number) for number in found.view(float)]
