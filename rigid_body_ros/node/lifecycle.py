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

"""Provide `AttitudeLifecycleNode`, the managed node, and `main`, which runs it as a command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import traceback

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.node.attitude_node import AttitudeComponent, AttitudeNode
from rigid_body_ros.node.parameters import declare, given_parameters
from rigid_body_ros.node.process import run
from rigid_body_ros.runtime.parameters import checked, Parameter

_FAILURE = TransitionCallbackReturn.FAILURE
_AUTOSTART = Parameter('autostart', False, '', 'whether the node configures and activates '
                       'itself when it starts')


class AttitudeLifecycleNode(AttitudeNode, LifecycleNode):
    """
    Compute the attitude of a rigid body in a node with a managed lifecycle.

    The transitions do the following. *configure* reads the scene. *activate* subscribes to the
    inputs and begins to publish. *deactivate* unsubscribes but keeps the motion, which continues
    under the last torques. *cleanup* publishes the end of the log and discards the motion. If the
    parameter `autostart` is true, the node configures and activates itself when it starts.

    Parameters
    ----------
    node_name : str
    **kwargs
        Arguments of `rclpy.lifecycle.LifecycleNode`.

    Raises
    ------
    InputError
        The node name is not valid. The error is also raised if `autostart` is true and the
        parameters do not describe a valid scene.

    """

    #: The value that the parameter `mode` had when the node was first configured, or None if the
    #: node has not been configured yet.
    _mode: str | None = None
    #: The error in the last transition that failed.
    _error: InputError | None = None

    def _start(self) -> None:
        declare(self, given_parameters(self))
        autostart = self.declare_parameter(_AUTOSTART.name, _AUTOSTART.default,
                                           ParameterDescriptor(dynamic_typing=True))
        if checked(_AUTOSTART, autostart.value):
            self.trigger_configure()
            if self._component:
                self.trigger_activate()
            if self._error:
                raise self._error

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the scene, and create the publishers."""
        return super().on_configure(state) if self._attempt(self._configure) else _FAILURE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the inputs, and begin to publish the motion."""
        return super().on_activate(state) if self._attempt(self._activate) else _FAILURE

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Unsubscribe and stop publishing, but keep the motion."""
        return super().on_deactivate(state) if self._attempt(self._deactivate) else _FAILURE

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish the end of the log, and discard the motion."""
        return super().on_cleanup(state) if self._attempt(self._clean_up) else _FAILURE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish the end of the log, and discard the motion."""
        return super().on_shutdown(state) if self._attempt(self._clean_up) else _FAILURE

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Discard the motion, so that the node can be configured again."""
        return super().on_error(state) if self._attempt(self._forget) else _FAILURE

    def _attempt(self, work: Callable[[], None]) -> bool:
        """
        Do the work of a transition, and return whether it succeeded.

        A mistake by the user is logged as an error. Any other exception is logged and raised.
        """
        try:
            work()
        except InputError as error:
            self._error = error
            self.get_logger().error(str(error))
            return False
        except Exception:  # log the traceback here, because rclpy does not
            self.get_logger().error(traceback.format_exc())
            raise
        return True

    def _configure(self) -> None:
        component = AttitudeComponent(self, is_managed=True, on_log=self._on_log)
        if self._mode not in (None, component.mode):
            component.destroy()
            raise InputError(f'mode: expected {self._mode!r} as in the first configuration, '
                             'because rclpy keeps the quality of service of the torques, found '
                             f'{component.mode!r}; start the node again')
        self._component, self._mode = component, component.mode

    def _activate(self) -> None:
        assert self._component
        try:
            self._component.activate()
        except BaseException:
            self._component.deactivate()
            raise

    def _deactivate(self) -> None:
        assert self._component
        self._component.deactivate()
        self.get_logger().info('deactivated: the motion goes on under the last torques')

    def _clean_up(self) -> None:
        if self._component:
            self._component.finish()
        self._forget()

    def _forget(self) -> None:
        if self._component:
            self._component.destroy()
        self._component = None


def main(arguments: Sequence[str] | None = None) -> None:
    """
    Run the managed node until it receives SIGINT or SIGTERM.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    run(AttitudeLifecycleNode, 'attitude_lifecycle_node', arguments)
