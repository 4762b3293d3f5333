"""
Recordings: torques in, motion out.

`source` finds a topic in a recording of any kind; `mcap_file` and `sqlite_file` read the files it
is made of, `bulk` what their messages say. `writer` writes MCAP files, `container` their bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigid_body_ros import messages
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.source import TIME_SOURCES, Messages, Source, joined
from rigid_body_ros.recording.writer import Column, Writer
from rigid_body_ros.scene import InputError
from rigid_body_ros.torque import TorqueLog

__all__ = ['TIME_SOURCES', 'TORQUES', 'Column', 'Messages', 'Source', 'Track', 'Writer',
           'new_logs', 'read', 'torque_log']

#: Wraps an iterable of blocks of messages, so many in all, to show progress.
Track = Callable[[Iterable[Any], int], Iterable[Any]]

#: Ten years, more than a simulation lasts and less than the wall clock shows.
_SIMULATED_NS = 315_576_000 * 10 ** 9
#: What torques come as.
TORQUES = (messages.WRENCH, messages.BARE_WRENCH)


def read(path: str | Path, topic: str | None = None, kind: MessageType | None = None,
         track: Track = lambda items, total: items, time_source: str = 'header') -> Messages:
    """
    Read the messages of a topic.

    Parameters
    ----------
    path : str or Path
        An MCAP file, a SQLite file of rosbag2, or a folder of either with metadata.yaml.
    topic : str, optional
        May be left out where only one topic has the type.
    kind : MessageType, optional
        Torques are looked for otherwise.
    track : callable, optional
        Wraps the iteration over blocks of messages, to show progress.
    time_source : str
        Where stamps are taken from: 'header', 'log' or 'publish'.

    Raises
    ------
    InputError
        The recording cannot be read, has no such topic, one of another type, or several that
        are meant, or a message is not what its type says.

    """
    with Source(path, topic, TORQUES if kind is None else (kind,), time_source) as source:
        return joined(source.topic, source.kind, list(track(source, source.count)), source.damage)


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
    for row in np.flatnonzero(~np.isfinite(torques).all(axis=1)):
        raise InputError(f'{where}: message {row + 1} at {recorded.stamps_ns[row]} ns: expected '
                         f'a finite torque, found {torques[row].tolist()}')
    # After the last mark, or the mark itself, zero torque, where nothing came after it.
    first = min(int(np.append(0, new_logs(recorded) + 1)[-1]), len(torques) - 1)
    _check_stamped(where, recorded.stamps_ns, first)
    axes = []
    for code, frame_id in enumerate(recorded.names):
        try:
            axes.append(messages.torque_frame(frame_id, body_frame, space_frame))
        except ValueError as error:
            number = int(np.argmax(recorded.frames == code)) + 1
            raise InputError(f'{where}: message {number}: {error}') from error
    frames = axes[0] if len(set(axes)) == 1 else \
        [axes[code] for code in recorded.frames[first:].tolist()]
    try:
        return TorqueLog(recorded.stamps_ns[first:], torques[first:], frames, interpolation)
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error


def _check_stamped(where: str, stamps_ns: NDArray[np.int64], first: int) -> None:
    """Raise InputError where torques, from row `first` on, have no stamp."""
    unstamped = first + np.flatnonzero(stamps_ns[first:] == 0)
    # Simulated time may begin with 0; it does not reach wall time.
    begins = stamps_ns[first] == 0 < stamps_ns.max() < _SIMULATED_NS
    if unstamped.size and not begins and len(stamps_ns) > 1:
        raise InputError(f'{where}: message {unstamped[0] + 1}: expected a stamp in its header, '
                         f'found 0, as in {np.sum(stamps_ns == 0)} of {len(stamps_ns)} messages')


def new_logs(recorded: Messages) -> NDArray[np.intp]:
    """Return the rows where the log of a node begins anew (see `messages.new_log`)."""
    unnamed = np.array([not name for name in recorded.names], bool)[recorded.frames]
    begun = (recorded.stamps_ns == 0) & ~recorded.values.any(axis=1) & unnamed
    return np.flatnonzero(begun[1:]) + 1
