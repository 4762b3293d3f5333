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

"""Offer the services of the package simulation_interfaces, with which tools drive simulators."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
from typing import Any

from geometry_msgs.msg import Quaternion, Vector3
from rclpy.node import Node
from rigid_body_ros.mechanics import so3
from rigid_body_ros.node.clock_mode import ClockMode
from rigid_body_ros.scene import Scene

try:
    from simulation_interfaces import srv
    from simulation_interfaces.msg import Result
    IS_INSTALLED = True
except ModuleNotFoundError:
    IS_INSTALLED = False


class SimulatorMode(ClockMode):
    """Publish /clock, and offer the services if simulation_interfaces is installed."""

    def activate(self) -> None:
        """Begin to publish the clock and states, and offer the services."""
        super().activate()
        if IS_INSTALLED:
            _offer(self._node, self, self._scene)


def _offer(node: Node, mode: ClockMode, scene: Scene) -> None:
    """Create the services, which reset, step and pause the node, and return its state."""
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
        found = response.state
        found.header.stamp, found.header.frame_id = mode.stamp(), scene.space_frame
        found.pose.orientation = Quaternion(**dict(zip('xyzw', state.attitude.tolist())))
        rates = so3.rotate(state.attitude, state.angular_velocity)  # in the axes of the frame_id
        found.twist.angular = Vector3(**dict(zip('xyz', rates.tolist())))
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
