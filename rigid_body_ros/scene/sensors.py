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

"""The parameters for IMU errors, and for the covariances in odometry messages."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from rigid_body_ros.mechanics.imu import ImuErrors
from rigid_body_ros.runtime.parameters import Parameter

_FAST = 1e9
_GYRO_BIAS = 'imu.gyro_bias'
_ATTITUDE, _RATE = 'odometry.attitude_variance', 'odometry.rate_variance'
PARAMETERS = (
    Parameter('imu.gyro_noise_density', 0.0, 'rad/s/sqrt(Hz)', 'density of the white noise in the '
              'angular velocity of imu/data', (0.0, _FAST)),
    Parameter('imu.gyro_random_walk', 0.0, 'rad/s^2/sqrt(Hz)', 'density of the random walk of the '
              'gyro bias in imu/data', (0.0, _FAST)),
    *(Parameter(f'{_GYRO_BIAS}.{axis}', 0.0, 'rad/s', 'constant bias of the angular velocity in '
                'imu/data, body axes', (-_FAST, _FAST)) for axis in 'xyz'),
    Parameter('imu.attitude_noise', 0.0, 'rad', 'standard deviation of the attitude error in '
              'imu/data, about each body axis', (0.0, math.pi)),
    Parameter('imu.delay', 0.0, 's', 'delay of imu/data: each message contains the state from '
              'this long before its stamp, or the start state if that is before the start',
              (0.0, 3600.0)),
    Parameter('imu.seed', 0, '', 'seed of the noise in imu/data; the noise depends only on the '
              'seed and the stamp', (0, 2 ** 63 - 1)),
    Parameter(_ATTITUDE, 0.0, 'rad^2', 'attitude variance about each axis, for the covariance in '
              'odometry; 0 means unknown', (0.0, _FAST)),
    Parameter(_RATE, 0.0, 'rad^2/s^2', 'variance of each component of the angular velocity, for '
              'the covariance in odometry; 0 means unknown', (0.0, _FAST)),
)


def imu_of(values: Mapping[str, Any]) -> ImuErrors:
    """Create the IMU errors from the parameters of a scene."""
    x, y, z = (values[f'{_GYRO_BIAS}.{axis}'] for axis in 'xyz')
    names = 'gyro_noise_density', 'gyro_random_walk', 'attitude_noise', 'delay', 'seed'
    return ImuErrors(gyro_bias=(x, y, z), **{name: values[f'imu.{name}'] for name in names})


def odometry_variances(values: Mapping[str, Any]) -> tuple[float, float]:
    """Return the odometry variances of attitude, rad^2, and angular velocity, rad^2/s^2."""
    return values[_ATTITUDE], values[_RATE]
