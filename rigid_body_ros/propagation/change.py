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

from rigid_body_ros.mechanics.wheels import Axial
from rigid_body_ros.propagation.acting import ActingSamples
from rigid_body_ros.propagation.segment import NewBody, Sample, Segment
from rigid_body_ros.propagation.wheels import Commands


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
