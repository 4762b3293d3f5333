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

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine import state_layout
from rigid_body_ros.mechanics.efforts import EffortLog, filled
from rigid_body_ros.mechanics.fields import Field, GravityGradient
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.mechanics.wheels import Axial, Wheels
from rigid_body_ros.propagation.timeline import momentum_at, Timeline

_NO_TIMES = np.empty(0, np.int64)


class WheelTimeline:
    """
    The wheels from a start time onward.

    If a wheel is too fast when a command that would speed it up takes effect, the command is
    refused and acts as zero. Whether the wheel is too fast depends on the motion before the
    command. Until this motion is known, `assume` sets which commands count as refused.

    Parameters
    ----------
    wheels : Wheels
    axial : Axial
        The state of the wheels at the start time.
    log : EffortLog, optional
        The commands, including those in force at the start time.
    timeout_ns : int
        See `TorqueLog.segments`.
    start_ns : int
        The start time, ns. It is already known which of the commands up to this time are refused.

    Attributes
    ----------
    times_ns : array of int64, shape (n,), ns
        The stamps of the commands after the start time.

    """

    def __init__(self, wheels: Wheels, axial: Axial, log: EffortLog | None, timeout_ns: int,
                 start_ns: int) -> None:
        self.wheels, self._axial, self._timeout_ns = wheels, axial, timeout_ns
        later = slice(log.times_ns.searchsorted(start_ns, 'right') if log else 0, None)
        self.times_ns = log.times_ns[later] if log else _NO_TIMES
        commands = log.efforts[later] if log else np.empty((0, len(wheels)))
        self._given = ~np.isnan(commands)
        self._commanded = filled(wheels.clipped(commands), axial.commanded)
        self._refused = np.zeros(commands.shape, np.bool_)
        self.assume(0, self._refused)

    def assume(self, row: int, refused: NDArray[np.bool_]) -> None:
        """Set which commands count as refused from a row onward, shape (n - row, wheels)."""
        self._refused[row:] = refused & self._given[row:]
        commands = np.where(self._refused, 0.0, self._commanded)
        self._acting = filled(np.where(self._given, commands, np.nan), self._axial.acting)
        self.__dict__.pop('_groups', None)

    def refused(self, rows: slice, speeds: Floats) -> NDArray[np.bool_]:
        """Return whether each command in some rows is refused at given wheel speeds."""
        return self.wheels.refused(self._commanded[rows], speeds) & self._given[rows]

    def first_wrong(self, rows: slice, refused: NDArray[np.bool_]) -> int | None:
        """Return the first row in which the assumed refusals differ from `refused`, or None."""
        wrong = np.flatnonzero((refused != self._refused[rows]).any(axis=1))
        return rows.start + int(wrong[0]) if len(wrong) else None

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

    @property
    def _held(self) -> tuple[NDArray[np.int64], Floats]:
        """Return the stamps and efforts of the commands in force at the start or later."""
        if self._axial.stamp_ns == -NEVER_NS:
            return self.times_ns, self._acting
        return (np.append(self._axial.stamp_ns, self.times_ns),
                np.concatenate([self._axial.acting[None], self._acting]))

    @cached_property
    def _groups(self) -> list[Timeline]:
        """
        Return timelines for groups of three wheels.

        A timeline treats the three wheels of a group like the three axes of rotors.
        """
        assert self._axial.momenta is not None
        times_ns, efforts = self._held
        return [Timeline((), TorqueLog(times_ns, three) if len(times_ns) else None,
                         self._timeout_ns, False, self._axial.since_ns, momenta)
                for three, momenta in zip(_threes(efforts), _threes(self._axial.momenta))]

    def momenta(self, times_ns: NDArray[np.int64]) -> Floats:
        """
        Return the momenta of wheels without friction, N m s, shape (m, 2, n).

        The second axis holds the momenta and their low-order parts.
        """
        found = [group.momentum(times_ns) for group in self._groups]
        return np.concatenate(found, axis=2)[:, :, :len(self.wheels)]

    def efforts(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the efforts applied at given times, N m, shape (m, wheels)."""
        held_ns, efforts = self._held
        rows = held_ns.searchsorted(times_ns, 'right') - 1
        found = np.zeros((len(times_ns), len(self.wheels)))
        acts = rows >= 0
        if self._timeout_ns:
            acts[acts] = times_ns[acts] - held_ns[rows[acts]] < self._timeout_ns
        found[acts] = efforts[rows[acts]]
        return found

    def axial(self, time_ns: int) -> Axial:
        """Return the state of the wheels at a time, which must not lie before the start time."""
        row = int(self.times_ns.searchsorted(time_ns, 'right')) - 1
        stamp_ns, commanded, acting, refused = self._axial.stamp_ns, self._axial.commanded, \
            self._axial.acting, self._axial.refused
        since_ns = self._axial.since_ns
        if row >= 0:
            since_ns = stamp_ns = int(self.times_ns[row])
            commanded, acting = self._commanded[row], self._acting[row]
            refused = self._refused[row]
        is_silent = 0 < self._timeout_ns <= time_ns - stamp_ns
        if is_silent:
            since_ns = max(since_ns, stamp_ns + self._timeout_ns)
        momenta = None if self.wheels.has_friction else self.momenta(np.array([since_ns]))[0]
        return Axial(since_ns, stamp_ns, momenta, commanded, acting, refused, is_silent)


def joined_log(timelines: Sequence[WheelTimeline]) -> TorqueLog:
    """Return the total motor torque on the wheels over consecutive timelines."""
    logs = [log for each in timelines if (log := each.log)]
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
    if any(isinstance(one, GravityGradient) for one in fields):
        raise ValueError('fields: expected no gravity gradient with wheels that have names, '
                         'because the two together are not supported yet, found one')


def commanded(wheels: Wheels, before: Axial, row: Floats, state: State) -> Axial:
    """
    Return the state of the wheels after new commands take effect.

    Parameters
    ----------
    wheels : Wheels
        The wheels.
    before : Axial
        The state of the wheels before the new commands.
    row : array, shape (n,), N m
        The new commands, with NaN for a wheel that keeps its command.
    state : State
        The state of the carrier when the commands take effect, at their stamp or later.

    """
    momenta, given = momenta_of(before, state), ~np.isnan(row)
    commands = np.where(given, wheels.clipped(row), before.commanded)
    refused = given & wheels.refused(commands, wheels.speeds(momenta[0], state.angular_velocity))
    acting = np.where(given, np.where(refused, 0.0, commands), before.acting)
    return Axial(state.time_ns, state.time_ns, momenta if before.momenta is not None else None,
                 commands, acting, refused)


def in_force(wheels: Wheels, axial: Axial, log: EffortLog | None, state: State,
             timeout_ns: int) -> Axial:
    """
    Return the state of the wheels under the commands in force at a given carrier state.

    Commands that have already taken effect or have already been refused are not checked again.

    Parameters
    ----------
    wheels : Wheels
        The wheels.
    axial : Axial
        The state of the wheels before `state`.
    log : EffortLog, optional
        The commands.
    state : State
        The state of the carrier.
    timeout_ns : int
        See `TorqueLog.segments`.

    """
    time_ns = state.time_ns
    row = int(log.times_ns.searchsorted(time_ns, 'right')) - 1 if log else -1
    if not log or row < 0:
        return axial
    stamp_ns, held = int(log.times_ns[row]), log.between(time_ns, time_ns).efforts[0]
    begins = wheels.clipped(held) != axial.commanded
    if stamp_ns == time_ns:
        begins |= ~np.isnan(log.efforts[row])
    if stamp_ns == axial.stamp_ns and not begins.any():
        return axial
    found = commanded(wheels, axial, np.where(begins, held, np.nan), state)
    return found._replace(stamp_ns=stamp_ns,
                          is_silent=0 < timeout_ns <= time_ns - stamp_ns)


def momenta_of(axial: Axial, state: State) -> Floats:
    """Return axial momenta at a state, N m s, and their low-order parts, shape (2, n)."""
    if axial.momenta is None:
        return state_layout.momenta(state._packed)[:, :len(axial.acting)]
    if not axial.efforts.any():
        return axial.momenta
    found = [momentum_at(np.array([axial.since_ns]), momenta[None], efforts[None],
                         np.array([state.time_ns]))[0]
             for momenta, efforts in zip(_threes(axial.momenta), _threes(axial.efforts[None]))]
    return np.concatenate(found, axis=1)[:, :len(axial.acting)]


def _threes(rows: Floats) -> list[Floats]:
    """Split the columns of an array into groups of three, and pad the last group with zeros."""
    count = rows.shape[1]
    padded = np.pad(rows, [(0, 0), (0, -count % 3)])
    return [np.ascontiguousarray(padded[:, k:k + 3]) for k in range(0, count, 3)]
