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

"""An epoch: one start state and the torques applied since then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, NEVER_NS
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Axial, Wheels
from rigid_body_ros.propagation import Propagator
from rigid_body_ros.propagation.sources import BODY, COMMANDS, Sample, WHEELS
from rigid_body_ros.scene import Scene

#: How much later than possible a state may be committed, s and ns.
_SLACK = 1.0
_SLACK_NS = duration_ns(_SLACK, 'slack')


class Epoch:
    """
    The motion from one start state under the torques applied since then.

    Parameters
    ----------
    scene : Scene
    start : State
    torques : sequence of Torque
        Torques from an earlier epoch that are still acting.

    """

    def __init__(self, scene: Scene, start: State, torques: Sequence[Torque] = ()) -> None:
        self.start, self._timeout_ns = start, scene.timeout_ns
        self._body, self._keep = scene.body, scene.inertia_change
        self._wheels = Wheels(scene.named_wheels)
        #: A torque is too old if its stamp is older than the newest stamp by this time or more,
        #: ns.
        self.history_ns = max(1, duration_ns(scene.history, 'history'))
        # The propagator needs additional history for the delay of the IMU, because the IMU
        # measures earlier states, and for states that are committed later than they could be.
        self._propagator = Propagator(scene.body, start, wheels=scene.named_wheels,
                                      fields=scene.fields_from(start.time_ns),
                                      actuator=scene.actuators, **asdict(scene.options),
                                      history=scene.history + scene.imu.delay + _SLACK)
        self._committed_ns = start.time_ns
        #: The sources and stamps of the torques from the earlier epoch.
        self._carried = {(torque.source, torque.stamp_ns) for torque in torques}
        for torque in torques:
            self._put(torque)

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp from any source, ns, or None before the first torque."""
        return self._propagator.newest_ns

    def at(self, time_ns: int, within: float) -> State:
        """Return the state at a time; see `Propagator.at` for the arguments and errors."""
        return self._propagator.at(time_ns, within)

    def applied_torque(self, state: State) -> Floats:
        """Return the torque that acts on the body in a given state; see `Propagator.torque`."""
        return self._propagator.torque(state)

    def apply(self, torque: Torque) -> bool:
        """
        Apply a torque that is not too old, and return whether this replaces an earlier torque.

        A torque replaces an earlier torque that has the same source and the same stamp. If the
        replaced torque was taken over from an earlier epoch, the method returns False.

        Raises
        ------
        ValueError
            See `Propagator.apply`.

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
        """Return whether the epoch already has a torque with this stamp from this source."""
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
        """Return the torque with the newest stamp from a source, or None before its first one."""
        if self.newest_ns is None:
            return None
        if source == COMMANDS:
            return self._commands_at(self.newest_ns)
        held = self._held(self.newest_ns, source)
        return None if held is None else _torque(source, held)

    def acting_at(self, time_ns: int) -> list[Torque]:
        """Return the nonzero torques that act at a given time."""
        torques = [_torque(*pair) for pair in self._propagator.held(time_ns).items()]
        if commands := self._commands_at(time_ns):
            torques.append(commands)
        return [torque for torque in torques if torque.values.any()
                and not 0 < self._timeout_ns <= time_ns - torque.stamp_ns
                - self._propagator.delay_ns(torque.source)]

    def _held(self, stamp_ns: int, source: int) -> Sample | None:
        """Return the sample of a source in force when a torque with a given stamp takes effect."""
        acts_ns = stamp_ns + self._propagator.delay_ns(source)
        return self._propagator.held(acts_ns).get(source)

    def _commands_at(self, time_ns: int) -> Torque | None:
        """
        Return the commands in force for all wheels at a given time, as a single `Torque`.

        The stamp of this torque is the newest stamp of these commands.
        """
        commands = self._propagator.commands_at(time_ns)
        return None if commands.stamp_ns == -NEVER_NS else Torque(
            commands.stamp_ns, np.array(commands.efforts), 'body', COMMANDS)

    def torques_since(self, time_ns: int) -> list[Torque]:
        """Return the torques in force at a given time and all later torques, sorted by stamp."""
        torques = [_torque(*pair) for pair in self._propagator.samples_since(time_ns)]
        torques += [Torque(stamp_ns, body.entries, 'body', BODY)
                    for stamp_ns, body, *_ in self._propagator.bodies_since(time_ns)]
        torques += [Torque(stamp_ns, self._wheels.row(efforts), 'body', COMMANDS)
                    for stamp_ns, efforts in self._propagator.commands_since(time_ns)]
        return sorted(torques, key=lambda torque: torque.stamp_ns)

    @property
    def must_commit(self) -> bool:
        """Return whether the next torque may discard states that are not committed yet."""
        return (self.newest_ns is not None and self._committed_ns
                < self.newest_ns - self.history_ns - _SLACK_NS)

    def uncommitted(self, until_ns: int) -> list[int]:
        """Return the stamps up to a given time whose states are not committed yet, sorted."""
        return self._propagator.stamps(self._committed_ns, until_ns)

    def mark_committed(self, time_ns: int) -> None:
        """Record that the states at all stamps up to a given time are committed."""
        self._committed_ns = time_ns

    def count_limited(self, state: State) -> int:
        """Return how many wheels are at their largest speed and give less than their command."""
        axial = state._axial
        if not isinstance(axial, Axial):
            return 0
        return int((state.wheel_efforts != axial.efforts).sum())

    def clipped(self, torque: Torque) -> int:
        """Return how many efforts of a wheel command were clipped; 0 for any other torque."""
        return self._wheels.count_clipped(torque.values) if torque.source == COMMANDS else 0


def _torque(source: int, sample: Sample) -> Torque:
    return Torque(sample.stamp_ns, np.ravel(sample.torque), 'space' if sample.in_space else 'body',
                  source)
