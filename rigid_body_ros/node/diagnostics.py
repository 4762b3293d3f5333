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
from collections.abc import Iterable, Mapping
import time
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_check_compatible, QoSCompatibility
from rclpy.subscription import Subscription
from rigid_body_ros.node.inputs import CAUSES, RejectedError

if TYPE_CHECKING:  # Lyrical has it in rclpy.endpoint_info
    from rclpy.topic_endpoint_info import TopicEndpointInfo

RECEIVED, APPLIED, WAITING = 'received', 'applied', 'waiting'
#: Names of the counts other than those of rejected torques.
REPLACED, FORCE = 'replaced (same stamp)', 'force ignored'
LOST, OVERFLOW = 'lost in transit', 'dropped (queue full)'
MISSED, NOT_COMPUTABLE, UNSENT = 'deadlines missed', 'states not computable', 'publish failures'
TIME_JUMP = 'clock jumps'
STATES, STATES_REJECTED = 'initial states', 'initial states rejected'
_SEVERAL_PUBLISHERS, _QOS = 'several publishers', 'incompatible QoS'
_OF_TORQUES = (REPLACED, FORCE, LOST, OVERFLOW)
_OF_MOTION = (MISSED, NOT_COMPUTABLE, UNSENT, TIME_JUMP, STATES, STATES_REJECTED)
#: Counts that make a status an error, or a warning, in any second in which they increase.
_ERRORS, _WARNINGS = (MISSED, NOT_COMPUTABLE, UNSENT, STATES_REJECTED), (TIME_JUMP,)
_TORQUE_WARNINGS = (REPLACED, LOST, OVERFLOW)
#: s; shortest time between two log messages of one kind.
_LOG_PERIOD = 5.0


def rejections(cause: str) -> str:
    """Return the key under which torques rejected for a cause are counted."""
    return f'rejected: {cause}'


class Diagnostics:
    """
    Count events of torques and of the motion.

    Every torque sent is either lost in transit, dropped from the full queue, or received. Every
    torque received is applied, rejected for a cause, or waiting.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._counts: Counter[str] = Counter()
        self._published_counts: Counter[str] = Counter()
        #: Monotonic time, s, of the last log message of each kind.
        self._logged_at: dict[str, float] = {}
        self._missing = 0

    def count(self, name: str) -> None:
        """Count an event without logging it."""
        self._counts[name] += 1

    def reject(self, rejected: RejectedError) -> None:
        """Count a rejected torque and log the reason."""
        cause = rejected.cause
        self._counts[cause] += 1
        self._log(cause, f'torque rejected ({self._counts[cause]} so far): {cause}: {rejected}')

    def event(self, name: str, text: str, number: int = 1) -> None:
        """Count a problem and log it."""
        self._counts[name] += number
        self._log(name, text)

    def count_force(self) -> None:
        """Count an ignored force, and log only the first, as it is not a fault."""
        self._counts[FORCE] += 1
        if self._counts[FORCE] == 1:
            self._node.get_logger().warning('the force of a WrenchStamped is ignored: its torque '
                                            'is taken about the centre of mass')

    def reject_state(self, rejected: RejectedError) -> None:
        """Count a rejected initial state and log the reason."""
        self.event(STATES_REJECTED, f'initial_state rejected: {rejected.cause}: {rejected}')

    def count_lost(self, number: int) -> None:
        """Count torques that the middleware reports as lost in transit."""
        self.event(LOST, f'torques lost in transit so far: {self._counts[LOST] + number}', number)
        self.count_missing(0)

    def count_missing(self, number: int) -> None:
        """
        Count torques that are missing between two torques from one publisher.

        Missing torques that the middleware does not report as lost in transit were dropped from
        the full queue.
        """
        self._missing += number
        self._counts[OVERFLOW] = max(0, self._missing - self._counts[LOST])
        if number and self._counts[OVERFLOW]:
            self._log(OVERFLOW, 'torques dropped from the full queue so far: '
                      f'{self._counts[OVERFLOW]}; they arrive faster than this machine can '
                      'process them')

    def connection_problems(self, torques: Subscription, inputs: Iterable[Subscription],
                            outputs: Iterable[Publisher], several: str) -> list[str]:
        """
        Return missing, surplus and incompatible connections.

        Parameters
        ----------
        torques : Subscription
            The subscription to torques.
        inputs : iterable of Subscription
            All subscriptions of the node.
        outputs : iterable of Publisher
            All publishers of the node.
        several : str
            Text for the log: what happens to the torques of several publishers.

        Returns
        -------
        list of str

        """
        problems = []
        found = self._node.get_publishers_info_by_topic(torques.topic_name)
        if not found:
            problems.append(f'{torques.topic_name}: no publisher')
        if len(found) > 1:
            names = ', '.join(sorted(_full_name(info) for info in found))
            problems.append(f'{torques.topic_name}: {len(found)} publishers: {names}; {several}')
            self._log(_SEVERAL_PUBLISHERS, problems[-1])
        for subscription in inputs:
            peers = self._node.get_publishers_info_by_topic(subscription.topic_name)
            problems += self._incompatible(subscription.topic_name, peers, 'subscriptions')
        for publisher in outputs:
            peers = self._node.get_subscriptions_info_by_topic(publisher.topic_name)
            problems += self._incompatible(publisher.topic_name, peers, 'publishers')
        return problems

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

    def publish(self, problems: list[str], waiting: int, epoch: str, stamp: Time) -> None:
        """Publish all counts; warn of those that have increased since the last call."""
        counts, new = self._counts, self._counts - self._published_counts
        self._published_counts = counts.copy()
        rejected = [f'{rejections(cause)}: {new[cause]}' for cause in CAUSES if new[cause]]
        warnings = problems + [f'{name}: {new[name]}' for name in _TORQUE_WARNINGS if new[name]]
        torques = self._status(
            'torques', bool(rejected), bool(warnings), '; '.join(rejected + warnings) or 'OK',
            {RECEIVED: counts[RECEIVED], APPLIED: counts[APPLIED],
             **{rejections(cause): counts[cause] for cause in CAUSES}, WAITING: waiting,
             **{name: counts[name] for name in _OF_TORQUES}})
        errors = [f'{name}: {new[name]}' for name in _ERRORS if new[name]]
        warnings = [f'{name}: {new[name]}' for name in _WARNINGS if new[name]]
        motion = self._status(
            'motion', bool(errors), bool(warnings), '; '.join(errors + warnings) or epoch,
            {name: counts[name] for name in _OF_MOTION})
        array = DiagnosticArray(status=[torques, motion])
        array.header.stamp = stamp
        self._publisher.publish(array)

    def _status(self, name: str, is_error: bool, is_warning: bool, message: str,
                values: Mapping[str, int]) -> DiagnosticStatus:
        level = DiagnosticStatus.WARN if is_warning else DiagnosticStatus.OK
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if is_error else level,
            name=f'{self._node.get_name()}: {name}', hardware_id=self._node.get_name(),
            message=message,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])

    def _log(self, kind: str, text: str) -> None:
        now, last = time.monotonic(), self._logged_at.get(kind)
        if last is None or now - last > _LOG_PERIOD:
            self._logged_at[kind] = now
            self._node.get_logger().warning(text)


def _full_name(info: TopicEndpointInfo) -> str:
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'
