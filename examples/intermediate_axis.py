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

The example plots the angular velocity, and the angle from the intermediate axis to the angular
momentum, to intermediate_axis.png or another file. It prints the time between flips from the
computed motion, and from the textbook formula (Landau and Lifshitz, Mechanics, section 37). The
formula needs scipy.

    python examples/intermediate_axis.py [PNG]
"""

import argparse

from matplotlib.figure import Figure
import numpy as np
from rigid_body_ros import propagate, RigidBody, State
from scipy.special import ellipkm1

#: rad/s, about the axes of the smallest, intermediate and largest moment.
RATES = (0.0, 6.0, 0.05)
TIMES_NS = np.arange(2001) * 10 ** 7


def wing_nut():
    """Return six masses in a ring and two wings above it (kg, m); the thread is the z axis."""
    around = np.arange(6) * np.pi / 3.0
    ring = 0.005 * np.stack([np.cos(around), np.sin(around), np.zeros(6)], axis=1)
    wings = [(0.015, 0.0, 0.008), (-0.015, 0.0, 0.008)]
    return RigidBody.from_point_masses(6 * [0.002] + 2 * [0.003], np.concatenate([ring, wings]))


def flip_times(start, motion):
    """
    Return the times, s, shape (n,), at which the rate about the intermediate axis changes sign.

    Parameters
    ----------
    start : State
        Initial state, at time 0. The function computes the motion near each flip again from it.
    motion : Trajectory
        Motion from `start` on, sampled densely enough to show every flip.

    """
    body, middle = motion.body, motion.body.principal_axes[:, 1]
    rate = motion.angular_velocity @ middle
    times = motion.times_ns[:-1][rate[:-1] * rate[1:] < 0.0] * 1e-9
    for _ in range(2):  # Newton's method
        at = np.round(times * 1e9).astype(np.int64)
        rates = propagate(body, start, at=at).angular_velocity
        times = at * 1e-9 - rates @ middle / (body.angular_acceleration(rates) @ middle)
    return times


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


def draw(path, motion, flips):
    """
    Plot the rates and the angle over time to a PNG file.

    Parameters
    ----------
    path : str
        An existing file is overwritten.
    motion : Trajectory
        Motion from time 0 on.
    flips : array, shape (n,), s
        Times of at least two flips; the plot marks the time between the first two.

    """
    seconds = motion.times_ns * 1e-9
    rates = motion.angular_velocity @ motion.body.principal_axes
    momentum = rates * motion.body.principal_moments
    angle = np.degrees(np.arccos(momentum[:, 1] / np.linalg.norm(momentum, axis=1)))

    figure = Figure(figsize=(8.0, 5.5), layout='constrained')
    upper, lower = figure.subplots(2, 1, sharex=True)
    flip, between = np.searchsorted(seconds, (flips[0], flips[:2].mean()))
    for column, (name, style, colour, row, offset, side) in zip(rates.T, (
            ('smallest', ':', '#B04A00', flip, (-9, -3), 'right'),
            ('intermediate', '-', '#000000', between, (0, 6), 'center'),
            ('largest', '--', '#0072B2', flip, (9, -3), 'left'))):
        upper.plot(seconds, column, style, color=colour)
        upper.annotate(name, (seconds[row], column[row]), offset, textcoords='offset points',
                       color=colour, ha=side)
    upper.set_title('Wing nut: angular velocity about the axes of smallest, intermediate and '
                    'largest moment', loc='left', fontsize=9)
    upper.set(ylabel='angular velocity (rad/s)')
    lower.plot(seconds, angle, color='#000000')
    lower.annotate('', (flips[0], 90.0), (flips[1], 90.0), arrowprops={'arrowstyle': '<->'})
    lower.text(flips[:2].mean(), 94.0, f'{flips[1] - flips[0]:.2f} s', ha='center')
    lower.set(xlabel='time (s)', xlim=seconds[[0, -1]], yticks=range(0, 181, 45),
              ylabel='intermediate axis to\nangular momentum (deg)')
    for panel in (upper, lower):
        panel.grid(alpha=0.3)
    figure.savefig(path, dpi=120, format='png')


def main():
    parser = argparse.ArgumentParser(description='Plot the motion of a wing nut that flips.')
    parser.add_argument('picture', metavar='PNG', nargs='?', default='intermediate_axis.png',
                        help='file to write (default: %(default)s)')
    path = parser.parse_args().picture

    nut = wing_nut()
    start = State(angular_velocity=nut.principal_axes @ RATES)
    motion = propagate(nut, start, at=TIMES_NS)
    flips = flip_times(start, motion)
    found, textbook = np.diff(flips).mean(), textbook_time(nut.principal_moments, RATES)

    print('principal moments   ', *(f'{moment:.6g}' for moment in nut.principal_moments), 'kg m^2')
    print('flips at            ', *(f'{flip:.3f}' for flip in flips), 's')
    print('time between flips  ', f'{found:.15g} s')
    print('textbook            ', f'{textbook:.15g} s')
    print('relative difference ', f'{abs(found / textbook - 1.0):.1g}')
    try:
        draw(path, motion, flips)
    except OSError as error:
        parser.error(f'{path}: cannot write: {error.strerror}')
    print('wrote               ', path)


if __name__ == '__main__':
    main()
