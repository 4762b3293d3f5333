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

"""Compose transforms along a chain of frames, such as map to odom to base_link."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted
from rigid_body_ros.mechanics import so3
from rigid_body_ros.messages import TRANSFORM
from rigid_body_ros.recording.source import joined, Messages, Source, topics

#: What the name of a topic of fixed transforms ends in.
STATIC = '_static'
_ROTATION = slice(3, 7)
#: A frame_id and a child_frame_id.
_Pair = tuple[str, str]


def chained(path: str | Path, topic: str, ends: _Pair, time_source: str) -> Messages:
    """
    Compose the rotations between two frames that no message connects directly.

    They are composed at the stamps of the fastest transform in the chain. The rotations of the
    others are interpolated with a constant angular velocity (slerp) between their samples. A
    transform on a topic whose name ends in _static holds at all times.

    Parameters
    ----------
    path : str or Path
        The recording.
    topic : str
        A topic of type TFMessage.
    ends : tuple of str
        The first and the last frame of the chain.
    time_source : str
        As for `Source`.

    Returns
    -------
    Messages
        In the order of the recording. The rotation is NaN at stamps at which one of the other
        transforms is not known.

    Raises
    ------
    InputError
        No chain of transforms connects the frames, or all of its transforms are fixed.

    """
    homes: dict[_Pair, str] = {}
    for name in sorted({topic, topic + STATIC}.intersection(topics(path, [TRANSFORM]))):
        with Source(path, name, [TRANSFORM], time_source) as source:
            homes |= dict.fromkeys(source.pairs(), name)
    pairs = _chain(homes, *ends)
    described = [f'{quoted(parent)} to {quoted(child)}' for parent, child in homes]
    if not pairs:
        raise InputError(f'{path}: {topic}: expected transforms from {quoted(ends[0])} to '
                         f'{quoted(ends[1])}, directly or in a chain, found '
                         f'{listed(described)}; choose other frames with --frames')
    links = []
    for pair in pairs:
        recorded = pair if pair in homes else pair[::-1]
        with Source(path, homes[recorded], [TRANSFORM], time_source, frames=recorded) as source:
            link = joined(topic, TRANSFORM, [*source], source.damage)
        rotations = so3.normalize(link.values[:, _ROTATION])
        link.values[:, _ROTATION] = rotations if pair in homes else so3.conjugate(rotations)
        links.append(replace(link, stamps_ns=link.stamps_ns[:0], values=link.values[-1:])
                     if homes[recorded].endswith(STATIC) else link)
    fastest = max(links, key=lambda link: len(link.stamps_ns))
    if not len(fastest):
        raise InputError(f'{path}: {topic}: expected a transform that changes between '
                         f'{quoted(ends[0])} and {quoted(ends[1])}, found fixed ones only')
    values = fastest.values.copy()
    values[:, _ROTATION] = [0.0, 0.0, 0.0, 1.0]
    for link in links:
        rotations = link.values[:, _ROTATION] if link is fastest else _at(fastest.stamps_ns, link)
        values[:, _ROTATION] = so3.multiply(values[:, _ROTATION], rotations)
    return replace(fastest, values=values)


def _chain(pairs: Collection[_Pair], first: str, last: str) -> list[_Pair]:
    """Return the shortest chain of pairs of frames, in either direction; [] if there is none."""
    chains: dict[str, list[_Pair]] = {first: []}
    waiting = [first]
    for frame in waiting:  # the loop extends this list
        for pair in [*pairs, *(pair[::-1] for pair in pairs)]:
            if pair[0] == frame and pair[1] not in chains:
                chains[pair[1]] = [*chains[frame], pair]
                waiting.append(pair[1])
    return chains.get(last, [])


def _at(times_ns: NDArray[np.int64], link: Messages) -> Floats:
    """Return the rotations of a link at the given times; NaN before and after its samples."""
    rotations = link.values[:, _ROTATION]
    if not len(link):  # fixed
        return rotations
    stamps_ns, rows = np.unique(link.stamps_ns[::-1], return_index=True)
    rotations = rotations[::-1][rows]
    before = np.clip(np.searchsorted(stamps_ns, times_ns, 'right') - 1, 0,
                     max(len(stamps_ns) - 2, 0))
    after = np.minimum(before + 1, len(stamps_ns) - 1)
    share = (times_ns - stamps_ns[before]) / np.maximum(stamps_ns[after] - stamps_ns[before], 1)
    turns = so3.difference(rotations[before], rotations[after])
    is_known = (times_ns >= stamps_ns[0]) & (times_ns <= stamps_ns[-1])
    return np.where(is_known[:, None], so3.multiply(
        rotations[before], so3.exp(share[:, None] * turns)), np.nan)
