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

"""
Real-time mode, in which the node publishes the present state whenever a timer fires.

Nobody waits for the response to a torque, so the node takes torques in batches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.clock import JumpHandle, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.timer import Timer
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.live import events
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.torque_queue import Queued
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.node import clocks
from rigid_body_ros.node.mode import BUDGET, Mode
from rigid_body_ros.node.outputs import APPLIED_TORQUE, IMU
from rigid_body_ros.node.process import timer
from rigid_body_ros.propagation.segment import OutOfTimeError
from rigid_body_ros.scene.parameters import REBASE, RESET

#: How often to take the torques that have arrived, in seconds. They are also taken before a state
#: is published.
_POLL_PERIOD = 0.02
#: How long a torque waits for a /clock message that was sent before the torque but arrives after
#: the torque, in seconds.
_CLOCK_DELAY = 0.5
#: If this process uses more than this share of a processor, the cause of a delay is its own work.
_BUSY = 0.5


class Realtime(Mode):
    """Publish the state at the present time, `publish_rate` times per second."""

    several_publishers = ('torques of several publishers of one topic are not summed, and each '
                          'replaces the previous one; list a topic for each in torque_topics')

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._max_future_ns = duration_ns(self._scene.max_future, 'max_future')
        self._is_simulated = self._node.get_parameter('use_sim_time').value
        self._arrivals = clocks.ArrivalStamps(self._is_simulated)
        self._clock = clocks.WatchedClock(self._node.get_clock(), self._is_simulated,
                                          duration_ns(self._scene.history, 'history'))
        self._rate = self._scene.publish_rate
        self._timer: Timer | None = None
        self._jumps: JumpHandle | None = None
        self._now_ns, self._taken_at = 0, 0.0
        #: The time in ns of a state that must be published as soon as it has been computed, or 0
        #: if there is no such state, and the time of the state that was published last.
        self._deferred_ns = self._published_ns = 0
        #: When a state was last published on time, in seconds on the monotonic clock, and the
        #: processor time in seconds that this process had used by then.
        self._on_time = time.monotonic(), time.process_time()

    def activate(self) -> None:
        """Begin to publish states, and begin an epoch if there is none."""
        node_clock = self._node.get_clock()
        if self._is_simulated:  # rclpy does not report jumps of a wall clock
            ahead = Duration(nanoseconds=self._clock.most_ahead_ns)
            self._jumps = node_clock.create_jump_callback(
                JumpThreshold(min_forward=ahead, min_backward=Duration(nanoseconds=-1),
                              on_clock_change=False),
                pre_callback=self.work,
                post_callback=self._on_jump)
        # A timer on a wall clock stops when the clock is set back, so use a steady timer instead.
        self._timer = timer(self._node, 1.0 / self._rate, self._publish_now,
                            node_clock if self._is_simulated else None)
        self._poll_timer()

    def _on_jump(self, jump: TimeJump) -> None:
        self.now_ns()

    def _poll_timer(self) -> None:
        timer(self._node, _POLL_PERIOD, self._poll)
        self.now_ns()

    def deactivate(self) -> None:
        """Stop publishing. The owner of the node destroys the timer."""
        self._timer = None
        if self._jumps:
            self._jumps.unregister()

    def set_rate(self, rate: float) -> None:
        """Change the publishing rate, Hz."""
        self._rate = rate
        if self._timer:
            self._timer.timer_period_ns = duration_ns(1.0 / rate, 'publish_rate')
            self._timer.reset()  # otherwise the next call is due after the old period

    def _arrived_ns(self, received_ns: int) -> int:
        if not self._now_ns:
            raise events.RejectedError(events.NO_CLOCK, events.NO_TIME)
        return self._arrivals.stamp(max(0, time.time_ns() - received_ns) if received_ns else 0)

    def take(self) -> None:
        """Take the torques that have arrived."""
        self._taken_at = time.monotonic()
        self.now_ns()
        self._queue.retry()
        self.intake.poll()

    def work(self) -> None:
        """Take and apply torques, and publish a state that could not be computed in time."""
        self.take()
        self.process()
        self.settle()
        if self._deferred_ns:
            self._publish(self._deferred_ns)

    def _poll(self) -> None:
        # Before a state is published, torques are taken, too. Large batches take less time.
        if self._deferred_ns or len(self._queue) \
                or time.monotonic() > self._taken_at + _POLL_PERIOD:
            self.work()

    def set_state(self, state: State) -> str:
        """
        Begin a new epoch with the given attitude and body rates, and return a description of it.

        The rotors keep their momentum.

        Raises
        ------
        RejectedError
            The clock has no time yet. The error is also raised if the stamp of the state is too
            far ahead of the clock or too far behind it, or if the state is older than the newest
            torque by `history` or more.

        """
        now_ns = self._valid_now_ns()
        start = replace(state, time_ns=state.time_ns or now_ns)
        self._check_stamp(start.time_ns, now_ns)
        torques = self.run.torques_since(start.time_ns)
        start = self.run.with_rotor_momentum(start, start.time_ns, self.run.present.start)
        return self._begin(start, torques, 'initial_state received')

    def reset(self) -> str:
        """
        Begin a new epoch with the initial state, and return a text that describes the epoch.

        Raises
        ------
        RejectedError
            The clock has no time yet.

        """
        now_ns = self._valid_now_ns()
        try:
            torques = self.run.torques_since(now_ns)
        except events.RejectedError:  # the clock was set back by `history` or more
            torques = []
        return self._begin(self.run.initial(now_ns), torques, 'reset')

    def problems(self) -> dict[int, list[str]]:
        """Return current problems by source. Problems of the clock belong to the first source."""
        now_ns, timeout = self.now_ns(), self._scene.torque_timeout
        problems = self.intake.problems()
        problems[self.intake.first] += self._clock.problems()
        for source in problems if now_ns else ():
            newest = self.run.present.newest_of(source)
            silence = (now_ns - newest.stamp_ns) * 1e-9 if newest else 0.0
            if silence > timeout > 0.0:
                problems[source].append(
                    f'{self.intake.topic(source)}: no torque for {silence:.3g} s: the torque is '
                    f'zero, because torque_timeout ({timeout:g} s) has passed')
        return problems

    def stamp(self) -> Time:
        """Return the present time."""
        return self._node.get_clock().now().to_msg()

    def end(self, until: float | None = None, kept: str = events.LATE) -> None:
        """End the epoch as `Mode.end` does, and drop any state that is waiting to be published."""
        self._deferred_ns = 0
        super().end(until, kept)

    def _read(self, queued: Queued) -> Torque | None:
        torque = self.intake.read(self.intake.inputs.torque, queued.data, queued.source,
                                  queued.arrived_ns)
        now_ns = self._now_ns if self._is_simulated else queued.arrived_ns
        try:
            self._check_stamp(torque.stamp_ns, now_ns)
            self.run.check_age(torque.stamp_ns)
        except events.RejectedError as rejected:
            # A torque may overtake a /clock message that was sent before it. Until this message
            # arrives, the torque is ahead of the clock. If the /clock message sets the clock back,
            # the torque is not ahead of the clock, but too old for the present epoch.
            if not (self._is_simulated and torque.stamp_ns - now_ns < clocks.OTHER_CLOCK_NS
                    and time.monotonic() - queued.since < _CLOCK_DELAY):
                raise
            self._queue.hold(queued, rejected.cause)
            return None
        self._diagnostics.offset(torque.source, torque.stamp_ns - queued.arrived_ns)
        return torque

    def _publish_now(self) -> None:
        self._deferred_ns = 0
        self.work()
        if self._now_ns and self._now_ns >= self.run.present.start.time_ns:
            self._publish(self._now_ns)
        if not self._deferred_ns:
            self._on_time = time.monotonic(), time.process_time()

    def _publish(self, time_ns: int) -> None:
        """
        Publish the state at a given time, or the newest state that one slice of work can compute.

        In the second case, and if waiting torques may still change the state, `work` publishes it
        again. We cannot leave this to the timer, because the timer does not fire again while
        simulated time stands still.
        """
        self._deferred_ns = time_ns if self._current or self._queue else 0
        listened = self._outputs.listened
        if not listened:
            return
        needed = IMU in listened, APPLIED_TORQUE in listened
        try:
            snapshot = self.run.snapshot(time_ns, time.monotonic() + BUDGET, *needed)
        except OutOfTimeError as error:
            self._miss_deadline(error)
            self._deferred_ns, time_ns = time_ns, error.reached_ns
            if time_ns <= self._published_ns:  # a late torque changed earlier states
                return
            snapshot = self.run.snapshot(time_ns, math.inf, *needed)
        if snapshot is not None:
            self._published_ns = time_ns
            self._outputs.publish(snapshot, listened)

    def _miss_deadline(self, error: OutOfTimeError) -> None:
        elapsed = time.monotonic() - self._on_time[0]
        share = (time.process_time() - self._on_time[1]) / max(elapsed, BUDGET)
        why = 'the body spins too fast, or late torques force too much recomputation' \
            if share > _BUSY else 'other processes keep the processor busy'
        lag = (self._now_ns - error.reached_ns) * 1e-9
        self._diagnostics.event(events.MISSED, (
            f'cannot keep up: {why}; the states are {lag:.3g} s late, {self.waiting.total()} '
            f'torques wait, and computing took {share:.0%} of the last {elapsed:.2g} s'))

    def _valid_now_ns(self) -> int:
        """Return the present time in ns, once the torques that arrived before are applied."""
        self.work()
        if not self._now_ns:
            raise events.RejectedError(events.NO_CLOCK, events.NO_TIME)
        return self._now_ns

    def now_ns(self) -> int:
        """
        Read the clock, and return its time in ns, or 0 if it has no time yet.

        If there is no epoch, or if the clock has jumped, the method may begin a new epoch.
        """
        now_ns, jump_ns = self._clock.read()
        self._now_ns = now_ns
        if not now_ns:  # simulated time, before the first message has arrived on /clock
            return 0
        self._arrivals.tick(now_ns)
        if self.run.epoch is None:
            self._start(now_ns)
        elif jump_ns:
            self._jump(now_ns - jump_ns, now_ns)
        return now_ns

    def _start(self, now_ns: int) -> None:
        """Begin the first epoch with the state in the checkpoint, or else the initial state."""
        if not self._saved:
            self._begin(self.run.initial(self._given_start_ns or now_ns), (), 'start')
            return
        away_ns = now_ns - self._saved.time_ns
        if away_ns < -self._max_future_ns:
            raise InputError(f'checkpoint {self._checkpoint}: expected a state from before '
                             f'{now_ns} ns, the present time, found one from '
                             f'{self._saved.time_ns} ns; remove the file to start from the '
                             'initial state')
        self._begin(self._saved, (), f'start from the checkpoint {self._checkpoint}')
        self._warn_away(max(0, away_ns) * 1e-9)

    def _jump(self, latest_ns: int, now_ns: int) -> None:
        action, is_ahead = self._scene.on_time_jump, now_ns > latest_ns
        text = f'clock jumped {"ahead" if is_ahead else "back"}'
        seconds = abs(now_ns - latest_ns) * 1e-9
        self._diagnostics.event(events.TIME_JUMP, f'the {text} by {seconds:.9g} s to {now_ns} ns; '
                                f'on_time_jump: {action}')
        if action == REBASE and self._rebase(latest_ns, now_ns, text):
            return
        if action in (REBASE, RESET):
            start_ns = self._given_start_ns if self._is_simulated else 0
            # After a jump ahead, do not start before the present time. Otherwise the node would
            # have to compute the motion during the jump.
            start_ns = max(start_ns, now_ns) if is_ahead else start_ns or now_ns
            self._begin(self.run.initial(start_ns), (), text, is_ahead)

    def _rebase(self, latest_ns: int, now_ns: int, text: str) -> bool:
        state = self.run.last_state(latest_ns)
        if state is None:
            self._diagnostics.event(events.NOT_COMPUTABLE, 'on_time_jump: the current state '
                                    'cannot be computed; the motion starts again from the initial '
                                    'state')
            return False
        # Shift the stamps by the jump, so that the torques keep their age. The age matters for the
        # torque timeout.
        torques = [torque._replace(stamp_ns=max(1, torque.stamp_ns + now_ns - latest_ns))
                   for torque in self.run.present.torques_since(latest_ns)
                   if torque.stamp_ns <= latest_ns]
        start = State(now_ns, state.attitude, state.angular_velocity, state.rotor_momentum,
                      state.wheel_speeds)
        self._begin(start, torques, f'{text}, state kept', now_ns > latest_ns)
        return True

    def _begin(self, start: State, torques: Sequence[Torque], reason: str,
               is_ahead: bool = False) -> str:
        """
        Begin an epoch, and return a text that describes it.

        `torques` contains torques that were applied earlier and still act. Early torques that were
        sent after a clock jump stay in the queue. If the clock jumped ahead, these are the torques
        that were ahead of the clock. Otherwise, they are the torques that were too old for the
        previous epoch.
        """
        self._begin_epoch(start, torques, events.FUTURE if is_ahead else events.LATE)
        self._published_ns = 0
        text = f'{reason}: a new epoch begins at {start.time_ns} ns'
        self._node.get_logger().info(text)
        return text

    def _check_stamp(self, stamp_ns: int, now_ns: int) -> None:
        clocks.check_stamp(stamp_ns, now_ns, self._scene.max_future, max_past=self._scene.max_past)
