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

"""The efforts applied to named wheels, and the resulting momenta."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine import Friction, state_layout, Sums
from rigid_body_ros.mechanics.efforts import EffortLog, filled
from rigid_body_ros.mechanics.fields import Field, GravityGradient
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.mechanics.wheels import Axial, Wheels
from rigid_body_ros.propagation.sources import momentum_at, summed

_NO_TIMES = np.empty(0, np.int64)
_NO_OUTPUTS, _NO_EVENTS = np.empty((0, 0)), np.empty((0, 4), np.int64)


class Commands(NamedTuple):
    """
    The newest command of each named wheel: its stamp, ns, and its effort, N m.

    The stamp of a wheel without a command is -NEVER_NS.
    """

    stamps_ns: tuple[int, ...]
    efforts: tuple[float, ...]

    @classmethod
    def none(cls, count: int) -> Commands:
        """Return the commands of wheels that have not received any."""
        return cls((-NEVER_NS,) * count, (0.0,) * count)

    @classmethod
    def of(cls, log: EffortLog, after_ns: int, until_ns: int) -> Commands:
        """Return the newest of the commands with stamps in (after_ns, until_ns]."""
        rows = slice(*log.times_ns.searchsorted([after_ns, until_ns], 'right'))
        stamps_ns, efforts = np.append(-NEVER_NS, log.times_ns[rows]), log.efforts[rows]
        efforts = np.concatenate([np.zeros((1, efforts.shape[1])), efforts])
        newest = np.where(np.isnan(efforts), 0, np.arange(len(efforts))[:, None]).max(axis=0)
        return cls(tuple(stamps_ns[newest].tolist()),
                   tuple(efforts[newest, np.arange(len(newest))].tolist()))

    @property
    def stamp_ns(self) -> int:
        """Return the latest stamp of all commands, ns, or -NEVER_NS before the first command."""
        return max(self.stamps_ns, default=-NEVER_NS)

    def taking(self, time_ns: int, row: Floats) -> Commands:
        """
        Return the commands that are in force once a new row has been received.

        A wheel keeps its command if that command is newer than the row.
        """
        pairs = [(time_ns, effort) if effort == effort and stamp_ns <= time_ns
                 else (stamp_ns, old) for stamp_ns, old, effort in zip(
                     self.stamps_ns, self.efforts, row.tolist())]
        stamps_ns, efforts = zip(*pairs)
        return Commands(stamps_ns, efforts)


class WheelTimeline:
    """
    The commands of the wheels, and without coupling to the motion their momenta, from a time on.

    Parameters
    ----------
    wheels : Wheels
    axial : Axial
        The state of the wheels at the start time.
    log : EffortLog, optional
        The commands. Those up to the start time have already taken effect.
    timeout_ns : int
        See `TorqueLog.segments`.
    start_ns : int
        The start time, ns.

    Attributes
    ----------
    times_ns : array of int64, shape (n,), ns
        The stamps of the commands after the start time.

    """

    def __init__(self, wheels: Wheels, axial: Axial, log: EffortLog | None, timeout_ns: int,
                 start_ns: int) -> None:
        self.wheels, self._axial, self._timeout_ns = wheels, axial, timeout_ns
        self.times_ns, commands = _NO_TIMES, np.empty((0, len(wheels)))
        if log:
            first = int(log.times_ns.searchsorted(start_ns, 'right'))
            self.times_ns, commands = log.times_ns[first:], log.efforts[first:]
        #: The stamps and efforts of the commands in force at the start time or later.
        self._held = self.times_ns, filled(wheels.clipped(commands), axial.commanded)
        if axial.stamp_ns > -NEVER_NS:
            self._held = (np.append(axial.stamp_ns, self.times_ns),
                          np.concatenate([axial.commanded[None], self._held[1]]))

    @property
    def marks_ns(self) -> NDArray[np.int64]:
        """Return the times at which the efforts of the wheels change, ns, ascending."""
        return self.log.segments(self._timeout_ns)[0] if self.log else _NO_TIMES

    @property
    def log(self) -> TorqueLog | None:
        """Return the total motor torque on the wheels, or None if there are no commands."""
        times_ns, efforts = self._held
        return TorqueLog(times_ns, self.wheels.torque(efforts)) if len(times_ns) else None

    @cached_property
    def _groups(self) -> list[Sums]:
        """Return the momenta of groups of three wheels, as if these were the axes of rotors."""
        assert self._axial.momenta is not None
        times_ns, efforts = self._held
        return [summed([TorqueLog(times_ns, three)], self._axial.since_ns, before,
                       self._timeout_ns)
                for three, before in zip(_threes(efforts), _threes(self._axial.momenta))]

    def momenta(self, times_ns: NDArray[np.int64]) -> Floats:
        """
        Return the momenta of wheels that are not coupled, N m s, shape (m, 2, n).

        The second axis holds the momenta and their low-order parts.
        """
        momenta = [momentum_at(group.times_ns, group.momentum, group.motors, times_ns)
                   for group in self._groups]
        return np.concatenate(momenta, axis=2)[:, :, :len(self.wheels)]

    def efforts(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the commands in force at given times, N m, shape (m, wheels)."""
        held_ns, efforts = self._held
        rows = held_ns.searchsorted(times_ns, 'right') - 1
        applied = np.zeros((len(times_ns), len(self.wheels)))
        acts = rows >= 0
        if self._timeout_ns:
            acts[acts] = times_ns[acts] - held_ns[rows[acts]] < self._timeout_ns
        applied[acts] = efforts[rows[acts]]
        return applied

    def axial(self, time_ns: int) -> Axial:
        """Return the state of the wheels at a time, which must not lie before the start time."""
        axial, row = self._axial, int(self.times_ns.searchsorted(time_ns, 'right')) - 1
        if row >= 0:
            stamp_ns = int(self.times_ns[row])
            axial = Axial(stamp_ns, stamp_ns, axial.momenta,
                          self._held[1][row - len(self.times_ns)])
        if 0 < self._timeout_ns <= time_ns - axial.stamp_ns:
            axial = axial._replace(since_ns=max(axial.since_ns, axial.stamp_ns + self._timeout_ns),
                                   is_silent=True)
        momenta = None if axial.momenta is None else self.momenta(np.array([axial.since_ns]))[0]
        return axial._replace(momenta=momenta)


def joined_log(timelines: Sequence[WheelTimeline]) -> TorqueLog:
    """Return the total motor torque on the wheels over consecutive timelines."""
    logs = [log for timeline in timelines if (log := timeline.log)]
    # If two timelines contain the same stamp, TorqueLog uses the sample of the later one.
    return TorqueLog(np.concatenate([_NO_TIMES, *(log.times_ns for log in logs)]),
                     np.concatenate([np.empty((0, 3)), *(log.torques for log in logs)]))


def without_wheels(start: State) -> State:
    """Return a start state in which rotors with the same momentum replace the named wheels."""
    if start._axial is None:
        return start
    return State(start.time_ns, start.attitude, start.angular_velocity, start.rotor_momentum)


def check_named(wheels: Wheels | None, efforts: EffortLog | None,
                fields: Sequence[Field]) -> None:
    """Raise ValueError if efforts or fields do not fit the named wheels."""
    count = len(wheels) if wheels else 0
    if efforts and efforts.efforts.shape[1] != count:
        raise ValueError(f'efforts: expected those of {count} named wheels, found those of '
                         f'{efforts.efforts.shape[1]}')
    if any(isinstance(field, GravityGradient) for field in fields):
        raise ValueError('fields: expected no gravity gradient with wheels that have names, '
                         'because the two together are not supported yet, found one')


def in_force(wheels: Wheels, before: Axial, commands: Commands, state: State,
             timeout_ns: int) -> Axial:
    """
    Return the state of the wheels once commands have taken effect or timed out.

    A command takes effect if it has the stamp of the carrier state, or if it differs from the
    command before, as at the start of a motion.

    Parameters
    ----------
    wheels : Wheels
        The wheels.
    before : Axial
        The state of the wheels before.
    commands : Commands
        The commands. A wheel without a command keeps the one before.
    state : State
        The state of the carrier.
    timeout_ns : int
        See `TorqueLog.segments`.

    """
    time_ns, stamps_ns = state.time_ns, np.array(commands.stamps_ns)
    clipped = wheels.clipped(np.array(commands.efforts))
    begins = (stamps_ns == time_ns) | ((stamps_ns > -NEVER_NS) & (clipped != before.commanded))
    stamp_ns = before.stamp_ns if commands.stamp_ns == -NEVER_NS else commands.stamp_ns
    is_silent = 0 < timeout_ns <= time_ns - stamp_ns
    if (stamp_ns, is_silent) == (before.stamp_ns, before.is_silent) and not begins.any():
        return before
    momenta = None if before.momenta is None else momenta_of(before, state)
    commanded = np.where(begins, clipped, before.commanded)
    return Axial(time_ns, stamp_ns, momenta, commanded, is_silent)


def momenta_of(axial: Axial, state: State) -> Floats:
    """Return axial momenta at a state, N m s, and their low-order parts, shape (2, n)."""
    if axial.momenta is None:
        return state_layout.momenta(state._packed)[:, :len(axial.commanded)]
    if not axial.efforts.any():
        return axial.momenta
    momenta = [momentum_at(np.array([axial.since_ns]), before[None], efforts[None],
                           np.array([state.time_ns]))[0]
               for before, efforts in zip(_threes(axial.momenta), _threes(axial.efforts[None]))]
    return np.concatenate(momenta, axis=1)[:, :len(axial.commanded)]


def coupled(wheels: Wheels, efforts: Floats) -> Friction:
    """
    Pack wheels that are coupled to the motion into a record that has room for one output.

    `efforts`, N m, has one row for each row of the record and one column for each wheel.
    """
    return with_outputs(Friction(wheels.padded(efforts), wheels.constants, _NO_OUTPUTS,
                                 _NO_EVENTS), 1, 0)


def with_outputs(friction: Friction, outputs: int, events: int) -> Friction:
    """Return a record with room for outputs and for events, of which there are none yet."""
    return friction._replace(
        momenta=np.empty((outputs, 2 * friction.efforts.shape[1])),
        events=np.zeros((1 + events, 4), np.int64))


def _threes(rows: Floats) -> list[Floats]:
    """Split the columns of an array into groups of three, and pad the last group with zeros."""
    count = rows.shape[1]
    padded = np.zeros((len(rows), count + -count % 3))  # np.pad would take ten times as long
    padded[:, :count] = rows
    return [np.ascontiguousarray(padded[:, k:k + 3]) for k in range(0, count, 3)]
