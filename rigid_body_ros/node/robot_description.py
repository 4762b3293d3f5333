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

"""Wait for the URDF of a body on the topic that robot_state_publisher uses."""

from __future__ import annotations

from collections.abc import Mapping
import time
from typing import Any

from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.scene import Scene
from std_msgs.msg import String

#: The name of the topic with the URDF, and also the name of the parameter with which users can
#: give the URDF instead.
ROBOT_DESCRIPTION = 'robot_description'
#: The QoS of robot_state_publisher, which delivers the last message even to later subscriptions.
_LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)
_MOMENTS = ('inertia.ixx', 'inertia.iyy', 'inertia.izz')
#: How often to check the topic, and how often to log that the node is still waiting, in seconds.
_PERIOD, _LOG_PERIOD = 0.05, 10.0


def with_robot_description(node: Node, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """
    Return the given parameters; if they contain no inertia, add the URDF from the topic.

    If the parameters contain an inertia or a `robot_description`, the node does not subscribe to
    the topic, and does not wait.

    Raises
    ------
    InputError
        A parameter other than the inertia is not valid. The node checks these parameters before it
        waits for the URDF.
    ExternalShutdownException
        The context was shut down while the node was waiting.

    """
    if given.get(ROBOT_DESCRIPTION) or any(name.startswith('inertia.') for name in given):
        return given
    Scene.from_values({**given, 'link': '', ROBOT_DESCRIPTION: '', **dict.fromkeys(_MOMENTS, 1.0)})
    return {**given, ROBOT_DESCRIPTION: _received(node)}


def _received(node: Node) -> str:
    """
    Wait for a message and return the URDF in it.

    The function does not spin the node, because the node may already belong to an executor.
    """
    subscription = node.create_subscription(String, ROBOT_DESCRIPTION, lambda _: None, _LATCHED)
    topic, logger = subscription.topic_name, node.get_logger()
    logger.info(f'waiting for a URDF on {topic}, because the parameters have neither inertia.ixx '
                'nor robot_description')
    logged_at = time.monotonic()
    try:
        while True:
            with subscription.handle:
                taken = subscription.handle.take_message(String, False)
            if taken is not None:
                return str(taken[0].data)
            interrupts.check()
            if not node.context.ok():
                raise ExternalShutdownException
            if time.monotonic() > logged_at + _LOG_PERIOD:
                logged_at = time.monotonic()
                count = node.count_publishers(topic)
                why = 'no node publishes it' if not count else \
                    f'publishers: {count}, none of which has sent one with transient local QoS'
                logger.warning(f'still waiting for a URDF on {topic}: {why}')
            time.sleep(_PERIOD)
    finally:
        node.destroy_subscription(subscription)
