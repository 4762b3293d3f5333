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

"""Turn recorded torques into a torque log, all at once or in pieces; split them into epochs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, located, quoted, reason
from rigid_body_ros.mechanics.frames import Frame, Frames, NO_FRAMES, OffAxisError
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.recording.account import Account, SLASH
from rigid_body_ros.recording.source import Messages

#: Ten years, ns. A stamp below this limit is simulated time. Wall-clock time counts from 1970 and
#: is always above it.
_SIMULATED_NS = 315_576_000 * 10 ** 9
#: Approximate number of samples in a piece.
_SAMPLES = 2 ** 13
#: Consecutive pieces overlap, because cubic interpolation needs neighbouring samples. The next
#: piece takes over at the sample `Piece.stop`, and repeats this many samples on each side of that
#: sample.
_NEIGHBOURS = 3
#: The topics on which a node logs the torques that it accepts.
_NODE_LOG = re.compile(r'(.*/)?accepted_(torque(_[0-9]+)?|wheel_torque|wheel_command|inertia)')


def epochs(path: str | Path, recorded: Messages) -> list[Messages]:
    """
    Split a node's log into epochs, each with its start state.

    Torques that a node did not log are returned unchanged, as a single epoch.

    A node writes a marker to its log at the beginning of every epoch; see `messages.epoch_marker`.

    Parameters
    ----------
    path : str or Path
        Path of the recording, for error messages.
    recorded : Messages
        The torques, as returned by `read`.

    Raises
    ------
    InputError
        A node's log does not begin with a marker, or a marker is not valid.

    """
    is_marker = np.array([messages.is_epoch_marker(name) for name in recorded.names], np.bool_)
    markers = np.flatnonzero(is_marker[recorded.frames]).tolist()
    if markers[:1] != [0] and len(recorded) and (markers or _NODE_LOG.fullmatch(recorded.topic)):
        where = f'the first marker in message {recorded.before + markers[0] + 1}' if markers \
            else 'no marker'
        raise InputError(f'{path}: {recorded.topic}: expected the log of a node to begin with the '
                         f'marker and the start state of an epoch, found {where}: the recording '
                         'began in the middle of an epoch, or an older version of rigid_body_ros '
                         'made it')
    return [replace(recorded.rows(slice(row + 1, end)), before=recorded.before + row + 1,
                    start=_start(path, recorded, row))
            for row, end in zip(markers, [*markers[1:], len(recorded)])] or [recorded]


def _start(path: str | Path, recorded: Messages, row: int) -> State:
    """Read the start state from a marker; raise InputError if the marker is not valid."""
    frame_id, values = recorded.names[recorded.frames[row]], recorded.values[row]
    try:
        if values.any():
            raise ValueError(f'expected zeros, found {values.tolist()}')
        return messages.epoch_start(int(recorded.stamps_ns[row]), frame_id)
    except ValueError as error:
        raise InputError(f'{path}: {recorded.topic}: message {recorded.before + row + 1}: marker '
                         f'of an epoch: {reason(error)}') from error


def first_epoch(path: str | Path, blocks: Iterator[Messages]
                ) -> tuple[State | None, Iterator[Messages]]:
    """
    Return the start state and the torques of the first epoch in a node's log.

    If a node did not log the torques, the start state is None.

    Only the first block is checked here. If a later block contains the marker of another epoch,
    `torque_pieces` raises NotInOrderError.

    Raises
    ------
    NotInOrderError
        The first block contains several epochs.
    InputError
        `epochs` rejects the first block.

    """
    block = next(blocks, None)
    if block is None:
        return None, blocks
    first, *others = epochs(path, block)
    if others:
        raise NotInOrderError
    return first.start, chain([first] if len(first) else [], blocks)


def torque_log(path: str | Path, recorded: Messages, body_frame: str, space_frame: str,
               interpolation: str = 'hold', links: Frames = NO_FRAMES,
               account: Account | None = None) -> TorqueLog:
    """
    Turn the WrenchStamped messages of one epoch (see `epochs`) into a torque log.

    Parameters
    ----------
    path : str or Path
        Path of the recording, for error messages.
    recorded : Messages
        The torques, as returned by `read`.
    body_frame, space_frame : str
        The frame_ids that mean body axes and space axes. An empty frame_id also means body axes.
    interpolation : str
        'hold', 'linear' or 'cubic'.
    links : Frames
        The link frames of a URDF (see `urdf.fixed_frames`). A wrench in a link frame acts at the
        origin of that frame.
    account : Account, optional
        Counts the messages.

    Returns
    -------
    TorqueLog
        Without the messages whose torque is not finite; `account` counts them.

    Raises
    ------
    InputError
        `recorded` has neither messages with a finite torque nor a start state; a message has an
        unknown frame_id or no stamp; a wrench in a turning frame does not point along
        the axis of that frame; or the torques mix body axes and space axes, which only the
        interpolation 'hold' allows.

    """
    where = f'{path}: {recorded.topic}'
    if not len(recorded) and not recorded.start:
        lost = f' ({recorded.damage})' if recorded.damage else ''
        raise InputError(f'{where}: expected torques, found no messages{lost}')
    account = account or Account()
    account.notes += recorded.notes
    piece = _torques(where, recorded, (body_frame, space_frame, links), account)
    if len(recorded) and not len(piece.times_ns):
        raise InputError(f'{where}: expected a finite torque, found none among {len(recorded)} '
                         'messages')
    check_stamped(where, recorded)
    with located(where):
        return TorqueLog(*piece[:3], interpolation)


def _torques(where: str, recorded: Messages, frames: tuple[str, str, Frames],
             account: Account) -> Piece:
    """
    Return the finite torques about the centre of mass, and count the messages.

    `frames` contains the body frame, the space frame and the link frames. If a message is invalid,
    raise an InputError that names the first such message.
    """
    axes, moved = [], {}
    for code, frame_id in enumerate(recorded.names):
        if frame_id.startswith('/') and SLASH not in account.notes:
            account.notes.append(SLASH)
        try:
            axis, frame = messages.wrench_frame(frame_id, *frames)
        except ValueError as error:
            number = recorded.before + int(np.argmax(recorded.frames == code)) + 1
            raise InputError(f'{where}: message {number}: {error}') from error
        axes.append(axis)
        if frame:
            moved[code] = frame
    torques = _moved(where, recorded, moved) if moved else recorded.values[:, 3:]
    in_space = np.array([name == 'space' for name in axes], np.bool_)[recorded.frames]
    piece = Piece(recorded.stamps_ns, torques, in_space)
    if not np.isfinite(torques).all():
        piece = piece.rows(np.flatnonzero(np.isfinite(torques).all(axis=1)))
    account.add(piece.times_ns, len(recorded) - len(piece.times_ns))
    return piece


def _moved(where: str, recorded: Messages, frames: Mapping[int, Frame]) -> Floats:
    """Convert wrenches in `frames` to torques about the centre of mass, N m, shape (n, 3)."""
    torques, off_axis = recorded.values[:, 3:].copy(), {}
    for code, frame in frames.items():
        rows = recorded.frames == code
        try:
            torques[rows] = frame.torque(recorded.values[rows, :3], recorded.values[rows, 3:])
        except OffAxisError as error:
            row = int(np.flatnonzero(rows)[error.row])
            off_axis[row] = f'frame {quoted(recorded.names[code])}: {error}'
    if off_axis:
        row = min(off_axis)
        raise InputError(f'{where}: message {recorded.before + row + 1}: {off_axis[row]}')
    return torques


def check_stamped(where: str, recorded: Messages) -> None:
    """Raise InputError if there are several messages and one of them has no stamp."""
    stamps_ns = recorded.stamps_ns
    if recorded.start or len(stamps_ns) < 2:  # a node never accepts a message without a stamp
        return
    unstamped = np.flatnonzero(stamps_ns == 0)
    # The stamp 0 is allowed at the beginning of a log of simulated time.
    begins = stamps_ns[0] == 0 < stamps_ns.max() < _SIMULATED_NS
    if unstamped.size and not begins:
        raise InputError(f'{where}: message {unstamped[0] + 1}: expected a stamp in the header, '
                         f'found 0, as in {np.sum(stamps_ns == 0)} of {len(stamps_ns)} messages; '
                         'use --time-source log for the times of the recording')


class NotInOrderError(Exception):
    """Raised if a log cannot be read in pieces, so that the whole recording has to be read."""


class Piece(NamedTuple):
    """
    Consecutive samples of a torque log. The next piece repeats the last few samples of this piece.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
    torques : array, shape (n, 3), N m
    in_space : array of bool, shape (n,)
        Whether each torque is given in space axes.
    stop : int, optional
        The index of the sample at which the next piece takes over; None in the last piece.

    """

    times_ns: NDArray[np.int64]
    torques: Floats
    in_space: NDArray[np.bool_]
    stop: int | None = None

    def rows(self, chosen: slice | NDArray[np.intp]) -> Piece:
        """Return a piece that contains only the chosen samples."""
        return Piece(self.times_ns[chosen], self.torques[chosen], self.in_space[chosen])


def torque_pieces(where: str, blocks: Iterable[Messages], body_frame: str, space_frame: str,
                  links: Frames = NO_FRAMES, account: Account | None = None) -> Iterator[Piece]:
    """
    Turn blocks of messages into the pieces of a torque log that need not fit in memory.

    The samples are sorted by stamp, within each block and across two neighbouring blocks.
    If several samples have the same stamp, only the one that was recorded last is kept. Torques
    that are not finite are left out. `account` counts the messages as they are read.

    Raises
    ------
    InputError
        A message has an unknown frame_id, or a wrench in a turning frame does not point along the
        axis of that frame.
    NotInOrderError
        A message begins another epoch, has no stamp, or has a stamp that is not later than the
        last stamp in earlier pieces.

    """
    piece = _EMPTY
    for samples in _ascending(where, blocks, (body_frame, space_frame, links),
                              account or Account()):
        piece = _concatenated(piece, samples)
        stop = len(piece.times_ns) - 1 - _NEIGHBOURS
        if stop >= _SAMPLES:
            yield piece._replace(stop=stop)
            piece = piece.rows(slice(stop - _NEIGHBOURS, None))
    yield piece


def _ascending(where: str, blocks: Iterable[Messages],
               frames: tuple[str, str, Frames], account: Account) -> Iterator[Piece]:
    """
    Generate the samples of all blocks, sorted by stamp.

    Once a block has been read, yield the samples whose stamps are before the block's earliest
    stamp, and keep the rest until the next block has been read.
    """
    waiting, last_ns = _EMPTY, -2 ** 63
    for block in blocks:
        if any(map(messages.is_epoch_marker, block.names)):
            raise NotInOrderError
        first_ns = int(block.stamps_ns.min())
        if first_ns <= last_ns or not block.stamps_ns.all():
            raise NotInOrderError
        waiting = _sorted(_concatenated(waiting, _torques(where, block, frames, account)))
        ready = int(np.searchsorted(waiting.times_ns, first_ns))
        if ready:
            last_ns = int(waiting.times_ns[ready - 1])
            yield waiting.rows(slice(ready))
            waiting = waiting.rows(slice(ready, None))
    yield waiting


def _concatenated(first: Piece, second: Piece) -> Piece:
    return Piece(np.concatenate([first.times_ns, second.times_ns]),
                 np.concatenate([first.torques, second.torques]),
                 np.concatenate([first.in_space, second.in_space]))


def _sorted(piece: Piece) -> Piece:
    # If several samples have the same stamp, keep the one that was recorded last.
    if np.all(np.diff(piece.times_ns) > 0):
        return piece
    order = np.argsort(piece.times_ns, kind='stable')
    chosen = order[np.append(np.diff(piece.times_ns[order]) != 0, True)]
    return piece.rows(chosen)


_EMPTY = Piece(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.bool_))
