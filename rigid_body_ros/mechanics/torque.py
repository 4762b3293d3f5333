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

"""Torque logs: recorded samples, and how to interpolate between them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instants, NEVER_NS
from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import internal, njit

FRAMES = ('body', 'space')
INTERPOLATIONS = ('hold', 'linear', 'cubic')
#: Number of samples that determine a slope of the cubic interpolation.
_NEAREST = 5
#: Number of samples before and after a span of time that its cubics depend on.
_MARGIN = 4


class TorqueLog:
    """
    A torque as a function of time, given by stamped samples.

    Before the first sample the torque is zero. After the last one it is held.

    Parameters
    ----------
    times_ns : array of int, shape (n,), ns
        In any order. Of samples with equal stamps, only the last one in the arrays is used.
    torques : array, shape (n, 3), N m
        About the centre of mass.
    frame : str, sequence of n str, or array of bool, shape (n,)
        The axes of the components: 'body' or 'space', for all samples or for each. An array of
        bool states for each sample whether it is in space axes.
    interpolation : str
        'hold' (zero order), 'linear', or 'cubic': piecewise Hermite polynomials whose slopes
        come from the five nearest samples, of any spacing (fourth order).

    Attributes
    ----------
    times_ns : array of int64, shape (n,), ns
        Strictly ascending.
    torques : array, shape (n, 3), N m
    in_space : array of bool, shape (n,)
        Whether each torque is in space axes.
    interpolation : str

    Raises
    ------
    ValueError
        The shapes do not match, a time is not an integer that fits int64, the times span 292
        years or more, a torque is not finite, a name is unknown, or samples in different frames
        are to be interpolated.

    """

    def __init__(self, times_ns: ArrayLike, torques: ArrayLike,
                 frame: str | Sequence[str] | NDArray[np.bool_] = 'body',
                 interpolation: str = 'hold') -> None:
        times, values = _checked_samples(times_ns, torques)
        in_space = _checked_frames(frame, len(times))
        if interpolation not in INTERPOLATIONS:
            raise ValueError(f'interpolation: expected one of {", ".join(INTERPOLATIONS)}, '
                             f'found {interpolation!r}')
        if interpolation != 'hold' and np.unique(in_space).size > 1:
            raise ValueError(f'interpolation {interpolation}: expected torques in one frame, '
                             'found torques in body axes and in space axes')
        if not np.all(times[1:] > times[:-1]):
            order = np.argsort(times, kind='stable')
            chosen = order[np.append(np.diff(times[order]) != 0, True)]
            times, values, in_space = times[chosen], values[chosen], in_space[chosen]
        self.times_ns: NDArray[np.int64] = times
        self.torques: Floats = values
        self.in_space: NDArray[np.bool_] = in_space
        self.interpolation = interpolation
        for array in (self.times_ns, self.torques, self.in_space):
            array.flags.writeable = False

    @classmethod
    def from_momentum(cls, times_ns: ArrayLike, momenta: ArrayLike) -> TorqueLog:
        """
        Return the torque on rotors from their measured momentum.

        Under this torque the momentum follows a straight line from each sample to the next, and
        stays at the last one. Rounding errors do not accumulate. For the momentum of a motion to
        be the measured one, `State.rotor_momentum` must be that at the start: before the first
        sample the torque is zero.

        Parameters
        ----------
        times_ns : array of int, shape (n,), ns
            As for `TorqueLog`.
        momenta : array, shape (n, 3), N m s, body axes
            Angular momentum of the rotors relative to the body.

        Returns
        -------
        TorqueLog
            Held torques of the motors on the rotors, body axes.

        Raises
        ------
        ValueError
            As for `TorqueLog`, or the momentum changes so fast that the torque overflows.

        """
        measured = cls(*_checked_samples(times_ns, momenta, 'momentum', 'momenta'))
        times, values = measured.times_ns, measured.torques
        slopes = _slopes(times, values)
        if not np.isfinite(slopes).all():
            row = int(np.flatnonzero(~np.isfinite(slopes).all(axis=1))[0])
            raise ValueError(f'momentum {row} at {times[row]} ns: expected a finite torque up to '
                             f'the next sample, found a change from {values[row].tolist()} to '
                             f'{values[row + 1].tolist()} N m s in {times[row + 1] - times[row]} '
                             'ns')
        return measured.with_torques(slopes)

    @classmethod
    def constant(cls, torque: ArrayLike, begin_ns: int, end_ns: int, timeout_ns: int = 0
                 ) -> TorqueLog:
        """
        Return a constant torque, body axes, that does not time out.

        Parameters
        ----------
        torque : array, shape (3,), N m
            About the centre of mass.
        begin_ns, end_ns : int
            The torque acts from the first of these times on, at least up to the second.
        timeout_ns : int
            As for `segments`.

        """
        times = np.array([begin_ns])
        if timeout_ns:
            times = np.arange(begin_ns, end_ns + 1, max(1, timeout_ns // 2))
        return cls(times, np.broadcast_to(torque, (len(times), 3)))

    def __len__(self) -> int:
        return len(self.times_ns)

    def __repr__(self) -> str:
        if not len(self):
            return 'TorqueLog(no samples)'
        seconds = (int(self.times_ns[-1]) - int(self.times_ns[0])) / 1e9
        axes = 'space' if self.in_space.all() else 'mixed' if self.in_space.any() else 'body'
        largest = np.linalg.norm(self.torques, axis=1).max()
        samples = '1 sample' if len(self) == 1 else f'{len(self)} samples'
        return (f'TorqueLog({samples} over {seconds:g} s, {axes} axes, '
                f'{self.interpolation}, up to {largest:.3g} N m)')

    def with_torques(self, torques: ArrayLike) -> TorqueLog:
        """
        Return a log with other torques at the same times.

        Parameters
        ----------
        torques : array, shape (n, 3), N m
            In the same axes.

        Raises
        ------
        ValueError
            The shape does not match, or a torque is not finite.

        """
        return TorqueLog(self.times_ns, torques, self.in_space, self.interpolation)

    def rows(self, chosen: slice | NDArray[np.intp]) -> TorqueLog:
        """Return a log of some of the samples, chosen by a slice or an array of indices."""
        return TorqueLog(self.times_ns[chosen], self.torques[chosen], self.in_space[chosen],
                         self.interpolation)

    def between(self, begin_ns: int, end_ns: int) -> TorqueLog:
        """Return a log of the samples that determine the torque between two times, ns."""
        first = max(int(np.searchsorted(self.times_ns, begin_ns, 'right')) - _MARGIN, 0)
        return self.rows(slice(
            first, int(np.searchsorted(self.times_ns, end_ns, 'right')) + _MARGIN))

    def segments(self, timeout_ns: int = 0) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """
        Return the times at which a sample comes into force or times out.

        Parameters
        ----------
        timeout_ns : int
            If positive, the torque is zero from this long after a sample until the next one.

        Returns
        -------
        starts_ns : array of int64, shape (m,), ns
        samples : array of int, shape (m,)
            Index of the sample in force from each time on, or -1 after a timeout.

        """
        samples = np.arange(len(self))
        if timeout_ns <= 0 or not len(self):
            return self.times_ns, samples
        silent = self.silent(timeout_ns)
        return (np.insert(self.times_ns, silent + 1, self.times_ns[silent] + timeout_ns),
                np.insert(samples, silent + 1, -1))

    def silent(self, timeout_ns: int) -> NDArray[np.intp]:
        """Return the samples that time out before the next one, as indices."""
        return np.flatnonzero(np.append(np.diff(self.times_ns) > timeout_ns, True))

    def polynomials(self, first: int, stop: int) -> Floats:
        """
        Return the polynomials between samples.

        Parameters
        ----------
        first, stop : int
            The first sample, and the one after the last.

        Returns
        -------
        array, shape (stop - first, 2 degree + 1, 3), N m
            A row has the degree + 1 coefficients of a polynomial in the fraction of the time to
            the next sample, then the low-order parts of all coefficients but the first, which is
            the sample itself.

        """
        here = self.torques[first:stop]
        if self.interpolation == 'hold':
            return here[:, None, :]
        if self.interpolation == 'linear':
            following = self.torques[first + 1:stop + 1]
            following = np.concatenate([following, here[len(following):]])
            slope = following - here
            rounded = slope - following
            low = (following - (slope - rounded)) - (here + rounded)  # Knuth's exact sum
            return np.stack([here, slope, low], axis=1)
        return _hermite(self.times_ns, self.torques, first, stop)

    def at(self, times_ns: ArrayLike, timeout_ns: int = 0) -> tuple[Floats, NDArray[np.bool_]]:
        """
        Return the torque at given times; at a jump, the value after it.

        Parameters
        ----------
        times_ns : array of int, shape (m,), ns
            In any order. Before the first sample the torque is zero.
        timeout_ns : int
            As for `segments`.

        Returns
        -------
        torques : array, shape (m, 3), N m
        in_space : array of bool, shape (m,)
            Whether each torque is in space axes.

        Raises
        ------
        ValueError
            A time is not an integer that fits int64.

        """
        times = instants(times_ns)
        torques, in_space = np.zeros((times.size, 3)), np.zeros(times.size, np.bool_)
        samples = np.searchsorted(self.times_ns, times, 'right') - 1
        given = samples >= 0
        if timeout_ns > 0 and len(self):
            given &= times - self.times_ns[samples] < timeout_ns
        if not given.any():
            return torques, in_space
        samples, times = samples[given], times[given]
        first, stop = int(samples.min()), int(samples.max()) + 1
        stamps = self.times_ns[first:stop + 1]
        spans = np.append(np.diff(stamps), 10 ** 9)[samples - first]
        fraction = ((times - self.times_ns[samples]) / spans)[:, None]
        coefficients = self.polynomials(first, stop)[samples - first]
        degree = coefficients.shape[1] // 2
        value = coefficients[:, degree]
        for k in range(degree - 1, -1, -1):
            value = coefficients[:, k] + fraction * value
        torques[given], in_space[given] = value, self.in_space[samples]
        return torques, in_space


def _checked_samples(times_ns: ArrayLike, samples: ArrayLike, name: str = 'torque',
                     plural: str = 'torques') -> tuple[NDArray[np.int64], Floats]:
    times = instants(times_ns)
    if times.size and int(times.max()) - int(times.min()) >= NEVER_NS:
        raise ValueError('times_ns: expected times within 292 years of each other, '
                         f'found {times.min()} ns and {times.max()} ns')
    values = np.array(samples, float).reshape(-1, 3) if np.size(samples) == 0 \
        else np.array(samples, float, order='C')
    if values.shape != (times.size, 3):
        raise ValueError(f'{plural}: expected shape ({times.size}, 3), found {values.shape}')
    if not np.isfinite(values).all():  # row by row this takes ten times as long
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        raise ValueError(f'{name} {bad[0]} at {times[bad[0]]} ns: expected finite numbers, '
                         f'found {values[bad[0]].tolist()}')
    return times, values


def _checked_frames(frame: str | Sequence[str] | NDArray[np.bool_],
                    count: int) -> NDArray[np.bool_]:
    names = np.asarray(frame)
    if names.shape not in ((), (count,)):
        raise ValueError(f'frame: expected one name or {count}, found {names.size}')
    if names.shape and names.dtype == np.bool_:
        return names.copy()
    names = names.astype(str)
    unknown = names[~np.isin(names, FRAMES)]
    if unknown.size:
        raise ValueError(f"frame: expected 'body' or 'space', found {str(unknown[0])!r}")
    return np.array(np.broadcast_to(names == 'space', count))


@njit
def _slopes(times_ns: NDArray[np.int64], values: Floats) -> Floats:
    # Return the slopes, 1/s, of straight lines through the samples, and zero for the last. Each
    # one leads from where the rounded slopes before it end, not from the sample there.
    result = np.zeros(values.shape)
    for axis in range(3 if len(values) else 0):
        reached = values[0, axis], 0.0
        for k in range(len(values) - 1):
            span = dd.seconds(times_ns[k + 1] - times_ns[k])
            rest = dd.subtract((values[k + 1, axis], 0.0), reached)
            result[k, axis] = dd.divide(rest, span)[0]
            reached = dd.add(reached, dd.multiply((result[k, axis], 0.0), span))
    return result


@njit
def _hermite(times_ns: NDArray[np.int64], values: Floats, first: int, stop: int) -> Floats:
    # Return cubics through the samples. At each sample, the slope is that of the polynomial
    # through the nearest samples. The low-order parts matter for a thin rod, where torques may
    # cancel.
    last = len(times_ns) - 1
    count = min(_NEAREST, last + 1)
    result = np.empty((stop - first, 7, 3))
    weights, spacing = np.zeros((_NEAREST, 2)), np.zeros(_NEAREST, np.int64)
    start, end = np.zeros((3, 2)), np.zeros((3, 2))
    for node in range(first, stop + 1):
        start, end = end, start
        at = min(node, last)
        begin = min(max(at - count // 2, 0), last + 1 - count)
        _update_weights(times_ns, at, begin, count, weights, spacing)
        for axis in range(3):
            slope = (0.0, 0.0)
            for k in range(count):
                delta = dd.two_sum(values[begin + k, axis], -values[at, axis])
                slope = dd.add(slope, dd.multiply((weights[k, 0], weights[k, 1]), delta))
            end[axis, 0], end[axis, 1] = slope
            if node > first:
                _store_cubic(result[node - 1 - first, :, axis], values[node - 1, axis],
                             values[at, axis], dd.from_int(times_ns[at] - times_ns[node - 1]),
                             (start[axis, 0], start[axis, 1]), slope)
    return result


@internal
def _update_weights(times_ns: NDArray[np.int64], node: int, begin: int, count: int,
                    weights: Floats, spacing: NDArray[np.int64]) -> None:
    # Update the weights, 1/ns, with which the differences between the samples and a node add up to
    # the slope at the node: the derivatives of the Lagrange polynomials there. They depend on the
    # spacing only, and stay if it does.
    same = True
    for k in range(count):
        span = times_ns[begin + k] - times_ns[node]
        same = same and span == spacing[k]
        spacing[k] = span
    if same:
        return
    for k in range(count):
        above, below = (1.0, 0.0), dd.from_int(spacing[k])
        for m in range(count):
            if spacing[m] != 0 and m != k:
                above = dd.multiply(above, dd.from_int(-spacing[m]))
                below = dd.multiply(below, dd.from_int(spacing[k] - spacing[m]))
        weights[k, 0], weights[k, 1] = dd.divide(above, below) if spacing[k] != 0 else (0.0, 0.0)


@internal
def _store_cubic(row: Floats, here: float, following: float, span: DoubleDouble,
                 start: DoubleDouble, end: DoubleDouble) -> None:
    # Store the coefficients on one axis, from the values and the slopes, 1/ns, at both ends.
    delta = dd.two_sum(following, -here)
    start, end = dd.multiply(start, span), dd.multiply(end, span)
    curved = dd.subtract(delta, start)
    third = dd.subtract(dd.subtract(end, delta), curved)
    second = dd.subtract(curved, third)
    row[0], row[1], row[2], row[3] = here, start[0], second[0], third[0]
    row[4], row[5], row[6] = start[1], second[1], third[1]


def torque_logs(log: TorqueLog | Sequence[TorqueLog] | None) -> list[TorqueLog]:
    """Return one log, several or none as a list."""
    return [log] if isinstance(log, TorqueLog) else [*(log or ())]


def stamps_of(logs: Iterable[TorqueLog]) -> NDArray[np.int64]:
    """Return the stamps of logs, ns, in ascending order, each once."""
    return np.unique(np.concatenate([np.empty(0, np.int64), *(log.times_ns for log in logs)]))
