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

"""The measurements of one sensor, stored as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instants
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording.account import Account

#: Minimum number of samples needed for a comparison with a motion.
FEWEST = 4
#: A quantity that stays the same to the last bit is not measured if the other quantity of the same
#: messages turns the body by more than this angle, rad.
_TURNS = 0.1
#: Largest accepted deviation of the norm of a quaternion from 1.
_UNIT = 1e-6


@dataclass(frozen=True)
class Measured:
    """
    The measurements of one sensor, from one topic.

    Attributes
    ----------
    topic : str
    stamps_ns : array of int64, shape (n,)
        Time of each sample in ns, in increasing order.
    attitude : array, shape (n, 4), optional
        Unit quaternions x, y, z, w from body to space axes. None if the topic contains no
        attitudes.
    angular_velocity : array, shape (n, 3), optional
        Angular velocities in body axes, rad/s. None if the topic contains no angular velocities.
    attitude_covariance : array, shape (n, 3, 3), optional
        Covariance of the attitude error, rad^2. The error is a rotation vector in body axes. None
        if the covariance is unknown.
    rate_covariance : array, shape (n, 3, 3), optional
        Covariance of the angular velocity in body axes, rad^2/s^2. None if the covariance is
        unknown.
    account : Account
        What became of the messages: how many were rejected, and why.
    damage : str
        A description of what was lost from the recording. Empty if nothing was lost.
    frames : str
        A sentence that says how the frames named in the messages differ from the frames of the
        scene, for example another child frame than `body_frame`. Empty if the frames agree.

    """

    topic: str
    stamps_ns: NDArray[np.int64]
    attitude: Floats | None
    angular_velocity: Floats | None
    attitude_covariance: Floats | None = None
    rate_covariance: Floats | None = None
    account: Account = field(default_factory=Account)
    damage: str = ''
    frames: str = ''

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def is_attitude(self) -> bool:
        """Return whether the topic contains attitudes."""
        return self.attitude is not None

    @property
    def values(self) -> Floats:
        """Return the attitudes, or the angular velocities if there are no attitudes."""
        values = self.angular_velocity if self.attitude is None else self.attitude
        assert values is not None
        return values

    def channels(self) -> Iterator[Measured]:
        """Generate each measured quantity as a separate sensor, attitudes first."""
        stamps_ns = np.asarray(self.stamps_ns, np.int64)
        if self.attitude is not None:
            yield Measured(self.topic, stamps_ns, np.asarray(self.attitude, float), None)
        if self.angular_velocity is not None:
            yield Measured(self.topic, stamps_ns, None, np.asarray(self.angular_velocity, float))

    def check(self) -> None:
        """
        Check that all attributes are valid.

        Raises
        ------
        ValueError
            There are fewer than four samples, stamps do not increase, neither attitudes nor
            angular velocities are given, a shape does not match, a value is not finite, an
            angular velocity is above 1e9 rad/s, or an attitude is not a unit quaternion.

        """
        count = len(instants(self.stamps_ns, f'{self.topic}: stamps'))
        if count < FEWEST:
            raise ValueError(f'{self.topic}: expected at least {FEWEST} samples, found {count}')
        if not np.all(np.diff(self.stamps_ns) > 0):
            raise ValueError(f'{self.topic}: expected increasing stamps, found others')
        if self.attitude is None and self.angular_velocity is None:
            raise ValueError(f'{self.topic}: expected attitudes or angular velocities, '
                             'found neither')
        for name, values, size in (('attitude', self.attitude, 4),
                                   ('angular_velocity', self.angular_velocity, 3)):
            if values is None:
                continue
            if values.shape != (count, size) or not np.isfinite(values).all():
                raise ValueError(f'{self.topic}: {name}: expected finite numbers of shape '
                                 f'({count}, {size}), found {values.shape} with '
                                 f'{np.sum(~np.isfinite(values))} that are not finite')
        fastest = 0.0 if self.angular_velocity is None else np.abs(self.angular_velocity).max()
        if fastest > FASTEST:
            raise ValueError(f'{self.topic}: angular_velocity: expected at most {FASTEST:g} '
                             f'rad/s, found {fastest:g} rad/s')
        if self.attitude is not None:
            norms = np.linalg.norm(self.attitude, axis=1)
            if np.abs(norms - 1.0).max() > _UNIT:
                raise ValueError(f'{self.topic}: attitude: expected unit quaternions, found norms '
                                 f'from {norms.min():.6g} to {norms.max():.6g}')

    def between(self, begin_ns: int, end_ns: int) -> Measured:
        """Return the samples with begin_ns <= stamp < end_ns."""
        return self.rows(slice(*np.searchsorted(self.stamps_ns, [begin_ns, end_ns]).tolist()))

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Measured:
        """Return a selection of the samples."""
        def of(values: Floats | None) -> Floats | None:
            return None if values is None else values[chosen]
        return replace(self, stamps_ns=self.stamps_ns[chosen], attitude=of(self.attitude),
                       angular_velocity=of(self.angular_velocity),
                       attitude_covariance=of(self.attitude_covariance),
                       rate_covariance=of(self.rate_covariance))


def faults_of(torques: Account | None, sensors: Iterable[Measured]) -> list[str]:
    """Return what is wrong with recorded samples, so that no cause can be inferred from them."""
    accounts = torques, *(sensor.account for sensor in sensors)
    return [fault for account in accounts if account for fault in account.faults]


def not_measured(stamps_ns: NDArray[np.int64], attitude: Floats, rates: Floats) -> tuple[str, str]:
    """
    Tell which quantity of the same messages is not measured, because it never changes.

    An Imu message whose publisher does not know the orientation often contains the identity.

    Parameters
    ----------
    stamps_ns, attitude, rates : array, shape (n,), (n, 4) and (n, 3)
        Stamps in any order, quaternions, and angular velocities, rad/s.

    Returns
    -------
    name, note : str
        'attitude', 'rates' or '', and why.

    """
    if (attitude == attitude[:1]).all():
        order = np.argsort(stamps_ns, kind='stable')
        steps = 1e-9 * np.diff(stamps_ns[order])[:, None]
        turns = np.linalg.norm(np.cumsum(rates[order][:-1] * steps, axis=0), axis=1)
        turned = float(turns.max(initial=0.0))
        if turned > _TURNS:
            return 'attitude', f'the attitude is not used: it is {attitude[0].tolist()} in all ' \
                f'messages, although their angular velocity turns the body by {turned:.3g} rad'
    elif not rates.any():
        turned = float(so3.angle_between(*map(so3.normalize, (attitude[:1], attitude))).max())
        if turned > _TURNS:
            return 'rates', 'the angular velocity is not used: it is zero in all messages, ' \
                f'although their attitude turns by {turned:.3g} rad'
    return '', ''
