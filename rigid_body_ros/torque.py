"""Recorded torques, and what lies between the samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigid_body_ros.so3 import Floats

FRAMES = ('body', 'space')
INTERPOLATIONS = ('hold', 'linear', 'cubic')
#: Samples that a slope of the cubic is taken from.
_NEAREST = 5


class Rules(NamedTuple):
    """
    The torque in each of m spans of time.

    Attributes
    ----------
    polynomials : array, shape (m, degree + 1, 3), N m
        Coefficients in the fraction of the span that has passed.
    in_space : array of bool, shape (m,)
        Whether they are given in space axes.
    origins_ns : array of int64, shape (m,)
        Where the fraction is 0.
    spans : array, shape (m,), s
        The time from there to where it is 1.

    """

    polynomials: Floats
    in_space: NDArray[np.bool_]
    origins_ns: NDArray[np.int64]
    spans: Floats


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
        Shapes disagree, a torque is not finite, a name is unknown, or samples of different
        frames are to be interpolated.

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
        order = np.argsort(times, kind='stable')
        times = times[order]
        last = np.append(times[1:] != times[:-1], True)[:len(times)]
        chosen = order[last]
        self.times_ns: NDArray[np.int64] = times[last]
        self.torques: Floats = values[chosen]
        self.in_space: NDArray[np.bool_] = in_space[chosen]
        self.interpolation = interpolation
        for array in (self.times_ns, self.torques, self.in_space):
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.times_ns)

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

    def rules(self, samples: NDArray[np.intp]) -> Rules:
        """Return the rules of samples, such as `segments` gives; -1 stands for zero torque."""
        given = np.flatnonzero(samples >= 0)
        if not given.size:
            zeros = np.zeros(samples.size, np.int64)
            return Rules(np.zeros((samples.size, 1, 3)), zeros > 0, zeros, np.ones(samples.size))
        first, last = samples[given].min(), samples[given].max()
        row = np.where(samples < 0, 0, samples - first)
        polynomials = self._polynomials(first, last + 1)[row]
        polynomials[samples < 0] = 0.0
        times = self.times_ns[first:last + 2]
        spans = np.append(np.diff(times), 1)[:last + 1 - first] * 1e-9
        return Rules(polynomials, self.in_space[first:last + 1][row], times[row], spans[row])

    def at(self, times_ns: ArrayLike, timeout_ns: int = 0) -> tuple[Floats, NDArray[np.bool_]]:
        """
        Return the torque at times, on the side of what follows where it jumps.

        Parameters
        ----------
        times_ns : array of int, shape (m,)
        timeout_ns : int
            As for `segments`.

        Returns
        -------
        torques : array, shape (m, 3), N m
        in_space : array of bool, shape (m,)
            Whether the torque is given in space axes.

        """
        times = np.asarray(times_ns, np.int64)
        starts, samples = self.segments(timeout_ns)
        rules = self.rules(np.append(samples, -1)[np.searchsorted(starts, times, 'right') - 1])
        fraction = ((times - rules.origins_ns) * 1e-9 / rules.spans)[:, None]
        torques = rules.polynomials[:, -1]
        for k in range(rules.polynomials.shape[1] - 2, -1, -1):
            torques = rules.polynomials[:, k] + fraction * torques
        return torques, rules.in_space

    def _polynomials(self, first: int, stop: int) -> Floats:
        here = self.torques[first:stop]
        if self.interpolation == 'hold':
            return here[:, None, :]
        following = self.torques[first + 1:stop + 1]
        following = np.concatenate([following, here[len(following):]])
        if self.interpolation == 'linear':
            return np.stack([here, following - here], axis=1)
        nodes = np.minimum(np.arange(first, stop + 1), len(self) - 1)
        span = np.diff(self.times_ns[nodes])[:, None] * 1e-9
        slopes = _slopes(self.times_ns, self.torques, nodes)
        start, end = slopes[:-1] * span, slopes[1:] * span
        rise = following - here
        return np.stack([here, start, 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise],
                        axis=1)


def _checked_samples(times_ns: ArrayLike, torques: ArrayLike) -> tuple[NDArray[np.int64], Floats]:
    times = np.asarray(times_ns)
    if times.ndim != 1 or (times.size and not np.issubdtype(times.dtype, np.integer)):
        raise ValueError('times_ns: expected integer nanoseconds of shape (n,), '
                         f'found {times.dtype} of shape {times.shape}')
    values = np.array(torques, float).reshape(-1, 3) if np.size(torques) == 0 \
        else np.array(torques, float)
    if values.shape != (times.size, 3):
        raise ValueError(f'torques: expected shape ({times.size}, 3), found {values.shape}')
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise ValueError(f'torque {bad[0]} at {times[bad[0]]} ns: expected finite numbers, '
                         f'found {values[bad[0]].tolist()}')
    return times.astype(np.int64), values


def _checked_frames(frame: str | Sequence[str], count: int) -> NDArray[np.bool_]:
    names = np.full(count, frame) if isinstance(frame, str) else np.asarray(frame)
    if names.shape != (count,):
        raise ValueError(f'frame: expected one name or {count}, found {names.size}')
    known = np.isin(names, FRAMES)
    if not known.all() or (isinstance(frame, str) and frame not in FRAMES):
        found = frame if isinstance(frame, str) else names[~known][0]
        raise ValueError(f"frame: expected 'body' or 'space', found {str(found)!r}")
    return names == 'space'


def _slopes(times_ns: NDArray[np.int64], values: Floats, nodes: NDArray[np.int64]) -> Floats:
    # Derivative at each node of the polynomial through the nearest samples (barycentric weights;
    # Berrut and Trefethen, "Barycentric Lagrange interpolation", 2004, section 9.3).
    count = min(_NEAREST, len(times_ns))
    window = np.clip(nodes - count // 2, 0, len(times_ns) - count)[:, None] + np.arange(count)
    at = nodes - window[:, 0]
    rows = np.arange(len(nodes))
    seconds = (times_ns[window] - times_ns[nodes][:, None]) * 1e-9
    scale = np.ptp(seconds, axis=1)[:, None] if count > 1 else 1.0
    gaps = (seconds[:, :, None] - seconds[:, None, :]) / np.asarray(scale)[..., None]
    gaps[:, np.arange(count), np.arange(count)] = 1.0
    weights = 1.0 / gaps.prod(axis=2)
    slopes = weights / weights[rows, at][:, None] / gaps[rows, at]
    slopes[rows, at] = 0.0
    differences = values[window] - values[nodes][:, None, :]
    return np.einsum('nk,nkc->nc', slopes, differences) / np.asarray(scale)
