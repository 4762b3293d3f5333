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
A torque-free top that wobbles: its axis precesses about the angular momentum at a constant rate.

For a symmetric top the rate is |L| / I_t, where I_t is the transverse moment of inertia (Landau
and Lifshitz, Mechanics, section 33). The example compares this formula with the rate of the
computed motion. Think of a top thrown into the air: gravity exerts no torque about its centre of
mass.

    python examples/spinning_top.py
"""

import numpy as np
from rigid_body_ros import propagate, RigidBody, so3, State

#: Body axes.
AXIS, ACROSS = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
#: rad/s; transverse rate and spin.
RATES = (10.0, 0.0, 40.0)
SECONDS = 10


def child_top():
    """Return twelve masses in a ring and a stem of four masses through its centre (kg, m)."""
    around = np.arange(12) * np.pi / 6.0
    ring = 0.03 * np.stack([np.cos(around), np.sin(around), np.zeros(12)], axis=1)
    stem = [(0.0, 0.0, height) for height in (-0.02, 0.0, 0.02, 0.04)]
    return RigidBody.from_point_masses(12 * [0.004] + 4 * [0.002], np.concatenate([ring, stem]))


def azimuth(axis, momentum):
    """
    Return the azimuth of the axis about the angular momentum, rad, shape (m,).

    Parameters
    ----------
    axis : array, shape (m, 3), space axes
        Must turn by less than half a turn between rows; the first row must not be parallel to the
        momentum.
    momentum : array, shape (3,), space axes
        Not zero; only its direction matters.

    """
    along = momentum / np.linalg.norm(momentum)
    ahead = axis[0] - axis[0] @ along * along
    left = np.cross(along, ahead)
    return np.unwrap(np.arctan2(axis @ left, axis @ ahead))


def main():
    top = child_top()
    # Dense enough for `azimuth` to count the turns.
    times_ns = np.linspace(0, SECONDS * 10 ** 9, 1000 * SECONDS + 1).astype(np.int64)
    motion = propagate(top, State(angular_velocity=RATES), at=times_ns)

    axis, momentum = so3.rotate(motion.attitude, AXIS), motion.angular_momentum_space[0]
    size = np.linalg.norm(momentum)
    found = azimuth(axis, momentum)[-1] / SECONDS
    textbook = size / top.moment_about(ACROSS)

    print('principal moments   ', *(f'{moment:.6g}' for moment in top.principal_moments), 'kg m^2')
    print('symmetry            ', top.symmetry)
    print('axis to momentum    ', f'{np.degrees(np.arccos(axis[0] @ momentum / size)):.3f} deg')
    print('precession, motion  ', f'{found:.15g} rad/s')
    print('precession, |L|/I_t ', f'{textbook:.15g} rad/s')
    print('relative difference ', f'{abs(found / textbook - 1.0):.1g}')


if __name__ == '__main__':
    main()
