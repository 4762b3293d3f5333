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

"""Extract attitudes and angular velocities from messages and tables, and check them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics import so3
from rigid_body_ros.messages import MessageType
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.measured import FEWEST, Measured, not_measured
from rigid_body_ros.recording.source import Messages
from rigid_body_ros.recording.text_files import ATTITUDE, is_sample, RATES, Table

#: A value whose variance is at least this large, rad^2 or rad^2/s^2, counts as not measured.
_MEANINGLESS = 1e3
#: Attitudes and angular velocities are one sensor if at least this fraction of the messages that
#: contain one of them contains both.
_TOGETHER = 0.9
_Mask = NDArray[np.bool_]
#: What a topic may contain, and its name in messages.
_NAMES = {'attitude': 'attitude', 'rates': 'angular velocity'}
QUANTITIES = tuple(_NAMES)
_NONE = None, None
#: Where the attitude and the angular velocity are among the doubles of a message, each with its
#: covariance.
_LAYOUTS: dict[MessageType, tuple[tuple[slice | None, slice | None], ...]] = {
    messages.QUATERNION: ((slice(0, 4), None), _NONE),
    messages.POSE: ((slice(3, 7), None), _NONE),
    messages.POSE_WITH_COVARIANCE: ((slice(3, 7), slice(7, 43)), _NONE),
    messages.TRANSFORM_STAMPED: ((slice(3, 7), None), _NONE),
    messages.TRANSFORM: ((slice(3, 7), None), _NONE),
    messages.ODOMETRY: ((messages.ORIENTATION, slice(7, 43)),
                        (messages.ANGULAR_VELOCITY, slice(49, 85))),
    messages.IMU: ((slice(0, 4), slice(4, 13)), (slice(13, 16), slice(16, 25))),
    messages.VECTOR3: (_NONE, (slice(0, 3), None)),
}
#: Message types that a measured topic can have.
KINDS = tuple(_LAYOUTS)


@dataclass(frozen=True, eq=False)
class MeasuredSamples:
    """
    The attitudes and angular velocities in the messages of a topic or the lines of a table.

    Attributes
    ----------
    stamps_ns : array of int64, shape (n,)
        In the order of the recording.
    attitude : array, shape (n, 4)
        Unit quaternions; NaN in messages without a usable attitude.
    rates : array, shape (n, 3), rad/s
        Angular velocities; NaN in messages without a usable one.
    given : array of bool, shape (n, 2)
        Whether a message contains an attitude, and an angular velocity, usable or not.
    norms : array, shape (n,)
        The norms of the quaternions in the messages.
    covariances : tuple of array, shape (n, 3, 3), or None
        Those of the attitude and of the angular velocity.
    damage : str
        What was lost from the recording.
    notes : tuple of str
        What was converted, assumed or left out.

    """

    stamps_ns: NDArray[np.int64]
    attitude: Floats
    rates: Floats
    given: _Mask
    norms: Floats
    covariances: tuple[Floats | None, Floats | None] = (None, None)
    damage: str = ''
    notes: tuple[str, ...] = ()

    @cached_property
    def usable(self) -> _Mask:
        """Return whether a message has a usable attitude, and a usable rate, shape (n, 2)."""
        return np.isfinite(np.column_stack([self.attitude[:, 0], self.rates[:, 0]]))

    def rates_from_space(self, rows: _Mask, frame: str) -> MeasuredSamples:
        """Convert angular velocities in space axes to body axes, which needs attitudes."""
        rates, to_body = self.rates.copy(), so3.conjugate(self.attitude)
        rates[rows] = so3.rotate(to_body[rows], rates[rows])
        of_rates = _turned(self.covariances[1], so3.matrix(to_body), rows)
        note = f'the angular velocity is in the axes of {frame} (space): converted to body axes'
        return replace(self, rates=rates, covariances=(self.covariances[0], of_rates),
                       notes=(*self.notes, note))

    def from_link(self, rows: _Mask, rotation: Floats, frame: str) -> MeasuredSamples:
        """
        Convert measurements in the axes of a link to body axes.

        `rotation`, shape (3, 3), contains the axes of the link as columns, in body axes.
        """
        turn, attitude, rates = so3.from_matrix(rotation), self.attitude.copy(), self.rates.copy()
        attitude[rows] = so3.multiply(attitude[rows], so3.conjugate(turn))
        rates[rows] = so3.rotate(turn, rates[rows])
        first, second = (_turned(covariances, rotation, rows) for covariances in self.covariances)
        note = f'the measurements are in the axes of {frame}: converted to body axes'
        return replace(self, attitude=attitude, rates=rates, covariances=(first, second),
                       notes=(*self.notes, note))

    def without_unmeasured(self) -> MeasuredSamples:
        """
        Drop one of two quantities, with a note, if it is not measured.

        It is never usable, or it never changes although the other one says that the body turns.
        """
        for name, present, usable in zip(QUANTITIES, self.given.T, self.usable.T):
            if present.any() and not usable.any() and self.usable.any():
                note = f'the {_NAMES[name]} is not used: expected finite values, of a possible ' \
                       f'size, found none in {present.sum()} messages'
                return replace(self.without([name]), notes=(*self.notes, note))
        both = self.usable.all(axis=1)
        name, note = not_measured(self.stamps_ns[both], self.attitude[both], self.rates[both])
        return replace(self.without([name]), notes=(*self.notes, note)) if name else self

    def without(self, names: Collection[str]) -> MeasuredSamples:
        """Drop quantities: 'attitude', 'rates'."""
        kept = np.array([name not in names for name in QUANTITIES])
        return replace(self, given=self.given & kept,
                       attitude=np.where(kept[0], self.attitude, np.nan),
                       rates=np.where(kept[1], self.rates, np.nan))

    def sensors(self, where: str, topic: str, has_log_times: bool) -> list[Measured]:
        """
        Return the usable samples as a sensor, sorted by stamp.

        Return two sensors if attitudes and angular velocities are in different messages.

        Parameters
        ----------
        where : str
            The file and the topic, for error messages.
        topic : str
            The name of the sensor.
        has_log_times : bool
            Whether the recording has other stamps, which the option --time-source selects.

        Raises
        ------
        InputError
            There are too few usable samples.

        """
        usable = self.usable
        columns = np.flatnonzero(usable.any(axis=0)).tolist()
        if len(columns) == 2 and usable.all(axis=1).sum() < _TOGETHER * usable.sum(axis=0).max():
            return [self._sensor(where, f'{topic}:{QUANTITIES[column]}', [column], has_log_times)
                    for column in columns]
        return [self._sensor(where, topic, columns, has_log_times)]

    def _sensor(self, where: str, topic: str, columns: list[int],
                has_log_times: bool) -> Measured:
        usable = np.flatnonzero(self.usable[:, columns].all(axis=1) & bool(columns))
        count = int(self.given[:, columns].any(axis=1).sum()) if columns else len(self.stamps_ns)
        if len(usable) < FEWEST:
            lost = f' ({self.damage})' if self.damage else ''
            raise InputError(f'{where}: expected at least {FEWEST} messages with a finite '
                             f'attitude or angular velocity, found {len(usable)} among '
                             f'{count}{lost}')
        account = Account(Account.advice if has_log_times else '', notes=[*self.notes])
        account.add(self.stamps_ns[usable], count - len(usable))
        rows = _ordered(where, self.stamps_ns, usable, has_log_times)
        if 0 in columns:
            account.check_norms(self.norms[usable])
        attitude, rates, of_attitude, of_rates = (
            values[rows] if values is not None and column in columns else None
            for column, values in zip(2 * (0, 1), (self.attitude, self.rates, *self.covariances)))
        return Measured(topic, self.stamps_ns[rows], attitude, rates, _known(of_attitude),
                        _known(of_rates), account, self.damage)


def _samples(stamps_ns: NDArray[np.int64], attitude: Floats, rates: Floats, present: _Mask,
             **others: Any) -> MeasuredSamples:
    """Return the samples in messages, with NaN in place of values that are not usable."""
    is_rotation = np.isfinite(attitude).all(axis=1) & attitude.any(axis=1) & present[:, 0]
    is_slow = (np.abs(rates) <= FASTEST).all(axis=1) & present[:, 1]
    unit = np.full(attitude.shape, np.nan)
    unit[is_rotation] = so3.normalize(attitude[is_rotation])
    return MeasuredSamples(stamps_ns, unit, np.where(is_slow[:, None], rates, np.nan), present,
                           np.linalg.norm(attitude, axis=1), **others)


def of_messages(recorded: Messages, kind: MessageType) -> MeasuredSamples:
    """Return the samples in messages of a type in `KINDS`; covariances are in body axes."""
    (attitude, rates), present, (first, second) = zip(*(
        _part(recorded.values, *where, size, kind) for where, size in zip(_LAYOUTS[kind], (4, 3))))
    samples = _samples(recorded.stamps_ns, attitude, rates, np.column_stack(present),
                       damage=recorded.damage)
    if first is not None and kind is not messages.IMU:  # in space axes
        first = _turned(first, so3.matrix(so3.conjugate(samples.attitude)), samples.usable[:, 0])
    return replace(samples, covariances=(first, second))


def _part(values: Floats, where: slice | None, of_covariance: slice | None, size: int,
          kind: MessageType) -> tuple[Floats, _Mask, Floats | None]:
    """Return a quantity of messages, which of them contain it, and its covariances."""
    if where is None:
        return np.full((len(values), size), np.nan), np.full(len(values), False), None
    present = np.full(len(values), True)
    if of_covariance is None:
        return values[:, where], present, None
    width = 3 if kind is messages.IMU else 6  # of six variables, the last three are the rotation
    covariances = values[:, of_covariance].reshape(-1, width, width)[:, -3:, -3:]
    present &= ~(np.diagonal(covariances, axis1=1, axis2=2) >= _MEANINGLESS).any(axis=1)
    if kind is messages.IMU:
        present &= values[:, of_covariance.start] != -1.0
    return values[:, where], present, covariances


def of_table(path: str | Path, columns: Mapping[str, str] | None = None) -> MeasuredSamples:
    """Return the samples in a CSV file or a TUM trajectory; see `Table`."""
    table = Table(path, [ATTITUDE, RATES], columns)
    blocks = [*table]
    stamps_ns = np.concatenate([np.empty(0, np.int64), *(stamps_ns for stamps_ns, _ in blocks)])
    values = np.concatenate([np.empty((0, len(table.names))), *(values for _, values in blocks)])
    attitude, rates = (
        values[:, [table.names.index(name) for name in group]] if group[0] in table.names else
        np.full((len(values), len(group)), np.nan) for group in (ATTITUDE, RATES))
    present = [is_sample(attitude, table.width) & (ATTITUDE[0] in table.names),
               is_sample(rates, table.width) & (RATES[0] in table.names)]
    return _samples(stamps_ns, attitude, rates, np.column_stack(present), notes=tuple(table.notes))


def _turned(covariances: Floats | None, rotation: Floats, rows: _Mask) -> Floats | None:
    """Convert the covariances in some rows to other axes, as `rotation` converts vectors."""
    return None if covariances is None else np.where(
        rows[:, None, None], rotation @ covariances @ np.swapaxes(rotation, -2, -1), covariances)


def _known(covariances: Floats | None) -> Floats | None:
    """Return the covariances, or None if any is not positive definite."""
    is_known = covariances is not None and np.all(np.abs(covariances) < _MEANINGLESS) and not any(
        np.any(np.linalg.det(covariances[:, :size, :size]) <= 0.0) for size in (1, 2, 3))
    return covariances if is_known else None


def _ordered(where: str, stamps_ns: NDArray[np.int64], rows: NDArray[np.intp],
             has_log_times: bool) -> NDArray[np.intp]:
    """Sort rows by stamp, keeping only the last of several rows with the same stamp."""
    without = int(np.sum(stamps_ns[rows] == 0))
    if without > 1 and has_log_times:
        raise InputError(f'{where}: expected stamps in the headers, found 0 in {without} of '
                         f'{len(rows)} messages; use --time-source log for the times of the '
                         'recording')
    rows = rows[np.argsort(stamps_ns[rows], kind='stable')]
    rows = rows[np.append(np.diff(stamps_ns[rows]) != 0, True)]
    if len(rows) < FEWEST:
        raise InputError(f'{where}: expected at least {FEWEST} different stamps, found '
                         f'{len(rows)}')
    return rows
