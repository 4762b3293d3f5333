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

"""The torques of actuators with a lag, and the terms of wheels with friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import CommandChanges, FIELDS, Friction, kernels, Lags, Rows, Terms
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.actuator import Actuator, time_constants
from rigid_body_ros.mechanics.torque import TorqueLog

_NO_FIELDS = np.zeros(1, FIELDS)
_NO_FIELDS.flags.writeable = False
#: The torque of a source that has not received a command yet, in the form of `Lagging.torque`: the
#: high-order part, then the low-order part. Both parts are zero.
_AT_REST = np.zeros((2, 6))


class Lagging(NamedTuple):
    """
    A source that lags, from one change of its command to the next.

    `command`, N m, has shape (2, 3). The first row is in body axes, and the second row is in space
    axes. At least one of the two rows is zero. `torque`, N m, has shape (2, 6), and its rows are
    in the same axes as those of `command`. The first three columns are the torque at the change,
    and the last three columns are the low-order part of this torque.
    """

    since_ns: int
    command: Floats
    torque: Floats

    @property
    def key(self) -> Floats:
        """
        Return all numbers that describe the source.

        The time `since_ns` is split into seconds and nanoseconds, so that no digits of the time
        are lost.
        """
        return np.array([*divmod(self.since_ns, 10 ** 9), *self.command.flat, *self.torque.flat])

    def at(self, time_ns: int, command: Floats, actuator: Actuator) -> Lagging:
        """Return the record of this source after its command has changed at `time_ns`."""
        source = CommandChanges(np.array([self.since_ns, time_ns]),
                                np.stack([self.command, command]),
                                np.stack([self.torque, self.torque]))
        kernels.add_lag(_NO_TIMES, source, actuator.time_constant, actuator.expiry_ns, 0,
                        _NO_EXCESS)
        return Lagging(time_ns, command, source.torques[1])


_NO_TIMES, _NO_EXCESS = np.empty(0, np.int64), np.empty((0, 0, 2, 3))


def command_of(torque: Floats, in_space: bool) -> Floats:
    """Return a torque in the form of `Lagging.command`."""
    result = np.zeros((2, 3))
    result[int(in_space)] = torque
    return result


def first_of(time_ns: int, command: Floats) -> Lagging:
    """
    Return the record of a source whose torque is zero at a given time.

    The time is the start of the source's first command or the start of the motion.
    """
    return Lagging(time_ns, command, _AT_REST)


class Changes(NamedTuple):
    """The commands of one source. Each command is held until the next change."""

    actuator: Actuator
    times_ns: NDArray[np.int64]
    #: The commands in the form of `Lagging.command`, shape (n, 2, 3).
    commands: Floats
    #: Whether the first command took effect before the torque was at rest.
    is_clipped: bool

    @classmethod
    def of(cls, log: TorqueLog, actuator: Actuator, timeout_ns: int, rest_ns: int) -> Changes:
        """Return the changes, from `rest_ns` onward, in a log that `Actuator.acting` returned."""
        times_ns, samples = log.segments(timeout_ns)
        first = max(int(times_ns.searchsorted(rest_ns, 'right')) - 1, 0)
        is_clipped = bool(len(times_ns) and times_ns[first] < rest_ns)
        times_ns, samples = np.maximum(times_ns[first:], rest_ns), samples[first:]
        commands = np.zeros((len(times_ns), 2, 3))
        acts = np.flatnonzero(samples >= 0)
        commands[acts, log.in_space[samples[acts]].astype(int)] = log.torques[samples[acts]]
        return cls(actuator, times_ns, commands, is_clipped)

    def moving(self) -> Changes:
        """Return the changes that a delay moves: not that of a clipped command."""
        return self._replace(commands=self.commands - self.commands[:1]) if self.is_clipped \
            else self


class LaggingSources:
    """
    All sources that lag.

    Parameters
    ----------
    logs : sequence of TorqueLog
        The commands of all sources, delayed and limited.
    actuators : sequence of Actuator or None
        The actuators of all sources.
    timeout_ns : int
        See `TorqueLog.segments`.
    rest_ns : int, ns
        The time at which the lagging torques are zero.

    Attributes
    ----------
    marks_ns : array of int64, ns
        The times at which the lag of a command ends, ascending.

    """

    def __init__(self, logs: Sequence[TorqueLog], actuators: Sequence[Actuator | None],
                 timeout_ns: int, rest_ns: int) -> None:
        self._time_constants = np.array(time_constants(actuators))
        self._sources = [Changes.of(log, each, timeout_ns, rest_ns)
                         for log, each in zip(logs, actuators) if each and each.expiry_ns]
        self.marks_ns = np.unique(np.concatenate([_NO_TIMES, *map(_marks, self._sources)]))

    def __bool__(self) -> bool:
        return bool(self._sources)

    def excess(self, times_ns: NDArray[np.int64]) -> Floats:
        """
        Return the torques minus the commands, N m, at ascending times.

        See `layout.Lags.excess` for the shape.
        """
        return self._excess(times_ns, self._sources)

    def moving_excess(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the part of `excess` that a delay of the commands moves."""
        return self._excess(times_ns, [source.moving() for source in self._sources])

    def _excess(self, times_ns: NDArray[np.int64], sources: Sequence[Changes]) -> Floats:
        result = np.zeros((len(times_ns), len(self._time_constants), 2, 3))
        for source in sources:
            which = int(np.flatnonzero(self._time_constants == source.actuator.time_constant)[0])
            _add(source, times_ns, which, result)
        return result

    def slopes(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the derivatives of the torques with respect to their time constants, N m/s."""
        every_ns = np.unique(np.concatenate([
            times_ns, self.marks_ns, *(source.times_ns for source in self._sources)]))
        excess = self.excess(every_ns)
        found = np.zeros_like(excess)
        kernels.lag_slopes(every_ns, excess, self._time_constants, found)
        found[excess == 0.0] = 0.0  # what is left of a lag that is over
        return found[every_ns.searchsorted(times_ns)]

    def key(self, time_ns: int) -> Floats:
        """Return an array of all numbers that determine the torques until the next change."""
        found = [np.empty(0)]
        for source in self._sources:
            row = int(source.times_ns.searchsorted(time_ns, 'right')) - 1
            if row >= 0:
                torques = _add(source, _NO_TIMES, 0, _NO_EXCESS)
                found.append(Lagging(int(source.times_ns[row]), source.commands[row],
                                     torques[row]).key)
        return np.concatenate(found)

    def excess_torque(self, times_ns: NDArray[np.int64], attitude: Floats) -> Floats:
        """
        Return the total excess (torques minus commands) in body axes, N m, shape (m, 3).

        The excess is computed at m times and attitudes.
        """
        order = np.argsort(times_ns, kind='stable')
        sums = np.empty((len(times_ns), 2, 3))
        sums[order] = self.excess(times_ns[order]).sum(axis=1)
        return sums[:, 0] + so3.rotate(so3.conjugate(attitude), sums[:, 1])

    def impulses(self, times_ns: NDArray[np.int64]) -> Floats:
        """
        Return the integrals of the excess (torques minus commands) from each time to the next.

        Parameters
        ----------
        times_ns : array of int64, shape (m,), ns
            The times. No command may change between two neighbouring times.

        Returns
        -------
        array, shape (m - 1, 2, 3), N m s
            Each integral has a row in body axes and a row in space axes.

        """
        seconds, constants = np.diff(times_ns)[:, None] / 1e9, self._time_constants
        integrals = -constants * np.expm1(-seconds / constants)
        return np.einsum('nl,nlij->nij', integrals, self.excess(times_ns[:-1]))

    def lags(self, times_ns: NDArray[np.int64]) -> Lags:
        """Return the lags, as the kernels need them, for rows that begin at given times."""
        return Lags(self.excess(times_ns), self._time_constants)


def terms_of(momentum: Floats, motors: Floats, space: Floats, fields: NDArray[Any] | None,
             lags: Lags | None, friction: Friction | None) -> Terms:
    """Return the terms for rows with fields, lags or friction; see `layout.Terms`."""
    if friction is not None and lags is None:
        lags = no_lags(len(friction.efforts))
    if lags is not None and fields is None:
        fields = _NO_FIELDS
    return Terms(momentum, motors, space, fields, lags, friction)


def no_lags(count: int) -> Lags:
    """Return the lags of a number of rows in which nothing lags."""
    return Lags(np.zeros((count, 0, 2, 3)), np.empty(0))


def _add(changes: Changes, times_ns: NDArray[np.int64], which: int, into: Floats) -> Floats:
    """
    Add the excess of one source at given times to the array `into`.

    The excess is the torque minus the command. The function returns the torque at each change, in
    the form of `Lagging.torque`.
    """
    torques = np.zeros((len(changes.times_ns), 2, 6))
    kernels.add_lag(times_ns, CommandChanges(changes.times_ns, changes.commands, torques),
                    changes.actuator.time_constant, changes.actuator.expiry_ns, which, into)
    return torques


def _marks(changes: Changes) -> NDArray[np.int64]:
    """Return the times at which lags end, ns, leaving out lags that the next change cuts short."""
    over_ns = changes.times_ns + changes.actuator.expiry_ns
    return over_ns[np.append(over_ns[:-1] < changes.times_ns[1:], True)[:len(over_ns)]]


def with_momenta(rows: Rows, count: int) -> tuple[Rows, Floats]:
    """Add to rows an array for the wheel momenta at `count` outputs; return rows and array."""
    terms = rows.terms
    assert terms
    assert terms.friction
    momenta = np.empty((count, terms.friction.efforts.shape[1]))
    friction = terms.friction._replace(momenta=momenta)
    return rows._replace(terms=terms._replace(friction=friction)), momenta


def friction_key(friction: Friction, row: int = 0) -> Floats:
    """Return an array of all numbers that determine the friction in a row, for use as a key."""
    return np.concatenate([friction.efforts[row], friction.wheels])
