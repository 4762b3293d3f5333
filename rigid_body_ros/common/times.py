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

"""Validate times, which are integer nanoseconds."""

from __future__ import annotations

import operator

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: A time later than any valid time, ns.
NEVER_NS = 2 ** 63 - 1
#: Longest valid duration, s: about 32 years.
LONGEST = 1e9


def instant(time_ns: int, name: str = 'time_ns') -> int:
    """
    Check a time and convert it to an int.

    Parameters
    ----------
    time_ns : int, ns
        The time, as any integer type.
    name : str
        What to call the value in error messages.

    Returns
    -------
    int, ns

    Raises
    ------
    ValueError
        The time does not fit into int64.
    TypeError
        The time is not an integer. A bool does not count as an integer.

    """
    if isinstance(time_ns, (bool, np.bool_)):
        raise TypeError(f'{name}: expected integer nanoseconds, found {time_ns}')
    found = operator.index(time_ns)
    if abs(found) >= NEVER_NS:
        raise ValueError(f'{name}: expected a time in int64 nanoseconds, found {found}')
    return found


def instants(times_ns: ArrayLike, name: str = 'times_ns') -> NDArray[np.int64]:
    """
    Check times and copy them to a new array.

    Parameters
    ----------
    times_ns : array of int, shape (n,)
        The times, ns.
    name : str
        What to call the value in error messages.

    Returns
    -------
    array of int64, shape (n,), ns

    Raises
    ------
    ValueError
        The times are not integers of shape (n,), or do not fit into int64.

    """
    times = np.array(times_ns)
    if times.ndim != 1 or (times.size and times.dtype.kind not in 'iu'):
        raise ValueError(f'{name}: expected integer nanoseconds of shape (n,), '
                         f'found {times.dtype} of shape {times.shape}')
    if times.dtype.kind == 'u' and times.size and int(times.max()) > NEVER_NS:
        raise ValueError(f'{name}: expected times in int64 nanoseconds, found {times.max()}')
    return times.astype(np.int64, copy=False)


def duration_ns(seconds: float, name: str) -> int:
    """
    Convert a duration from seconds to the nearest integer number of nanoseconds.

    Parameters
    ----------
    seconds : float, s
        The duration, which may be between 0 and `LONGEST`.
    name : str
        What to call the value in error messages.

    Returns
    -------
    int, ns

    Raises
    ------
    ValueError
        The duration is out of range.

    """
    if not 0.0 <= seconds <= LONGEST:
        raise ValueError(f'{name}: expected seconds from 0 to {LONGEST:g}, found {seconds}')
    return round(seconds * 1e9)
