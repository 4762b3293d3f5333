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
Compute the residual torque, which must have acted in addition to the torques of the model.

Subtracting the impulse of all modelled torques from the measured change in angular momentum leaves
the impulse of the torques that the model lacks. The residual torque is the slope of this impulse
over a short window. The impulses of logged torques are computed exactly, so a torque step between
two measurements causes no error. Panels plot the torque and its spectrum.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import entries, Floats, Ints, symmetric
from rigid_body_ros.inference.noise import FEWEST, JUMP
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.lags import LaggingSources
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report.charts import Curves, Panel, TORQUES
from rigid_body_ros.report.panels import limits, SINCE_FIRST

#: Length of a window, s; it has more than `FEWEST` samples. If the samples of a window span more
#: than twice the usual time, the window contains a gap and is skipped.
WINDOW = 0.25
_BLOCK = 2 ** 15
#: Six symmetric tensors. In each, one of ixx, iyy, izz, ixy, ixz and iyz is 1 and the rest are 0.
_UNITS = [symmetric(unit) for unit in np.eye(6)]
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


@dataclass(frozen=True, eq=False)
class ResidualTorque:
    """
    The torque that must have acted in addition to the torques of the model.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
        Stamp of the middle sample of each window.
    torques : array, shape (n, 3), N m, body axes
        The mean residual torque in each window.
    noise : array, shape (3,), N m
        Standard deviation of each component, estimated from the scatter within the windows.
    window_s : float, s
        Length of a window.
    logged : array, shape (n, 3), N m, body axes
        The logged torque, averaged over each window.
    of_inertia : array, shape (n, 3, 6)
        Torque that the measured motion would require per unit of ixx, iyy, izz, ixy, ixz and iyz.

    """

    times_ns: Ints
    torques: Floats
    noise: Floats
    window_s: float
    logged: Floats
    of_inertia: Floats

    def in_space(self, sensor: Measured) -> tuple[Floats, Floats]:
        """
        Convert the torques and the noise to space axes, using the attitudes of a sensor.

        Both results have shape (n, 3).
        """
        assert sensor.attitude is not None
        attitude = interpolated(sensor.stamps_ns, sensor.attitude, self.times_ns)
        axes = so3.rotate(attitude[:, None], np.eye(3))
        noise = np.sqrt(np.einsum('nkj,k->nj', axes ** 2, self.noise ** 2))
        return so3.rotate(attitude, self.torques), noise


def with_attitude(rates: Measured, attitudes: Measured) -> Measured:
    """
    Combine the angular velocities of one sensor with interpolated attitudes of another sensor.

    The result contains only the samples between the first and the last attitude.
    """
    assert attitudes.attitude is not None
    first_ns, last_ns = attitudes.stamps_ns[[0, -1]]
    inside = rates.rows((rates.stamps_ns >= first_ns) & (rates.stamps_ns <= last_ns))
    return replace(inside, attitude=interpolated(attitudes.stamps_ns, attitudes.attitude,
                                                 inside.stamps_ns))


def residual_torque(problem: Problem, sensor: Measured) -> ResidualTorque | None:
    """
    Return the torque that must have acted in addition to the torques of a problem.

    The residual torque is J dw/dt - (J w + h) x w + D w + tau_wheel - tau, where w is the measured
    angular velocity. Each term is averaged over a window. The torque tau includes the field
    torques at the measured attitude.

    Parameters
    ----------
    problem : Problem
        The model with the known torques.
    sensor : Measured
        The measurements, already converted to the clock and the axes of the problem.

    Returns
    -------
    ResidualTorque or None
        None if the measurement is too short.

    """
    sensor = sensor.rows(sensor.stamps_ns >= problem.start.time_ns)
    if len(sensor) < 2:
        return None
    stamps_ns, rates = without_outliers(*measured_rates(sensor))
    seconds = 1e-9 * (stamps_ns - stamps_ns[0])
    usual = max(float(np.median(np.diff(seconds))), 1e-9)
    window = max(round(0.5 * WINDOW / usual), FEWEST // 2)
    if len(stamps_ns) <= 2 * window + 1:
        return None
    body, momenta = problem.body, problem.rotor_momentum(stamps_ns)
    uniform, gradients = _of_fields(problem, stamps_ns, sensor)
    parts = [rates @ unit - _integral(seconds, np.cross(rates @ unit, rates) + gradient)
             for unit, gradient in zip(_UNITS, gradients)]
    others = momenta - _integral(seconds, np.cross(momenta, rates)) \
        + _integral(seconds, rates @ body.damping - uniform)
    logged = impulses(problem, stamps_ns, sensor)
    momentum = sum(entry * part for entry, part in zip(entries(body.inertia), parts)) \
        + others - logged
    rows, slopes, variances = _slopes(seconds, np.stack([momentum, logged, *parts]), window)
    if not len(rows):
        return None
    return ResidualTorque(
        stamps_ns[rows], slopes[:, 0], np.sqrt(np.median(variances, axis=0)),
        float(np.median(seconds[2 * window:] - seconds[:-2 * window])),
        slopes[:, 1], slopes[:, 2:].swapaxes(1, 2))


def _of_fields(problem: Problem, stamps_ns: Ints, sensor: Measured) -> tuple[Floats, Floats]:
    """
    Return the torques of the fields at the given stamps, in two parts.

    The first part is the torque of the uniform fields. The second part is the gravity-gradient
    torque per unit inertia.
    """
    uniform, gradients = np.zeros((len(stamps_ns), 3)), np.zeros((6, len(stamps_ns), 3))
    if not problem.fields:
        return uniform, gradients
    attitude = _attitude(problem, stamps_ns, sensor)
    for field in problem.fields:
        if isinstance(field, UniformField):
            uniform += field.torque(problem.body, stamps_ns, attitude)
        else:
            r = so3.rotate(so3.conjugate(attitude), field.directions(stamps_ns))
            gradients += [3.0 * field.mean_motion ** 2 * np.cross(r, r @ unit) for unit in _UNITS]
    return uniform, gradients


def impulses(problem: Problem, stamps_ns: Ints, sensor: Measured) -> Floats:
    """
    Return the impulses of the logged torques from the first stamp to each stamp.

    Torques in space axes are converted to body axes, using the measured attitude or, if there is
    none, the computed attitude.

    Returns
    -------
    array, shape (n, 3), N m s, body axes

    """
    total = np.zeros((len(stamps_ns), 3))
    for log in problem.acting_logs:
        changes, _ = log.segments(problem.options.timeout_ns)
        changes = changes[(changes > stamps_ns[0]) & (changes < stamps_ns[-1])]
        ends = np.union1d(stamps_ns, changes)
        spans, impulse = np.diff(ends), np.zeros((len(ends) - 1, 3))
        # Two-point Gauss quadrature is exact for cubics.
        for node in (0.5 - np.sqrt(1.0 / 12.0), 0.5 + np.sqrt(1.0 / 12.0)):
            times = ends[:-1] + (node * spans).astype(np.int64)
            impulse += 0.5e-9 * spans[:, None] * _in_body(problem, log, times, sensor)
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(impulse, axis=0)])
        total += sums[np.searchsorted(ends, stamps_ns)]
    lagging = problem.lagging()
    return total + _lag_impulses(problem, lagging, stamps_ns, sensor) if lagging else total


def _lag_impulses(problem: Problem, lagging: LaggingSources, stamps_ns: Ints,
                  sensor: Measured) -> Floats:
    """Return the difference that actuator lags make to the impulses of the commanded torques."""
    changes = np.concatenate([lagging.marks_ns, *(
        log.segments(problem.options.timeout_ns)[0] for log in problem.acting_logs)])
    ends = np.union1d(stamps_ns, changes[(changes > stamps_ns[0]) & (changes < stamps_ns[-1])])
    body, space = lagging.impulses(ends).transpose(1, 0, 2)
    if space.any():
        middle = ends[:-1] + np.diff(ends) // 2
        body = body + so3.rotate(so3.conjugate(_attitude(problem, middle, sensor)), space)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(body, axis=0)])
    return np.asarray(sums[np.searchsorted(ends, stamps_ns)])


def _in_body(problem: Problem, log: TorqueLog, times: Ints, sensor: Measured) -> Floats:
    torques, in_space = log.at(times, problem.options.timeout_ns)
    rows = np.flatnonzero(in_space)
    if rows.size:
        attitude = _attitude(problem, times[rows], sensor)
        torques[rows] = so3.rotate(so3.conjugate(attitude), torques[rows])
    return torques


def _attitude(problem: Problem, times_ns: Ints, sensor: Measured) -> Floats:
    """
    Return the attitudes at given times.

    If the sensor does not measure attitudes, the attitudes come from a computed motion.
    """
    if sensor.attitude is None:
        return problem.propagate(at=times_ns).attitude
    return interpolated(sensor.stamps_ns, sensor.attitude, times_ns)


def interpolated(stamps_ns: Ints, attitude: Floats, times_ns: Ints) -> Floats:
    """
    Return attitudes at the times `times_ns`, shape (m, 4).

    The attitudes are interpolated from those at ascending stamps, shape (n, 4).
    """
    rows = np.clip(np.searchsorted(stamps_ns, times_ns, 'right') - 1, 0, len(stamps_ns) - 2)
    part = (times_ns - stamps_ns[rows]) / np.diff(stamps_ns)[rows]
    step = so3.difference(attitude[rows], attitude[rows + 1])
    return so3.multiply(attitude[rows], so3.exp(part[:, None] * step))


def without_outliers(stamps_ns: Ints, rates: Floats) -> tuple[Ints, Floats]:
    """
    Remove gross outliers from angular velocities.

    At an outlier, the angular velocity jumps to some value and back, which is impossible for a
    body. Each sample is compared with the median of five samples: itself and two neighbours on
    each side. A sample is an outlier if its distance from the median exceeds ten times the usual
    distance plus three times the usual change from one sample to the next.

    Parameters
    ----------
    stamps_ns : array of int64, shape (n,), ns
        Ascending stamps.
    rates : array, shape (n, 3), rad/s
        Angular velocities, in any axes.

    """
    from scipy.ndimage import median_filter
    away = np.linalg.norm(rates - median_filter(rates, (5, 1), mode='nearest'), axis=1)
    change = np.median(np.linalg.norm(np.diff(rates, axis=0), axis=1))
    kept = away <= JUMP * np.median(away) + 3.0 * change
    return stamps_ns[kept], rates[kept]


def _integral(seconds: Floats, values: Floats) -> Floats:
    """
    Return the integrals of the samples from the first sample to each sample.

    The integrals are those of a cubic spline through the samples.
    """
    from scipy.interpolate import CubicSpline  # slow to import
    return np.asarray(CubicSpline(seconds, values).antiderivative()(seconds))


def _slopes(seconds: Floats, values: Floats, half: int
            ) -> tuple[NDArray[np.intp], Floats, Floats]:
    """
    Fit a line to the samples in each window that has no gap.

    Parameters
    ----------
    seconds : array, shape (n,), s
        The times of the samples.
    values : array, shape (k, n, 3)
        The samples of k vectors.
    half : int
        Number of samples in a window before and after the middle one.

    Returns
    -------
    rows : array, shape (m,)
        The rows of the middle samples.
    slopes : array, shape (m, k, 3)
    variances : array, shape (m, 3)
        The variances of the slopes of the first vector.

    """
    size, usual = 2 * half + 1, float(np.median(np.diff(seconds)))
    is_whole = seconds[2 * half:] - seconds[:-2 * half] <= 2.0 * usual * (size - 1)
    views = sliding_window_view(np.ascontiguousarray(values.swapaxes(1, 2)), size, axis=2)
    slopes, variances = np.empty((len(is_whole), *values.shape[::2])), np.empty((len(is_whole), 3))
    for first in range(0, len(is_whole), _BLOCK):
        part = slice(first, first + _BLOCK)
        times = sliding_window_view(seconds, size)[part]
        times = times - times[:, half:half + 1]  # small numbers, whose mean has a small error
        times -= times.mean(axis=1, keepdims=True)
        spread, inside = np.sum(times ** 2, axis=1), views[:, :, part]
        slope = np.einsum('nw,kxnw->nkx', times, inside) / spread[:, None, None]
        left = inside[0] - inside[0].mean(axis=2, keepdims=True) - slope[:, 0].T[..., None] * times
        slopes[part] = slope
        variances[part] = (np.sum(left ** 2, axis=2) / (size - 2) / spread).T
    return np.flatnonzero(is_whole) + half, slopes[is_whole], variances[is_whole]


def measured_rates(sensor: Measured, lag: int = 1) -> tuple[Ints, Floats]:
    """
    Return the angular velocities of a sensor.

    If the sensor does not measure angular velocities, they are computed from its attitudes.

    Each computed value is the mean angular velocity between two samples that are `lag` samples
    apart, and its time is halfway between their stamps.

    Returns
    -------
    times_ns : array of int64, shape (n,) or (n - lag,)
    rates : array, shape (n, 3) or (n - lag, 3), rad/s, body axes

    """
    stamps_ns, attitude = sensor.stamps_ns, sensor.attitude
    if sensor.angular_velocity is not None:
        return stamps_ns, sensor.angular_velocity
    assert attitude is not None
    spans = stamps_ns[lag:] - stamps_ns[:-lag]
    turned = so3.difference(attitude[:-lag], attitude[lag:])
    return stamps_ns[:-lag] + spans // 2, turned / (1e-9 * np.maximum(spans, 1))[:, None]


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
            Curves.thinned(torque.times_ns, torques, TORQUES, start_ns),
            limits(torque.times_ns, 2.0 * sigma, '±2 sigma of the noise', start_ns)], SINCE_FIRST)
    if waves := spectrum(torque):
        names = ['99 % limit of white noise', '', '']
        yield Panel('amplitude of the residual torque, body axes', 'N m', [
            Curves(waves.hertz, waves.amplitudes, waves.amplitudes, TORQUES),
            Curves(waves.hertz, waves.limits, waves.limits, names, style='limits')],
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
    from scipy.special import chdtri  # slow to import
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
    # The limit of the mean of several segments, divided by the rms noise.
    freedom = 2 * len(segments)
    exceeded = float(np.sqrt(chdtri(freedom, _EXCEEDS) / freedom))
    return Spectrum(shown, amplitudes, np.outer(turn, 2.0 * exceeded * noise))
