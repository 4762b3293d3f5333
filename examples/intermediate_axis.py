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
The Dzhanibekov effect: a wing nut that spins about its intermediate axis flips periodically.

The example prints the time between flips from the computed motion, and from the textbook formula
(Landau and Lifshitz, Mechanics, section 37).

    python examples/intermediate_axis.py
"""

import numpy as np
from rigid_body_ros import propagate, RigidBody, State
from scipy.special import ellipkm1

#: rad/s, about the axes of the smallest, intermediate and largest moment.
RATES = (0.0, 6.0, 0.05)
#: The end of the motion, ns.
END_NS = 20 * 10 ** 9


def wing_nut():
    """Return six masses in a ring and two wings above it (kg, m); the thread is the z axis."""
    around = np.arange(6) * np.pi / 3.0
    ring = 0.005 * np.stack([np.cos(around), np.sin(around), np.zeros(6)], axis=1)
    wings = [(0.015, 0.0, 0.008), (-0.015, 0.0, 0.008)]
    return RigidBody.from_point_masses(6 * [0.002] + 2 * [0.003], np.concatenate([ring, wings]))


def flip_times(motion):
    """Return the times, s, at which the rate about the intermediate axis changes sign."""
    middle = motion.body.principal_axes[:, 1]
    flips = motion.crossings(lambda motion: motion.angular_velocity @ middle)
    return 1e-9 * (flips.times_ns + flips.fractions)


def textbook_time(moments, rates):
    """
    Return the time between flips, 2 K(k) / lambda, s.

    Parameters
    ----------
    moments : array, shape (3,), kg m^2
        Principal moments in ascending order.
    rates : array, shape (3,), rad/s
        Angular velocity about their axes.

    """
    def excess(moment):  # L^2 - 2 E moment, in a form without cancellation
        return np.sum(moments * (moments - moment) * np.square(rates))

    low, middle, high = moments
    if excess(middle) < 0.0:  # the motion circles the axis of the smallest moment
        low, high = high, low
    speed = np.sqrt((high - middle) * excess(low) / (low * middle * high))
    complement = (high - low) * excess(middle) / ((high - middle) * excess(low))  # 1 - k^2
    return 2.0 * ellipkm1(complement) / speed


if __name__ == '__main__':
    nut = wing_nut()
    start = State(angular_velocity=nut.principal_axes @ RATES)
    flips = flip_times(propagate(nut, start, at=[END_NS]))
    found, textbook = np.diff(flips).mean(), textbook_time(nut.principal_moments, RATES)
    print('principal moments   ', *(f'{moment:.6g}' for moment in nut.principal_moments), 'kg m^2')
    print('flips at            ', *(f'{flip:.3f}' for flip in flips), 's')
    print('time between flips  ', f'{found:.15g} s')
    print('textbook            ', f'{textbook:.15g} s')
    print('relative difference ', f'{abs(found / textbook - 1.0):.1g}')
