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

"""The inputs of a `Propagator` from a given time onward."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.wheels import Axial
from rigid_body_ros.propagation.acting import ActingSamples
from rigid_body_ros.propagation.segment import NewBody, Sample, Segment


class Commands(NamedTuple):
    """The commands in force: a stamp in ns and an effort in N m for each named wheel."""

    stamps_ns: tuple[int, ...]
    efforts: tuple[float, ...]

    @property
    def stamp_ns(self) -> int:
        """Return the latest stamp of all commands, ns, or -NEVER_NS before the first command."""
        return max(self.stamps_ns, default=-NEVER_NS)

    @property
    def log(self) -> EffortLog:
        """Return the commands as a log."""
        rows = np.where(np.eye(len(self.efforts), dtype=bool), self.efforts, np.nan)
        given = np.array(self.stamps_ns) > -NEVER_NS
        return EffortLog(np.array(self.stamps_ns)[given], rows[given])

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

    def given_at(self, time_ns: int) -> Floats:
        """Return the efforts of commands with the given stamp, and NaN for all other wheels."""
        return np.where(np.array(self.stamps_ns) == time_ns, self.efforts, np.nan)


def no_commands(count: int) -> Commands:
    """Return the `Commands` of `count` wheels that have not received a command yet."""
    return Commands((-NEVER_NS,) * count, (0.0,) * count)


class Active(NamedTuple):
    """
    The motion from a change onward, and the state of the named wheels at its beginning.

    Without named wheels, `axial` is None.
    """

    segment: Segment
    axial: Axial | None


@dataclass
class Change:
    """The samples of all sources, the body and the wheel commands from a given time onward."""

    time_ns: int
    samples: dict[int, Sample]
    body: NewBody
    commands: Commands
    active: Active | None = None
    #: The motions that begin at the times in `due_ns`, in order. Motions that have not been
    #: computed yet are missing at the end.
    after_timeouts: list[Active] = field(default_factory=list)

    @property
    def stamps_ns(self) -> set[int]:
        """Return the stamps of the samples, the body and the commands that are in force."""
        return {self.body.stamp_ns, *self.commands.stamps_ns, *(
            sample.stamp_ns for sample in self.samples.values())}

    def due_ns(self, acting: ActingSamples) -> list[int]:
        """Return the times after this change at which a torque times out or a lag ends."""
        if not (acting.timeout_ns or acting.lag):
            return []
        due = acting.due_ns(self.samples)
        if self.commands.efforts:
            due.add(self.commands.stamp_ns + acting.timeout_ns)
        return sorted(time_ns for time_ns in due if time_ns > self.time_ns)

    def begins_at(self, time_ns: int, acting: ActingSamples) -> bool:
        """Return whether any torque in force takes effect or times out at a given time."""
        samples = acting.acting(self.samples).values()
        return any(time_ns in (since_ns, since_ns + acting.timeout_ns) for since_ns in (
            self.commands.stamp_ns, *(sample.stamp_ns for sample in samples)))

    def discard(self) -> None:
        """Discard the computed motion, so that it is computed again when it is needed."""
        self.active = None
        self.after_timeouts.clear()
