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

"""The spectrum of a residual torque, and panels that plot the torque and its spectrum."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.noise import FEWEST
from rigid_body_ros.inference.residual_torque import ResidualTorque
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report import style
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.panels import limits, SINCE_FIRST

#: A residual torque that lasts longer than this, in seconds, is divided into segments of this
#: length. Adjacent segments overlap by half their length.
SEGMENT = 60.0
#: Probability that white noise exceeds the limit of the spectrum at any one frequency.
_EXCEEDS = 0.01
#: Value of pi f T, rad, at which a window of length T halves the amplitude at frequency f.
_FLATTENED = 2.5
#: The spacing of the frequencies is one cycle per segment, divided by this number. With this
#: spacing, the spectrum has a frequency close to that of any sine.
_FINER = 4


def residual_panels(torque: ResidualTorque, sensors: Sequence[Measured],
                    start_ns: int) -> Iterator[Panel]:
    """
    Generate the panels that plot a residual torque.

    Parameters
    ----------
    torque : ResidualTorque
        The residual torque with its noise.
    sensors : sequence of Measured
        Measurements in body axes. The panel in space axes is drawn only if the measurements
        include attitudes.
    start_ns : int
        The time at which the time axis of the panels begins.

    """
    noise = np.stack([torque.noise, torque.noise])
    shown = [('body', torque.torques, noise)]
    shown += [('space', *torque.in_space(sensor)) for sensor in sensors
              if sensor.attitude is not None and len(sensor) > 1][:1]
    for axes, torques, sigma in shown:
        label = f'residual torque, {axes} axes, averaged over {torque.window_s:.2g} s'
        yield Panel(label, 'N m', [
            Curves.thinned(torque.times_ns, torques, style.TORQUES, start_ns),
            limits(torque.times_ns, 2.0 * sigma, '±2 sigma of the noise', start_ns)], SINCE_FIRST)
    found = spectrum(torque)
    if found:
        names = ['99 % limit of white noise', '', '']
        yield Panel('amplitude of the residual torque, body axes', 'N m', [
            Curves(found.hertz, found.amplitudes, found.amplitudes, style.TORQUES),
            Curves(found.hertz, found.limits, found.limits, names, style='limits')],
            'frequency (Hz)', 'log')


class Spectrum(NamedTuple):
    """
    Amplitudes of the residual torque at a series of frequencies.

    Attributes
    ----------
    hertz : array, shape (m,)
    amplitudes, limits : array, shape (m, 3), N m, body axes
        The amplitude of a sine at each frequency, and a limit for this amplitude. White noise in
        the angular velocity exceeds the limit at about one frequency in a hundred.

    """

    hertz: Floats
    amplitudes: Floats
    limits: Floats


def spectrum(torque: ResidualTorque) -> Spectrum | None:
    """
    Return the spectrum of a residual torque, or None if the residual torque is too short.

    The residual torque is the slope of an angular momentum over a window of T seconds. If the
    samples are dense, taking this slope multiplies the amplitude at frequency f by
    3 (sin x - x cos x) / x^3, where x = pi f T. The spectrum is divided by this factor to undo its
    effect, and ends at the frequency where the factor has dropped to one half.
    """
    seconds = 1e-9 * (torque.times_ns - torque.times_ns[0])
    if len(seconds) < FEWEST:
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
    if not kept.any():
        return None
    shown = np.asarray(hertz[kept], np.float64)
    half = round(0.5 * torque.window_s / spacing)
    times, turn = spacing * np.arange(-half, half + 1), 2.0 * np.pi * shown
    smoothed = np.sin(np.outer(turn, times)) @ times / turn / np.sum(times ** 2)
    amplitudes = 2.0 / window.sum() * np.sqrt(power.mean(axis=0)[kept]) / smoothed[:, None]
    # Assume white noise in the angular momentum. Each torque is the slope of a line that is fitted
    # to the angular momentum in a window.
    noise = torque.noise * np.sqrt(np.sum(times ** 2) * np.sum(window ** 2)) / window.sum()
    return Spectrum(shown, amplitudes, np.outer(turn, 2.0 * _exceeded(len(segments)) * noise))


def _exceeded(count: int) -> float:
    """Return the noise limit divided by the rms noise, for an average of `count` segments."""
    from scipy.special import chdtri
    return float(np.sqrt(chdtri(2 * count, _EXCEEDS) / (2 * count)))
