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

"""Real-time mode, in which the node publishes the present state whenever a timer fires."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import time
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType, JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.timer import Timer
from rigid_body_ros import messages
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.live.events import (
    EarlyError,
    FUTURE,
    LATE,
    MISSED,
    NO_CLOCK,
    NOT_COMPUTABLE,
    RejectedError,
    TIME_JUMP,
)
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.torque_queue import Queued, Sender
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.node.clocks import (
    ArrivalStamps,
    check_stamp,
    ClockMonitor,
    JumpDetector,
    OTHER_CLOCK_NS,
)
from rigid_body_ros.node.mode import BUDGET, Mode
from rigid_body_ros.scene.parameters import ARRIVAL, REBASE, RESET

#: How long a torque waits for a /clock message that was sent before the torque but arrives after
#: the torque, in seconds.
_CLOCK_DELAY = 0.5


class Realtime(Mode):
    """Publish the state at the present time, `publish_rate` times per second."""

    several_publishers = ('torques of several publishers of one topic are not summed, and each '
                          'replaces the previous one; list a topic for each in torque_topics')

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._max_future_ns = duration_ns(self._scene.max_future, 'max_future')
        self._arrivals, self._monitor = ArrivalStamps(), ClockMonitor(self._node)
        self._is_simulated = self._node.get_parameter('use_sim_time').value
        self._clock = JumpDetector(self._node.get_clock(), self._is_simulated,
                                   duration_ns(self._scene.history, 'history'))
        self._rate = self._scene.publish_rate
        self._timer: Timer | None = None
        self._jumps: JumpHandle | None = None
        #: The time in ns of a state that must be published as soon as it has been computed, or 0
        #: if there is no such state.
        self._deferred_ns = 0
        #: When the next state will be overdue, in seconds on the monotonic clock.
        self._overdue_at = 0.0

    def activate(self) -> None:
        """Begin to publish states, and begin an epoch if there is none."""
        node_clock = self._node.get_clock()
        if self._is_simulated:  # rclpy does not report jumps of a wall clock
            ahead = Duration(nanoseconds=self._clock.most_ahead_ns)
            self._jumps = node_clock.create_jump_callback(
                JumpThreshold(min_forward=ahead, min_backward=Duration(nanoseconds=-1),
                              on_clock_change=False),
                pre_callback=self._hold_early_torques,
                post_callback=lambda jump: self._update())
        # A timer on a wall clock stops when the clock is set back, so use a steady timer instead.
        clock = node_clock if self._is_simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(1.0 / self._rate, self._publish_now, clock=clock)
        self._update()

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

    def enqueue(self, data: bytes, sender: Sender, source: int) -> None:
        """
        Queue a torque message from a source.

        Raises
        ------
        RejectedError
            The clock has no time yet, or too many torques are waiting.

        """
        self._valid_now_ns()
        self._queue.check_room()
        self._queue.put(Queued(source, data, sender, self._arrivals.stamp(), time.monotonic()))

    def process(self) -> bool:
        """Apply waiting torques for one slice of work. Return True if no work is left."""
        for cause in (FUTURE, LATE):
            while (first := self._queue.first_early(cause)) and not self._early_cause(first):
                self._queue.release(cause)
        is_done = super().process()
        if self._deferred_ns and not (self._current or self._queue):
            self._publish(self._deferred_ns)
        else:
            self.catch_up()
        return is_done and not self._deferred_ns

    def catch_up(self) -> None:
        """Publish the present state if many messages have delayed the timer for too long."""
        # With simulated time, leave the publication to the timer, because the timer follows the
        # clock, which may stand still.
        if self._timer and not self._is_simulated and self._is_overdue:
            self._publish_now()

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
        start = self.run.with_rotor_momentum(start, start.time_ns, self.run.epoch.start)
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
        except RejectedError:  # the clock was set back by `history` or more
            torques = []
        return self._begin(self.run.initial(now_ns), torques, 'reset')

    def now_ns(self) -> int:
        """Return the present time in ns, or 0 if the clock has no time yet."""
        return self._update()

    def problems(self) -> dict[int, list[str]]:
        """Return current problems by source. Problems of the clock belong to the first source."""
        now_ns, timeout = self._update(), self._scene.torque_timeout
        problems = {source: [] for source in self._torques}
        problems[next(iter(problems))] = self._monitor.problems()
        for source, subscription in self._torques.items() if now_ns else ():
            newest = self.run.epoch.newest_of(source)
            silence = (now_ns - newest.stamp_ns) * 1e-9 if newest else 0.0
            if silence > timeout > 0.0:
                problems[source].append(
                    f'{subscription.topic_name}: no torque for {silence:.3g} s: the torque is '
                    f'zero, because torque_timeout ({timeout:g} s) has passed')
        return problems

    def stamp(self) -> Time:
        """Return the present time."""
        return self._node.get_clock().now().to_msg()

    def end(self, until: float | None = None, kept: str = LATE) -> None:
        """End the epoch as `Mode.end` does, and drop any state that is waiting to be published."""
        self._deferred_ns = 0
        super().end(until, kept)

    def _read(self, queued: Queued) -> Torque | None:
        try:
            return self._decoded(queued)
        except EarlyError as early:
            self._queue.hold(queued, early.cause)
            return None

    def _early_cause(self, queued: Queued) -> str | None:
        """Return the reason why a torque is early, or None if it is not early."""
        try:
            self._decoded(queued)
        except EarlyError as early:
            return early.cause
        except RejectedError:
            pass  # `process` will reject and count this torque
        return None

    def _hold_early_torques(self) -> None:
        """Before the epoch ends, hold all queued torques that are early at the present time."""
        for queued in self._queue.pop_all():
            cause = self._early_cause(queued)
            if cause:
                self._queue.hold(queued, cause)
            else:
                self._queue.put(queued)

    def _decoded(self, queued: Queued) -> Torque:
        """
        Decode a torque, and check its stamp.

        Raises
        ------
        EarlyError
            The torque has to wait for the clock.
        RejectedError
            The torque or its stamp is not valid.

        """
        data = messages.unstamped(queued.data) if self._scene.time_source == ARRIVAL \
            else queued.data
        torque = self._inputs.torque(data, queued.source)
        if not torque.stamp_ns:
            torque = torque._replace(stamp_ns=queued.arrived_ns)
        if self._is_simulated:
            self._check_early(torque.stamp_ns, queued)
        else:
            self._check_stamp(torque.stamp_ns, queued.arrived_ns)
        return torque

    def _check_early(self, stamp_ns: int, queued: Queued) -> None:
        # A torque may overtake a /clock message that was sent before it. Until this message
        # arrives, the torque is ahead of the clock. If the /clock message sets the clock back, the
        # torque is not ahead of the clock, but too old for the present epoch.
        now_ns = self._node.get_clock().now().nanoseconds
        try:
            self._check_stamp(stamp_ns, now_ns)
            self.run.check_age(stamp_ns)
        except RejectedError as rejected:
            is_other_clock = stamp_ns - now_ns >= OTHER_CLOCK_NS
            if is_other_clock or time.monotonic() - queued.since >= _CLOCK_DELAY:
                raise
            raise EarlyError(rejected.cause, str(rejected)) from rejected

    @property
    def _is_overdue(self) -> bool:
        return time.monotonic() > self._overdue_at

    def _publish_now(self) -> None:
        now_ns = self._update()
        if not now_ns or now_ns < self.run.epoch.start.time_ns:
            return
        # Normally, waiting torques are applied before the state is published. But if the state is
        # overdue, publish it without them. Otherwise a flood of torques would keep the node from
        # publishing any state.
        if (self._current or self._queue) and not self._is_overdue:
            self._deferred_ns = now_ns
        else:
            self._publish(now_ns)

    def _publish(self, time_ns: int) -> None:
        """
        Publish the state at a given time.

        If one slice of work is enough to compute the state, it is published immediately. Otherwise
        `process` publishes it later. We cannot leave the state to the timer, because the timer
        does not fire again while simulated time stands still. If torques are waiting, they may
        change the state, so `process` publishes the state again once it has applied them.
        """
        self._deferred_ns = time_ns if self._current or self._queue else 0
        began = time.monotonic()
        try:
            snapshot = self.run.snapshot(time_ns, began + BUDGET)
        except TimeoutError as error:
            self._miss_deadline(error)
            self._deferred_ns = time_ns
            # Wait for ten slices, so that most of the time is left for messages, services and
            # torques.
            self._overdue_at = began + 10.0 * BUDGET
            self._wake()
            return
        now = time.monotonic()
        self._overdue_at = now + 1.0 / self._rate + 2.0 * (now - began)
        if snapshot is not None:
            self._outputs.publish(snapshot)

    def _miss_deadline(self, error: TimeoutError) -> None:
        self._diagnostics.event(MISSED, 'cannot keep up: the body spins too fast, or late torques '
                                f'force too much recomputation; {error}')

    def _valid_now_ns(self) -> int:
        now_ns = self._update()
        if not now_ns:
            raise RejectedError(NO_CLOCK, 'no time was received on /clock yet')
        return now_ns

    def _update(self) -> int:
        """
        Read the clock, and return its time in ns, or 0 if it has no time yet.

        If there is no epoch, or if the clock has jumped, the method may begin a new epoch.
        """
        now_ns, jump_ns = self._clock.read()
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
        state = self._checkpoint and self._checkpoint.start
        if not state:
            self._begin(self.run.initial(self._given_start_ns or now_ns), (), 'start')
            return
        away_ns = now_ns - state.time_ns
        if away_ns < -self._max_future_ns:
            raise InputError(f'checkpoint {self._checkpoint}: expected a state from before '
                             f'{now_ns} ns, the present time, found one from {state.time_ns} ns; '
                             'remove the file to start from the initial state')
        self._begin(state, (), f'start from the checkpoint {self._checkpoint}')
        self._warn_away(max(0, away_ns) * 1e-9)

    def _jump(self, latest_ns: int, now_ns: int) -> None:
        action, is_ahead = self._scene.on_time_jump, now_ns > latest_ns
        text = f'clock jumped {"ahead" if is_ahead else "back"}'
        self._diagnostics.event(TIME_JUMP, f'the {text} by {abs(now_ns - latest_ns) * 1e-9:.9g} s '
                                f'to {now_ns} ns; on_time_jump: {action}')
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
            self._diagnostics.event(NOT_COMPUTABLE, 'on_time_jump: the current state cannot be '
                                    'computed; the motion starts again from the initial state')
            return False
        # Shift the stamps by the jump, so that the torques keep their age. The age matters for the
        # torque timeout.
        torques = [torque._replace(stamp_ns=max(1, torque.stamp_ns + now_ns - latest_ns))
                   for torque in self.run.epoch.torques_since(latest_ns)
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
        if self.run.epoch is not None:  # otherwise the queued torques belong to the new epoch
            self.end(kept=FUTURE if is_ahead else LATE)
        self.run.begin(start, torques)
        self._parameters.set_start(start)
        text = f'{reason}: a new epoch begins at {start.time_ns} ns'
        self._node.get_logger().info(text)
        return text

    def _check_stamp(self, stamp_ns: int, now_ns: int) -> None:
        check_stamp(stamp_ns, now_ns, self._scene.max_future)
