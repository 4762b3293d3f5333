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

"""The torques of actuators with a lag."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import CommandChanges, kernels, Lags
from rigid_body_ros.mechanics.actuator import Actuator, time_constants
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation.sources import Sample

#: The torque of a source that has not received a command yet; see `CommandChanges.torques`.
_AT_REST = np.zeros((2, 6))
_AT_REST.setflags(write=False)
_NO_TIMES, _NO_EXCESS = np.empty(0, np.int64), np.empty((0, 0, 2, 3))


class LaggingSource(NamedTuple):
    """A source that lags. Each of its commands is held until the next change."""

    actuator: Actuator
    times_ns: NDArray[np.int64]
    #: The commands, N m, shape (n, 2, 3): each in body axes and in space axes, one of them zero.
    commands: Floats
    #: The torque at the first change, N m, shape (2, 6); see `CommandChanges.torques`.
    torque: Floats = _AT_REST
    #: Whether the first command took effect before the torque was at rest.
    is_clipped: bool = False

    @classmethod
    def of(cls, log: TorqueLog, actuator: Actuator, timeout_ns: int,
           rest_ns: int) -> LaggingSource:
        """Return the changes, from `rest_ns` onward, in a log that `Actuator.acting` returned."""
        times_ns, samples = log.segments(timeout_ns)
        first = max(int(times_ns.searchsorted(rest_ns, 'right')) - 1, 0)
        is_clipped = bool(len(times_ns) and times_ns[first] < rest_ns)
        times_ns, samples = np.maximum(times_ns[first:], rest_ns), samples[first:]
        commands = np.zeros((len(times_ns), 2, 3))
        acts = np.flatnonzero(samples >= 0)
        commands[acts, log.in_space[samples[acts]].astype(int)] = log.torques[samples[acts]]
        return cls(actuator, times_ns, commands, is_clipped=is_clipped)

    def add(self, times_ns: NDArray[np.int64], which: int, into: Floats) -> Floats:
        """
        Add the excess at given times to the array `into`, in the place of a time constant.

        The excess is the torque minus the command. The method returns the torque at each change,
        N m, shape (n, 2, 6).
        """
        torques = np.empty((len(self.times_ns), 2, 6))
        torques[:1] = self.torque
        kernels.add_lag(times_ns, CommandChanges(self.times_ns, self.commands, torques),
                        self.actuator.time_constant, self.actuator.expiry_ns, which, into)
        return torques

    def then(self, time_ns: int, command: Floats) -> LaggingSource:
        """Return the source from a change of its only command onward."""
        if time_ns == self.times_ns[0] and np.array_equal(command, self.commands[0]):
            return self
        changed = self._replace(times_ns=np.append(self.times_ns, time_ns),
                                commands=np.stack([self.commands[0], command]))
        torques = changed.add(_NO_TIMES, 0, _NO_EXCESS)
        return self._replace(times_ns=changed.times_ns[1:], commands=changed.commands[1:],
                             torque=torques[1])

    def moving(self) -> LaggingSource:
        """Return the changes that a delay moves: not that of a clipped command."""
        return self._replace(commands=self.commands - self.commands[:1]) if self.is_clipped \
            else self

    def ends_ns(self) -> NDArray[np.int64]:
        """Return the times at which lags end, leaving out those that a change cuts short, ns."""
        over_ns = self.times_ns + self.actuator.expiry_ns
        return over_ns[np.append(over_ns[:-1] < self.times_ns[1:], True)[:len(over_ns)]]

    def key(self, time_ns: int) -> list[float]:
        """Return all numbers that determine the torque from a time until the next change."""
        row = int(self.times_ns.searchsorted(time_ns, 'right')) - 1
        if row < 0:
            return []
        torque = self.add(_NO_TIMES, 0, _NO_EXCESS)[row] if row else self.torque
        # The time is split into seconds and nanoseconds, so that no digits of it are lost.
        return [*divmod(int(self.times_ns[row]), 10 ** 9), *self.commands[row].flat, *torque.flat]


class LaggingSources:
    """
    All sources that lag.

    Parameters
    ----------
    time_constants : sequence of float, s
        The time constants of the sources, each once.
    sources : mapping of int to LaggingSource
        The sources, by number, in order.

    """

    def __init__(self, time_constants: Sequence[float],
                 sources: Mapping[int, LaggingSource]) -> None:
        self._time_constants, self._sources = time_constants, sources

    @classmethod
    def of(cls, logs: Sequence[TorqueLog], actuators: Sequence[Actuator | None],
           timeout_ns: int, rest_ns: int) -> LaggingSources | None:
        """
        Return the sources that lag; None if no source lags.

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

        """
        sources = {k: LaggingSource.of(log, actuator, timeout_ns, rest_ns)
                   for k, (log, actuator) in enumerate(zip(logs, actuators))
                   if actuator and actuator.expiry_ns}
        return cls(time_constants(actuators), sources) if sources else None

    def under(self, samples: Mapping[int, Sample], time_ns: int, timeout_ns: int,
              rest_ns: int) -> LaggingSources:
        """
        Return the sources, each with a single command, under the samples in force at a time.

        At this time, samples take effect or time out.
        """
        sources = {}
        for source, sample in sorted(samples.items()):
            if sample.actuator and sample.actuator.expiry_ns:
                is_over = sample.is_over(time_ns, timeout_ns)
                since_ns = max(sample.begins_ns + timeout_ns * is_over, rest_ns)
                command = np.zeros((2, 3))
                if not is_over:
                    command[int(sample.in_space)] = sample.applied[0]
                before = self._sources.get(source)
                sources[source] = before.then(since_ns, command) if before else LaggingSource(
                    sample.actuator, np.array([since_ns]), command[None])
        return LaggingSources(self._time_constants, sources)

    @cached_property
    def marks_ns(self) -> NDArray[np.int64]:
        """Return the times at which the lag of a command ends, ns, ascending."""
        return np.unique(np.concatenate([
            _NO_TIMES, *(source.ends_ns() for source in self._sources.values())]))

    def excess(self, times_ns: NDArray[np.int64]) -> Floats:
        """
        Return the torques minus the commands, N m, at ascending times.

        See `layout.Lags.excess` for the shape.
        """
        return self._excess(times_ns, self._sources.values())

    def moving_excess(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the part of `excess` that a delay of the commands moves."""
        return self._excess(times_ns, [source.moving() for source in self._sources.values()])

    def _excess(self, times_ns: NDArray[np.int64], sources: Iterable[LaggingSource]) -> Floats:
        excess = np.zeros((len(times_ns), len(self._time_constants), 2, 3))
        for source in sources:
            source.add(times_ns, self._time_constants.index(source.actuator.time_constant), excess)
        return excess

    def slopes(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the derivatives of the torques with respect to their time constants, N m/s."""
        every_ns = np.unique(np.concatenate([
            times_ns, self.marks_ns, *(source.times_ns for source in self._sources.values())]))
        excess = self.excess(every_ns)
        slopes = np.zeros_like(excess)
        kernels.lag_slopes(every_ns, excess, np.array(self._time_constants), slopes)
        slopes[excess == 0.0] = 0.0  # what is left of a lag that is over
        return slopes[every_ns.searchsorted(times_ns)]

    def key(self, time_ns: int) -> Floats:
        """Return an array of all numbers that determine the torques until the next change."""
        return np.array([number for source in self._sources.values()
                         for number in source.key(time_ns)])

    def total_excess(self, times_ns: NDArray[np.int64]) -> Floats:
        """Return the sum over all time constants of `excess` at any times, shape (m, 2, 3)."""
        order = np.argsort(times_ns, kind='stable')
        total = np.empty((len(times_ns), 2, 3))
        total[order] = self.excess(times_ns[order]).sum(axis=1)
        return total

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
        seconds, constants = np.diff(times_ns)[:, None] / 1e9, np.array(self._time_constants)
        integrals = -constants * np.expm1(-seconds / constants)
        return np.einsum('nl,nlij->nij', integrals, self.excess(times_ns[:-1]))

    def lags(self, times_ns: NDArray[np.int64]) -> Lags:
        """Return the lags, as the kernels need them, for rows that begin at given times."""
        return Lags(self.excess(times_ns), np.array(self._time_constants))
