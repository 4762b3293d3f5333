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

"""Motions with known parameters, and the measurements of sensors."""

from dataclasses import dataclass, field, replace

import numpy as np
from rigid_body_ros import Problem, RigidBody, State, TorqueLog
from rigid_body_ros.identification import Experiment
from rigid_body_ros.mechanics import so3
from rigid_body_ros.recording.measured import Measured
from scipy.spatial.transform import Rotation

SECOND = 10 ** 9
INERTIA = np.array([[0.020, 0.001, -0.002], [0.001, 0.030, 0.0005], [-0.002, 0.0005, 0.040]])


@dataclass
class Truth:
    """A motion under held torques; benchmarks/simulated.py has some of another integrator."""

    seconds: float = 20.0
    torque_hz: int = 10
    measured_hz: int = 50
    amplitude: float = 0.02
    inertia: np.ndarray = field(default_factory=lambda: INERTIA)
    rates: tuple = (0.5, 1.0, 0.2)
    attitude: tuple = (0.1, -0.2, 0.3, 0.9)
    damping: np.ndarray | None = None
    bias: tuple = (0.0, 0.0, 0.0)
    gain: float = 1.0
    #: Momentum of the rotors at the torque samples, linear between them.
    momentum: np.ndarray | None = None
    axes: tuple = (1.0, 1.0, 1.0)
    frame: str = 'body'
    #: Further options of the problem: `wheels`, `efforts`, `fields` and `actuator`.
    options: dict = field(default_factory=dict)

    def __post_init__(self):
        count = round(self.seconds * self.torque_hz)
        self.times = np.arange(count + 1) * (SECOND // self.torque_hz)
        phases = np.outer(self.times * 1e-9, [0.7, 1.1, 1.7]) + np.arange(3.0)
        self.torques = self.amplitude * np.sin(phases) * self.axes
        spacing = SECOND // self.measured_hz
        self.stamps_ns = np.arange(1, round(self.seconds * self.measured_hz)) * spacing
        self.log = TorqueLog(self.times, self.torques, self.frame)
        acting = [TorqueLog(self.times, self.gain * self.torques, self.frame)]
        if any(self.bias):
            acting.append(TorqueLog([0], [self.bias]))
        if self.momentum is not None:
            self.options = {'wheels': TorqueLog.from_momentum(self.times, self.momentum)}
        self.start = State(0, self.attitude, self.rates,
                           (0.0, 0.0, 0.0) if self.momentum is None else self.momentum[0])
        self.problem = Problem(RigidBody(self.inertia, self.damping), self.start, acting,
                               **self.options)
        motion = self.problem.propagate(at=self.stamps_ns)
        self.q, self.w = motion.attitude, motion.angular_velocity

    def experiment(self, *measured, start=None):
        return Experiment(start or self.start, self.log, measured, self.options.get('wheels'),
                          efforts=self.options.get('efforts'))

    def measured(self, attitude=0.0, rate=0.0, seed=0, topic='/imu'):
        """Return attitudes and rates with noise; a noise of None leaves a quantity out."""
        random = np.random.default_rng(seed)
        turned, added = random.standard_normal((2, len(self.stamps_ns), 3))
        q = None if attitude is None else so3.multiply(self.q, so3.exp(attitude * turned))
        w = None if rate is None else self.w + rate * added
        return Measured(topic, self.stamps_ns, q, w)


def shifted(measured, seconds):
    """Return measurements of a sensor whose clock is late by some seconds."""
    return replace(measured, stamps_ns=measured.stamps_ns - round(seconds * SECOND))


def mounted(measured, vector):
    """Return measurements in the axes of a sensor that is turned by a rotation vector."""
    turn, rates = so3.exp(vector), measured.angular_velocity
    return replace(measured, attitude=so3.multiply(measured.attitude, turn), angular_velocity=(
        None if rates is None else so3.rotate(so3.conjugate(turn), rates)))


def with_outliers(measured, fraction, seed=0):
    """Return measurements of which some are outliers."""
    random = np.random.default_rng(seed)
    bad = random.random(len(measured.stamps_ns)) < fraction
    q, w = measured.attitude.copy(), measured.angular_velocity.copy()
    q[bad] = Rotation.random(int(bad.sum()), random_state=seed).as_quat()
    w[bad] += 5.0 * random.standard_normal((int(bad.sum()), 3))
    return replace(measured, attitude=q, angular_velocity=w), bad
