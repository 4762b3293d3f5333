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

"""Trajectories: their results and how they are printed."""

from conftest import EPOCH_NS, SECOND
import numpy as np
from rigid_body_ros import propagate, RigidBody, State
from rigid_body_ros.mechanics import so3

BODY = RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05)
START = State(EPOCH_NS, (0.1, -0.2, 0.3, 0.9), (0.5, -0.7, 0.9))


def test_the_attitudes_come_as_a_scipy_rotation():
    motion = propagate(BODY, START, at=EPOCH_NS + np.arange(0, 100, 10) * SECOND)
    np.testing.assert_allclose(motion.rotation.as_quat(), motion.attitude, rtol=0, atol=4e-16)
    vector = np.array([0.3, -0.1, 0.7])
    np.testing.assert_allclose(motion.rotation.apply(vector),
                               so3.rotate(motion.attitude, vector), rtol=0, atol=1e-15)


def test_a_trajectory_is_printed_with_units():
    motion = propagate(BODY, START, at=[EPOCH_NS + 3 * SECOND, EPOCH_NS])
    assert repr(motion) == f'Trajectory(2 states from {EPOCH_NS} ns on, over 3 s)'
    assert repr(propagate(BODY, START, at=[])) == 'Trajectory(no states)'
