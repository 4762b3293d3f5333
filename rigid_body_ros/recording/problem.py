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
Combine a recording and a scene into problems, one for each epoch.

A recording with one epoch can also be read piece by piece, so that its torques do not have to fit
in memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, located, quoted
from rigid_body_ros.mechanics.changes import BodyLog
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import stamps_of, TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording import source, torques
from rigid_body_ros.recording.account import Account, merged
from rigid_body_ros.recording.selection import Reading, Topics
from rigid_body_ros.recording.source import Messages, Source
from rigid_body_ros.recording.text_files import is_text_file
from rigid_body_ros.scene import load, Scene

#: Two rotor momenta count as equal if their relative difference is at most this.
_SAME_MOMENTUM = 1e-6


class Logged(NamedTuple):
    """The problem that a recording or an epoch of a node describes, and how it was recorded."""

    problem: Problem
    account: Account
    #: Whether the start state comes from the marker of an epoch rather than from the scene.
    is_epoch: bool
    damage: str
    topics: tuple[str, ...]

    @property
    def times_ns(self) -> NDArray[np.int64]:
        """Return the ascending stamps of all inputs, or the start time if there are no inputs."""
        stamps_ns = self.problem.stamps_ns
        return stamps_ns if stamps_ns.size else np.array([self.problem.start.time_ns])


def read(path: str | Path, scene: str | Path | Scene, *,
         topic: str | Sequence[str] | None = None, wheel_torque: str | None = None,
         wheel_momentum: str | None = None, wheel_command: str | None = None,
         inertia: str | None = None, interpolation: str | None = None,
         time_source: str = 'header', columns: Mapping[str, str] | None = None) -> Problem:
    """
    Return the problem that the command `attitude_replay` solves for a recording and a scene.

    A recording of a node may contain several epochs. In that case, return the problem of the last
    epoch that begins at the scene's `start_time`.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : str, Path or Scene
        The scene, or the scene file.
    topic, wheel_torque, wheel_momentum, wheel_command, inertia
        See `replay`.
    interpolation, time_source, columns
        See `replay`.

    Returns
    -------
    Problem

    Raises
    ------
    InputError
        The recording or the scene cannot be read, the recording does not fit the scene, or no
        epoch begins at `start_time`.

    """
    loaded = scene if isinstance(scene, Scene) else load(scene)
    topics = Topics.given(topic, wheel_torque=wheel_torque, wheel_momentum=wheel_momentum,
                          inertia=inertia, wheel_command=wheel_command, columns=columns)
    reading = Reading(topics=topics.found_in(path, loaded), interpolation=interpolation,
                      time_source=time_source)
    return chosen(path, loaded, read_epochs(path, loaded, reading), may_change=True).problem


def read_epochs(path: str | Path, scene: Scene, reading: Reading) -> list[Logged]:
    """
    Read the problem of a recording, or of each epoch if a node made the recording.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : Scene
        The body, the names of the frames, and the initial state.
    reading : Reading
        What to read, and how. Its topics are those that `Topics.found_in` returns.

    Returns
    -------
    list of Logged
        The problems, in the order of the recording.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene, or its topics disagree about the
        epochs.

    """
    topics = reading.topics
    kinds = [(name, topics.kinds(name)) for name in topics.wrenches]
    if topics.inertia:
        kinds.append((topics.inertia, [messages.INERTIA]))
    if topics.wheel_command:
        names = [wheel.name for wheel in scene.named_wheels]
        kinds.append((topics.wheel_command, [messages.joint_commands(names)]))
    logs = [source.read(path, name, kind, reading.track, reading.time_source, topics.preferred,
                        topics.columns) for name, kind in kinds]
    momentum = source.read(path, topics.wheel_momentum, messages.VECTOR3, reading.track,
                           reading.time_source) if topics.wheel_momentum else None
    parts = aligned(path, [torques.epochs(path, log) for log in logs],
                    reading.time_source == 'header')
    if momentum is not None and len(parts) > 1:
        raise InputError(f'{path}: --wheel-momentum: expected one epoch, found {len(parts)}')
    return [_logged(path, scene, reading, part, momentum) for part in parts]


def chosen(path: str | Path, scene: Scene, recorded: Sequence[Logged],
           may_change: bool = False) -> Logged:
    """
    Choose one epoch, for a command that works on a single motion.

    If there are several epochs, return the last one that begins at the scene's `start_time`.
    Commands that can handle a changing body set `may_change`.

    Raises
    ------
    InputError
        No epoch begins at `start_time`, or the body changes but `may_change` is not set.

    """
    stamps_ns = [epoch.problem.start.time_ns for epoch in recorded]
    start_ns = scene.start.time_ns
    if len(stamps_ns) > 1 and start_ns not in stamps_ns:
        raise InputError(f'{path}: expected one epoch, or the start_time of one, found '
                         f'{len(stamps_ns)} epochs, which begin at '
                         f'{listed([str(stamp) for stamp in stamps_ns])} ns, and start_time '
                         f'{start_ns}; set start_time in the scene')
    epoch = recorded[len(recorded) - 1 - stamps_ns[::-1].index(start_ns)
                     if len(recorded) > 1 else 0]
    if epoch.problem.changes and not may_change:
        raise InputError(f'{path}: expected a body that does not change, found '
                         f'{len(epoch.problem.changes)} changes of its inertia, which only '
                         'attitude_replay computes; set inertia_topic: false in the scene')
    return epoch


def _logged(path: str | Path, scene: Scene, reading: Reading, parts: Sequence[Messages],
            momentum: Messages | None) -> Logged:
    """
    Return the problem of one epoch.

    `parts` contains the messages of each topic that is read: first the torques on the body, then
    the rotor torque, the inertia and the commands to named wheels, in this order.
    """
    topics, interpolation = reading.topics, reading.interpolation or scene.interpolation
    body, measured, wheels = [*parts], None, None
    recorded = [*parts, *([] if momentum is None else [momentum])]
    where = f'{path}: {listed([part.topic for part in recorded])}'
    advice = '' if is_text_file(str(path)) else Account.advice
    accounts = {part.topic: Account(advice) for part in recorded}
    efforts = _efforts(path, body.pop()) if topics.wheel_command else None
    changes = _changes(path, body.pop(), scene) if topics.inertia else None
    if topics.wheel_torque:
        check_axes(path, body[-1], scene)
        wheels = _log(path, body.pop(), scene, interpolation, accounts)
    actuators = topics.actuators(scene)
    logs = [_log(path, part, scene, 'hold' if held else interpolation, accounts)
            for part, held in zip(body, actuators or (None,) * len(body))]
    if momentum is not None:
        measured, wheels = _from_momentum(path, momentum, scene)
    damage = '; '.join(dict.fromkeys(part.damage for part in recorded if part.damage))
    stamps_ns = stamps_of([*logs, *([wheels] if wheels else [])])
    if efforts:
        stamps_ns = np.union1d(stamps_ns, efforts.times_ns)
    begin = next((part.start for part in parts if part.start), None)
    if not stamps_ns.size and not begin:
        lost = f' ({damage})' if damage else ''
        raise InputError(f'{where}: expected torques, found no messages{lost}')
    first_ns = int(stamps_ns[0]) if stamps_ns.size else 0
    start = started(path, scene, begin, first_ns, reading.start)
    if measured is not None:
        start = _started(start, measured)
    with located(where):
        problem = scene.problem(start).replaced(
            log=logs, wheels=wheels, changes=changes, efforts=efforts, actuator=actuators)
        if reading.start:  # an actuator lags from its first command, not from the start
            problem = problem.replaced(start=replace(start, time_ns=first_ns)).replaced(
                start=start)
    for part in recorded:
        if accounts[part.topic].samples < len(part):  # not a torque
            accounts[part.topic].add(part.stamps_ns)
    return Logged(problem, merged(accounts), begin is not None, damage, tuple(accounts))


def started(path: str | Path, scene: Scene, begin: State | None, first_ns: int,
            skip: float) -> State:
    """
    Return the state in which a motion starts: `begin` for an epoch of a node, else the scene's.

    If `skip` is positive, the motion starts `skip` seconds after `first_ns`. Earlier samples still
    act. For an epoch of a node, raise InputError instead.
    """
    if begin and skip:
        raise InputError(f'{path}: --from: expected no time to skip, because the log of a node '
                         'begins at its start state')
    return begin or scene.starting_at(first_ns, skip)


def aligned(path: str | Path, topics: Sequence[Sequence[Messages]],
            has_stamps: bool) -> list[tuple[Messages, ...]]:
    """
    Match up the epochs of all topics; return a tuple per epoch, with the messages of each topic.

    If a node is killed while it begins an epoch, the marker of that epoch may be missing from some
    topics. A topic without the marker has no torques in that epoch.

    Parameters
    ----------
    path : str or Path
        Path of the recording, for error messages.
    topics : sequence of sequence of Messages
        The epochs of each topic.
    has_stamps : bool
        Whether the stamps come from the message headers. Otherwise, the marker of an epoch has a
        different stamp on each topic.

    Raises
    ------
    InputError
        An epoch begins with different states on different topics.

    """
    longest = max(topics, key=lambda parts: sum(part.start is not None for part in parts),
                  default=())
    if not longest or longest[0].start is None:
        return [tuple(parts[0] for parts in topics)]
    for parts in topics:
        for part, expected in zip(parts, longest):
            _check_same_start(path, part, expected, has_stamps)
    return [tuple(parts[k] if k < len(parts) else
                  replace(parts[0].rows(slice(0)), start=expected.start) for parts in topics)
            for k, expected in enumerate(longest)]


def _check_same_start(path: str | Path, part: Messages, expected: Messages,
                      has_stamps: bool) -> None:
    if part.start is None and not len(part):
        return  # a topic without messages
    if bits_of(part.start, has_stamps) != bits_of(expected.start, has_stamps):
        begin = f'the epoch that begins at {part.start.time_ns} ns' if part.start else \
            'torques without epochs'
        assert expected.start
        raise InputError(f'{path}: {part.topic}: expected the epoch that begins at '
                         f'{expected.start.time_ns} ns, with the same start state as on '
                         f'{expected.topic}, found {begin}')


def bits_of(state: State | None, has_stamp: bool = True) -> tuple[int | bytes, ...]:
    """Return what is equal for two states only if all of their bits are."""
    return () if state is None else (
        state.time_ns if has_stamp else 0, state.attitude.tobytes(),
        state.angular_velocity.tobytes(), state.rotor_momentum.tobytes(),
        state.wheel_speeds.tobytes())


def same_bits(values: Floats, others: Floats) -> NDArray[np.bool_]:
    """Return whether the rows of two arrays, shape (n, d), are equal in every bit, shape (n,)."""
    bits, other_bits = (np.ascontiguousarray(rows).view(np.int64) for rows in (values, others))
    return (bits == other_bits).all(axis=1)


def _log(path: str | Path, recorded: Messages, scene: Scene, interpolation: str,
         accounts: Mapping[str, Account]) -> TorqueLog:
    """Return the torque log of a topic; the log is empty if there are no messages."""
    if not len(recorded):
        return TorqueLog([], [], interpolation=interpolation)
    return torques.torque_log(path, recorded, scene.body_frame, scene.space_frame, interpolation,
                              scene.links, accounts[recorded.topic])


def _efforts(path: str | Path, recorded: Messages) -> EffortLog:
    """
    Return the wheel commands on a topic, in the order of the wheels.

    The frame_ids of the commands are ignored.
    """
    torques.check_stamped(f'{path}: {recorded.topic}', recorded)
    return EffortLog(recorded.stamps_ns, recorded.values)


def _changes(path: str | Path, recorded: Messages, scene: Scene) -> BodyLog:
    """Return the bodies that an inertia topic describes; all have the damping of the scene."""
    check_axes(path, recorded, scene)
    torques.check_stamped(f'{path}: {recorded.topic}', recorded)
    bodies = []
    for row, entries in enumerate(messages.inertia_entries(recorded.values)):
        try:
            bodies.append(scene.body.with_entries(entries))
        except ValueError as error:
            raise InputError(f'{path}: {recorded.topic}: message {recorded.before + row + 1} at '
                             f'{recorded.stamps_ns[row]} ns: {error}') from error
    return BodyLog(recorded.stamps_ns, bodies, scene.inertia_change)


def check_axes(path: str | Path, recorded: Messages, scene: Scene) -> None:
    """Raise InputError unless all messages (rotor vectors or inertias) are in body axes."""
    body = scene.body_frame
    for code, name in enumerate(recorded.names):
        if name.removeprefix('/') not in ('', body):
            number = recorded.before + int(np.argmax(recorded.frames == code)) + 1
            raise InputError(f'{path}: {recorded.topic}: message {number}: frame_id: '
                             f"expected '{body}' or '' (body axes), found {quoted(name)}")


def _from_momentum(path: str | Path, recorded: Messages,
                   scene: Scene) -> tuple[TorqueLog, TorqueLog]:
    """Return measured rotor momenta, N m s, interpolated linearly, and the rotor torques."""
    where = f'{path}: {recorded.topic}'
    if not len(recorded):
        raise InputError(f'{where}: expected the momentum of the rotors, found no messages')
    check_axes(path, recorded, scene)
    unstamped = int(np.sum(recorded.stamps_ns == 0))
    if unstamped > 1:
        raise InputError(f'{where}: expected stamps in the headers, found 0 in {unstamped} of '
                         f'{len(recorded)} messages; use --time-source log for the times of the '
                         'recording')
    bad = np.flatnonzero(~np.isfinite(recorded.values).all(axis=1))
    if bad.size:
        raise InputError(f'{where}: message {bad[0] + 1} at {recorded.stamps_ns[bad[0]]} ns: '
                         'expected a finite momentum, found '
                         f'{recorded.values[bad[0]].tolist()}')
    measured = TorqueLog(recorded.stamps_ns, recorded.values, interpolation='linear')
    longest = int(np.diff(measured.times_ns).max(initial=0))
    if 0 < scene.timeout_ns < longest:
        raise InputError(f'{where}: expected samples at most torque_timeout '
                         f'({scene.torque_timeout} s) apart, found a gap of '
                         f'{longest * 1e-9:.9g} s')
    with located(where):
        return measured, TorqueLog.from_momentum(measured.times_ns, measured.torques)


def _started(start: State, measured: TorqueLog) -> State:
    """
    Return the start state with the measured rotor momentum.

    The momentum is taken from the measurements at the start time. If the measurements begin later,
    the momentum of their first sample is used.
    """
    time_ns = max(start.time_ns, int(measured.times_ns[0]))
    momentum: Floats = measured.at([time_ns])[0][0]
    stated = start.rotor_momentum
    most = _SAME_MOMENTUM * np.linalg.norm(stated)
    if stated.any() and np.linalg.norm(stated - momentum) > most:
        raise InputError(f'initial_rotor_momentum: expected {momentum.tolist()} N m s as '
                         f'measured at the start, or no value, found {stated.tolist()}')
    return replace(start, rotor_momentum=momentum)


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
    where : str
        The recording and the topic, for error messages.
    account : Account, optional
        What became of the messages; complete once the last piece has been read.
    source : Source, optional
        The topic that is read piece by piece.

    Attributes
    ----------
    piece : Piece
        The current piece.

    """

    def __init__(self, pieces: Iterator[torques.Piece], on_rotors: bool, interpolation: str,
                 where: str = '', account: Account | None = None,
                 source: Source | None = None) -> None:
        self._pieces, self.source, self.account = pieces, source, account
        self.on_rotors, self._interpolation, self._where = on_rotors, interpolation, where
        self.piece = next(pieces)

    @property
    def end_ns(self) -> int | None:
        """Return the stamp at which the next piece takes over; None if this is the last piece."""
        return None if self.piece.stop is None else int(self.piece.times_ns[self.piece.stop])

    def advance(self) -> None:
        """
        Go to the next piece.

        Raise NotInOrderError if the next piece is in other axes, unless torques are held.
        """
        in_space, self.piece = self.piece.in_space[0], next(self._pieces)
        if self._interpolation != 'hold' and (self.piece.in_space != in_space).any():
            raise torques.NotInOrderError  # the error is raised when the whole log is read

    def log(self) -> TorqueLog:
        """
        Return the current piece as a torque log.

        Raises
        ------
        InputError
            The samples mix body axes and space axes, which only the interpolation 'hold' allows.

        """
        with located(self._where):
            return TorqueLog(*self.piece[:3], self._interpolation)


def whole(problem: Problem) -> list[Stream]:
    """Return the torques of a problem as streams, each of which is a single piece."""
    return [Stream(iter([torques.Piece(log.times_ns, log.torques, log.in_space)]),
                   log is problem.wheels, log.interpolation) for log in problem.sources]


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
            raise torques.NotInOrderError  # any error is reported when the whole recording is read
        yield starts[0], [*streams]


def _begun(path: str | Path, scene: Scene, reading: Reading,
           source: Source) -> tuple[State | None, Stream]:
    """Return the start state and the torques of a topic."""
    on_rotors = source.topic == reading.topics.wheel_torque
    start, blocks = torques.first_epoch(path, iter(reading.track(source, source.count)))
    account = Account('' if is_text_file(str(path)) else Account.advice)
    where = f'{path}: {source.topic}'

    def checked() -> Iterator[Messages]:
        for block in blocks:
            if on_rotors and not any(map(messages.is_epoch_marker, block.names)):
                check_axes(path, block, scene)
            yield block
        account.notes += source.notes
    pieces = torques.torque_pieces(where, checked(), scene.body_frame, scene.space_frame,
                                   scene.links, account)
    return start, Stream(pieces, on_rotors, reading.interpolation or scene.interpolation, where,
                         account, source)
