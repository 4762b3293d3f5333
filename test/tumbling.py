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

"""Motions with known parameters, integrated by SciPy, and the measurements of sensors."""

from dataclasses import dataclass
from dataclasses import field as default

import numpy as np
from rigid_body_ros import State, TorqueLog
from rigid_body_ros.identification import Experiment
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.measured import Measured
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

SECOND = 10 ** 9
INERTIA = np.array([[0.020, 0.001, -0.002], [0.001, 0.030, 0.0005], [-0.002, 0.0005, 0.040]])


@dataclass
class Truth:
    """A motion that SciPy's DOP853 integrates: all torques are held between samples."""

    seconds: float = 20.0
    torque_hz: int = 10
    measured_hz: int = 50
    amplitude: float = 0.02
    inertia: np.ndarray = default(default_factory=lambda: INERTIA)
    rates: tuple = (0.5, 1.0, 0.2)
    attitude: tuple = (0.1, -0.2, 0.3, 0.9)
    damping: np.ndarray = default(default_factory=lambda: np.zeros((3, 3)))
    bias: tuple = (0.0, 0.0, 0.0)
    gain: float = 1.0
    #: Momentum of the rotors at the torque samples, linear between them.
    momentum: np.ndarray | None = None
    axes: tuple = (1.0, 1.0, 1.0)
    #: The moment of a weight, body axes, and its field, space axes.
    moment: tuple = (0.0, 0.0, 0.0)
    field: tuple = (0.0, 0.0, -9.81)

    def __post_init__(self):
        count = round(self.seconds * self.torque_hz)
        self.times = np.arange(count + 1) * (SECOND // self.torque_hz)
        phases = np.outer(self.times * 1e-9, [0.7, 1.1, 1.7]) + np.arange(3.0)
        self.torques = self.amplitude * np.sin(phases) * self.axes
        spacing = SECOND // self.measured_hz
        self.stamps_ns = np.arange(1, round(self.seconds * self.measured_hz)) * spacing
        self.q, self.w = self._integrated()

    @property
    def start(self):
        return State(0, self.attitude, self.rates,
                     self.momentum[0] if self.momentum is not None else (0.0, 0.0, 0.0))

    @property
    def log(self):
        return TorqueLog(self.times, self.torques)

    @property
    def wheels(self):
        return None if self.momentum is None else TorqueLog.from_momentum(self.times,
                                                                          self.momentum)

    def experiment(self, *measured, start=None):
        return Experiment(start or self.start, self.log, measured, self.wheels)

    def measured(self, attitude=0.0, rate=0.0, seed=0, topic='/imu'):
        """Return attitudes and rates with noise; a noise of None leaves a quantity out."""
        random = np.random.default_rng(seed)
        turned, added = random.standard_normal((2, len(self.stamps_ns), 3))
        q = None if attitude is None else so3.multiply(self.q, so3.exp(attitude * turned))
        w = None if rate is None else self.w + rate * added
        return Measured(topic, self.stamps_ns, q, w)

    def _integrated(self):
        inertia, inverse = self.inertia.tolist(), np.linalg.inv(self.inertia).tolist()
        damping = self.damping.tolist()
        momenta = np.zeros_like(self.torques) if self.momentum is None else self.momentum

        def times(matrix, v):
            return [row[0] * v[0] + row[1] * v[1] + row[2] * v[2] for row in matrix]

        def weight(x, y, z, s):
            if not any(self.moment):
                return 0.0, 0.0, 0.0
            f = times([[s * s + x * x - y * y - z * z, 2 * (x * y + z * s), 2 * (x * z - y * s)],
                       [2 * (x * y - z * s), s * s - x * x + y * y - z * z, 2 * (y * z + x * s)],
                       [2 * (x * z + y * s), 2 * (y * z - x * s), s * s - x * x - y * y + z * z]],
                      self.field)
            a, b, c = self.moment
            return b * f[2] - c * f[1], c * f[0] - a * f[2], a * f[1] - b * f[0]

        def slope(t, state, torque, rotors, spin, begin):  # plain floats are ten times as fast
            x, y, z, s, *w = state.tolist()
            a, b, c = (moment + rotor + rate * (t - begin) for moment, rotor, rate
                       in zip(times(inertia, w), rotors, spin))
            gyroscopic = (b * w[2] - c * w[1], c * w[0] - a * w[2], a * w[1] - b * w[0])
            total = [one + tau - rate - drag + pull for one, tau, rate, drag, pull
                     in zip(gyroscopic, torque, spin, times(damping, w), weight(x, y, z, s))]
            return [0.5 * (s * w[0] + y * w[2] - z * w[1]), 0.5 * (s * w[1] + z * w[0] - x * w[2]),
                    0.5 * (s * w[2] + x * w[1] - y * w[0]),
                    -0.5 * (x * w[0] + y * w[1] + z * w[2]), *times(inverse, total)]
        y = np.append(self.start.attitude, self.rates)
        rows = []
        for k in range(len(self.times) - 1):
            begin, end = self.times[k:k + 2] * 1e-9
            inside = self.stamps_ns[(self.stamps_ns >= self.times[k])
                                    & (self.stamps_ns < self.times[k + 1])] * 1e-9
            spin = (momenta[k + 1] - momenta[k]) / (end - begin)
            acting = self.gain * self.torques[k] + self.bias
            vectors = (one.tolist() for one in (acting, momenta[k], spin))
            result = solve_ivp(slope, (begin, end), y, 'DOP853', np.append(inside, end),
                               args=(*vectors, begin), rtol=1e-12, atol=1e-13)
            rows.append(result.y[:, :-1].T)
            y = result.y[:, -1]
        found = np.concatenate(rows)
        return so3.normalize(found[:, :4]), found[:, 4:]


def shifted(measured, seconds):
    """Return measurements of a sensor whose clock is late by some seconds."""
    return Measured(measured.topic, measured.stamps_ns - round(seconds * SECOND),
                    measured.attitude, measured.angular_velocity)


def mounted(measured, vector):
    """Return measurements in the axes of a sensor that is turned by a rotation vector."""
    turn, rates = so3.exp(vector), measured.angular_velocity
    return Measured(measured.topic, measured.stamps_ns, so3.multiply(measured.attitude, turn),
                    None if rates is None else so3.rotate(so3.conjugate(turn), rates))


def with_outliers(measured, fraction, seed=0):
    """Return measurements of which some are outliers."""
    random = np.random.default_rng(seed)
    bad = random.random(len(measured.stamps_ns)) < fraction
    q, w = measured.attitude.copy(), measured.angular_velocity.copy()
    q[bad] = Rotation.random(int(bad.sum()), random_state=seed).as_quat()
    w[bad] += 5.0 * random.standard_normal((int(bad.sum()), 3))
    return Measured(measured.topic, measured.stamps_ns, q, w), bad
