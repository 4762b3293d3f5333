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

"""Count events and problems, and report them in the node's log and on /diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
import math
import statistics
import time
from typing import Any, TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile
from rclpy.subscription import Subscription
from rigid_body_ros.live import events
from rigid_body_ros.live.torque_queue import Sender
from rigid_body_ros.node.intake import DrainCallback, full_name
from rigid_body_ros.node.sources import BODY, COMMANDS, TorqueTopic

if TYPE_CHECKING:  # moved to rclpy.endpoint_info in Lyrical
    from rclpy.topic_endpoint_info import TopicEndpointInfo

_SEVERAL_PUBLISHERS, _QOS = 'several publishers', 'incompatible QoS'
#: Under this key, diagnostics report how long ago the newest torque of a source arrived.
AGE = 'age of the newest torque (s)'
#: Under these keys, diagnostics report how far the stamps of a source are ahead of the clock.
OFFSETS = 'offset of stamps, median (s)', 'offset of stamps, largest (s)'
#: Log messages of the same kind are at least this many seconds apart.
_LOG_PERIOD = 5.0


class _Counts(Counter[str]):
    """The counts that one diagnostic status reports."""

    def __init__(self) -> None:
        super().__init__()
        self._published: Counter[str] = Counter()

    def increments(self) -> Counter[str]:
        """Return how much each count has increased since the last call of this method."""
        new = Counter(self) - self._published
        self._published = Counter(self)
        return new


class Diagnostics:
    """
    Count what happens to the torques of each source, and what happens to the motion.

    Every torque that is sent is either lost or received. Every torque that is received has been
    applied, has been rejected for one of the counted causes, or is still waiting.
    """

    def __init__(self, node: Node, sources: Sequence[TorqueTopic],
                 largest_offset: float = 0.0) -> None:
        self._largest_offset = largest_offset
        #: By source, how far the stamps since the last report are ahead of the clock, ns, and the
        #: median and the largest value of the last report that had any, s.
        self._offsets_ns: dict[int, list[int]] = {}
        self._offsets: dict[int, tuple[float, float]] = {}
        self._node, self._sources = node, {source.number: source for source in sources}
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # The topic is latched, so that a subscription that connects later also gets the result.
        self._results = node.create_publisher(
            DiagnosticStatus, '~/initial_state_result',
            QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self._torques = {source: _Counts() for source in self._sources}
        self._motion = _Counts()
        #: When a message of each kind was last logged, in seconds on the monotonic clock.
        self._logged_at: dict[str, float] = {}

    def ignore_mass(self) -> None:
        """Log once that the mass and the centre of mass of an inertia message are ignored."""
        self._node.get_logger().info('the mass and the centre of mass of an InertiaStamped are '
                                     'ignored: the inertia is that about the centre of mass',
                                     once=True)

    def count(self, name: str, source: int, number: int = 1) -> None:
        """Count events that concern the torques of a source. Do not log these events."""
        self._torques[source][name] += number

    def offset(self, source: int, ahead_ns: int) -> None:
        """Record how far the stamp of a torque is ahead of the clock on its arrival, ns."""
        self._offsets_ns.setdefault(source, []).append(ahead_ns)

    def accept_state(self, result: str, stamp_ns: int) -> None:
        """Count an initial state that was accepted and began an epoch, and publish the result."""
        self._motion[events.STATES] += 1
        self._acknowledge(result, stamp_ns, is_error=False)

    def reject(self, rejected: events.RejectedError, source: int) -> None:
        """Count a torque that was rejected, and log the reason."""
        cause, counts = rejected.cause, self._torques[source]
        counts[cause] += 1
        what = self._sources[source].what + self._place(source)
        self._log(f'{cause} {source}', f'{what} rejected '
                  f'({counts[cause]} so far): {cause}: {rejected}')

    def event(self, name: str, text: str, kind: str = '') -> None:
        """Count a problem with the motion, and log it unless this kind was logged recently."""
        self._motion[name] += 1
        self._log(f'{name} {kind}', text)

    def count_force(self, source: int) -> None:
        """
        Count a force that was ignored.

        Only the first such force is logged, because ignoring a force is not a fault.
        """
        self._torques[source][events.FORCE] += 1
        if sum(counts[events.FORCE] for counts in self._torques.values()) == 1:
            self._node.get_logger().info('the force of a WrenchStamped is ignored, as it has no '
                                         'lever arm about the centre of mass; diagnostics count '
                                         'such forces')

    def reject_state(self, rejected: events.RejectedError, stamp_ns: int | None) -> None:
        """Count an initial state that was rejected, and log and publish the reason."""
        reason = f'{rejected.cause}: {rejected}'
        self.event(events.STATES_REJECTED, f'initial_state rejected: {reason}')
        self._acknowledge(reason, stamp_ns, is_error=True)

    def _acknowledge(self, text: str, stamp_ns: int | None, is_error: bool) -> None:
        stamp = {} if stamp_ns is None else {'stamp': stamp_ns}
        self._results.publish(self.status('initial_state', is_error, False, text, stamp))

    def count_lost(self, source: int, number: int, is_first: bool = False) -> None:
        """
        Count the torques lost between two torques of a publisher, and log a warning.

        If the second torque is the first that was received from this publisher, only log how many
        came before, because the node may have been started later.
        """
        if is_first:
            self._node.get_logger().info(
                f'{self._sources[source].topic}: the first {self._sources[source].what} received '
                f'from a publisher is its number {number + 1}; the earlier ones were not received')
            return
        counts = self._torques[source]
        counts[events.LOST] += number
        self._log(f'{events.LOST} {source}', f'{self._sources[source].what}s{self._place(source)} '
                  f'lost so far: {counts[events.LOST]}; the network dropped them, or they arrive '
                  'faster than this machine can process them')

    def _place(self, source: int) -> str:
        return f' on {self._sources[source].topic}' if len(self._sources) > 1 else ''

    def connection_problems(self, problems: Mapping[int, list[str]],
                            torques: Mapping[int, DrainCallback],
                            inputs: Iterable[Subscription[Any]], outputs: Iterable[Publisher[Any]],
                            several: str) -> Mapping[int, list[str]]:
        """
        Look for missing, surplus and incompatible connections, and add them to the problems.

        Parameters
        ----------
        problems : mapping of int to list of str
            The problems found so far, by source. The method adds to these lists.
        torques : mapping of int to DrainCallback
            The callbacks of the torque subscriptions, by source.
        inputs : iterable of Subscription
            The subscriptions to check for incompatible publishers.
        outputs : iterable of Publisher
            The publishers to check for incompatible subscriptions.
        several : str
            A text for the log that says what happens if several nodes publish on one topic.

        Returns
        -------
        mapping of int to list of str
            The argument `problems`.

        """
        for source, drain in torques.items():
            if source != BODY:  # a node that publishes an inertia need not stay connected
                problems[source].extend(self._surplus(drain, several))
        topics = {drain.subscription.topic_name: source for source, drain in torques.items()}
        first = next(iter(problems))
        for subscription in inputs:
            problems[topics.get(subscription.topic_name, first)].extend(
                self._incompatible(subscription.topic_name, is_input=True))
        for publisher in outputs:
            problems[first].extend(self._incompatible(publisher.topic_name, is_input=False))
        return problems

    def _surplus(self, drain: DrainCallback, several: str) -> list[str]:
        topic = drain.subscription.topic_name
        connected = self._node.get_publishers_info_by_topic(topic)
        if not connected:
            return [f'{topic}: no publisher']
        publishers = [info for info in connected
                      if not _is_replaced(info, connected, drain.heard)]
        if len(publishers) == 1:
            return []
        names = ', '.join(sorted(map(full_name, publishers)))
        problem = f'{topic}: {len(publishers)} publishers: {names}; {several}'
        self._log(f'{_SEVERAL_PUBLISHERS} {topic}', problem)
        return [problem]

    def _incompatible(self, topic: str, is_input: bool) -> list[str]:
        # Compare the QoS profiles that DDS reports, because these contain no unresolved defaults.
        publishers = self._node.get_publishers_info_by_topic(topic)
        subscriptions = self._node.get_subscriptions_info_by_topic(topic)
        own, peers = (subscriptions, publishers) if is_input else (publishers, subscriptions)
        profile = next((info.qos_profile for info in own
                        if full_name(info) == self._node.get_fully_qualified_name()), None)
        problems = []
        for info in peers if profile else ():
            compatible, reason = qos_check_compatible(
                *((info.qos_profile, profile) if is_input else (profile, info.qos_profile)))
            if compatible == QoSCompatibility.ERROR:
                problems.append(f'{topic}: {full_name(info)} is not connected: '
                                f'{reason.removeprefix("ERROR: ").rstrip("; ")}')
        if problems:
            self._log(f'{_QOS} {topic}', '; '.join(problems))
        return problems

    def publish(self, problems: Mapping[int, list[str]], waiting: Mapping[int, int],
                ages: Mapping[int, float | None], epoch: str, stamp: Time,
                others: Iterable[DiagnosticStatus] = ()) -> None:
        """
        Publish a status for each source and for the motion.

        The level of a status depends on its problems, and on which of its counts have increased
        since the last report.

        Parameters
        ----------
        problems : mapping of int to list of str
            The problems of each source, by source number.
        waiting : mapping of int to int
            How many torques of each source are waiting.
        ages : mapping of int to float or None
            The age of each source's newest torque, s.
        epoch : str
            The message of the status `motion` if nothing is wrong.
        stamp : Time
            The stamp of the message.
        others : iterable of DiagnosticStatus
            Further statuses to publish.

        """
        statuses = [self._torque_status(source, problems.get(source, []), {
            events.WAITING: waiting[source], AGE: _seconds(ages[source])})
            for source in self._sources]
        counts, new = self._motion, self._motion.increments()
        errors = [f'{name}: {new[name]}' for name in events.ERRORS if new[name]]
        warnings = [f'{name}: {new[name]}' for name in events.MOTION_WARNINGS if new[name]]
        statuses.append(self.status(
            'motion', bool(errors), bool(warnings), '; '.join(errors + warnings) or epoch,
            {name: counts[name] for name in events.OF_MOTION}))
        array = DiagnosticArray(status=[*statuses, *others])
        array.header.stamp = stamp
        self._publisher.publish(array)

    def _torque_status(self, source: int, problems: list[str],
                       present: Mapping[str, object]) -> DiagnosticStatus:
        counts, new = self._torques[source], self._torques[source].increments()
        problems = problems + self._offset_problems(source)
        if source in self._offsets:
            present = {**present, **dict(zip(OFFSETS, map(_seconds, self._offsets[source])))}
        rejected = [f'{events.rejections(cause)}: {new[cause]}'
                    for cause in events.CAUSES if new[cause]]
        warnings = problems + [f'{name}: {new[name]}'
                               for name in events.TORQUE_WARNINGS if new[name]]
        notes = [f'{events.UNSTAMPED}: {new[events.UNSTAMPED]}'] if new[events.UNSTAMPED] else []
        is_error = any(new[cause] for cause in events.CAUSES if cause not in events.OF_RESETS)
        return self.status(
            self._sources[source].status, is_error, bool(rejected or warnings),
            '; '.join((rejected + warnings or ['OK']) + notes),
            {events.RECEIVED: counts[events.RECEIVED], events.APPLIED: counts[events.APPLIED],
             **{events.rejections(cause): counts[cause] for cause in events.CAUSES}, **present,
             **{name: counts[name] for name in
                (events.OF_COMMANDS if source == COMMANDS else events.OF_TORQUES)}})

    def _offset_problems(self, source: int) -> list[str]:
        if offsets_ns := self._offsets_ns.pop(source, []):
            self._offsets[source] = (1e-9 * statistics.median(offsets_ns),
                                     1e-9 * max(offsets_ns, key=abs))
        median, _ = self._offsets.get(source, (0.0, 0.0))
        if not abs(median) > self._largest_offset > 0.0:
            return []
        topic = self._node.resolve_topic_name(self._sources[source].topic)
        side = 'ahead of' if median > 0.0 else 'behind'
        problem = (f'{topic}: the stamps are {abs(median):.3g} s {side} the clock (median): is '
                   'the clock of the sender right?')
        self._log(f'{OFFSETS[0]} {source}', problem)
        return [problem]

    def status(self, name: str, is_error: bool, is_warning: bool, message: str,
               values: Mapping[str, object]) -> DiagnosticStatus:
        """Return a diagnostic status of the node."""
        # The status name begins with the node's full name, including the namespace and the leading
        # slash. Aggregators identify a status by its name, and the nodes of a fleet differ only in
        # their namespaces.
        node = self._node.get_fully_qualified_name()
        level = DiagnosticStatus.WARN if is_warning else DiagnosticStatus.OK
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if is_error else level,
            name=f'{node}: {name}', hardware_id=node, message=message,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])

    def _log(self, kind: str, text: str) -> None:
        now, last = time.monotonic(), self._logged_at.get(kind)
        if last is None or now - last > _LOG_PERIOD:
            self._logged_at[kind] = now
            self._node.get_logger().warning(text)


def _seconds(seconds: float | None) -> str:
    return 'none yet' if seconds is None else f'{seconds:.3f}'


def _is_replaced(info: TopicEndpointInfo, peers: Iterable[TopicEndpointInfo],
                 heard: Mapping[Sender, tuple[float, float]]) -> bool:
    """
    Return whether a newer publisher of the same node has replaced a publisher.

    This is the case if the old publisher fell silent before the new one was first heard.
    """
    # When a node is killed, the middleware still lists the node's publisher until the lease of
    # that publisher runs out.
    _, last = heard.get(bytes(info.endpoint_gid), (0.0, math.inf))
    return any(heard.get(bytes(peer.endpoint_gid), (0.0, 0.0))[0] > last
               for peer in peers if full_name(peer) == full_name(info))
