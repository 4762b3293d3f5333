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

"""Named wheels, actuators and changes of the body together give one motion, bit for bit."""

from dataclasses import replace

from conftest import at_night
import numpy as np
import pytest
from rigid_body_ros import (
    Actuator,
    BodyLog,
    EffortLog,
    Problem,
    Propagator,
    RigidBody,
    State,
    TorqueLog,
    Wheel,
)
from rigid_body_ros.propagation import Integration

SECOND = 10 ** 9
BODY = RigidBody([[2.0, 0.1, -0.2], [0.1, 3.0, 0.05], [-0.2, 0.05, 4.0]])
SMALLER = RigidBody.from_moments(1.5, 2.2, 2.6, 0.05, -0.1)
START = State(0, (0.1, -0.3, 0.2, 0.9), (0.3, 0.5, -0.2), (0.2, -0.1, 0.4))
WHEELS = [Wheel(name, axis, 0.05, speed, max_torque=0.3, max_speed=9.0) for name, axis, speed in (
    ('a', (1, 1, 1), 0.0), ('b', (-1, 1, 1), 9.0), ('c', (1, -1, 1), -8.0))]
SLOWED = [replace(wheel, friction=0.0005) for wheel in WHEELS]
UNLIMITED = [replace(wheel, max_speed=0.0) for wheel in WHEELS]
#: Actuators of three sources: with a lag, ideal, and with another lag.
ACTUATORS = (Actuator(0.05, 0.02, (0.8, 0.0, 0.5)), None, Actuator(0.02, 0.1))


def problem_of(rng, keep, wheels=WHEELS, **options):
    """
    Return a problem with everything, and the calls that apply it.

    Torques, efforts and bodies come into force at the same times, and a torque acts just when an
    effort arrives.
    """
    stamps = np.arange(-3, 57) * 50_000_000
    logs = [TorqueLog(stamps, rng.normal(size=(60, 3)) * (rng.random(60) < 0.6)[:, None]),
            TorqueLog(stamps[::3] + 12_345, rng.normal(size=(20, 3))),
            TorqueLog(stamps[::4], rng.normal(size=(15, 3)), rng.random(15) < 0.5)]
    efforts = rng.normal(0.0, 0.4, (60, 3))
    efforts[rng.random(efforts.shape) < 0.3] = np.nan
    efforts = EffortLog(np.sort(np.concatenate([stamps[::2], rng.integers(0, 3 * SECOND, 30)])),
                        efforts)
    changes = BodyLog([stamps[20], int(efforts.times_ns[35]), 2_345_678_901],
                      [SMALLER, RigidBody(BODY.inertia, damping=np.diag([0.01, 0.02, 0.03])),
                       BODY], keep)
    calls = [('apply', int(stamp), torque, 'space' if in_space else 'body', source)
             for source, log in enumerate(logs)
             for stamp, torque, in_space in zip(log.times_ns, log.torques, log.in_space)]
    calls += [('apply_efforts', int(stamp), {
        wheel.name: effort for wheel, effort in zip(WHEELS, row) if effort == effort})
        for stamp, row in zip(efforts.times_ns, efforts.efforts)]
    calls += [('apply_body', int(stamp), body, keep)
              for stamp, body in zip(changes.times_ns, changes.bodies)]
    return Problem(BODY, START, logs, wheels=wheels, efforts=efforts, changes=changes,
                   actuator=ACTUATORS, **options), calls


def all_of(motion):
    """Return all numbers of a state, or of a motion."""
    return np.concatenate([getattr(motion, name) for name in (
        'attitude', 'angular_velocity', 'rotor_momentum', 'wheel_speeds')], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize('timeout', [0.04, *at_night(0.0, 0.3)])
@pytest.mark.parametrize(('solver', 'wheels'), [
    ('auto', WHEELS), ('rk4', UNLIMITED), ('auto', SLOWED)])
@pytest.mark.parametrize('keep', ['rate', 'momentum'])
def test_any_order_of_arrival_gives_the_bits_of_the_whole_logs(keep, solver, wheels, timeout):
    rng = np.random.default_rng(45)
    options = {'solver': solver, 'max_step': 0.01 if solver == 'rk4' else None,
               'torque_timeout': timeout}
    problem, calls = problem_of(rng, keep, wheels, **options)
    at = np.union1d(rng.integers(0, 3 * SECOND, 40), problem.stamps_ns[problem.stamps_ns > 0])
    run = Integration(problem)
    motion = run.advance(at)
    expected = all_of(motion)
    assert wheels is UNLIMITED or motion.at_limit
    for _ in range(2):
        propagator = Propagator(BODY, START, wheels=wheels, actuator=ACTUATORS, history=10.0,
                                **options)
        for number in rng.permutation(len(calls)):
            name, *values = calls[number]
            assert getattr(propagator, name)(*values)
            if not number % 5:
                propagator.at(int(rng.integers(0, 3 * SECOND)))  # a prediction changes no bit
        states = [propagator.at(int(time_ns)) for time_ns in at]
        assert np.array_equal(np.array([all_of(state) for state in states]), expected)
        assert propagator.stamps(0, 3 * SECOND) == [
            stamp for stamp in problem.stamps_ns.tolist() if stamp > 0]
        for row in (1, 30, 60):  # a state restarts the motion
            motion = problem.replaced(start=states[row]).propagate(at=at[row:])
            assert np.array_equal(all_of(motion), expected[row:])
