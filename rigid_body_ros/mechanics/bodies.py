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

"""Many rigid bodies, stored as arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import body_layout, kernels, tensors
from rigid_body_ros.mechanics.body import FASTEST_DAMPING, RigidBody, ROUNDING, TRIANGLE_EXCESS


class RigidBodies:
    """
    Many rigid bodies, some of which may be invalid.

    `bodies[i]` returns the `RigidBody` of row i, or raises ValueError if that body is invalid.

    Parameters
    ----------
    tensors : array, shape (n, 3, 3), kg m^2
        The inertia tensors, as for `RigidBody`.
    damping : array, shape (n, 3, 3) or (3, 3), N m s/rad, optional
        One damping tensor for each body, or a single tensor for all bodies.

    Attributes
    ----------
    inertia : array, shape (n, 3, 3), kg m^2, body axes
        The inertia tensors as given.
    damping : array, shape (n, 3, 3), N m s/rad, body axes
        The damping tensor of each body, as given.
    is_damped : array of bool, shape (n,)
        Whether each body has nonzero damping.
    messages : tuple of n str
        For an invalid body, the message of the error that `RigidBody` raises. For a valid body, an
        empty string.

    Raises
    ------
    ValueError
        An array has the wrong shape.

    """

    def __init__(self, tensors: ArrayLike, damping: ArrayLike | None = None) -> None:
        self.inertia = _rows_of_tensors(tensors, 'tensors')
        self.damping = np.zeros_like(self.inertia) if damping is None else _rows_of_tensors(
            np.broadcast_to(damping, self.inertia.shape) if np.ndim(damping) == 2 else damping,
            'damping')
        if len(self.damping) != len(self.inertia):
            raise ValueError(f'damping: expected {len(self.inertia)} tensors, '
                             f'found {len(self.damping)}')
        self.is_damped: NDArray[np.bool_] = np.asarray(self.damping.any(axis=(1, 2)))
        self._constants, self.messages = self._computed()

    def __len__(self) -> int:
        return len(self.inertia)

    def __getitem__(self, row: int) -> RigidBody:
        return RigidBody(self.inertia[row], self.damping[row])

    def __repr__(self) -> str:
        return f'RigidBodies({len(self)} bodies, {sum(map(bool, self.messages))} invalid)'

    def _computed(self) -> tuple[Floats, tuple[str, ...]]:
        """Return the constants for the kernels, shape (n, body_layout.SIZE), and `messages`."""
        inertia, damping = _symmetric_part(self.inertia), _symmetric_part(self.damping)
        constants: Floats = np.zeros((len(self), body_layout.SIZE))
        certain = np.empty(len(self), np.bool_)
        kernels.fill_constants(inertia, damping, constants, certain, tensors.workspace())
        certain &= _almost_symmetric(self.inertia) & _almost_symmetric(self.damping)
        certain[certain] = _is_possible(constants, certain)
        rows = np.flatnonzero(certain & self.is_damped)
        certain[rows] = _is_semidefinite(damping[rows])
        messages, computed = [''] * len(self), dict[bytes, tuple[Floats | float, str]]()
        for row in np.flatnonzero(~certain).tolist():
            key = self.inertia[row].tobytes() + self.damping[row].tobytes()
            if key not in computed:
                computed[key] = self._computed_alone(row)
            constants[row], messages[row] = computed[key]
        return constants, tuple(messages)

    def _computed_alone(self, row: int) -> tuple[Floats | float, str]:
        try:
            return self[row]._constants, ''
        except ValueError as error:
            return 0.0, str(error)


def _symmetric_part(tensors: Floats) -> Floats:
    with np.errstate(invalid='ignore'):  # rows that contain infinities are rejected later
        return np.ascontiguousarray(0.5 * tensors + 0.5 * tensors.transpose(0, 2, 1))


def _almost_symmetric(tensors: Floats) -> NDArray[np.bool_]:
    if np.array_equal(tensors, tensors.transpose(0, 2, 1)):
        return np.ones(len(tensors), np.bool_)
    with np.errstate(invalid='ignore', over='ignore'):
        differences = np.abs(tensors - tensors.transpose(0, 2, 1)).max(axis=(1, 2))
    return np.asarray(differences <= ROUNDING * np.abs(tensors).max(axis=(1, 2)))


def _is_possible(constants: Floats, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return, for each selected row, whether `RigidBody` would accept its moments and damping."""
    moments = constants[:, body_layout.MOMENTS:body_layout.MOMENTS + 3]
    damping = constants[:, body_layout.DAMPING:body_layout.LOST_DAMPING][which]
    smallest, middle, largest = moments[which].T
    return np.asarray((largest / (smallest + middle) - 1.0 <= TRIANGLE_EXCESS)
                      & (np.abs(damping).max(axis=1) <= FASTEST_DAMPING))


def _is_semidefinite(damping: Floats) -> NDArray[np.bool_]:
    # Allow only half the rounding error that `RigidBody` allows, so that `RigidBody` accepts every
    # row that is accepted here.
    largest = np.abs(damping).max(axis=(1, 2))
    return np.asarray(np.linalg.eigvalsh(damping)[:, 0] >= -0.5 * ROUNDING * largest)


def _rows_of_tensors(values: ArrayLike, name: str) -> Floats:
    tensors = np.array(values, float)
    if tensors.ndim != 3 or tensors.shape[1:] != (3, 3):
        raise ValueError(f'{name}: expected shape (n, 3, 3), found {tensors.shape}')
    tensors.flags.writeable = False
    return tensors
