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

"""Feed recorded messages to a node, one stamp at a time, and keep what the node publishes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
import pickle
import time
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.node.clocks import message_of
from rigid_body_ros.node.intake import full_name
from rigid_body_ros.node.process import Observer
from rigid_body_ros.recording.all_messages import AllMessages
from rosgraph_msgs.msg import Clock

#: If no connection changes for this many seconds, we assume that all connections are complete.
_QUIET = 2.0
#: How long a node may take to process a message, s. If an expected output is missing, how long to
#: wait for it, s; this becomes shorter each time, because other outputs may be missing as well.
_PATIENCE, _IN_TRANSIT = 20.0, 0.5
_CLOCK = '/clock'
#: The topics that every node has, or that we publish: neither inputs nor outputs.
_OTHERS = {_CLOCK, '/parameter_events', '/rosout'}
_DEPTH = 1000
#: A node floods if it publishes this many times as many messages as were recorded, and more than
#: `_DEPTH`.
_FLOOD = 3
#: The key of the time up to which the inputs are fed.
FED = 'inputs'
#: A log time, ns, and the topics and messages to publish at this time.
_Group = tuple[int, list[tuple[str, bytes]]]
#: A topic, the full name of a node that has connected to it, and the message type of the node.
_Connection = tuple[str, str, str]


class OpenLoopNode(Observer):
    """
    Feed recorded inputs to the nodes in the domain, and keep their outputs.

    The recorded topics to which a node subscribes are its inputs, and those that it publishes are
    its outputs. The messages are published one at a time in the order of their log times, after
    `/clock` if a node subscribes to it. Before the next one is published, each node must have
    processed it: the node answers a request for its parameters, which its executor takes after the
    message.

    Parameters
    ----------
    path : str
        The recording.
    step_ns : int, ns
        While no message is due, time goes forward by this much, for nodes with timers; 0 if time
        only goes forward with the messages.
    logs : collection of str
        Not used: it is for nodes that wait for some topics only.

    """

    has_rival = False

    def __init__(self, path: str, step_ns: int, logs: Collection[str] = ()) -> None:
        #: Who subscribes to topics, and who publishes on them.
        self._connections: tuple[set[_Connection], set[_Connection]]
        super().__init__((set(), set()))
        self._recorded, self._step_ns = AllMessages(path), step_ns
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._observer)
        self._topics = sorted({*self._recorded.topics} - _OTHERS)
        self._publishers: dict[str, Publisher[Any]] = {}
        self._clients: list[Client[Any, Any]] = []
        self._clock: Publisher[Any] | None = None
        self._groups: Iterator[_Group] | None = None
        self._next: _Group | None = None
        self._now_ns, self._missing = self._recorded.span_ns[0], 0
        self.elapsed_ns: dict[str, int] = {}
        #: The outputs of each topic: the time at which each was caused, ns, and its message.
        self._outputs: dict[str, list[tuple[int, bytes]]] = {}

    def __exit__(self, *error: object) -> None:
        self._executor.shutdown()
        super().__exit__(*error)

    @property
    def unpublished(self) -> list[str]:
        """Return the recorded topics that no node publishes."""
        return sorted({*self._topics} - {topic for topic, *_ in self._connections[1]})

    def spin(self, seconds: float) -> None:
        """Feed the nodes what is next; if nothing can be fed, sleep for a number of seconds."""
        if self._groups is None and self._is_connected():
            self._begin()
        elif self._groups is None or self._next is None:
            time.sleep(seconds)
        else:
            now, self._next = self._next, next(self._groups, None)
            self._feed(*now, self._next[0] if self._next else NEVER_NS)
            first_ns, last_ns = self._recorded.span_ns
            self.elapsed_ns = {FED: (now[0] if self._next else last_ns) - first_ns}

    def _is_connected(self) -> bool:
        """Return whether nodes have connected to topics, and no connection has changed since."""
        subscribed, published = (
            {(topic, full_name(peer), peer.topic_type)
             for topic in (*self._topics, _CLOCK) for peer in peers(topic)
             if peer.node_name != self.NAME}
            for peers in (self._observer.get_subscriptions_info_by_topic,
                          self._observer.get_publishers_info_by_topic))
        outputs = {topic for topic, *_ in published}
        return self._are_lasting((subscribed, published), _QUIET) and bool(outputs - _OTHERS) \
            and any(topic not in {*outputs, _CLOCK} for topic, *_ in subscribed)

    def _begin(self) -> None:
        """Publish the inputs, subscribe to the outputs, and wait until all are connected."""
        subscribed, published = self._connections
        outputs = {topic for topic, *_ in published} - _OTHERS
        inputs = {topic for topic, *_ in subscribed} - _OTHERS - outputs
        for topic, name, found in sorted(subscribed | published):
            if topic != _CLOCK and found != (recorded := self._recorded.topics[topic].type_name):
                raise InputError(f'{topic}: expected {recorded or "no type"} as in the recording, '
                                 f'found that {name} uses {found}')
        for topic in sorted(outputs):
            self._outputs[topic] = []
            self._observer.create_subscription(self._type(topic), topic, self._keep(topic), _qos(
                self._observer.get_publishers_info_by_topic(topic), all), raw=True)
        for topic in sorted(inputs):
            self._publishers[topic] = self._publisher(topic, self._type(topic))
        if any(topic == _CLOCK for topic, *_ in subscribed):
            self._clock = self._publisher(_CLOCK, Clock)
        elif self._step_ns:
            raise InputError('--step: expected a node that subscribes to /clock, found none; set '
                             'use_sim_time')
        # A node that only publishes may react to the outputs of another.
        names = sorted({name for _, name, _ in subscribed | published})
        self._clients = [self._observer.create_client(GetParameters, f'{name}/get_parameters')
                         for name in names]
        for name, client in zip(names, self._clients):
            if not client.wait_for_service(timeout_sec=_PATIENCE):
                raise InputError(f'expected a node with the service {name}/get_parameters, which '
                                 'tells when it has processed a message, found none')
        self._wait(lambda: all(publisher.get_subscription_count()
                               for publisher in self._publishers.values()), _PATIENCE)
        self._wait(lambda: False, _IN_TRANSIT)  # the node may not be connected to us yet
        self._groups = self._recorded.groups(inputs, self._step_ns)
        self._next = next(self._groups)

    def _type(self, topic: str) -> Any:
        return message_type(topic, self._recorded.topics[topic].type_name)

    def _publisher(self, topic: str, kind: Any) -> Publisher[Any]:
        return self._observer.create_publisher(
            kind, topic, _qos(self._observer.get_subscriptions_info_by_topic(topic), any))

    def _keep(self, topic: str) -> Callable[[bytes], None]:
        kept = self._outputs[topic]
        most = max(_DEPTH, _FLOOD * len(self._recorded.topics[topic].data))

        def keep(data: bytes) -> None:
            if len(kept) >= most:
                raise InputError(f'{topic}: expected about as many messages as in the recording, '
                                 f'found more than {most} before {self._now_ns} ns; does the '
                                 'node publish without end?')
            kept.append((self._now_ns, data))
        return keep

    def _feed(self, time_ns: int, messages: list[tuple[str, bytes]], next_ns: int) -> None:
        """Publish messages, wait until the nodes have processed them, and wait for outputs."""
        # A recorder logs an output a little after the input that causes it.
        wanted = {topic: len(kept) + self._recorded.count(topic, time_ns, next_ns)
                  for topic, kept in self._outputs.items()}
        self._now_ns = time_ns
        if self._clock:
            self._clock.publish(Clock(clock=message_of(time_ns)))
            self._synchronize()
        for topic, data in messages:
            self._publishers[topic].publish(data)
            self._synchronize()
        if not self._wait(lambda: all(len(self._outputs[topic]) >= number
                                      for topic, number in wanted.items()),
                          _IN_TRANSIT / (1 + self._missing)):
            self._missing += 1

    def _synchronize(self) -> None:
        """Wait until each node has taken what was published, and has called its callbacks."""
        # The request arrives after the message, because a node receives on one port in one thread.
        # The first request may be taken together with a message, before a timer that the message
        # makes due; the second one is not.
        for _ in range(2 if self._clock else 1):
            futures: list[Future[Any]] = [client.call_async(GetParameters.Request())
                                          for client in self._clients]
            if not self._wait(partial(_are_done, futures), _PATIENCE):
                raise InputError(f'expected a node that processes a message within {_PATIENCE:g} '
                                 f's, found none at {self._now_ns} ns')

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        until = time.monotonic() + seconds
        while not condition():
            if (rest := until - time.monotonic()) <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(rest, 0.05))
        return True

    def finish(self) -> None:
        """Receive outputs that nobody expects."""
        self._wait(lambda: False, _IN_TRANSIT)

    def write(self, path: str | Path, last_ns: int) -> None:
        """Write the names of the inputs, and the outputs."""
        Path(path).write_bytes(pickle.dumps(([*self._publishers], self._outputs)))


def _are_done(futures: list[Future[Any]]) -> bool:
    return all(future.done() for future in futures)


def _qos(peers: list[TopicEndpointInfo], strongest: Callable[[Iterable[bool]], bool]
         ) -> QoSProfile:
    """Return a profile that connects to peers: `any` for a publisher, `all` for a subscription."""
    reliable, latched = (
        strongest(policy is best for policy in policies) for policies, best in (
            ([peer.qos_profile.reliability for peer in peers], ReliabilityPolicy.RELIABLE),
            ([peer.qos_profile.durability for peer in peers], DurabilityPolicy.TRANSIENT_LOCAL)))
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def message_type(topic: str, name: str) -> Any:
    """Return the class of a message type; raise InputError if it is not installed."""
    package, _, kind = name.partition('/')
    with suppress(ImportError, AttributeError):
        return getattr(import_module(f'{package}.msg'), kind.rpartition('/')[2])
    raise InputError(f'{topic}: expected the package of {name} to be installed, found none')


def fields_of(topic: str, name: str, data: bytes) -> dict[str, Any]:
    """Return the fields of a message by their paths, such as 'pose.pose.orientation.x'."""
    message = deserialize_message(data, message_type(topic, name))
    return dict(_fields(message, ''))


def _fields(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if hasattr(value, 'get_fields_and_field_types'):
        for name in value.get_fields_and_field_types():
            yield from _fields(getattr(value, name), f'{path}.{name}' if path else name)
    elif hasattr(value, '__len__') and not isinstance(value, str | bytes):
        for number, part in enumerate(value.tolist() if hasattr(value, 'tolist') else value):
            yield from _fields(part, f'{path}[{number}]')
    else:
        yield path, value
