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

"""The epochs of a node: on all topics of torques, in a recorded motion, and the chosen one."""

from __future__ import annotations

from bisect import bisect
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.recording import Messages
from rigid_body_ros.scene import Scene


def aligned(path: str | Path, topics: Sequence[Sequence[Messages]],
            has_stamps: bool) -> list[tuple[Messages, ...]]:
    """
    Return the torques of all topics in each epoch.

    A node that is killed while it begins an epoch has marked it on the first topics only: on the
    others there are no torques in that epoch.

    Parameters
    ----------
    path : str or Path
        The recording, for error messages.
    topics : sequence of sequence of Messages
        By topic, its epochs.
    has_stamps : bool
        Whether the stamps are those of the headers, which are the same on all topics.

    Raises
    ------
    InputError
        An epoch does not begin with the same state on all topics.

    """
    longest = max(topics, key=lambda parts: sum(part.start is not None for part in parts),
                  default=())
    if not longest or longest[0].start is None:
        return [tuple(parts[0] for parts in topics)]
    for parts in topics:
        for part, expected in zip(parts, longest):
            _check_same_start(path, part, expected, has_stamps)
    return [tuple(parts[k] if k < len(parts) else
                  replace(expected.rows(slice(0)), topic=parts[0].topic) for parts in topics)
            for k, expected in enumerate(longest)]


def _check_same_start(path: str | Path, part: Messages, expected: Messages,
                      has_stamps: bool) -> None:
    if part.start is None and not len(part):
        return  # a topic without messages
    one, other = ((state.time_ns if has_stamps else 0, state.attitude.tobytes(),
                   state.angular_velocity.tobytes(), state.rotor_momentum.tobytes())
                  if (state := found.start) else None for found in (part, expected))
    if one != other:
        found = f'the epoch that begins at {part.start.time_ns} ns' if part.start else \
            'torques without epochs'
        assert expected.start
        raise InputError(f'{path}: {part.topic}: expected the epoch that begins at '
                         f'{expected.start.time_ns} ns, with the same start state as on '
                         f'{expected.topic}, found {found}')


def chosen(path: str | Path, scene: Scene, starts: Sequence[State]) -> int:
    """
    Return the number of the epoch for a command that needs one motion.

    Of several epochs, it is the last one that begins at the start_time of the scene.

    Raises
    ------
    InputError
        None begins there.

    """
    stamps, start_ns = [start.time_ns for start in starts], scene.start.time_ns
    if len(stamps) > 1 and start_ns not in stamps:
        raise InputError(f'{path}: expected one epoch, or the start_time of one, found '
                         f'{len(stamps)} epochs, which begin at '
                         f'{listed([str(stamp) for stamp in stamps])} ns, and start_time '
                         f'{start_ns}; set start_time in the scene')
    return len(stamps) - 1 - stamps[::-1].index(start_ns) if len(stamps) > 1 else 0


def groups(starts: Sequence[State], stamps_ns: NDArray[np.int64], values: Floats) -> list[slice]:
    """
    Return the rows of each epoch in a recorded motion; the first is its start state.

    An epoch without rows is that of a process which was killed before it recorded a state.

    Parameters
    ----------
    starts : sequence of State
        The start states of the epochs.
    stamps_ns : array of int64, shape (n,)
        They ascend within an epoch.
    values : array, shape (n, 4) or (n, 7)
        Attitudes, and body rates, rad/s, if they are recorded.

    Raises
    ------
    InputError
        The first state, or one whose stamp is not later than the previous one, is not the start
        state of an epoch.

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
        # A state of the present epoch may equal the start of another one, which then follows.
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
