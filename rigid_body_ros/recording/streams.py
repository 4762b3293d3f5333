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

"""Read the torques of several topics piece by piece, so that they do not have to fit in memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from pathlib import Path

from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.messages import is_epoch_marker
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.problem import bits_of, check_axes
from rigid_body_ros.recording.selection import Reading
from rigid_body_ros.recording.source import Messages, Source
from rigid_body_ros.recording.text_files import is_text_file
from rigid_body_ros.recording.torques import first_epoch, NotInOrderError, Piece, torque_pieces
from rigid_body_ros.scene import Scene


class Stream:
    """
    The torques on one topic, one piece at a time.

    Parameters
    ----------
    pieces : iterator of Piece
    on_rotors : bool
        Whether these are the torques that the motors apply to the rotors.
    interpolation : str
        How to interpolate between samples.
    account : Account, optional
        What became of the messages; complete once the last piece has been read.
    source : Source, optional
        The topic that is read piece by piece.

    Attributes
    ----------
    piece : Piece
        The current piece.

    """

    def __init__(self, pieces: Iterator[Piece], on_rotors: bool, interpolation: str,
                 account: Account | None = None, source: Source | None = None) -> None:
        self._pieces, self.source, self.account = pieces, source, account
        self.on_rotors, self._interpolation = on_rotors, interpolation
        self.piece = next(pieces)

    @property
    def end_ns(self) -> int | None:
        """Return the stamp at which the next piece takes over; None if this is the last piece."""
        return None if self.piece.stop is None else int(self.piece.times_ns[self.piece.stop])

    def advance(self) -> None:
        """Go to the next piece."""
        self.piece = next(self._pieces)

    def log(self) -> TorqueLog:
        """
        Return the current piece as a torque log.

        Raises
        ------
        ValueError
            The samples mix body axes and space axes, which only the interpolation 'hold' allows.

        """
        return TorqueLog(*self.piece[:3], self._interpolation)


def whole(problem: Problem) -> list[Stream]:
    """Return the torques of a problem as streams, each of which is a single piece."""
    return [Stream(iter([Piece(log.times_ns, log.torques, log.in_space)]), log is problem.wheels,
                   log.interpolation) for log in problem.sources]


@contextmanager
def streamed(path: str | Path, scene: Scene,
             reading: Reading) -> Iterator[tuple[State | None, list[Stream]]]:
    """
    Open the torques on all topics of a recording that has only one epoch.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : Scene
        The body, the names of the frames, and the initial state.
    reading : Reading
        What to read, and how. Its topics are those that `Topics.found_in` returns, without a rotor
        momentum topic.

    Yields
    ------
    start : State or None
        The start state, if a node recorded the epoch.
    streams : list of Stream
        The torques of each topic.

    Raises
    ------
    InputError
        `first_epoch` or `torque_pieces` rejects a message, or a rotor torque is not in body axes.
    NotInOrderError
        The recording has to be read as a whole, because its stamps are not in order, because its
        topics begin with different start states, or because it has no messages.

    """
    topics = reading.topics
    with ExitStack() as stack:
        sources = [stack.enter_context(Source(path, name, topics.kinds(name), reading.time_source,
                                              topics.preferred, columns=topics.columns))
                   for name in topics.wrenches]
        starts, streams = zip(*(_begun(path, scene, reading, source) for source in sources))
        is_empty = starts[0] is None and not any(len(stream.piece.times_ns) for stream in streams)
        if is_empty or len({bits_of(start) for start in starts}) > 1:
            raise NotInOrderError  # any error is reported when the whole recording is read
        yield starts[0], [*streams]


def _begun(path: str | Path, scene: Scene, reading: Reading,
           source: Source) -> tuple[State | None, Stream]:
    """Return the start state and the torques of a topic."""
    on_rotors = source.topic == reading.topics.wheel_torque
    start, blocks = first_epoch(path, iter(reading.track(source, source.count)))
    account = Account('' if is_text_file(str(path)) else Account.advice)

    def checked() -> Iterator[Messages]:
        for block in blocks:
            if on_rotors and not any(map(is_epoch_marker, block.names)):
                check_axes(path, block, scene)
            yield block
        account.notes += source.notes
    pieces = torque_pieces(f'{path}: {source.topic}', checked(), scene.body_frame,
                           scene.space_frame, scene.links, account)
    return start, Stream(pieces, on_rotors, reading.interpolation or scene.interpolation, account,
                         source)
