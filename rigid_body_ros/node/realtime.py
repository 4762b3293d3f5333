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

"""Real time: a timer publishes the state at the present time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import time

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType, JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.node.clocks import ArrivalStamps, ClockMonitor, JumpDetector
from rigid_body_ros.node.diagnostics import Diagnostics, NOT_COMPUTABLE, TIME_JUMP
from rigid_body_ros.node.drain import Sender
from rigid_body_ros.node.epoch import Torque
from rigid_body_ros.node.inputs import (
    EarlyError,
    FUTURE,
    Inputs,
    LATE,
    NO_CLOCK,
    QueuedMessage,
    RejectedError,
)
from rigid_body_ros.node.outputs import Outputs
from rigid_body_ros.node.parameters import Parameters
from rigid_body_ros.node.pipeline import Pipeline
from rigid_body_ros.scene import ARRIVAL, REBASE, RESET
from rigid_body_ros.state import State

#: A stamp further ahead of or behind the clock is assumed to come from another clock.
_OTHER_CLOCK_NS = 3600 * 10 ** 9
_ADVICE = ('; if the torques come from a bag, play it with --clock and set use_sim_time, or set '
           'time_source:=arrival')
#: s; how long a torque waits for a /clock message that was sent before it.
_CLOCK_DELAY = 0.5


class Realtime:
    """Publish the state at the present time, at a rate."""

    several_publishers = ('torques of several publishers of one topic are not summed, and each '
                          'replaces the previous one; list a topic for each in torque_topics')

    def __init__(self, node: Node, parameters: Parameters, inputs: Inputs, outputs: Outputs,
                 diagnostics: Diagnostics) -> None:
        self._node, self._parameters = node, parameters
        self._inputs, self._diagnostics = inputs, diagnostics
        self._values = parameters.scene.values
        self._given_start_ns = parameters.scene.start.time_ns
        self._max_future_ns = duration_ns(self._values['max_future'], 'max_future')
        self.pipeline = Pipeline(parameters.scene, outputs, diagnostics, self._read)
        self._arrivals, self._monitor = ArrivalStamps(), ClockMonitor(node)
        self._torques: Mapping[int, Subscription] = {}
        self._is_simulated = node.get_parameter('use_sim_time').value
        self._clock = JumpDetector(node.get_clock(), self._is_simulated,
                                   duration_ns(self._values['history'], 'history'))
        self._rate = self._values['publish_rate']
        self._timer: Timer | None = None
        self._jumps: JumpHandle | None = None

    def activate(self) -> None:
        """Begin to publish, with an epoch if there is none."""
        node_clock = self._node.get_clock()
        if self._is_simulated:  # rclpy does not report jumps of a wall clock
            ahead = Duration(nanoseconds=self._clock.most_ahead_ns)
            self._jumps = node_clock.create_jump_callback(
                JumpThreshold(min_forward=ahead, min_backward=Duration(nanoseconds=-1),
                              on_clock_change=False),
                pre_callback=self.pipeline.hold_early_torques,
                post_callback=lambda jump: self._update())
        # If a wall clock is set back, a timer that follows it stops; a steady timer does not.
        clock = node_clock if self._is_simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(1.0 / self._rate, self._publish, clock=clock)
        self._update()

    def deactivate(self) -> None:
        """Stop publishing; the owner of the node destroys the timer."""
        self._timer = None
        if self._jumps:
            self._jumps.unregister()

    def connect(self, torques: Mapping[int, Subscription]) -> None:
        """Set the subscriptions to torques by source; the timer runs without publishers, too."""
        self._torques = torques

    def set_rate(self, rate: float) -> None:
        """Publish at another rate, Hz."""
        self._rate = rate
        if self._timer:
            self._timer.timer_period_ns = duration_ns(1.0 / rate, 'publish_rate')
            self._timer.reset()  # otherwise the next call is due after the old period

    def enqueue(self, data: bytes, sender: Sender, source: int) -> None:
        """
        Queue a torque message of a source from any sender.

        Raises
        ------
        RejectedError
            There is no time yet, or too many torques wait.

        """
        self._valid_now_ns()
        self.pipeline.enqueue(data, sender, self._arrivals.stamp(), source)

    def set_state(self, state: State) -> str:
        """
        Begin an epoch with an attitude and body rates, and return a description.

        The rotors keep their momentum.

        Raises
        ------
        RejectedError
            There is no time yet, or the stamp of the state is too far ahead of the clock, too far
            behind it, or older than the newest torque by `history` or more.

        """
        now_ns = self._valid_now_ns()
        start = replace(state, time_ns=state.time_ns or now_ns)
        self._check_stamp(start.time_ns, now_ns)
        torques = self.pipeline.torques_since(start.time_ns)
        start = self.pipeline.with_rotor_momentum(start, start.time_ns, self.pipeline.epoch.start)
        return self._begin(start, torques, 'initial_state received')

    def reset(self) -> str:
        """
        Begin an epoch with the initial state, and return a description.

        Raises
        ------
        RejectedError
            There is no time yet.

        """
        now_ns = self._valid_now_ns()
        try:
            torques = self.pipeline.torques_since(now_ns)
        except RejectedError:  # the clock was set back by `history` or more
            torques = []
        return self._begin(self.pipeline.initial(now_ns), torques, 'reset')

    def problems(self) -> list[str]:
        """Return the present problems."""
        problems = self._monitor.problems()
        now_ns = self._update()
        if not now_ns:
            return problems
        timeout = self._values['torque_timeout']
        for source, subscription in self._torques.items():
            newest_ns = self.pipeline.epoch.newest_of(source)
            silence = 0.0 if newest_ns is None else (now_ns - newest_ns) * 1e-9
            if silence > timeout > 0.0:
                problems.append(f'{subscription.topic_name}: no torque for {silence:.3g} s: the '
                                f'torque is zero, because torque_timeout ({timeout:g} s) has '
                                'passed')
        return problems

    def stamp(self) -> Time:
        """Return the present time."""
        return self._node.get_clock().now().to_msg()

    def _read(self, message: QueuedMessage) -> Torque:
        torque = self._inputs.torque(message.data, message.source)
        if not torque.stamp_ns or self._values['time_source'] == ARRIVAL:
            torque = torque._replace(stamp_ns=message.time_ns)
        if self._is_simulated:
            self._check_early(torque.stamp_ns, message)
        else:
            self._check_stamp(torque.stamp_ns, message.time_ns)
        return torque

    def _check_early(self, stamp_ns: int, message: QueuedMessage) -> None:
        # A torque may overtake the /clock message that was sent before it. It is then ahead of
        # the clock, or, if that message sets the clock back, too old for the present epoch.
        now_ns = self._node.get_clock().now().nanoseconds
        try:
            self._check_stamp(stamp_ns, now_ns)
            self.pipeline.check_age(stamp_ns)
        except RejectedError as rejected:
            is_other_clock = stamp_ns - now_ns >= _OTHER_CLOCK_NS
            if is_other_clock or time.monotonic() - message.since >= _CLOCK_DELAY:
                raise
            raise EarlyError(rejected.cause, str(rejected)) from rejected

    def _publish(self) -> None:
        now_ns = self._update()
        if now_ns and now_ns >= self.pipeline.epoch.start.time_ns:
            self.pipeline.publish(now_ns)

    def _valid_now_ns(self) -> int:
        now_ns = self._update()
        if not now_ns:
            raise RejectedError(NO_CLOCK, 'no time was received on /clock yet')
        return now_ns

    def _update(self) -> int:
        """Read the clock, and begin an epoch if necessary; return the time, ns, or 0 if none."""
        now_ns, jump_ns = self._clock.read()
        if not now_ns:  # simulated time before the first message on /clock
            return 0
        self._arrivals.tick(now_ns)
        if self.pipeline.epoch is None:
            self._begin(self.pipeline.initial(self._given_start_ns or now_ns), (), 'start')
        elif jump_ns:
            self._jump(now_ns - jump_ns, now_ns)
        return now_ns

    def _jump(self, latest_ns: int, now_ns: int) -> None:
        action, is_ahead = self._values['on_time_jump'], now_ns > latest_ns
        text = f'clock jumped {"ahead" if is_ahead else "back"}'
        self._diagnostics.event(TIME_JUMP, f'the {text} by {abs(now_ns - latest_ns) * 1e-9:.9g} s '
                                f'to {now_ns} ns; on_time_jump: {action}')
        if action == REBASE and self._rebase(latest_ns, now_ns, text):
            return
        if action in (REBASE, RESET):
            start_ns = self._given_start_ns if self._is_simulated else 0
            # A start before a jump ahead would integrate all the time between them.
            start_ns = max(start_ns, now_ns) if is_ahead else start_ns or now_ns
            self._begin(self.pipeline.initial(start_ns), (), text, is_ahead)

    def _rebase(self, latest_ns: int, now_ns: int, text: str) -> bool:
        state = self.pipeline.last_state(latest_ns)
        if state is None:
            self._diagnostics.event(NOT_COMPUTABLE, 'on_time_jump: the current state cannot be '
                                    'computed; the motion starts again from the initial state')
            return False
        # Shift the stamp, so that the torque keeps its age for torque_timeout.
        torques = [torque._replace(stamp_ns=max(1, torque.stamp_ns + now_ns - latest_ns))
                   for torque in self.pipeline.epoch.torques_since(latest_ns)
                   if torque.stamp_ns <= latest_ns]
        start = State(now_ns, state.attitude, state.angular_velocity, state.rotor_momentum)
        self._begin(start, torques, f'{text}, state kept', now_ns > latest_ns)
        return True

    def _begin(self, start: State, torques: Sequence[Torque], reason: str,
               is_ahead: bool = False) -> str:
        self.pipeline.begin(start, torques, is_ahead)
        self._parameters.set_start(start)
        text = f'{reason}: a new epoch begins at {start.time_ns} ns'
        self._node.get_logger().info(text)
        return text

    def _check_stamp(self, stamp_ns: int, now_ns: int) -> None:
        ahead_ns = stamp_ns - now_ns
        advice = _ADVICE if abs(ahead_ns) > _OTHER_CLOCK_NS else ''
        if ahead_ns > self._max_future_ns:
            raise RejectedError(FUTURE, f'stamped {ahead_ns * 1e-9:.9g} s ahead of the clock, '
                                f'expected at most max_future '
                                f'({self._values["max_future"]:g} s){advice}')
        if advice:
            raise RejectedError(LATE,
                                f'stamped {-ahead_ns * 1e-9:.9g} s behind the clock{advice}')
