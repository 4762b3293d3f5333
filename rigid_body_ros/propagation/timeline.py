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

"""A body's inputs in rows: the torques of all sources, their timeouts, and the rotors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import Rows, Terms
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import summation
from rigid_body_ros.propagation.lags import friction_key, LaggingSources, terms_of
from rigid_body_ros.propagation.wheels import friction_of, WheelTimeline

#: Number of samples whose polynomials are computed at once.
_CHUNK = 65536


class OtherTorques(NamedTuple):
    """
    Torques other than those of the logs and the rotors.

    If there are no torques of a kind, the attribute for this kind is None.
    """

    #: The torques that depend on the attitude: FIELDS, shape (1,).
    fields: NDArray[Any] | None = None
    #: The sources whose torques lag behind the commands in the logs.
    lagging: LaggingSources | None = None
    #: The wheels with friction.
    wheels: WheelTimeline | None = None


NO_OTHERS = OtherTorques()


class Timeline:
    """
    The inputs of a body from a given time onward.

    The rows are the samples of a single log, or the sums of several logs. A torque that times out
    is followed by a row of zeros.

    Parameters
    ----------
    logs : sequence of TorqueLog
        The torques on the body, none of them empty.
    wheels : TorqueLog, optional
        The log of the torque on the rotors, not empty.
    timeout_ns : int
        See `TorqueLog.segments`.
    is_damped : bool
        Whether the body is damped.
    start_ns : int
        The time from which the inputs are needed.
    momentum : array, shape (2, 3), N m s, or None
        The rotor momentum at `start_ns`, and its low-order part. None if there are no rotors.
    others : OtherTorques

    Attributes
    ----------
    times_ns : array of int64, shape (n,)
        The time at which each row begins.
    has_rotors, has_terms : bool
        `has_rotors` tells whether there are rotors, and `has_terms` whether there are rotors,
        damping or fields.

    """

    # These defaults are class attributes, because most motions never change them, and setting
    # instance attributes takes time.
    has_rotors = has_terms = _has_motors = _always_acts = False
    _fields: NDArray[Any] | None = None
    _lagging: LaggingSources | None = None
    #: The wheels with friction.
    _named: WheelTimeline | None = None
    #: For a single log, `_terms` holds the terms of the rows. For a sum of logs, `_summed` holds
    #: the rows, including their terms.
    _terms: Terms | None = None
    _summed: Rows | None = None
    #: The indices of the samples that time out before the next sample; None without a timeout.
    _silent: NDArray[np.intp] | None = None

    def __init__(self, logs: Sequence[TorqueLog], wheels: TorqueLog | None, timeout_ns: int,
                 is_damped: bool, start_ns: int, momentum: Floats | None,
                 others: OtherTorques = NO_OTHERS) -> None:
        self._timeout_ns, (fields, lagging, named) = timeout_ns, others
        is_summed = (wheels is not None or fields is not None or lagging is not None
                     or named is not None)
        if is_summed or is_damped or momentum is not None:
            self._has_motors = wheels is not None and bool(wheels.torques.any())
            self._set_terms(is_damped, momentum, others)
        if is_summed or len(logs) > 1:
            self._summed = self._sum([*logs, wheels or _NO_LOG], start_ns)
            self.times_ns = self._summed.times_ns
            return
        self._log = logs[0] if logs else _NO_LOG
        stamps_ns = self.times_ns = self._log.times_ns
        if timeout_ns and len(stamps_ns):
            self._silent = self._log.silent(timeout_ns)
            self.times_ns = np.insert(stamps_ns, self._silent + 1,
                                      stamps_ns[self._silent] + timeout_ns)

    def _set_terms(self, is_damped: bool, momentum: Floats | None, others: OtherTorques) -> None:
        self._fields, self._lagging, self._named = others
        self.has_rotors = momentum is not None or self._has_motors
        self._always_acts = momentum is not None or is_damped or self._fields is not None
        self.has_terms = self._always_acts or self._has_motors
        self._terms = Terms((_NO_MOMENTUM if momentum is None else momentum)[None], None, None)

    @property
    def has_fields(self) -> bool:
        """Return whether there are torques that depend on the attitude."""
        return self._fields is not None

    @cached_property
    def _samples(self) -> NDArray[np.intp] | None:
        """
        Return the index of the sample in each row, or None if torques do not time out.

        The index is -1 in a row that begins at a timeout.
        """
        if self._silent is None:
            return None
        return np.insert(np.arange(len(self._log)), self._silent + 1, -1)

    def _sum(self, sources: Sequence[TorqueLog], start_ns: int) -> Rows:
        momentum = self._terms.momentum[0] if self._terms else _NO_MOMENTUM
        marks_ns = [each.marks_ns for each in (self._lagging, self._named) if each]
        sums = summation.summed(sources, start_ns, momentum, self._timeout_ns,
                                reduce(np.union1d, marks_ns) if marks_ns else None)
        times_ns = sums.times_ns
        axes = [log.in_space for log in sources if len(log)]
        in_two = any(each.any() for each in axes) and not all(each.all() for each in axes)
        spans = _NO_SPANS
        if sums.torques.shape[1] > 1:
            spans = np.append(np.diff(times_ns) / 1e9, 1.0)
        has_motors = self._has_motors
        momentum = sums.momentum if has_motors else momentum[None]
        lags = self._lagging.lags(times_ns) if self._lagging else None
        friction = friction_of(self._named.wheels, self._named.efforts(times_ns)) \
            if self._named is not None else None
        terms: Terms | None = None
        if self._fields is not None or lags is not None or friction is not None:
            terms = terms_of(momentum, sums.motors, sums.space, self._fields, lags, friction)
        elif self.has_terms or in_two:
            terms = Terms(momentum, sums.motors if has_motors else None,
                          sums.space if in_two else None)
        return Rows(times_ns, sums.torques, sums.in_space, spans, terms)

    def in_force(self, time_ns: int) -> int:
        """Return the index of the row in force at a given time; -1 before the first row."""
        times_ns = self.times_ns
        if not len(times_ns) or time_ns < times_ns.item(0):
            return -1
        if len(times_ns) == 1 or time_ns < times_ns.item(1):  # the usual case; saves a search
            return 0
        return int(times_ns.searchsorted(time_ns, 'right')) - 1

    def held(self, row: int) -> tuple[Floats, bool, list[Floats]] | None:
        """
        Return the torques that are held in a row, N m; None if a torque changes within the row.

        The result is a tuple of three values: the torque on the body, shape (3,); whether this
        torque is in space axes; and a list of other torques. In this order, the list contains a
        torque in space axes that acts in addition to a torque in body axes, the torque on the
        rotors, and the excess of lagging torques.
        """
        none = np.zeros(3)
        if self._summed is not None:
            _, torques, in_space, _, terms = self._summed
            space, motors = (terms.space, terms.motors) if terms else (None, None)
            if torques.shape[1] > 1:
                return None
            others = [none if space is None else space[row, 0],
                      none if motors is None else motors[row, 0]]
            if terms and terms.lags and self._lagging:
                others.append(terms.lags.excess[row])
            return torques[row, 0], bool(in_space[row]), others
        if row >= 0 and self._samples is not None:
            row = int(self._samples[row])
        if row < 0:
            return none, False, [none, none]
        if self._log.interpolation != 'hold':
            return None
        return self._log.torques[row], bool(self._log.in_space[row]), [none, none]

    def key(self, row: int) -> list[Floats]:
        """Return all numbers that determine the friction in a row, or [] without friction."""
        terms = self._summed.terms if self._summed else None
        return [friction_key(terms.friction, row)] if terms and terms.friction else []

    def begin_earlier(self, begin_ns: int, momentum: Floats) -> None:
        """Move the beginning of the first row, whose torques are held, to an earlier time."""
        if self._summed is None:
            return
        self.times_ns, terms = np.append(begin_ns, self.times_ns[1:]), self._summed.terms
        if terms and self._has_motors:
            terms = terms._replace(momentum=np.concatenate([momentum[None], terms.momentum[1:]]))
        if self._lagging and terms and terms.lags:
            lags = terms.lags._replace(excess=self._lagging.excess(self.times_ns))
            terms = terms._replace(lags=lags)
        self._summed = self._summed._replace(times_ns=self.times_ns, terms=terms)

    def chunks(self, begun: NDArray[np.int64], stop: int) -> Iterable[tuple[int, int, Rows]]:
        """
        Return the rows in chunks.

        Parameters
        ----------
        begun : array of int, shape (n,)
            The indices of the rows in force, or -1 before the first row. Rows before the smallest
            of these indices are not needed, and may be left out.
        stop : int
            The index after the last row to return.

        Returns
        -------
        iterable of (int, int, Rows)
            For each chunk, the index of its first row, the index after its last row, and its rows.
            The returned rows include one extra row after the last row of the chunk.

        """
        if self._summed:
            return (0, stop, self._summed),
        if self._log.interpolation == 'hold':
            return (0, stop, self._held()),
        return ((begin, min(begin + _CHUNK, stop), self._interpolated(
            slice(begin, min(begin + _CHUNK, stop) + 1)))
            for begin in range(max(int(begun.min()), 0), stop, _CHUNK))

    def _held(self) -> Rows:
        log = self._log
        if self._silent is None:
            return Rows(log.times_ns, log.torques[:, None, :], log.in_space, _NO_SPANS,
                        self._terms)
        due = self._silent + 1
        return Rows(self.times_ns, np.insert(log.torques, due, 0.0, axis=0)[:, None, :],
                    np.insert(log.in_space, due, False), _NO_SPANS, self._terms)

    def _interpolated(self, rows: slice) -> Rows:
        log, times_ns = self._log, self.times_ns[rows]
        samples = self._samples[rows] if self._samples is not None else \
            np.arange(rows.start, rows.start + len(times_ns))
        acts = samples >= 0
        first = int(samples[acts][0]) if acts.any() else 0
        stop = int(samples.max(initial=0)) + 1
        index = np.maximum(samples - first, 0)
        polynomials = log.polynomials(first, stop)[index] * acts[:, None, None]
        spans = np.append(np.diff(log.times_ns[first:stop + 1]) / 1e9, 1.0)[index]
        return Rows(times_ns, polynomials, log.in_space[samples] & acts, spans, self._terms)

    def acts(self) -> NDArray[np.bool_]:
        """For each row, return whether any torques, rotors, damping or fields act in that row."""
        if self._always_acts:
            return np.ones(len(self.times_ns), np.bool_)
        if self._summed is not None:
            _, torques, _, _, terms = self._summed
            others = [] if terms is None else [terms.space, terms.motors]
            if terms and self._has_motors:
                others.append(terms.momentum)
            if terms and terms.lags:
                others.append(terms.lags.excess.reshape(len(torques), -1, 3))
            parts = [torques, *(other for other in others if other is not None)]
            return np.asarray(np.concatenate(parts, axis=1).any(axis=(1, 2)))
        found = np.asarray(self._log.torques.any(axis=1))
        return found if self._silent is None else np.insert(found, self._silent + 1, False)

    def momentum(self, times_ns: NDArray[np.int64]) -> Floats:
        """
        Return the rotor momentum at given times, and its low-order part.

        Parameters
        ----------
        times_ns : array of int64, shape (m,)
            The times, in any order, none before the start.

        Returns
        -------
        array, shape (m, 2, 3), N m s

        """
        terms = self._summed.terms if self._summed else self._terms
        if terms is None or terms.motors is None or not self._has_motors:
            constant = terms.momentum if terms else _NO_MOMENTUM[None]
            return np.broadcast_to(constant, (len(times_ns), 2, 3))
        return summation.momentum_at(self.times_ns, terms.momentum, terms.motors, times_ns)


def held_row(time_ns: int, torque: Floats, in_space: bool,
             terms: Terms | None = None) -> Rows:
    """Return a row with a torque, N m, shape (1, 3), that is held from a given time onward."""
    return Rows(np.array([time_ns]), torque[None], _IN_SPACE if in_space else _IN_BODY, _NO_SPANS,
                terms)


_NO_LOG = TorqueLog([], [])
_NO_SPANS, _NO_MOMENTUM = np.empty(0), np.zeros((2, 3))
_IN_BODY, _IN_SPACE = np.array([False]), np.array([True])
for _constant in (_NO_SPANS, _NO_MOMENTUM, _IN_BODY, _IN_SPACE):
    _constant.setflags(write=False)
