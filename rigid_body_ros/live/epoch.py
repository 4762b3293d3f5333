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

"""One start state, and the torques applied since then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, NEVER_NS
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Wheels
from rigid_body_ros.propagation import Propagator
from rigid_body_ros.propagation.segment import BODY, COMMANDS, Sample, WHEELS
from rigid_body_ros.scene import Scene


class Epoch:
    """
    The motion that begins with one start state, under the torques applied since then.

    Parameters
    ----------
    scene : Scene
    start : State
    torques : sequence of Torque
        Torques of an earlier epoch that still act.

    """

    def __init__(self, scene: Scene, start: State, torques: Sequence[Torque] = ()) -> None:
        self.start, self._timeout_ns = start, scene.timeout_ns
        self._body, self._keep = scene.body, scene.inertia_change
        self._wheels = Wheels(scene.named_wheels)
        #: A torque that is older than the newest stamp by this time, ns, is too old.
        self.history_ns = max(1, duration_ns(scene.history, 'history'))
        # The history is longer by the delay of the IMU, which measures earlier states.
        self._propagator = Propagator(scene.body, start, wheels=scene.named_wheels,
                                      fields=scene.fields_from(start.time_ns),
                                      actuator=scene.actuators, **asdict(scene.options),
                                      history=scene.history + scene.imu.delay)
        self._committed_ns = start.time_ns
        #: Commands that act as zero have been counted up to this stamp, ns.
        self._counted_ns = start.time_ns - 1
        #: Sources and stamps of the torques of the earlier epoch.
        self._carried = {(torque.source, torque.stamp_ns) for torque in torques}
        for torque in torques:
            self._put(torque)

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp of all sources, ns, or None before the first torque."""
        return self._propagator.newest_ns

    def at(self, time_ns: int, within: float) -> State:
        """Return the state at a time; arguments and errors are those of `Propagator.at`."""
        return self._propagator.at(time_ns, within)

    def applied_torque(self, state: State) -> Floats:
        """Return the torque that acts in a state of this epoch; see `Propagator.torque`."""
        return self._propagator.torque(state)

    def apply(self, torque: Torque) -> bool:
        """
        Apply a torque that is not too old; return whether it replaces an earlier torque.

        A torque replaces another torque of the same source with the same stamp. A torque of the
        earlier epoch does not count as replaced.

        Raises
        ------
        ValueError
            As for `Propagator.apply`.

        """
        key = torque.source, torque.stamp_ns
        is_replacement = self._replaces(torque) and key not in self._carried
        self._put(torque)
        self._carried.discard(key)
        return is_replacement

    def _put(self, torque: Torque) -> None:
        if torque.source == BODY:
            self._propagator.apply_body(torque.stamp_ns, self._body.with_entries(torque.values),
                                        self._keep)
        elif torque.source == COMMANDS:
            self._propagator.apply_efforts(torque.stamp_ns, {
                name: effort for name, effort in zip(self._wheels.names, torque.values.tolist())
                if effort == effort})
        elif torque.source == WHEELS:
            self._propagator.apply_wheels(torque.stamp_ns, torque.values)
        else:
            self._propagator.apply(*torque)

    def has_torque_at(self, stamp_ns: int, source: int) -> bool:
        """Return whether a source has a torque with this stamp, which may still be replaced."""
        if source == BODY:
            return self._propagator.body_at(stamp_ns).stamp_ns == stamp_ns
        if source == COMMANDS:
            return stamp_ns in self._propagator.commands_at(stamp_ns).stamps_ns
        held = self._held(stamp_ns, source)
        return held is not None and held.stamp_ns == stamp_ns

    def _replaces(self, torque: Torque) -> bool:
        if torque.source != COMMANDS:
            return self.has_torque_at(torque.stamp_ns, torque.source)
        stamps_ns = self._propagator.commands_at(torque.stamp_ns).stamps_ns
        return any(stamp_ns == torque.stamp_ns and effort == effort
                   for stamp_ns, effort in zip(stamps_ns, torque.values.tolist()))

    def newest_of(self, source: int) -> Torque | None:
        """Return the torque of a source with the newest stamp, or None before the first torque."""
        if self.newest_ns is None:
            return None
        if source == COMMANDS:
            return self._commands_at(self.newest_ns)
        held = self._held(self.newest_ns, source)
        return None if held is None else _torque(source, held)

    def acting_at(self, time_ns: int) -> list[Torque]:
        """Return the nonzero torques that act at a time."""
        found = [_torque(*pair) for pair in self._propagator.held(time_ns).items()]
        commands = self._commands_at(time_ns)
        return [torque for torque in (*found, *([commands] if commands else []))
                if torque.values.any()
                and not 0 < self._timeout_ns <= time_ns - torque.stamp_ns
                - self._propagator.delay_ns(torque.source)]

    def _held(self, stamp_ns: int, source: int) -> Sample | None:
        """Return the sample of a source in force when a torque with this stamp begins to act."""
        acts_ns = stamp_ns + self._propagator.delay_ns(source)
        return self._propagator.held(acts_ns).get(source)

    def _commands_at(self, time_ns: int) -> Torque | None:
        """Return the commands in force for all wheels at a time, with their newest stamp."""
        commands = self._propagator.commands_at(time_ns)
        return None if commands.stamp_ns == -NEVER_NS else Torque(
            commands.stamp_ns, np.array(commands.efforts), 'body', COMMANDS)

    def torques_since(self, time_ns: int) -> list[Torque]:
        """Return the torques in force at a time and all later torques, sorted by stamp."""
        found = [_torque(*pair) for pair in self._propagator.samples_since(time_ns)]
        found += [Torque(stamp_ns, body.entries, 'body', BODY)
                  for stamp_ns, body, *_ in self._propagator.bodies_since(time_ns)]
        found += [Torque(stamp_ns, self._wheels.row(efforts), 'body', COMMANDS)
                  for stamp_ns, efforts in self._propagator.commands_since(time_ns)]
        return sorted(found, key=lambda torque: torque.stamp_ns)

    def uncommitted(self, until_ns: int) -> list[int]:
        """Return the stamps up to a time, ascending, at which no state is committed yet."""
        return self._propagator.stamps(self._committed_ns, until_ns)

    def mark_committed(self, time_ns: int) -> None:
        """Record that the states at the stamps up to a time are committed."""
        self._committed_ns = time_ns

    def refused(self, time_ns: int) -> int:
        """
        Return how many commands act as zero, because their wheels are too fast.

        Each call counts the commands after the time of the previous call, up to its own time.
        """
        if not self._wheels.is_limited:
            return 0
        begin_ns, self._counted_ns = self._counted_ns, time_ns
        return self._propagator.refused_commands(begin_ns, time_ns)

    def clipped(self, torque: Torque) -> int:
        """Return the number of clipped efforts of a command; 0 if a torque is not a command."""
        return self._wheels.count_clipped(torque.values) if torque.source == COMMANDS else 0


def _torque(source: int, sample: Sample) -> Torque:
    return Torque(sample.stamp_ns, np.ravel(sample.torque), 'space' if sample.in_space else 'body',
                  source)
