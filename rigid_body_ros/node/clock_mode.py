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
Clock mode, in which the node is the source of simulated time.

The node publishes /clock in steps, and treats torques as in real time, by its own clock. Therefore
controllers that run on a timer work with it. The node also offers the services of the package
simulation_interfaces, if it is installed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
import time
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, Vector3
from rclpy.node import Node
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.live import events
from rigid_body_ros.mechanics import so3
from rigid_body_ros.node.clocks import ArrivalStamps, ClockPublisher, message_of
from rigid_body_ros.node.mode import BUDGET
from rigid_body_ros.node.process import timer
from rigid_body_ros.node.realtime import Realtime
from rigid_body_ros.scene import Scene
from std_srvs.srv import SetBool, Trigger

try:
    from simulation_interfaces import srv
    from simulation_interfaces.msg import Result
    _IS_INSTALLED = True
except ModuleNotFoundError:
    _IS_INSTALLED = False

#: The shortest time between two calls of the timer, s. Several steps may fall into this time.
_SHORTEST = 1e-3
#: The time between two calls of the timer if the clock shall run as fast as possible, s.
_FASTEST = 1e-6
#: If the clock is late by more than this many seconds, it does not catch up, because a controller
#: could not follow it.
_LATEST = 0.1


class ClockMode(Realtime):
    """Publish /clock, and the state at the times of this clock, `publish_rate` times a second."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._publisher = ClockPublisher(self._node, 'mode: clock')
        self._arrivals = ArrivalStamps(is_simulated=True)
        self._step_ns = max(1, duration_ns(self._scene.step, 'step'))
        self._factor = self._scene.real_time_factor
        # A time of 0 would mean that there is no time yet.
        self._time_ns = self._saved.time_ns if self._saved else \
            self._given_start_ns or self._step_ns
        self._first_ns = self._next_ns = self._time_ns
        #: How far the clock is behind, s of simulated time.
        self._owed = 0.0

    def activate(self) -> None:
        """Begin to publish the clock and states, and offer services to pause and to step."""
        #: When `_owed` was determined, in seconds on the monotonic clock.
        self._ticked_at = time.monotonic()
        self._poll_timer()
        timer(self._node, max(self._scene.step / self._factor, _SHORTEST) if self._factor
              else _FASTEST, self._tick)
        self._node.create_service(SetBool, '~/pause', self._on_pause)
        self._node.create_service(Trigger, '~/step', self._on_step)
        if _IS_INSTALLED:
            _offer(self._node, self, self._scene)

    def set_rate(self, rate: float) -> None:
        """Change the publishing rate, Hz of simulated time."""
        self._rate = rate

    def pause(self, is_paused: bool) -> str:
        """Stop the clock, or let it go on, and return a description."""
        text = super().pause(is_paused)
        return f'paused: {self._standing}' if is_paused else text

    def rewind(self) -> str:
        """Set the clock back to the start, begin a new epoch there, and return a description."""
        self.work()
        self._time_ns = self._next_ns = self._first_ns
        self._publisher.publish(self._time_ns)
        return self._begin(self.run.initial(self._time_ns), (), 'rewound')

    @property
    def _standing(self) -> str:
        return f'the clock stands at {self._time_ns} ns'

    def advance(self) -> None:
        """Advance the clock by a step, and publish it, and the state if it is due or paused."""
        self._time_ns += self._step_ns
        self._publisher.publish(self._time_ns)
        if self._time_ns >= self._next_ns or self.is_paused:
            self._next_ns = max(self._next_ns + duration_ns(1.0 / self._rate, 'publish_rate'),
                                self._time_ns + 1)
            self._publish_now()

    def stamp(self) -> Time:
        """Return the present time."""
        return message_of(self._time_ns)

    def problems(self) -> dict[int, list[str]]:
        """Return current problems by source. Problems of the clock belong to the first source."""
        problems = super().problems()
        if self.is_paused:
            problems[self.intake.first].append(f'paused: {self._standing}')
        if self._publisher.has_rival:
            problems[self.intake.first].append('/clock: another node publishes it, too')
        return problems

    def _tick(self) -> None:
        now, step = time.monotonic(), self._scene.step
        elapsed, self._ticked_at = now - self._ticked_at, now
        if self.is_paused:
            return
        self._owed = self._owed + elapsed * self._factor if self._factor else step
        late = (self._owed - step) / self._factor if self._factor else 0.0
        if late > _LATEST:
            self._owed = step
            self._diagnostics.event(events.MISSED, f'the clock is {late:.3g} s late, and does not '
                                    'catch up: this machine is too slow or too busy for '
                                    f'real_time_factor {self._factor:g}')
        while self._owed >= step and time.monotonic() < now + BUDGET:
            self.advance()
            self._owed -= step

    def now_ns(self) -> int:
        """Return the present time in ns."""
        self._now_ns = self._time_ns
        self._arrivals.tick(self._now_ns)
        if self.run.epoch is None:
            self._start(self._now_ns)
        return self._now_ns

    def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.is_paused
        if self.is_paused:
            self.advance()
        response.message = self._standing if self.is_paused else 'the clock runs: pause it first'
        return response


def _offer(node: Node, mode: ClockMode, scene: Scene) -> None:
    """Create the services of simulation_interfaces, with which tools drive simulators."""
    def reset(request: Any, response: Any) -> tuple[int, str]:
        scope = request.scope or request.SCOPE_ALL
        if not scope & request.SCOPE_STATE:
            return Result.RESULT_FEATURE_UNSUPPORTED, 'expected a scope that includes the state'
        text = mode.rewind() if scope & request.SCOPE_TIME else mode.reset()
        return Result.RESULT_OK, text

    def step(request: Any, response: Any) -> tuple[int, str]:
        if not mode.is_paused:
            return Result.RESULT_INCORRECT_STATE, 'pause the simulation first'
        for _ in range(request.steps):
            mode.advance()
        return Result.RESULT_OK, ''

    def set_state(request: Any, response: Any) -> tuple[int, str]:
        target, is_paused = request.state.state, request.state.state != request.state.STATE_PLAYING
        if target > request.state.STATE_PAUSED:
            return Result.RESULT_FEATURE_UNSUPPORTED, 'expected stopped, playing or paused'
        if target != request.state.STATE_STOPPED and is_paused == mode.is_paused:
            return response.ALREADY_IN_TARGET_STATE, ''
        text = mode.pause(is_paused)
        return Result.RESULT_OK, text if target else mode.rewind()

    def get_state(request: Any, response: Any) -> tuple[int, str]:
        state = mode.run.state(mode.now_ns(), math.inf)
        if request.entity != scene.body_frame:
            return Result.RESULT_NOT_FOUND, \
                f'expected {scene.body_frame}, the only entity, found {request.entity}'
        if state is None:
            return Result.RESULT_OPERATION_FAILED, 'the state is not computable'
        entity = response.state
        entity.header.stamp, entity.header.frame_id = mode.stamp(), scene.space_frame
        entity.pose.orientation = Quaternion(**dict(zip('xyzw', state.attitude.tolist())))
        rates = so3.rotate(state.attitude, state.angular_velocity)  # in the axes of the frame_id
        entity.twist.angular = Vector3(**dict(zip('xyz', rates.tolist())))
        return Result.RESULT_OK, ''

    def answered(callback: Callable[[Any, Any], tuple[int, str]], request: Any,
                 response: Any) -> Any:
        response.result.result, response.result.error_message = callback(request, response)
        return response
    for kind, name, callback in (
            (srv.ResetSimulation, 'reset_simulation', reset),
            (srv.StepSimulation, 'step_simulation', step),
            (srv.SetSimulationState, 'set_simulation_state', set_state),
            (srv.GetEntityState, 'get_entity_state', get_state)):
        node.create_service(kind, f'~/{name}', partial(answered, callback))
