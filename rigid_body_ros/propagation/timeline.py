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

from collections.abc import Hashable, Iterable, Sequence
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import FIELDS, Friction, Lags, Rows, Sums, Terms
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation.lags import LaggingSources
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.sources import acts, momentum_at, summed
from rigid_body_ros.propagation.wheels import coupled, WheelTimeline

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
    #: The wheels with friction or a largest speed.
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
    has_rotors = has_terms = _has_motors = _always_acts = _is_summed = False
    _others = NO_OTHERS
    _terms: Terms | None = None
    #: All rows; None if they are the polynomials of a single log, which are computed in chunks.
    _rows: Rows | None = None
    #: The indices of the samples that time out before the next sample; None without a timeout.
    _silent: NDArray[np.intp] | None = None

    def __init__(self, logs: Sequence[TorqueLog], wheels: TorqueLog | None, timeout_ns: int,
                 is_damped: bool, start_ns: int, momentum: Floats | None,
                 others: OtherTorques = NO_OTHERS) -> None:
        is_summed = wheels is not None or (
            others is not NO_OTHERS and any(other is not None for other in others))
        if is_summed or is_damped or momentum is not None:
            self._others, self._has_motors = others, wheels is not None and bool(
                wheels.torques.any())
            self.has_rotors = momentum is not None or self._has_motors
            self._always_acts = momentum is not None or is_damped or self.has_fields
            self.has_terms = self._always_acts or self._has_motors
            momentum = _NO_MOMENTUM if momentum is None else momentum
            self._terms = Terms(momentum[None], None, None)
        if is_summed or len(logs) > 1:
            self._is_summed = True
            self._rows = self._sum([*logs, wheels or _NO_LOG], timeout_ns, start_ns)
            self.times_ns = self._rows.times_ns
            return
        log = self._log = logs[0] if logs else _NO_LOG
        stamps_ns, torques, in_space = log.times_ns, log.torques, log.in_space
        self.times_ns, is_held = stamps_ns, log.interpolation == 'hold'
        if timeout_ns and len(stamps_ns):
            silent = self._silent = log.silent(timeout_ns)
            self.times_ns = np.insert(stamps_ns, silent + 1, stamps_ns[silent] + timeout_ns)
            if is_held:
                torques = np.insert(torques, silent + 1, 0.0, axis=0)
                in_space = np.insert(in_space, silent + 1, False)
        if is_held:
            self._rows = Rows(self.times_ns, torques[:, None, :], in_space, NO_SPANS, self._terms)

    @property
    def has_fields(self) -> bool:
        """Return whether there are torques that depend on the attitude."""
        return self._others.fields is not None

    def _sum(self, logs: Sequence[TorqueLog], timeout_ns: int, start_ns: int) -> Rows:
        _, lagging, wheels = self._others
        momentum = self._terms.momentum[0] if self._terms else _NO_MOMENTUM
        marks_ns = [other.marks_ns for other in (lagging, wheels) if other]
        sums = summed(logs, start_ns, momentum, timeout_ns,
                      reduce(np.union1d, marks_ns) if marks_ns else None)
        friction = coupled(wheels.wheels, wheels.efforts(sums.times_ns)) if wheels else None
        return rows_of(sums, sums.momentum, self.has_terms, self._has_motors, self._others,
                       friction)

    def in_force(self, time_ns: int) -> int:
        """Return the index of the row in force at a given time; -1 before the first row."""
        times_ns = self.times_ns
        if not len(times_ns) or time_ns < times_ns.item(0):
            return -1
        if len(times_ns) == 1 or time_ns < times_ns.item(1):  # the usual case; saves a search
            return 0
        return int(times_ns.searchsorted(time_ns, 'right')) - 1

    def rule(self, options: Options, body: RigidBody, row: int, time_ns: int) -> Hashable:
        """Return `rule_of` a row, or None if a torque changes within the row."""
        rows = self._rows
        if row >= 0 and (self._samples[row] >= 0 if rows is None else len(rows.spans)):
            return None
        return rule_of(options, body, rows, row, time_ns, self._others)

    def begin_earlier(self, begin_ns: int, momentum: Floats) -> None:
        """Move the beginning of the first row, whose torques are held, to an earlier time."""
        if self._rows and self._is_summed:
            self._rows = beginning_at(self._rows, begin_ns, momentum, self._others.lagging)
            self.times_ns = self._rows.times_ns

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
        if self._rows:
            return (0, stop, self._rows),
        return ((begin, min(begin + _CHUNK, stop), self._interpolated(
            slice(begin, min(begin + _CHUNK, stop) + 1)))
            for begin in range(max(int(begun.min()), 0), stop, _CHUNK))

    @cached_property
    def _samples(self) -> NDArray[np.intp]:
        """Return the index of the sample in each row, or -1 in a row that begins at a timeout."""
        samples = np.arange(len(self._log))
        return samples if self._silent is None else np.insert(samples, self._silent + 1, -1)

    def _interpolated(self, rows: slice) -> Rows:
        log, times_ns, samples = self._log, self.times_ns[rows], self._samples[rows]
        in_force = samples >= 0
        first = int(samples[in_force][0]) if in_force.any() else 0
        stop = int(samples.max(initial=0)) + 1
        index = np.maximum(samples - first, 0)
        polynomials = log.polynomials(first, stop)[index] * in_force[:, None, None]
        spans = np.append(np.diff(log.times_ns[first:stop + 1]) / 1e9, 1.0)[index]
        return Rows(times_ns, polynomials, log.in_space[samples] & in_force, spans, self._terms)

    def acts(self, which: slice = slice(None)) -> NDArray[np.bool_]:
        """For some rows, return whether any torques, rotors, damping or fields act in each row."""
        if self._always_acts:
            return np.ones(len(self.times_ns[which]), np.bool_)
        if self._rows is None:
            samples = self._samples[which]
            return np.asarray((samples >= 0) & self._log.torques[samples].any(axis=1))
        terms, parts = self._rows.terms, [self._rows.torques[which]]
        if terms:
            parts += [part[which] for part in (terms.space, terms.motors) if part is not None]
            if self._has_motors:
                parts.append(terms.momentum[which])
            if terms.lags:
                parts.append(terms.lags.excess[which].reshape(len(parts[0]), -1, 3))
        return np.asarray(np.concatenate(parts, axis=1).any(axis=(1, 2)))

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
        terms = self._rows.terms if self._rows else self._terms
        if terms is None or terms.motors is None or not self._has_motors:
            constant = terms.momentum if terms else _NO_MOMENTUM[None]
            return np.broadcast_to(constant, (len(times_ns), 2, 3))
        return momentum_at(self.times_ns, terms.momentum, terms.motors, times_ns)


def rows_of(sums: Sums, momentum: Floats, has_terms: bool, has_motors: bool,
            others: OtherTorques, friction: Friction | None) -> Rows:
    """
    Return rows with summed torques and everything else that acts.

    Parameters
    ----------
    sums : Sums
        The torques.
    momentum : array, shape (n, 2, 3), N m s
        The rotor momentum in each row, and its low-order part. Without motors, the first of them
        is that of all rows.
    has_terms, has_motors : bool
        Whether there are rotors, damping or fields, and whether torques on the rotors.
    others, friction
        The other torques, and the wheels that depend on the motion; see `layout.Friction`.

    """
    spans, terms = NO_SPANS, None
    if sums.torques.size > 3 * len(sums.times_ns):
        spans = np.append(np.diff(sums.times_ns) / 1e9, 1.0)
    fields, lagging, _ = others
    if fields is not None or lagging is not None or friction is not None:
        lags = lagging.lags(sums.times_ns) if lagging else None
        terms = terms_of(momentum if has_motors else momentum[:1], sums.motors, sums.space, fields,
                         lags, friction)
    elif (in_two := acts(sums.space)) or has_terms:
        terms = Terms(momentum if has_motors else momentum[:1],
                      sums.motors if has_motors else None, sums.space if in_two else None)
    return Rows(sums.times_ns, sums.torques, sums.in_space, spans, terms)


def terms_of(momentum: Floats, motors: Floats, space: Floats, fields: NDArray[Any] | None,
             lags: Lags | None, friction: Friction | None) -> Terms:
    """Return the terms for rows with fields, lags or friction; see `layout.Terms`."""
    if friction is not None and lags is None:
        lags = no_lags(len(friction.efforts))
    if lags is not None and fields is None:
        fields = _NO_FIELDS
    return Terms(momentum, motors, space, fields, lags, friction)


def no_lags(count: int) -> Lags:
    """Return the lags of a number of rows in which nothing lags."""
    return Lags(np.zeros((count, 0, 2, 3)), np.empty(0))


def rule_of(options: Options, body: RigidBody, rows: Rows | None, row: int, time_ns: int,
            others: OtherTorques) -> Hashable:
    """
    Return the `Options.rule` of a row of held torques.

    No torque acts before all rows, in the row -1, and if `rows` is None. The commands of lagging
    sources are those at the time `time_ns` in the row.
    """
    if rows is None or row < 0:
        return options.rule(body, others.fields, _NO_TORQUE, False)
    parts: list[Floats] = []
    terms = rows.terms
    if terms and (terms.space is not None or terms.motors is not None):
        parts = [_NO_TORQUE if part is None else part[row] for part in (terms.space, terms.motors)]
        if terms.lags and others.lagging and terms.lags.excess[row].any():
            parts.append(others.lagging.key(time_ns))
        if terms.friction:
            parts += [terms.friction.efforts[row], terms.friction.wheels]
    return options.rule(body, others.fields, rows.torques[row], rows.in_space.item(row), *parts)


def beginning_at(rows: Rows, begin_ns: int, momentum: Floats,
                 lagging: LaggingSources | None) -> Rows:
    """Return rows whose first row begins earlier, with the rotor momentum at that time."""
    times_ns, terms = np.append(begin_ns, rows.times_ns[1:]), rows.terms
    if terms:
        lags = terms.lags
        if lags and lagging:
            lags = lags._replace(excess=lagging.excess(times_ns))
        momentum = np.concatenate([momentum[None], terms.momentum[1:]])
        terms = terms._replace(momentum=momentum, lags=lags)
    return rows._replace(times_ns=times_ns, terms=terms)


def on_body(torques: Iterable[tuple[Floats, NDArray[np.bool_]]], lagging: LaggingSources | None,
            times_ns: NDArray[np.int64], attitude: Floats) -> Floats:
    """
    Return the total torque of several sources in body axes, N m, shape (m, 3).

    Parameters
    ----------
    torques : iterable of tuple
        For each source, the torques at the m times, N m, and whether they are in space axes.
    lagging : LaggingSources or None
        The sources that lag.
    times_ns : array of int64, shape (m,), ns
        The times, in any order.
    attitude : array, shape (m, 4)
        The attitudes at these times, x y z w.

    """
    axes = np.zeros((len(times_ns), 2, 3))
    for torque, in_space in torques:
        axes[np.arange(len(times_ns)), in_space.astype(int)] += torque
    if lagging is not None:
        axes += lagging.total_excess(times_ns)
    return axes[:, 0] + so3.rotate(so3.conjugate(attitude), axes[:, 1])


_NO_LOG = TorqueLog([], [])
_NO_FIELDS = np.zeros(1, FIELDS)
_NO_TORQUE, _NO_MOMENTUM, NO_SPANS = np.zeros((1, 3)), np.zeros((2, 3)), np.empty(0)
for _constant in (_NO_FIELDS, _NO_TORQUE, _NO_MOMENTUM, NO_SPANS):
    _constant.setflags(write=False)
