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

"""Motions whose derivatives are known with more digits than a double has."""

from dataclasses import dataclass, field
import json
from pathlib import Path

import numpy as np
from rigid_body_ros import (
    Actuator,
    BodyLog,
    EffortLog,
    GravityGradient,
    Problem,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
    Wheel,
)

SECOND = 10 ** 9
FULL = np.array([[1.1, 0.15, -0.2], [0.15, 2.0, 0.05], [-0.2, 0.05, 2.7]])
ATTITUDE = np.array([2.0, -4.0, 5.0, 6.0]) / 9.0
WHEEL = np.array([0.4, -0.3, 0.2])
#: The body after a change.
NEXT = RigidBody(0.5 * FULL + np.diag([0.25, 0.125, 0.0]), np.diag([0.02, 0.03, 0.04]))


@dataclass(frozen=True)
class Case:
    """A motion under a number of torques of equal duration, N m."""

    inertia: np.ndarray = field(default_factory=FULL.copy)
    rates: tuple[float, float, float] = (0.5, -0.7, 0.9)
    seconds: float = 5.0
    #: How many torques there are, and their size.
    count: int = 0
    size: float = 0.4
    in_space: bool = False
    interpolation: str = 'hold'
    #: The fraction of the first torque that is over when the motion starts.
    begun: float = 0.0
    attitude: np.ndarray = field(default_factory=ATTITUDE.copy)
    momentum: np.ndarray = field(default_factory=lambda: np.zeros(3))
    damping: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    #: Torque on the rotors; and named wheels, and the efforts of their motors.
    motor: np.ndarray = field(default_factory=lambda: np.zeros(3))
    wheels: tuple[Wheel, ...] = ()
    efforts: tuple[float, ...] = ()
    #: The moment, kg m, of a body under gravity, m/s^2.
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: tuple[float, float, float] = (2.0, 4.0, -9.0)
    #: Mean motion of the orbit, rad/s, and time constant of the actuator, s.
    mean_motion: float = 0.0
    lag: float = 0.0
    #: What stays the same when the body changes, after half of the motion.
    keep: str = ''
    #: Parameters with derivatives, apart from those that every motion has.
    more: tuple[str, ...] = ()
    #: Whether the truth is that of the closed form.
    is_free: bool = False

    @property
    def end_ns(self):
        """Return the time at which the derivatives are known, ns."""
        return round(self.seconds * SECOND)

    @property
    def torques(self):
        """Return the torques, in order."""
        return np.random.default_rng(self.count).normal(size=(self.count, 3)) * self.size

    @property
    def times_ns(self):
        """Return the times at which the torques begin, ns."""
        span_ns = round(self.end_ns / max(self.count - self.begun, 1))
        return np.arange(self.count) * span_ns - round(self.begun * span_ns)

    def parameters(self):
        """Return the values of all parameters, and the attitude at the start."""
        return {'inertia': self.inertia, 'damping': self.damping,
                'initial_rotor_momentum': self.momentum, 'attitude': self.attitude,
                'initial_angular_velocity': self.rates, 'torque_gains': np.ones(3),
                'torque_bias': np.zeros(3), 'torque_delay': [0.0], 'torque_lag': [self.lag],
                'weight.moment': self.moment}

    def names(self):
        """Return the names of the parameters with derivatives."""
        return ['inertia', 'start', 'rotor_momentum', 'damping'][:2 if self.is_free else 4] + (
            ['torque_gains'] * bool(self.count)
            + ['torque_bias'] * bool(self.count and not (self.in_space or self.lag))
            + [*self.more])

    def problem(self):
        """Return the problem in doubles."""
        fields = [UniformField(self.moment, self.gravity, 'weight')] if any(self.moment) else []
        if self.mean_motion:
            fields.append(GravityGradient(self.mean_motion))
        return Problem(
            RigidBody(self.inertia, self.damping if self.damping.any() else None),
            State(0, self.attitude, self.rates, self.momentum),
            TorqueLog(self.times_ns, self.torques, 'space' if self.in_space else 'body',
                      self.interpolation),
            wheels=self.wheels or (TorqueLog([0], [self.motor]) if any(self.motor) else None),
            fields=fields,
            efforts=EffortLog([0], [self.efforts]) if self.efforts else None,
            actuator=Actuator(time_constant=self.lag) if self.lag else None,
            changes=BodyLog([self.end_ns // 2], [NEXT], self.keep) if self.keep else None)


DAMPING = np.diag([0.05, 0.02, 0.1]) + 0.01
REST = (0.0, 0.0, 0.0)
DELAYED, LAGGING, WEIGHED = ('torque_delay',), ('torque_lag', 'torque_delay'), ('weight.moment',)
CASES = {
    'free': Case(seconds=10.0),
    'log at 50 Hz': Case(seconds=4.0, count=200, size=0.3),
    'rod': Case(np.diag([1e-4, 1.0, 1.00005]), (3.0, 0.02, -0.03)),
    'plate': Case(np.diag([1.0, 2.0, 3.0 - 1e-9]), (0.3, 1.0, 0.2), count=10, size=0.1),
    'near-sphere': Case(np.diag([1.0, 1.0 + 1e-9, 1.0 + 3e-9]), (1.0, 0.5, -0.8), 20.0),
    'separatrix': Case(np.diag([1.0, 2.0, 3.0]), (1e-6, 1.0, 1e-6), 10.0),
    'torque in space axes': Case(rates=(0.1, 0.2, 0.3), count=5, in_space=True),
    'rotors and damping': Case(count=5, size=0.2, momentum=WHEEL, damping=DAMPING),
    'rotors of a body at rest': Case(rates=REST, momentum=WHEEL),
    'from rest': Case(rates=REST, count=1),
    'log at 1 kHz': Case(seconds=1.0, count=1000, size=0.3),
    'top': Case(rates=(0.5, -0.7, 3.0), momentum=WHEEL, moment=(0.1, -0.05, 0.2), damping=DAMPING,
                more=WEIGHED),
    'hanging': Case(rates=REST, moment=(0.0, 0.0, -0.5), gravity=(0.0, 0.0, -9.0),
                    attitude=np.array([0.0, 0.0, 0.0, 1.0]), more=WEIGHED),
    'rod under gravity': Case(np.diag([1e-4, 1.0, 1.00005]), (3.0, 0.02, -0.03), 1.0,
                              moment=(0.25, 1e-4, -5e-5), more=WEIGHED),
    'orbit': Case(rates=(0.05, -0.07, 0.3), mean_motion=0.3),
    'orbit at rest': Case(rates=REST, mean_motion=0.3),
    'lag': Case(count=5, begun=0.25, lag=0.6, more=LAGGING),
    'lag in space axes': Case(count=5, in_space=True, lag=0.6, more=LAGGING),
    'cubic': Case(count=5, interpolation='cubic', more=DELAYED),
    'linear in space axes': Case(count=5, in_space=True, interpolation='linear', more=DELAYED),
    'delay': Case(count=5, more=DELAYED),
    'delay in space axes': Case(count=5, in_space=True, begun=0.25, more=DELAYED),
    'motor': Case(count=5, size=0.2, momentum=WHEEL, motor=0.25 * WHEEL[::-1]),
    'wheels': Case(count=5, size=0.2, efforts=(0.25, -0.125), wheels=(
        Wheel('a', (1.0, 0.0, 0.0), 0.125, 20.0), Wheel('b', (0.6, 0.0, 0.8), 0.0625))),
    'change that keeps the rate': Case(count=5, momentum=WHEEL, keep='rate', more=DELAYED),
    'change that keeps the momentum': Case(count=5, momentum=WHEEL, damping=DAMPING,
                                           keep='momentum', more=DELAYED),
    'change at the stamp of a torque': Case(seconds=4.0, count=4, keep='rate', more=DELAYED),
    'ten thousand turns': Case(seconds=50_000.0, is_free=True),
    'ten thousand turns of a near-sphere': Case(np.diag([1.0, 1.0 + 1e-6, 1.0 + 3e-6]),
                                                seconds=50_000.0, is_free=True)}
TRUTH = json.loads(path.read_text()) if (
    path := Path(__file__).with_name('truth_derivatives.json')).exists() else {}
