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

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics import so3
from rigid_body_ros.messages import MessageType
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.headings import ATTITUDE, RATES
from rigid_body_ros.recording.measured import FEWEST, Measured, not_measured
from rigid_body_ros.recording.source import Messages
from rigid_body_ros.recording.text_files import is_sample, Table

#: A value whose variance is at least this large, rad^2 or rad^2/s^2, counts as not measured.
_MEANINGLESS = 1e3
#: Attitudes and angular velocities are one sensor if at least this fraction of the messages that
#: contain one of them contains both.
_TOGETHER = 0.9
_Mask = NDArray[np.bool_]


class _Layout(NamedTuple):
    """Where the values and their covariances are among the doubles of a message."""

    attitude: slice | None = None
    attitude_covariance: slice | None = None
    rates: slice | None = None
    rate_covariance: slice | None = None


_LAYOUTS: dict[MessageType, _Layout] = {
    messages.QUATERNION: _Layout(slice(0, 4)),
    messages.POSE: _Layout(slice(3, 7)),
    messages.POSE_WITH_COVARIANCE: _Layout(slice(3, 7), slice(7, 43)),
    messages.TRANSFORM_STAMPED: _Layout(slice(3, 7)),
    messages.TRANSFORM: _Layout(slice(3, 7)),
    messages.ODOMETRY: _Layout(messages.ORIENTATION, slice(7, 43), messages.ANGULAR_VELOCITY,
                               slice(49, 85)),
    messages.IMU: _Layout(slice(0, 4), slice(4, 13), slice(13, 16), slice(16, 25)),
    messages.VECTOR3: _Layout(rates=slice(0, 3)),
}
#: Message types that a measured topic can have.
KINDS = tuple(_LAYOUTS)


class Quantity(NamedTuple):
    """
    Attitudes or angular velocities, with one row for each message.

    Attributes
    ----------
    values : array, shape (n, 4) or (n, 3)
        Quaternions, not normalised, or angular velocities, rad/s.
    is_given, is_usable : array of bool, shape (n,)
        Whether a message contains the quantity, and whether its value can also be used.
    covariance : array, shape (n, 3, 3), optional

    """

    values: Floats
    is_given: _Mask
    is_usable: _Mask
    covariance: Floats | None = None


@dataclass(frozen=True, eq=False)
class MeasuredSamples:
    """
    The attitudes and angular velocities in the messages of a topic or the lines of a table.

    Attributes
    ----------
    stamps_ns : array of int64, shape (n,)
        In the order of the recording.
    attitude, rates : Quantity, optional
    damage : str
        What was lost from the recording.
    notes : tuple of str
        What was converted, assumed or left out.

    """

    stamps_ns: NDArray[np.int64]
    attitude: Quantity | None
    rates: Quantity | None
    damage: str = ''
    notes: tuple[str, ...] = ()

    def rates_from_space(self, rows: _Mask, frame: str) -> MeasuredSamples:
        """Convert angular velocities in space axes to body axes, which needs attitudes."""
        attitude, rates = self.attitude, self.rates
        assert attitude
        assert rates
        known = rows & attitude.is_usable
        values = rates.values.copy()
        values[known] = so3.rotate(so3.conjugate(so3.normalize(attitude.values[known])),
                                   values[known])
        note = f'the angular velocity is in the axes of {frame} (space): converted to body axes'
        return replace(self, notes=(*self.notes, note), rates=rates._replace(
            values=values, is_usable=rates.is_usable & (known | ~rows)))

    def from_link(self, rows: _Mask, rotation: Floats, frame: str) -> MeasuredSamples:
        """
        Convert measurements in the axes of a link to body axes.

        `rotation`, shape (3, 3), contains the axes of the link as columns, in body axes.
        """
        turn = so3.from_matrix(rotation)

        def converted(quantity: Quantity | None, is_rates: bool) -> Quantity | None:
            if quantity is None:
                return None
            values, covariance = quantity.values.copy(), quantity.covariance
            values[rows] = so3.rotate(turn, values[rows]) if is_rates else so3.multiply(
                values[rows], so3.conjugate(turn))
            if covariance is not None:
                covariance = covariance.copy()
                covariance[rows] = rotation @ covariance[rows] @ rotation.T
            return quantity._replace(values=values, covariance=covariance)
        note = f'the measurements are in the axes of {frame}: converted to body axes'
        return replace(self, attitude=converted(self.attitude, False),
                       rates=converted(self.rates, True), notes=(*self.notes, note))

    def without_constants(self) -> MeasuredSamples:
        """Drop a quantity that never changes, if the other one says that the body turns."""
        if self.attitude is None or self.rates is None:
            return self
        both = np.flatnonzero(self.attitude.is_usable & self.rates.is_usable)
        both = both[np.argsort(self.stamps_ns[both], kind='stable')]
        name, note = not_measured(self.stamps_ns[both], self.attitude.values[both],
                                  self.rates.values[both])
        return replace(self.without([name]), notes=(*self.notes, note)) if name else self

    def without(self, names: Collection[str]) -> MeasuredSamples:
        """Drop quantities: 'attitude', 'rates'."""
        return replace(self, attitude=None if 'attitude' in names else self.attitude,
                       rates=None if 'rates' in names else self.rates)

    @property
    def usable(self) -> tuple[Floats, Floats]:
        """
        Return unit quaternions, shape (n, 4), and angular velocities, rad/s, shape (n, 3).

        Values that are not measured or not usable are NaN.
        """
        attitude, rates = (np.full((len(self.stamps_ns), size), np.nan) for size in (4, 3))
        for values, quantity in ((attitude, self.attitude), (rates, self.rates)):
            if quantity:
                values[quantity.is_usable] = quantity.values[quantity.is_usable]
        return so3.normalize(attitude), rates

    def sensors(self, where: str, topic: str, has_log_times: bool) -> Iterator[Measured]:
        """
        Generate the usable samples as a sensor, sorted by stamp.

        Generate two sensors if attitudes and angular velocities are in different messages.

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
        named = [(name, each) for name, each in (('attitude', self.attitude),
                                                 ('rates', self.rates))
                 if each is not None and each.is_usable.any()]
        usable = [each.is_usable for _, each in named]
        if len(named) == 2 and (usable[0] & usable[1]).sum() < _TOGETHER * max(
                usable[0].sum(), usable[1].sum()):
            for name, each in named:
                yield self._sensor(where, f'{topic}:{name}', each.is_given, {name: each},
                                   has_log_times)
        else:
            given = [each.is_given for _, each in named]
            yield self._sensor(where, topic, np.logical_or.reduce(
                given or [np.full(len(self.stamps_ns), True)]), dict(named), has_log_times)

    def _sensor(self, where: str, topic: str, given: _Mask, quantities: Mapping[str, Quantity],
                has_log_times: bool) -> Measured:
        usable = np.logical_and.reduce([np.full(len(given), bool(quantities)), *(
            each.is_usable for each in quantities.values())])
        count = int(usable.sum())
        if count < FEWEST:
            lost = f' ({self.damage})' if self.damage else ''
            raise InputError(f'{where}: expected at least {FEWEST} messages with a finite '
                             f'attitude or angular velocity, found {count} among '
                             f'{len(given)}{lost}')
        account = Account(Account.advice if has_log_times else '', notes=[*self.notes])
        account.add(self.stamps_ns[usable], int(given.sum()) - count)
        rows = _ordered(where, self.stamps_ns, np.flatnonzero(usable), has_log_times)
        attitude, rates = (quantities.get(name) for name in ('attitude', 'rates'))
        if attitude:
            account.check_norms(attitude.values[usable])
        return Measured(
            topic, self.stamps_ns[rows],
            so3.normalize(attitude.values[rows]) if attitude else None,
            rates.values[rows] if rates else None, _known(attitude, rows), _known(rates, rows),
            account, self.damage)


def of_messages(recorded: Messages, kind: MessageType) -> MeasuredSamples:
    """Return the samples in messages of a type in `KINDS`; covariances are in body axes."""
    layout, values = _LAYOUTS[kind], recorded.values
    attitude = _quantity(values, layout.attitude, layout.attitude_covariance, kind, _is_rotation)
    rates = _quantity(values, layout.rates, layout.rate_covariance, kind, _is_slow)
    if attitude and attitude.covariance is not None and kind in (
            messages.POSE_WITH_COVARIANCE, messages.ODOMETRY):
        turn = so3.matrix(so3.normalize(np.where(attitude.is_usable[:, None], attitude.values,
                                                 [0.0, 0.0, 0.0, 1.0])))
        attitude = attitude._replace(
            covariance=np.swapaxes(turn, 1, 2) @ attitude.covariance @ turn)
    return MeasuredSamples(recorded.stamps_ns, attitude, rates, recorded.damage)


def of_table(path: str | Path, columns: Mapping[str, str] | None = None) -> MeasuredSamples:
    """Return the samples in a CSV file or a TUM trajectory; see `Table`."""
    table = Table(path, [ATTITUDE, RATES], columns)
    blocks = [*table]
    stamps_ns = np.concatenate([np.empty(0, np.int64), *(stamps_ns for stamps_ns, _ in blocks)])
    values = np.concatenate([np.empty((0, len(table.names))), *(values for _, values in blocks)])

    def quantity(group: Sequence[str], is_possible: Callable[[Floats], _Mask]) -> Quantity | None:
        if not {*group} <= {*table.names}:
            return None
        found = values[:, [table.names.index(name) for name in group]]
        given = is_sample(found, table.width)
        return Quantity(found, given, given & is_possible(found))
    return MeasuredSamples(stamps_ns, quantity(ATTITUDE, _is_rotation), quantity(RATES, _is_slow),
                   notes=tuple(table.notes))


def _is_rotation(attitude: Floats) -> _Mask:
    return np.asarray(np.isfinite(attitude).all(axis=1) & attitude.any(axis=1))


def _is_slow(rates: Floats) -> _Mask:
    return np.all(np.abs(rates) <= FASTEST, axis=1)


def _quantity(values: Floats, where: slice | None, covariance: slice | None, kind: MessageType,
              is_possible: Callable[[Floats], _Mask]) -> Quantity | None:
    """Return a quantity of messages, or None if their type has no field for it."""
    if where is None:
        return None
    found, given, block = values[:, where], np.full(len(values), True), None
    if covariance is not None:
        if kind is messages.IMU:
            given &= values[:, covariance.start] != -1.0
        block = _block(values[:, covariance])
        given &= ~(np.diagonal(block, axis1=1, axis2=2) >= _MEANINGLESS).any(axis=1)
    return Quantity(found, given, given & is_possible(found), block)


def _block(covariances: Floats) -> Floats:
    """Return the rotational (n, 3, 3) parts of covariances with 9 or 36 entries each."""
    size = 3 if covariances.shape[1] == 9 else 6
    return covariances.reshape(-1, size, size)[:, size - 3:, size - 3:]


def _known(quantity: Quantity | None, rows: NDArray[np.intp]) -> Floats | None:
    """Return the covariances in the given rows; None if any is not positive definite."""
    if quantity is None or quantity.covariance is None:
        return None
    found = quantity.covariance[rows]
    is_known = np.all(np.abs(found) < _MEANINGLESS) and not any(
        np.any(np.linalg.det(found[:, :size, :size]) <= 0.0) for size in (1, 2, 3))
    return found if is_known else None


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
