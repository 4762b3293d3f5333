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

"""The state of a rigid body."""

from __future__ import annotations

from dataclasses import dataclass, field
import math
import struct
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats, written
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.common.times import instant
from rigid_body_ros.engine import state_layout

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

#: A quaternion is normalized if its norm differs from 1 by at most this.
_NORMALIZED = 4.0 * float(np.finfo(float).eps)
#: The angular velocity, a zero, the attitude, and the zeros that follow; see `state_layout`.
_PACKED = struct.Struct(f'8d{8 * (state_layout.WITH_WHEELS - 8)}x')
#: The rotor momentum, with zeros as its low-order part.
_ROTORS = struct.Struct('3d24x')
_ZERO = 0.0, 0.0, 0.0
_NO_ROTORS, _NO_WHEELS = np.zeros((2, 3)), np.empty(0)
_NO_ROTORS.flags.writeable = _NO_WHEELS.flags.writeable = False


@dataclass(frozen=True, eq=False, init=False)
class State:
    """
    The attitude, angular velocity and rotor momentum of a body at an instant.

    Parameters
    ----------
    time_ns : int, ns
    attitude : array, shape (4,), or scipy.spatial.transform.Rotation
        The quaternion x y z w that maps body vectors to space vectors. It is normalised unless its
        norm is already 1 within 4 eps.
    angular_velocity : array, shape (3,), rad/s, body axes
    rotor_momentum : array, shape (3,), N m s, body axes
        The angular momentum of all rotors (reaction wheels, propellers) relative to the body. If
        `wheel_speeds` is given, include the momentum of these wheels, or leave `rotor_momentum` at
        zero if there are no other rotors.
    wheel_speeds : array, shape (k,), rad/s
        The speeds of k named wheels relative to the body. If the array is empty, the wheels start
        at their `initial_speed`, and `rotor_momentum` must not include them.

    Raises
    ------
    ValueError
        An array has the wrong shape, a component is not finite, the quaternion is zero, or the
        time does not fit in int64.
    TypeError
        The time is not an integer.

    """

    time_ns: int
    attitude: Floats
    angular_velocity: Floats
    rotor_momentum: Floats
    wheel_speeds: Floats
    #: The components of the state, in the layout that `state_layout` defines.
    _packed: Floats = field(init=False, repr=False)
    #: The rotor momentum and its low-order part, shape (2, 3). If `_axial` is not None, this
    #: attribute contains the rotor momentum of the carrier; see `Wheels`.
    _rotors: Floats = field(init=False, repr=False)
    #: The step grid from which the state was computed (an `Origin`), or None.
    _origin: object = field(init=False, repr=False)
    #: The motor torques on the named wheels from `time_ns` onward, N m, shape (k,).
    wheel_efforts: Floats = field(init=False, repr=False)
    #: The state of the wheels (an `Axial`), or None.
    _axial: object = field(init=False, repr=False, default=None)

    @classmethod
    def _as_computed(cls, time_ns: int, packed: Floats, origin: object = None,
                     rotors: Floats = _NO_ROTORS) -> State:
        """Return a state with exactly the given numbers; do not normalise the quaternion."""
        state = object.__new__(cls)
        packed.setflags(write=False)
        state._fill(time_ns, packed, origin, rotors)
        return state

    def _fill(self, time_ns: int, packed: Floats, origin: object, rotors: Floats) -> None:
        own = self.__dict__
        own['time_ns'], own['_packed'], own['_origin'] = time_ns, packed, origin
        own['attitude'] = state_layout.attitude(packed)
        own['angular_velocity'] = state_layout.angular_velocity(packed)
        if rotors is not _NO_ROTORS:
            own['rotor_momentum'], own['_rotors'] = rotors[0], rotors

    def __init__(self, time_ns: int = 0,
                 attitude: ArrayLike | Rotation = (0.0, 0.0, 0.0, 1.0),
                 angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
                 rotor_momentum: ArrayLike = _ZERO,
                 wheel_speeds: ArrayLike = ()) -> None:
        if hasattr(attitude, 'as_quat'):  # a Rotation; checking the type would import SciPy
            attitude = attitude.as_quat()
        q = _checked_vector(attitude, 4, 'attitude quaternion (x, y, z, w)')
        if abs(_norm(*q) - 1.0) > _NORMALIZED:
            if not any(q):
                raise ValueError('attitude quaternion (x, y, z, w): expected a non-zero '
                                 f'quaternion, found {q}')
            q = _normalized(q)
        w = _checked_vector(angular_velocity, 3, 'angular velocity')
        packed = np.frombuffer(_PACKED.pack(*w, 0.0, *q))
        self._fill(instant(time_ns), packed, None, _NO_ROTORS if rotor_momentum is _ZERO
                   else _checked_rotors(rotor_momentum))
        if not isinstance(wheel_speeds, tuple) or wheel_speeds:
            speeds = np.array(_checked_vector(wheel_speeds, np.size(wheel_speeds),
                                              'wheel speeds'))
            speeds.flags.writeable = False
            self.__dict__['wheel_speeds'] = speeds

    @property
    def _has_rotors(self) -> bool:
        # The first test saves the call of `any` in most states. This call would take a tenth of
        # the time of a short run.
        return self._rotors is not _NO_ROTORS and bool(self._rotors.any())

    def __repr__(self) -> str:
        rotors = f', rotor momentum {written(self.rotor_momentum)} N m s' \
            if self.rotor_momentum.any() else ''
        return (f'State(time {self.time_ns} ns, attitude xyzw {written(self.attitude)}, '
                f'angular velocity {written(self.angular_velocity)} rad/s{rotors})')


# These defaults are class attributes, because storing them in every state would take a tenth of
# the time needed to construct a state.
for _name, _default in (('wheel_speeds', _NO_WHEELS), ('wheel_efforts', _NO_WHEELS),
                        ('rotor_momentum', _NO_ROTORS[0]), ('_rotors', _NO_ROTORS)):
    type.__setattr__(State, _name, _default)


def is_normalized(q: Floats) -> NDArray[np.bool_]:
    """Return whether quaternions, shape (n, 4), have norm 1 within 4 eps."""
    return np.asarray(abs(np.sqrt(np.sum(q * q, axis=-1)) - 1.0) <= _NORMALIZED)


# Plain numbers take a fraction of the time of `is_normalized` and `so3.normalize`, which are for
# many quaternions, and give the same bits.
def _norm(x: float, y: float, z: float, w: float) -> float:
    return math.sqrt(x * x + y * y + z * z + w * w)


def _normalized(q: list[float]) -> list[float]:
    x, y, z, w = q
    largest = max(abs(x), abs(y), abs(z), abs(w))
    x, y, z, w = x / largest, y / largest, z / largest, w / largest
    norm = _norm(x, y, z, w)
    return [x / norm, y / norm, z / norm, w / norm]


def _checked_rotors(momentum: ArrayLike) -> Floats:
    high = _checked_vector(momentum, 3, 'rotor momentum')
    return np.frombuffer(_ROTORS.pack(*high)).reshape(2, 3) if any(high) else _NO_ROTORS


def all_finite(numbers: list[float]) -> bool:
    """Return whether all numbers are finite. Their sum is, too, unless it overflows."""
    return math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))


def _checked_vector(values: ArrayLike, size: int, what: str) -> list[float]:
    # Three or four numbers are checked faster in a list than in an array.
    vector = np.asarray(values, float)
    numbers: list[float] = vector.tolist()
    if vector.shape != (size,) or not all_finite(numbers):
        raise ValueError(f'{what}: expected {size} finite numbers, found {quoted(numbers)}')
    return numbers
