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
Thin bodies under torque: rods and plates with full tensors are accurate to rounding.

One motion, or as many as the environment variable RODS sets, is compared with 25 digits.
"""

import os

import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.sensitivity import last_digit_effect
import truth

pytestmark = pytest.mark.nightly

COUNT = int(os.environ.get('RODS', '1'))
SECOND = 10 ** 9


def random_motion(seed):
    """Return body, start and torques of a rod or a ruler, ratios 1e-2 to 1e-6."""
    random = np.random.default_rng(seed)
    ratio, speed = 10.0 ** random.uniform(-6.0, -2.0), 10.0 ** random.uniform(0.3, 1.5)
    larger = 1.0 + ratio * (random.uniform() if seed % 2 else 1.0 - 1e-9)
    axes = so3.matrix(so3.normalize(random.normal(size=4)))
    tensor = axes @ np.diag([ratio, 1.0, larger]) @ axes.T
    rates = axes @ (speed * random.normal(size=3) * [1.0, 0.5, 0.5])
    frame, interpolation = ('body', 'space')[seed // 2 % 2], ('hold', 'linear', 'cubic')[seed % 3]
    # A torque in space axes sometimes lies along the rod, where a small torque spins it up.
    sizes = [ratio, 0.3, 0.3] if frame == 'body' else 3 * [ratio]
    torques = speed ** 1.5 * random.normal(size=(5, 3)) * sizes @ axes.T
    times_ns = np.cumsum(random.integers(SECOND // 2, 3 * SECOND // 2, 5))
    return (RigidBody(0.5 * (tensor + tensor.T)), State(int(times_ns[0]), angular_velocity=rates),
            TorqueLog(times_ns, torques, frame, interpolation))


@pytest.mark.parametrize('seed', range(COUNT))
def test_a_thin_body_under_torque_is_right_to_rounding(seed):
    body, start, log = random_motion(seed)
    motion = propagate(body, start, log, at=log.times_ns[1:])
    fine = np.linspace(0, log.times_ns[-1] - start.time_ns, 2001).astype(np.int64)
    speeds = np.linalg.norm(
        propagate(body, start, log, at=start.time_ns + fine).angular_velocity, axis=1)
    bound = 1e-15 * (10.0 + speeds.mean() * fine[-1] * 1e-9)
    torques = [(span, rows, log.in_space[0]) for span, rows in zip(
        np.diff(log.times_ns), truth.polynomials(log.times_ns, log.torques, log.interpolation))]
    right = truth.series(body.inertia, start.attitude, start.angular_velocity, torques, digits=25)
    apart = max(truth.chord(q, p) for (q, _), p in zip(right, motion.attitude))
    effect = last_digit_effect(Problem(body, start, log), at=log.times_ns[-1:])
    assert apart <= max(bound, effect)
