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

"""Logs of commands for named wheels."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instants, NEVER_NS


class EffortLog:
    """
    A log of motor torques commanded to named wheels.

    A wheel holds each command until it receives the next one. Before its first command, its effort
    is zero. With a timeout, all wheels time out together: the commands of all wheels end when none
    of the wheels has received a command for the length of the timeout.

    Parameters
    ----------
    times_ns : array of int, shape (n,), ns
        The stamps of the commands, in any order. If several commands for a wheel have the same
        stamp, only the last one in the array is used.
    efforts : array, shape (n, k), N m
        The commanded torques, with one column for each of k wheels, in the order of the wheels. An
        entry of NaN leaves the wheel's previous command in force.

    Attributes
    ----------
    times_ns : array of int64, shape (m,), ns
        The stamps, strictly ascending.
    efforts : array, shape (m, k), N m

    Raises
    ------
    ValueError
        The shapes do not match, a time is not an integer that fits in int64, the times span 292
        years or more, or an effort is infinite.

    """

    def __init__(self, times_ns: ArrayLike, efforts: ArrayLike) -> None:
        stamps_ns, values = instants(times_ns), np.array(efforts, float)
        if values.ndim != 2 or len(values) != stamps_ns.size:
            raise ValueError(f'efforts: expected shape ({stamps_ns.size}, wheels), found '
                             f'{values.shape}')
        if np.isinf(values).any():
            row = int(np.flatnonzero(np.isinf(values).any(axis=1))[0])
            raise ValueError(f'effort {row} at {stamps_ns[row]} ns: expected finite numbers, or '
                             f'NaN to keep a command, found {values[row].tolist()}')
        if stamps_ns.size and int(stamps_ns.max()) - int(stamps_ns.min()) >= NEVER_NS:
            raise ValueError('times_ns: expected times within 292 years of each other, found '
                             f'{stamps_ns.min()} ns and {stamps_ns.max()} ns')
        commands = ~np.isnan(values)
        found, rows = np.unique(stamps_ns[commands.any(axis=1)], return_inverse=True)
        values, commands = values[commands.any(axis=1)], commands[commands.any(axis=1)]
        merged = np.full((len(found), values.shape[1]), np.nan)
        for wheel in range(values.shape[1]):  # if an index repeats, NumPy uses the last value
            merged[rows[commands[:, wheel]], wheel] = values[commands[:, wheel], wheel]
        self.times_ns: NDArray[np.int64] = found
        self.efforts: Floats = merged
        self.times_ns.flags.writeable = self.efforts.flags.writeable = False

    def __len__(self) -> int:
        return len(self.times_ns)

    def __repr__(self) -> str:
        return f'EffortLog({len(self)} commands of {self.efforts.shape[1]} wheels)'

    def between(self, begin_ns: int, end_ns: int) -> EffortLog:
        """Return a log of the commands in force at any time between two given times, ns."""
        first = max(int(self.times_ns.searchsorted(begin_ns, 'right')) - 1, 0)
        stop = int(self.times_ns.searchsorted(end_ns, 'right'))
        begun = filled(self.efforts[:first + 1], np.full(self.efforts.shape[1], np.nan))[-1:]
        return EffortLog(self.times_ns[first:stop], np.concatenate(
            [begun, self.efforts[first + 1:stop]])[:max(stop - first, 0)])


def filled(rows: Floats, before: Floats) -> Floats:
    """
    Replace each NaN in rows, shape (n, m), by the last number above it in its column.

    If there is no number above a NaN, it is replaced by the column's entry in `before`.
    """
    if not np.isnan(rows).any():
        return rows
    rows = np.concatenate([before[None], rows])
    last = np.where(np.isnan(rows), 0, np.arange(len(rows))[:, None])
    return np.take_along_axis(rows, np.maximum.accumulate(last), axis=0)[1:]
