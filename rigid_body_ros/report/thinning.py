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

"""Thin a long series while it is being computed, so that it need not fit into memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats

#: Maximum number of intervals in a series. This number is about ten times the width of a chart in
#: pixels.
_INTERVALS = 2 ** 13


class Extremes:
    """
    The minimum and maximum of each column of a series, in intervals of 2^k samples.

    When there are too many intervals, each pair of neighbouring intervals is merged, and k
    increases by one. No extreme value is lost in this way, so a spike of a single sample stays
    visible in a series of any length.

    Parameters
    ----------
    columns : int
        Number of columns.

    """

    def __init__(self, columns: int) -> None:
        self._size = 1
        self._times = np.empty(0, np.int64)
        self._low = self._high = np.empty((0, columns))
        #: The samples of the last interval, which is not complete yet.
        self._rest = np.empty(0, np.int64), np.empty((0, columns))

    def add(self, times_ns: NDArray[np.int64], values: Floats) -> None:
        """
        Add the next samples of the series.

        The times have shape (n,), and the values have shape (n, columns).
        """
        times = np.concatenate([self._rest[0], times_ns])
        values = np.concatenate([self._rest[1], values])
        while len(times) >= self._size:
            if len(self._times) == _INTERVALS:
                self._merge_pairs()
            count = min(len(times) // self._size, _INTERVALS - len(self._times))
            whole = count * self._size
            blocks = values[:whole].reshape(count, self._size, values.shape[1])
            self._times = np.concatenate([self._times, times[:whole:self._size]])
            self._low = np.concatenate([self._low, blocks.min(axis=1)])
            self._high = np.concatenate([self._high, blocks.max(axis=1)])
            times, values = times[whole:], values[whole:]
        self._rest = times.copy(), values.copy()

    def result(self) -> tuple[NDArray[np.int64], Floats, Floats]:
        """
        Return the start time of each interval, and its minima and maxima.

        The times have shape (n,), and the minima and the maxima have shape (n, columns).
        """
        times, values = self._rest
        if not len(times):
            return self._times, self._low, self._high
        return (np.append(self._times, times[0]), np.vstack([self._low, values.min(axis=0)]),
                np.vstack([self._high, values.max(axis=0)]))

    def _merge_pairs(self) -> None:
        shape = len(self._times) // 2, 2, self._low.shape[1]
        self._times = self._times[::2]
        self._low = self._low.reshape(shape).min(axis=1)
        self._high = self._high.reshape(shape).max(axis=1)
        self._size *= 2


class EveryNth:
    """
    A selection of evenly spaced rows of a series, including the first and the last row.

    Parameters
    ----------
    most : int
        Maximum number of selected rows, not counting the last row.

    """

    def __init__(self, most: int) -> None:
        self._most, self._step, self._count = most, 1, 0
        self._parts: list[tuple[NDArray[np.int64], Floats]] = []
        self._last: tuple[NDArray[np.int64], Floats] | None = None

    def chosen(self, count: int) -> NDArray[np.intp]:
        """
        Return the indices of the rows to pass to `add`, out of the next `count` rows.

        The last row is always included.
        """
        rows = np.arange(-self._count % self._step, count, self._step)
        return np.union1d(rows, [count - 1]) if count else rows

    def add(self, count: int, times_ns: NDArray[np.int64], values: Floats) -> None:
        """Add the rows that `chosen` selected: times, shape (n,), and values, shape (n, k)."""
        regular = len(times_ns) - ((self._count + count - 1) % self._step != 0)
        self._parts.append((times_ns[:regular], values[:regular]))
        self._last = times_ns[-1:], values[-1:]
        self._count += count
        while sum(len(times) for times, _ in self._parts) > self._most:
            times, rows = self._joined()
            self._parts = [(times[::2], rows[::2])]
            self._step *= 2

    def result(self) -> tuple[NDArray[np.int64], Floats]:
        """Return the times, shape (n,), and the values, shape (n, k), of the selected rows."""
        times, rows = self._joined()
        assert self._last is not None
        if self._last[0][0] > times[-1]:
            return np.append(times, self._last[0]), np.vstack([rows, self._last[1]])
        return times, rows

    def _joined(self) -> tuple[NDArray[np.int64], Floats]:
        return (np.concatenate([times for times, _ in self._parts]),
                np.concatenate([rows for _, rows in self._parts]))


def thinned(count: int, most: int) -> slice:
    """Return a slice that selects at most `most` of `count` items, evenly spaced."""
    return slice(None, None, max(-(-count // most), 1))
