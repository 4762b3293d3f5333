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
from rigid_body_ros.engine import interpolation, kernels

FRAMES = ('body', 'space')
INTERPOLATIONS = ('hold', 'linear', 'cubic')
#: In cubic interpolation, the torque within a span of time depends on up to this many samples
#: before the span, and on up to this many samples after the span.
_MARGIN = 4


class TorqueLog:
    """
    A torque as a function of time, given by stamped samples.

    Before the first sample the torque is zero. After the last sample, the last torque is held.

    Parameters
    ----------
    times_ns : array of int, shape (n,), ns
        The stamps, in any order. If several samples have the same stamp, only the last one in the
        arrays is used.
    torques : array, shape (n, 3), N m
        The torques about the centre of mass.
    frame : str, sequence of n str, or array of bool, shape (n,)
        The axes in which the torques are given: 'body' or 'space', as one name for all samples or
        one name for each sample. An array of bool is accepted, too, and is True for each sample in
        space axes.
    interpolation : str
        'hold' (zero order), 'linear' or 'cubic' (piecewise Hermite polynomials, accurate to
        fourth order). The slopes of the cubics come from the five nearest samples, which need not
        be evenly spaced.

    Attributes
    ----------
    times_ns : array of int64, shape (n,), ns
        The stamps, strictly ascending.
    torques : array, shape (n, 3), N m
    in_space : array of bool, shape (n,)
        Whether each torque is in space axes.
    interpolation : str

    Raises
    ------
    ValueError
        The shapes do not match, a time is not an integer that fits in int64, the times span 292
        years or more, a torque is not finite, a frame or an interpolation is unknown, or linear or
        cubic interpolation is requested for samples in different frames.

    """

    def __init__(self, times_ns: ArrayLike, torques: ArrayLike,
                 frame: str | Sequence[str] | NDArray[np.bool_] = 'body',
                 interpolation: str = 'hold') -> None:
        times, values = _checked_samples(times_ns, torques)
        in_space = _checked_frames(frame, len(times))
        if interpolation not in INTERPOLATIONS:
            raise ValueError(f'interpolation: expected one of {", ".join(INTERPOLATIONS)}, '
                             f'found {interpolation!r}')
        if interpolation != 'hold' and in_space.any() and not in_space.all():
            raise ValueError(f'interpolation {interpolation}: expected torques in one frame, '
                             'found torques in body axes and in space axes')
        if np.count_nonzero(times[1:] > times[:-1]) < len(times) - 1:
            order = np.argsort(times, kind='stable')
            chosen = order[np.append(np.diff(times[order]) != 0, True)]
            times, values, in_space = times[chosen], values[chosen], in_space[chosen]
        if len(times) > 1 and times.item(-1) - times.item(0) >= NEVER_NS:
            raise ValueError('times_ns: expected times within 292 years of each other, '
                             f'found {times[0]} ns and {times[-1]} ns')
        self.times_ns: NDArray[np.int64] = times
        self.torques: Floats = values
        self.in_space: NDArray[np.bool_] = in_space
        self.interpolation = interpolation
        for array in (times, values, in_space):
            array.setflags(write=False)

    @classmethod
    def from_momentum(cls, times_ns: ArrayLike, momenta: ArrayLike) -> TorqueLog:
        """
        Compute the motor torque on rotors from their measured momentum.

        Under this torque, the momentum of the rotors changes linearly from each sample to the
        next, and stays constant after the last sample. Rounding errors do not accumulate. The
        torque is zero before the first sample, so the rotors follow the measured momentum only if
        the `rotor_momentum` of the start state is the momentum measured at the start.

        Parameters
        ----------
        times_ns : array of int, shape (n,), ns
            As for `TorqueLog`.
        momenta : array, shape (n, 3), N m s, body axes
            The angular momentum of the rotors relative to the body.

        Returns
        -------
        TorqueLog
            The motor torques on the rotors in body axes, held between samples.

        Raises
        ------
        ValueError
            `TorqueLog` does not accept the samples, or the momentum changes so fast that the
            torque overflows.

        """
        measured = cls(*_checked_samples(times_ns, momenta, 'momentum', 'momenta'))
        times, values = measured.times_ns, measured.torques
        torques = np.zeros(values.shape)
        kernels.fill_slopes(times, values, torques)
        if not np.isfinite(torques).all():
            row = int(np.flatnonzero(~np.isfinite(torques).all(axis=1))[0])
            raise ValueError(f'momentum {row} at {times[row]} ns: expected a finite torque up to '
                             f'the next sample, found a change from {values[row].tolist()} to '
                             f'{values[row + 1].tolist()} N m s in {times[row + 1] - times[row]} '
                             'ns')
        return measured.with_torques(torques)

    @classmethod
    def constant(cls, torque: ArrayLike, begin_ns: int, end_ns: int, timeout_ns: int = 0
                 ) -> TorqueLog:
        """
        Return a log of a torque that is constant in body axes and does not time out.

        Parameters
        ----------
        torque : array, shape (3,), N m
            The torque about the centre of mass.
        begin_ns, end_ns : int
            The torque begins at `begin_ns` and lasts at least until `end_ns`.
        timeout_ns : int
            If positive, the log repeats the sample often enough that a timeout of this length does
            not end the torque before `end_ns`.

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
        Return a log with different torques at the same times.

        Parameters
        ----------
        torques : array, shape (n, 3), N m
            The new torques, one for each of the n samples of this log, in the same axes.

        Returns
        -------
        TorqueLog

        Raises
        ------
        ValueError
            The array does not have one row of three numbers for each sample.
            A torque is not finite.

        """
        return TorqueLog(self.times_ns, torques, self.in_space, self.interpolation)

    def rows(self, chosen: slice | NDArray[np.intp]) -> TorqueLog:
        """Return a log of the samples selected by a slice or by an array of indices."""
        return TorqueLog(self.times_ns[chosen], self.torques[chosen], self.in_space[chosen],
                         self.interpolation)

    def between(self, begin_ns: int, end_ns: int) -> TorqueLog:
        """Return a log of the samples that determine the torque between two times, ns."""
        first = max(int(np.searchsorted(self.times_ns, begin_ns, 'right')) - _MARGIN, 0)
        return self.rows(slice(
            first, int(np.searchsorted(self.times_ns, end_ns, 'right')) + _MARGIN))

    def segments(self, timeout_ns: int = 0) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """
        Return the times at which samples take effect or time out, with the index of each sample.

        Parameters
        ----------
        timeout_ns : int
            If positive, a sample acts for at most this long. After this time, the torque is zero
            until the next sample.

        Returns
        -------
        starts_ns : array of int64, shape (m,), ns
        samples : array of int, shape (m,)
            The index of the sample that takes effect at each time in `starts_ns`, or -1 for a
            timeout.

        """
        samples = np.arange(len(self))
        if timeout_ns <= 0 or not len(self):
            return self.times_ns, samples
        silent = self.silent(timeout_ns)
        return (np.insert(self.times_ns, silent + 1, self.times_ns[silent] + timeout_ns),
                np.insert(samples, silent + 1, -1))

    def silent(self, timeout_ns: int) -> NDArray[np.intp]:
        """Return the indices of the samples that time out before the next sample takes over."""
        return np.flatnonzero(np.append(np.diff(self.times_ns) > timeout_ns, True))

    def polynomials(self, first: int, stop: int) -> Floats:
        """
        Return the polynomials that interpolate between samples.

        Parameters
        ----------
        first, stop : int
            The polynomials begin at the samples `first` to `stop - 1`.

        Returns
        -------
        array, shape (stop - first, 2 degree + 1, 3), N m
            One row per polynomial. The variable is 0 at the first sample of an interval, and 1 at
            the next sample. A row contains the degree + 1 coefficients, followed by their
            low-order parts. The first coefficient has no low-order part, because it is the sample
            itself and therefore exact.

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
        cubics = np.empty((stop - first, 7, 3))
        kernels.fill_cubics(self.times_ns, self.torques, first, stop,
                            np.empty(interpolation.WORKSPACE), cubics)
        return cubics

    def at(self, times_ns: ArrayLike, timeout_ns: int = 0) -> tuple[Floats, NDArray[np.bool_]]:
        """
        Return the torque at given times.

        Where the torque jumps, the result is the value after the jump.

        Parameters
        ----------
        times_ns : array of int, shape (m,), ns
            The times, in any order. Before the first sample the torque is zero.
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
            A time is not an integer that fits in int64.

        """
        times = instants(times_ns)
        torques, in_space = np.zeros((times.size, 3)), np.zeros(times.size, np.bool_)
        samples = np.searchsorted(self.times_ns, times, 'right') - 1
        acts = samples >= 0
        if timeout_ns > 0 and len(self):
            acts &= times - self.times_ns[samples] < timeout_ns
        if not acts.any():
            return torques, in_space
        samples, times = samples[acts], times[acts]
        first, stop = int(samples.min()), int(samples.max()) + 1
        stamps = self.times_ns[first:stop + 1]
        spans = np.append(np.diff(stamps), 10 ** 9)[samples - first]
        fraction = ((times - self.times_ns[samples]) / spans)[:, None]
        coefficients = self.polynomials(first, stop)[samples - first]
        degree = coefficients.shape[1] // 2
        value = coefficients[:, degree]
        for k in range(degree - 1, -1, -1):
            value = coefficients[:, k] + fraction * value
        torques[acts], in_space[acts] = value, self.in_space[samples]
        return torques, in_space


def _checked_samples(times_ns: ArrayLike, samples: ArrayLike, name: str = 'torque',
                     plural: str = 'torques') -> tuple[NDArray[np.int64], Floats]:
    times = instants(times_ns)
    values = np.array(samples, float, order='C')
    if not values.size:
        values = values.reshape(-1, 3)
    if values.shape != (times.size, 3):
        raise ValueError(f'{plural}: expected shape ({times.size}, 3), found {values.shape}')
    # Checking row by row would take ten times as long. Counting takes half as long as `all` does.
    if np.count_nonzero(np.isfinite(values)) < values.size:
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        raise ValueError(f'{name} {bad[0]} at {times[bad[0]]} ns: expected finite numbers, '
                         f'found {values[bad[0]].tolist()}')
    return times, values


def _checked_frames(frame: str | Sequence[str] | NDArray[np.bool_],
                    count: int) -> NDArray[np.bool_]:
    if isinstance(frame, str) and frame in FRAMES:
        return (np.ones if frame == 'space' else np.zeros)(count, np.bool_)
    names = np.asarray(frame)
    if names.shape not in ((), (count,)):
        raise ValueError(f'frame: expected one name or {count}, found {names.size}')
    if names.shape and names.dtype == np.bool_:
        return names.copy()
    names = names.astype(str)
    in_space = names == 'space'
    unknown = names[~in_space & (names != 'body')]
    if unknown.size:
        raise ValueError(f"frame: expected 'body' or 'space', found {str(unknown[0])!r}")
    return np.array(np.broadcast_to(in_space, count))


#: The torques on a body: one log, several logs whose torques add up, or None.
Logs = TorqueLog | Sequence[TorqueLog] | None


def torque_logs(log: Logs) -> list[TorqueLog]:
    """Return the given log or logs as a list, which is empty if there are none."""
    return [log] if isinstance(log, TorqueLog) else [*(log or ())]


def stamps_of(logs: Iterable[TorqueLog]) -> NDArray[np.int64]:
    """Return the distinct stamps of all samples in the logs, ns, in ascending order."""
    return np.unique(np.concatenate([np.empty(0, np.int64), *(log.times_ns for log in logs)]))
