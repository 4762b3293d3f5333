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

"""The problems that this package and its peers solve, and the errors of their results."""

from dataclasses import dataclass, field
from functools import cached_property
import hashlib
import json
from pathlib import Path
import sys

from mpmath import mp
import numpy as np
from rigid_body_ros import RigidBody, State, TorqueLog

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / 'test'))
import truth  # noqa: E402

TRUTH = HERE / 'truth.json'
SECOND = 10 ** 9
IDENTITY = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Problem:
    """
    A body in principal axes that starts at the identity, under torques held for equal times.

    Attributes
    ----------
    moments : (float, float, float), kg m^2
    rates : (float, float, float), rad/s
    seconds : int
    torques : array, shape (n, 3), N m, body axes

    """

    moments: tuple
    rates: tuple
    seconds: int
    torques: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def end_ns(self):
        """Return the time of the last requested state."""
        return self.seconds * SECOND

    @property
    def hold_ns(self):
        """Return how long each torque is held, ns; without torques, the whole time."""
        return self.end_ns // max(1, len(self.torques))

    @property
    def at(self):
        """Return the requested times, ns, (m,): the end of each torque, or of the motion."""
        return np.arange(1, max(1, len(self.torques)) + 1) * self.hold_ns

    @property
    def coupling(self):
        """Return the factors of w2 w3, w3 w1 and w1 w2 in Euler's equations."""
        i1, i2, i3 = self.moments
        return (i2 - i3) / i1, (i3 - i1) / i2, (i1 - i2) / i3

    @property
    def accelerations(self):
        """Return the torques over the moments, rad/s^2, shape (n, 3)."""
        return self.torques / self.moments

    @property
    def first_acceleration(self):
        """Return the first of the accelerations, or zeros without torques."""
        return tuple(self.accelerations[0].tolist()) if len(self.torques) else (0.0, 0.0, 0.0)

    @property
    def start_vector(self):
        """Return rates and attitude at the start, shape (7,), as a solver of equations needs."""
        return np.array(self.rates + IDENTITY)

    @cached_property
    def scene(self):
        """Return the arguments of `propagate`: body, start and log."""
        times_ns = np.arange(len(self.torques)) * self.hold_ns
        log = TorqueLog(times_ns, self.torques) if len(self.torques) else None
        return (RigidBody.from_moments(*self.moments),
                State(0, attitude=IDENTITY, angular_velocity=self.rates), log)

    @property
    def fingerprint(self):
        """Return a digest of everything that the reference depends on, including every torque."""
        doubles = np.concatenate([self.moments, self.start_vector, self.torques.ravel()])
        digest = hashlib.sha256(doubles.astype('<f8').tobytes())
        digest.update(str(self.end_ns).encode())
        return digest.hexdigest()[:16]


def wave():
    """Return a minute of three sines, one about each axis, sampled at 1 kHz."""
    seconds = np.arange(60_000) * 1e-3
    return 0.5 * np.sin(2 * np.pi * np.outer(seconds, (0.7, 1.1, 1.9)))


PROBLEMS = {
    'P1': Problem((1.0, 2.0, 3.0), (0.01, 1.0, 0.02), 100),
    'P1f': Problem((1.0, 2.0, 3.0), (0.1, 10.0, 0.2), 100),
    'P2': Problem((1.0, 2.0, 3.0), (1.0, 0.4, 2.0), 1000),
    'P3': Problem((1.0, 2.0, 3.0), (0.1, 0.2, -0.1), 100, np.array([[0.02, -0.01, 0.03]])),
    'P4': Problem((1.0, 2.0, 3.0), (0.3, -0.2, 0.5), 60, wave()),
    'P5': Problem((1.0, 1.0 + 1e-9, 1.0 + 2e-9), (1.0, 0.4, 2.0), 1000),
    'P6': Problem((1e-6, 1.0, 1.0000005), (50.0, 1.0, 1.0), 10),
}


def error(name, attitude):
    """Return the angle, rad, between an attitude and the true final attitude of a problem."""
    recorded = json.loads(TRUTH.read_text())[name]
    if recorded['fingerprint'] != PROBLEMS[name].fingerprint:
        raise SystemExit(f'{TRUTH.name}: {name}: computed from other numbers than those of the '
                         f'problem; run python {HERE.name}/make_truth.py {name}')
    with mp.workdps(40):
        return truth.chord(truth.exact(recorded['attitude']), attitude)
