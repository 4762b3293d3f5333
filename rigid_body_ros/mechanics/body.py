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

Vectors are in body axes unless their names end in `_space`. The formulas follow Goldstein,
Classical Mechanics, chapters 4 and 5.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats, written
from rigid_body_ros.common.errors import quoted
from rigid_body_ros.engine import body_layout, kernels, tensors
from rigid_body_ros.engine import tensor as tensor_constants
from rigid_body_ros.mechanics import so3, urdf

#: Largest relative asymmetry that a tensor may have. Moments count as equal if their relative
#: difference is at most this value. Rotating or adding tensors in doubles causes smaller errors.
ROUNDING = 1e-12
#: Largest `triangle_excess` that a body may have. Published tensors are rounded to two or three
#: digits, so the tensor of a thin plate may be slightly unphysical. The motion under such a tensor
#: is still well defined.
TRIANGLE_EXCESS = 0.03
#: Largest entry that J^-1 D may have, 1/s. This limit keeps motions from decaying by more than a
#: factor of e^3 in one nanosecond, the shortest step.
FASTEST_DAMPING = 1e9
#: Upper bound on the relative rounding error when NumPy's pairwise summation computes a weighted
#: sum over up to a million point masses.
_SUMMED = 40.0 * np.finfo(float).eps


class RigidBody:
    """
    A rigid body with a constant inertia tensor.

    Parameters
    ----------
    tensor : array, shape (3, 3), kg m^2
        The inertia tensor about the centre of mass, in body axes, with the rotors locked. The
        off-diagonal entries have the signs that they have in the matrix, as in URDF: ixy is minus
        the integral of x y dm.
    damping : array, shape (3, 3), N m s/rad, optional
        The damping tensor D in body axes, which must be symmetric and positive semidefinite. The
        damping torque on the body is -D w, where w is the angular velocity.

    Attributes
    ----------
    inertia : array, shape (3, 3), kg m^2, body axes
    damping : array, shape (3, 3), N m s/rad, body axes
    is_damped : bool
        Whether the damping is nonzero.
    principal_moments : array, shape (3,), kg m^2
        The principal moments in ascending order.
    principal_axes : array, shape (3, 3)
        The principal axes as columns, in body axes and in the order of the principal moments. They
        form a right-handed system.
    triangle_excess : float
        How much the largest principal moment exceeds the sum of the other two, relative to that
        sum. The excess is zero for any real body, but `RigidBody` accepts up to `TRIANGLE_EXCESS`,
        because the entries of a tensor may have been rounded.
    symmetry : str
        'sphere' if all three principal moments are equal within rounding, 'symmetric top' if two
        are equal, otherwise 'asymmetric top'.

    Raises
    ------
    ValueError
        The tensor is not a finite, symmetric and positive definite 3 by 3 matrix; its
        `triangle_excess` is larger than `TRIANGLE_EXCESS`; a moment or its inverse does not fit in
        a double; the damping is not a finite, symmetric and positive semidefinite 3 by 3 matrix;
        or the damping is too strong for steps of a nanosecond.

    """

    def __init__(self, tensor: ArrayLike, damping: ArrayLike | None = None) -> None:
        self.inertia = _checked_tensor(tensor)
        self.damping = _checked_damping(damping)
        self.is_damped = bool(self.damping.any())
        self._exact: NDArray[Any] = self.inertia
        self._constants = self._computed()
        self.principal_moments, self.principal_axes = (high.copy() for high, _ in self._principal)
        self.triangle_excess = _checked_excess(self.principal_moments)
        self.symmetry = _symmetry(self.principal_moments)
        self.inertia.flags.writeable = self.damping.flags.writeable = False

    def _computed(self) -> Floats:
        """Return the constants that the compiled kernel computes, or else the exact constants."""
        constants, is_certain = np.zeros((1, body_layout.SIZE)), np.empty(1, np.bool_)
        kernels.fill_constants(self.inertia[None], self.damping[None], constants, is_certain,
                               tensors.workspace())
        if is_certain[0]:
            if self.is_damped:
                _check_damping_coefficients(constants[0, body_layout.DAMPING:])
            return constants[0]
        principal = tensor_constants.principal(self.inertia)
        _checked_excess(principal[0][0])
        return self._exact_constants(*principal)

    def _set_exact(self, exact: NDArray[Any]) -> None:
        """Compute the coefficients from a tensor whose entries are Fractions (sums of doubles)."""
        self._exact = exact
        self._constants = self._exact_constants(*self._principal)

    def _exact_constants(self, moments: Floats, axes: Floats) -> Floats:
        return body_layout.pack(_euler_coefficients(self._exact), moments, axes,
                                _damping_coefficients(self._exact, self.damping))

    @property
    def _coefficients(self) -> Floats:
        """Return the coefficients of Euler's equations and their low-order parts, (2, 3, 9)."""
        columns = self._constants[:body_layout.MOMENTS].reshape(2, 9, 4)
        return columns[:, :, :3].swapaxes(1, 2)

    @property
    def _principal(self) -> tuple[Floats, Floats]:
        """Return the principal moments and axes with their parts, as `tensor.principal` does."""
        vectors = self._constants[body_layout.MOMENTS:body_layout.DAMPING].reshape(8, 4)[:, :3]
        return vectors[:2], vectors[2:].reshape(2, 3, 3).swapaxes(1, 2)

    @classmethod
    def from_moments(cls, ixx: float, iyy: float, izz: float,
                     ixy: float = 0.0, ixz: float = 0.0, iyz: float = 0.0) -> RigidBody:
        """
        Build a body from the six entries of its inertia tensor.

        This method raises the same errors as `RigidBody`.

        Parameters
        ----------
        ixx, iyy, izz, ixy, ixz, iyz : float, kg m^2
            The entries of the inertia tensor about the centre of mass, in body axes. The
            off-diagonal entries have the signs that they have in the matrix, as in URDF.

        """
        return cls([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])

    @property
    def entries(self) -> Floats:
        """Return the entries ixx, iyy, izz, ixy, ixz and iyz in an array of shape (6,), kg m^2."""
        return self.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]

    def with_entries(self, entries: Floats) -> RigidBody:
        """Return a body with these entries and the same damping; raise ValueError if invalid."""
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
            The positions in body axes. Choose an origin near the body, because a distant origin
            reduces the accuracy.

        Returns
        -------
        RigidBody
            The body with the inertia about the centre of mass of all the point masses.

        Raises
        ------
        ValueError
            A mass is not positive and finite.
            The shapes do not match.
            All masses lie on a line: their distances from the line are less than about 1e-7 times
            their extent along it, or less than about 1e-14 times their distance from the origin.

        """
        masses, positions = np.asarray(masses, float), np.asarray(positions, float)
        if masses.ndim != 1 or positions.shape != (masses.size, 3):
            raise ValueError('masses and positions: expected shapes (n,) and (n, 3), '
                             f'found {masses.shape} and {positions.shape}')
        if not (masses.size and np.all(masses > 0.0) and np.isfinite(masses).all()):
            raise ValueError('masses: expected at least one, each finite and greater than zero, '
                             f'found {quoted(masses.tolist())}')
        columns = np.ascontiguousarray(positions.T)  # NumPy's sums are pairwise only along rows
        arms = columns - (masses * columns).sum(axis=1)[:, None] / masses.sum()
        squares = ((masses * arms)[:, None] * arms).sum(axis=2)
        tensor = _checked_tensor(np.trace(squares) * np.eye(3) - squares)
        _check_thickness(tensor, masses.sum(), float(np.abs(positions).max()))
        return cls(tensor)

    @classmethod
    def from_urdf(cls, text: str, link: str = '') -> RigidBody:
        """
        Build a body from a URDF link and all links that fixed joints connect to it.

        The tensor is that of all these links, about their common centre of mass (see
        `urdf.inertia`). The body axes are the axes of the named link. Links that other joints
        move, such as propellers, do not contribute.

        Parameters
        ----------
        text : str
            The contents of a URDF file, such as ROS's robot_description, after processing by
            xacro.
        link : str
            Name of the link. It may be empty if all links with <inertial> belong to one body.

        Returns
        -------
        RigidBody

        Raises
        ------
        ValueError
            The URDF is invalid (see `urdf.inertia`), or `RigidBody` rejects its tensor.

        """
        return cls(urdf.inertia(text, link))

    def __repr__(self) -> str:
        return (f'RigidBody({self.symmetry}, principal moments '
                f'{written(self.principal_moments)} kg m^2)')

    def moment_about(self, axis: ArrayLike) -> float:
        """
        Return the moment of inertia n . J n, kg m^2, about an axis given in body axes.

        Here, n is the unit vector along `axis`.
        """
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
        """Return kinetic energies, J, shape (...), for angular velocities, rad/s, (..., 3)."""
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
        Return the torque tau = (dL/dt)_space that produces a given angular acceleration.

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
    Return the edges of a uniform box whose moments have the same ratios as the body's.

    The result has shape (3,), with one edge along each principal axis. The first edge of a box of
    mass m is sqrt(6 (I2 + I3 - I1) / m); the other two follow by cyclic permutation. The ratios do
    not determine the mass, so all edges are scaled by a common factor that makes the longest edge
    1. The axes of the equivalent ellipsoid have the same ratios.
    """
    moments = body.principal_moments
    squares = np.maximum(moments.sum() - 2.0 * moments, 0.0)
    return np.asarray(np.sqrt(squares / squares.max()))


def _product(factors: Floats, rows: Floats) -> Floats:
    # Return factors @ rows, but sum in a fixed order. BLAS sums in an order that depends on the
    # processor.
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
    if tensor.shape != (3, 3) or not np.isfinite(tensor).all():
        raise ValueError(f'{name}: expected 3 by 3 finite numbers, '
                         f'found {quoted(tensor.tolist())}')
    if (tensor == tensor.T).all():
        return tensor
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
    _check_damping_coefficients(coefficients[0])
    return coefficients


def _check_damping_coefficients(coefficients: Floats) -> None:
    largest = np.max(np.abs(coefficients))
    if largest > FASTEST_DAMPING:
        raise ValueError('damping: expected quotients by the moments of inertia of at most '
                         f'{FASTEST_DAMPING:g} 1/s, found {largest:.6g} 1/s')


def _check_thickness(tensor: Floats, mass: float, distance: float) -> None:
    """Raise ValueError if rounding errors may exceed the smallest moment of the point masses."""
    moments = np.linalg.eigvalsh(tensor)
    # The first term bounds the rounding error of the sums. The second term bounds the effect of
    # rounding errors in the positions and in the centre of mass.
    rounding = _SUMMED * moments[2] + mass * (_SUMMED * distance) ** 2
    if moments[0] <= rounding:
        raise ValueError('inertia: expected a positive definite tensor, found masses that are on '
                         f'one line within rounding: principal moments {moments.tolist()} kg m^2')


def _checked_excess(moments: Floats) -> float:
    smallest, middle, largest = moments.tolist()
    excess = largest / (smallest + middle) - 1.0 if smallest > 0.0 else math.inf
    if excess > TRIANGLE_EXCESS:
        found = f'principal moments {smallest:.17g}, {middle:.17g}, {largest:.17g} kg m^2'
        if smallest <= 0.0:
            raise ValueError(f'inertia: expected a positive definite tensor, found {found}')
        raise ValueError(f'inertia: not physical, {found}: the largest exceeds the sum of the '
                         f'other two by {100 * excess:.3g} % (limit {100 * TRIANGLE_EXCESS:g} %)')
    return excess if excess > ROUNDING else 0.0


def _symmetry(moments: Floats) -> str:
    smallest, middle, largest = moments.tolist()
    close = (middle - smallest <= ROUNDING * largest) + (largest - middle <= ROUNDING * largest)
    return ('asymmetric top', 'symmetric top', 'sphere')[close]


def _euler_coefficients(tensor: NDArray[Any]) -> Floats:
    try:
        return tensor_constants.euler_coefficients(tensor)
    except ArithmeticError:
        raise ValueError('inertia: expected moments whose values and inverses fit a double, '
                         f'found {tensor.tolist()}') from None
