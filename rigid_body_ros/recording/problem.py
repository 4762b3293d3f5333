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

"""Combine a recording and a scene into problems: one for each epoch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed, quoted
from rigid_body_ros.mechanics.changes import BodyLog
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import stamps_of, TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording import source
from rigid_body_ros.recording.account import Account, merged
from rigid_body_ros.recording.selection import Topics
from rigid_body_ros.recording.source import Messages
from rigid_body_ros.recording.text_files import is_text_file
from rigid_body_ros.recording.torques import check_stamped, epochs, torque_log
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.scene import load, Scene

#: Two rotor momenta count as equal if their relative difference is at most this.
_SAME_MOMENTUM = 1e-6


class Logged(NamedTuple):
    """The problem that a recording or an epoch of a node describes, and how it was recorded."""

    problem: Problem
    #: Whether the rotor torque is derived from the measured rotor momentum. A rotor torque that is
    #: derived in this way is never interpolated.
    is_measured: bool
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
    topics = Topics.given(topic, wheel_torque, wheel_momentum, inertia, wheel_command,
                          columns).found_in(path, loaded)
    return chosen(path, loaded, read_epochs(path, loaded, topics, interpolation,
                                            time_source=time_source), may_change=True).problem


def read_epochs(path: str | Path, scene: Scene, topics: Topics, interpolation: str | None = None,
                track: Track = no_progress, time_source: str = 'header',
                skip: float = 0.0) -> list[Logged]:
    """
    Read the problem of a recording, or of each epoch if a node made the recording.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : Scene
        The body, the names of the frames, and the initial state.
    topics : Topics
        The topics to read, as `Topics.found_in` returns them.
    interpolation : str, optional
        How to interpolate between samples; by default, as the scene specifies.
    track : callable
        Wraps the iteration over blocks of messages, to show progress.
    time_source, skip
        See `recording.read` and `started`.

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
    torques = [source.read(path, name, topics.kinds(name), track, time_source, topics.preferred,
                           topics.columns)
               for name in topics.wrenches]
    momentum = source.read(path, topics.wheel_momentum, messages.VECTOR3, track, time_source) \
        if topics.wheel_momentum else None
    if topics.inertia:
        torques.append(source.read(path, topics.inertia, messages.INERTIA, track, time_source))
    if topics.wheel_command:
        kind = messages.joint_commands([wheel.name for wheel in scene.named_wheels])
        torques.append(source.read(path, topics.wheel_command, kind, track, time_source))
    found = aligned(path, [epochs(path, one) for one in torques], time_source == 'header')
    if momentum is not None and len(found) > 1:
        raise InputError(f'{path}: --wheel-momentum: expected one epoch, found {len(found)}')
    return [_logged(path, scene, topics, parts, momentum, interpolation or scene.interpolation,
                    skip)
            for parts in found]


def chosen(path: str | Path, scene: Scene, found: Sequence[Logged],
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
    stamps_ns = [each.problem.start.time_ns for each in found]
    start_ns = scene.start.time_ns
    if len(stamps_ns) > 1 and start_ns not in stamps_ns:
        raise InputError(f'{path}: expected one epoch, or the start_time of one, found '
                         f'{len(stamps_ns)} epochs, which begin at '
                         f'{listed([str(stamp) for stamp in stamps_ns])} ns, and start_time '
                         f'{start_ns}; set start_time in the scene')
    one = found[len(found) - 1 - stamps_ns[::-1].index(start_ns) if len(found) > 1 else 0]
    if one.problem.changes and not may_change:
        raise InputError(f'{path}: expected a body that does not change, found '
                         f'{len(one.problem.changes)} changes of its inertia, which only '
                         'attitude_replay computes; set inertia_topic: false in the scene')
    return one


def _logged(path: str | Path, scene: Scene, topics: Topics, parts: Sequence[Messages],
            momentum: Messages | None, interpolation: str, skip: float) -> Logged:
    """
    Return the problem of one epoch.

    `parts` contains the messages of each topic that is read: first the torques on the body, then
    the rotor torque, the inertia and the commands to named wheels, in this order.
    """
    body, measured, wheels = [*parts], None, None
    every = [*parts, *([] if momentum is None else [momentum])]
    advice = '' if is_text_file(str(path)) else Account.advice
    accounts = {one.topic: Account(advice) for one in every}
    efforts = _efforts(path, body.pop()) if topics.wheel_command else None
    changes = _changes(path, body.pop(), scene) if topics.inertia else None
    if topics.wheel_torque:
        check_axes(path, body[-1], scene)
        wheels = _log(path, body.pop(), scene, interpolation, accounts)
    actuators = topics.actuators(scene)
    logs = [_log(path, one, scene, 'hold' if held else interpolation, accounts)
            for one, held in zip(body, actuators or (None,) * len(body))]
    if momentum is not None:
        measured = _momentum(path, momentum, scene)
        wheels = _from_momentum(path, momentum, measured, scene)
    damage = '; '.join(dict.fromkeys(one.damage for one in every if one.damage))
    stamps_ns = stamps_of([*logs, *([wheels] if wheels else [])])
    if efforts:
        stamps_ns = np.union1d(stamps_ns, efforts.times_ns)
    begin = next((one.start for one in parts if one.start), None)
    if not stamps_ns.size and not begin:
        lost = f' ({damage})' if damage else ''
        raise InputError(f'{path}: {listed([one.topic for one in every])}: expected torques, '
                         f'found no messages{lost}')
    first_ns = int(stamps_ns[0]) if stamps_ns.size else 0
    start = started(path, scene, begin, first_ns, skip)
    if measured is not None:
        start = _started(start, measured)
    try:
        problem = scene.problem(start).replaced(
            log=logs, wheels=wheels, changes=changes, efforts=efforts, actuator=actuators)
        if skip:  # an actuator lags from its first command, not from the start
            problem = problem.replaced(start=replace(start, time_ns=first_ns)).replaced(
                start=start)
    except ValueError as error:
        raise InputError(f'{path}: {listed([one.topic for one in every])}: {error}') from error
    for one in every:
        if accounts[one.topic].samples < len(one):  # not a torque
            accounts[one.topic].add(one.stamps_ns)
    return Logged(problem, measured is not None, merged(accounts), begin is not None, damage,
                  tuple(accounts))


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
    one, other = ((state.time_ns if has_stamps else 0, state.attitude.tobytes(),
                   state.angular_velocity.tobytes(), state.rotor_momentum.tobytes(),
                   state.wheel_speeds.tobytes())
                  if (state := found.start) else None for found in (part, expected))
    if one != other:
        found = f'the epoch that begins at {part.start.time_ns} ns' if part.start else \
            'torques without epochs'
        assert expected.start
        raise InputError(f'{path}: {part.topic}: expected the epoch that begins at '
                         f'{expected.start.time_ns} ns, with the same start state as on '
                         f'{expected.topic}, found {found}')


def _log(path: str | Path, recorded: Messages, scene: Scene, interpolation: str,
         accounts: Mapping[str, Account]) -> TorqueLog:
    """Return the torque log of a topic; the log is empty if there are no messages."""
    if not len(recorded):
        return TorqueLog([], [], interpolation=interpolation)
    return torque_log(path, recorded, scene.body_frame, scene.space_frame, interpolation,
                      scene.links, accounts[recorded.topic])


def _efforts(path: str | Path, recorded: Messages) -> EffortLog:
    """
    Return the wheel commands on a topic, in the order of the wheels.

    The frame_ids of the commands are ignored.
    """
    if len(recorded) and not recorded.start:
        check_stamped(f'{path}: {recorded.topic}', recorded.stamps_ns)
    return EffortLog(recorded.stamps_ns, recorded.values)


def _changes(path: str | Path, recorded: Messages, scene: Scene) -> BodyLog:
    """Return the bodies that an inertia topic describes; all have the damping of the scene."""
    check_axes(path, recorded, scene)
    if len(recorded) and not recorded.start:
        check_stamped(f'{path}: {recorded.topic}', recorded.stamps_ns)
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


def _momentum(path: str | Path, recorded: Messages, scene: Scene) -> TorqueLog:
    """Return the measured rotor momenta, N m s, as a log with linear interpolation."""
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
    return TorqueLog(recorded.stamps_ns, recorded.values, interpolation='linear')


def _from_momentum(path: str | Path, recorded: Messages, measured: TorqueLog,
                   scene: Scene) -> TorqueLog:
    where = f'{path}: {recorded.topic}'
    longest = int(np.diff(measured.times_ns).max(initial=0))
    if 0 < scene.timeout_ns < longest:
        raise InputError(f'{where}: expected samples at most torque_timeout '
                         f'({scene.torque_timeout} s) apart, found a gap of '
                         f'{longest * 1e-9:.9g} s')
    try:
        return TorqueLog.from_momentum(measured.times_ns, measured.torques)
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error


def _started(start: State, measured: TorqueLog) -> State:
    """
    Return the start state with the measured rotor momentum.

    The momentum is taken from the measurements at the start time. If the measurements begin later,
    the momentum of their first sample is used.
    """
    time_ns = max(start.time_ns, int(measured.times_ns[0]))
    momentum: Floats = measured.at([time_ns])[0][0]
    given = start.rotor_momentum
    if given.any() and np.linalg.norm(given - momentum) > _SAME_MOMENTUM * np.linalg.norm(given):
        raise InputError(f'initial_rotor_momentum: expected {momentum.tolist()} N m s as '
                         f'measured at the start, or no value, found {given.tolist()}')
    return replace(start, rotor_momentum=momentum)
