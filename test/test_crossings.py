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

"""The times at which functions of a motion cross a level, and their maxima."""

from itertools import pairwise

from mpmath import ellipf, mp, mpf
import numpy as np
from numpy.testing import assert_array_equal
import pytest
from rigid_body_ros import (
    BodyLog,
    EffortLog,
    Problem,
    propagate,
    RigidBody,
    so3,
    State,
    TorqueLog,
    UniformField,
    Wheel,
)
from rigid_body_ros.propagation import Integration

SECOND, SECONDS = 10 ** 9, 20
TOP = RigidBody.from_moments(1.0, 1.0, 2.0)
FREE = propagate(TOP, State(angular_velocity=(0.3, 0.0, 1.0)), at=[SECONDS * SECOND])
IDENTITY = [0.0, 0.0, 0.0, 1.0]


def angle(motion):
    """Return the angle from the space axes, rad."""
    return so3.angle_between(motion.attitude, IDENTITY)


def rate(motion):
    """Return the magnitude of the angular velocity, rad/s."""
    return np.linalg.norm(motion.angular_velocity, axis=1)


def check(found, expected, directions):
    """Check times, s with many digits, to 1e-13 s, and directions, which repeat."""
    assert len(found.times_ns) == len(expected)
    assert max(abs(time_ns + mpf(fraction) - 10 ** 9 * time) for time_ns, fraction, time in zip(
        found.times_ns.tolist(), found.fractions.tolist(), sorted(expected))) < 1e-4
    assert_array_equal(found.directions, np.resize(directions, len(expected)))


@pytest.fixture(autouse=True)
def _many_digits():
    with mp.workdps(50):
        yield


def test_the_angle_of_a_free_top():
    momentum = mp.sqrt(mpf(0.3) ** 2 + 4)

    def excess(time):  # the body precesses about the momentum, and turns back about its own axis
        first, second = momentum * time / 2, time / 2
        return mp.cos(0.25) - abs(mp.cos(first) * mp.cos(second)
                                  + 2 / momentum * mp.sin(first) * mp.sin(second))
    grid = [mpf(SECONDS) * k / 400 for k in range(401)]
    check(FREE.crossings(angle, 0.5), [
        mp.findroot(excess, ends, solver='anderson') for ends in pairwise(grid)
        if excess(ends[0]) * excess(ends[1]) < 0], [1, -1])


def test_a_component_that_rises_falls_and_touches():
    def component(motion):
        return motion.angular_velocity[:, 0]  # 0.3 cos t
    first, turn = mp.acos(mpf(0.1) / mpf(0.3)), 2 * mp.pi
    crossed = [k * turn + sign * first for k in range(4) for sign in (-1, 1)][1:-1]
    check(FREE.crossings(component, 0.1), crossed, [-1, 1])
    check(FREE.crossings(component, 0.3), [turn, 2 * turn, 3 * turn], [0])
    assert abs(FREE.maximum(component, SECOND) - 0.3) < 1e-15
    # Outputs at the crossings and elsewhere make no difference.
    at = [round(1e9 * time) for time in crossed] + [SECONDS * SECOND]
    for one, other in zip(FREE.crossings(component, 0.1), propagate(
            TOP, State(angular_velocity=(0.3, 0, 1)), at=at).crossings(component, 0.1)):
        assert_array_equal(one, other)


def test_a_rate_between_outputs_at_an_output_and_where_the_body_changes():
    start = State(angular_velocity=(0.0, 0.0, -1.0))
    log = TorqueLog([0, 4 * SECOND], [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])  # -1 rad/s + t / 2
    motion = propagate(TOP, start, log, at=[SECOND, 4 * SECOND])
    check(motion.crossings(rate, 0.5), [1, 3], [-1, 1])
    changes = BodyLog([2 * SECOND], [RigidBody.from_moments(1.0, 1.0, 1.0)], 'momentum')
    found = propagate(TOP, start, changes=changes, at=[3 * SECOND]).crossings(rate, 1.5)
    assert abs(found.times_ns + found.fractions - 2 * SECOND) <= 1.0


def test_a_pendulum():
    largest, level, moment = 2.5, 1.0, 2.0
    frequency = mp.sqrt(mpf(moment) * 9.81)
    modulus = mp.sin(mpf(largest) / 2)
    quarter = ellipf(mp.pi / 2, modulus ** 2) / frequency
    first = quarter - ellipf(mp.asin(mp.sin(mpf(level) / 2) / modulus), modulus ** 2) / frequency
    motion = propagate(TOP, State(attitude=so3.exp([largest, 0.0, 0.0])), at=[5 * SECOND], fields=[
        UniformField(moment=(0.0, 0.0, -moment), field=(0.0, 0.0, -9.81))])
    times = [2 * k * quarter + sign * first for k in range(9) for sign in (-1, 1)]
    check(motion.crossings(angle, level), [time for time in times if 0 < time < 5], [-1, 1])
    assert abs(motion.maximum(angle, SECOND) - largest) < 1e-14


def test_the_speed_of_a_wheel_and_an_euler_angle():
    motion = propagate(TOP, State(), at=[SECONDS * SECOND], efforts=EffortLog([SECOND], [[-0.5]]),
                       wheels=[Wheel('w', (0.0, 0.0, 1.0), inertia=0.25)])
    gain = mpf(0.5) * (4 + 1 / mpf(1.75))  # rad/s^2; the body turns the other way
    check(motion.crossings(lambda motion: motion.wheel_speeds[:, 0], -3.0), [1 + 3 / gain], [-1])
    times = [1 + mp.sqrt(2 * (1 + 2 * k * mp.pi) * mpf(1.75) / 0.5) for k in range(9)]
    check(motion.crossings(lambda motion: motion.euler_angles('XYZ')[:, 2], 1.0, 2.0 * np.pi),
          [time for time in times if time < SECONDS], [1])


@pytest.mark.parametrize('seed', range(200))
def test_no_crossing_is_missed(seed):
    random = np.random.default_rng(seed)
    stamps = np.arange(20) * SECOND // 4 + random.integers(0, SECOND // 8, 20)
    problem = Problem(
        RigidBody(np.diag(random.uniform(1.0, 1.9, 3))), State(0, IDENTITY, random.normal(size=3)),
        TorqueLog(stamps, 2.0 * random.normal(size=(20, 3)), interpolation=(
            'hold', 'linear', 'cubic')[seed % 3]),
        fields=[UniformField(random.normal(size=3), random.normal(size=3))] * (seed % 2),
        wheels=[Wheel('w', (0.6, 0.0, 0.8), inertia=0.1, max_speed=2.0)] * (seed % 4 // 2),
        efforts=EffortLog(stamps, random.normal(size=(20, 1))) if seed % 4 // 2 else None)
    at = np.arange(0, 5 * SECOND + 1, SECOND // 500)
    motion = problem.propagate(at=at)
    for function in (angle, rate):
        values = function(motion)
        level = np.sort(values)[random.choice([-3, int(2500 * random.random())])]
        found = motion.crossings(function, level + 1e-9)
        counts, _ = np.histogram(found.times_ns[found.directions != 0], at)
        assert_array_equal(counts % 2, np.diff(values > level + 1e-9))
        assert motion.maximum(function) >= values.max() - 1e-15 * abs(values.max())


def test_what_cannot_be_searched():
    with pytest.raises(ValueError, match=r'expected a finite number for each time, found shape '
                       r'\(9, 3\) for 9 times'):
        FREE.crossings(lambda motion: motion.angular_velocity)
    with pytest.raises(ValueError, match='expected a finite number .*, found nan at 0 ns'):
        FREE.maximum(lambda motion: rate(motion) * np.nan)
    with pytest.raises(ValueError, match='level: expected a finite number, found inf'):
        FREE.crossings(rate, np.inf)
    with pytest.raises(ValueError, match='period: expected a number above 0, found nan'):
        FREE.crossings(rate, 0.5, np.nan)
    for from_ns in (-1, SECONDS * SECOND):
        with pytest.raises(ValueError, match=rf'from_ns: expected .* found {from_ns} ns'):
            FREE.maximum(rate, from_ns)
    whole = Integration(Problem(TOP, State()))
    assert whole.advance([SECOND], SECOND).maximum(rate) == 0.0
    with pytest.raises(ValueError, match='expected a whole motion.* found a piece of one'):
        whole.advance([2 * SECOND]).crossings(rate)
    whole.extend(whole.problem)
    with pytest.raises(ValueError, match='expected a whole motion.* found a piece of one'):
        whole.advance([3 * SECOND]).maximum(rate)
