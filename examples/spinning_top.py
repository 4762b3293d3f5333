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
A top that wobbles without torque: its axis goes round the angular momentum at a steady rate.

For a symmetric top textbooks have that rate as |L| / I_t, where I_t is the moment of inertia
across the axis (Landau and Lifshitz, Mechanics, section 33). Here it is read off the motion and
held against the formula. The package turns bodies about their centre of mass, where gravity has
no arm: think of a top thrown into the air.

    python examples/spinning_top.py

The very first run takes some seconds more: it compiles the package's kernels.
"""

import numpy as np
from rigid_body_ros import propagate, RigidBody, so3, State

#: Body axes.
AXIS, ACROSS = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
#: rad/s: a wobble across the axis, and the spin about it.
RATES = (10.0, 0.0, 40.0)
SECONDS = 10


def child_top():
    """Return twelve masses in a ring, and a stem of four through its middle; kg and m."""
    around = np.arange(12) * np.pi / 6.0
    ring = 0.03 * np.stack([np.cos(around), np.sin(around), np.zeros(12)], axis=1)
    stem = [(0.0, 0.0, height) for height in (-0.02, 0.0, 0.02, 0.04)]
    return RigidBody.from_point_masses(12 * [0.004] + 4 * [0.002], np.concatenate([ring, stem]))


def azimuth(axis, momentum):
    """
    Return the angle that the axis has gone round the angular momentum, rad, shape (m,).

    Parameters
    ----------
    axis : array, shape (m, 3), space axes
        Going on by less than half a turn at a time; at first not along the momentum.
    momentum : array, shape (3,), space axes
        Of any length but zero: only its direction counts.

    """
    along = momentum / np.linalg.norm(momentum)
    ahead = axis[0] - axis[0] @ along * along
    left = np.cross(along, ahead)
    return np.unwrap(np.arctan2(axis @ left, axis @ ahead))


def main():
    top = child_top()
    # Often enough for `azimuth` to count the turns.
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
    print('they agree within   ', f'{abs(found / textbook - 1.0):.1g} of it')


if __name__ == '__main__':
    main()
