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

"""Turn recorded torques into a torque log, at once or in pieces."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.frames import Frames, NO_FRAMES
from rigid_body_ros.recording.source import Messages
from rigid_body_ros.torque import TorqueLog

#: Ten years: longer than any simulation, and earlier than any wall-clock time.
_SIMULATED_NS = 315_576_000 * 10 ** 9
#: Approximate number of samples in a piece.
_SAMPLES = 2 ** 16
#: Samples on each side that interpolation needs, for the slopes of the cubic.
_NEIGHBOURS = 2


def torque_log(path: str | Path, recorded: Messages, body_frame: str, space_frame: str,
               interpolation: str = 'hold', links: Frames = NO_FRAMES) -> TorqueLog:
    """
    Return the torque log of WrenchStamped messages; if they form several logs, the last one.

    A node starts a new log with a marker; see `messages.new_log`.

    Parameters
    ----------
    path : str or Path
        The recording, for error messages.
    recorded : Messages
        Torques, as `read` returns them.
    body_frame, space_frame : str
        The frame_ids of torques in body axes (or empty) and in space axes.
    interpolation : str
        'hold', 'linear' or 'cubic'.
    links : Frames
        The links of a URDF that are fixed to the body (see `urdf.fixed_frames`): a wrench in the
        frame of one acts at its origin.

    Returns
    -------
    TorqueLog

    Raises
    ------
    InputError
        There is no message; a message has an unknown frame_id, no stamp or a torque that is not
        finite; or torques of both frames are to be interpolated.

    """
    where = f'{path}: {recorded.topic}'
    if not len(recorded.stamps_ns):
        lost = f' ({recorded.damage})' if recorded.damage else ''
        raise InputError(f'{where}: expected torques, found no messages{lost}')
    torques, axes = _torques(where, recorded, (body_frame, space_frame, links))
    # The log begins with the torque after the last marker or, if no torque follows, with the
    # marker itself, a zero torque.
    first = min(int(np.append(0, new_logs(recorded) + 1)[-1]), len(torques) - 1)
    _check_stamped(where, recorded.stamps_ns, first)
    frames = axes[0] if len(set(axes)) == 1 else \
        [axes[code] for code in recorded.frames[first:].tolist()]
    try:
        return TorqueLog(recorded.stamps_ns[first:], torques[first:], frames, interpolation)
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error


def _torques(where: str, recorded: Messages, frames: tuple[str, str, Frames],
             before: int = 0) -> tuple[Floats, list[str]]:
    """
    Return the torques about the centre of mass, N m, shape (n, 3), and the axes of each frame.

    `frames` are the body frame, the space frame and the links that are fixed to the body. Raise
    InputError that names the first invalid message; `before` messages of the topic came before.
    """
    torques, axes, moved = recorded.values[:, 3:], [], {}
    for code, frame_id in enumerate(recorded.names):
        try:
            one, frame = messages.wrench_frame(frame_id, *frames)
        except ValueError as error:
            number = before + int(np.argmax(recorded.frames == code)) + 1
            raise InputError(f'{where}: message {number}: {error}') from error
        axes.append(one)
        if frame:
            moved[code] = frame
    if moved:
        torques = torques.copy()
    for code, frame in moved.items():
        rows = recorded.frames == code
        torques[rows] = frame.torque(recorded.values[rows, :3], recorded.values[rows, 3:])
    _check_finite(where, recorded, torques, moved, before)
    return torques, axes


def _check_finite(where: str, recorded: Messages, torques: Floats, moved: Collection[int],
                  before: int) -> None:
    """Raise InputError that names the first message whose torque is not finite."""
    if np.isfinite(torques).all():
        return
    row = int(np.flatnonzero(~np.isfinite(torques).all(axis=1))[0])
    source = f', from the wrench {recorded.values[row].tolist()} in frame ' \
             f'{recorded.names[recorded.frames[row]]!r}' if recorded.frames[row] in moved else ''
    raise InputError(f'{where}: message {before + row + 1} at {recorded.stamps_ns[row]} ns: '
                     f'expected a finite torque, found {torques[row].tolist()}{source}')


def _check_stamped(where: str, stamps_ns: NDArray[np.int64], first: int) -> None:
    """Raise InputError if a torque from row `first` on has no stamp."""
    unstamped = first + np.flatnonzero(stamps_ns[first:] == 0)
    # A log of simulated time may begin with the stamp 0.
    begins = stamps_ns[first] == 0 < stamps_ns.max() < _SIMULATED_NS
    if unstamped.size and not begins and len(stamps_ns) > 1:
        raise InputError(f'{where}: message {unstamped[0] + 1}: expected a stamp in the header, '
                         f'found 0, as in {np.sum(stamps_ns == 0)} of {len(stamps_ns)} messages; '
                         'use --time-source log for the times of the recording')


def new_logs(recorded: Messages) -> NDArray[np.intp]:
    """Return the rows of the markers that start a new log (see `messages.new_log`)."""
    without_frame = np.array([not name for name in recorded.names], bool)[recorded.frames]
    markers = (recorded.stamps_ns == 0) & ~recorded.values.any(axis=1) & without_frame
    return np.flatnonzero(markers[1:]) + 1


class NotInOrderError(Exception):
    """The log cannot be read in pieces; the whole recording is needed."""


class Piece(NamedTuple):
    """
    Consecutive samples of a log, which overlap with those of the next piece.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
    torques : array, shape (n, 3), N m
    in_space : array of bool, shape (n,)
        Whether a torque is given in space axes.
    dropped : int
        Number of samples of the previous piece before the first sample of this piece.
    stop : int, optional
        Index of the sample at which the next piece continues; None in the last piece.

    """

    times_ns: NDArray[np.int64]
    torques: Floats
    in_space: NDArray[np.bool_]
    dropped: int = 0
    stop: int | None = None

    def rows(self, chosen: slice | NDArray[np.intp]) -> Piece:
        """Return a selection of the samples."""
        return Piece(self.times_ns[chosen], self.torques[chosen], self.in_space[chosen])

    def log(self, interpolation: str) -> TorqueLog:
        """
        Return the samples as a log.

        Raises
        ------
        ValueError
            The interpolation is not 'hold', and the samples are in body axes and in space axes.

        """
        return TorqueLog(self.times_ns, self.torques, self.in_space, interpolation)


def torque_pieces(where: str, blocks: Iterable[Messages], body_frame: str, space_frame: str,
                  links: Frames = NO_FRAMES) -> Iterator[Piece]:
    """
    Generate the torque log in pieces from blocks of messages, so that it need not fit in memory.

    Samples are sorted by stamp within two neighbouring blocks. Of samples with equal stamps, only
    the last in the recording is kept.

    Raises
    ------
    InputError
        A message has an unknown frame_id or a torque that is not finite.
    NotInOrderError
        A message has no stamp, or its stamp is not after the samples of earlier pieces.

    """
    piece, dropped = _EMPTY, 0
    for samples in _ascending(where, blocks, (body_frame, space_frame, links)):
        piece = _concatenated(piece, samples)
        stop = len(piece.times_ns) - 1 - _NEIGHBOURS
        if stop >= _SAMPLES:
            yield piece._replace(dropped=dropped, stop=stop)
            dropped = stop - _NEIGHBOURS
            piece = piece.rows(slice(dropped, None))
    yield piece._replace(dropped=dropped)


def _ascending(where: str, blocks: Iterable[Messages],
               frames: tuple[str, str, Frames]) -> Iterator[Piece]:
    """
    Generate the samples of all blocks, sorted by stamp.

    Of two neighbouring blocks, only the samples before the first stamp of the second are ready.
    """
    waiting, last_ns, number = _EMPTY, -2 ** 63, 0
    for block in blocks:
        torques, axes = _torques(where, block, frames, number)
        number += len(block)
        in_space = np.array([name == 'space' for name in axes])[block.frames]
        first_ns = int(block.stamps_ns.min())
        if first_ns <= last_ns or not block.stamps_ns.all():
            raise NotInOrderError
        waiting = _sorted(_concatenated(
            waiting, Piece(block.stamps_ns, torques, in_space)))
        ready = int(np.searchsorted(waiting.times_ns, first_ns))
        if ready:
            last_ns = int(waiting.times_ns[ready - 1])
            yield waiting.rows(slice(ready))
            waiting = waiting.rows(slice(ready, None))
    yield waiting


def _concatenated(one: Piece, other: Piece) -> Piece:
    return Piece(np.concatenate([one.times_ns, other.times_ns]),
                 np.concatenate([one.torques, other.torques]),
                 np.concatenate([one.in_space, other.in_space]))


def _sorted(piece: Piece) -> Piece:
    # Of samples with equal stamps, keep the last in the recording.
    if np.all(np.diff(piece.times_ns) > 0):
        return piece
    order = np.argsort(piece.times_ns, kind='stable')
    chosen = order[np.append(np.diff(piece.times_ns[order]) != 0, True)]
    return piece.rows(chosen)


_EMPTY = Piece(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.bool_))
