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

from collections import deque
from collections.abc import Callable, Container, Sequence
from contextlib import suppress
from copy import copy
from functools import partial
import time
from typing import Any

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
from rigid_body_ros.node.sources import BODY, class_of, COMMANDS, TorqueTopic
from rigid_body_ros.scene import Scene

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


_Encode = Callable[[State, State, Floats], bytes]
OnLog = Callable[[str, bytes], None]
#: The log of the committed states.
COMMITTED = '~/committed'
#: The topics that need more than the state of the body.
IMU, APPLIED_TORQUE = 'imu/data', 'applied_torque'


class Publishers:
    """
    All the publishers of a node.

    If the middleware fails to publish a message, for example because it has run out of memory,
    `Diagnostics` counts and logs the failure. If `on_log` is given, it is called with the name of
    the log and each message of it, and nobody else gets the log.
    """

    def __init__(self, node: Node, scene: Scene, sources: Sequence[TorqueTopic],
                 diagnostics: Diagnostics, on_log: OnLog | None = None) -> None:
        self._node, self._diagnostics = node, diagnostics
        space, body, sequence = scene.space_frame, scene.body_frame, scene.euler_sequence
        self._frames = {'body': body, 'space': space}
        imu, variances = scene.imu, scene.odometry_variances
        #: The publisher of each state topic, and the function that encodes a snapshot for it.
        #: Odometry comes first, because controllers in lockstep are waiting for it.
        self._states: dict[str, tuple[Publisher[Any], _Encode]] = {}

        def add(kind: messages.MessageType, topic: str, encode: _Encode) -> None:
            self._states[topic] = self._publisher(kind, topic), encode
        add(messages.ODOMETRY, 'odometry', lambda state, *_: (
            messages.odometry(state, space, body, *variances)))
        add(messages.QUATERNION, 'attitude', lambda state, *_: (
            messages.QUATERNION.encode(state.time_ns, space, state.attitude)))
        add(messages.VECTOR3, 'euler_angles', lambda state, *_: (
            messages.VECTOR3.encode(state.time_ns, space,
                                    euler.from_quaternion(state.attitude, sequence))))
        add(messages.VECTOR3, 'angular_velocity', lambda state, *_: (
            messages.VECTOR3.encode(state.time_ns, body, state.angular_velocity)))
        add(messages.IMU, IMU, lambda state, sensed, _: (
            messages.imu(state.time_ns, body, sensed, imu)))
        if scene.wheels:
            add(messages.VECTOR3, 'rotor_momentum', lambda state, *_: (
                messages.VECTOR3.encode(state.time_ns, body, state.rotor_momentum)))
        if scene.actuators:
            add(messages.WRENCH, APPLIED_TORQUE, lambda state, _, torque: (
                messages.wrench(state.time_ns, body, torque)))
        if scene.named_wheels:
            kind = messages.joint_states([wheel.name for wheel in scene.named_wheels])
            add(kind, 'wheel_states', _wheel_states(scene.named_wheels, kind))
        if scene.publish_tf:
            try:
                add(messages.TRANSFORM, '/tf', lambda state, *_: (
                    messages.transform(state, space, body)))
            except ModuleNotFoundError as error:
                raise InputError('publish_tf: needs the package tf2_msgs, which is not '
                                 'installed') from error
        self._sources, self._on_log = {source.number: source for source in sources}, on_log
        #: The publisher of each log, and what it has not sent yet, because nobody listens. A
        #: listener that comes later gets it.
        self._logs: dict[str, tuple[Publisher[Any], deque[Callable[[], bytes]]]] = {
            log: (self._publisher(kind, log, _LOG_QOS), deque(maxlen=LOG_DEPTH))
            for log, kind in (*((source.log, source.logged) for source in sources),
                              (COMMITTED, messages.ODOMETRY))}

    @property
    def publishers(self) -> list[Publisher[Any]]:
        """Return all publishers of states and logs."""
        return [publisher for publisher, _ in (*self._states.values(), *self._logs.values())]

    @property
    def subscription_count(self) -> int:
        """Return how many subscriptions are connected to the state topics."""
        return sum(publisher.get_subscription_count() for publisher, _ in self._states.values())

    @property
    def listened(self) -> set[str]:
        """Return the state topics that have a subscription."""
        return {topic for topic, (publisher, _) in self._states.items()
                if publisher.handle.get_subscription_count()}

    def publish(self, snapshot: Snapshot, listened: Container[str] | None = None) -> None:
        """Publish a snapshot on the given state topics, by default on all that `listened` has."""
        listened = self.listened if listened is None else listened
        for topic, (publisher, encode) in self._states.items():
            if topic in listened:
                self._send(publisher, encode(*snapshot))

    def begin_log(self, start: State) -> None:
        """Publish the marker of a new epoch, with its start state, to every torque log."""
        for source in self._sources.values():
            self._log(source.log, messages.epoch_marker, start, source.logged)

    def log_torque(self, torque: Torque) -> None:
        """Publish an accepted torque in the log of its source."""
        source = self._sources[torque.source]
        encoders: dict[int, Callable[..., bytes]] = {
            BODY: messages.inertia, COMMANDS: source.logged.encode}
        self._log(source.log, encoders.get(source.number, messages.wrench), torque.stamp_ns,
                  self._frames[torque.frame], torque.values)

    def log_state(self, state: State) -> None:
        """Publish a committed state, which no later torque can change, in the log."""
        self._log(COMMITTED, messages.odometry, state, self._frames['space'],
                  self._frames['body'])

    def _log(self, log: str, encode: Callable[..., bytes], *arguments: Any) -> None:
        if self._on_log:
            self._on_log(log, encode(*arguments))
        else:
            self._logs[log][1].append(partial(encode, *arguments))

    def flush(self) -> None:
        """Publish what the log contains and has not been sent yet, if somebody listens."""
        for publisher, unsent in self._logs.values():
            if unsent and publisher.handle.get_subscription_count():
                while unsent:
                    self._send(publisher, unsent.popleft()())

    def deliver(self, until: float) -> bool:
        """
        Wait until all subscribers have acknowledged the log.

        `until` is the time on the monotonic clock at which to stop waiting, s. The result is False
        if a subscriber has not acknowledged the log by this time.
        """
        self.flush()
        is_delivered = True
        for publisher, _ in self._logs.values():
            remaining = max(0.0, until - time.monotonic())
            with suppress(RuntimeError):  # not every middleware supports acknowledgement
                is_delivered &= publisher.wait_for_all_acked(Duration(seconds=remaining))
        return is_delivered

    def _send(self, publisher: Publisher[Any], data: bytes) -> None:
        try:
            publisher.publish(data)
        except RuntimeError as error:
            self._diagnostics.event(UNSENT, f'{publisher.topic_name}: publishing failed: '
                                    f'{" ".join(str(error).split())}')

    def _publisher(self, kind: messages.MessageType, topic: str,
                   qos: QoSProfile = _STATE_QOS) -> Publisher[Any]:
        # Pass a copy, because rclpy writes the overrides for a topic into the profile. Disable the
        # event handlers, because rclpy would check each of them in every cycle, and `Diagnostics`
        # reports the same problems anyway.
        return self._node.create_publisher(
            class_of(kind), topic, copy(qos),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())


def _wheel_states(wheels: Sequence[Wheel], kind: messages.MessageType) -> _Encode:
    """Return a function that encodes the speeds and efforts of named wheels."""
    speeds = np.array([wheel.initial_speed for wheel in wheels])

    def encode(state: State, *_: object) -> bytes:
        # A start state that was given, not computed, contains no wheel efforts. The start state of
        # the scene contains no wheel speeds either.
        velocities = state.wheel_speeds if state.wheel_speeds.size else speeds
        efforts = state.wheel_efforts if state.wheel_efforts.size else np.zeros(len(wheels))
        return kind.encode(state.time_ns, '', messages.joint_values(
            velocities[None], efforts[None])[0])
    return encode
