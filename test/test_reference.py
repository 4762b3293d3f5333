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

"""The engine, compared with motions of 50 digits and with closed forms."""

from conftest import chord, RECORDINGS, Reference, SECOND
from mpmath import mp
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import so3

NAMES = sorted(path.stem for path in RECORDINGS.glob('*.yaml'))
#: Largest error, rad, in scenes that amplify rounding errors.
AMPLIFYING = {'separatrix': 1e-7, 'torque_free_intermediate_axis': 5e-12}


def test_every_reference_motion_is_here():
    assert len(NAMES) == 15


def cases():
    """Return pairs of a scene and a solver that it applies to."""
    for name in NAMES:
        solvers = ('auto', 'taylor') if Reference(name).log.torques.any() else \
            ('auto', 'taylor', 'exact')
        yield from ((name, solver) for solver in solvers)


@pytest.mark.parametrize(('name', 'solver'), [*cases()])
def test_motion_is_that_of_fifty_digits(name, solver):
    reference = Reference(name)
    motion = reference.propagate(solver=solver)
    bound = AMPLIFYING.get(name, 1e-15 * (10.0 + reference.phase()))
    assert np.all(chord(reference.attitude, motion.attitude) <= bound)
    fastest = np.linalg.norm(reference.angular_velocity, axis=1).max()
    apart = np.linalg.norm(motion.angular_velocity - reference.angular_velocity, axis=1)
    assert np.all(apart <= bound * fastest)
    assert np.abs(np.linalg.norm(motion.attitude, axis=1) - 1.0).max() < 1e-14
    assert np.all(euler_error(reference.attitude, motion.euler_angles()) <= 4.0 * bound)


def euler_error(attitude, angles):
    """Return the error of 3-1-3 angles; at a pole, of theta and of the sum or difference."""
    errors = []
    with mp.workdps(30):
        for (x, y, z, w), given in zip(attitude.tolist(), angles.tolist()):
            theta = 2 * mp.atan2(mp.hypot(x, y), mp.hypot(w, z))
            half_sum, half_difference = mp.atan2(z, w), mp.atan2(y, x)
            pairs = [(given[0] + mp.mpf(given[2]), 2 * half_sum),
                     (given[0] - mp.mpf(given[2]), 2 * half_difference)]
            if abs(mp.sin(theta)) < 1e-7:
                pairs = pairs[:1] if theta < 1 else pairs[1:]
            turns = [(found - right) / (4 * mp.pi) for found, right in pairs]
            errors.append(max(abs(given[1] - theta), *(
                4 * mp.pi * abs(turn - mp.nint(2 * turn) / 2) for turn in turns)))
    return np.array(errors, float)


def test_sphere_under_constant_body_torque_turns_about_one_axis():
    # Torque along the spin: theta = w t + tau t^2 / 2 I, from -50 rad/s through rest to +50.
    body, axis = RigidBody(2.0 * np.eye(3)), so3.normalize([1.0, -2.0, 2.0])
    times = np.arange(0, 21) * SECOND
    motion = propagate(body, State(0, angular_velocity=-50.0 * axis),
                       TorqueLog([0], [10.0 * axis]), at=times)
    t = times * 1e-9
    angle = -50.0 * t + 10.0 * t * t / (2.0 * 2.0)
    np.testing.assert_allclose(motion.angular_velocity, np.outer(-50.0 + 5.0 * t, axis),
                               atol=1e-14 * 50)
    assert chord(so3.exp(angle[:, None] * axis), motion.attitude).max() < 1e-15 * (10 + 250)


def test_symmetric_top_precesses_at_l_over_i():
    # Free symmetric top: space precession rate L / It about L, body rate (I3 - It) w3 / It.
    body, w = RigidBody.from_moments(3.0, 3.0, 1.0), np.array([0.4, 0.0, 2.0])
    times = np.linspace(0, 100 * SECOND, 51).astype(np.int64)
    motion = propagate(body, State(0, angular_velocity=w), at=times)
    t = times[:, None] * 1e-9
    momentum = body.angular_momentum(w)
    expected = so3.multiply(so3.exp(t * momentum / 3.0),
                            so3.exp(t * [0.0, 0.0, (3.0 - 1.0) * 2.0 / 3.0]))
    assert chord(expected, motion.attitude).max() < 1e-15 * (10 + 204)
