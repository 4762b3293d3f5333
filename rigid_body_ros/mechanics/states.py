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

"""Many states of rigid bodies, stored as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instant, instants
from rigid_body_ros.engine import state_layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import is_normalized, State

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


class Poses(NamedTuple):
    """Attitudes x y z w, shape (n, 4), and angular velocities, rad/s, body axes, shape (n, 3)."""

    attitude: Floats
    angular_velocity: Floats

    def rows(self, chosen: int | Sequence[int] | slice | NDArray[np.intp]) -> Poses:
        """Return the attitudes and angular velocities of the chosen rows."""
        return Poses(self.attitude[chosen], self.angular_velocity[chosen])


class States:
    """
    The states of many bodies, some of which may be invalid.

    `states[i]` returns the `State` of row i, or raises ValueError if that state is invalid.

    Parameters
    ----------
    time_ns : int, or array of int, shape (n,), ns
        One time for each state, or one time for all states.
    attitude : array, shape (n, 4) or (4,), or scipy.spatial.transform.Rotation
        One attitude for each state, or one attitude for all states, as for `State`.
    angular_velocity : array, shape (n, 3) or (3,), rad/s, body axes
        One angular velocity for each state, or one angular velocity for all states.
    rotor_momentum : array, shape (n, 3) or (3,), N m s, body axes
        One momentum for each state, or one momentum for all states.

    Attributes
    ----------
    time_ns : array of int64, shape (n,), ns
    attitude : array, shape (n, 4)
        x y z w, normalised as in `State`. The attitude of an invalid state is as given.
    angular_velocity : array, shape (n, 3), rad/s, body axes
    rotor_momentum : array, shape (n, 3), N m s, body axes
    has_rotors : array of bool, shape (n,)
        Whether each state has a nonzero rotor momentum.
    messages : tuple of n str
        For an invalid state, the message of the error that `State` raises. For a valid state, an
        empty string.

    Raises
    ------
    ValueError
        An array has the wrong shape, or a time does not fit in int64.
    TypeError
        A time is not an integer.

    """

    def __init__(self, time_ns: int | NDArray[np.int64] = 0,
                 attitude: ArrayLike | Rotation = (0.0, 0.0, 0.0, 1.0),
                 angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
                 rotor_momentum: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        if hasattr(attitude, 'as_quat'):
            attitude = attitude.as_quat()
        times = instants(time_ns) if isinstance(time_ns, np.ndarray) \
            else np.array([instant(time_ns)])
        q, w = _rows(attitude, 4, 'attitude'), _rows(angular_velocity, 3, 'angular_velocity')
        h = _rows(rotor_momentum, 3, 'rotor_momentum')
        sizes = {'time_ns': len(times), 'attitude': len(q), 'angular_velocity': len(w),
                 'rotor_momentum': len(h)}
        count = next((size for size in sizes.values() if size != 1), 1)
        for name, size in sizes.items():
            if size not in (1, count):
                raise ValueError(f'{name}: expected {count} rows, found {size}')
        valid = np.asarray(np.isfinite(q).all(axis=1) & q.any(axis=1))
        turned = valid.copy()
        turned[valid] = ~is_normalized(q[valid])
        q[turned] = so3.normalize(q[turned])
        self.time_ns: NDArray[np.int64] = _read_only(times, (count,))
        self.attitude: Floats = _read_only(q, (count, 4))
        self.angular_velocity: Floats = _read_only(w, (count, 3))
        self.rotor_momentum: Floats = _read_only(h, (count, 3))
        self.has_rotors: NDArray[np.bool_] = np.asarray(self.rotor_momentum.any(axis=1))
        self.messages = self._messages(np.broadcast_to(valid, count))

    def __len__(self) -> int:
        return len(self.time_ns)

    def __getitem__(self, row: int) -> State:
        return State(int(self.time_ns[row]), self.attitude[row], self.angular_velocity[row],
                     self.rotor_momentum[row])

    def __repr__(self) -> str:
        return f'States({len(self)} states, {sum(map(bool, self.messages))} invalid)'

    @property
    def _packed(self) -> Floats:
        """Return all states as one array, shape (n, state_layout.WITH_WHEELS)."""
        packed = np.zeros((len(self), state_layout.WITH_WHEELS))
        for rows, value in ((state_layout.attitude(packed.T), self.attitude),
                            (state_layout.angular_velocity(packed.T), self.angular_velocity)):
            rows[:] = value.T
        return packed

    def _messages(self, valid: NDArray[np.bool_]) -> tuple[str, ...]:
        messages = [''] * len(self)
        for vectors in (self.angular_velocity, self.rotor_momentum):
            valid = valid & np.isfinite(vectors).all(axis=1)
        for row in np.flatnonzero(~valid).tolist():
            try:
                self[row]
            except ValueError as error:
                messages[row] = str(error)
        return tuple(messages)


def _rows(values: ArrayLike, size: int, name: str) -> Floats:
    rows = np.array(values, float, ndmin=2)
    if rows.ndim != 2 or rows.shape[1] != size:
        raise ValueError(f'{name}: expected shape (n, {size}), found {np.shape(values)}')
    return rows


def _read_only(rows: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    rows = np.array(np.broadcast_to(rows, shape))
    rows.flags.writeable = False
    return rows
