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

"""Wheels at their largest speed."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import pytest
from rigid_body_ros import EffortLog, Problem, Propagator, RigidBody, so3, State, TorqueLog, Wheel

TRUTH = json.loads((Path(__file__).parent / 'truth_limits.json').read_text())
SECOND = 10 ** 9
#: Spans that are shorter, s, are those of a wheel that touches its limit within rounding.
TOUCH = 1e-6


def problem_of(values):
    """Return a scene of the file as a problem."""
    xx, yy, zz, xy, xz, yz = values['inertia_ixx_iyy_izz_ixy_ixz_iyz']
    torques, efforts = values['torque_t_ns_x_y_z'], values['efforts_t_ns_each']
    return Problem(
        RigidBody([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
        State(0, values['initial_attitude_xyzw'], values['initial_angular_velocity']),
        TorqueLog([row[0] for row in torques], [row[1:] for row in torques]) if torques else None,
        wheels=[Wheel(**wheel) for wheel in values['wheels']],
        efforts=EffortLog([row[0] for row in efforts], [row[1:] for row in efforts]))


def true_spans(values):
    """Return wheel, begin and end, ns, of the spans in which a wheel is not free."""
    begins, spans = {}, []
    for time, wheel, _, mode in values['events_t_ns_wheel_before_after']:
        if mode != 'free':
            begins.setdefault(wheel, time)
        elif wheel in begins:
            spans.append((wheel, begins.pop(wheel), time))
    return spans + [(wheel, begin, f"{values['end_ns']}") for wheel, begin in begins.items()]


def elapsed(time, time_ns, fraction):
    """Return the difference between a time with many digits and a time in two parts, s."""
    whole, _, digits = time.partition('.')
    return abs(int(whole) - time_ns + float(f'0.{digits or 0}') - fraction) * 1e-9


@pytest.mark.parametrize('name', TRUTH)
def test_motions_agree_with_fifty_digits(name):
    values = TRUTH[name]
    rows = values['rows_t_ns_attitude_rates_speeds']
    times_ns = [row[0] for row in rows]
    motion = problem_of(values).propagate(at=times_ns)
    attitude, rates, speeds = (np.array([row[k] for row in rows], float) for k in (1, 2, 3))
    phase = np.cumsum(np.linalg.norm(rates, axis=1) * np.diff([0, *times_ns]) * 1e-9)
    attitude *= np.sign(np.sum(attitude * motion.attitude, axis=1, keepdims=True))
    bound = 1e-15 * (10.0 + phase)
    assert (so3.angle_between(attitude, motion.attitude) <= bound).all()
    size = 1.0 + np.linalg.norm(rates, axis=1)
    assert (abs(rates - motion.angular_velocity).max(axis=1) <= 2.0 * bound * size).all()
    assert (abs(speeds - motion.wheel_speeds) <= 2e-15 * (10.0 + abs(speeds)) * (
        10.0 + phase[:, None])).all()


@pytest.mark.parametrize('name', TRUTH)
def test_the_times_at_the_limit_agree_with_fifty_digits(name):
    values = TRUTH[name]
    problem = problem_of(values)
    names = [wheel.name for wheel in problem.named_wheels.wheels]
    found = [span for span in problem.propagate(at=[values['end_ns']]).at_limit
             if span.seconds > TOUCH]
    expected = sorted(true_spans(values), key=lambda span: float(span[1]))
    assert [names.index(span.wheel) for span in found] == [wheel for wheel, _, _ in expected]
    for span, (_, begin, end) in zip(found, expected):
        assert elapsed(begin, span.begin_ns, span.begin_fraction) <= 1e-12
        # A wheel leaves the speed of `grazing` with hardly any acceleration.
        assert elapsed(end, span.end_ns, span.end_fraction) <= (
            1e-11 if name == 'grazing' else 1e-12)


@pytest.mark.parametrize('name', ['one_wheel', 'four_skewed', 'friction'])
def test_momentum_in_space_is_kept(name):
    values = TRUTH[name]
    momentum = problem_of(values).propagate(
        at=np.linspace(0, values['end_ns'], 300).astype(np.int64)).angular_momentum_space
    size = np.linalg.norm(momentum[0])
    assert np.linalg.norm(momentum - momentum[0], axis=1).max() <= 1.5e-15 * size


def random_problem(seed, friction=False):
    """Return a body with one to four limited wheels, commands at irregular times, and a torque."""
    random = np.random.default_rng((58, seed))
    count = int(random.integers(1, 5))
    moments = 0.1 * random.uniform(1.0, 1.9, 3)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    wheels = [Wheel(f'w{k}', random.normal(size=3), 0.002 * random.uniform(0.5, 2.0),
                    random.uniform(-70.0, 70.0), 1e-4 * friction * random.random(),
                    max_speed=50.0) for k in range(count)]
    stamps = np.sort(random.integers(0, 5 * SECOND, 6))
    torque = TorqueLog(np.arange(5) * SECOND, 0.05 * random.normal(size=(5, 3)))
    return Problem(RigidBody(turn * moments @ turn.T), State(0, (0, 0, 0, 1),
                                                             random.normal(size=3)),
                   torque if random.random() < 0.5 else None, wheels=wheels,
                   efforts=EffortLog(stamps, 0.05 * random.normal(size=(6, count))))


def check(problem, at):
    """Check that motors do what they may at all times; return how often wheels are held."""
    motion = problem.propagate(at=at)
    speeds, efforts = motion.wheel_speeds, motion.wheel_efforts
    commands = motion._parts[0].wheels.efforts(at)
    drives = commands * speeds > 0.0
    beyond, below = abs(speeds) > 50.0 * (1.0 + 1e-11), abs(speeds) < 50.0 * (1.0 - 1e-11)
    assert (efforts[drives & beyond] == 0.0).all()
    assert (efforts[below | ~drives] == commands[below | ~drives]).all()
    assert (abs(efforts) <= abs(commands)).all()
    assert (efforts * commands >= 0.0).all()
    return int((drives & ~beyond & ~below & (efforts != 0.0)).sum())


@pytest.mark.parametrize('friction', [False, True])
def test_no_motor_drives_a_wheel_beyond_its_limit(friction):
    at = np.linspace(0, 8 * SECOND, 400).astype(np.int64)
    assert sum(check(random_problem(seed, friction), at) for seed in range(60)) > 1000


@pytest.mark.nightly
def test_no_event_is_missed_in_a_hundred_thousand_motions():
    at = np.linspace(0, 8 * SECOND, 100).astype(np.int64)
    for seed in range(100_000):
        check(random_problem(seed, seed % 2 > 0), at)


@pytest.mark.parametrize('seed', range(6))
def test_live_late_and_replayed_motions_have_the_same_bits(seed):
    problem = random_problem(seed, seed % 2 > 0)
    at = np.sort(np.random.default_rng(seed).integers(0, 7 * SECOND, 60))
    expected = problem.propagate(at=at)
    live = Propagator(problem.body, problem.start, wheels=problem.named_wheels.wheels,
                      history=10.0)
    calls = [('apply_efforts', int(time_ns), dict(zip(problem.named_wheels.names, row)))
             for time_ns, row in zip(problem.efforts.times_ns, problem.efforts.efforts.tolist())]
    calls += [('apply', int(time_ns), torque) for log in problem.logs
              for time_ns, torque in zip(log.times_ns, log.torques)]
    for number in np.random.default_rng(seed).permutation(len(calls)):
        name, *values = calls[number]
        assert getattr(live, name)(*values)
        live.at(int(at[number]))  # a prediction changes no bit
    for row, time_ns in enumerate(at.tolist()):
        state = live.at(time_ns)
        for name in ('attitude', 'angular_velocity', 'wheel_speeds', 'wheel_efforts'):
            assert np.array_equal(getattr(state, name), getattr(expected, name)[row])
    restarted = problem.replaced(start=live.at(int(at[30]))).propagate(at=at[30:])
    assert np.array_equal(restarted.attitude, expected.attitude[30:])
    assert np.array_equal(restarted.wheel_efforts, expected.wheel_efforts[30:])


def test_a_motor_at_the_limit_gives_what_friction_takes():
    wheel = Wheel('w', (0, 0, 1), 1e-3, friction=1e-3, max_speed=5.0)
    motion = Problem(RigidBody(np.eye(3) * 1e9), State(), wheels=[wheel],
                     efforts=EffortLog([0], [[1.0]])).propagate(at=[SECOND])
    assert motion.wheel_efforts[0, 0] == pytest.approx(5e-3, rel=1e-9)
    assert motion.wheel_speeds[0, 0] == pytest.approx(5.0, rel=1e-15)


def test_a_wheel_without_a_command_turns_as_the_body_drives_it():
    values = TRUTH['by_the_body']
    free = problem_of(values)
    free = free.replaced(efforts=EffortLog([0], [[0.0]]))
    unlimited = Problem(free.body, free.start, free.logs, wheels=[
        replace(wheel, max_speed=0.0) for wheel in free.named_wheels.wheels])
    at = np.arange(0, 10 * SECOND, SECOND)
    motion = free.propagate(at=at)
    assert not motion.at_limit
    np.testing.assert_allclose(motion.attitude, unlimited.propagate(at=at).attitude, atol=1e-14)


def test_rotors_with_the_mean_efforts_keep_the_momentum_of_the_wheels():
    problem = problem_of(TRUTH['four_skewed'])
    carried = problem.carried()
    at = problem.efforts.times_ns[1:]
    expected, found = problem.propagate(at=at), carried.propagate(at=at)
    assert expected.at_limit
    # The rotors of the carrier have the axial momenta of the wheels.
    wheels = problem.named_wheels
    momentum = expected.rotor_momentum + wheels.of_body(expected.angular_velocity)
    np.testing.assert_allclose(found.rotor_momentum, momentum, atol=1e-10)
    np.testing.assert_allclose(found.attitude, expected.attitude, atol=1e-4)
