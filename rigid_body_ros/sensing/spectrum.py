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

"""The spectrum of a residual torque."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.sensing.residual_torque import ResidualTorque

#: s; a residual torque that lasts longer is divided into segments of this length. Adjacent
#: segments overlap by half their length.
SEGMENT = 60.0
#: Probability that white noise exceeds the limit of a spectrum at one frequency.
_EXCEEDS = 0.01
#: Value of pi f T, rad, at which a window of length T halves the amplitude at the frequency f.
_FLATTENED = 2.5
#: The spectrum contains this many times more frequencies than a segment has cycles, so that the
#: frequency of any sine is close to one of these frequencies.
_FINER = 4
#: Minimum number of samples from which a spectrum is computed.
_FEWEST = 16


class Spectrum(NamedTuple):
    """
    Amplitudes of the residual torque by frequency.

    Attributes
    ----------
    hertz : array, shape (m,)
    amplitudes, limits : array, shape (m, 3), N m, body axes
        The amplitude of a sine at each frequency, and a limit for this amplitude. White noise of
        the angular velocity exceeds the limit at one frequency in a hundred.

    """

    hertz: Floats
    amplitudes: Floats
    limits: Floats


def spectrum(torque: ResidualTorque) -> Spectrum | None:
    """
    Return the spectrum of a residual torque; None if the residual torque is too short.

    The residual torque is the slope of an angular momentum over a window of T seconds. With dense
    samples, taking the slope multiplies amplitudes at the frequency f by the factor
    3 (sin x - x cos x) / x^3 with x = pi f T. The spectrum is divided by this factor, and ends at
    the frequency at which the factor is one half.
    """
    seconds = 1e-9 * (torque.times_ns - torque.times_ns[0])
    if len(seconds) < _FEWEST:
        return None
    spacing = float(np.median(np.diff(seconds)))
    grid = np.arange(0.0, seconds[-1], spacing)
    values = np.stack([np.interp(grid, seconds, column) for column in torque.torques.T], axis=1)
    size = min(len(grid), round(SEGMENT / spacing))
    segments = np.stack([values[first:first + size]
                         for first in range(0, len(grid) - size + 1, max(size // 2, 1))])
    window = np.hanning(size)
    means = segments.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft((segments - means) * window[:, None], _FINER * size, axis=1)) ** 2
    hertz = np.fft.rfftfreq(_FINER * size, spacing)
    kept = (np.pi * hertz * torque.window_s <= _FLATTENED) & (hertz > 1.5 / (size * spacing))
    shown = np.asarray(hertz[kept], np.float64)
    half = round(0.5 * torque.window_s / spacing)
    times, turn = spacing * np.arange(-half, half + 1), 2.0 * np.pi * shown
    smoothed = np.sin(np.outer(turn, times)) @ times / turn / np.sum(times ** 2)
    amplitudes = 2.0 / window.sum() * np.sqrt(power.mean(axis=0)[kept]) / smoothed[:, None]
    # The limit applies to the slope of a line that is fitted to a momentum with white noise.
    noise = torque.noise * np.sqrt(np.sum(times ** 2) * np.sum(window ** 2)) / window.sum()
    return Spectrum(shown, amplitudes, np.outer(turn, 2.0 * _exceeded(len(segments)) * noise))


def _exceeded(count: int) -> float:
    """Return the limit of the noise, divided by its rms, for an average of `count` segments."""
    from scipy.special import chdtri
    return float(np.sqrt(chdtri(2 * count, _EXCEEDS) / (2 * count)))
