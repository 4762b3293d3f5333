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

"""Sensor model: the clock, axes, bias and scale of each sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.parameters import SPACE, split_topic
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.measured import Measured


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


def mounts(physics: Sequence[Physics], channels: Sequence[Measured]) -> list[Floats | None]:
    """
    Return the rotation from sensor axes to body axes for each channel.

    If any topic contains attitudes, the parameter `mount` applies only to topics with attitudes.
    The angular velocities on all other topics are then assumed to be in body axes, unless
    `mount@TOPIC` is fitted.

    Returns
    -------
    list of array, shape (c, 1, 4), or None
        One entry for each channel. The entry contains a quaternion for each of the c elements of
        `physics`, or is None if there is no rotation.

    """
    result: list[Floats | None] = []
    for channel in channels:
        vectors = np.array([mount_of(f'mount@{channel.topic}', one, channels) for one in physics])
        result.append(so3.exp(vectors)[:, None] if vectors.any() else None)
    return result


def space_axes(physics: Sequence[Physics]) -> Floats | None:
    """
    Return the rotation from the space axes of the motion to those of the measurements.

    The result has shape (c, 1, 4), or is None if there is no rotation.
    """
    vectors = np.array([one.value(SPACE) for one in physics])
    return so3.exp(vectors)[:, None] if vectors.any() else None


def mount_of(name: str, physics: Physics, channels: Sequence[Measured]) -> Floats:
    """
    Return the rotation vector from body axes to the axes of a sensor.

    The vector is the parameter `mount@TOPIC` or, if this parameter is not fitted, `mount`. The
    vector is zero if neither parameter applies to the sensor.
    """
    topic = split_topic(name)[1]
    attitudes = {channel.topic for channel in channels if channel.is_attitude}
    if topic and attitudes and topic not in attitudes and name not in physics.values:
        return np.zeros(3)
    return physics.value('mount', topic)


def corrected(channels: Sequence[Measured], physics: Physics, origin_ns: int) -> list[Measured]:
    """
    Return the channels with all fitted sensor errors removed.

    The stamps are converted to the torque clock and the values to body axes, and the bias and
    scale of each gyro are removed.
    """
    result, space = [], space_axes([physics])
    for channel, mount in zip(channels, mounts([physics], channels)):
        moved = replace(channel, stamps_ns=clocked(channel, physics, origin_ns))
        if channel.angular_velocity is not None:
            rates = (channel.angular_velocity - physics.value('gyro_bias', channel.topic)) \
                / physics.value('gyro_scale', channel.topic)
            moved = replace(moved, angular_velocity=rates if mount is None
                            else so3.rotate(mount[0], rates))
        elif channel.attitude is not None:
            attitude = channel.attitude
            if space is not None:
                attitude = so3.multiply(so3.conjugate(space[0]), attitude)
            moved = replace(moved, attitude=attitude if mount is None
                            else so3.multiply(attitude, so3.conjugate(mount[0])))
        result.append(moved)
    return result
