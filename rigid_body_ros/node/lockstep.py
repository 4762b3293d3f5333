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

from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rigid_body_ros import messages
from rigid_body_ros.body import State
from rigid_body_ros.node.epoch import Torque
from rigid_body_ros.node.health import Health
from rigid_body_ros.node.inputs import FUTURE, RefusedError
from rigid_body_ros.node.motion import Motion
from rigid_body_ros.node.outputs import Outputs
from rigid_body_ros.node.parameters import Parameters
from rigid_body_ros.scene import InputError
from rosgraph_msgs.msg import Clock

#: s; between offers of the start state, until the first torque.
_OFFER_EVERY = 0.1
#: s; how long to look for another publisher of /clock, and until its name is known.
_DISCOVERY, _INTRODUCTION = 3.0, 0.5
_CLOCK = '/clock'


class Lockstep:
    """Publishes the state `step` after every torque, as soon as the torque comes."""

    def __init__(self, node: Node, parameters: Parameters, outputs: Outputs,
                 health: Health) -> None:
        self._node, self._parameters, self._outputs = node, parameters, outputs
        values = parameters.scene.values
        self._given_start_ns = parameters.scene.start.time_ns
        self._clock = self._clock_publisher() if values['publish_clock'] else None
        self._step_ns = max(1, round(values['step'] * 1e9))
        self.motion = Motion(parameters.scene, outputs, health, self._tell, self._step_ns)
        self._start = self.motion.initial(self._given_start_ns)
        self._timer = node.create_timer(_OFFER_EVERY, self._offer,
                                        clock=RosClock(clock_type=ClockType.STEADY_TIME))
        self._begin()

    def set_rate(self, rate: float) -> None:
        """Nothing: torques set the pace."""

    def take(self, torque: Torque) -> None:
        """
        Take a torque by its stamp, and answer it.

        Raises
        ------
        RefusedError
            Too many wait, or the answer's time is later than a message can say.

        """
        if torque.stamp_ns + self._step_ns > messages.LAST_NS:
            raise RefusedError(FUTURE, f'stamped {torque.stamp_ns} ns, expected a time that, with '
                               f'a step, is {messages.LAST_NS} ns at most')
        self._timer.cancel()
        if self.motion.epoch is None:
            self._open(replace(self._start, time_ns=torque.stamp_ns))
        self.motion.take(torque)

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
        self._timer.reset()
        self._offer()

    def reset(self) -> str:
        """Go back to before the first torque, and say so."""
        self.motion.end()
        self._start = self.motion.initial(self._given_start_ns)
        self._begin()
        self._timer.reset()
        return 'back at the initial state, waiting for the first torque'

    def check(self) -> list[str]:
        """Return what is wrong at present."""
        if self._clock is not None and self._node.count_publishers(_CLOCK) > 1:
            self._node.destroy_publisher(self._clock)
            self._clock = None
            self._node.get_logger().error(f'{_CLOCK}: another node publishes it, too: this one '
                                          'does not any more')
        return []

    def _begin(self) -> None:
        if self._given_start_ns:
            self._open(self._start)

    def _open(self, start: State, torques: Sequence[Torque] = ()) -> None:
        self._start = start
        self.motion.begin(start, torques)
        self._parameters.report(start)

    def _offer(self) -> None:
        self._tell(self._start)

    def _tell(self, state: State) -> None:
        if self._clock is not None:
            clock = Clock()
            clock.clock.sec, clock.clock.nanosec = divmod(state.time_ns, 10 ** 9)
            self._clock.publish(clock)
        self._outputs.publish(state)

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
