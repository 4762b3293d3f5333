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

"""Real time: the clock asks for the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import time

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription
from rigid_body_ros.body import State
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.node.arrivals import Sender
from rigid_body_ros.node.clocks import ArrivalStamps, ClockWatch
from rigid_body_ros.node.epoch import Torque
from rigid_body_ros.node.health import Health, TIME_JUMP, UNKNOWN
from rigid_body_ros.node.inputs import (
    Arrival,
    EarlyError,
    FUTURE,
    Inputs,
    LATE,
    NO_CLOCK,
    RefusedError,
)
from rigid_body_ros.node.motion import Motion
from rigid_body_ros.node.outputs import Outputs
from rigid_body_ros.node.parameters import Parameters
from rigid_body_ros.scene import ARRIVAL, REBASE, RESET

#: A stamp further behind or ahead is that of another clock.
_OTHER_CLOCK_NS = 3600 * 10 ** 9
_ADVICE = ('; torques of a bag? Play it with --clock and set use_sim_time, or set '
           'time_source:=arrival')
#: s; how long a torque waits for a message of /clock that was sent before it.
_CLOCK_DELAY = 0.5
#: A clock that leaps ahead by more is worth a word.
_LEAP_NS = 10 ** 9


class Realtime:
    """Publishes the state at the present time, at a rate."""

    several_publishers = 'they do not add up: each torque holds only until the next one'

    def __init__(self, node: Node, parameters: Parameters, inputs: Inputs, outputs: Outputs,
                 health: Health) -> None:
        self._node, self._parameters = node, parameters
        self._inputs, self._health = inputs, health
        self._values = parameters.scene.values
        self._given_start_ns = parameters.scene.start.time_ns
        self._max_future_ns = duration_ns(self._values['max_future'], 'max_future')
        self.motion = Motion(parameters.scene, outputs, health, self._read)
        self._latest_ns = 0
        self._arrivals, self._watch = ArrivalStamps(), ClockWatch(node)
        self._simulated = node.get_parameter('use_sim_time').value
        # A wall clock may be set back, which would stop a timer that follows it.
        pace = node.get_clock() if self._simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(1.0 / self._values['publish_rate'], self._publish,
                                        clock=pace)
        self._now_ns()

    def connect(self, torques: Subscription) -> None:
        """Nothing: the clock sets the pace, whoever is connected."""

    def set_rate(self, rate: float) -> None:
        """Publish at another rate, Hz."""
        self._timer.timer_period_ns = round(1e9 / rate)
        self._timer.reset()  # or the next call keeps the time it was due

    def take(self, data: bytes, sender: Sender) -> None:
        """
        Take a torque as it arrives, from any sender.

        Raises
        ------
        RefusedError
            There is no time yet, or too many wait.

        """
        self._valid_now_ns()
        self.motion.take(data, sender, self._arrivals.stamp())

    def set_state(self, state: State) -> None:
        """
        Begin an epoch with a state.

        Raises
        ------
        RefusedError
            There is no time yet, or that of the state is impossible.

        """
        now_ns = self._valid_now_ns()
        start = replace(state, time_ns=state.time_ns or now_ns)
        self._check_stamp(start.time_ns, now_ns)
        self._open(start, self.motion.in_force(start.time_ns), 'as told')

    def reset(self) -> str:
        """
        Begin an epoch with the initial state, and say so.

        Raises
        ------
        RefusedError
            There is no time yet.

        """
        now_ns = self._valid_now_ns()
        try:
            torques = self.motion.in_force(now_ns)
        except RefusedError:  # the clock was set back, and what was in force then is forgotten
            torques = []
        return self._open(self.motion.initial(now_ns), torques, 'reset')

    def check(self) -> list[str]:
        """Return what is wrong at present."""
        problems = self._watch.check()
        if not self._now_ns():
            return problems
        newest_ns = self.motion.epoch.newest_ns
        silent_s = 0.0 if newest_ns is None else (self._latest_ns - newest_ns) * 1e-9
        if silent_s > self._values['torque_timeout'] > 0.0:
            problems.append(f'silent for {silent_s:.3g} s: the torque timed out')
        return problems

    def stamp(self) -> Time:
        """Return the time of now."""
        return self._node.get_clock().now().to_msg()

    def _read(self, arrival: Arrival) -> Torque:
        torque = self._inputs.torque(arrival.data)
        if not torque.stamp_ns or self._values['time_source'] == ARRIVAL:
            torque = torque._replace(stamp_ns=arrival.time_ns)
        try:
            self._check_stamp(torque.stamp_ns, arrival.time_ns)
        except RefusedError as refused:
            self._check_again(torque.stamp_ns, arrival, refused)
        return torque

    def _check_again(self, stamp_ns: int, arrival: Arrival, refused: RefusedError) -> None:
        # A torque may overtake the message of /clock that was sent before it.
        if not self._simulated or refused.cause != FUTURE:
            raise refused
        now_ns = self._node.get_clock().now().nanoseconds
        if _OTHER_CLOCK_NS > stamp_ns - now_ns > self._max_future_ns \
                and time.monotonic() - arrival.since < _CLOCK_DELAY:
            raise EarlyError(FUTURE, str(refused))
        self._check_stamp(stamp_ns, now_ns)

    def _publish(self) -> None:
        now_ns = self._now_ns()
        if now_ns and now_ns >= self.motion.epoch.start.time_ns:
            self.motion.publish(now_ns)

    def _valid_now_ns(self) -> int:
        now_ns = self._now_ns()
        if not now_ns:
            raise RefusedError(NO_CLOCK, 'a message came before the first of /clock')
        return now_ns

    def _now_ns(self) -> int:
        """Return the time, with an epoch open, or 0 while there is none."""
        now_ns = self._node.get_clock().now().nanoseconds
        if not now_ns:  # simulated time before the first message of /clock
            return 0
        latest_ns, self._latest_ns = self._latest_ns, now_ns
        self._arrivals.tick(now_ns)
        # A wall clock is set back by a little now and then; late torques may be, too.
        slack_ns = 0 if self._simulated or not self.motion.epoch else self.motion.epoch.history_ns
        if self.motion.epoch is None:
            self._open(self.motion.initial(self._given_start_ns or now_ns), (), 'start')
        elif latest_ns - now_ns > slack_ns:
            self._jump_back(latest_ns, now_ns)
        elif now_ns - latest_ns > _LEAP_NS + 2 * self._timer.timer_period_ns:
            self._health.event(TIME_JUMP, f'the clock leapt ahead by '
                               f'{(now_ns - latest_ns) * 1e-9:.9g} s; the motion goes on under '
                               'the last torque')
        return now_ns

    def _jump_back(self, latest_ns: int, now_ns: int) -> None:
        action = self._values['on_time_jump']
        self._health.event(TIME_JUMP, f'the clock jumped back by {(latest_ns - now_ns) * 1e-9:.9g}'
                           f' s to {now_ns} ns; on_time_jump: {action}')
        if action == REBASE and self._rebase(latest_ns, now_ns):
            return
        if action in (REBASE, RESET):
            start_ns = self._given_start_ns if self._simulated else 0
            self._open(self.motion.initial(start_ns or now_ns), (), 'clock jumped back')

    def _rebase(self, latest_ns: int, now_ns: int) -> bool:
        state = self.motion.last(latest_ns)
        if state is None:
            self._health.event(UNKNOWN, 'no state to go on from: back to the initial one')
            return False
        # Its age stays what it was, for torque_timeout.
        torques = [torque._replace(stamp_ns=max(1, torque.stamp_ns + now_ns - latest_ns))
                   for torque in self.motion.epoch.since(latest_ns)[:1]
                   if torque.stamp_ns <= latest_ns]
        self._open(State(now_ns, state.attitude, state.angular_velocity), torques, 'rebased')
        return True

    def _open(self, start: State, torques: Sequence[Torque], why: str) -> str:
        self.motion.begin(start, torques)
        self._parameters.report(start)
        text = f'{why}: a new epoch begins at {start.time_ns} ns'
        self._node.get_logger().info(text)
        return text

    def _check_stamp(self, stamp_ns: int, now_ns: int) -> None:
        ahead_ns = stamp_ns - now_ns
        advice = _ADVICE if abs(ahead_ns) > _OTHER_CLOCK_NS else ''
        if ahead_ns > self._max_future_ns:
            raise RefusedError(FUTURE, f'stamped {ahead_ns * 1e-9:.9g} s ahead of the clock, '
                               f'expected at most max_future '
                               f'({self._values["max_future"]:g} s){advice}')
        if advice:
            raise RefusedError(LATE, f'stamped {-ahead_ns * 1e-9:.9g} s behind the clock{advice}')
