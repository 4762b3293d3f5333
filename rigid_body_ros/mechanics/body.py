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
The rigid body, and the relations between torque, momentum and rotation.

Vectors are in body axes unless their name ends in `_space`. The formulas are those of Goldstein,
Classical Mechanics, chapters 4 and 5.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats, written
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.engine import body_layout
from rigid_body_ros.engine import tensor as tensor_constants
from rigid_body_ros.mechanics import so3, urdf

#: Largest accepted relative asymmetry of a tensor, and largest relative difference of moments that
#: count as equal. A tensor that was rotated or summed in doubles has a smaller rounding error.
ROUNDING = 1e-12
#: Largest accepted `triangle_excess`. Published tensors have two or three digits, so the tensor of
#: a thin plate may be slightly unphysical. The motion with such a tensor is still well defined.
TRIANGLE_EXCESS = 0.03
#: Largest accepted entry of J^-1 D, 1/s. With this limit, no motion decays by more than a factor
#: of e^3 in the shortest step, a nanosecond.
FASTEST_DAMPING = 1e9
#: Bound on the relative rounding error of a weighted sum over up to a million point masses with
#: numpy's pairwise summation.
_SUMMED = 40.0 * np.finfo(float).eps


class RigidBody:
    """
    A rigid body with a constant inertia tensor.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        Inertia about the centre of mass, body axes, with the rotors locked. The off-diagonal
        entries have the signs of the matrix, as in URDF: ixy is minus the integral of x y dm.
    damping : array, shape (3, 3), N m s/rad, optional
        Damping tensor D, symmetric and positive semidefinite, body axes. The damping torque on the
        body is -D w, where w is the angular velocity.

    Attributes
    ----------
    inertia : array, shape (3, 3), kg m^2, body axes
    damping : array, shape (3, 3), N m s/rad, body axes
    is_damped : bool
        Whether the damping is not zero.
    principal_moments : array, shape (3,), kg m^2
        In ascending order.
    principal_axes : array, shape (3, 3)
        The axes of the principal moments as columns, in body axes, right-handed.
    triangle_excess : float
        Excess of the largest principal moment over the sum of the other two, relative to that
        sum. The excess is zero for any real body. `RigidBody` accepts an excess of up to
        `TRIANGLE_EXCESS`, because the digits of a tensor may be rounded.
    symmetry : str
        'sphere' if all three principal moments are equal within rounding, 'symmetric top' if two
        are equal, otherwise 'asymmetric top'.

    Raises
    ------
    ValueError
        The tensor is not 3 by 3, finite, symmetric and positive definite; its largest principal
        moment exceeds the sum of the others by more than `TRIANGLE_EXCESS`; a moment or its
        inverse does not fit a double; or the damping is not 3 by 3, finite, symmetric and positive
        semidefinite, or is too strong for steps of a nanosecond.

    """

    def __init__(self, tensor: ArrayLike, damping: ArrayLike | None = None) -> None:
        self.inertia = _checked_tensor(tensor)
        self.damping = _checked_damping(damping)
        self.is_damped = bool(self.damping.any())
        #: Principal moments, shape (2, 3), and axes, shape (2, 3, 3): high and low-order parts.
        self._principal = tensor_constants.principal(self.inertia)
        self.principal_moments, self.principal_axes = (high.copy() for high, _ in self._principal)
        self.triangle_excess = _checked_excess(self.principal_moments)
        self.symmetry = _symmetry(self.principal_moments)
        self._set_constants(self.inertia)
        self.inertia.flags.writeable = self.damping.flags.writeable = False

    def _set_constants(self, exact: NDArray[Any]) -> None:
        """Set the constants from a tensor of doubles, or of Fractions that are sums of doubles."""
        self._exact = exact
        #: Coefficients of Euler's equations, shape (2, 3, 9).
        self._coefficients = _euler_coefficients(exact)
        self._constants = body_layout.pack(self._coefficients, *self._principal,
                                           _damping_coefficients(exact, self.damping))

    @classmethod
    def from_moments(cls, ixx: float, iyy: float, izz: float,
                     ixy: float = 0.0, ixz: float = 0.0, iyz: float = 0.0) -> RigidBody:
        """
        Build a body from the six entries of its inertia tensor.

        The method raises the same errors as the class.

        Parameters
        ----------
        ixx, iyy, izz, ixy, ixz, iyz : float, kg m^2
            The entries of the tensor about the centre of mass, in body axes, with the signs of the
            matrix (as in URDF).

        """
        return cls([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])

    @property
    def entries(self) -> Floats:
        """Return ixx, iyy, izz, ixy, ixz, iyz, kg m^2, shape (6,)."""
        return self.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]

    def with_entries(self, entries: Floats) -> RigidBody:
        """Return a body with new entries and the same damping; raise ValueError if not valid."""
        return RigidBody(entries[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]], self.damping)

    @classmethod
    def from_point_masses(cls, masses: ArrayLike, positions: ArrayLike) -> RigidBody:
        """
        Build a body from point masses.

        Parameters
        ----------
        masses : array, shape (n,), kg
            The masses, each greater than zero.
        positions : array, shape (n, 3), m
            The positions in body axes, relative to any origin. The tensor is about the centre of
            mass of all point masses.

        Returns
        -------
        RigidBody

        Raises
        ------
        ValueError
            A mass is not positive and finite, the shapes do not match, or the masses are collinear
            within rounding. Masses count as collinear if their distances from a common line are
            less than about 1e-7 of their extent along the line, or less than about 1e-14 of their
            distance from the origin.

        """
        masses, positions = np.asarray(masses, float), np.asarray(positions, float)
        if masses.ndim != 1 or positions.shape != (masses.size, 3):
            raise ValueError('masses and positions: expected shapes (n,) and (n, 3), '
                             f'found {masses.shape} and {positions.shape}')
        if not (masses.size and np.all(masses > 0.0) and np.isfinite(masses).all()):
            raise ValueError('masses: expected at least one, each finite and greater than zero, '
                             f'found {quoted(masses.tolist())}')
        columns = np.ascontiguousarray(positions.T)  # numpy sums in pairs along rows only
        arms = columns - (masses * columns).sum(axis=1)[:, None] / masses.sum()
        squares = ((masses * arms)[:, None] * arms).sum(axis=2)
        tensor = _checked_tensor(np.trace(squares) * np.eye(3) - squares)
        _check_thickness(tensor, masses.sum(), float(np.abs(positions).max()))
        return cls(tensor)

    @classmethod
    def from_urdf(cls, text: str, link: str = '') -> RigidBody:
        """
        Build a body from the <inertial> of a URDF link; the body axes are the axes of the link.

        The rotation rpy of <origin> is applied to the tensor. The position xyz has no effect,
        because the tensor is about the centre of mass. The inertia of other links is not added,
        even if they are fixed to this link.

        Parameters
        ----------
        text : str
            Contents of the URDF file (such as ROS's robot_description), after xacro.
        link : str
            Name of the link. It may be empty if only one link has an <inertial>.

        Returns
        -------
        RigidBody

        Raises
        ------
        ValueError
            The URDF is not valid (see `urdf.inertia`), or its tensor is not valid for a rigid body
            (see the class).

        """
        return cls(urdf.inertia(text, link))

    def __repr__(self) -> str:
        return (f'RigidBody({self.symmetry}, principal moments '
                f'{written(self.principal_moments)} kg m^2)')

    def moment_about(self, axis: ArrayLike) -> float:
        """Return the moment of inertia n . J n, kg m^2, about a body axis n, shape (3,)."""
        direction = so3.normalize(axis)
        return float(np.sum(direction * self.angular_momentum(direction)))

    def angular_momentum(self, angular_velocity: ArrayLike) -> Floats:
        """
        Return the angular momentum J w.

        Parameters
        ----------
        angular_velocity : array, shape (..., 3), rad/s
            The angular velocity w in body axes.

        Returns
        -------
        array, shape (..., 3), N m s, body axes

        """
        return _product(np.asarray(angular_velocity, float), self.inertia)

    def kinetic_energy(self, angular_velocity: ArrayLike) -> Floats:
        """Return kinetic energies, J, shape (...), of angular velocities, rad/s, (..., 3)."""
        w = np.asarray(angular_velocity, float)
        return 0.5 * np.sum(w * self.angular_momentum(w), axis=-1)

    def angular_acceleration(self, angular_velocity: ArrayLike,
                             torque: ArrayLike = (0.0, 0.0, 0.0)) -> Floats:
        """
        Return the angular acceleration from Euler's equations J dw/dt = (J w) x w + tau.

        Parameters
        ----------
        angular_velocity : array, shape (..., 3), rad/s, body axes
            The angular velocity, which is broadcast against `torque`.
        torque : array, shape (..., 3), N m, body axes
            The torque about the centre of mass.

        Returns
        -------
        array, shape (..., 3), rad/s^2, body axes

        """
        w, torque = np.broadcast_arrays(np.asarray(angular_velocity, float), torque)
        products = np.concatenate([np.roll(w, -1, -1) * np.roll(w, -2, -1), w * w, torque], -1)
        return _product(products, self._coefficients[0].T)

    def torque(self, angular_velocity: ArrayLike, angular_acceleration: ArrayLike) -> Floats:
        """
        Return the torque tau = (dL/dt)_space that causes an angular acceleration.

        Parameters
        ----------
        angular_velocity, angular_acceleration : array, shape (..., 3), body axes
            The angular velocity, rad/s, and the angular acceleration, rad/s^2, which are broadcast
            against each other.

        Returns
        -------
        array, shape (..., 3), N m, body axes

        """
        change = self.angular_momentum(angular_acceleration)
        return rate_in_space(change, angular_velocity, self.angular_momentum(angular_velocity))


def uniform_box(body: RigidBody) -> Floats:
    """
    Return the edges, shape (3,), of a uniform box with the same ratios of moments as the body.

    The edges lie along the principal axes. The first edge of a box of mass m is
    sqrt(6 (I2 + I3 - I1) / m); the other two follow by cyclic permutation. The moments do not
    determine the mass, so the edges are scaled such that the longest is 1. The axes of the
    equivalent ellipsoid have the same ratios.
    """
    moments = body.principal_moments
    squares = np.maximum(moments.sum() - 2.0 * moments, 0.0)
    return np.asarray(np.sqrt(squares / squares.max()))


def _product(factors: Floats, rows: Floats) -> Floats:
    # Return factors @ rows, summed in a fixed order. In BLAS the order depends on the processor.
    total = factors[..., :1] * rows[0]
    for k in range(1, len(rows)):
        total = total + factors[..., k:k + 1] * rows[k]
    return total


def rate_in_space(rate_in_body: ArrayLike, angular_velocity: ArrayLike,
                  vector: ArrayLike) -> Floats:
    """
    Return the rate of change of a vector in space: (dA/dt)_space = (dA/dt)_body + w x A.

    Parameters
    ----------
    rate_in_body : array, shape (..., 3)
        The time derivative of the body components of A.
    angular_velocity : array, shape (..., 3), rad/s, body axes
        Angular velocity w of the body relative to space.
    vector : array, shape (..., 3), body axes
        The vector A.

    Returns
    -------
    array, shape (..., 3), body axes
        The rate of change, in the units of A per second.

    """
    w, a = np.asarray(angular_velocity, float), np.asarray(vector, float)
    return np.asarray(rate_in_body, float) + np.cross(w, a)


def _checked_tensor(values: ArrayLike, name: str = 'inertia') -> Floats:
    tensor = np.array(values, float)
    if tensor.shape != (3, 3) or not np.all(np.isfinite(tensor)):
        raise ValueError(f'{name}: expected 3 by 3 finite numbers, '
                         f'found {quoted(tensor.tolist())}')
    if np.max(np.abs(tensor - tensor.T)) > ROUNDING * np.max(np.abs(tensor)):
        raise ValueError(f'{name}: expected a symmetric tensor, found {tensor.tolist()}')
    return 0.5 * tensor + 0.5 * tensor.T


def _checked_damping(values: ArrayLike | None) -> Floats:
    if values is None:
        return np.zeros((3, 3))
    damping = _checked_tensor(values, 'damping')
    least = np.linalg.eigvalsh(damping)[0]
    if least < -ROUNDING * np.max(np.abs(damping)):
        raise ValueError('damping: expected a tensor without negative eigenvalues, '
                         f'found {damping.tolist()} with the eigenvalue {least:.6g} N m s/rad')
    return damping


def _damping_coefficients(tensor: NDArray[Any], damping: Floats) -> Floats:
    if not damping.any():
        return np.zeros((2, 3, 3))
    try:
        coefficients = tensor_constants.damping_coefficients(tensor, damping)
    except ArithmeticError:
        raise ValueError('damping: expected entries whose quotients by the moments of inertia fit '
                         f'a double, found {damping.tolist()}') from None
    largest = np.max(np.abs(coefficients[0]))
    if largest > FASTEST_DAMPING:
        raise ValueError('damping: expected quotients by the moments of inertia of at most '
                         f'{FASTEST_DAMPING:g} 1/s, found {largest:.6g} 1/s')
    return coefficients


def _check_thickness(tensor: Floats, mass: float, distance: float) -> None:
    """Raise ValueError if the smallest moment of point masses may be a mere rounding error."""
    moments = np.linalg.eigvalsh(tensor)
    # The first term bounds the error of the sums. The second term bounds the errors of positions
    # and of the centre of mass.
    rounding = _SUMMED * moments[2] + mass * (_SUMMED * distance) ** 2
    if moments[0] <= rounding:
        raise ValueError('inertia: expected a positive definite tensor, found masses that are on '
                         f'one line within rounding: principal moments {moments.tolist()} kg m^2')


def _checked_excess(moments: Floats) -> float:
    smallest, middle, largest = moments
    found = f'principal moments {smallest:.17g}, {middle:.17g}, {largest:.17g} kg m^2'
    if smallest <= 0.0:
        raise ValueError(f'inertia: expected a positive definite tensor, found {found}')
    excess = float(largest / (smallest + middle) - 1.0)
    if excess > TRIANGLE_EXCESS:
        raise ValueError(f'inertia: not physical, {found}: the largest exceeds the sum of the '
                         f'other two by {100 * excess:.3g} % (limit {100 * TRIANGLE_EXCESS:g} %)')
    return excess if excess > ROUNDING else 0.0


def _symmetry(moments: Floats) -> str:
    close = np.diff(moments) <= ROUNDING * moments[2]
    return ('asymmetric top', 'symmetric top', 'sphere')[int(close.sum())]


def _euler_coefficients(tensor: NDArray[Any]) -> Floats:
    try:
        return tensor_constants.euler_coefficients(tensor)
    except ArithmeticError:
        raise ValueError('inertia: expected moments whose values and inverses fit a double, '
                         f'found {tensor.tolist()}') from None
