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

"""Bring a measurement and a motion into the same time, frames and start."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.comparison import coarse
from rigid_body_ros.comparison.alignment import Alignment
from rigid_body_ros.comparison.motion import divided, inside, Motion, Recorded, span_of, States
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.sensing.measured import Measured
from rigid_body_ros.sensing.rates import measured_rates

START, CLOCK, MOUNT = 'start', 'clock', 'mount'
#: What can be fitted.
ALIGNMENTS = (START, CLOCK, MOUNT)
#: Half steps of the differences for the Jacobian: rad and rad/s, and s of the clock.
_STEP, _CLOCK_STEP = 1e-6, 1e-5
#: Largest number of samples in the first stages of a fit of the start, and of steps of a fit.
_STAGE, _MOST = 1000, 20
#: Largest number of samples of a sensor in all but the last fit.
_PART = 10_000
#: Residuals, in standard deviations, from which on the loss grows linearly, or a sample is left
#: out of the last stage.
_HUBER, _OUTLIER = 2.0, 5.0
#: Number of motions that are kept: at a clock offset, and half a step before and after it.
_KEPT = 3
#: Singular value, relative to the largest, below which the data does not determine a direction.
_SINGULAR = 1e-7


def align(motion: Motion, sensors: Sequence[Measured],
          names: Collection[str], most: int | None = None) -> Alignment:
    """
    Fit what is asked for by robust least squares.

    Parameters
    ----------
    motion : Problem or Recorded
        What they are aligned with.
    sensors : sequence of Measured
        All share one clock and one mounting.
    names : collection of str
        Some of `ALIGNMENTS`.
    most : int, optional
        Fit only this many samples of each sensor, evenly spread.

    Returns
    -------
    Alignment

    Raises
    ------
    InputError
        A name is unknown, or too few samples lie within the motion.

    """
    for name in names:
        if name not in ALIGNMENTS:
            raise InputError(f'align: expected some of {", ".join(ALIGNMENTS)}, found {name!r}')
    if START in names and isinstance(motion, Recorded):
        raise InputError('align: expected no start, because a recorded motion has its own, '
                         'found start')
    if not names:
        return Alignment()
    guess = coarse.guess(motion, sensors, CLOCK in names, MOUNT in names)
    fit = _Fit(motion, sensors, names, Alignment(*guess), most)
    if START in names:
        fit.grow()
    return fit.solved()


class _Fit:
    """The least squares problem of an alignment."""

    def __init__(self, motion: Motion, sensors: Sequence[Measured],
                 names: Collection[str], first: Alignment, most: int | None) -> None:
        self._motion, self._sensors = motion, sensors
        self._value = replace(first, start=motion.start) \
            if isinstance(motion, Problem) and START in names else first
        has_attitude = any(sensor.attitude is not None for sensor in sensors)
        #: The fitted values, three columns each but the clock.
        self._names = [
            *(['initial_angular_velocity_rad_s'] if START in names else []),
            # With a mounting, the rotation of the space axes takes the place of the attitude.
            *(['initial_attitude_rad'] if START in names and has_attitude and MOUNT not in names
              else []),
            *(['clock_offset_s'] if CLOCK in names else []),
            *(['mount_rad'] if MOUNT in names else []),
            *(['space_rad'] if MOUNT in names and has_attitude else [])]
        self._sizes = [1 if name == 'clock_offset_s' else 3 for name in self._names]
        self._rows = [_thinned(self._inside(sensor), most) for sensor in sensors]
        if not any(len(rows) for rows in self._rows):
            raise apart(motion, sensors)
        #: Standard deviations of attitude and rate of each sensor.
        self._scales = np.ones((len(sensors), 2))
        #: The latest motions, by start and stamps; a mounting does not change them.
        self._kept: dict[bytes, States] = {}

    def _inside(self, sensor: Measured) -> NDArray[np.intp]:
        margin = 10_000_000 if 'clock_offset_s' in self._names else 0
        stamps_ns = sensor.stamps_ns + round(1e9 * self._value.clock_offset_s)
        return np.flatnonzero(inside(self._motion, stamps_ns, margin))

    def grow(self) -> None:
        """Fit the start to longer and longer beginnings of the measurement."""
        every, first_ns = self._rows, self._motion.start.time_ns
        stamps_ns = np.concatenate([sensor.stamps_ns[rows] for sensor, rows
                                    in zip(self._sensors, every)]) - first_ns
        stamps_ns += round(1e9 * self._value.clock_offset_s)
        last = int(stamps_ns.max())
        horizon = int(np.partition(stamps_ns, min(15, len(stamps_ns) - 1))[:16].max())
        self._from_first_samples()
        while horizon < last:
            self._rows = [_thinned(rows[sensor.stamps_ns[rows] - first_ns <= horizon], _STAGE)
                          for sensor, rows in zip(self._sensors, every)]
            self._fit(1e-5)
            horizon = max(2 * horizon, 1)
        self._rows = every

    def _from_first_samples(self) -> None:
        # Start as measured, unless the start of the scene is closer to the first samples.
        start = self._value.start
        assert start is not None
        for sensor, rows in zip(self._sensors, self._rows):
            aligned = self._value.applied(sensor.rows(rows[:16]))
            if len(rows) < 4 or aligned.stamps_ns[0] - start.time_ns > 10 ** 9:
                continue
            attitude, rate = start.attitude, start.angular_velocity
            if aligned.angular_velocity is not None:
                rate = np.median(aligned.angular_velocity[:5], axis=0)
            elif aligned.attitude is not None:
                rate = measured_rates(aligned)[1][:5].mean(axis=0)
            if aligned.attitude is not None and 'initial_attitude_rad' in self._names:
                late = 1e-9 * (aligned.stamps_ns[0] - start.time_ns)
                attitude = so3.multiply(aligned.attitude[0], so3.exp(-late * rate))
            other = replace(self._value, start=State(
                start.time_ns, so3.normalize(attitude), rate, start.rotor_momentum))
            every, self._rows = self._rows, [part[:16] for part in self._rows]
            if self._median(other) < self._median(self._value):
                self._value = other
            self._rows = every

    def _median(self, value: Alignment) -> float:
        return float(np.median(np.abs(self._residuals(value))))

    def solved(self) -> Alignment:
        """Return the fit, with its standard deviations."""
        every = self._rows
        self._rows = [_thinned(rows, _PART) for rows in every]
        for tolerance in (1e-8, 1e-12):
            self._fit(tolerance)
            self._estimate_scales()
        self._rows = every
        kept = np.abs(self._residuals(self._value)) < _OUTLIER
        deviations = self._named(_deviations(self._fit(1e-12, kept)) * self._correlation())
        return replace(self._value, sigma={
            name: float(part[0]) if len(part) == 1 else part for name, part in deviations.items()})

    def _named(self, values: Floats) -> dict[str, Floats]:
        """Return the columns by name."""
        return dict(zip(self._names, np.split(values, np.cumsum(self._sizes)[:-1])))

    def _correlation(self) -> float:
        """
        Return by how much errors that are not white enlarge the standard deviations.

        Errors of the model last for many samples. With the correlation r of neighbours, n samples
        count as n (1 - r) / (1 + r).
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
        """Generate the residuals of attitudes (0) and rates (1) of each sensor, shape (n, 3)."""
        residuals, first = self._residuals(self._value), 0
        for number, (sensor, rows) in enumerate(zip(self._sensors, self._rows)):
            for quantity, values in enumerate((sensor.attitude, sensor.angular_velocity)):
                if values is not None:
                    last = first + 3 * len(rows)
                    yield number, quantity, residuals[first:last].reshape(-1, 3)
                    first = last

    def _fit(self, tolerance: float, kept: NDArray[np.bool_] | None = None) -> Floats:
        """Improve the value; without chosen rows, by a robust loss. Return the Jacobian."""
        from scipy.optimize import least_squares  # takes as long to import as the engine
        base, count = self._value, sum(self._sizes)
        rows = slice(None) if kept is None else kept
        halves = [_CLOCK_STEP if name == 'clock_offset_s' else _STEP
                  for name, size in zip(self._names, self._sizes) for _ in range(size)]

        def residuals(step: Floats) -> Floats:
            return np.asarray(self._residuals(self._moved(base, step))[rows])

        def jacobian(step: Floats) -> Floats:
            columns = []
            for change, half in zip(np.diag(halves), halves):
                columns.append((residuals(step + change) - residuals(step - change))
                               / (2.0 * half))
            return np.stack(columns, axis=1)
        options = {'loss': 'linear'} if kept is not None else {'loss': 'huber', 'f_scale': _HUBER}
        result = least_squares(residuals, np.zeros(count), jacobian, max_nfev=_MOST,
                               xtol=tolerance, ftol=tolerance, gtol=tolerance, x_scale='jac',
                               **options)
        self._value = self._moved(base, result.x)
        return np.asarray(result.jac)

    def _moved(self, base: Alignment, step: Floats) -> Alignment:
        """Return an alignment with small changes."""
        changes, start = self._named(step), base.start
        rate = changes.get('initial_angular_velocity_rad_s')
        if start is not None and rate is not None:
            turn = so3.exp(changes.get('initial_attitude_rad', np.zeros(3)))
            start = State(start.time_ns, so3.normalize(so3.multiply(start.attitude, turn)),
                          start.angular_velocity + rate, start.rotor_momentum)
        mount, space = base.mount, base.space
        if 'mount_rad' in changes:
            mount = so3.normalize(so3.multiply(mount, so3.exp(changes['mount_rad'])))
        if 'space_rad' in changes:
            space = so3.normalize(so3.multiply(so3.exp(changes['space_rad']), space))
        offset = base.clock_offset_s + float(changes.get('clock_offset_s', np.zeros(1))[0])
        return Alignment(offset, mount, space, start)

    def _residuals(self, value: Alignment) -> Floats:
        """Return the errors in standard deviations, of all samples of all sensors."""
        interrupts.check()
        aligned = [value.applied(sensor.rows(rows))
                   for sensor, rows in zip(self._sensors, self._rows)]
        stamps_ns = np.concatenate([sensor.stamps_ns for sensor in aligned])
        to_sensor, parts = so3.conjugate(value.mount), []
        states = divided(self._states(value.start, stamps_ns), aligned)
        for sensor, scales, part in zip(aligned, self._scales, states):
            # In the axes of the sensor: there, what a mounting cannot change does not turn the
            # noise either, and an undetermined direction shows as exactly that.
            parts += [(so3.rotate(to_sensor, error) / scale).ravel()
                      for error, scale in zip(errors_of(sensor, part), scales)
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
            # A step of the clock may lead out of the motion, unless the offset is nearly right.
            self._kept[key] = moved.propagate(at=np.clip(stamps_ns, *span_of(moved)))
        return self._kept[key]


def errors_of(sensor: Measured, states: States) -> tuple[Floats | None, Floats | None]:
    """
    Return what a sensor measured relative to a motion at the same times.

    Returns
    -------
    rotation_vectors : array, shape (n, 3), optional
        From the attitude of the motion to the measured one, rad, body axes.
    rate_errors : array, shape (n, 3), optional
        Measured angular velocity minus that of the motion, rad/s, body axes.

    """
    rotation = rate = None
    if sensor.attitude is not None:
        rotation = so3.log(so3.multiply(so3.conjugate(states.attitude), sensor.attitude))
    if sensor.angular_velocity is not None:
        rate = sensor.angular_velocity - states.angular_velocity
    return rotation, rate


def apart(motion: Motion, sensors: Sequence[Measured]) -> InputError:
    """Return the error that measurements and motion do not overlap in time."""
    stamps_ns = sensors[0].stamps_ns
    return InputError(f'{sensors[0].topic}: expected measurements during the motion, which begins '
                      f'at {motion.start.time_ns} ns, found them from {stamps_ns[0]} ns to '
                      f'{stamps_ns[-1]} ns; are the clocks the same (--time-source log)?')


def _thinned(rows: NDArray[np.intp], most: int | None) -> NDArray[np.intp]:
    return rows if most is None else rows[::-(-len(rows) // most) or 1]


def _deviations(jacobian: Floats) -> Floats:
    """Return standard deviations; infinite for what the rows do not determine."""
    norms = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(norms > 0.0, norms, 1.0)
    # The factor R has the singular values of the whole matrix, and is as small as the problem.
    _, singular, turn = np.linalg.svd(np.linalg.qr(scaled, mode='r'), full_matrices=False)
    small = singular < _SINGULAR * singular.max(initial=1e-300)
    variances = np.sum((turn / np.where(small, 1.0, singular)[:, None]) ** 2, axis=0)
    lost = (np.abs(turn[small]) > 1e-3).any(axis=0) | (norms == 0.0)
    return np.where(lost, np.inf, np.sqrt(variances) / np.where(norms > 0.0, norms, 1.0))
