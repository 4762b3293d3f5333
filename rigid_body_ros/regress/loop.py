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

"""A recorded closed loop: the torques that a node accepted, and the states that it committed."""

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
    The torques of a topic, the states, or another series of samples.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
        Strictly ascending times.
    values : array, shape (n, d)
        One row for each sample. A row contains a torque, N m (d = 3); a state, with attitude
        x y z w and angular velocity, rad/s, body axes (d = 7); an inertia, kg m^2 (d = 6); or the
        commands that named wheels follow, N m (one column for each wheel).
    frames : array of str, shape (n,)
        The frame of each sample.

    """

    times_ns: NDArray[np.int64]
    values: Floats
    frames: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.times_ns)

    def until(self, last_ns: int) -> Signal:
        """Return the samples up to a time."""
        kept = slice(int(np.searchsorted(self.times_ns, last_ns, 'right')))
        return Signal(self.times_ns[kept], self.values[kept], self.frames[kept])


EMPTY = Signal(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.str_))


@dataclass(frozen=True, eq=False)
class Loop:
    """
    The last epoch in the log of a node.

    Attributes
    ----------
    start : State
    torques : dict
        Torques by the name of the log, such as 'accepted_torque'.
    states : Signal
    made_by : dict
        The versions on which the last bits of the states depend, from the metadata of the
        recording.
    node : str
        The name of the node. The names of its topics begin with this name.
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
        """Return the time, ns, from the start to the last torque, for each log with torques."""
        return {name: int(samples.times_ns[-1]) - self.start.time_ns
                for name, samples in self.torques.items() if len(samples) and name != INERTIA}


def read(path: str | Path, wheels: tuple[str, ...] = ()) -> Loop:
    """
    Read the last epoch of a loop.

    Parameters
    ----------
    path : str or Path
        The recording.
    wheels : tuple of str
        The names of the wheels of the scene.

    Raises
    ------
    InputError
        The recording cannot be read, is not the complete log of one node, or contains wheels other
        than the given ones.

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
    # If several states have the start time, the last one begins the last epoch.
    rows = states.rows(slice(int(begun[-1]), None))
    return Loop(start, torques, _samples(rows, messages.ODOMETRY), made_by, node, wheels)


def committed(path: str | Path) -> str:
    """Return the topic of the states; raise InputError unless exactly one node wrote a log."""
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
    # Of torques with equal stamps, the last one acts.
    order = order[np.append(np.diff(stamps_ns) != 0, True)[:len(order)]]
    frames = np.array(found.names, np.str_)[found.frames[order]] if len(order) else \
        np.empty(0, np.str_)
    return Signal(found.stamps_ns[order], values[order], frames)
