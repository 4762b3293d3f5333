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

"""Publish the states and the log of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from copy import copy
import time

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.live.events import UNSENT
from rigid_body_ros.live.inputs import Torque
from rigid_body_ros.live.run import LOG_DEPTH, Snapshot
from rigid_body_ros.mechanics import euler
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.wheels import Wheel
from rigid_body_ros.node.diagnostics import Diagnostics
from rigid_body_ros.node.sources import BODY, COMMANDS, TorqueTopic
from rigid_body_ros.scene import Scene
from sensor_msgs.msg import Imu, JointState

try:
    from rclpy.event_handler import PublisherEventCallbacks
except ModuleNotFoundError:  # Humble
    from rclpy.qos_event import PublisherEventCallbacks

_STATE_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# No log message may be lost, not even if a recorder starts a moment later. The queue is deep
# because an epoch ends with a burst of messages that contain the states of the last `history`
# seconds.
_LOG_QOS = QoSProfile(depth=LOG_DEPTH, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Publishers:
    """
    All the publishers of a node.

    If the middleware fails to publish a message, for example because it has run out of memory,
    `Diagnostics` counts and logs the failure.
    """

    def __init__(self, node: Node, scene: Scene, sources: Iterable[TorqueTopic],
                 diagnostics: Diagnostics) -> None:
        self._node, self._diagnostics = node, diagnostics
        space, body, sequence = scene.space_frame, scene.body_frame, scene.euler_sequence
        self._frames = {'body': body, 'space': space}
        imu, variances = scene.imu, scene.odometry_variances
        #: The publisher of each state topic, and the function that encodes a snapshot for it.
        #: Odometry comes first, because controllers in lockstep are waiting for it.
        self._states: list[tuple[Publisher, Callable[[State, State, Floats], bytes]]] = [
            (self._publisher(Odometry, 'odometry'), lambda state, *_: (
                messages.odometry(state, space, body, *variances))),
            (self._publisher(QuaternionStamped, 'attitude'), lambda state, *_: (
                messages.QUATERNION.encode(state.time_ns, space, state.attitude))),
            (self._publisher(Vector3Stamped, 'euler_angles'), lambda state, *_: (
                messages.VECTOR3.encode(state.time_ns, space,
                                        euler.from_quaternion(state.attitude, sequence)))),
            (self._publisher(Vector3Stamped, 'angular_velocity'), lambda state, *_: (
                messages.VECTOR3.encode(state.time_ns, body, state.angular_velocity))),
            (self._publisher(Imu, 'imu/data'), lambda state, sensed, _: (
                messages.imu(state.time_ns, body, sensed, imu)))]
        if scene.wheels:
            self._states.append((
                self._publisher(Vector3Stamped, 'rotor_momentum'), lambda state, *_: (
                    messages.VECTOR3.encode(state.time_ns, body, state.rotor_momentum))))
        if scene.actuators:
            self._states.append((
                self._publisher(WrenchStamped, 'applied_torque'), lambda state, _, torque: (
                    messages.wrench(state.time_ns, body, torque))))
        if scene.named_wheels:
            self._states.append((self._publisher(JointState, 'wheel_states'),
                                 _wheel_states(scene.named_wheels)))
        if scene.publish_tf:
            self._states.append((self._publisher(_transform_type(), '/tf'), lambda state, *_: (
                messages.transform(state, space, body))))
        #: The publisher of each source's log, by source number.
        self._accepted = {source.number: self._publisher(source.kind, source.log, _LOG_QOS)
                          for source in sources}
        self._kinds = {source.number: source.message for source in sources}
        self._committed = self._publisher(Odometry, '~/committed', _LOG_QOS)

    @property
    def publishers(self) -> list[Publisher]:
        """Return all publishers of states and logs."""
        return [*(publisher for publisher, _ in self._states), *self._accepted.values(),
                self._committed]

    @property
    def subscription_count(self) -> int:
        """Return how many subscriptions are connected to the state topics."""
        return sum(publisher.get_subscription_count() for publisher, _ in self._states)

    def publish(self, snapshot: Snapshot) -> None:
        """Publish a snapshot on each state topic that has a subscription."""
        for publisher, encode in self._states:
            if publisher.get_subscription_count():
                self._send(publisher, encode(*snapshot))

    def begin_log(self, start: State) -> None:
        """Publish the marker of a new epoch, with its start state, to every torque log."""
        for source, publisher in self._accepted.items():
            self._send(publisher, messages.epoch_marker(start, self._kinds[source]))

    def log_torque(self, torque: Torque) -> None:
        """Publish an accepted torque in the log of its source."""
        encode = {BODY: messages.inertia, COMMANDS: self._kinds[torque.source].encode}.get(
            torque.source, messages.wrench)
        self._send(self._accepted[torque.source], encode(
            torque.stamp_ns, self._frames[torque.frame], torque.values))

    def log_state(self, state: State) -> None:
        """Publish a committed state, which no later torque can change, in the log."""
        self._send(self._committed, messages.odometry(
            state, self._frames['space'], self._frames['body']))

    def deliver(self, until: float) -> bool:
        """
        Wait until all subscribers have acknowledged the log.

        `until` is the time on the monotonic clock at which to stop waiting, s. The result is False
        if a subscriber has not acknowledged the log by this time.
        """
        is_delivered = True
        for publisher in (self._committed, *self._accepted.values()):
            remaining = max(0.0, until - time.monotonic())
            with suppress(RuntimeError):  # not every middleware supports acknowledgement
                is_delivered &= publisher.wait_for_all_acked(Duration(seconds=remaining))
        return is_delivered

    def _send(self, publisher: Publisher, data: bytes) -> None:
        try:
            publisher.publish(data)
        except RuntimeError as error:
            self._diagnostics.event(UNSENT, f'{publisher.topic_name}: publishing failed: '
                                    f'{" ".join(str(error).split())}')

    def _publisher(self, kind: type, topic: str, qos: QoSProfile = _STATE_QOS) -> Publisher:
        # Pass a copy, because rclpy writes the overrides for a topic into the profile. Disable the
        # event handlers, because rclpy would check each of them in every cycle, and `Diagnostics`
        # reports the same problems anyway.
        return self._node.create_publisher(
            kind, topic, copy(qos),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())


def _wheel_states(wheels: Sequence[Wheel]) -> Callable[[State, State, Floats], bytes]:
    """Return a function that encodes the speeds and efforts of named wheels."""
    kind = messages.joint_states([wheel.name for wheel in wheels])
    speeds = np.array([wheel.initial_speed for wheel in wheels])

    def encode(state: State, *_: object) -> bytes:
        # A start state that was given, not computed, contains no wheel efforts. The start state of
        # the scene contains no wheel speeds either.
        values = (found if found.size else default for found, default in (
            (state.wheel_speeds, speeds), (state.wheel_efforts, np.zeros(len(wheels)))))
        return kind.encode(state.time_ns, '', messages.joint_values(*(
            each[None] for each in values))[0])
    return encode


def _transform_type() -> type:
    try:
        from tf2_msgs.msg import TFMessage
    except ModuleNotFoundError as error:
        raise InputError('publish_tf: needs the package tf2_msgs, which is not installed') \
            from error
    return TFMessage
