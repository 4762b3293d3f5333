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
The torques of several sources, their sum, and the momentum of the rotors.

The sum changes whenever one of its sources changes. Torques are added in the order of the sources,
so the order in which the torques arrive does not change any bit of the sum.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import accumulate
import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels, Samples, Sums
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.torque import TorqueLog

#: The source numbers of wheel commands, of the torque on the rotors, and of bodies. These are the
#: largest possible numbers, so that these sources come after all others.
COMMANDS, WHEELS, BODY = sys.maxsize - 2, sys.maxsize - 1, sys.maxsize
#: The sum of no torques. Adding it to a torque does not change any bit of the torque.
_NOTHING = np.full((1, 3), -0.0)
_NO_MARKS = np.empty(0, np.int64)
#: The arrays for more rows than this share a block of memory; see `_allocated`.
_FEW = 100
#: The parts of `Sums` for kinds of torques that do not act; see `acts`.
_NO_TORQUE, _NO_MOMENTUM = np.zeros((1, 1, 3)), np.zeros((1, 2, 3))
_IN_BODY, _IN_SPACE = np.array([False]), np.array([True])
for _constant in (_NO_TORQUE, _NO_MOMENTUM, _IN_BODY, _IN_SPACE):
    _constant.setflags(write=False)


class Sample(NamedTuple):
    """A torque from one source, N m, shape (1, 3)."""

    stamp_ns: int
    torque: Floats
    in_space: bool
    #: When the actuator of the source applies the torque, and the torque within its limits.
    begins_ns: int
    applied: Floats
    actuator: Actuator | None = None

    def is_over(self, time_ns: int, timeout_ns: int) -> bool:
        """Return whether the torque has timed out at a given time."""
        return 0 < timeout_ns <= time_ns - self.begins_ns

    def due_ns(self, timeout_ns: int, rest_ns: int) -> Iterator[int]:
        """Yield the times at which the torque times out and at which its lags end."""
        over_ns, expiry_ns = self.begins_ns + timeout_ns, 0
        if timeout_ns:
            yield over_ns
        if self.actuator and (expiry_ns := self.actuator.expiry_ns):
            if timeout_ns:
                yield max(over_ns, rest_ns) + expiry_ns
            end_ns = max(self.begins_ns, rest_ns) + expiry_ns
            if not timeout_ns or end_ns < over_ns:
                yield end_ns


def summed(sources: Sequence[TorqueLog], start_ns: int, momentum: Floats, timeout_ns: int,
           marks_ns: NDArray[np.int64] | None = None) -> Sums:
    """
    Return the sum of torque logs and the momentum of the rotors.

    Parameters
    ----------
    sources : sequence of TorqueLog
        The torque logs of the body, followed by the log of the torque on the rotors, in body axes.
        Only this last log may be empty.
    start_ns : int
        The start of the motion.
    momentum : array, shape (2, 3), N m s
        The rotor momentum at the start, and its low-order part.
    timeout_ns : int
        See `TorqueLog.segments`.
    marks_ns : array of int64, shape (n,), ns, optional
        Additional times at which a row must begin, in ascending order.

    Returns
    -------
    Sums
        The sums. Their first row begins at the start.

    """
    *logs, wheels = sources
    motors = [wheels] if len(wheels) else []
    if timeout_ns == 0 and marks_ns is None and _change_together([*logs, *motors], start_ns):
        return _summed_together(logs, motors, start_ns, momentum)
    return _merged(sources, start_ns, momentum, timeout_ns,
                   _NO_MARKS if marks_ns is None else marks_ns)


def summed_at(time_ns: int, samples: Mapping[int, Sample], timeout_ns: int,
              on_wheels: Floats | None) -> Sums:
    """
    Return the sum of the samples in force at a given time, as a single row, as `summed` does.

    The rotor momentum of the row is zero. The array `on_wheels`, N m, shape (1, 3), is the total
    motor torque on named wheels.
    """
    body: list[Floats] = []
    space: list[Floats] = []
    motors = [] if on_wheels is None else [on_wheels]
    for source in sorted(samples):
        sample = samples[source]
        if not (timeout_ns and sample.is_over(time_ns, timeout_ns)):
            (motors if source == WHEELS else space if sample.in_space else body).append(
                sample.applied)
    times_ns = np.array([time_ns])
    if motors or (body and space):
        return _row_by_row(times_ns, [body, space, motors], _NO_MOMENTUM[0])
    # The usual case, in which there is nothing to combine, takes a third of the time.
    return Sums(times_ns, _IN_SPACE if space else _IN_BODY, _added(space or body)[None],
                _NO_TORQUE, _NO_TORQUE, _NO_MOMENTUM)


def acts(torque: Floats) -> bool:
    """Return whether a part of `Sums` is not zero."""
    # Checking arrays of zeros takes a tenth of the time of a short segment.
    return torque is not _NO_TORQUE and bool(torque.any())


def _added(torques: Sequence[Floats]) -> Floats:
    """Return the sum, N m, shape (n, 3) or (1, 3), of torques added in the order given."""
    return reduce(np.add, torques) if torques else _NOTHING


def momentum_at(row_times_ns: NDArray[np.int64], momentum: Floats, motors: Floats,
                times_ns: NDArray[np.int64]) -> Floats:
    """Return the momentum of rotors on which a torque acts; see `Timeline.momentum`."""
    result = np.empty((len(times_ns), 2, 3))
    kernels.momentum_at(row_times_ns, momentum, motors, times_ns, result)
    return result


def _change_together(logs: Sequence[TorqueLog], start_ns: int) -> bool:
    """
    Return whether all logs are held, begin at or before the start, and change together.

    Each log must have a single stamp, or the same stamps as the longest log. The samples of a log
    must all be in the same axes.
    """
    stamps = max((log.times_ns for log in logs), key=len, default=())
    return (len(stamps) > 0 and all(log.interpolation == 'hold' for log in logs)
            and all(log.times_ns[0] <= start_ns for log in logs)
            and all(len(log) == 1 or np.array_equal(log.times_ns, stamps) for log in logs)
            and all(log.in_space.all() or not log.in_space.any() for log in logs))


def _summed_together(logs: Sequence[TorqueLog], motors: Sequence[TorqueLog], start_ns: int,
                     momentum: Floats) -> Sums:
    """
    Return the sum of torque logs whose torques change at the same times.

    For such logs, this takes a third of the time that `_merged` takes.
    """
    stamps_ns = max((log.times_ns for log in (*logs, *motors)), key=len)
    first = int(np.searchsorted(stamps_ns, start_ns, 'right')) - 1
    times_ns = np.append(start_ns, stamps_ns[first + 1:])
    in_axes = [[log for log in logs if log.in_space[0] == in_space] for in_space in (False, True)]
    groups = [[log.torques[first if len(log) > 1 else 0:] for log in group]
              for group in (*in_axes, motors)]
    return _row_by_row(times_ns, groups, momentum)


def _row_by_row(times_ns: NDArray[np.int64], groups: Sequence[Sequence[Floats]],
                momentum: Floats) -> Sums:
    """Return the sum of torques in body axes, in space axes and on the rotors, row by row."""
    (body, space, motors), sums = map(_added, groups), _allocated(times_ns, 0)
    kernels.sum_rows(body, space, motors, momentum, sums)
    return sums


def _allocated(times_ns: NDArray[np.int64], degree: int) -> Sums:
    """
    Allocate arrays for the sums at given times, without filling them.

    Large arrays share one block of memory, because NumPy requests large pages for a large block.
    This saves time: getting many small pages from the system takes longer than filling the arrays.
    Memory that is never touched costs no time.
    """
    sizes, count = (2 * degree + 1, degree + 1, degree + 1, 2), len(times_ns)
    parts: Iterable[Floats] = (np.empty((count, size, 3)) for size in sizes)
    if count > _FEW:
        block = np.empty((sum(sizes), 3 * count))
        parts = (block[end - size:end].reshape(count, size, 3)
                 for size, end in zip(sizes, accumulate(sizes)))
    return Sums(times_ns, np.empty(count, np.bool_), *parts)


def _merged(sources: Sequence[TorqueLog], start_ns: int, momentum: Floats, timeout_ns: int,
            marks_ns: NDArray[np.int64]) -> Sums:
    """Return the sum of arbitrary sources, the last of which is the torque on the rotors."""
    pieces = [log.polynomials(0, len(log)) for log in sources]
    degree = max(piece.shape[1] // 2 for piece in pieces)
    samples = Samples(np.concatenate([_padded(piece, degree) for piece in pieces]),
                      np.concatenate([log.times_ns for log in sources]),
                      np.concatenate([log.in_space for log in sources]),
                      np.cumsum([0, *map(len, sources)]))
    limit = 1 + len(samples.stamps_ns) * (2 if timeout_ns > 0 else 1) + len(marks_ns)
    sums = _allocated(np.empty(limit, np.int64), degree)
    count = kernels.sum_logs(samples, samples.offsets[:-1] - 1, timeout_ns, start_ns, marks_ns,
                             momentum, sums)
    return Sums._make(part[:count] for part in sums)


def _padded(coefficients: Floats, degree: int) -> Floats:
    """Return polynomials with zero coefficients added, so that all have the given degree."""
    count, own = len(coefficients), coefficients.shape[1] // 2
    if own == degree:
        return coefficients
    result = np.zeros((count, 2 * degree + 1, 3))
    result[:, :own + 1] = coefficients[:, :own + 1]
    result[:, degree + 1:degree + 1 + own] = coefficients[:, own + 1:]
    return result
