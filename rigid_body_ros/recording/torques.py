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

"""The torques of a recording as a log, whole or piece by piece."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.recording.source import Messages
from rigid_body_ros.torque import TorqueLog

#: Ten years, more than a simulation lasts and less than the wall clock shows.
_SIMULATED_NS = 315_576_000 * 10 ** 9
#: Samples that a piece has, about.
_SAMPLES = 2 ** 16
#: Samples on each side that a reading between samples looks at: the slopes of the cubic.
_BESIDE = 2


def torque_log(path: str | Path, recorded: Messages, body_frame: str, space_frame: str,
               interpolation: str = 'hold') -> TorqueLog:
    """
    Return the log that WrenchStamped messages make: the last one, where it was begun anew.

    Raises
    ------
    InputError
        There is no message, or one has an unknown frame_id, no stamp or a torque that is not
        finite; or frames are mixed where torques are interpolated.

    """
    where = f'{path}: {recorded.topic}'
    if not len(recorded.stamps_ns):
        lost = f' ({recorded.damage})' if recorded.damage else ''
        raise InputError(f'{where}: expected torques, found no message{lost}')
    torques = recorded.values[:, 3:]
    axes = _checked(where, recorded, body_frame, space_frame)
    # After the last mark, or the mark itself, zero torque, where nothing came after it.
    first = min(int(np.append(0, new_logs(recorded) + 1)[-1]), len(torques) - 1)
    _check_stamped(where, recorded.stamps_ns, first)
    frames = axes[0] if len(set(axes)) == 1 else \
        [axes[code] for code in recorded.frames[first:].tolist()]
    try:
        return TorqueLog(recorded.stamps_ns[first:], torques[first:], frames, interpolation)
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error


def _checked(where: str, recorded: Messages, body_frame: str, space_frame: str,
             before: int = 0) -> list[str]:
    """Return the axes of each frame, or raise InputError that names a message to refuse."""
    torques = recorded.values[:, 3:]
    if not np.isfinite(torques).all():
        row = int(np.flatnonzero(~np.isfinite(torques).all(axis=1))[0])
        raise InputError(f'{where}: message {before + row + 1} at {recorded.stamps_ns[row]} ns: '
                         f'expected a finite torque, found {torques[row].tolist()}')
    axes = []
    for code, frame_id in enumerate(recorded.names):
        try:
            axes.append(messages.torque_frame(frame_id, body_frame, space_frame))
        except ValueError as error:
            number = before + int(np.argmax(recorded.frames == code)) + 1
            raise InputError(f'{where}: message {number}: {error}') from error
    return axes


def _check_stamped(where: str, stamps_ns: NDArray[np.int64], first: int) -> None:
    """Raise InputError where torques, from row `first` on, have no stamp."""
    unstamped = first + np.flatnonzero(stamps_ns[first:] == 0)
    # Simulated time may begin with 0; it does not reach wall time.
    begins = stamps_ns[first] == 0 < stamps_ns.max() < _SIMULATED_NS
    if unstamped.size and not begins and len(stamps_ns) > 1:
        raise InputError(f'{where}: message {unstamped[0] + 1}: expected a stamp in its header, '
                         f'found 0, as in {np.sum(stamps_ns == 0)} of {len(stamps_ns)} messages; '
                         '--time-source log takes the times of the recording')


def new_logs(recorded: Messages) -> NDArray[np.intp]:
    """Return the rows where the log of a node begins anew (see `messages.new_log`)."""
    unnamed = np.array([not name for name in recorded.names], bool)[recorded.frames]
    begun = (recorded.stamps_ns == 0) & ~recorded.values.any(axis=1) & unnamed
    return np.flatnonzero(begun[1:]) + 1


class NotInOrderError(Exception):
    """Only the whole of a recording tells what its log is."""


class Piece(NamedTuple):
    """
    Some samples of a log, for `Run.advance`.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
    torques : array, shape (n, 3), N m
    in_space : array of bool, shape (n,)
        Whether the torque is given in space axes.
    dropped : int
        How many samples at the front of the piece before this one leaves out.
    stop : int, optional
        The sample that the next piece goes on from; None in the last.

    """

    times_ns: NDArray[np.int64]
    torques: Floats
    in_space: NDArray[np.bool_]
    dropped: int = 0
    stop: int | None = None

    def rows(self, chosen: slice | NDArray[np.intp]) -> Piece:
        """Return some of the samples."""
        return Piece(self.times_ns[chosen], self.torques[chosen], self.in_space[chosen])

    def log(self, interpolation: str) -> TorqueLog:
        """Return the piece as a log; ValueError where frames are mixed and interpolated."""
        return TorqueLog(self.times_ns, self.torques, self.in_space, interpolation)


def torque_pieces(where: str, blocks: Iterable[Messages], body_frame: str,
                  space_frame: str) -> Iterator[Piece]:
    """
    Generate the log that blocks of torques make, without holding all of it.

    Stamps out of order, or twice, are put in order where they lie in one block or two.

    Raises
    ------
    InputError
        A message has an unknown frame_id or a torque that is not finite.
    NotInOrderError
        A message has no stamp, or one from before the block before.

    """
    held, dropped = _NOTHING, 0
    for fresh in _in_order(where, blocks, body_frame, space_frame):
        held = _joined(held, fresh)
        stop = len(held.times_ns) - 1 - _BESIDE
        if stop >= _SAMPLES:
            yield held._replace(dropped=dropped, stop=stop)
            dropped = stop - _BESIDE
            held = held.rows(slice(dropped, None))
    yield held._replace(dropped=dropped)


def _in_order(where: str, blocks: Iterable[Messages], body_frame: str,
              space_frame: str) -> Iterator[Piece]:
    waiting, last_ns, number = _NOTHING, -2 ** 63, 0
    for block in blocks:
        axes = _checked(where, block, body_frame, space_frame, number)
        number += len(block)
        in_space = np.array([name == 'space' for name in axes])[block.frames]
        first_ns = int(block.stamps_ns.min())
        if first_ns <= last_ns or not block.stamps_ns.all():
            raise NotInOrderError
        waiting = _sorted(_joined(
            waiting, Piece(block.stamps_ns, block.values[:, 3:], in_space)))
        ready = int(np.searchsorted(waiting.times_ns, first_ns))
        if ready:
            last_ns = int(waiting.times_ns[ready - 1])
            yield waiting.rows(slice(ready))
            waiting = waiting.rows(slice(ready, None))
    yield waiting


def _joined(one: Piece, other: Piece) -> Piece:
    return Piece(np.concatenate([one.times_ns, other.times_ns]),
                 np.concatenate([one.torques, other.torques]),
                 np.concatenate([one.in_space, other.in_space]))


def _sorted(piece: Piece) -> Piece:
    # Of equal stamps the later in the recording counts.
    if np.all(np.diff(piece.times_ns) > 0):
        return piece
    order = np.argsort(piece.times_ns, kind='stable')
    chosen = order[np.append(np.diff(piece.times_ns[order]) != 0, True)]
    return piece.rows(chosen)


_NOTHING = Piece(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.bool_))
