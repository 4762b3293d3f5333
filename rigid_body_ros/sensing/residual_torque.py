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
The torque that must have acted in addition to the logged one.

The change of the angular momentum that was measured, less the impulse of everything that the
model knows, is the impulse of what it does not know. Its slope over a short window is the residual
torque. Logged torques enter as exact impulses, so a step between two measurements is not an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import entries, Floats, symmetric
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.lags import LaggingSources
from rigid_body_ros.sensing.measured import Measured
from rigid_body_ros.sensing.rates import measured_rates

#: Length of a window, s, and its fewest samples; a window of more than twice the length has a gap.
WINDOW, FEWEST = 0.25, 11
#: The nodes of Gauss's formula with two points, exact for a cubic.
_NODES = 0.5 - np.sqrt(1.0 / 12.0), 0.5 + np.sqrt(1.0 / 12.0)
_BLOCK = 2 ** 15
#: Distance from the median around a sample, in usual distances, above which it is an outlier.
_OUTLIER = 10.0
#: Tensors with one of the six entries.
_UNITS = [symmetric(unit) for unit in np.eye(6)]


class Slopes(NamedTuple):
    """Slopes in windows: rows of the samples at their middles, slopes and standard deviations."""

    rows: NDArray[np.intp]
    values: Floats
    deviations: Floats


@dataclass(frozen=True, eq=False)
class ResidualTorque:
    """
    The torque that must have acted in addition to the logged one, smoothed over a window.

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
    torques : array, shape (n, 3), N m, body axes
    noise : array, shape (3,), N m
        Standard deviation of each component, estimated from the scatter within the windows.
    window_s : float, s
    logged : array, shape (n, 3), N m, body axes
        The logged torque, smoothed in the same way.
    of_inertia : array, shape (n, 3, 6)
        Torque that the measured motion needs for a unit of each of ixx, iyy, izz, ixy, ixz, iyz.

    """

    times_ns: NDArray[np.int64]
    torques: Floats
    noise: Floats
    window_s: float
    logged: Floats
    of_inertia: Floats

    def in_space(self, sensor: Measured) -> tuple[Floats, Floats]:
        """Return torques and noise, shape (n, 3), in space axes, by attitudes of a sensor."""
        assert sensor.attitude is not None
        attitude = interpolated(sensor.stamps_ns, sensor.attitude, self.times_ns)
        axes = so3.rotate(attitude[:, None], np.eye(3))
        noise = np.sqrt(np.einsum('nkj,k->nj', axes ** 2, self.noise ** 2))
        return so3.rotate(attitude, self.torques), noise


def with_attitude(rates: Measured, attitudes: Measured) -> Measured:
    """Return the angular velocities between attitudes of another sensor, with these."""
    assert attitudes.attitude is not None
    first_ns, last_ns = attitudes.stamps_ns[[0, -1]]
    inside = rates.rows((rates.stamps_ns >= first_ns) & (rates.stamps_ns <= last_ns))
    return replace(inside, attitude=interpolated(attitudes.stamps_ns, attitudes.attitude,
                                                 inside.stamps_ns))


def residual_torque(problem: Problem, sensor: Measured) -> ResidualTorque | None:
    """
    Return the torque that explains the measurements, in addition to the torques of a problem.

    J dw/dt - (J w + h) x w + D w + tau_wheel - tau with the measured w, each term averaged over
    the window. tau has the torques of the fields, at the measured attitude.

    Parameters
    ----------
    problem : Problem
        What is known.
    sensor : Measured
        In the time and the axes of the problem.

    Returns
    -------
    ResidualTorque or None
        None if the measurement is too short.

    """
    inside = np.flatnonzero(sensor.stamps_ns >= problem.start.time_ns)
    sensor = sensor.rows(inside)
    if len(sensor) < 2:
        return None
    stamps_ns, rates = without_outliers(*measured_rates(sensor))
    seconds = 1e-9 * (stamps_ns - stamps_ns[0])
    window = _half_window(seconds)
    if len(stamps_ns) <= 2 * window + 1:
        return None
    body, momenta = problem.body, problem.rotor_momentum(stamps_ns)
    uniform, gradients = _of_fields(problem, stamps_ns, sensor)
    parts = [rates @ unit - _integral(seconds, np.cross(rates @ unit, rates) + gradient)
             for unit, gradient in zip(_UNITS, gradients)]
    known = momenta - _integral(seconds, np.cross(momenta, rates)) \
        + _integral(seconds, rates @ body.damping - uniform)
    logged = impulses(problem, stamps_ns, sensor)
    momentum = sum(entry * part for entry, part in zip(entries(body.inertia), parts)) \
        + known - logged
    slopes = _slopes(seconds, momentum, window)
    if not len(slopes.rows):
        return None
    of_inertia = np.stack([_slopes(seconds, part, window).values for part in parts], axis=-1)
    return ResidualTorque(
        stamps_ns[slopes.rows], slopes.values, np.sqrt(np.median(slopes.deviations ** 2, axis=0)),
        float(np.median(seconds[2 * window:] - seconds[:-2 * window])),
        _slopes(seconds, logged, window).values, of_inertia)


def _of_fields(problem: Problem, stamps_ns: NDArray[np.int64],
               sensor: Measured) -> tuple[Floats, Floats]:
    """Return the torque of uniform fields, and the gravity gradient on a unit of each entry."""
    uniform, gradients = np.zeros((len(stamps_ns), 3)), np.zeros((6, len(stamps_ns), 3))
    if not problem.fields:
        return uniform, gradients
    attitude = _attitude(problem, stamps_ns, sensor)
    for one in problem.fields:
        if isinstance(one, UniformField):
            uniform += one.torque(problem.body, stamps_ns, attitude)
        else:
            r = so3.rotate(so3.conjugate(attitude), one.directions(stamps_ns))
            gradients += [3.0 * one.mean_motion ** 2 * np.cross(r, r @ unit) for unit in _UNITS]
    return uniform, gradients


def impulses(problem: Problem, stamps_ns: NDArray[np.int64], sensor: Measured) -> Floats:
    """
    Return the impulses of the logged torques since the first of some times.

    Torques in space axes are converted with the measured attitude, or if there is none, with the
    attitude of the motion.

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
        for node in _NODES:
            times = ends[:-1] + (node * spans).astype(np.int64)
            impulse += 0.5e-9 * spans[:, None] * _in_body(problem, log, times, sensor)
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(impulse, axis=0)])
        total += sums[np.searchsorted(ends, stamps_ns)]
    lagging = problem.lagging()
    return total + _lag_impulses(problem, lagging, stamps_ns, sensor) if lagging else total


def _lag_impulses(problem: Problem, lagging: LaggingSources, stamps_ns: NDArray[np.int64],
                  sensor: Measured) -> Floats:
    """Return what the lags of actuators add, as `impulses` does."""
    changes = np.concatenate([lagging.marks_ns, *(
        log.segments(problem.options.timeout_ns)[0] for log in problem.acting_logs)])
    ends = np.union1d(stamps_ns, changes[(changes > stamps_ns[0]) & (changes < stamps_ns[-1])])
    body, space = lagging.impulses(ends).transpose(1, 0, 2)
    if space.any():
        middle = ends[:-1] + np.diff(ends) // 2
        body = body + so3.rotate(so3.conjugate(_attitude(problem, middle, sensor)), space)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(body, axis=0)])
    return np.asarray(sums[np.searchsorted(ends, stamps_ns)])


def _in_body(problem: Problem, log: TorqueLog, times: NDArray[np.int64],
             sensor: Measured) -> Floats:
    torques, in_space = log.at(times, problem.options.timeout_ns)
    rows = np.flatnonzero(in_space)
    if rows.size:
        attitude = _attitude(problem, times[rows], sensor)
        torques[rows] = so3.rotate(so3.conjugate(attitude), torques[rows])
    return torques


def _attitude(problem: Problem, times_ns: NDArray[np.int64], sensor: Measured) -> Floats:
    """Return the measured attitude at times, or the computed one if none is measured."""
    if sensor.attitude is None:
        return problem.propagate(at=times_ns).attitude
    return interpolated(sensor.stamps_ns, sensor.attitude, times_ns)


def interpolated(stamps_ns: NDArray[np.int64], attitude: Floats,
                 times_ns: NDArray[np.int64]) -> Floats:
    """Return attitudes at times, shape (m, 4), from those at ascending stamps, shape (n, 4)."""
    rows = np.clip(np.searchsorted(stamps_ns, times_ns, 'right') - 1, 0, len(stamps_ns) - 2)
    part = (times_ns - stamps_ns[rows]) / np.diff(stamps_ns)[rows]
    step = so3.log(so3.multiply(so3.conjugate(attitude[rows]), attitude[rows + 1]))
    return so3.multiply(attitude[rows], so3.exp(part[:, None] * step))


def without_outliers(stamps_ns: NDArray[np.int64], rates: Floats
                     ) -> tuple[NDArray[np.int64], Floats]:
    """
    Return angular velocities without gross outliers.

    An outlier differs from the median of the five samples around it by more than ten times the
    usual difference, and by more than samples usually change. The angular velocity of a body
    cannot jump and come back.

    Parameters
    ----------
    stamps_ns : array of int64, shape (n,), ns
        Ascending.
    rates : array, shape (n, 3), rad/s
        In any axes.

    """
    from scipy.ndimage import median_filter
    away = np.linalg.norm(rates - median_filter(rates, (5, 1), mode='nearest'), axis=1)
    change = np.median(np.linalg.norm(np.diff(rates, axis=0), axis=1))
    kept = away <= _OUTLIER * np.median(away) + 3.0 * change
    return stamps_ns[kept], rates[kept]


def _integral(seconds: Floats, values: Floats) -> Floats:
    """Return integrals of a cubic spline through samples, from the first sample on."""
    from scipy.interpolate import CubicSpline  # takes as long to import as the engine
    return np.asarray(CubicSpline(seconds, values).antiderivative()(seconds))


def _half_window(seconds: Floats) -> int:
    usual = max(float(np.median(np.diff(seconds))), 1e-9)
    return max(round(0.5 * WINDOW / usual), FEWEST // 2)


def _slopes(seconds: Floats, values: Floats, half: int) -> Slopes:
    """Return the slopes of straight lines through the samples in each window without a gap."""
    size = 2 * half + 1
    middles = np.arange(half, len(seconds) - half)
    usual = float(np.median(np.diff(seconds)))
    long = seconds[2 * half:] - seconds[:-2 * half] > 2.0 * usual * (size - 1)
    rows, slopes, deviations = middles[~long], [], []
    for first in range(0, len(rows), _BLOCK):
        part = rows[first:first + _BLOCK] - half
        times = sliding_window_view(seconds, size)[part]
        times = times - times.mean(axis=1, keepdims=True)
        inside = sliding_window_view(values, size, axis=0)[part]
        inside = inside - inside.mean(axis=2, keepdims=True)
        spread = np.sum(times ** 2, axis=1)[:, None]
        slope = np.einsum('nw,nkw->nk', times, inside) / spread
        left = inside - slope[:, :, None] * times[:, None, :]
        slopes.append(slope)
        deviations.append(np.sqrt(np.sum(left ** 2, axis=2) / (size - 2) / spread))
    empty: Sequence[Floats] = [np.empty((0, values.shape[1]))]
    return Slopes(rows, np.concatenate([*empty, *slopes]), np.concatenate([*empty, *deviations]))
