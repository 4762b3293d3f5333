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

"""Percentiles of numbers, which may be more than fit into memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats

#: Bits of a number that a pass over all numbers determines.
_DIGIT = 11
#: Bits of a number after the next digit.
_SHIFTS = range(5 * _DIGIT, -1, -_DIGIT)


def percentiles(chunks: Callable[[], Iterable[Floats]], wanted: Sequence[int]) -> list[float]:
    """
    Return percentiles of many numbers, each one of the numbers itself.

    Parameters
    ----------
    chunks : callable
        Returns all numbers in chunks, the same at each of six calls; NaN is left out. The others
        are not negative.
    wanted : sequence of int
        From 1 to 100.

    Returns
    -------
    list of float
        For each k the smallest number that at least k percent of the numbers do not exceed, as
        `numpy.percentile` with the method 'inverted_cdf'. Empty if there are no numbers.

    """
    found = of_columns(lambda: (chunk[:, None] for chunk in chunks()), wanted, 1)[:, 0]
    return [] if np.isnan(found).any() else [float(number) for number in found]


def of_columns(chunks: Callable[[], Iterable[Floats]], wanted: Sequence[int],
               columns: int) -> Floats:
    """
    Return the percentiles of each column of many rows.

    Parameters
    ----------
    chunks : callable
        As for `percentiles`; a chunk has the shape (n, columns).
    wanted : sequence of int
        From 1 to 100.
    columns : int
        Number of columns.

    Returns
    -------
    array, shape (len(wanted), columns)
        NaN in columns that have no numbers.

    """
    # The bits of a number that is not negative are in the order of the numbers. A pass finds the
    # next digit of all results, from the most significant one.
    found = np.zeros((len(wanted), columns), np.uint64)
    ranks, known = np.zeros(found.shape, np.int64), np.zeros(columns, np.int64)
    for shift in _SHIFTS:
        counts = np.zeros((*found.shape, 2 ** _DIGIT), np.int64)
        for chunk in chunks():
            _count(counts, chunk, found, shift)
        if shift == _SHIFTS[0]:
            known = counts[0].sum(axis=-1)
            ranks = -(-np.outer(wanted, known) // 100) - 1
        ends = counts.cumsum(axis=-1)
        digit = (ends[..., :-1] <= ranks[..., None]).sum(axis=-1)
        ranks -= np.take_along_axis(ends - counts, digit[..., None], -1)[..., 0]
        found = found << np.uint64(_DIGIT) | digit.astype(np.uint64)
    return np.where(known, found.view(float), np.nan)


def of_rows(numbers: Floats, wanted: Sequence[int]) -> Floats:
    """
    Return the percentiles of each row of an array, those of `of_columns`, in less time.

    Parameters
    ----------
    numbers : array, shape (rows, n)
        Sorted on return; NaN is left out.
    wanted : sequence of int
        From 1 to 100.

    Returns
    -------
    array, shape (len(wanted), rows)
        NaN for rows that have no numbers.

    """
    numbers.sort(axis=-1)  # NaN is last
    known = np.isfinite(numbers).sum(axis=-1)
    ranks = np.maximum(-(-np.outer(wanted, known) // 100) - 1, 0)
    return np.take_along_axis(numbers, ranks.T, -1).T


def _count(counts: NDArray[np.int64], chunk: Floats, prefixes: NDArray[np.uint64],
           shift: int) -> None:
    """Count the next digits of the numbers that begin with a prefix of their column."""
    known, bits = np.isfinite(chunk), chunk.view(np.uint64) >> np.uint64(shift)
    for count, prefix in zip(counts, prefixes):
        digits = bits - (prefix << np.uint64(_DIGIT))  # wraps to a large one if below
        rows, columns = np.nonzero(known & (digits < 2 ** _DIGIT))
        np.add.at(count, (columns, digits[rows, columns].astype(np.intp)), 1)
