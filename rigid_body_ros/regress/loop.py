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

"""Read a closed loop from a recording: the torques and the states in a node's log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages, recording
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.mechanics.efforts import EffortLog, filled
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.recording import Messages
from rigid_body_ros.runtime.fingerprint import NAME

COMMITTED = 'committed'
INERTIA, COMMANDS = 'accepted_inertia', 'accepted_wheel_command'
_TORQUE = 'accepted_'


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
        states = recording.joined(source.topic, source.kind, list(source), source.damage)
        made_by = source.metadata(NAME)
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


def _samples(found: Messages, kind: messages.MessageType) -> Signal:
    if isinstance(kind, messages.JointCommands):
        log = EffortLog(found.stamps_ns, found.values)
        return Signal(log.times_ns, filled(log.efforts, np.zeros(kind.doubles)),
                      np.full(len(log), ''))
    values = found.values[:, 3:] if kind is messages.WRENCH else \
        messages.inertia_entries(found.values) if kind is messages.INERTIA else \
        np.hstack([found.values[:, messages.ORIENTATION],
                   found.values[:, messages.ANGULAR_VELOCITY]])
    order = np.argsort(found.stamps_ns, kind='stable')
    stamps_ns = found.stamps_ns[order]
    # If several torques have the same stamp, only the last of these torques acts.
    order = order[np.append(np.diff(stamps_ns) != 0, True)[:len(order)]]
    frames = np.array(found.names, np.str_)[found.frames[order]] if len(order) else \
        np.empty(0, np.str_)
    return Signal(found.stamps_ns[order], values[order], frames)
