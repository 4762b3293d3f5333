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

"""The effect of the last digit of a tensor, a torque or a start on a motion."""

import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.sensitivity import last_digit_effect
from scenes import ROD, SECOND, turned

RATES = (0.5, -0.7, 0.9)


def test_a_spin_ends_where_the_last_digit_of_its_rate_leads():
    # 1.5 rad/s for a million seconds, in closed form; the last digit is 2.2e-16 rad/s.
    problem = Problem(RigidBody.from_moments(1.0, 2.0, 3.0),
                      State(0, angular_velocity=(0.0, 0.0, 1.5)))
    effect = last_digit_effect(problem, at=[10 ** 6 * SECOND])
    assert effect == pytest.approx(2.0 ** -52 * 1e6, rel=0.01)


def test_zeros_stay():
    # About the intermediate axis, the smallest product of inertia would cause a tumble.
    problem = Problem(RigidBody.from_moments(1.0, 2.0, 3.0),
                      State(0, angular_velocity=(0.0, 1.0, 0.0)))
    effect = last_digit_effect(problem, at=[1000 * SECOND])
    assert effect < 1e-12


def rod_under_torque(frame, interpolation):
    tensor, rates = turned(ROD, (5.0, 1.0, 1.0))
    torques = np.random.default_rng(1).normal(size=(6, 3)) * 1e-4
    return RigidBody(tensor), State(0, angular_velocity=rates), TorqueLog(
        np.arange(6) * SECOND, torques, frame, interpolation)


@pytest.mark.parametrize('frame', ['body', 'space'])
@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
def test_a_full_tensor_of_a_rod_leaves_much_to_its_last_digit(frame, interpolation):
    # A change of 1.1e-16 in the moments of 1 is 1e-10 of the moment of 1e-6, so the effect of a
    # torque along the rod changes by 1e-10.
    body, start, log = rod_under_torque(frame, interpolation)
    times = [3 * SECOND, 6 * SECOND]
    effect = last_digit_effect(Problem(body, start, log), at=times)
    assert 1e-11 < effect < 1e-6
    assert effect == last_digit_effect(Problem(body, start, log), at=times)
    changed = body.inertia.copy()
    changed[0, 0] = np.nextafter(changed[0, 0], np.inf)
    right, moved = (propagate(some, start, log, at=times).attitude
                    for some in (body, RigidBody(changed)))
    assert so3.angle_between(right, moved).max() < 10.0 * effect


def test_mixed_frames_and_timeouts_are_kept():
    body, start, log = rod_under_torque('body', 'hold')
    mixed = TorqueLog(log.times_ns, log.torques, ['body', 'space'] * 3)
    effects = [last_digit_effect(Problem(body, start, some, torque_timeout=timeout),
                                 at=[6 * SECOND])
               for some in (log, mixed) for timeout in (0.0, 0.5)]
    assert len(set(effects)) == 4


def test_a_changed_tensor_of_no_body_is_left_out():
    # If the largest moment were one unit in the last place larger, or another one smaller, the
    # body would be rejected.
    problem = Problem(RigidBody.from_moments(1.0, 1.0, np.nextafter(2.06, 0.0)),
                      State(0, angular_velocity=RATES), TorqueLog([0], [[0.1, 0.2, 0.3]]))
    effect = last_digit_effect(problem, at=[SECOND])
    assert 0.0 < effect < 1e-14
