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
The errors of an IMU, as functions of a seed and a stamp.

The IMU takes 1000 samples per second of its stamps, and their noise is a function of their number.
A stamp has the noise of the last sample at or before it, whatever the rate and the earlier
requests.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.mechanics import draws, so3

#: Time between samples, ns.
_SAMPLE_NS = 10 ** 6
_SAMPLES_PER_SECOND = 1e9 / _SAMPLE_NS
#: Number of samples of the gyro whose mean is an output: the noise is white up to 100 Hz.
_AVERAGED = 10
#: By this a normal number becomes its part of that mean, for a density of 1.
_WHITE = _SAMPLES_PER_SECOND ** 0.5 / _AVERAGED
#: The random walk returns to zero every 2 ** _LEVELS samples, 9.3 hours.
_LEVELS = 25
#: Random numbers have a level and, below these bits, a number of a sample or an interval: 0 is the
#: white noise, then the levels of the walk, then the attitude.
_SHIFT, _TURN = 48, _LEVELS + 1
#: Number of stamps computed at once: their random numbers fit in a cache.
_BLOCK = 4096


@dataclass(frozen=True)
class ImuErrors:
    """
    The errors of an IMU.

    Attributes
    ----------
    gyro_noise_density : float, rad/s/sqrt(Hz)
        Of white noise, as in data sheets. The output is the mean of 10 ms, so at 100 Hz the noise
        of each output is independent, at higher rates neighbours share a part of it, and at lower
        rates it is that of a sensor of which only some outputs are used.
    gyro_random_walk : float, rad/s^2/sqrt(Hz)
        Of the bias, which is zero at the stamp 0 and every 2**25 ms (9.3 hours) after it, and a
        Wiener process in between, conditional on that.
    gyro_bias : tuple of 3 floats, rad/s, body axes
    attitude_noise : float, rad
        Standard deviation of each component of a rotation vector in body axes.
    delay : float, s
        A message has the state from this long before its stamp.
    seed : int
        From 0 to 2**63 - 1.

    """

    gyro_noise_density: float = 0.0
    gyro_random_walk: float = 0.0
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    attitude_noise: float = 0.0
    delay: float = 0.0
    seed: int = 0

    @property
    def delay_ns(self) -> int:
        """Return the delay, ns."""
        return duration_ns(self.delay, 'imu.delay')

    @property
    def attitude_variance(self) -> float:
        """Return the variance of the attitude about each axis, rad^2."""
        return self.attitude_noise ** 2

    @property
    def rate_variance(self) -> float:
        """Return the variance of the white noise on each axis, rad^2/s^2; the bias is no noise."""
        return self.gyro_noise_density ** 2 * _SAMPLES_PER_SECOND / _AVERAGED

    def measured(self, stamps_ns: NDArray[np.int64], attitude: Floats,
                 angular_velocity: Floats) -> tuple[Floats, Floats]:
        """
        Return what the IMU measures of a motion.

        Parameters
        ----------
        stamps_ns : array of int, shape (n,), ns
            Of the messages, from 0 on, in any order.
        attitude, angular_velocity : array, shape (n, 4) and (n, 3), rad/s, body axes
            Of the motion, `delay` before the stamps.

        Returns
        -------
        attitude, angular_velocity : array, shape (n, 4) and (n, 3)
            Without errors the same objects.

        """
        if any(self.gyro_bias):
            angular_velocity = angular_velocity + np.array(self.gyro_bias)
        if not (self.gyro_noise_density or self.gyro_random_walk or self.attitude_noise):
            return attitude, angular_velocity
        samples = stamps_ns // _SAMPLE_NS
        vectors, rates = np.concatenate([
            self._noise(samples[first:first + _BLOCK])
            for first in range(0, max(len(samples), 1), _BLOCK)], axis=1)
        if self.attitude_noise:
            attitude = so3.multiply(attitude, so3.exp(vectors))
        return attitude, angular_velocity + rates

    def _noise(self, samples: NDArray[np.int64]) -> Floats:
        """Return noise of attitude and angular velocity, shape (2, n, 3), of samples, (n,)."""
        # Rows of one array, because a single stamp takes as long as the number of calls.
        ago = np.arange(_AVERAGED * bool(self.gyro_noise_density))[:, None]
        levels = np.arange(1, 1 + _LEVELS * bool(self.gyro_random_walk))[:, None]
        turns = np.full((int(bool(self.attitude_noise)), 1), _TURN)
        numbers = _normals(self.seed, np.concatenate([
            samples - ago, levels << _SHIFT | samples >> levels, turns << _SHIFT | samples]))
        white, walk, turn = np.split(numbers, [len(ago), len(ago) + len(levels)])
        # One after the other: NumPy's sum has another order for other shapes.
        zero = np.zeros((len(samples), 3))
        return np.array([
            self.attitude_noise * sum(turn, zero),
            self.gyro_noise_density * _WHITE * sum(white, zero)
            + self.gyro_random_walk * sum(_hats(levels, samples)[..., None] * walk, zero)])


def _hats(levels: NDArray[np.int64], samples: NDArray[np.int64]) -> Floats:
    """
    Return functions, sqrt(s); a Wiener process is their sum, each times a normal number.

    On each level, intervals of 2, 4, 8 ... samples have hats, which are zero at both ends (Lévy
    1948; Karatzas, Shreve 1991, "Brownian motion and stochastic calculus", section 2.3).
    """
    length = 1 << levels
    inside = samples & (length - 1)
    return np.minimum(inside, length - inside) * (length * _SAMPLES_PER_SECOND) ** -0.5


def _normals(seed: int, counters: NDArray[np.int64]) -> Floats:
    """Return standard normal numbers, shape (..., 3), of counters, shape (...)."""
    flat = counters.ravel()
    # Long intervals have many samples: draw each number once.
    is_new = np.empty(flat.shape, bool)
    is_new[:1], is_new[1:] = True, flat[1:] != flat[:-1]
    bits = draws.hashed(_keys(seed), flat[is_new, None].astype(np.uint64))
    numbers = draws.normals(bits)[:, :3]
    return numbers[np.cumsum(is_new) - 1].reshape(*counters.shape, 3)


@lru_cache
def _keys(seed: int) -> NDArray[np.uint64]:
    """Return the keys of the three axes, and one more, because normal numbers come in pairs."""
    return draws.hashed(draws.hashed(np.array([seed], np.uint64), np.zeros(1, np.uint64)),
                        np.arange(4, dtype=np.uint64))
