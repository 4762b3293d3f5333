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

"""
Recordings: torques in, motion out.

`source` finds a topic in a recording of any kind; `mcap_file`, `sqlite_file` and `csv_file` read
the files it is made of, `unpack` what is compressed in them, `csv_columns` the first line of text,
`bulk` what their messages say, and `torques` makes a log of it. `writer`
writes MCAP files, `container` their bytes, and `folder` what rosbag2 wants beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rigid_body_ros import messages
from rigid_body_ros.messages import MessageType
from rigid_body_ros.recording.folder import FolderWriter
from rigid_body_ros.recording.source import joined, Messages, Source, TIME_SOURCES
from rigid_body_ros.recording.torques import (
    new_logs,
    NotInOrderError,
    Piece,
    torque_log,
    torque_pieces,
)
from rigid_body_ros.recording.writer import Column, Writer

__all__ = ['TIME_SOURCES', 'TORQUES', 'Column', 'FolderWriter', 'Messages', 'NotInOrderError',
           'Piece', 'Source', 'Track', 'Writer', 'joined', 'new_logs', 'read', 'torque_log',
           'torque_pieces']

#: Wraps an iterable of blocks of messages, so many in all, to show progress.
Track = Callable[[Iterable[Any], int], Iterable[Any]]

#: What torques come as.
TORQUES = (messages.WRENCH, messages.BARE_WRENCH)


def read(path: str | Path, topic: str | None = None, kind: MessageType | None = None,
         track: Track = lambda items, total: items, time_source: str = 'header') -> Messages:
    """
    Read the messages of a topic.

    Parameters
    ----------
    path : str or Path
        A recording, see `Source`.
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
