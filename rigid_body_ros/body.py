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
The rigid body, its state, and the relations between torque, momentum and rotation.

Body axes unless a name says `_space`. Formulas as in Goldstein, Classical Mechanics, chapters
4 and 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros import so3, urdf
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instant
from rigid_body_ros.kernels import body_layout, state_layout
from rigid_body_ros.kernels import tensor as constants

Result = TypeVar('Result')

#: Relative size of what rounding may do to a tensor that was rotated or put together in doubles.
ROUNDING = 1e-12
#: Largest `triangle_excess` that is taken. Published tensors are rounded to two or three digits,
#: which puts thin plates beyond what a distribution of mass can have; the motion is well defined.
TRIANGLE_EXCESS = 0.03
#: Bound on the relative rounding error of a weighted sum over up to a million point masses, where
#: numpy adds in pairs.
_SUMMED = 40.0 * np.finfo(float).eps


class RigidBody:
    """
    A rigid body with a constant inertia tensor.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        Inertia about the centre of mass in body axes; the entries of the matrix itself, so that
        the products of inertia stand with the sign they have there (as in URDF).

    Attributes
    ----------
    inertia : array, shape (3, 3), kg m^2
    principal_moments : array, shape (3,), kg m^2
        In ascending order.
    principal_axes : array, shape (3, 3)
        The axes of those moments as columns, in body axes, right-handed.
    triangle_excess : float
        By how much, relatively, the largest principal moment exceeds the sum of the other two:
        zero for any real body, up to `TRIANGLE_EXCESS` where published digits were rounded.
    symmetry : str
        'sphere', 'symmetric top' or 'asymmetric top': how many moments agree within rounding.

    Raises
    ------
    ValueError
        The tensor is not 3 by 3, finite, symmetric and positive definite, or its largest
        principal moment exceeds the sum of the others by more than rounded digits explain.

    """

    def __init__(self, tensor: ArrayLike) -> None:
        self.inertia = _checked_tensor(tensor)
        #: Principal moments (2, 3) and axes (2, 3, 3), each with what rounding took from them.
        self._principal = _worked_out(constants.principal, self.inertia)
        self.principal_moments, self.principal_axes = (high.copy() for high, _ in self._principal)
        self.triangle_excess = _checked_excess(self.principal_moments)
        self.symmetry = _symmetry(self.principal_moments)
        #: Euler's equations (2, 3, 9), and all that the kernels need to know.
        self._coefficients = _worked_out(constants.euler_coefficients, self.inertia)
        self._constants = body_layout.pack(self._coefficients, *self._principal)
        self.inertia.flags.writeable = False

    @classmethod
    def from_moments(cls, ixx: float, iyy: float, izz: float,
                     ixy: float = 0.0, ixz: float = 0.0, iyz: float = 0.0) -> RigidBody:
        """Build a body from the six entries of its tensor, kg m^2; errors as for the class."""
        return cls([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])

    @classmethod
    def from_point_masses(cls, masses: ArrayLike, positions: ArrayLike) -> RigidBody:
        """
        Build a body from point masses.

        Parameters
        ----------
        masses : array, shape (n,), kg
            Each greater than zero.
        positions : array, shape (n, 3), m
            In body axes; any origin: the tensor is taken about the common centre of mass.

        Raises
        ------
        ValueError
            A mass is not positive and finite, the shapes do not agree, or the masses lie on one
            line within rounding: nearer to it than about 1e-7 of its length, or 1e-14 of the
            distance from the origin.

        """
        masses, positions = np.asarray(masses, float), np.asarray(positions, float)
        if masses.ndim != 1 or positions.shape != (masses.size, 3):
            raise ValueError('expected masses of shape (n,) and positions of shape (n, 3), '
                             f'found {masses.shape} and {positions.shape}')
        if not (masses.size and np.all(masses > 0.0) and np.isfinite(masses).all()):
            raise ValueError(f'expected finite masses greater than zero, found {masses.tolist()}')
        columns = np.ascontiguousarray(positions.T)  # numpy adds in pairs along rows only
        arms = columns - (masses * columns).sum(axis=1)[:, None] / masses.sum()
        squares = ((masses * arms)[:, None] * arms).sum(axis=2)
        tensor = _checked_tensor(np.trace(squares) * np.eye(3) - squares)
        _check_thickness(tensor, masses.sum(), float(np.abs(positions).max()))
        return cls(tensor)

    @classmethod
    def from_urdf(cls, text: str, link: str = '') -> RigidBody:
        """
        Build a body from the <inertial> of a URDF link; body axes are those of the link.

        The rotation rpy of its <origin> turns the tensor. The shift xyz does not change it: it is
        about the centre of mass, wherever that lies. Links fixed to this one are not added.

        Parameters
        ----------
        text : str
            The file itself (such as ROS's robot_description), after xacro.
        link : str
            May be empty where only one link has an <inertial>.

        Raises
        ------
        ValueError
            As `urdf.inertia` has it, or the tensor is none, as for the class.

        """
        return cls(urdf.inertia(text, link))

    def moment_about(self, axis: ArrayLike) -> float:
        """Return the moment of inertia n J n, kg m^2, about an axis through the centre of mass."""
        direction = so3.normalize(axis)
        return float(np.sum(direction * self.angular_momentum(direction)))

    def angular_momentum(self, angular_velocity: ArrayLike) -> Floats:
        """Return L = J w, N m s, body axes, shape (..., 3)."""
        return _combined(np.asarray(angular_velocity, float), self.inertia)

    def kinetic_energy(self, angular_velocity: ArrayLike) -> Floats:
        """Return w J w / 2, J, shape (...)."""
        w = np.asarray(angular_velocity, float)
        return 0.5 * np.sum(w * self.angular_momentum(w), axis=-1)

    def angular_acceleration(self, angular_velocity: ArrayLike,
                             torque: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
        """
        Return dw/dt, rad/s^2, from Euler's equations J dw/dt = (J w) x w + tau.

        Parameters
        ----------
        angular_velocity : array, shape (..., 3), rad/s, body axes
            Broadcast against `torque`.
        torque : array, shape (..., 3), N m, body axes
            About the centre of mass.

        Returns
        -------
        array, shape (..., 3)

        """
        w, torque = np.broadcast_arrays(np.asarray(angular_velocity, float), torque)
        products = np.concatenate([np.roll(w, -1, -1) * np.roll(w, -2, -1), w * w, torque], -1)
        return _combined(products, self._coefficients[0].T)

    def torque(self, angular_velocity: ArrayLike, angular_acceleration: ArrayLike) -> Floats:
        """Return the body torque tau = (dL/dt)_space in body axes, N m, shape (..., 3)."""
        change = self.angular_momentum(angular_acceleration)
        return rate_in_space(change, angular_velocity, self.angular_momentum(angular_velocity))


def _combined(factors: Floats, rows: Floats) -> Floats:
    # The product factors @ rows, added up in order: that of BLAS depends on the processor.
    total = factors[..., :1] * rows[0]
    for k in range(1, len(rows)):
        total = total + factors[..., k:k + 1] * rows[k]
    return total


def rate_in_space(rate_in_body: ArrayLike, angular_velocity: ArrayLike,
                  vector: ArrayLike) -> Floats:
    """
    Return the rate of a vector as seen from space: (dA/dt)_space = (dA/dt)_body + w x A.

    Parameters
    ----------
    rate_in_body : array, shape (..., 3)
        Time derivative of the body components of A.
    angular_velocity : array, shape (..., 3), rad/s, body axes
        Of the body, w: that of its axes against those of space.
    vector : array, shape (..., 3)
        A, body axes.

    Returns
    -------
    array, shape (..., 3)
        In body axes.

    """
    w, a = np.asarray(angular_velocity, float), np.asarray(vector, float)
    return np.asarray(rate_in_body, float) + np.cross(w, a)


@dataclass(frozen=True, eq=False, init=False)
class State:
    """
    Attitude and angular velocity at an instant.

    Parameters
    ----------
    time_ns : int
    attitude : array, shape (4,)
        x y z w, maps body vectors to space vectors. Normalised, unless it is of unit length
        within 4 eps already.
    angular_velocity : array, shape (3,), rad/s, body axes

    Raises
    ------
    ValueError
        A component is not finite, the quaternion is zero, or the time does not fit int64.
    TypeError
        The time is not an integer.

    """

    time_ns: int
    attitude: Floats
    angular_velocity: Floats
    #: See `state_layout`.
    _packed: Floats = field(init=False, repr=False)
    #: And if it lies between two torque changes, where the steps to it began.
    _origin: object = field(init=False, repr=False)

    @classmethod
    def _as_computed(cls, time_ns: int, packed: Floats, origin: object = None) -> State:
        """Return a state with every bit as it is: no norm is restored."""
        state = object.__new__(cls)
        packed.flags.writeable = False
        for name, value in (('time_ns', time_ns), ('attitude', state_layout.attitude(packed)),
                            ('angular_velocity', state_layout.angular_velocity(packed)),
                            ('_packed', packed),
                            ('_origin', origin)):
            object.__setattr__(state, name, value)
        return state

    def __init__(self, time_ns: int = 0, attitude: ArrayLike = (0.0, 0.0, 0.0, 1.0),
                 angular_velocity: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        q = _checked_vector(attitude, 4, 'attitude quaternion (x, y, z, w)')
        if not q.any():
            raise ValueError('attitude quaternion (x, y, z, w): expected a rotation, '
                             f'found {q.tolist()}')
        if abs(np.sqrt(np.sum(q * q)) - 1.0) > 4.0 * np.finfo(float).eps:
            q = so3.normalize(q)
        w = _checked_vector(angular_velocity, 3, 'angular velocity')
        computed = self._as_computed(instant(time_ns), state_layout.pack(w, q))
        self.__dict__.update(computed.__dict__)


def _checked_vector(values: ArrayLike, size: int, what: str) -> Floats:
    vector = np.array(values, float)
    if vector.shape != (size,) or not np.all(np.isfinite(vector)):
        raise ValueError(f'{what}: expected {size} finite numbers, found {vector.tolist()}')
    return vector


def _checked_tensor(values: ArrayLike) -> Floats:
    tensor = np.array(values, float)
    if tensor.shape != (3, 3) or not np.all(np.isfinite(tensor)):
        raise ValueError(f'inertia: expected 3 by 3 finite numbers, found {tensor.tolist()}')
    if np.max(np.abs(tensor - tensor.T)) > ROUNDING * np.max(np.abs(tensor)):
        raise ValueError(f'inertia: expected a symmetric tensor, found {tensor.tolist()}')
    return 0.5 * tensor + 0.5 * tensor.T


def _check_thickness(tensor: Floats, mass: float, distance: float) -> None:
    """Raise ValueError if rounding alone may make the smallest moment of point masses."""
    moments = np.linalg.eigvalsh(tensor)
    # That of the sums, and that of the positions and of the centre of mass.
    rounding = _SUMMED * moments[2] + mass * (_SUMMED * distance) ** 2
    if moments[0] <= rounding:
        raise ValueError('inertia: expected a positive definite tensor, found masses that lie on '
                         f'one line within rounding: principal moments {moments.tolist()} kg m^2')


def _checked_excess(moments: Floats) -> float:
    smallest, middle, largest = moments
    found = f'found principal moments {smallest:.17g}, {middle:.17g}, {largest:.17g} kg m^2'
    if smallest <= 0.0:
        raise ValueError(f'inertia: expected a positive definite tensor, {found}')
    excess = float(largest / (smallest + middle) - 1.0)
    if excess > TRIANGLE_EXCESS:
        raise ValueError(f'inertia: {found}; in no rigid body does the largest exceed the sum '
                         'of the other two')
    return excess if excess > ROUNDING else 0.0


def _symmetry(moments: Floats) -> str:
    close = np.diff(moments) <= ROUNDING * moments[2]
    return ('asymmetric top', 'symmetric top', 'sphere')[int(close.sum())]


def _worked_out(constant: Callable[[Floats], Result], tensor: Floats) -> Result:
    try:
        return constant(tensor)
    except ArithmeticError:
        raise ValueError('inertia: expected moments that are, and whose inverse is, a finite '
                         f'number, found {tensor.tolist()}') from None
