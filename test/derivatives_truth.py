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
from rigid_body_ros import Problem, RigidBody, State, TorqueLog

SECOND = 10 ** 9
FULL = np.array([[1.1, 0.15, -0.2], [0.15, 2.0, 0.05], [-0.2, 0.05, 2.7]])
ATTITUDE = np.array([2.0, -4.0, 5.0, 6.0]) / 9.0
WHEEL = np.array([0.4, -0.3, 0.2])


@dataclass(frozen=True)
class Case:
    """A motion under a number of torques of equal duration."""

    inertia: np.ndarray
    rates: tuple[float, float, float]
    seconds: float
    #: How many torques there are, and their size, N m.
    count: int = 0
    size: float = 0.2
    in_space: bool = False
    momentum: np.ndarray = field(default_factory=lambda: np.zeros(3))
    damping: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    #: Whether the truth is that of the closed form.
    is_free: bool = False

    @property
    def end_ns(self):
        """Return the time at which the derivatives are known, ns."""
        return round(self.seconds * SECOND)

    @property
    def torques(self):
        """Return the duration of each torque, ns, and the torque, N m."""
        random = np.random.default_rng(self.count)
        rows = random.normal(size=(self.count, 3)) * self.size if self.count else np.zeros((1, 3))
        return [(self.end_ns // len(rows), row) for row in rows]

    def parameters(self):
        """Return the values of all parameters, and the attitude at the start."""
        return {'inertia': self.inertia.copy(), 'damping': self.damping.copy(),
                'initial_rotor_momentum': self.momentum.copy(), 'attitude': ATTITUDE.copy(),
                'initial_angular_velocity': np.array(self.rates), 'torque_gains': np.ones(3),
                'torque_bias': np.zeros(3)}

    def names(self):
        """Return the names of the parameters with derivatives."""
        return ['inertia', 'start', 'rotor_momentum', 'damping'][:2 if self.is_free else 4] + (
            ['torque_gains', 'torque_bias'] if self.count and not self.in_space else [])

    def components(self):
        """Return the components of these parameters."""
        return self.problem().derivatives(self.names(), at=[0]).names

    def problem(self):
        """Return the problem in doubles."""
        log = TorqueLog(np.arange(self.count) * (self.end_ns // max(self.count, 1)),
                        np.array([row for _, row in self.torques])[:self.count],
                        'space' if self.in_space else 'body') if self.count else None
        damping = self.damping if self.damping.any() else None
        return Problem(RigidBody(self.inertia, damping),
                       State(0, ATTITUDE, self.rates, self.momentum), log)


CASES = {
    'free': Case(FULL, (0.5, -0.7, 0.9), 10.0),
    'log at 50 Hz': Case(FULL, (0.5, -0.7, 0.9), 4.0, 200, 0.3),
    'rod': Case(np.diag([1e-4, 1.0, 1.00005]), (3.0, 0.02, -0.03), 5.0),
    'plate': Case(np.diag([1.0, 2.0, 3.0 - 1e-9]), (0.3, 1.0, 0.2), 5.0, 10, 0.1),
    'near-sphere': Case(np.diag([1.0, 1.0 + 1e-9, 1.0 + 3e-9]), (1.0, 0.5, -0.8), 20.0),
    'separatrix': Case(np.diag([1.0, 2.0, 3.0]), (1e-6, 1.0, 1e-6), 10.0),
    'torque in space axes': Case(FULL, (0.1, 0.2, 0.3), 5.0, 5, 0.4, True),
    'rotors and damping': Case(FULL, (0.5, -0.7, 0.9), 5.0, 5, momentum=WHEEL,
                               damping=np.diag([0.05, 0.02, 0.1]) + 0.01),
    'rotors of a body at rest': Case(FULL, (0.0, 0.0, 0.0), 5.0, momentum=WHEEL),
    'from rest': Case(FULL, (0.0, 0.0, 0.0), 5.0, 1, 0.4),
    'ten thousand turns': Case(FULL, (0.5, -0.7, 0.9), 50_000.0, is_free=True),
    'ten thousand turns of a near-sphere': Case(
        np.diag([1.0, 1.0 + 1e-6, 1.0 + 3e-6]), (0.5, -0.7, 0.9), 50_000.0, is_free=True),
}
TRUTH = json.loads(path.read_text()) if (
    path := Path(__file__).with_name('truth_derivatives.json')).exists() else {}
