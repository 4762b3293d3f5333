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

"""
What sensors measure of a motion.

A sensor has a clock and axes of its own, and a gyro also a bias and a scale. A channel is one
quantity that a sensor measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.parameters import SPACE, split_topic
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.recording.measured import Measured

#: Parameters of clocks.
CLOCKS = 'clock_offset', 'clock_drift'


class MotionSlopes(NamedTuple):
    """
    How a motion changes with p numbers, in body axes.

    The attitude changes by rotation vectors, shape (n, 3, p), as does the angular velocity.
    """

    attitude: Floats
    angular_velocity: Floats

    def rows(self, chosen: NDArray[np.intp]) -> MotionSlopes:
        """Return the changes at the chosen times."""
        return MotionSlopes(self.attitude[chosen], self.angular_velocity[chosen])


@dataclass(frozen=True, eq=False)
class Sensor:
    """
    A sensor with given parameters.

    Attributes
    ----------
    channel : Measured
        The samples of the sensor.
    physics : Physics
        The parameters.
    mount : array, shape (3,), rad
        The rotation vector from body axes to the axes of the sensor.
    origin_ns : int
        The time at which the drift of the clock is zero.

    """

    channel: Measured
    physics: Physics
    mount: Floats
    origin_ns: int

    @cached_property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Return the stamps, ns, corrected for clock offset and clock drift."""
        return clocked(self.channel, self.physics, self.origin_ns)

    def measured(self, poses: Poses) -> Floats:
        """Return what the sensor would measure without noise, shape (n, 4) or (n, 3)."""
        if self.channel.is_attitude:
            attitude, space = poses.attitude, self.physics.value(SPACE)
            attitude = so3.multiply(so3.exp(space), attitude) if space.any() else attitude
            return so3.multiply(attitude, self._axes) if self.mount.any() else attitude
        return self._value('gyro_scale') * self._rates(poses) + self._value('gyro_bias')

    def by_motion(self, motion: MotionSlopes) -> Floats:
        """Return how a measurement changes with the motion, shape (p, n, 3)."""
        change = np.moveaxis(motion[0 if self.channel.is_attitude else 1], 2, 0)
        if self.mount.any():
            change = change @ so3.matrix(self._axes)
        return change if self.channel.is_attitude else self._value('gyro_scale') * change

    def slopes(self, kind: str, poses: Poses, flow: MotionSlopes | None) -> Floats:
        """
        Return how a measurement changes with a parameter of the sensor.

        Parameters
        ----------
        kind : str
            The name of the parameter, without a topic.
        poses : Poses
            The n states at the stamps.
        flow : MotionSlopes, optional
            How the motion changes with time, for a clock.

        Returns
        -------
        array, shape (k, n, 3)
            One block for each component of the parameter.

        """
        if kind in CLOCKS:
            assert flow is not None
            found = self.by_motion(flow)
            since = 1e-9 * (self.channel.stamps_ns - self.origin_ns)
            return found * since[:, None] if kind == 'clock_drift' else found
        count, turn = len(self.channel), so3.right_jacobian(self.mount).T
        if self.channel.is_attitude:
            if kind == SPACE:
                turn = so3.right_jacobian(self.physics.value(SPACE)).T
                back = so3.conjugate(so3.multiply(poses.attitude, self._axes))
                return so3.rotate(back, turn[:, None])
            return np.repeat(turn[:, None] * (kind == 'mount'), count, axis=1)
        if kind == 'mount':
            return self._value('gyro_scale') * np.cross(self._rates(poses), turn[:, None])
        if kind == 'gyro_scale':
            return self._rates(poses) * np.eye(3)[:, None]
        return np.repeat(np.eye(3)[:, None] * (kind == 'gyro_bias'), count, axis=1)

    @cached_property
    def _axes(self) -> Floats:
        return so3.exp(self.mount)

    def _rates(self, poses: Poses) -> Floats:
        if not self.mount.any():
            return poses.angular_velocity
        return so3.rotate(so3.conjugate(self._axes), poses.angular_velocity)

    def _value(self, kind: str) -> Floats:
        return self.physics.value(kind, self.channel.topic)


def sensors_of(channels: Sequence[Measured], physics: Physics, origin_ns: int) -> list[Sensor]:
    """
    Return the sensors of channels.

    If any topic contains attitudes, the parameter `mount` applies only to topics with attitudes.
    The angular velocities on all other topics are then assumed to be in body axes, unless
    `mount@TOPIC` is fitted.
    """
    return [Sensor(channel, physics, mount_of(f'mount@{channel.topic}', physics, channels),
                   origin_ns) for channel in channels]


def applies(name: str, channel: Measured, physics: Physics, channels: Sequence[Measured]) -> bool:
    """Return whether a parameter of sensors changes what a channel measures."""
    kind, topic = split_topic(name)
    if topic:
        return topic == channel.topic
    is_own = f'{kind}@{channel.topic}' in physics.values
    return not is_own and (kind != 'mount' or channel.topic in _mounted(channels))


def _mounted(channels: Sequence[Measured]) -> set[str]:
    """Return the topics to which the parameter `mount` applies."""
    return {channel.topic for channel in channels if channel.is_attitude} or {
        channel.topic for channel in channels}


def topics_of(kind: str, channels: Sequence[Measured]) -> list[str]:
    """
    Return the topics to which a sensor parameter applies.

    Gyro parameters apply only to topics with angular velocities.
    """
    return [*{channel.topic: None for channel in channels
              if not (kind.startswith('gyro') and channel.is_attitude)}]


def clocked(channel: Measured, physics: Physics, origin_ns: int) -> NDArray[np.int64]:
    """
    Return the stamps of a channel, ns, corrected for clock offset and clock drift.

    The drift is zero at `origin_ns`.
    """
    offset_ns = round(1e9 * physics.number('clock_offset', channel.topic))
    drift = physics.number('clock_drift', channel.topic)
    stamps_ns = channel.stamps_ns + offset_ns if offset_ns else channel.stamps_ns
    if not drift:
        return stamps_ns
    return stamps_ns + np.round(drift * (channel.stamps_ns - origin_ns)).astype(np.int64)


def mount_of(name: str, physics: Physics, channels: Sequence[Measured]) -> Floats:
    """
    Return the rotation vector from body axes to the axes of a sensor.

    The vector is the parameter `mount@TOPIC` or, if this parameter is not fitted, `mount`. The
    vector is zero if neither parameter applies to the sensor.
    """
    topic = split_topic(name)[1]
    if topic and topic not in _mounted(channels) and name not in physics.values:
        return np.zeros(3)
    return physics.value('mount', topic)


def corrected(channels: Sequence[Measured], physics: Physics, origin_ns: int) -> list[Measured]:
    """
    Return the channels with all fitted sensor errors removed.

    The stamps are converted to the torque clock and the values to body axes, and the bias and
    scale of each gyro are removed.
    """
    result, space = [], so3.exp(-physics.value(SPACE))
    for sensor in sensors_of(channels, physics, origin_ns):
        channel, axes = sensor.channel, so3.exp(sensor.mount)
        moved = replace(channel, stamps_ns=sensor.stamps_ns)
        if channel.angular_velocity is not None:
            rates = (channel.angular_velocity - physics.value('gyro_bias', channel.topic)) \
                / physics.value('gyro_scale', channel.topic)
            moved = replace(moved, angular_velocity=so3.rotate(axes, rates))
        elif channel.attitude is not None:
            moved = replace(moved, attitude=so3.multiply(
                so3.multiply(space, channel.attitude), so3.conjugate(axes)))
        result.append(moved)
    return result
