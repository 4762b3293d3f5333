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

"""Find out where the epochs of a node begin and end in a recorded motion."""

from __future__ import annotations

from bisect import bisect
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics.state import State


def groups(starts: Sequence[State], stamps_ns: NDArray[np.int64], values: Floats) -> list[slice]:
    """
    Return the rows that belong to each epoch of a recorded motion.

    The first row of an epoch is its start state. If the node was killed before any state was
    recorded, the epoch has no rows.

    Parameters
    ----------
    starts : sequence of State
        The start states of the epochs.
    stamps_ns : array of int64, shape (n,)
        The stamps of the recorded states, which ascend within an epoch.
    values : array, shape (n, 4) or (n, 7)
        The attitudes, each followed by the body rates, rad/s, if these are recorded.

    Raises
    ------
    InputError
        The recording does not begin with the start state of an epoch; or a stamp is not later
        than the one before, although no epoch starts there.

    """
    width = values.shape[1]
    numbers: dict[tuple[int, bytes], list[int]] = {}
    for number, start in enumerate(starts):
        given = np.hstack([start.attitude, start.angular_velocity])[:width]
        numbers.setdefault((start.time_ns, given.tobytes()), []).append(number)
    restarts = np.append(True, np.diff(stamps_ns) <= 0)
    possible = np.flatnonzero(restarts | np.isin(stamps_ns, [start.time_ns for start in starts]))
    states = [(int(stamps_ns[row]), values[row].tobytes()) for row in possible]
    left, begun = Counter(states), list[tuple[int, int]]()
    for row, state in zip(possible.tolist(), states):
        left[state] -= 1
        same = numbers.get(state, [])
        following = same[bisect(same, begun[-1][0] if begun else -1):]
        # A state in the current epoch may happen to equal the start state of a later epoch.
        if following and (restarts[row] or left[state] < len(following)):
            begun.append((following[0], row))
        elif restarts[row]:
            raise InputError(_not_a_start(row, stamps_ns))
    ends = [*(row for _, row in begun[1:]), len(stamps_ns)]
    found = {number: slice(row, end) for (number, row), end in zip(begun, ends)}
    return [found.get(number, slice(0)) for number in range(len(starts))]


def _not_a_start(row: int, stamps_ns: NDArray[np.int64]) -> str:
    where = f'expected the start state of an epoch of the torque log in message {row + 1}'
    if not row:
        return f'{where}, found another state, at {stamps_ns[0]} ns: the recording began in the ' \
               'middle of an epoch, or is not that of this log'
    return f'{where}, because its stamp, {stamps_ns[row]} ns, is not later than the one before, ' \
           f'{stamps_ns[row - 1]} ns; found another state: the recording is not that of this ' \
           'log, or a part is missing'
