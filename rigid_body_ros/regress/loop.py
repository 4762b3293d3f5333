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

"""Read closed loops from recordings of a node's log, and compare two loops stamp by stamp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages, recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.efforts import EffortLog, filled
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.recording import Messages
from rigid_body_ros.runtime.fingerprint import NAME, other_versions

COMMITTED = 'committed'
INERTIA, COMMANDS = 'accepted_inertia', 'accepted_wheel_command'
_TORQUE = 'accepted_'
_STATE, _STAMP = 'state', 'stamp'


@dataclass(frozen=True, eq=False)
class Signal:
    """
    A series of samples, such as the torques on one topic, or the states of the body.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
        The times of the samples, strictly ascending.
    values : array, shape (n, d)
        One row for each sample. For torques, d is 3 and the unit is N m. For states, d is 7: the
        attitude x y z w and the angular velocity, rad/s, in body axes. For inertias, d is 6 and
        the unit is kg m^2. For the commands that named wheels follow, there is one column for each
        wheel, and the unit is N m.
    frames : array of str, shape (n,)
        The frame_id of each sample.

    """

    times_ns: NDArray[np.int64]
    values: Floats
    frames: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.times_ns)

    def until(self, last_ns: int) -> Signal:
        """Return the samples up to and including the given time."""
        kept = slice(int(np.searchsorted(self.times_ns, last_ns, 'right')))
        return Signal(self.times_ns[kept], self.values[kept], self.frames[kept])


EMPTY = Signal(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.str_))


@dataclass(frozen=True, eq=False)
class Loop:
    """
    A closed loop: the last epoch in the log of a node.

    Attributes
    ----------
    start : State
    torques : dict
        The torques in each log, keyed by the name of the log, such as 'accepted_torque'.
    states : Signal
    made_by : dict
        The software versions that the last bits of the states depend on, as stored in the metadata
        of the recording.
    node : str
        The name of the node. All of its topic names begin with this name.
    wheels : tuple of str
        The names of the wheels.

    """

    start: State
    torques: Mapping[str, Signal]
    states: Signal
    made_by: Mapping[str, str]
    node: str
    wheels: tuple[str, ...] = ()

    @property
    def spans_ns(self) -> dict[str, int]:
        """For each log that has torques, return the time from the start to the last torque, ns."""
        return {name: int(samples.times_ns[-1]) - self.start.time_ns
                for name, samples in self.torques.items() if len(samples) and name != INERTIA}


def read(path: str | Path, wheels: tuple[str, ...] = ()) -> Loop:
    """
    Read the last epoch of a closed loop from a recording.

    Parameters
    ----------
    path : str or Path
        The recording.
    wheels : tuple of str
        The names of the wheels in the scene.

    Raises
    ------
    InputError
        The recording cannot be read, does not contain the complete log of exactly one node, or
        contains wheels that are not in `wheels`.

    """
    log = committed(path)
    node = log.rpartition('/')[0]
    with recording.Source(path, log, [messages.ODOMETRY]) as source:
        states, made_by = source.read(), source.metadata(NAME)
    torques, start = {}, None
    for kind in (messages.WRENCH, messages.INERTIA, messages.joint_commands(wheels)):
        for topic in recording.topics(path, [kind]):
            name = topic.removeprefix(f'{node}/')
            if name == COMMANDS and not wheels:
                raise InputError(f'{path}: {topic}: expected wheel_names in the scene, found none')
            if name.startswith(_TORQUE):
                last = recording.epochs(path, recording.read(path, topic, kind))[-1]
                torques[name], start = _samples(last, kind), last.start or start
    if start is None or not any(map(len, torques.values())):
        raise InputError(f'{path}: expected torques that {node} accepted, found none; write a '
                         'reference with --update')
    begun = np.flatnonzero(states.stamps_ns == start.time_ns)
    if not begun.size:
        raise InputError(f'{path}: {log}: expected the start state at {start.time_ns} ns, '
                         'found none: a part of the recording is missing')
    # Earlier epochs may have had the same start time. The last state at this time begins the last
    # epoch.
    rows = states.rows(slice(int(begun[-1]), None))
    return Loop(start, torques, _samples(rows, messages.ODOMETRY), made_by, node, wheels)


def committed(path: str | Path) -> str:
    """
    Return the topic of the committed states.

    Raise InputError unless the recording contains the log of exactly one node.
    """
    logs = [topic for topic in recording.topics(path, [messages.ODOMETRY])
            if topic.rpartition('/')[2] == COMMITTED]
    if len(logs) != 1:
        raise InputError(f'{path}: expected the log of one node, with its topics accepted_torque '
                         f'and committed, found {listed(logs)}; --update writes one to a new file')
    return logs[0]


def _samples(recorded: Messages, kind: messages.MessageType) -> Signal:
    if isinstance(kind, messages.JointCommands):
        log = EffortLog(recorded.stamps_ns, recorded.values)
        return Signal(log.times_ns, filled(log.efforts, np.zeros(kind.doubles)),
                      np.full(len(log), ''))
    values = recorded.values[:, 3:] if kind is messages.WRENCH else \
        messages.inertia_entries(recorded.values) if kind is messages.INERTIA else \
        np.hstack([recorded.values[:, messages.ORIENTATION],
                   recorded.values[:, messages.ANGULAR_VELOCITY]])
    # If several torques have the same stamp, only the last of these torques acts.
    stamps_ns, from_end = np.unique(recorded.stamps_ns[::-1], return_index=True)
    order = len(recorded.stamps_ns) - 1 - from_end
    frames = np.array(recorded.names, np.str_)[recorded.frames[order]]
    return Signal(stamps_ns, values[order], frames)


@dataclass(frozen=True, eq=False)
class Differences:
    """
    How a closed loop differs from a reference.

    Attributes
    ----------
    torques, states : int
        The number of torques and the number of states that were compared: those whose stamps occur
        in both loops.
    same_torques, same_states : int
        The number of compared torques, and of compared states, that agree in every bit.
    first_ns : int, optional
        The first stamp where the loops differ, either because some bits are different or because
        the stamp occurs in only one loop. None if all bits are equal.
    first : str
        What differs at `first_ns`: the name of a torque log; 'state'; or 'stamp', if the stamp
        occurs in only one loop. Empty if nothing differs.
    missing : int
        The number of stamps that occur in only one of the two loops.
    torque, attitude, rate : float, optional
        The largest differences between the torques (N m), the attitudes (rad) and the angular
        velocities (rad/s) of the two loops. None if the loops have no stamps in common.
    start_ns, end_ns : int
        The times of the start and of the last state of the reference.
    versions : dict
        For each package whose version has changed, the version that made the reference and the
        version in use now.

    """

    torques: int
    states: int
    same_torques: int
    same_states: int
    first_ns: int | None
    first: str
    missing: int
    torque: float | None
    attitude: float | None
    rate: float | None
    start_ns: int
    end_ns: int
    versions: dict[str, tuple[str, str]]

    @property
    def equal(self) -> bool:
        """Return whether all bits are equal."""
        return self.first_ns is None

    def within(self, tolerance: float | None) -> bool:
        """
        Return whether the loops agree. Without a tolerance, all bits must be equal.

        The tolerance is the largest angle by which attitudes may differ, rad. Stamps must be equal
        even if there is a tolerance.
        """
        if self.equal or tolerance is None:
            return self.equal
        return not self.missing and self.attitude is not None and self.attitude <= tolerance

    def rows(self) -> list[tuple[str, str]]:
        """Return the differences as rows to print, each with a name and a text."""
        span = (self.end_ns - self.start_ns) * 1e-9
        rows = [('compared', f'{self.torques} torques and {self.states} states over {span:.9g} '
                 's of the loop'),
                ('same bits', f'{self.same_torques} of {self.torques} torques, '
                 f'{self.same_states} of {self.states} states')]
        if self.missing:
            rows.append(('stamps', f'{self.missing} are those of one of the two loops only'))
        if self.first_ns is not None:
            rows.append(('first', f'{self._cause} at {self.first_ns} ns, '
                         f'{(self.first_ns - self.start_ns) * 1e-9:.9g} s after the start'))
        if self.attitude is not None:
            torque = '' if self.torque is None else f'torque {self.torque:.2g} N m, '
            rows.append(('largest', f'{torque}attitude {self.attitude:.2g} rad, rate '
                         f'{self.rate:.2g} rad/s'))
        return rows if self.equal else rows + [
            ('made by', f'{name} {there}, here {here}: the last bits may differ')
            for name, (there, here) in self.versions.items()]

    @property
    def _cause(self) -> str:
        if self.first == _STATE:
            return 'the state, so the scene or the package differs,'
        if self.first == _STAMP:
            return 'a stamp that only one of the two loops has,'
        log = self.first.removeprefix('accepted_').replace('_', ' ')
        return f'the {log} at equal states, so the controller differs,'

    def as_dict(self) -> dict[str, Any]:
        """Return the differences as a dictionary of JSON types; the keys contain the units."""
        return {'torques': self.torques, 'states': self.states,
                'first_difference_ns': self.first_ns,
                'largest': {'torque_N_m': self.torque, 'attitude_rad': self.attitude,
                            'rate_rad_s': self.rate}}


def differences(reference: Loop, loop: Loop) -> Differences:
    """Compare a loop with a reference, up to the last state of the reference."""
    last_ns = int(reference.states.times_ns[-1])
    pairs = {name: Pair.of(reference.torques.get(name, EMPTY).until(last_ns),
                           loop.torques.get(name, EMPTY).until(last_ns))
             for name in {**reference.torques, **loop.torques}}
    states = Pair.of(reference.states, loop.states.until(last_ns))
    # If a state and a torque differ at the same stamp, report the state, because the controller
    # computes the torque from this state.
    every = {_STATE: states, **pairs}
    first = {name: pair.first_ns for name, pair in every.items() if pair.first_ns is not None}
    name = min(first, key=first.__getitem__, default='')
    torques = [_largest(pair.reference - pair.loop) for key, pair in pairs.items()
               if key != INERTIA and len(pair.same)]
    angles = so3.angle_between(states.reference[:, :4], states.loop[:, :4])
    first_ns = first.get(name)
    if name and first_ns in every[name].missing_ns:
        name = _STAMP
    return Differences(
        torques=sum(len(pair.same) for pair in pairs.values()), states=len(states.same),
        same_torques=sum(int(pair.same.sum()) for pair in pairs.values()),
        same_states=int(states.same.sum()), first_ns=first_ns, first=name,
        missing=sum(len(pair.missing_ns) for pair in every.values()),
        torque=max(torques, default=None),
        attitude=float(angles.max()) if len(angles) else None,
        rate=_largest((states.reference - states.loop)[:, 4:]) if len(angles) else None,
        start_ns=reference.start.time_ns, end_ns=last_ns,
        versions=other_versions(reference.made_by))


@dataclass(frozen=True, eq=False)
class Pair:
    """The values of two series at their common stamps, and the first stamp where they differ."""

    times_ns: NDArray[np.int64]
    reference: Floats
    loop: Floats
    same: NDArray[np.bool_]
    missing_ns: NDArray[np.int64]
    first_ns: int | None

    @classmethod
    def of(cls, reference: Signal, loop: Signal) -> Pair:
        """Pair the values of two series by their stamps."""
        times_ns, rows, others = np.intersect1d(
            reference.times_ns, loop.times_ns, assume_unique=True, return_indices=True)
        values, loop_values = reference.values[rows], loop.values[others]
        if not times_ns.size:  # one series may be `EMPTY`, with a different number of columns
            loop_values = values
        same = recording.same_bits(values, loop_values)
        same &= reference.frames[rows] == loop.frames[others]
        missing_ns = np.setxor1d(reference.times_ns, loop.times_ns, assume_unique=True)
        differing_ns = np.concatenate([times_ns[~same], missing_ns])
        return cls(times_ns, values, loop_values, same, missing_ns,
                   int(differing_ns.min()) if differing_ns.size else None)


def _largest(errors: Floats) -> float:
    return float(np.linalg.norm(errors, axis=1).max())
