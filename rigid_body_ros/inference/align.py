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

"""Align measurements with a motion: fit clock offsets, mountings and the start of the motion."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.inference.alignment import Alignment
from rigid_body_ros.inference.guess import guess
from rigid_body_ros.inference.motion import divided, inside, Motion, Recorded, span_of, States
from rigid_body_ros.inference.residual_torque import measured_rates
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.runtime import interrupts

START, CLOCK, MOUNT = 'start', 'clock', 'mount'
#: The names of the alignments that can be fitted.
ALIGNMENTS = (START, CLOCK, MOUNT)
#: Finite-difference steps for the Jacobian. The first is used for rotations, rad, and for angular
#: velocities, rad/s. The second is used for clock offsets, s.
_STEP, _CLOCK_STEP = 1e-6, 1e-5
#: The start of the motion is first fitted in stages that cover more and more of the measurement.
#: Each stage uses at most `_STAGE` samples per sensor and at most `_EARLY` solver steps. All other
#: fits take at most `_MOST` solver steps.
_STAGE, _EARLY, _MOST = 400, 6, 20
#: All fits except the last use at most this many samples of each sensor.
_PART = 2000
#: A fit has converged when a step changes the cost by less than this fraction.
_TOLERANCE = 1e-6
#: Limits on the residuals, in standard deviations. The robust loss grows only linearly above
#: `_HUBER`. The last fit ignores all residuals above `_OUTLIER`.
_HUBER, _OUTLIER = 2.0, 5.0
#: Number of motions to cache. Two are enough for a finite difference: the motion at the current
#: point and the motion after a small change.
_KEPT = 2
#: A combination of parameters counts as undetermined by the data if its singular value is smaller
#: than this fraction of the largest singular value.
_SINGULAR = 1e-7


def align(motion: Motion, sensors: Sequence[Measured],
          names: Collection[str], most: int | None = None) -> tuple[Alignment, ...]:
    """
    Align measurements with a motion by a robust least-squares fit.

    Parameters
    ----------
    motion : Problem or Recorded
        The motion to align the sensors with.
    sensors : sequence of Measured
        The measurements. Each sensor has its own clock and its own mounting. All sensors share the
        same start of the motion, and the same rotation between the space axes of the measurements
        and those of the motion.
    names : collection of str
        What to fit: names in `ALIGNMENTS`. Use 'clock@TOPIC' or 'mount@TOPIC' to fit the clock or
        the mounting of a single sensor.
    most : int, optional
        Use at most this many samples of each sensor, evenly spaced. All samples are used by
        default.

    Returns
    -------
    tuple of Alignment
        One alignment for each sensor.

    Raises
    ------
    InputError
        A name is unknown, or no sample lies within the time span of the motion.

    """
    check_names(names, [sensor.topic for sensor in sensors])
    if START in names and isinstance(motion, Recorded):
        raise InputError('align: expected no start, because a recorded motion has its own, '
                         'found start')
    if not names:
        return tuple(Alignment() for _ in sensors)
    clocks, mounts = ([is_asked(names, kind, sensor.topic) for sensor in sensors]
                      for kind in (CLOCK, MOUNT))
    guesses = guess(motion, sensors, clocks, mounts)
    fit = _Fit(motion, sensors, names, [Alignment(*each) for each in guesses], most)
    if START in names:
        fit.grow()
    return fit.solved()


def check_names(names: Collection[str], topics: Sequence[str] | None = None) -> None:
    """Raise InputError if a name is not a known alignment, or if its topic is not in `topics`."""
    for name in names:
        kind, at, topic = name.partition('@')
        if kind not in ALIGNMENTS or (at and (kind == START or not topic)):
            raise InputError(f'align: expected some of {", ".join(ALIGNMENTS)}, or '
                             f'{CLOCK}@TOPIC or {MOUNT}@TOPIC of one sensor, found {name!r}')
        if at and topics is not None and topic not in topics:
            raise InputError(f'align: {name}: expected a topic among {listed(topics)}, found '
                             f'{topic}')


def is_asked(names: Collection[str], kind: str, topic: str) -> bool:
    """Return whether `names` request the alignment `kind`, 'clock' or 'mount', for a topic."""
    return kind in names or f'{kind}@{topic}' in names


class _Column(NamedTuple):
    """
    A fitted quantity, and the index of the sensor to which the quantity belongs.

    The index is -1 if all sensors share the quantity.
    """

    name: str
    sensor: int = -1

    @property
    def size(self) -> int:
        return 1 if self.name == 'clock_offset_s' else 3


_SPACE, _ATTITUDE = _Column('space_rad'), _Column('initial_attitude_rad')
_RATE = _Column('initial_angular_velocity_rad_s')


class _Fit:
    """The least-squares problem that `align` solves."""

    def __init__(self, motion: Motion, sensors: Sequence[Measured], names: Collection[str],
                 first: Sequence[Alignment], most: int | None) -> None:
        self._motion, self._sensors = motion, sensors
        self._value = [replace(one, start=motion.start) for one in first] \
            if isinstance(motion, Problem) and START in names else [*first]
        self._columns = _columns(sensors, names)
        #: A cache of the most recent motions, keyed by their start and stamps. The mountings are
        #: not part of the key, because a motion does not depend on how a sensor is mounted.
        self._kept: dict[bytes, States] = {}
        self._use([_thinned(self._inside(k), most) for k in range(len(sensors))])
        if not any(len(rows) for rows in self._rows):
            raise apart(motion, sensors)
        #: Standard deviations of the attitude and rate errors of each sensor.
        self._scales = np.ones((len(sensors), 2))

    def _use(self, rows: list[NDArray[np.intp]]) -> None:
        self._rows = rows
        self._samples = [sensor.rows(part) for sensor, part in zip(self._sensors, rows)]

    def _inside(self, k: int) -> NDArray[np.intp]:
        margin = 10_000_000 if _Column('clock_offset_s', k) in self._columns else 0
        stamps_ns = self._sensors[k].stamps_ns + round(1e9 * self._value[k].clock_offset_s)
        return np.flatnonzero(inside(self._motion, stamps_ns, margin))

    def grow(self) -> None:
        """
        Fit the start of the motion in stages.

        The first stage uses the first few samples. Each further stage also uses later samples.
        """
        every = self._rows
        since = [sensor.stamps_ns[rows] + round(1e9 * one.clock_offset_s)
                 - self._motion.start.time_ns
                 for sensor, rows, one in zip(self._sensors, every, self._value)]
        stamps_ns = np.concatenate(since)
        last = int(stamps_ns.max())
        horizon = int(np.partition(stamps_ns, min(15, len(stamps_ns) - 1))[:16].max())
        self._from_first_samples()
        while horizon < last:
            self._use([_thinned(rows[times <= horizon], _STAGE)
                       for rows, times in zip(every, since)])
            self._fit(1e-4, most=_EARLY)
            horizon = max(2 * horizon, 1)
        self._use(every)

    def _from_first_samples(self) -> None:
        # Take the start from the first measurements if this start fits the measurements better
        # than the start given in the scene.
        start = self._value[0].start
        assert start is not None
        every = self._rows
        self._use([part[:16] for part in every])
        for value, samples in zip(self._value, self._samples):
            aligned = value.applied(samples)
            if len(samples) < 4 or aligned.stamps_ns[0] - start.time_ns > 10 ** 9:
                continue
            attitude, rate = start.attitude, start.angular_velocity
            if aligned.angular_velocity is not None:
                rate = np.median(aligned.angular_velocity[:5], axis=0)
            elif aligned.attitude is not None:
                rate = measured_rates(aligned)[1][:5].mean(axis=0)
            if aligned.attitude is not None and _ATTITUDE in self._columns:
                late = 1e-9 * (aligned.stamps_ns[0] - start.time_ns)
                attitude = so3.multiply(aligned.attitude[0], so3.exp(-late * rate))
            found = State(start.time_ns, so3.normalize(attitude), rate, start.rotor_momentum)
            other = [replace(one, start=found) for one in self._value]
            if self._median(other) < self._median(self._value):
                self._value = other
        self._use(every)

    def _median(self, value: Sequence[Alignment]) -> float:
        return float(np.median(np.abs(self._residuals(value))))

    def solved(self) -> tuple[Alignment, ...]:
        """Return the fitted alignments with their standard deviations."""
        every = self._rows
        self._use([_thinned(rows, _PART) for rows in every])
        for _ in range(2):
            self._fit(_TOLERANCE)
            self._estimate_scales()
        self._use(every)
        kept = np.abs(self._residuals(self._value)) < _OUTLIER
        deviations = self._named(_deviations(self._fit(_TOLERANCE, kept)) * self._correlation())
        return tuple(replace(one, sigma={
            column.name: float(part[0]) if len(part) == 1 else part
            for column, part in deviations.items() if column.sensor in (-1, k)})
            for k, one in enumerate(self._value))

    def _named(self, values: Floats) -> dict[_Column, Floats]:
        """Split a vector of all parameters into one part for each fitted quantity."""
        ends = np.cumsum([column.size for column in self._columns])[:-1]
        return dict(zip(self._columns, np.split(values, ends)))

    def _correlation(self) -> float:
        """
        Return the factor by which correlated errors increase the standard deviations.

        Model errors persist over many samples, so the samples are not independent. If neighbouring
        samples have correlation r, then n samples carry only as much information as
        n (1 - r) / (1 + r) independent samples.
        """
        correlations = [0.0]
        for _, _, errors in self._blocks():
            clipped = np.clip(errors, -3.0, 3.0)
            products = np.sum(clipped[1:] * clipped[:-1], axis=0)
            squares = np.sum(clipped * clipped, axis=0)
            correlations += (products / np.maximum(squares, 1e-300)).tolist()
        neighbours = min(max(correlations), 0.9999)
        return float(np.sqrt((1.0 + neighbours) / (1.0 - neighbours)))

    def _estimate_scales(self) -> None:
        for sensor, quantity, errors in self._blocks():
            if len(errors):
                self._scales[sensor, quantity] *= 1.4826 * float(np.median(np.abs(errors)))
        self._scales = np.maximum(self._scales, 1e-13)

    def _blocks(self) -> Iterator[tuple[int, int, Floats]]:
        """
        Generate the residuals of each sensor and quantity.

        Yields
        ------
        tuple
            The index of the sensor; the quantity, which is 0 for the attitude and 1 for the
            angular velocity; and the residuals, shape (n, 3).

        """
        residuals, first = self._residuals(self._value), 0
        for number, sensor in enumerate(self._samples):
            for quantity, values in enumerate((sensor.attitude, sensor.angular_velocity)):
                if values is not None:
                    last = first + 3 * len(sensor)
                    yield number, quantity, residuals[first:last].reshape(-1, 3)
                    first = last

    def _fit(self, tolerance: float, kept: NDArray[np.bool_] | None = None,
             most: int = _MOST) -> Floats:
        """
        Improve the alignments, and return the Jacobian at the solution.

        If `kept` is given, only the residuals that it selects are fitted, with a quadratic loss.
        Otherwise, all residuals are fitted with a robust loss.
        """
        from scipy.optimize import least_squares  # slow to import
        base = self._value
        rows = slice(None) if kept is None else kept
        steps = np.concatenate([np.full(column.size, _CLOCK_STEP if column.size == 1 else _STEP)
                                for column in self._columns])

        def residuals(step: Floats) -> Floats:
            return np.asarray(self._residuals(self._moved(base, step))[rows])

        def jacobian(point: Floats) -> Floats:
            here = residuals(point)
            return np.stack([(residuals(point + change) - here) / step
                             for change, step in zip(np.diag(steps), steps)], axis=1)
        options = {'loss': 'linear'} if kept is not None else {'loss': 'huber', 'f_scale': _HUBER}
        result = least_squares(residuals, np.zeros(len(steps)), jacobian, max_nfev=most,
                               xtol=1e-12, ftol=tolerance, gtol=1e-15, x_scale='jac', **options)
        self._value = self._moved(base, result.x)
        return np.asarray(result.jac)

    def _moved(self, base: Sequence[Alignment], step: Floats) -> list[Alignment]:
        """Return the alignments in `base` after a small step in the fitted parameters."""
        changes, (first, *_) = self._named(step), base
        none, start, space = np.zeros(3), first.start, first.space
        if start is not None and _RATE in changes:
            turn = so3.exp(changes.get(_ATTITUDE, none))
            start = State(start.time_ns, so3.normalize(so3.multiply(start.attitude, turn)),
                          start.angular_velocity + changes[_RATE], start.rotor_momentum)
        if _SPACE in changes:
            space = so3.normalize(so3.multiply(so3.exp(changes[_SPACE]), space))
        result = []
        for k, one in enumerate(base):
            turn = so3.exp(changes.get(_Column('mount_rad', k), none))
            offset = float(changes.get(_Column('clock_offset_s', k), none)[0])
            result.append(Alignment(one.clock_offset_s + offset,
                                    so3.normalize(so3.multiply(one.mount, turn)), space, start))
        return result

    def _residuals(self, value: Sequence[Alignment]) -> Floats:
        """
        Return the errors of all samples of all sensors, divided by their standard deviations.

        The errors of a sensor are computed in the axes of this sensor, so that a change of the
        mounting does not rotate the noise. If the noise were rotated, the fit could seem to
        determine a direction about which the data says nothing.
        """
        interrupts.check()
        stamps_ns = np.concatenate([sensor.stamps_ns + round(1e9 * one.clock_offset_s)
                                    for sensor, one in zip(self._samples, value)])
        states, parts = divided(self._states(value[0].start, stamps_ns), self._samples), []
        for sensor, one, scales, part in zip(self._samples, value, self._scales, states):
            expected = one.expected(part)
            parts += [(error / scale).ravel()
                      for error, scale in zip(errors_of(sensor, expected), scales)
                      if error is not None]
        return np.concatenate(parts)

    def _states(self, start: State | None, stamps_ns: NDArray[np.int64]) -> States:
        key = stamps_ns.tobytes()
        moved = self._motion
        if start and isinstance(moved, Problem):
            moved = moved.replaced(start=start)
            key += start.attitude.tobytes() + start.angular_velocity.tobytes()
        if key not in self._kept:
            if len(self._kept) == _KEPT:
                del self._kept[next(iter(self._kept))]
            # A trial step can shift the clock so far that some stamps fall outside the motion.
            self._kept[key] = moved.propagate(at=np.clip(stamps_ns, *span_of(moved)))
        return self._kept[key]


def _columns(sensors: Sequence[Measured], names: Collection[str]) -> list[_Column]:
    """Return the fitted quantities, beginning with those that do not change the motion."""
    mounted = [k for k, sensor in enumerate(sensors) if is_asked(names, MOUNT, sensor.topic)]
    with_attitude = [k for k, sensor in enumerate(sensors) if sensor.attitude is not None]
    is_turned = bool({*mounted} & {*with_attitude})
    # To fit the mounting of an attitude sensor, we also fit a rotation of the space axes. Rotating
    # the space axes has the same effect as rotating the initial attitude, so the initial attitude
    # is not fitted as well.
    starts = [_RATE, *([_ATTITUDE] if with_attitude and not is_turned else [])]
    return [*(_Column('mount_rad', k) for k in mounted), *([_SPACE] if is_turned else []),
            *(_Column('clock_offset_s', k) for k, sensor in enumerate(sensors)
              if is_asked(names, CLOCK, sensor.topic)), *(starts if START in names else [])]


def errors_of(sensor: Measured, states: States) -> tuple[Floats | None, Floats | None]:
    """
    Return how far the measurements of a sensor are from a motion at the same times.

    Returns
    -------
    rotation_vectors : array, shape (n, 3), optional
        Rotation from the computed to the measured attitude, rad, body axes.
    rate_errors : array, shape (n, 3), optional
        Measured minus computed angular velocity, rad/s, body axes.

    """
    rotation = rate = None
    if sensor.attitude is not None:
        rotation = so3.log(so3.multiply(so3.conjugate(states.attitude), sensor.attitude))
    if sensor.angular_velocity is not None:
        rate = sensor.angular_velocity - states.angular_velocity
    return rotation, rate


def apart(motion: Motion, sensors: Sequence[Measured]) -> InputError:
    """Return the error to raise if the measurements and the motion do not overlap in time."""
    stamps_ns = sensors[0].stamps_ns
    return InputError(f'{sensors[0].topic}: expected measurements during the motion, which begins '
                      f'at {motion.start.time_ns} ns, found them from {stamps_ns[0]} ns to '
                      f'{stamps_ns[-1]} ns; are the clocks the same (--time-source log)?')


def _thinned(rows: NDArray[np.intp], most: int | None) -> NDArray[np.intp]:
    return rows if most is None else rows[::-(-len(rows) // most) or 1]


def _deviations(jacobian: Floats) -> Floats:
    """Return the standard deviations of the parameters, with infinity for undetermined ones."""
    norms = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(norms > 0.0, norms, 1.0)
    # The factor R of a QR decomposition has the same singular values as the Jacobian, but far
    # fewer rows.
    _, singular, turn = np.linalg.svd(np.linalg.qr(scaled, mode='r'), full_matrices=False)
    small = singular < _SINGULAR * singular.max(initial=1e-300)
    variances = np.sum((turn / np.where(small, 1.0, singular)[:, None]) ** 2, axis=0)
    lost = (np.abs(turn[small]) > 1e-3).any(axis=0) | (norms == 0.0)
    return np.where(lost, np.inf, np.sqrt(variances) / np.where(norms > 0.0, norms, 1.0))
