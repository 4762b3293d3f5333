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
Compute a motion in principal axes, where the Taylor series has different rounding errors.

In principal axes, no terms of J^-1 tau cancel. The principal moments and axes are computed with
about 32 digits. Torques and rates are rounded only once, after they have been rotated.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import body_layout, kernels, state_layout, tensor
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog

#: A coefficient of Euler's equations that is too small to affect the motion. Because this
#: coefficient is not zero, the kernels use the arithmetic for full tensors, so the rounding errors
#: differ even if the given tensor is diagonal.
_NEGLIGIBLE = 1e-200


class PrincipalAxes:
    """
    Convert a body and its motion to the principal axes, and convert attitudes to body axes.

    Attributes
    ----------
    body : RigidBody
        The body in principal axes. Its motion can be computed only with the Taylor series.

    """

    def __init__(self, body: RigidBody) -> None:
        moments, self._axes = body._principal
        exact = np.vectorize(Fraction, otypes=[object])
        coefficients = tensor.euler_coefficients(np.diag(exact(moments[0]) + exact(moments[1])))
        coefficients[0, 0, 1] = _NEGLIGIBLE
        self.body = RigidBody(np.diag(moments[0]))
        self.body._constants = body_layout.pack(
            coefficients, moments, np.stack([np.eye(3), np.zeros((3, 3))]), np.zeros((2, 3, 3)))
        self._rotation = so3.from_matrix(self._axes[0])

    def start(self, start: State) -> State:
        """Convert an initial state to principal axes."""
        rates = self._components(start.angular_velocity[None])[0]
        attitude = so3.multiply(start.attitude, self._rotation)
        packed = state_layout.pack(rates[:, 0], attitude, rates[:, 1])
        return State._as_computed(start.time_ns, packed)

    def log(self, log: TorqueLog) -> TorqueLog:
        """Convert torques in body axes to principal axes; torques in space axes do not change."""
        turned = self._components(log.torques)[..., 0]
        return log.with_torques(np.where(log.in_space[:, None], log.torques, turned))

    def back(self, attitude: Floats) -> Floats:
        """Convert attitudes of the principal axes to attitudes of the body axes, shape (m, 4)."""
        return so3.multiply(attitude, so3.conjugate(self._rotation))

    def _components(self, vectors: Floats) -> Floats:
        high, low = self._axes
        result = np.empty((len(vectors), 3, 2))
        kernels.fill_components(high, low, vectors, result)
        return result
