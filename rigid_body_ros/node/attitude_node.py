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

"""Provide `AttitudeNode`, the plain node without a managed lifecycle."""

from __future__ import annotations

from typing import Any

from rigid_body_ros import scene
from rigid_body_ros.node.component import AttitudeComponent
from rigid_body_ros.node.intake import PollingNode
from rigid_body_ros.node.outputs import OnLog


class AttitudeNode(PollingNode):
    """
    Compute the attitude of a rigid body from torques on a topic, and publish it.

    You can spin this node in any executor, alone or together with other nodes. All its callbacks
    are in one mutually exclusive group, so a MultiThreadedExecutor runs only one of them at a
    time.

    If the parameters give neither an inertia nor a URDF, the constructor waits until a URDF
    arrives on the topic `robot_description`.

    Parameters
    ----------
    node_name : str
    on_log : callable, optional
        Called with the name of a log, such as '~/committed', and each message of it. The log is
        then not published.
    **kwargs
        Arguments of `rclpy.node.Node`, such as `namespace` or `parameter_overrides`.

    Raises
    ------
    InputError
        The node name is not valid, or the parameters do not describe a valid scene.

    """

    #: The component, from its activation until it has published the pending states. None before
    #: and after this time.
    _component: AttitudeComponent | None = None

    def __init__(self, node_name: str = scene.NODE, on_log: OnLog | None = None,
                 **kwargs: Any) -> None:
        self._on_log = on_log
        super().__init__(node_name, **kwargs)

    def _start(self) -> None:
        component = AttitudeComponent(self, on_log=self._on_log)
        component.activate()
        self._component = component

    def destroy_node(self) -> None:
        """Publish all pending states and the last diagnostics, and then destroy the node."""
        if self._component:
            self._component.finish()
        self._component = None
        super().destroy_node()
