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
from contextlib import ExitStack
from pathlib import Path

from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.messages import is_epoch_marker
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.problem import check_axes, Logged
from rigid_body_ros.recording.selection import Topics
from rigid_body_ros.recording.source import Messages, Source
from rigid_body_ros.recording.text_files import is_text_file
from rigid_body_ros.recording.torques import first_epoch, NotInOrderError, Piece, torque_pieces
from rigid_body_ros.runtime.terminal import Track
from rigid_body_ros.scene import Scene


class Stream:
    """
    The torques on one topic, one piece at a time.

    Parameters
    ----------
    pieces : iterator of Piece
    on_rotors : bool
        Whether these are the torques that the motors apply to the rotors.
    is_held : bool
        Whether the torques are never interpolated. Commands to an actuator are never interpolated,
        and neither are torques that are derived from the rotor momentum.
    account : Account, optional
        What became of the messages; complete once the last piece has been read.
    topic : str
        The name of the topic, for error messages.

    Attributes
    ----------
    piece : Piece
        The current piece.

    """

    def __init__(self, pieces: Iterator[Piece], on_rotors: bool = False,
                 is_held: bool = False, account: Account | None = None,
                 topic: str = '') -> None:
        self._pieces, self.topic, self.account = pieces, topic, account
        self.on_rotors, self._is_held = on_rotors, is_held
        self.piece = next(pieces)

    @property
    def end_ns(self) -> int | None:
        """Return the stamp at which the next piece takes over; None if this is the last piece."""
        return None if self.piece.stop is None else int(self.piece.times_ns[self.piece.stop])

    def advance(self) -> None:
        """Go to the next piece."""
        self.piece = next(self._pieces)

    def log(self, interpolation: str) -> TorqueLog:
        """Return the current piece as a torque log; raise the same errors as `Piece.log`."""
        return self.piece.log('hold' if self._is_held else interpolation)


def whole(logged: Logged) -> list[Stream]:
    """Return the torques of a problem as streams, each of which is a single piece."""
    problem, wheels = logged.problem, logged.problem.wheels
    held = [log for log, actuator in zip(problem.logs, problem.actuators) if actuator]
    held += [wheels] if wheels and logged.is_measured else []
    return [Stream(iter([Piece(log.times_ns, log.torques, log.in_space)]), log is wheels,
                   any(log is one for one in held)) for log in problem.sources]


class Streams:
    """
    The torques on all topics of a recording that has only one epoch; a context manager.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : Scene
    topics : Topics
        The topics to read, as returned by `Topics.found_in`. They must not include a rotor
        momentum topic.
    track : callable
        Wraps the iteration over blocks of messages, to show progress.
    time_source
        See `recording.read`.

    Attributes
    ----------
    start : State, optional
        The start state, if a node recorded the epoch; set by `opened`.
    topics : tuple of str

    """

    def __init__(self, path: str | Path, scene: Scene, topics: Topics, track: Track,
                 time_source: str = 'header') -> None:
        self._path, self._scene, self._track = path, scene, track
        with ExitStack() as stack:
            self._sources = [stack.enter_context(Source(
                path, name, topics.kinds(name), time_source, topics.preferred,
                columns=topics.columns))
                             for name in topics.wrenches]
            self._wheel_torque, self._stack = topics.wheel_torque, stack.pop_all()
        self.start: State | None = None
        self.topics = tuple(source.topic for source in self._sources)

    def __enter__(self) -> Streams:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def opened(self) -> list[Stream]:
        """
        Return the torques of each topic.

        Raises
        ------
        InputError
            `first_epoch` or `torque_pieces` rejects a message, or a rotor torque is not in body
            axes.
        NotInOrderError
            The recording has to be read as a whole, because its stamps are not in order, because
            its topics begin with different start states, or because it has no messages.

        """
        begun = [self._begun(source) for source in self._sources]
        starts = {None if start is None else (
            start.time_ns, start.attitude.tobytes(), start.angular_velocity.tobytes(),
            start.rotor_momentum.tobytes(), start.wheel_speeds.tobytes())
            for start, _ in begun}
        self.start, streams = begun[0][0], [stream for _, stream in begun]
        if len(starts) > 1 or not (self.start or any(len(stream.piece.times_ns)
                                                     for stream in streams)):
            raise NotInOrderError  # any error is reported when the whole recording is read
        return streams

    def _begun(self, source: Source) -> tuple[State | None, Stream]:
        scene, on_rotors = self._scene, source.topic == self._wheel_torque
        start, blocks = first_epoch(self._path, iter(self._track(source, source.count)))
        account = Account('' if is_text_file(str(self._path)) else Account.advice)

        def checked() -> Iterator[Messages]:
            for block in blocks:
                if on_rotors and not any(map(is_epoch_marker, block.names)):
                    check_axes(self._path, block, scene)
                yield block
            account.notes += source.notes
        pieces = torque_pieces(f'{self._path}: {source.topic}', checked(), scene.body_frame,
                               scene.space_frame, scene.links, account)
        return start, Stream(pieces, on_rotors, account=account, topic=source.topic)

    @property
    def damage(self) -> str:
        """
        Return what data was lost and where; '' if nothing was lost.

        The text is complete only after the last piece has been read.
        """
        return '; '.join(dict.fromkeys(filter(None, (each.damage for each in self._sources))))
