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

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.node import Node
from rigid_body_ros import scene
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.node.component import AttitudeComponent


class AttitudeNode(Node):
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
    **kwargs
        Arguments of `rclpy.node.Node`, such as `namespace` or `parameter_overrides`.

    Raises
    ------
    InputError
        The node name is not valid, or the parameters do not describe a valid scene.

    """

    def __init__(self, node_name: str = scene.NODE, **kwargs: Any) -> None:
        with one_line_errors():
            super().__init__(node_name, **kwargs)
        #: The component, from its activation until it has published the pending states. None
        #: before and after this time.
        self._component: AttitudeComponent | None = None
        try:
            component = AttitudeComponent(self)
            component.activate()
        except BaseException:  # otherwise the node would stay in the graph
            self.destroy_node()
            raise
        self._component = component

    def destroy_node(self) -> None:
        """Publish all pending states and the last diagnostics, and then destroy the node."""
        if self._component:
            self._component.finish()
        self._component = None
        super().destroy_node()


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Convert rclpy errors about a node's arguments to InputErrors with one-line messages."""
    try:
        yield
    except NameValidationException as error:
        text, name, _ = str(error).splitlines()  # the last line marks a character in the name
        raise InputError(f'{text} {name.strip()}') from error
    except ParameterException as error:  # for example, if use_sim_time is not a Boolean
        raise InputError(str(error)) from error
