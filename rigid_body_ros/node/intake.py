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

"""Receive the messages of sources, with the types that their publishers have."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
import inspect
import time
from typing import Any, TYPE_CHECKING, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from rigid_body_ros import messages
from rigid_body_ros.common.errors import listed
from rigid_body_ros.live.events import Events, RECEIVED, RejectedError, UNSTAMPED
from rigid_body_ros.live.inputs import Inputs, Torque, wrench_of
from rigid_body_ros.live.torque_queue import Sender, UNKNOWN_SENDER
from rigid_body_ros.node.process import one_line_errors
from rigid_body_ros.node.sources import BODY, class_of, TorqueTopic
from rigid_body_ros.scene import Scene
from rigid_body_ros.scene.parameters import ARRIVAL

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
#: Best-effort QoS is compatible with any publisher, and reliable QoS loses no message.
BEST_EFFORT, RELIABLE = (QoSProfile(depth=1000, reliability=policy) for policy in (
    ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE))
_Receive = Callable[[bytes, Sender, int, int], None]
_Message = TypeVar('_Message', Torque, messages.Stamped)


def subscription(node: Node, kind: messages.MessageType, topic: str,
                 callback: Callable[..., None], qos: QoSProfile) -> Subscription[Any]:
    """Subscribe to serialized messages, with a QoS that parameters can override."""
    # Disable events, because rmw_fastrtps can deadlock if a message is lost while an event is
    # being taken (ros2/rmw_fastrtps#890).
    return node.create_subscription(
        class_of(kind), topic, callback, copy(qos), raw=True,
        event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        qos_overriding_options=QoSOverridingOptions.with_default_policies())


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to."""
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


class PollingNode(Node):
    """
    A node that polls some of its subscriptions, for which an executor does not wait.

    Waking an executor for every message takes more time than all other work on the message.

    Raises
    ------
    InputError
        The node name is not valid, or `_start` raises the error.

    """

    polled: Collection[Subscription[Any]] = ()

    def __init__(self, node_name: str, **kwargs: Any) -> None:
        with one_line_errors():
            super().__init__(node_name, **kwargs)
        try:
            self._start()
        except BaseException:  # otherwise the node would stay in the graph
            self.destroy_node()
            raise

    def _start(self) -> None:
        """Read the parameters, and create what the node consists of."""
        raise NotImplementedError

    @property
    def subscriptions(self) -> Iterator[Subscription[Any]]:
        """Return the subscriptions that an executor must wait for."""
        return (entity for entity in super().subscriptions if entity not in self.polled)


class DrainCallback:
    """
    A callback that takes the messages of a source, and counts received and lost messages.

    Publishers number their messages, so a gap in the numbers means that messages were lost. Either
    the network dropped them, or the queue of the subscription was full.

    Parameters
    ----------
    source : TorqueTopic
    kind : MessageType
        The type of the messages.
    events : Events
    receive : callable
        Called with each message as bytes, its sender, its source, and the time at which the
        middleware received the message, ns on the system clock. The time is 0 if the middleware
        does not report it. The function may raise RejectedError.
    on_passed : callable
        Called after each message that an executor has passed, but not after polling.

    Attributes
    ----------
    subscription : Subscription
        The subscription to take messages from. Set this attribute once you have created the
        subscription.
    heard : dict
        For each publisher, the times at which its first and its last message were taken, in
        seconds on the monotonic clock.
    has_gap : bool
        Whether messages were lost. Whoever uses this attribute resets it.

    """

    #: rclpy inspects the signature, and passes the message information only if a callback has two
    #: parameters.
    __signature__ = inspect.signature(lambda message, info: None)

    def __init__(self, source: TorqueTopic, kind: messages.MessageType, events: Events,
                 receive: _Receive, on_passed: Callable[[], None]) -> None:
        self._source, self._kind, self._events = source, kind, events
        self._receive, self._on_passed = receive, on_passed
        self.has_gap = False
        self._last_number: dict[Sender, int] = {}
        self.heard: dict[Sender, tuple[float, float]] = {}
        self.subscription: Subscription[Any]

    def __call__(self, *taken: Any) -> None:
        """Take a message that an executor has received."""
        # EventsExecutor passes one tuple (message, information), while other executors pass two
        # arguments.
        message, info = taken if len(taken) == 2 else taken[0]
        with self.subscription.handle:
            self.pass_on(message, info)
        self._on_passed()

    def pass_on(self, message: bytes, info: Mapping[str, Any]) -> None:
        """Pass on a message that was taken, or reject it."""
        sender, number = self._sender(info), self._source.number
        self._events.count(RECEIVED, number)
        try:
            if self._source.log and self._kind is not self._source.logged:
                message = wrench_of(self._kind, message)
            self._receive(message, sender, number, info['received_timestamp'])
        except RejectedError as rejected:
            self._events.reject(rejected, number)

    def waiting(self) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
        """Take the waiting messages, and yield each with its information."""
        # Without a time limit, the loop would not end if messages arrive faster than we take them.
        until, subscription = time.monotonic() + _BUDGET, self.subscription
        with subscription.handle:
            while taken := subscription.handle.take_message(subscription.msg_type, True):
                yield taken
                if time.monotonic() > until:
                    break

    def _sender(self, info: Mapping[str, Any]) -> Sender:
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
            self._events.count_lost(self._source.number, number - previous - 1, is_first)
            self.has_gap |= not is_first
        return sender


class Intake:
    """
    Subscribe to the topics of sources, and count and pass on what arrives.

    Parameters
    ----------
    node : PollingNode
    scene : Scene
    sources : sequence of TorqueTopic
    diagnostics : Events
    qos : QoSProfile
        The QoS of all subscriptions but that to the inertia.
    is_polled : bool
        Whether `poll` takes the messages, and not an executor.
    receive, on_passed : callable
        See `DrainCallback`.

    Attributes
    ----------
    inputs : Inputs
    sources : dict of int to TorqueTopic
    drains : dict of int to DrainCallback
        The callback of each source that has a subscription, by source number.
    types : dict of int to MessageType
        The type of the messages of each source, once it is known.

    """

    def __init__(self, node: PollingNode, scene: Scene, sources: Sequence[TorqueTopic],
                 diagnostics: Events, qos: QoSProfile, is_polled: bool, receive: _Receive,
                 on_passed: Callable[[], None] = lambda: None) -> None:
        self._node, self._diagnostics = node, diagnostics
        self._qos, self._is_polled = qos, is_polled
        self._callbacks = receive, on_passed
        self.inputs = Inputs(scene, diagnostics)
        self._is_stamped = scene.time_source != ARRIVAL
        self.sources = {source.number: source for source in sources}
        #: Torques are expected to have their first type, until a publisher shows another one.
        self.types = {source.number: source.logged for source in sources if source.log}
        self.drains: dict[int, DrainCallback] = {}
        #: Why messages of a source cannot be received, by source number.
        self._mismatches: dict[int, list[str]] = {source.number: [] for source in sources}

    @property
    def subscriptions(self) -> list[Subscription[Any]]:
        """Return all subscriptions."""
        return [drain.subscription for drain in self.drains.values()]

    @property
    def first(self) -> int:
        """Return the number of the first source, whose status also has the general problems."""
        return next(iter(self.sources))

    def topic(self, source: int) -> str:
        """Return the full name of the topic of a source."""
        return self._node.resolve_topic_name(self.sources[source].topic)

    def publisher_count(self, source: int) -> int:
        """Return how many publishers are connected to the subscription of a source."""
        drain = self.drains.get(source)
        return drain.subscription.handle.get_publisher_count() if drain else 0

    def listen(self) -> None:
        """Subscribe to the sources that have no subscription, but whose type is known."""
        if len(self.drains) < len(self.types):
            self.drains = {
                number: self.drains.get(number) or self._drain(number)
                for number in self.sources if number in self.types}
            if self._is_polled:
                self._node.polled = {*self.subscriptions}

    def _drain(self, number: int) -> DrainCallback:
        source, kind = self.sources[number], self.types[number]
        drain = DrainCallback(source, kind, self._diagnostics, *self._callbacks)
        with one_line_errors():
            # An inertia is sent only once, so the connection must not lose it.
            drain.subscription = subscription(self._node, kind, source.topic, drain,
                                              RELIABLE if number == BODY else self._qos)
        return drain

    def close(self) -> None:
        """Forget the subscriptions, which are destroyed by the owner of the node."""
        self.drains, self._node.polled = {}, ()

    def follow_types(self, is_due: bool = True) -> None:
        """
        Look for publishers of another type, on topics that are silent or, if it is due, on all.

        Unsubscribe from the topics that have one. `listen` then subscribes with the new type. It
        must not be called in the same callback, because the executor keeps the old subscription
        until the callback returns, and Fast DDS allows a topic only one type in a process.
        """
        for number, source in self.sources.items():
            if is_due or not self.drains[number].heard:
                self._mismatches[number] = self._follow(source)

    def problems(self) -> dict[int, list[str]]:
        """Return for each source why its messages cannot be received, as far as is known."""
        return {number: [*reasons] for number, reasons in self._mismatches.items()}

    def _follow(self, source: TorqueTopic) -> list[str]:
        """Follow the type of a source. Return the reason if the type cannot be received."""
        topic, expected = self.topic(source.number), self.types.get(source.number)
        publishers = self._node.get_publishers_info_by_topic(topic)
        names, by_name = {info.topic_type for info in publishers}, {
            kind.name: kind for kind in source.kinds}
        if len(names) > 1 or not names <= by_name.keys():
            wrong = [info for info in publishers if info.topic_type not in by_name] or publishers
            nodes = listed(sorted(f'{info.topic_type} from {full_name(info)}' for info in wrong))
            return [f'{topic}: expected one of {listed(by_name)}, found {nodes}']
        if not names:
            return [] if expected else [f'{topic}: no publisher']
        kind = by_name[names.pop()]
        if kind is expected:
            return []
        try:
            class_of(kind)
        except ModuleNotFoundError as error:
            return [f'{topic}: cannot receive {kind.name}: {error}']
        self.types[source.number] = kind
        if drain := self.drains.pop(source.number, None):
            self._node.destroy_subscription(drain.subscription)
            is_px4 = isinstance(kind, messages.Px4Type)
            note = '; they are normalized, not in N m' if is_px4 else ''
            self._node.get_logger().warning(f'{topic}: {source.what}s are {kind.name}{note}')
        return []

    def poll(self) -> None:
        """Take the waiting messages of all subscriptions, in the order of their arrival."""
        taken = [(drain, message, info) for drain in self.drains.values()
                 for message, info in drain.waiting()]
        if len(self.drains) > 1:
            taken.sort(key=lambda row: row[2]['received_timestamp'])
        for drain, message, info in taken:
            drain.pass_on(message, info)

    def read(self, decode: Callable[[bytes, int], _Message], data: bytes, source: int,
             arrived_ns: int) -> _Message:
        """
        Decode a message of a source. If it has no stamp, its stamp is the time of its arrival.

        `decode` takes the data and the source, like `Inputs.torque`. It may raise RejectedError.
        """
        message = decode(data if self._is_stamped else messages.unstamped(data), source)
        if message.stamp_ns:
            return message
        if self._is_stamped:
            self._diagnostics.count(UNSTAMPED, source)
        return message._replace(stamp_ns=arrived_ns)
