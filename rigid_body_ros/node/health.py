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

"""What went wrong and how often: counters, the log at a limited rate, /diagnostics."""

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
from rigid_body_ros.node.inputs import CAUSES, RefusedError

if TYPE_CHECKING:  # Lyrical has it in rclpy.endpoint_info
    from rclpy.topic_endpoint_info import TopicEndpointInfo

RECEIVED, APPLIED = 'received', 'applied'
#: What is counted in addition to rejected torques.
REPLACED, FORCE = 'of a stamp that came before', 'with a force'
LOST, OVERFLOW = 'lost on the way', 'lost in the queue'
SLOW, UNKNOWN, UNSENT = 'slow', 'states unknown', 'messages not sent'
TIME_JUMP = 'clock jumps'
STATES, STATES_REFUSED = 'initial states', 'initial states refused'
PUBLISHERS, QOS = 'several publishers', 'incompatible QoS'
_OF_TORQUES = (REPLACED, FORCE, LOST, OVERFLOW)
_OF_MOTION = (SLOW, UNKNOWN, UNSENT, TIME_JUMP, STATES, STATES_REFUSED)
#: Counts that make a status an error, or a warning, in the second in which they grow.
_ERRORS, _WARNINGS = (SLOW, UNKNOWN, UNSENT, STATES_REFUSED), (TIME_JUMP,)
_TORQUE_WARNINGS = (REPLACED, LOST, OVERFLOW)
_REPORT_EVERY_S = 5.0


class Health:
    """
    Counts what happens to torques and motion.

    Every torque sent is lost on the way or in the queue, or it is received. Every torque received
    is applied, rejected for a cause, or waiting for the motion or the clock to get there.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._counts: Counter[str] = Counter()
        self._told: Counter[str] = Counter()
        self._reported: dict[str, float] = {}
        self._missing = 0

    def count(self, name: str) -> None:
        """Count something that needs no word in the log."""
        self._counts[name] += 1

    def refuse(self, refused: RefusedError) -> None:
        """Count a message that is not taken, and say why."""
        cause = refused.cause
        self._counts[cause] += 1
        self._say(cause, f'refused ({cause}, {self._counts[cause]} so far): {refused}')

    def event(self, name: str, text: str, number: int = 1) -> None:
        """Count something else that should not be, and say it."""
        self._counts[name] += number
        self._say(name, text)

    def force(self) -> None:
        """Count a force that is ignored; it is no fault, so the log has it only once."""
        self._counts[FORCE] += 1
        if self._counts[FORCE] == 1:
            self._node.get_logger().warning('the force of a WrenchStamped is ignored: torques are '
                                            'about the centre of mass')

    def refuse_state(self, refused: RefusedError) -> None:
        """Count an initial state that is not taken, and say why."""
        self.event(STATES_REFUSED, f'initial_state: refused ({refused.cause}): {refused}')

    def lost(self, number: int) -> None:
        """Count torques that the middleware lost on the way."""
        self.event(LOST, f'{self._counts[LOST] + number} torques were lost on the way so far',
                   number)
        self.missing(0)

    def missing(self, number: int) -> None:
        """
        Count torques that are missing between two of one publisher.

        Those that the middleware does not report as lost on the way were lost in the full queue.
        """
        self._missing += number
        self._counts[OVERFLOW] = max(0, self._missing - self._counts[LOST])
        if number and self._counts[OVERFLOW]:
            self._say(OVERFLOW, f'{self._counts[OVERFLOW]} torques were lost in the full queue so '
                      'far: they come faster than this machine can take them')

    def inspect(self, torques: Subscription, inputs: Iterable[Subscription],
                outputs: Iterable[Publisher], several: str) -> list[str]:
        """
        Return what is wrong with who is connected.

        Parameters
        ----------
        torques : Subscription
            That of the torques.
        inputs : iterable of Subscription
            All of them.
        outputs : iterable of Publisher
            All of them.
        several : str
            What becomes of the torques of several publishers.

        """
        problems = []
        found = self._node.get_publishers_info_by_topic(torques.topic_name)
        if not found:
            problems.append(f'{torques.topic_name}: no publisher')
        if len(found) > 1:
            names = ', '.join(sorted(_full_name(info) for info in found))
            problems.append(f'{torques.topic_name}: {len(found)} publishers: {names}; {several}')
            self._say(PUBLISHERS, problems[-1])
        for reader in inputs:
            speakers = self._node.get_publishers_info_by_topic(reader.topic_name)
            problems += self._unconnected(reader.topic_name, speakers, 'subscriptions')
        for writer in outputs:
            listeners = self._node.get_subscriptions_info_by_topic(writer.topic_name)
            problems += self._unconnected(writer.topic_name, listeners, 'publishers')
        return problems

    def _unconnected(self, topic: str, others: Iterable[TopicEndpointInfo],
                     own: str) -> list[str]:
        # Profiles as DDS has them on both sides: what is left to a default is told apart here.
        endpoints = getattr(self._node, f'get_{own}_info_by_topic')(topic)
        profile = next((info.qos_profile for info in endpoints
                        if _full_name(info) == self._node.get_fully_qualified_name()), None)
        problems = []
        for info in others if profile else ():
            pair = (profile, info.qos_profile) if own == 'publishers' else \
                (info.qos_profile, profile)
            compatible, reason = qos_check_compatible(*pair)
            if compatible == QoSCompatibility.ERROR:
                problems.append(f'{topic}: {_full_name(info)} is not connected: '
                                f'{reason.removeprefix("ERROR: ").rstrip("; ")}')
        if problems:
            self._say(f'{QOS} {topic}', '; '.join(problems))
        return problems

    def publish(self, problems: list[str], waiting: int, epoch: str, stamp: Time) -> None:
        """Publish what was counted; what went wrong in the last second is an error or warning."""
        counts, new = self._counts, self._counts - self._told
        self._told = counts.copy()
        refused = [f'refused: {cause}' for cause in CAUSES if new[cause]]
        warnings = problems + [f'{new[name]} {name}' for name in _TORQUE_WARNINGS if new[name]]
        torques = self._status(
            'torques', bool(refused), bool(warnings), '; '.join(refused + warnings) or 'OK',
            {RECEIVED: counts[RECEIVED], APPLIED: counts[APPLIED],
             **{f'refused: {cause}': counts[cause] for cause in CAUSES}, 'waiting': waiting,
             **{name: counts[name] for name in _OF_TORQUES}})
        errors = [name for name in _ERRORS if new[name]]
        warnings = [name for name in _WARNINGS if new[name]]
        motion = self._status(
            'motion', bool(errors), bool(warnings), '; '.join(errors + warnings) or epoch,
            {name: counts[name] for name in _OF_MOTION})
        array = DiagnosticArray(status=[torques, motion])
        array.header.stamp = stamp
        self._publisher.publish(array)

    def _status(self, part: str, error: bool, warning: bool, message: str,
                values: Mapping[str, int]) -> DiagnosticStatus:
        level = DiagnosticStatus.WARN if warning else DiagnosticStatus.OK
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if error else level,
            name=f'{self._node.get_name()}: {part}', hardware_id=self._node.get_name(),
            message=message,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])

    def _say(self, cause: str, text: str) -> None:
        now, last = time.monotonic(), self._reported.get(cause)
        if last is None or now - last > _REPORT_EVERY_S:
            self._reported[cause] = now
            self._node.get_logger().warning(text)


def _full_name(info: TopicEndpointInfo) -> str:
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'
