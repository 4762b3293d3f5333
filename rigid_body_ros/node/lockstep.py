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

"""Lockstep: each torque is answered with the state one step later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import time

from builtin_interfaces.msg import Time
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rigid_body_ros import messages
from rigid_body_ros.body import State
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.node.arrivals import Sender
from rigid_body_ros.node.chain import Answers, Offers
from rigid_body_ros.node.clocks import ClockWatch
from rigid_body_ros.node.epoch import Torque
from rigid_body_ros.node.health import APPLIED, Health, REPLACED
from rigid_body_ros.node.inputs import ANSWERED, Arrival, FUTURE, Inputs, RefusedError, STALE
from rigid_body_ros.node.motion import Motion
from rigid_body_ros.node.outputs import Outputs
from rigid_body_ros.node.parameters import Parameters
from rosgraph_msgs.msg import Clock

#: s; between two looks at whether the state is to be published again.
_LOOK_EVERY = 0.1
#: s; silence, or work on one torque, that is worth a warning.
_LONG = 1.0
#: s; how long to look for another publisher of /clock, and until its name is known.
_DISCOVERY, _INTRODUCTION = 3.0, 0.5
_CLOCK = '/clock'


class Lockstep:
    """Publishes the state `step` after every torque, as soon as the torque comes."""

    several_publishers = 'a loop takes one torque for each state, the first to arrive'

    def __init__(self, node: Node, parameters: Parameters, inputs: Inputs, outputs: Outputs,
                 health: Health) -> None:
        self._node, self._parameters = node, parameters
        self._inputs, self._outputs, self._health = inputs, outputs, health
        values = parameters.scene.values
        self._given_start_ns = parameters.scene.start.time_ns
        self._clock = self._clock_publisher() if values['publish_clock'] else None
        self._watch = ClockWatch(node)
        self._step_ns = max(1, duration_ns(values['step'], 'step'))
        self.motion = Motion(parameters.scene, outputs, health, self._read, self._answer,
                             self._step_ns)
        self._answers = Answers(duration_ns(values['history'], 'history'))
        self._offers = Offers(self._connected)
        self._torques: Subscription | None = None
        #: The state that waits for a torque, and since when, s.
        self._latest = self._start = self.motion.initial(self._given_start_ns)
        self._since = time.monotonic()
        #: The stamp of the state that waited when the motion was reset.
        self._stale_ns: int | None = None
        self._timer = node.create_timer(_LOOK_EVERY, self._look,
                                        clock=RosClock(clock_type=ClockType.STEADY_TIME))
        self._begin()

    def connect(self, torques: Subscription) -> None:
        """Note the subscription that torques come from."""
        self._torques = torques

    def set_rate(self, rate: float) -> None:
        """Nothing: torques set the pace."""

    def take(self, data: bytes, sender: Sender) -> None:
        """
        Take a torque by its stamp, to be answered.

        Raises
        ------
        RefusedError
            Too many wait.

        """
        self.motion.take(data, sender, 0)

    def set_state(self, state: State) -> None:
        """
        Begin an epoch with a state; one without a stamp holds at the next torque.

        Raises
        ------
        RefusedError
            It is older than the newest torque by `history` or more.

        """
        if state.time_ns:
            self._open(state, self.motion.in_force(state.time_ns))
        else:
            self.motion.end()
            self._start = state
        self._answers.clear()
        self._publish(self._start, self._start)

    def reset(self) -> str:
        """Go back to before the first torque, and say so."""
        self.motion.end()
        self._start = self.motion.initial(self._given_start_ns)
        self._begin()
        self._answers.clear()
        # The torque that answers this state may be on its way.
        self._stale_ns = self._latest.time_ns
        self._publish(self._start, self._start)
        return 'back at the initial state, waiting for the first torque'

    def check(self) -> list[str]:
        """Return what is wrong at present."""
        if self._clock is not None and self._node.count_publishers(_CLOCK) > 1:
            self._node.destroy_publisher(self._clock)
            self._clock = None
            self._node.get_logger().error(f'{_CLOCK}: another node publishes it, too: this one '
                                          'does not any more')
        problems = self._watch.check()
        silence = time.monotonic() - self._since
        if self.motion.waiting_time > _LONG:
            problems.append(f'the answer to a torque has taken {self.motion.waiting_time:.0f} s '
                            'so far')
        elif not self.motion.waiting and silence > _LONG:
            problems.append(f'no torque for {silence:.0f} s: the state at {self._latest.time_ns} '
                            'ns waits for one')
        return problems

    def stamp(self) -> Time:
        """Return the time of now: that of the clock published here, if there is one."""
        if self._clock is None:
            return self._node.get_clock().now().to_msg()
        return _time(self._latest.time_ns)

    def _begin(self) -> None:
        if self._given_start_ns:
            self._open(self._start)

    def _open(self, start: State, torques: Sequence[Torque] = ()) -> None:
        self._start = start
        self.motion.begin(start, torques)
        self._parameters.report(start)

    def _read(self, arrival: Arrival) -> Torque | None:
        torque, sender = self._inputs.torque(arrival.data), arrival.sender
        self._check_stamp(torque.stamp_ns)
        if self._answers.repeated(torque, sender):
            self._leave(torque)
            return None
        if self.motion.epoch is None:
            self._open(replace(self._start, time_ns=torque.stamp_ns))
        self._answers.expect(torque, sender)
        return torque

    def _check_stamp(self, stamp_ns: int) -> None:
        if stamp_ns + self._step_ns > messages.LAST_NS:
            raise RefusedError(FUTURE, f'stamped {stamp_ns} ns, expected a time that, with a '
                               f'step, is {messages.LAST_NS} ns at most')
        if stamp_ns == self._stale_ns:
            raise RefusedError(STALE, f'the torque at {stamp_ns} ns answers a state from before '
                               'the reset')

    def _leave(self, torque: Torque) -> None:
        """Count a torque whose stamp has its answer, or raise RefusedError if it is another."""
        if not self._answers.is_same(torque):
            raise RefusedError(ANSWERED, f'another torque at {torque.stamp_ns} ns came before: a '
                               'loop takes one torque for each state')
        self._health.count(APPLIED)
        self._health.count(REPLACED)

    def _answer(self, torque: Torque, state: State | None) -> None:
        if state is None:
            self._answers.forget(torque)
            return
        self._publish(state, max(state, self._latest, key=lambda state: state.time_ns))
        self._answers.give(torque)

    def _publish(self, state: State, latest: State) -> None:
        self._latest, self._since = latest, time.monotonic()
        if state.time_ns == self._stale_ns:  # the motion has come this far again
            self._stale_ns = None
        self._send(state, is_repeated=False)

    def _look(self) -> None:
        if self._offers.is_due() and not self.motion.waiting:
            self._send(self._latest, is_repeated=True)

    def _send(self, state: State, is_repeated: bool) -> None:
        if self._clock is not None:
            self._clock.publish(Clock(clock=_time(state.time_ns)))
        self._outputs.publish(state)
        self._offers.published(is_repeated)
        if self._offers.has_controller or self.motion.epoch is not None:
            self._answers.published(state.time_ns)

    def _connected(self) -> tuple[int, int]:
        publishers = self._torques.handle.get_publisher_count() if self._torques else 0
        return publishers, self._outputs.reader_count

    def _clock_publisher(self) -> Publisher:
        if self._node.get_parameter('use_sim_time').value:
            raise InputError('publish_clock: expected use_sim_time false, as a clock does not '
                             'follow itself')
        until = time.monotonic() + _DISCOVERY
        while time.monotonic() < until:
            if self._node.count_publishers(_CLOCK):
                time.sleep(_INTRODUCTION)
                info = self._node.get_publishers_info_by_topic(_CLOCK)[0]
                raise InputError(f'publish_clock: expected no other publisher of {_CLOCK}, '
                                 f'found {info.node_name}')
            time.sleep(0.05)
        return self._node.create_publisher(Clock, _CLOCK, 10)


def _time(time_ns: int) -> Time:
    seconds, nanoseconds = divmod(time_ns, 10 ** 9)
    return Time(sec=seconds, nanosec=nanoseconds)
