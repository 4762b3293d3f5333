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

"""Recorded torques, and what lies between the samples."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instants, NEVER_NS
from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.jit import internal, njit

FRAMES = ('body', 'space')
INTERPOLATIONS = ('hold', 'linear', 'cubic')
#: Samples that a slope of the cubic is taken from.
_NEAREST = 5
#: Samples beyond a part of a log that its cubics depend on.
_BESIDE = 4
#: Samples whose polynomials are worked out at a time.
_CHUNK = 65536


class TorqueLog:
    """
    A torque as a function of time, given by stamped samples.

    Before the first sample the torque is zero; from the last one on it is held.

    Parameters
    ----------
    times_ns : array of int, shape (n,)
        In any order; of equal stamps the later sample in the arrays replaces the earlier.
    torques : array, shape (n, 3), N m
        About the centre of mass.
    frame : str or sequence of n str
        'body' or 'space': the axes that the components are given in.
    interpolation : str
        'hold' (zero order), 'linear', or 'cubic': piecewise Hermite polynomials whose slopes
        come from the five nearest samples, of any spacing (fourth order).

    Raises
    ------
    ValueError
        Shapes disagree, a time is not an integer that fits int64, the times span 292 years or
        more, a torque is not finite, a name is unknown, or samples of different frames are to be
        interpolated.

    """

    def __init__(self, times_ns: ArrayLike, torques: ArrayLike,
                 frame: str | Sequence[str] = 'body', interpolation: str = 'hold') -> None:
        times, values = _checked_samples(times_ns, torques)
        in_space = _checked_frames(frame, len(times))
        if interpolation not in INTERPOLATIONS:
            raise ValueError(f'interpolation: expected one of {", ".join(INTERPOLATIONS)}, '
                             f'found {interpolation!r}')
        if interpolation != 'hold' and np.unique(in_space).size > 1:
            raise ValueError(f'interpolation {interpolation}: expected torques of one frame, '
                             'found body and space torques in one log')
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

    def __len__(self) -> int:
        return len(self.times_ns)

    def with_torques(self, torques: ArrayLike) -> TorqueLog:
        """Return a log of other torques, N m, shape (n, 3), at the same times; errors as above."""
        return TorqueLog(self.times_ns, torques, frame_names(self.in_space), self.interpolation)

    def part(self, begin_ns: int, end_ns: int) -> TorqueLog:
        """Return the samples that the torque from one time to another depends on."""
        first = max(int(np.searchsorted(self.times_ns, begin_ns, 'right')) - _BESIDE, 0)
        rows = slice(first, int(np.searchsorted(self.times_ns, end_ns, 'right')) + _BESIDE)
        return TorqueLog(self.times_ns[rows], self.torques[rows],
                         frame_names(self.in_space[rows]), self.interpolation)

    def segments(self, timeout_ns: int = 0) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """
        Return when the rule for the torque changes, and which sample rules from then on.

        Parameters
        ----------
        timeout_ns : int
            If positive, the torque is zero from this long after a sample to the next one.

        Returns
        -------
        starts_ns : array of int64, shape (m,)
        samples : array of int, shape (m,)
            Index of the sample, or -1 where the torque is zero because none came in time.

        """
        samples = np.arange(len(self))
        if timeout_ns <= 0 or not len(self):
            return self.times_ns, samples
        due = self.times_ns + timeout_ns
        silent = np.append(due[:-1] < self.times_ns[1:], True)
        starts = np.concatenate([self.times_ns, due[silent]])
        order = np.argsort(starts, kind='stable')
        return starts[order], np.concatenate([samples, np.full(silent.sum(), -1)])[order]

    def in_force(self, time_ns: int, timeout_ns: int = 0) -> tuple[int, bool]:
        """Return the sample (-1: none yet) that rules at a time, and whether it timed out."""
        sample = bisect.bisect_right(self.times_ns, time_ns) - 1
        return sample, sample >= 0 and 0 < timeout_ns <= time_ns - int(self.times_ns[sample])

    def polynomials(self, first: int) -> Iterable[tuple[int, int, Floats]]:
        """
        Return what lies between the samples, from a sample on, a chunk at a time.

        Returns
        -------
        iterable of (start, stop, coefficients)
            The samples of the chunk, and the polynomials in the fraction of the time from a sample
            to the next: array, shape (stop - start + 1, 2 degree + 1, 3), N m; one row more than
            the chunk has, unless it is the last. After the degree + 1 coefficients comes what
            rounding took from all but the first, which is the sample itself.

        """
        count = len(self)
        if self.interpolation == 'hold' or not count:
            return ((0, count, self.torques[:, None, :]),)
        return self._chunks(first)

    def _chunks(self, first: int) -> Iterator[tuple[int, int, Floats]]:
        for start in range(max(first, 0), len(self), _CHUNK):
            stop = min(start + _CHUNK, len(self))
            coefficients = self._polynomials(start, min(stop + 1, len(self)))
            coefficients.flags.writeable = False  # as those of `hold`: one type for the kernels
            yield start, stop, coefficients

    def at(self, times_ns: ArrayLike, timeout_ns: int = 0) -> tuple[Floats, NDArray[np.bool_]]:
        """
        Return the torque at times, on the side of what follows where it jumps.

        Parameters
        ----------
        times_ns : array of int, shape (m,)
            In any order. Before the first sample the torque is zero.
        timeout_ns : int
            As for `segments`.

        Returns
        -------
        torques : array, shape (m, 3), N m
        in_space : array of bool, shape (m,)
            Whether the torque is given in space axes.

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
        coefficients = self._polynomials(first, stop)[samples - first]
        degree = coefficients.shape[1] // 2
        value = coefficients[:, degree]
        for k in range(degree - 1, -1, -1):
            value = coefficients[:, k] + fraction * value
        torques[given], in_space[given] = value, self.in_space[samples]
        return torques, in_space

    def _polynomials(self, first: int, stop: int) -> Floats:
        here = self.torques[first:stop]
        if self.interpolation == 'hold':
            return here[:, None, :]
        if self.interpolation == 'linear':
            following = self.torques[first + 1:stop + 1]
            following = np.concatenate([following, here[len(following):]])
            rise = following - here
            back = rise - following
            lost = (following - (rise - back)) - (here + back)  # Knuth's exact sum
            return np.stack([here, rise, lost], axis=1)
        return _hermite(self.times_ns, self.torques, first, stop)


def frame_names(in_space: NDArray[np.bool_]) -> str | list[str]:
    """Return the frame of samples as `TorqueLog` takes it: one name where one will do."""
    if not in_space.any():
        return 'body'
    return 'space' if in_space.all() else np.where(in_space, 'space', 'body').tolist()


def _checked_samples(times_ns: ArrayLike, torques: ArrayLike) -> tuple[NDArray[np.int64], Floats]:
    times = instants(times_ns)
    if times.size and int(times.max()) - int(times.min()) >= NEVER_NS:
        raise ValueError('times_ns: expected times within 292 years of each other, '
                         f'found {times.min()} and {times.max()}')
    values = np.array(torques, float).reshape(-1, 3) if np.size(torques) == 0 \
        else np.array(torques, float, order='C')
    if values.shape != (times.size, 3):
        raise ValueError(f'torques: expected shape ({times.size}, 3), found {values.shape}')
    if not np.isfinite(values).all():  # by rows it takes ten times as long
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        raise ValueError(f'torque {bad[0]} at {times[bad[0]]} ns: expected finite numbers, '
                         f'found {values[bad[0]].tolist()}')
    return times, values


def _checked_frames(frame: str | Sequence[str], count: int) -> NDArray[np.bool_]:
    names = np.asarray(frame)
    if names.shape not in ((), (count,)):
        raise ValueError(f'frame: expected one name or {count}, found {names.size}')
    unknown = names[~np.isin(names, FRAMES)]
    if unknown.size:
        raise ValueError(f"frame: expected 'body' or 'space', found {str(unknown[0])!r}")
    return np.array(np.broadcast_to(names == 'space', count))


@njit
def _hermite(times_ns: NDArray[np.int64], values: Floats, first: int, stop: int) -> Floats:
    # Cubics through the samples, with the slopes there of polynomials through the nearest ones,
    # and what rounding takes from them: the torques on a thin rod may cancel but for that.
    last = len(times_ns) - 1
    count = min(_NEAREST, last + 1)
    result = np.empty((stop - first, 7, 3))
    weights, spacing = np.zeros((_NEAREST, 2)), np.zeros(_NEAREST, np.int64)
    start, end = np.zeros((3, 2)), np.zeros((3, 2))
    for node in range(first, stop + 1):
        start, end = end, start
        at = min(node, last)
        begin = min(max(at - count // 2, 0), last + 1 - count)
        _weigh(times_ns, at, begin, count, weights, spacing)
        for axis in range(3):
            slope = (0.0, 0.0)
            for k in range(count):
                rise = dd.two_sum(values[begin + k, axis], -values[at, axis])
                slope = dd.add(slope, dd.multiply((weights[k, 0], weights[k, 1]), rise))
            end[axis, 0], end[axis, 1] = slope
            if node > first:
                _fill(result[node - 1 - first, :, axis], values[node - 1, axis],
                      values[at, axis], dd.from_int(times_ns[at] - times_ns[node - 1]),
                      (start[axis, 0], start[axis, 1]), slope)
    return result


@internal
def _weigh(times_ns: NDArray[np.int64], node: int, begin: int, count: int, weights: Floats,
           spacing: NDArray[np.int64]) -> None:
    # What the rise from a node to each of the samples counts for in the slope, 1/ns: derivatives
    # of Lagrange's polynomials. Those of the node before hold where the spacing is the same.
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
def _fill(row: Floats, here: float, following: float, span: DoubleDouble,
          start: DoubleDouble, end: DoubleDouble) -> None:
    # The coefficients on one axis, from the values and the slopes, 1/ns, at both ends.
    rise = dd.two_sum(following, -here)
    start, end = dd.multiply(start, span), dd.multiply(end, span)
    bend = dd.subtract(rise, start)
    third = dd.subtract(dd.subtract(end, rise), bend)
    second = dd.subtract(bend, third)
    row[0], row[1], row[2], row[3] = here, start[0], second[0], third[0]
    row[4], row[5], row[6] = start[1], second[1], third[1]
