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

"""Recompute a recorded motion, and compare the result with the recording."""

from __future__ import annotations

from bisect import bisect
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages, recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, located
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.recording import Logged, Reading, Source, Topics
from rigid_body_ros.report.text import lines
from rigid_body_ros.runtime.fingerprint import NAME, other_versions
from rigid_body_ros.runtime.terminal import progress
from rigid_body_ros.scene import Scene

#: The message types of a node's states and of a replay's attitude.
_KINDS = (messages.ODOMETRY, messages.QUATERNION)
#: A node's first attitude counts as the scene's initial attitude if the angle between them is at
#: most this, rad.
_SAME_START = 1e-6


@dataclass(frozen=True, eq=False)
class Verified:
    """
    How well a recorded motion agrees with the motion recomputed from the recorded torques.

    Attributes
    ----------
    topic : str
    stamps_ns : array of int64, shape (n,)
    same : array of bool, shape (n,)
        Whether the recorded and computed states are equal in every bit.
    angles : array, shape (n,), rad
        The angle between the recorded and computed attitudes.
    versions : dict
        For each package whose version has changed: the version that made the recording, and the
        version in use now.
    epochs : int
        The number of epochs, if the torques are a node's log; otherwise 0.
    compared_epochs : int
        The number of epochs for which at least one state was recorded.
    pending : int
        The number of torque stamps for which there is no committed state.

    """

    topic: str
    stamps_ns: NDArray[np.int64]
    same: NDArray[np.bool_]
    angles: Floats
    versions: dict[str, tuple[str, str]]
    epochs: int = 0
    compared_epochs: int = 0
    pending: int = 0

    def text(self) -> str:
        """Return a text that says how well the two motions agree, with one fact per line."""
        count, part, pending = len(self.same), '', ''
        if self.epochs:
            compared = '' if self.compared_epochs == self.epochs else f'{self.compared_epochs} of '
            part = f' in {compared}{self.epochs} epoch{"s" * (self.epochs > 1)}'
        if self.pending:
            has = ' has' if self.pending == 1 else 's have'
            pending = f'; {self.pending} torque{has} no committed state'
        rows = [('compared', f'{count} states of {self.topic}{part}{pending}'),
                ('same bits', f'{np.count_nonzero(self.same)} of {count}'),
                ('difference', f'at most {self.angles.max():.2g} rad')]
        if not self.same.all():
            row = int(np.argmin(self.same))
            rows.append(('', f'first in state {row + 1}, at {self.stamps_ns[row]} ns: '
                             f'{self.angles[row]:.2g} rad'))
        rows += [('made by', f'{name} {there}, here {here}: the last bits may differ')
                 for name, (there, here) in self.versions.items()]
        return lines(f'{name:14}{text}' for name, text in rows)

    __str__ = text


def verify(path: str | Path, scene: Scene, motion_path: str | Path,
           topics: Topics | None = None, *, motion_topic: str | None = None,
           interpolation: str | None = None, until: float | None = None) -> Verified:
    """
    Recompute a recorded motion, and compare the result with the recording.

    If the motion was recorded by a node, all of its epochs are compared.

    Parameters
    ----------
    path : str or Path
        The recording of the torques, such as a node's accepted_torque.
    scene : Scene
        The scene with which the motion was recorded. Every bit of the motion depends on the
        options and the initial state in the scene. If the torques are a node's log, the start
        states in the log are used in place of the initial state.
    motion_path : str or Path
        The recording of the motion: the committed states of a node, or the attitude of a replay.
    topics : Topics, optional
        The topics from which to read torques; by default, the torque topics of the scene.
    motion_topic : str, optional
        The topic of the motion. By default, it is the topic with the committed states of the node
        that logged the torques. You have to name the topic if the recording of the motion does not
        contain these states but has several topics of a suitable type.
    interpolation : str, optional
        How to interpolate between samples; by default, as the scene specifies.
    until : float, optional, s
        Compare only the states in the first `until` seconds of the motion or of each epoch.

    Returns
    -------
    Verified

    Raises
    ------
    InputError
        A recording cannot be read, does not match the scene, or contains no states after the
        start; or a committed state has no torque in the log.
    ValueError
        `until` is negative or longer than 1e9 s.

    """
    topics = topics or Topics()
    epochs = recording.read_epochs(path, scene, Reading(
        topics=topics.found_in(path, scene), interpolation=interpolation,
        track=progress('reading', size=len)))
    # Prefer the committed states, because a recording of all of a node's topics has other outputs
    # as well.
    log = next(iter(topics.torques), topics.wheel_command)
    committed = f'{log.rpartition("/")[0]}/committed' if log else ''
    until_ns = messages.LAST_NS if until is None else duration_ns(until, 'until')
    with Source(motion_path, motion_topic, _KINDS, preferred=committed) as source:
        recorded, made_by = source.read(), source.metadata(NAME)
    is_state = source.kind is messages.ODOMETRY
    values = np.hstack([recorded.values[:, messages.ORIENTATION],
                        recorded.values[:, messages.ANGULAR_VELOCITY]]) \
        if is_state else recorded.values
    parts = []
    with located(f'{motion_path}: {source.topic}', InputError):
        for epoch, rows in zip(epochs, _rows(epochs, recorded.stamps_ns, values)):
            parts.append(_until(epoch.problem.start.time_ns + until_ns, recorded.stamps_ns[rows],
                                values[rows]))
            if is_state:
                _check_torques(epoch, parts[-1][0])
    same, angles = map(np.concatenate, zip(*(
        _compared(path, epoch, *part) for epoch, part in zip(epochs, parts))))
    stamps_ns = [stamps for stamps, _ in parts]
    result = Verified(source.topic, np.concatenate(stamps_ns), same, angles,
                      other_versions(made_by))
    if not epochs[0].is_epoch:
        return result
    pending = [_pending(*part, until_ns) for part in zip(epochs, stamps_ns)]
    return replace(result, epochs=len(epochs), pending=sum(pending) if is_state else 0,
                   compared_epochs=sum(stamps.size > 0 for stamps in stamps_ns))


def _rows(epochs: Sequence[Logged], stamps_ns: NDArray[np.int64], values: Floats) -> list[slice]:
    """
    For each epoch, return the rows of a recorded motion that belong to that epoch.

    `values` contains attitudes, shape (n, 4), or a node's attitudes and body rates, shape (n, 7).
    """
    if not stamps_ns.size:
        raise InputError('expected states, found no messages')
    start, is_state = epochs[0].problem.start, values.shape[1] > 4
    if epochs[0].is_epoch:
        return _rows_of_epochs([epoch.problem.start for epoch in epochs], stamps_ns, values)
    # A node marks the start of each epoch. If there are no markers, the motion starts with the
    # last state at the start time.
    begun = np.flatnonzero(stamps_ns == start.time_ns)
    first = int(begun[-1]) if is_state and begun.size else 0
    _check_begins(start, epochs[0].times_ns, stamps_ns[first:])
    if is_state:
        _check_start(start, stamps_ns[first:], values[first, :4])
    return [slice(first, None)]


def _rows_of_epochs(starts: Sequence[State], stamps_ns: NDArray[np.int64],
                    values: Floats) -> list[slice]:
    """
    Return the rows that belong to each epoch of a recorded motion.

    The first row of an epoch is its start state. If the node was killed before any state was
    recorded, the epoch has no rows.

    Parameters
    ----------
    starts : sequence of State
        The start states of the epochs.
    stamps_ns : array of int64, shape (n,)
        The stamps of the recorded states, which ascend within an epoch.
    values : array, shape (n, 4) or (n, 7)
        The attitudes, each followed by the body rates, rad/s, if these are recorded.

    Raises
    ------
    InputError
        The recording does not begin with the start state of an epoch; or a stamp is not later
        than the one before, although no epoch starts there.

    """
    numbers: dict[tuple[int, bytes], list[int]] = {}
    for number, start in enumerate(starts):
        doubles = np.hstack([start.attitude, start.angular_velocity])[:values.shape[1]]
        numbers.setdefault((start.time_ns, doubles.tobytes()), []).append(number)
    restarts = np.append(True, np.diff(stamps_ns) <= 0)
    possible = np.flatnonzero(restarts | np.isin(stamps_ns, [start.time_ns for start in starts]))
    states = [(int(stamps_ns[row]), values[row].tobytes()) for row in possible]
    left, begun = Counter(states), list[tuple[int, int]]()
    for row, state in zip(possible.tolist(), states):
        left[state] -= 1
        same = numbers.get(state, [])
        following = same[bisect(same, begun[-1][0] if begun else -1):]
        # A state in the current epoch may happen to equal the start state of a later epoch.
        if following and (restarts[row] or left[state] < len(following)):
            begun.append((following[0], row))
        elif restarts[row]:
            raise InputError(_not_a_start(row, stamps_ns))
    ends = [*(row for _, row in begun[1:]), len(stamps_ns)]
    rows = {number: slice(row, end) for (number, row), end in zip(begun, ends)}
    return [rows.get(number, slice(0)) for number in range(len(starts))]


def _not_a_start(row: int, stamps_ns: NDArray[np.int64]) -> str:
    where = f'expected the start state of an epoch of the torque log in message {row + 1}'
    if not row:
        return f'{where}, found another state, at {stamps_ns[0]} ns: the recording began in the ' \
               'middle of an epoch, or is not that of this log'
    return f'{where}, because its stamp, {stamps_ns[row]} ns, is not later than the one before, ' \
           f'{stamps_ns[row - 1]} ns; found another state: the recording is not that of this ' \
           'log, or a part is missing'


def _until(end_ns: int, stamps_ns: NDArray[np.int64],
           values: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the states up to `end_ns`; raise InputError if all states are after that time."""
    chosen = stamps_ns <= end_ns
    if stamps_ns.size and not chosen.any():
        raise InputError(f'expected states up to --until, at {end_ns} ns, found the first at '
                         f'{stamps_ns.min()} ns')
    return stamps_ns[chosen], values[chosen]


def _compared(path: str | Path, epoch: Logged, stamps_ns: NDArray[np.int64],
              values: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """
    Compare recorded states with computed states.

    For each recorded state and the computed state at the same time, return whether the two are
    equal in every bit, and the angle between their attitudes, rad.
    """
    with located(path):
        motion = epoch.problem.propagate(at=stamps_ns)
    expected = np.hstack([motion.attitude, motion.angular_velocity])[:, :values.shape[1]]
    return recording.same_bits(values, expected), so3.angle_between(values[:, :4], motion.attitude)


def _pending(epoch: Logged, stamps_ns: NDArray[np.int64], until_ns: int) -> int:
    """Count the torque stamps, up to `until_ns` after the start, that have no committed state."""
    start_ns, times = epoch.problem.start.time_ns, epoch.times_ns
    due = times[(times > start_ns) & (times <= start_ns + until_ns)]
    return len(np.setdiff1d(due, stamps_ns))


def _check_begins(start: State, torques_ns: NDArray[np.int64],
                  stamps_ns: NDArray[np.int64]) -> None:
    """Raise InputError if a recorded motion begins before its torques."""
    first_ns, torque_ns = int(stamps_ns.min()), int(torques_ns[0])
    if first_ns >= start.time_ns:
        return
    if start.time_ns == torque_ns:
        raise InputError(
            f'expected the first state at or after the first torque, {torque_ns} ns, found it at '
            f'{first_ns} ns: the beginning of the torque log or the start_time of the scene is '
            'missing')
    raise InputError('expected the first state at or after the start_time of the scene, '
                     f'{start.time_ns} ns, found it at {first_ns} ns')


def _check_start(start: State, stamps_ns: NDArray[np.int64], first: Floats) -> None:
    """Raise InputError unless a node's first committed state is the start state."""
    late = 'the recorder started late, or the scene or its start_time is not that of the run'
    if start.time_ns not in stamps_ns:
        raise InputError(f'expected the first state at the start of the motion, {start.time_ns} '
                         f'ns, found it at {stamps_ns.min()} ns: {late}')
    angle = float(so3.angle_between(first, start.attitude))
    if angle > _SAME_START:
        raise InputError(f'expected the initial attitude of the scene at {start.time_ns} ns, '
                         f'found an attitude {angle:.2g} rad away: {late}')


def _check_torques(epoch: Logged, stamps_ns: NDArray[np.int64]) -> None:
    """
    Raise InputError if there is no torque at the stamp of a committed state.

    A node first commits the start state of an epoch. After that, it commits the state at each
    torque that it has accepted.
    """
    torques_ns = epoch.times_ns
    missing = np.setdiff1d(stamps_ns, np.append(torques_ns, epoch.problem.start.time_ns))
    if missing.size:
        where = 'the beginning' if missing[0] < torques_ns[0] else 'a part'
        raise InputError(
            f'expected a torque at the stamp of each state, found none for {missing.size} of '
            f'{stamps_ns.size} states, the first at {missing[0]} ns: {where} of the torque log is '
            'missing')
