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
    The wheels from a start time onward, if they keep the speeds that decide which commands act.

    A command is refused, so that it acts as zero, if it would speed up a wheel that is too fast
    when the command takes effect. `are_wrong` tells at which commands the wheels have speeds that
    decide otherwise.

    Parameters
    ----------
    wheels : Wheels
    axial : Axial
        The state of the wheels at the start time.
    log : EffortLog, optional
        The commands. Those up to the start time have already taken effect.
    timeout_ns : int
        See `TorqueLog.segments`.
    start_ns, end_ns : int
        The start time, and the time up to which there may be commands, ns.
    speeds : array, shape (n,), rad/s
        The speeds that decide.

    Attributes
    ----------
    times_ns : array of int64, shape (n,), ns
        The stamps of the commands after the start time.

    """

    def __init__(self, wheels: Wheels, axial: Axial, log: EffortLog | None, timeout_ns: int,
                 start_ns: int, end_ns: int, speeds: Floats) -> None:
        self.wheels, self._axial, self._timeout_ns = wheels, axial, timeout_ns
        self.times_ns, commands = _NO_TIMES, np.empty((0, len(wheels)))
        if log:
            later = slice(*log.times_ns.searchsorted([start_ns, end_ns], 'right'))
            self.times_ns, commands = log.times_ns[later], log.efforts[later]
        self._begins = ~np.isnan(commands)
        self._commanded = filled(wheels.clipped(commands), axial.commanded)
        self._refused = wheels.refused(self._commanded, speeds) & self._begins
        acting = np.where(self._begins, np.where(self._refused, 0.0, self._commanded), np.nan)
        #: The stamps and efforts of the commands in force at the start time or later.
        self._held = self.times_ns, filled(acting, axial.acting)
        if axial.stamp_ns > -NEVER_NS:
            self._held = (np.append(axial.stamp_ns, self.times_ns),
                          np.concatenate([axial.acting[None], self._held[1]]))

    def are_wrong(self, rows: slice, speeds: Floats) -> NDArray[np.bool_]:
        """Return whether, at given wheel speeds, other commands in each row would be refused."""
        refused = self.wheels.refused(self._commanded[rows], speeds) & self._begins[rows]
        return np.asarray((refused != self._refused[rows]).any(axis=1))

    def count_refused(self, begin_ns: int, end_ns: int) -> int:
        """Return the number of refused commands with stamps in (begin_ns, end_ns]."""
        rows = slice(*self.times_ns.searchsorted([begin_ns, end_ns], 'right'))
        return int(self._refused[rows].sum())

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
        Return the momenta of wheels without friction, N m s, shape (m, 2, n).

        The second axis holds the momenta and their low-order parts.
        """
        momenta = [momentum_at(group.times_ns, group.momentum, group.motors, times_ns)
                   for group in self._groups]
        return np.concatenate(momenta, axis=2)[:, :, :len(self.wheels)]

    def efforts(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the efforts applied at given times, N m, shape (m, wheels)."""
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
            axial = Axial(stamp_ns, stamp_ns, axial.momenta, self._commanded[row],
                          self._held[1][row - len(self.times_ns)], self._refused[row])
        if 0 < self._timeout_ns <= time_ns - axial.stamp_ns:
            axial = axial._replace(since_ns=max(axial.since_ns, axial.stamp_ns + self._timeout_ns),
                                   is_silent=True)
        momenta = None if axial.momenta is None else self.momenta(np.array([axial.since_ns]))[0]
        return axial._replace(momenta=momenta)


def joined_log(timelines: Sequence[WheelTimeline]) -> TorqueLog:
    """Return the total motor torque on the wheels over consecutive timelines."""
    logs = [log for timeline in timelines if (log := timeline.log)]
    # If two timelines contain the same stamp, TorqueLog uses the sample of the later timeline, for
    # which it is known whether the command is refused.
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
    command before, as at the start of a motion. If its wheel is then too fast, it is refused, so
    that it acts as zero.

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
    momenta = momenta_of(before, state)
    commanded = np.where(begins, clipped, before.commanded)
    refused = begins & wheels.refused(
        commanded, wheels.speeds(momenta[0], state.angular_velocity))
    acting = np.where(begins, np.where(refused, 0.0, commanded), before.acting)
    return Axial(time_ns, stamp_ns, None if before.momenta is None else momenta, commanded, acting,
                 refused, is_silent)


def momenta_of(axial: Axial, state: State) -> Floats:
    """Return axial momenta at a state, N m s, and their low-order parts, shape (2, n)."""
    if axial.momenta is None:
        return state_layout.momenta(state._packed)[:, :len(axial.acting)]
    if not axial.efforts.any():
        return axial.momenta
    momenta = [momentum_at(np.array([axial.since_ns]), before[None], efforts[None],
                           np.array([state.time_ns]))[0]
               for before, efforts in zip(_threes(axial.momenta), _threes(axial.efforts[None]))]
    return np.concatenate(momenta, axis=1)[:, :len(axial.acting)]


def friction_of(wheels: Wheels, efforts: Floats) -> Friction:
    """
    Pack wheels with friction into a record that has room for one output.

    `efforts`, N m, has one row for each row of the record and one column for each wheel.
    """
    padded = wheels.padded(efforts)
    return Friction(padded, wheels.constants, np.empty((1, padded.shape[1])))


def _threes(rows: Floats) -> list[Floats]:
    """Split the columns of an array into groups of three, and pad the last group with zeros."""
    count = rows.shape[1]
    padded = np.zeros((len(rows), count + -count % 3))  # np.pad would take ten times as long
    padded[:, :count] = rows
    return [np.ascontiguousarray(padded[:, k:k + 3]) for k in range(0, count, 3)]
