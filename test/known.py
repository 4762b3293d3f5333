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
Quantities of extreme motions for which there is a closed form or a published value.

Each function returns the known and the computed value. `test_extremes.py` compares them, and
`benchmarks/extremes.py` prints them.
"""

import math

from mpmath import mp
import numpy as np
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import so3
from scenes import FIXED_STEP, SECOND
import truth

PERIODS = 1_000_000
#: 4 K / lambda, s, to 18 digits: van Zon and Schofield's program, and this project's 34 digits.
TOPS = {
    "van Zon's top": ((10.0, 20.0, 26.0), (1.0, 15.0, 1.0), 2.34711299288784672),
    "Gazebo's boxes": ((10 / 12 * 0.97, 10 / 12 * 0.82, 10 / 12 * 0.17), (0.1, 5.0, 0.1),
                       6.05684415801567644),
    'Hairer and Vilmart': ((0.6, 0.8, 1.0), (3.0, 0.5, -0.9), 6.86261617805811641),
    'Hairer and Vilmart, water': ((0.345, 0.653, 1.0), (1.8 / 0.345, 0.4 / 0.653, -0.9),
                                  2.2146446558330431),
}


def period(name):
    """Return the known period of the rates, s, and the period computed over a million periods."""
    moments, rates, known = TOPS[name]
    body = RigidBody.from_moments(*moments)
    time_ns = round(PERIODS * known * 1e9)
    motion = propagate(body, State(0, angular_velocity=rates), at=[time_ns], solver='exact')
    change = body.angular_acceleration(rates)
    late = (motion.angular_velocity[0] - rates) @ change / (change @ change)
    return known, (time_ns * 1e-9 - late) / PERIODS


def escape(offset):
    """Return K / lambda, s, the time when w2 = 0 for a body 1 : 2 : 3 that leaves axis 2."""
    body, rates = RigidBody.from_moments(1.0, 2.0, 3.0), np.array([offset, 1.0, 0.0])
    with mp.workdps(50):
        square = 2 * mp.mpf(offset) ** 2
        known = float(mp.ellipk(2 / (2 + square)) / mp.sqrt((2 + square) / 6))
    time_ns = round(known * 1e9)
    rates = propagate(body, State(0, angular_velocity=rates), at=[time_ns]).angular_velocity[0]
    return known, time_ns * 1e-9 - rates[1] / body.angular_acceleration(rates)[1]


def landau_zener(half_time):
    """
    Return R33 of a sphere with w = (1, 0, t) from -T to T, a sweep through resonance.

    A row (a, b) of the matrix of SU(2) obeys a'' + ((1 + t^2) / 4 + i / 2) a = 0, which parabolic
    cylinder functions solve (Zener 1932). For infinite T, R33 = 2 exp(-pi / 2) - 1.
    """
    with mp.workdps(30):
        turn, order = mp.expjpi(0.25), mp.mpc(0, -0.25)

        def pair(t):
            # Both solutions and their slopes; D_v' = z D_v / 2 - D_(v + 1).
            columns = []
            for z, sign in ((turn * t, 1), (-turn * t, -1)):
                value = mp.pcfd(order, z)
                columns.append((value, sign * turn * (z * value / 2 - mp.pcfd(order + 1, z))))
            return mp.matrix(columns).T
        start = mp.matrix([1, mp.mpc(0, 0.5) * half_time])  # b = 0: a' = -i t a / 2
        survives = (pair(half_time) * mp.lu_solve(pair(-half_time), start))[0]
        known = float(2 * abs(survives) ** 2 - 1)
    start = State(0, angular_velocity=(1.0, 0.0, -half_time))
    motion = propagate(RigidBody(np.eye(3)), start, TorqueLog([0], [[0.0, 0.0, 1.0]]),
                       at=[2 * half_time * SECOND])
    return known, so3.matrix(motion.attitude[0])[2, 2]


def boedewadt(seconds):
    """
    Return the rates of a symmetric body under a torque held in body axes, rad/s, complex.

    w1 + i w2 = exp(i f) [W + (tau1 + i tau2) / It  int exp(-i f) dt], where
    f = k (w3 t + tau3 t^2 / 2 I3) and k = (I3 - It) / It (Boedewadt 1952; Longuski 1991).
    """
    across, along, rates, torque = 2.0, 3.0, (0.3, -0.2, 1.5), (0.4, 0.1, -0.2)
    with mp.workdps(30):
        ratio = mp.mpf(along - across) / mp.mpf(across)

        def angle(t):
            return ratio * (rates[2] * t + mp.mpf(torque[2]) * t * t / (2 * along))
        impulse = mp.quad(lambda t: mp.expj(-angle(t)), mp.linspace(0, seconds, 4 * seconds + 1))
        known = complex(mp.expj(angle(seconds)) * (
            mp.mpc(*rates[:2]) + mp.mpc(*torque[:2]) / across * impulse))
    motion = propagate(RigidBody.from_moments(across, across, along),
                       State(0, angular_velocity=rates), TorqueLog([0], [torque]),
                       at=[seconds * SECOND])
    return known, complex(*motion.angular_velocity[0, :2])


def gyrostat(seconds):
    """
    Return attitude and rates, known and computed, of a symmetric body with a rotor on its axis.

    With I1 w + (I3 w3 + h - I1 w3) e3 = L the attitude is exp(L t / 2 I1) exp(m e3 t / 2), where
    m = w3 - (I3 w3 + h) / I1, and w1 + i w2 turns at -m = ((I3 - I1) w3 + h) / I1.
    """
    across, along, rates, rotors = 2.0, 3.0, (0.5, -0.25, 1.5), 4.0
    motion = propagate(RigidBody.from_moments(across, across, along),
                       State(0, angular_velocity=rates, rotor_momentum=(0.0, 0.0, rotors)),
                       at=[seconds * SECOND])
    with mp.workdps(30):
        momentum = np.array([*(across * mp.mpf(rate) for rate in rates[:2]),
                             along * mp.mpf(rates[2]) + rotors])
        spin = rates[2] - momentum[2] / across
        turned = mp.mpc(*rates[:2]) * mp.expj(-spin * seconds)
        attitude = truth.times(truth.turn(momentum / across, seconds),
                               truth.turn(np.array([mp.zero, mp.zero, spin]), seconds))
        known = attitude.astype(float), (float(turned.real), float(turned.imag), rates[2])
    return {'attitude': (known[0], motion.attitude[0]),
            'rates': (known[1], motion.angular_velocity[0])}


def damped_sphere(seconds):
    """Return attitude and rates, known and computed, of a sphere with w = W exp(-d t / I)."""
    inertia, damping, rates = 2.0, 0.03125, (0.6, -1.2, 2.5)
    motion = propagate(RigidBody(inertia * np.eye(3), damping * np.eye(3)),
                       State(0, angular_velocity=rates), at=[seconds * SECOND])
    with mp.workdps(30):
        rate, start = mp.mpf(damping) / inertia, truth.exact(rates)
        attitude = truth.turn(start, -mp.expm1(-rate * seconds) / rate)
        known = attitude.astype(float), (start * mp.exp(-rate * seconds)).astype(float)
    return {'attitude': (known[0], motion.attitude[0]),
            'rates': (known[1], motion.angular_velocity[0])}


def dual_spin(axis, rotors):
    """
    Return the rate, 1/s, at which small deviations of a dual spin grow or swing.

    The body 1 : 2 : 3 spins at 1 rad/s about one of its axes, 0 to 2, which is also the axis of
    its rotor. If I is the moment of that axis, and I' and I" are the others, the square of the
    rate is -(I - I' + h) (I - I" + h) / (I' I") (Schaub and Junkins, Analytical Mechanics of Space
    Systems, chapter 4). The spin is stable where this square is negative.
    """
    moments, spin = np.array([1.0, 2.0, 3.0]), np.eye(3)[axis]
    others = np.delete(moments, axis)
    square = -np.prod((moments[axis] - others + rotors) / others)
    known = math.sqrt(abs(square))
    time_ns = round(0.5 * math.pi / known * SECOND)
    probe = (axis + 1) % 3
    motion = propagate(RigidBody.from_moments(*moments),
                       State(0, angular_velocity=spin + 1e-8 * np.eye(3)[probe],
                             rotor_momentum=rotors * spin), at=[time_ns])
    deviation = motion.angular_velocity[0, probe] / 1e-8
    angle = math.acosh(deviation) if square > 0.0 else math.acos(deviation)
    return known, angle / time_ns * SECOND


def spin_up():
    """Return the cosine of half the angle of a spin-up from -1e4 to 1.5e4 rad/s, axis 3."""
    body = RigidBody.from_moments(1.0, 2.0, 2.5)
    motion = propagate(body, State(0, angular_velocity=(0.0, 0.0, -1e4)),
                       TorqueLog([0], [[0.0, 0.0, 2.5 * 8192.0]]), at=[3 * SECOND])
    with mp.workdps(30):
        known = float(mp.cos((-3e4 + mp.mpf(8192) * 9 / 2) / 2))
    return known, motion.attitude[0, 3]


#: Largest momentum error, max |dL| / |L|, of ODE with Gazebo's boxes in 10 s, by step, s; from
#: github.com/scpeters/benchmark, BENCHMARK_boxes_dt.csv.
ODE_LOSSES = {1e-3: 1.30708e-2, 5e-4: 6.43471e-3, 1e-4: 1.2715e-3}


def lost_momentum(solver, step):
    """Return the momentum error of a solver of this package for the same motion."""
    motion = propagate(RigidBody.from_moments(0.80833, 0.68333, 0.14167),
                       State(0, angular_velocity=(0.1, 5.0, 0.1)), solver=solver,
                       at=np.arange(0, 10 * SECOND + 1, SECOND // 1000),
                       max_step=step if solver in FIXED_STEP else None)
    momentum = motion.angular_momentum_space
    apart = np.linalg.norm(momentum - momentum[0], axis=1)
    return apart.max() / np.linalg.norm(momentum[0])


#: For each quantity with its unit, a function that returns the reference and the result, and the
#: bound on their difference.
KNOWN = {
    **{f'period of {name}, s': (lambda name=name: period(name), 1e-15) for name in TOPS},
    **{f'escape from the intermediate axis, offset {offset:.0e}, s':
       (lambda offset=offset: escape(offset), 1e-14)
       for offset in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15)},
    'Landau-Zener, R33 from -20 s to 20 s': (lambda: landau_zener(20), 1e-13),
    'Landau-Zener, R33 from -40 s to 40 s': (lambda: landau_zener(40), 1e-12),
    'Boedewadt, w1 + i w2 after 30 s, rad/s': (lambda: boedewadt(30), 1e-14),
    'spin from -1e4 to 1.5e4 rad/s, cosine of half the angle': (spin_up, 1e-11),
}
