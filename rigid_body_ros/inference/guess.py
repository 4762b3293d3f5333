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

"""Guess clock offsets, mountings and states from the data, for a fit to begin with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.motion import inside, Motion
from rigid_body_ros.inference.residual_torque import measured_rates, residual_torque
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report.thinning import thinned

#: The largest clock offset that the search can find, s.
LARGEST_OFFSET = 10.0
#: The search samples the angular velocities on a grid with at most this many points in time.
_POINTS = 2 ** 20
#: An offset is considered only if at least this fraction of the measurement overlaps the motion.
_OVERLAP = 0.5
#: Tolerance for ties between local minima, as a fraction of the difference between the median cost
#: and the smallest cost. A minimum that exceeds the smallest cost by no more than this is a tie.
#: Among tied minima, the search chooses the one with the smallest absolute offset.
_SAME = 0.01
#: A state is estimated from about this many samples.
_LOCAL = 25
#: Spacing of the offsets that `likely_offset` tries, s.
_SPACING = 0.02
#: Approximate number of samples used to evaluate each offset.
_ROWS = 500
#: A clock offset is accepted only if the fraction of the torque that stays unexplained at this
#: offset is less than `_BETTER` times the fraction that stays unexplained at zero offset.
_BETTER = 0.8
#: The quaternion of no rotation.
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def guess(motion: Motion, sensors: Sequence[Measured], clocks: Sequence[bool],
          mounts: Sequence[bool]) -> list[tuple[float, Floats, Floats]]:
    """
    Guess clock offsets and mountings, and the rotation of the space axes.

    Parameters
    ----------
    motion : Problem or Recorded
        The motion to align the sensors with.
    sensors : sequence of Measured
        The measurements. The rotation of the space axes is determined from the sensor with the
        most attitudes.
    clocks, mounts : sequence of bool
        For each sensor, whether to guess its clock offset, and whether to guess its rotations.
        A clock offset that is not requested is zero, and a rotation that is not requested is the
        identity.

    Returns
    -------
    list of tuple
        For each sensor, the clock offset, s, and two quaternions: the rotation of the mounting and
        the rotation of the space axes.

    """
    space, most, guesses = IDENTITY, 0, []
    for sensor, clock, mount in zip(sensors, clocks, mounts):
        offset = _offset(motion, sensor, mount) if clock else 0.0
        mounting, turn = _mounting(motion, sensor, round(1e9 * offset)) if mount \
            else (IDENTITY, IDENTITY)
        if mount and sensor.attitude is not None and len(sensor) > most:
            space, most = turn, len(sensor)
        guesses.append((offset, mounting))
    return [(offset, mounting, space) for offset, mounting in guesses]


def _offset(motion: Motion, sensor: Measured, mount: bool) -> float:
    """Return the clock offset, s, for which the measured and computed rates agree best."""
    from scipy.ndimage import median_filter
    stamps_ns, rates = measured_rates(sensor)
    rates = median_filter(rates, (5, 1), mode='nearest')  # removes isolated outliers
    first_ns, last_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    step_ns = max(int(np.median(np.diff(stamps_ns))), (last_ns - first_ns) // _POINTS, 1000)
    most = round(1e9 * LARGEST_OFFSET) // step_ns
    grid_ns = first_ns + step_ns * np.arange((last_ns - first_ns) // step_ns + 1)
    measured = np.stack([np.interp(grid_ns - first_ns, stamps_ns - first_ns, column)
                         for column in rates.T])
    wider_ns = first_ns + step_ns * np.arange(-most, len(grid_ns) + most)
    within = inside(motion, wider_ns)
    computed = np.zeros((3, len(wider_ns)))
    if within.any():
        computed[:, within] = motion.propagate(at=wider_ns[within]).angular_velocity.T
    return _best_lag(measured, computed, within, mount) * 1e-9 * step_ns


def _best_lag(measured: Floats, computed: Floats, within: NDArray[np.bool_], mount: bool) -> float:
    """
    Return the lag, in grid steps, that minimizes the mean squared difference of the rates.

    If the mounting is unknown, the measured rates are first rotated, at each lag, so that they
    agree with the computed rates as well as possible. The sum of the singular values of the
    correlation matrix then takes the place of the trace of this matrix (Kabsch, 1976).
    """
    from scipy import fft  # slow to import
    count = measured.shape[1]
    size = fft.next_fast_len(computed.shape[1], real=True)

    def correlated(wide: Floats, narrow: Floats) -> Floats:
        product = fft.rfft(wide, size) * np.conj(fft.rfft(narrow, size))
        return np.asarray(fft.irfft(product, size)[:len(wide) - count + 1])
    valid = within.astype(float)
    overlap = correlated(valid, np.ones(count))
    energy = correlated(valid, np.sum(measured ** 2, axis=0)) \
        + correlated(np.sum(computed ** 2, axis=0), np.ones(count))
    if mount:
        products = np.array([[correlated(wide, narrow) for narrow in measured]
                             for wide in computed]).transpose(2, 0, 1)
        singular = np.linalg.svd(products, compute_uv=False)
        singular[:, 2] *= np.sign(np.linalg.det(products))
        match = singular.sum(axis=1)
    else:
        match = np.sum([correlated(*pair) for pair in zip(computed, measured)], axis=0)
    allowed = overlap >= _OVERLAP * count
    middle = len(overlap) // 2
    if not allowed.any():
        return 0.0
    cost = np.where(allowed, (energy - 2.0 * match) / np.maximum(overlap, 1.0), np.inf)
    least, usual = cost.min(), float(np.median(cost[allowed]))
    padded = np.concatenate([[np.inf], cost, [np.inf]])
    good = (cost <= least + _SAME * max(usual - least, 0.0)) & (padded[:-2] >= cost) \
        & (padded[2:] >= cost)
    lags = np.flatnonzero(good)
    best = int(lags[np.argmin(np.abs(lags - middle))])
    around = padded[best:best + 3]
    bend = around[0] - 2.0 * around[1] + around[2] if np.isfinite(around).all() else 0.0
    fraction = 0.5 * (around[0] - around[2]) / bend if bend > 0.0 else 0.0
    return best - middle + float(np.clip(fraction, -0.5, 0.5))


def _mounting(motion: Motion, sensor: Measured, offset_ns: int) -> tuple[Floats, Floats]:
    """Return the best-fitting rotations for a sensor: of its mounting, and of the space axes."""
    times_ns = sensor.stamps_ns + offset_ns
    within = inside(motion, times_ns)
    if within.sum() < 2:
        return IDENTITY, IDENTITY
    states = motion.propagate(at=times_ns[within])
    if sensor.attitude is None:
        assert sensor.angular_velocity is not None
        return kabsch(sensor.angular_velocity[within], states.angular_velocity), IDENTITY
    attitude = sensor.attitude[within]
    # Between the samples of a pair, the body turns by about one radian.
    usual = max(float(np.median(so3.angle_between(attitude[:-1], attitude[1:]))), 1e-9)
    step = int(np.clip(1.0 / usual, 1, max(len(attitude) // 4, 1)))
    turned, expected = (so3.difference(poses[:-step], poses[step:])
                        for poses in (attitude, states.attitude))
    short = np.linalg.norm(turned, axis=1) < 2.8
    mount = kabsch(turned[short], expected[short]) if short.any() else IDENTITY
    rest = so3.multiply(so3.multiply(attitude, so3.conjugate(mount)),
                        so3.conjugate(states.attitude))
    return mount, davenport(rest)


def kabsch(vectors: Floats, targets: Floats) -> Floats:
    """
    Return the rotation that best maps vectors to targets, as a quaternion x y z w.

    Outliers are given less weight.

    Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    weights = np.ones(len(vectors))
    for _ in range(5):
        left, _, right = np.linalg.svd((weights[:, None] * targets).T @ vectors)
        signs = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
        turn = left @ signs @ right
        distances = np.linalg.norm(targets - vectors @ turn.T, axis=1)
        weights = _weights(distances)
    return so3.from_matrix(turn)


def davenport(attitudes: Floats) -> Floats:
    """
    Return the mean of several attitudes, giving less weight to outliers.

    The mean is the eigenvector of the largest eigenvalue of the sum of q q^T (Davenport, 1968;
    Markley et al., "Averaging quaternions", 2007).
    """
    weights = np.ones(len(attitudes))
    for _ in range(5):
        _, vectors = np.linalg.eigh((weights[:, None] * attitudes).T @ attitudes)
        mean = so3.normalize(vectors[:, -1])
        weights = _weights(so3.angle_between(attitudes, mean))
    return mean


def _weights(distances: Floats) -> Floats:
    scale = 2.0 * float(np.median(distances))
    return 1.0 / np.maximum(distances / max(scale, 1e-12), 1.0)


def likely_offset(problem: Problem, sensors: Sequence[Measured]) -> float:
    """
    Return the clock offset for which the logged torques best explain the measured motion.

    The torque required for a given motion is a linear function of the entries of the inertia. For
    each trial offset, linear least squares therefore finds the best inertia, and no guess of the
    inertia is needed.

    Parameters
    ----------
    problem : Problem
        The model. Its inertia is not used.
    sensors : sequence of Measured
        The measurements. Only one sensor is used: the gyro with the most samples or, if there is
        no gyro, the sensor with the most samples.

    Returns
    -------
    float, s
        The offset to add to the stamps of the measurements. It is 0 unless some other offset
        explains the torques much better.

    """
    sensor = max(sensors, key=lambda sensor: (sensor.angular_velocity is not None, len(sensor)))
    residual = residual_torque(problem, sensor)
    if residual is None or not residual.logged.any():
        return 0.0
    seconds = 1e-9 * (residual.times_ns - residual.times_ns[0])
    rows = thinned(len(seconds), _ROWS)
    largest = min(LARGEST_OFFSET, _OVERLAP * seconds[-1])
    offsets = _SPACING * np.arange(-int(largest / _SPACING), int(largest / _SPACING) + 1)
    left = np.array([_unexplained(seconds[rows] + offset, residual.of_inertia[rows], seconds,
                                  residual.logged) for offset in offsets])
    best = int(np.argmin(left))
    return float(offsets[best]) if left[best] < _BETTER * left[len(left) // 2] else 0.0


def _unexplained(times: Floats, of_inertia: Floats, seconds: Floats, logged: Floats) -> float:
    """Return the fraction of the torque at the given times (s) that no inertia can explain."""
    inside = (times >= 0.0) & (times <= seconds[-1])
    torques = np.stack([np.interp(times[inside], seconds, column) for column in logged.T], axis=1)
    matrix, wanted = of_inertia[inside].reshape(-1, 6), torques.ravel()
    total = float(wanted @ wanted)
    if not total:
        return 1.0
    errors = wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    return float(errors @ errors) / total


def local_state(channels: Sequence[Measured], time_ns: int, rate: float,
                fallback: State) -> tuple[Floats, Floats]:
    """
    Estimate the attitude and angular velocity at a given time from nearby measurements.

    Parameters
    ----------
    channels : sequence of Measured
        The measurements, already converted to the torque clock and to body axes.
    time_ns : int
        The time at which the state is wanted.
    rate : float, rad/s
        Typical angular velocity.
    fallback : State
        A state that provides the quantities that were not measured.

    Returns
    -------
    attitude, angular_velocity : array, shape (4,) and (3,)

    """
    attitude, velocity = fallback.attitude, fallback.angular_velocity
    near = [_near(channel, time_ns, rate) for channel in channels]
    rates, turns = (next((channel for channel in near if channel and channel.is_attitude is kind),
                         None) for kind in (False, True))
    if rates is not None:
        velocity, _ = _robust_line((rates.stamps_ns - time_ns) * 1e-9, rates.values)
    if turns is not None:
        middle = turns.values[np.argsort(turns.stamps_ns)[len(turns) // 2]]
        turned = so3.difference(middle, turns.values)
        here, slope = _robust_line((turns.stamps_ns - time_ns) * 1e-9, turned)
        attitude = so3.multiply(middle, so3.exp(here))
        velocity = slope if rates is None else velocity
    return attitude, velocity


def _near(channel: Measured, time_ns: int, rate: float) -> Measured:
    span_ns = int(0.5e9 / rate)
    centre = int(np.searchsorted(channel.stamps_ns, time_ns))
    near = channel.rows(slice(max(centre - _LOCAL // 2, 0), centre + _LOCAL))
    distances = np.abs(near.stamps_ns - time_ns)
    closest = np.sort(distances)[:3]
    return near.rows(distances <= max(span_ns, int(closest.max(initial=0))))


def _robust_line(seconds: NDArray[np.floating], values: Floats) -> tuple[Floats, Floats]:
    """
    Fit a low-order polynomial to each column, giving less weight to outliers.

    Return the values of the polynomials and their slopes at time zero.
    """
    degree = 0 if len(seconds) < 3 else 1 if len(seconds) < 7 else 2
    columns = np.vander(seconds, degree + 1, increasing=True)
    weights: Floats = np.ones(len(seconds))
    for _ in range(8):
        root = np.sqrt(weights)[:, None]
        coefficients = np.linalg.lstsq(columns * root, values * root, rcond=None)[0]
        errors = np.linalg.norm(values - columns @ coefficients, axis=1)
        weights = 1.0 / (1.0 + (errors / (2.0 * np.median(errors) + 1e-12)) ** 2)
    return coefficients[0], coefficients[1] if degree else np.zeros(3)
