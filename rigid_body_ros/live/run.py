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

"""A node's run, with its epochs and the log of accepted torques and committed states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import time
from typing import NamedTuple, Protocol

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.live import events
from rigid_body_ros.live.epoch import Epoch
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation.segment import OutOfTimeError
from rigid_body_ros.propagation.sources import COMMANDS
from rigid_body_ros.scene import Scene

#: The queue depth of each log topic, and therefore the largest number of messages in one burst.
LOG_DEPTH = 10_000
#: How long the node may spend on computing the last states of an epoch, s.
_END_BUDGET = 0.2
_NO_TORQUE = np.zeros(3)
_NO_TORQUE.flags.writeable = False


class Snapshot(NamedTuple):
    """
    What the node publishes for one time.

    `sensed` is the state that the IMU reports at this time, which is one IMU delay old.
    """

    state: State
    sensed: State
    #: The torque that acts on the body, N m, body axes. This torque is zero if the scene has no
    #: actuators, and before the first epoch.
    torque: Floats = _NO_TORQUE


class RunLog(Protocol):
    """Protocol of an object that publishes the log of a run."""

    def begin_log(self, start: State) -> None:
        """Publish the marker of a new epoch, with its start state, to every torque log."""

    def log_torque(self, torque: Torque) -> None:
        """Log a torque that was accepted."""

    def log_state(self, state: State) -> None:
        """Log a state that no later torque can change."""

    def deliver(self, until: float) -> bool:
        """
        Wait until all subscribers have acknowledged the log.

        `until` is the time on the monotonic clock at which to stop waiting, s. The result is False
        if a subscriber has not acknowledged the log by this time.
        """


class Run:
    """
    The current epoch of a node, and the log of all its epochs.

    If `commit` or `state` takes longer than the caller can wait, it raises TimeoutError. To
    continue the work, call the same method again with the same arguments. Neither the results nor
    the order of the log depend on how many calls this takes.

    Parameters
    ----------
    scene : Scene
    log : RunLog
    events : events.Events

    Attributes
    ----------
    epoch : Epoch or None
    committed : State or None
        The latest state that has been logged. States are logged when they are final, which means
        that no later torque can change them.

    """

    def __init__(self, scene: Scene, log: RunLog, events: events.Events) -> None:
        self._scene, self._sink, self._events = scene, log, events
        self._delay_ns, self._has_actuators = scene.imu.delay_ns, bool(scene.actuators)
        self.epoch: Epoch | None = None
        self.committed: State | None = None
        #: The time at which the newest torque from each source arrived, ns.
        self._arrived_ns: dict[int, int] = {}

    def initial(self, time_ns: int) -> State:
        """
        Return the scene's initial state, including the wheel speeds, as a state at `time_ns`.

        The marker of every epoch needs these wheel speeds, because a parameter dump of the node
        contains only the speeds at the start of the last epoch.
        """
        start, wheels = replace(self._scene.start, time_ns=time_ns), self._scene.named_wheels
        others, speeds = start.rotor_momentum, np.array([wheel.initial_speed for wheel in wheels])
        if not others.any():
            return replace(start, wheel_speeds=speeds)
        total = sum((wheel.inertia * wheel.initial_speed * np.asarray(wheel.axis)
                     for wheel in wheels), others)
        # In a state with wheel speeds, a rotor momentum of zero means that there are no other
        # rotors.
        return replace(start, wheel_speeds=speeds, rotor_momentum=total) if total.any() else start

    def begin(self, start: State, torques: Sequence[Torque] = ()) -> None:
        """Begin an epoch and its log. The `torques` of an earlier epoch continue to act."""
        self.epoch = Epoch(self._scene, start, torques)
        self._arrived_ns = dict.fromkeys((torque.source for torque in torques), start.time_ns)
        self._sink.begin_log(start)
        for torque in torques:
            self._sink.log_torque(torque)
        self._log_state(start)

    def end(self, until: float | None = None) -> None:
        """
        Commit the remaining states of the epoch, and end it.

        `until` is the time on the monotonic clock at which to stop trying, s. If it is None, the
        time limit is 0.2 s from now.
        """
        if self.epoch is not None:
            self._finish(self.epoch, time.monotonic() + _END_BUDGET if until is None else until)
        self.epoch = None

    def apply(self, torque: Torque, arrived_ns: int) -> bool:
        """
        Apply a torque that arrived at `arrived_ns`, and return False if it is rejected.

        The torque is logged, too. Before you apply another one, call `commit` if `must_commit` is
        true.
        """
        epoch = self.present
        try:
            self.check_age(torque.stamp_ns)
            is_replacement = epoch.apply(torque)
        except events.RejectedError as rejected:
            self._events.reject(rejected, torque.source)
            return False
        except ValueError as error:  # the motion before the torque is too fast to compute
            self._events.reject(events.RejectedError(events.NO_STATE, str(error)), torque.source)
            return False
        self._arrived_ns[torque.source] = arrived_ns
        self._events.count(events.APPLIED, torque.source)
        if is_replacement:
            self._events.count(events.REPLACED, torque.source)
        if clipped := epoch.clipped(torque):
            self._events.count(events.CLIPPED, torque.source, clipped)
        self._sink.log_torque(torque)
        return True

    @property
    def must_commit(self) -> bool:
        """Return whether the next torque may discard states that are not committed yet."""
        return self.present.must_commit

    def commit(self, until: float) -> None:
        """
        Compute and log the states that no later torque can change any more.

        Raises
        ------
        TimeoutError
            The computation did not finish by `until`, a time on the monotonic clock, s.

        """
        if self.epoch is not None and self.epoch.newest_ns is not None:
            self._commit(self.epoch, self.epoch.newest_ns - self.epoch.history_ns, until)

    def state(self, time_ns: int, until: float) -> State | None:
        """
        Return the state at a given time. If it cannot be computed, report this and return None.

        Raises
        ------
        TimeoutError
            The computation did not finish by `until`, a time on the monotonic clock, s.

        """
        try:
            return self.present.at(time_ns, until - time.monotonic())
        except ValueError as error:
            self._events.event(events.NOT_COMPUTABLE,
                               f'cannot compute the state at {time_ns} ns: {error}')
            return None

    def snapshot(self, time_ns: int, until: float, with_sensed: bool = True,
                 with_torque: bool = True) -> Snapshot | None:
        """
        Return what to publish for a given time, or None if the state cannot be computed.

        If nobody needs the state that the IMU reports, or the torque that acts, omit them with
        `with_sensed` and `with_torque`. See `state` for the other arguments and errors.
        """
        state = sensed = self.state(time_ns, until)
        if state is not None and self._delay_ns and with_sensed:
            start_ns = self.present.start.time_ns
            sensed = self.state(max(time_ns - self._delay_ns, start_ns), until)
        if state is None or sensed is None:
            return None
        torque = self.present.applied_torque(state) \
            if self._has_actuators and with_torque else _NO_TORQUE
        return Snapshot(state, sensed, torque)

    def last_state(self, time_ns: int) -> State | None:
        """Return the state at a given time, or None if it cannot be computed within 0.2 s."""
        try:
            return self.state(time_ns, time.monotonic() + _END_BUDGET)
        except TimeoutError as error:
            self._events.event(events.MISSED, f'the present state takes too long: {error}')
            return None

    def check_age(self, stamp_ns: int) -> None:
        """Raise RejectedError if a stamp is older than the newest torque by `history` or more."""
        epoch = self.present
        newest_ns, history_ns = epoch.newest_ns, epoch.history_ns
        if newest_ns is not None and newest_ns - stamp_ns >= history_ns:
            raise events.RejectedError(
                events.LATE, f'{(newest_ns - stamp_ns) * 1e-9:.9g} s older than the newest torque '
                f'({newest_ns} ns), expected less than history ({history_ns * 1e-9:g} s)')

    def torques_since(self, time_ns: int) -> list[Torque]:
        """
        Return the torques that act at a given time, and all later ones.

        Raises
        ------
        RejectedError
            The time is earlier than the newest torque by `history` or more.

        """
        if self.epoch is None or self.epoch.newest_ns is None:
            return []
        self.check_age(time_ns)
        return self.epoch.torques_since(time_ns)

    def with_rotor_momentum(self, start: State, time_ns: int, default: State) -> State:
        """
        Return a start state that takes over the rotor momentum and the wheel speeds of this epoch.

        The momentum and the speeds are those at `time_ns`. If there is no epoch, or if the rotors
        have no motors, both are taken from `default` instead.
        """
        has_motors = self._scene.wheels or self._scene.named_wheels
        if self.epoch is not None and has_motors and time_ns > self.epoch.start.time_ns:
            default = self.last_state(time_ns) or default
        return replace(start, rotor_momentum=default.rotor_momentum,
                       wheel_speeds=default.wheel_speeds)

    def age(self, source: int, now_ns: int) -> float | None:
        """
        Return how long ago the newest torque of a source arrived, s.

        If no torque has arrived from the source yet, the result is None.
        """
        arrived_ns = self._arrived_ns.get(source)
        return None if arrived_ns is None else max(0.0, (now_ns - arrived_ns) * 1e-9)

    def silent(self, now_ns: int) -> list[Torque]:
        """Return the acting torques of sources that are silent for more than `stale_after`."""
        longest = self._scene.stale_after
        if self.epoch is None or not longest:
            return []
        return [torque for torque in self.epoch.acting_at(now_ns)
                if (self.age(torque.source, now_ns) or 0.0) > longest]

    @property
    def present(self) -> Epoch:
        """Return the epoch, which must have begun."""
        assert self.epoch is not None, 'no epoch has begun'
        return self.epoch

    def _commit(self, epoch: Epoch, until_ns: int, until: float) -> None:
        """Compute the states up to a given time, and mark them as committed."""
        for stamp_ns in epoch.uncommitted(until_ns):
            state = self.state(stamp_ns, until)
            epoch.mark_committed(stamp_ns)
            if state is not None:
                self._log_state(state)
                if limited := epoch.count_limited(state):
                    self._events.count(events.TOO_FAST, COMMANDS, limited)
            if time.monotonic() > until:  # the next call will continue from here
                raise OutOfTimeError(stamp_ns)

    def _finish(self, epoch: Epoch, until: float) -> None:
        """Commit the states of an epoch that could still have been changed by late torques."""
        last_ns = epoch.start.time_ns if epoch.newest_ns is None else epoch.newest_ns
        try:
            while stamps := epoch.uncommitted(last_ns)[:LOG_DEPTH]:  # at most the queue's depth
                self._commit(epoch, stamps[-1], until)
                self._sink.deliver(until)
        except OutOfTimeError as error:
            self._events.event(
                events.MISSED, f'{len(epoch.uncommitted(last_ns))} states are missing on '
                '~/committed, because computing them at the end of the epoch took too long: they '
                f'are computed up to {error.reached_ns} ns', events.ENDED)

    def _log_state(self, state: State) -> None:
        self._sink.log_state(state)
        self.committed = state
