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

"""Actuator delays, limits and lags for samples that arrive one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import CommandChanges, kernels, Lags
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.actuator import Actuator, Actuators, time_constants
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation.lags import command_of, first_of, Lagging
from rigid_body_ros.propagation.segment import COMMANDS, Sample, summed, WHEELS


class ActingSamples:
    """
    The actuator delays, limits and lags that apply to the samples of all sources.

    Parameters
    ----------
    actuator : Actuator, or sequence of Actuator or None, optional
        One actuator for all sources, or an actuator or None for each source.
    timeout_ns : int
        See `TorqueLog.segments`.
    start_ns : int
        The start of the motion. All lagging torques are zero at this time.

    """

    def __init__(self, actuator: Actuators, timeout_ns: int, start_ns: int) -> None:
        each = [actuator] if isinstance(actuator, Actuator) else [*(actuator or ())]
        self._actuator, self.timeout_ns, self._start_ns = actuator, timeout_ns, start_ns
        self._time_constants = time_constants(each)
        #: `exist` tells whether any source has an actuator, and `lag` tells whether the actuator
        #: of any source has a lag.
        self.exist, self.lag = any(each), bool(self._time_constants)
        #: The longest of all delays.
        self.longest_delay_ns = max((one.delay_ns for one in each if one), default=0)

    def of(self, source: int) -> Actuator | None:
        """Return the actuator of a source, or None; raise ValueError for an unknown source."""
        given = self._actuator
        if source >= COMMANDS or given is None:
            return None
        if isinstance(given, Actuator):
            return given
        if source >= len(given):
            raise ValueError(f'source: expected a number from 0 to {len(given) - 1}, because '
                             f'there are {len(given)} actuators, found {source}')
        return given[source]

    def delay_ns(self, source: int) -> int:
        """Return the delay between the stamp of a sample and its effect, ns."""
        found = self.of(source) if self.exist else None
        return found.delay_ns if found else 0

    def acting(self, samples: Mapping[int, Sample]) -> Mapping[int, Sample]:
        """
        Apply the actuator delays and limits to samples.

        The stamp of each returned sample is the time at which it takes effect.
        """
        if not self.exist:
            return samples
        return {source: sample if (one := self.of(source)) is None else
                Sample(sample.stamp_ns + one.delay_ns, one.limited(sample.torque), sample.in_space)
                for source, sample in samples.items()}

    def due_ns(self, samples: Mapping[int, Sample]) -> set[int]:
        """Return the times, ns, at which samples time out or lags end."""
        acting, timeout_ns = self.acting(samples), self.timeout_ns
        due = {sample.stamp_ns + timeout_ns for sample in acting.values()} if timeout_ns else set()
        if self.lag:
            for source, sample in acting.items():
                due.update(self._lags_end_ns(source, sample.stamp_ns))
        return due

    def _lags_end_ns(self, source: int, acts_ns: int) -> Iterator[int]:
        """Yield the times at which the lag after a command and the lag after its timeout end."""
        found, out_ns = self.of(source), acts_ns + self.timeout_ns
        if found and found.expiry_ns:
            over_ns = max(acts_ns, self._start_ns) + found.expiry_ns
            if not self.timeout_ns or over_ns < out_ns:
                yield over_ns
            if self.timeout_ns:
                yield max(out_ns, self._start_ns) + found.expiry_ns

    def lagging(self, samples: Mapping[int, Sample], time_ns: int,
                before: Mapping[int, Lagging]) -> Mapping[int, Lagging]:
        """
        Return the lagging sources right after samples have taken effect or timed out.

        Parameters
        ----------
        samples : mapping of int to Sample
            The samples in force at `time_ns`.
        time_ns : int, ns
            The time at which samples take effect or time out.
        before : mapping of int to Lagging
            The sources that were lagging just before `time_ns`.

        """
        found: dict[int, Lagging] = {}
        if not self.lag:
            return found
        for source, (acts_ns, torque, in_space) in sorted(self.acting(samples).items()):
            one = self.of(source)
            if one is None or not one.expiry_ns:
                continue
            is_out = 0 < self.timeout_ns <= time_ns - acts_ns
            since_ns = max(acts_ns + (self.timeout_ns if is_out else 0), self._start_ns)
            command = command_of(torque[0], in_space) * (not is_out)
            last = before.get(source)
            if last is None:
                last = first_of(since_ns, command)
            elif last.since_ns != since_ns or not np.array_equal(last.command, command):
                last = last.at(since_ns, command, one)
            found[source] = last
        return found

    def torque(self, samples: Mapping[int, Sample], lagging: Mapping[int, Lagging],
               state: State) -> Floats:
        """
        Return the total torque on the body, in body axes, N m, shape (3,).

        The total includes the lags of actuators, but not the torques on the rotors.
        """
        on_body = {source: sample for source, sample in self.acting(samples).items()
                   if source != WHEELS}
        total = summed(on_body, state.time_ns, self.timeout_ns)
        axes = np.zeros((2, 3))
        axes[int(total.in_space)] += total.torque[0]
        axes[1] += total.space[0]
        lags = self.lags(lagging, state.time_ns)
        if lags is not None:
            axes += lags.excess.sum(axis=(0, 1))
        return np.asarray(axes[0] + so3.rotate(so3.conjugate(state.attitude), axes[1]))

    def lags(self, lagging: Mapping[int, Lagging], time_ns: int) -> Lags | None:
        """
        Return the torques of lagging sources minus their commands, in the form for the kernels.

        The result is None if no source has a lag.
        """
        if not self.lag:
            return None
        excess: Floats = np.zeros((1, len(self._time_constants), 2, 3))
        for source, (since_ns, command, torque) in lagging.items():
            one = self.of(source)
            assert one
            which = self._time_constants.index(one.time_constant)
            kernels.add_lag(
                np.array([time_ns]),
                CommandChanges(np.array([since_ns]), command[None], torque[None].copy()),
                one.time_constant, one.expiry_ns, which, excess)
        return Lags(excess, np.array(self._time_constants))
