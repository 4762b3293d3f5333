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

"""Count events and problems, and report them in the log and on /diagnostics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
import math
import time
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile
from rclpy.subscription import Subscription
from rigid_body_ros.live.events import (
    APPLIED,
    CAUSES,
    CLIPPED,
    FORCE,
    LOST,
    MISSED,
    NOT_COMPUTABLE,
    OF_RESETS,
    RECEIVED,
    RejectedError,
    rejections,
    REPLACED,
    STATES,
    STATES_REJECTED,
    TIME_JUMP,
    TOO_FAST,
    UNSAVED,
    UNSENT,
    WAITING,
)
from rigid_body_ros.live.torque_queue import Sender
from rigid_body_ros.node.drain import DrainCallback
from rigid_body_ros.node.sources import BODY, COMMANDS, TorqueTopic

if TYPE_CHECKING:  # in Lyrical, rclpy.endpoint_info contains it
    from rclpy.topic_endpoint_info import TopicEndpointInfo

_SEVERAL_PUBLISHERS, _QOS = 'several publishers', 'incompatible QoS'
_OF_TORQUES = (REPLACED, FORCE, LOST)
_OF_COMMANDS = (REPLACED, CLIPPED, TOO_FAST, LOST)
_OF_MOTION = (MISSED, NOT_COMPUTABLE, UNSENT, UNSAVED, TIME_JUMP, STATES, STATES_REJECTED)
#: The key under which the time since the newest torque of a source arrived is reported.
AGE = 'age of the newest torque (s)'
#: A status is an error if a count in `_ERRORS` has increased since the last report, and a warning
#: if a count in `_WARNINGS` or `_TORQUE_WARNINGS` has increased.
_ERRORS = (MISSED, NOT_COMPUTABLE, UNSENT, UNSAVED, STATES_REJECTED)
_WARNINGS = (TIME_JUMP,)
_TORQUE_WARNINGS = (REPLACED, TOO_FAST, LOST)
#: Shortest time between two log messages of one kind, s.
_LOG_PERIOD = 5.0


class _Counts(Counter[str]):
    """The counts of one status."""

    def __init__(self) -> None:
        super().__init__()
        self._published: Counter[str] = Counter()

    def increments(self) -> Counter[str]:
        """Return the increase of the counts since the last call."""
        new = Counter(self) - self._published
        self._published = Counter(self)
        return new


class Diagnostics:
    """
    Count events that concern the torques of each source, and events that concern the motion.

    Every torque sent is either lost or received. Every torque received is applied, rejected for a
    cause, or waiting.
    """

    def __init__(self, node: Node, sources: Sequence[TorqueTopic]) -> None:
        self._node, self._sources = node, {source.number: source for source in sources}
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # Latched, so that a result also reaches a subscription that connects later.
        self._results = node.create_publisher(
            DiagnosticStatus, '~/initial_state_result',
            QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self._torques = {source: _Counts() for source in self._sources}
        self._motion = _Counts()
        #: Monotonic time, s, of the last log message of each kind.
        self._logged_at: dict[str, float] = {}

    def ignore_mass(self) -> None:
        """Log, once, that the mass and the centre of mass of an inertia are ignored."""
        self._node.get_logger().info('the mass and the centre of mass of an InertiaStamped are '
                                     'ignored: the inertia is that about the centre of mass',
                                     once=True)

    def count(self, name: str, source: int, number: int = 1) -> None:
        """Add a number of events to a count of a source, without logging."""
        self._torques[source][name] += number

    def accept_state(self, result: str, stamp_ns: int) -> None:
        """Count an accepted initial state, which begins an epoch, and publish the result."""
        self._motion[STATES] += 1
        self._acknowledge(result, stamp_ns, is_error=False)

    def reject(self, rejected: RejectedError, source: int) -> None:
        """Count a rejected torque of a source, and log the reason."""
        cause, counts = rejected.cause, self._torques[source]
        counts[cause] += 1
        what = self._sources[source].what + self._place(source)
        self._log(f'{cause} {source}', f'{what} rejected '
                  f'({counts[cause]} so far): {cause}: {rejected}')

    def event(self, name: str, text: str, kind: str = '') -> None:
        """Count a problem of the motion, and log it; each kind is logged at a limited rate."""
        self._motion[name] += 1
        self._log(f'{name} {kind}', text)

    def count_force(self, source: int) -> None:
        """Count an ignored force; log only the first one, because ignored forces are no fault."""
        self._torques[source][FORCE] += 1
        if sum(counts[FORCE] for counts in self._torques.values()) == 1:
            self._node.get_logger().info('the force of a WrenchStamped is ignored, as it has no '
                                         'lever arm about the centre of mass; diagnostics count '
                                         'such forces')

    def reject_state(self, rejected: RejectedError, stamp_ns: int | None) -> None:
        """Count a rejected initial state, and log and publish the reason."""
        reason = f'{rejected.cause}: {rejected}'
        self.event(STATES_REJECTED, f'initial_state rejected: {reason}')
        self._acknowledge(reason, stamp_ns, is_error=True)

    def _acknowledge(self, text: str, stamp_ns: int | None, is_error: bool) -> None:
        stamp = {} if stamp_ns is None else {'stamp': stamp_ns}
        self._results.publish(self.status('initial_state', is_error, False, text, stamp))

    def count_lost(self, source: int, number: int) -> None:
        """Count the torques that are missing between two torques of one publisher, and warn."""
        counts = self._torques[source]
        counts[LOST] += number
        self._log(f'{LOST} {source}', f'{self._sources[source].what}s{self._place(source)} lost '
                  f'so far: {counts[LOST]}; the network dropped them, or they arrive faster than '
                  'this machine can process them')

    def _place(self, source: int) -> str:
        return f' on {self._sources[source].topic}' if len(self._sources) > 1 else ''

    def connection_problems(self, problems: Mapping[int, list[str]],
                            torques: Mapping[int, DrainCallback],
                            inputs: Iterable[Subscription], outputs: Iterable[Publisher],
                            several: str) -> Mapping[int, list[str]]:
        """
        Add missing, surplus and incompatible connections to `problems`, and return `problems`.

        Parameters
        ----------
        problems : mapping of int to list of str
            The problems of each source.
        torques : mapping of int to DrainCallback
            The callbacks of the subscriptions to torques, by source.
        inputs : iterable of Subscription
            All subscriptions of the node.
        outputs : iterable of Publisher
            All publishers of the node.
        several : str
            Text for the log: what happens to torques if several nodes publish one topic.

        Returns
        -------
        mapping of int to list of str

        """
        for source, drain in torques.items():
            if source != BODY:  # the publisher of an inertia need not stay connected
                problems[source].extend(self._surplus(drain, several))
        topics = {drain.subscription.topic_name: source for source, drain in torques.items()}
        first = next(iter(problems))
        for subscription in inputs:
            peers = self._node.get_publishers_info_by_topic(subscription.topic_name)
            problems[topics.get(subscription.topic_name, first)].extend(
                self._incompatible(subscription.topic_name, peers, 'subscriptions'))
        for publisher in outputs:
            peers = self._node.get_subscriptions_info_by_topic(publisher.topic_name)
            problems[first].extend(self._incompatible(publisher.topic_name, peers, 'publishers'))
        return problems

    def _surplus(self, drain: DrainCallback, several: str) -> list[str]:
        topic = drain.subscription.topic_name
        found = self._node.get_publishers_info_by_topic(topic)
        if not found:
            return [f'{topic}: no publisher']
        found = [info for info in found if not _is_replaced(info, found, drain.heard)]
        if len(found) == 1:
            return []
        names = ', '.join(sorted(_full_name(info) for info in found))
        problem = f'{topic}: {len(found)} publishers: {names}; {several}'
        self._log(f'{_SEVERAL_PUBLISHERS} {topic}', problem)
        return [problem]

    def _incompatible(self, topic: str, peers: Iterable[TopicEndpointInfo],
                      own: str) -> list[str]:
        # Compare the profiles as DDS reports them, with defaults resolved.
        endpoints = getattr(self._node, f'get_{own}_info_by_topic')(topic)
        profile = next((info.qos_profile for info in endpoints
                        if _full_name(info) == self._node.get_fully_qualified_name()), None)
        problems = []
        for info in peers if profile else ():
            pair = (profile, info.qos_profile) if own == 'publishers' else \
                (info.qos_profile, profile)
            compatible, reason = qos_check_compatible(*pair)
            if compatible == QoSCompatibility.ERROR:
                problems.append(f'{topic}: {_full_name(info)} is not connected: '
                                f'{reason.removeprefix("ERROR: ").rstrip("; ")}')
        if problems:
            self._log(f'{_QOS} {topic}', '; '.join(problems))
        return problems

    def publish(self, problems: Mapping[int, list[str]], waiting: Mapping[int, int],
                ages: Mapping[int, float | None], epoch: str, stamp: Time,
                others: Iterable[DiagnosticStatus] = ()) -> None:
        """
        Publish all counts, and the statuses `others`; counts that have increased set the levels.

        The keys of `problems`, `waiting` (how many torques wait) and `ages` (of the newest torque,
        s) are the numbers of the sources. `epoch` is the message of the status `motion` if nothing
        is wrong.
        """
        statuses = [self._torque_status(source, problems.get(source, []), {
            WAITING: waiting[source], AGE: _age(ages[source])}) for source in self._sources]
        counts, new = self._motion, self._motion.increments()
        errors = [f'{name}: {new[name]}' for name in _ERRORS if new[name]]
        warnings = [f'{name}: {new[name]}' for name in _WARNINGS if new[name]]
        statuses.append(self.status(
            'motion', bool(errors), bool(warnings), '; '.join(errors + warnings) or epoch,
            {name: counts[name] for name in _OF_MOTION}))
        array = DiagnosticArray(status=[*statuses, *others])
        array.header.stamp = stamp
        self._publisher.publish(array)

    def _torque_status(self, source: int, problems: list[str],
                       present: Mapping[str, object]) -> DiagnosticStatus:
        counts, new = self._torques[source], self._torques[source].increments()
        rejected = [f'{rejections(cause)}: {new[cause]}' for cause in CAUSES if new[cause]]
        warnings = problems + [f'{name}: {new[name]}' for name in _TORQUE_WARNINGS if new[name]]
        is_error = any(new[cause] for cause in CAUSES if cause not in OF_RESETS)
        return self.status(
            self._sources[source].status, is_error, bool(rejected or warnings),
            '; '.join(rejected + warnings) or 'OK',
            {RECEIVED: counts[RECEIVED], APPLIED: counts[APPLIED],
             **{rejections(cause): counts[cause] for cause in CAUSES}, **present,
             **{name: counts[name] for name in
                (_OF_COMMANDS if source == COMMANDS else _OF_TORQUES)}})

    def status(self, name: str, is_error: bool, is_warning: bool, message: str,
               values: Mapping[str, object]) -> DiagnosticStatus:
        """Return a status of the node."""
        # The name includes the namespace, because aggregators identify a status by its name, and
        # nodes of a fleet differ only in their namespaces. The name keeps the leading slash,
        # because it begins with the full name of the node.
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


def _age(seconds: float | None) -> str:
    return 'none yet' if seconds is None else f'{seconds:.3f}'


def _is_replaced(info: TopicEndpointInfo, peers: Iterable[TopicEndpointInfo],
                 heard: Mapping[Sender, tuple[float, float]]) -> bool:
    """Return whether a publisher fell silent before its node's next publisher was first heard."""
    # After a publisher is killed, the middleware lists it until its lease ends.
    _, last = heard.get(bytes(info.endpoint_gid), (0.0, math.inf))
    return any(heard.get(bytes(peer.endpoint_gid), (0.0, 0.0))[0] > last
               for peer in peers if _full_name(peer) == _full_name(info))


def _full_name(info: TopicEndpointInfo) -> str:
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'
