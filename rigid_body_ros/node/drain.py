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

"""Raw subscriptions, which count lost messages, and which a node may poll in batches."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from copy import copy
from importlib import import_module
import inspect
import time
from typing import Any, TYPE_CHECKING

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.live.torque_queue import Sender, UNKNOWN_SENDER
from rigid_body_ros.messages import MessageType

if TYPE_CHECKING:  # moved to rclpy.endpoint_info in Lyrical
    from rclpy.topic_endpoint_info import TopicEndpointInfo

try:
    from rclpy.event_handler import SubscriptionEventCallbacks
except ModuleNotFoundError:  # Humble
    from rclpy.qos_event import SubscriptionEventCallbacks

#: One call takes messages for at most this many seconds.
_BUDGET = 0.02
#: Maximum number of publishers to remember. If there are more publishers, the one that has been
#: silent for the longest time is forgotten.
_MAX_SENDERS = 100


def subscription(node: Node, kind: type, topic: str, callback: Callable[..., None],
                 qos: QoSProfile) -> Subscription:
    """Subscribe to serialized messages, with a QoS that parameters can override."""
    # Disable events, because rmw_fastrtps can deadlock if a message is lost while an event is
    # being taken (ros2/rmw_fastrtps#890).
    return node.create_subscription(
        kind, topic, callback, copy(qos), raw=True,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        qos_overriding_options=QoSOverridingOptions.with_default_policies())


def published(node: Node, topic: str,
              kinds: Iterable[MessageType]) -> tuple[MessageType, type] | None:
    """
    Return the type with which a topic is published, and its class; None if there is no publisher.

    Raise InputError if the type is not one of `kinds`, or if its package is not installed.
    """
    found = node.get_publishers_info_by_topic(topic)
    names, by_name = {info.topic_type for info in found}, {kind.name: kind for kind in kinds}
    if len(names) > 1 or not names <= by_name.keys():
        wrong = [info for info in found if info.topic_type not in by_name] or found
        nodes = listed(sorted(f'{info.topic_type} from {full_name(info)}' for info in wrong))
        raise InputError(f'{topic}: expected one of {listed(by_name)}, found {nodes}')
    for name in names:
        package, _, last = name.split('/')
        try:
            return by_name[name], vars(import_module(f'{package}.msg'))[last]
        except ModuleNotFoundError as error:
            raise InputError(f'{topic}: cannot receive {name}: {error}') from error
    return None


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to."""
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


class PollingNode(Node):
    """
    A node that polls some of its subscriptions, for which an executor does not wait.

    Waking an executor for every message takes more time than all other work on the message.
    """

    polled: Collection[Subscription[Any]] = ()

    @property
    def subscriptions(self) -> Iterator[Subscription[Any]]:
        """Return the subscriptions that an executor must wait for."""
        return (one for one in super().subscriptions if one not in self.polled)


class DrainCallback:
    """
    A callback that takes the messages of a subscription, and counts lost messages.

    Publishers number their messages, so a gap in the numbers means that messages were lost. Either
    the network dropped them, or the queue of the subscription was full.

    Parameters
    ----------
    on_message : callable
        Called with each message as bytes, its sender, and the time at which the middleware
        received the message, ns on the system clock. The time is 0 if the middleware does not
        report it.
    on_gap : callable
        Called with the number of lost messages when there is a gap, and with whether the gap comes
        before the first message of a publisher.
    on_passed : callable, optional
        Called after each message that an executor has passed, but not after polling.

    Attributes
    ----------
    subscription : Subscription
        The subscription to take messages from. Set this attribute once you have created the
        subscription.
    heard : dict
        For each publisher, the times at which its first and its last message were taken, in
        seconds on the monotonic clock.

    """

    #: rclpy inspects the signature, and passes the message information only if a callback has two
    #: parameters.
    __signature__ = inspect.signature(lambda message, info: None)

    def __init__(self, on_message: Callable[[bytes, Sender, int], None],
                 on_gap: Callable[[int, bool], None],
                 on_passed: Callable[[], None] = lambda: None) -> None:
        self._on_message, self._on_passed, self._on_gap = on_message, on_passed, on_gap
        self._last_number: dict[Sender, int] = {}
        self.heard: dict[Sender, tuple[float, float]] = {}
        self.subscription: Subscription

    def __call__(self, *taken: Any) -> None:
        """Take a message that an executor has received."""
        # EventsExecutor passes one tuple (message, information), while other executors pass two
        # arguments.
        message, info = taken if len(taken) == 2 else taken[0]
        with self.subscription.handle:
            self._pass_on(message, info)
        self._on_passed()

    def _pass_on(self, message: bytes, info: dict[str, Any]) -> None:
        self._on_message(message, self._sender(info), info['received_timestamp'])

    def _waiting(self) -> Iterator[tuple[bytes, dict[str, Any]]]:
        # Without a time limit, the loop would not end if messages arrive faster than we take them.
        until, subscription = time.monotonic() + _BUDGET, self.subscription
        with subscription.handle:
            while found := subscription.handle.take_message(subscription.msg_type, True):
                yield found
                if time.monotonic() > until:
                    break

    @staticmethod
    def poll(drains: Collection[DrainCallback]) -> None:
        """Take the waiting messages of several subscriptions, in the order of their arrival."""
        found = [(drain, *taken) for drain in drains for taken in drain._waiting()]
        if len(drains) > 1:
            found.sort(key=lambda taken: taken[2]['received_timestamp'])
        for drain, *taken in found:
            drain._pass_on(*taken)

    def _sender(self, info: dict[str, Any]) -> Sender:
        number, identity = info.get('publication_sequence_number'), info.get('publisher_gid')
        if number is None:
            return None
        sender = identity['data'] if identity else None
        if sender is None and self.subscription.handle.get_publisher_count() > 1:
            self._last_number.clear()  # we cannot tell which publisher a number comes from
            return UNKNOWN_SENDER
        is_first = sender not in self._last_number
        previous = self._last_number.pop(sender, 0)
        self._last_number[sender] = number
        now = time.monotonic()
        self.heard[sender] = self.heard.get(sender, (now, now))[0], now
        if len(self._last_number) > _MAX_SENDERS:
            oldest = next(iter(self._last_number))
            del self._last_number[oldest], self.heard[oldest]
        if number > previous + 1:
            self._on_gap(number - previous - 1, is_first)
        return sender
