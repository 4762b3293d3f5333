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
IMU errors that depend only on a seed and a stamp.

The IMU takes 1000 samples per second, numbered from stamp 0, and the noise of each sample is a
function of its number. The noise at a stamp is the noise of the last sample at or before that
stamp, so it depends neither on the message rate nor on earlier requests.
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
#: Number of gyro samples that are averaged for one output. The noise is white up to 100 Hz.
_AVERAGED = 10
#: Factor by which each standard normal number is multiplied in an output if the noise density is
#: 1.
_WHITE = _SAMPLES_PER_SECOND ** 0.5 / _AVERAGED
#: The random walk returns to zero every 2 ** _LEVELS samples (9.3 hours).
_LEVELS = 25
#: To get the counter of a random number, shift its level left by `_SHIFT` bits, and add the number
#: of a sample or an interval. Level 0 is for the white noise, levels 1 to `_LEVELS` are for the
#: random walk, and level `_TURN` is for the attitude noise.
_SHIFT, _TURN = 48, _LEVELS + 1
#: Number of samples whose noise is computed at once. The random numbers for this many samples fit
#: in the processor's cache.
_BLOCK = 4096


@dataclass(frozen=True)
class ImuErrors:
    """
    The errors of an IMU.

    Attributes
    ----------
    gyro_noise_density : float, rad/s/sqrt(Hz)
        Density of the white noise, as given in data sheets. Each output is the mean over 10 ms, so
        at an output rate of 100 Hz, the noise of each output is independent of the noise of all
        other outputs. At higher rates, neighbouring outputs share part of their noise. At lower
        rates, the noise is that of a 100 Hz sensor that drops some of its outputs.
    gyro_random_walk : float, rad/s^2/sqrt(Hz)
        Density of the bias random walk. The walk is zero at stamp 0, and returns to zero every
        2**25 ms (9.3 hours). In between, it is a Brownian bridge: a Wiener process that is zero at
        both ends.
    gyro_bias : tuple of 3 floats, rad/s, body axes
    attitude_noise : float, rad
        Standard deviation of each component of the attitude error, which is a rotation vector in
        body axes.
    delay : float, s
        Delay of the sensor. A message with stamp t reports the state at t - `delay`.
    seed : int
        The seed, from 0 to 2**63 - 1.

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
        """Return the variance of the white gyro noise per axis, rad^2/s^2, without the bias."""
        return self.gyro_noise_density ** 2 * _SAMPLES_PER_SECOND / _AVERAGED

    def measured(self, stamps_ns: NDArray[np.int64], attitude: Floats,
                 angular_velocity: Floats) -> tuple[Floats, Floats]:
        """
        Return a motion as the IMU measures it.

        Parameters
        ----------
        stamps_ns : array of int, shape (n,), ns
            The message stamps, in any order. They must not be negative.
        attitude, angular_velocity : array, shape (n, 4) and (n, 3), rad/s, body axes
            The motion at the times `stamps_ns` minus `delay`.

        Returns
        -------
        attitude, angular_velocity : array, shape (n, 4) and (n, 3)
            The measured motion. If all errors are zero, the function returns its arguments.

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
        """Return the noise of n samples, shape (2, n, 3): attitude noise, then gyro noise."""
        # Draw all random numbers in one call, because for a single stamp, the computing time is
        # proportional to the number of NumPy calls.
        ago = np.arange(_AVERAGED * bool(self.gyro_noise_density))[:, None]
        levels = np.arange(1, 1 + _LEVELS * bool(self.gyro_random_walk))[:, None]
        turns = np.full((int(bool(self.attitude_noise)), 1), _TURN)
        numbers = _normals(self.seed, np.concatenate([
            samples - ago, levels << _SHIFT | samples >> levels, turns << _SHIFT | samples]))
        white, walk, turn = np.split(numbers, [len(ago), len(ago) + len(levels)])
        # Add row by row, because the order in which NumPy sums depends on the shape.
        zero = np.zeros((len(samples), 3))
        return np.array([
            self.attitude_noise * sum(turn, zero),
            self.gyro_noise_density * _WHITE * sum(white, zero)
            + self.gyro_random_walk * sum(_hats(levels, samples)[..., None] * walk, zero)])


def _hats(levels: NDArray[np.int64], samples: NDArray[np.int64]) -> Floats:
    """
    Return the values of the hat functions from which a Wiener process is composed.

    The Wiener process is the sum of the hat functions, each multiplied by a normal number.

    The values are in sqrt(s). Each interval of level k is 2^k samples long and has one hat
    function, which is zero at both ends of the interval (Lévy 1948; Karatzas, Shreve 1991,
    "Brownian motion and stochastic calculus", section 2.3).
    """
    length = 1 << levels
    inside = samples & (length - 1)
    return np.minimum(inside, length - inside) * (length * _SAMPLES_PER_SECOND) ** -0.5


def _normals(seed: int, counters: NDArray[np.int64]) -> Floats:
    """Return three standard normal numbers, shape (..., 3), for each counter, shape (...)."""
    flat = counters.ravel()
    # Neighbouring samples in one interval share their random numbers, so draw the shared numbers
    # only once.
    is_new = np.empty(flat.shape, bool)
    is_new[:1], is_new[1:] = True, flat[1:] != flat[:-1]
    bits = draws.hashed(_keys(seed), flat[is_new, None].astype(np.uint64))
    numbers = draws.normals(bits)[:, :3]
    return numbers[np.cumsum(is_new) - 1].reshape(*counters.shape, 3)


@lru_cache
def _keys(seed: int) -> NDArray[np.uint64]:
    """Return four keys: one for each axis, and one more because normal numbers come in pairs."""
    return draws.hashed(draws.hashed(np.array([seed], np.uint64), np.zeros(1, np.uint64)),
                        np.arange(4, dtype=np.uint64))
