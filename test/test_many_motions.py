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

"""Many motions at once: each has the bits of `propagate`, and a bad one does not affect others."""

from itertools import product

from conftest import at_night
import numpy as np
import pytest
from rigid_body_ros import (
    propagate,
    propagate_many,
    RigidBodies,
    RigidBody,
    State,
    States,
    TorqueLog,
)
from rigid_body_ros.engine.binding import LANES

SECOND = 10 ** 9
COUNT = 12
STRAIGHT, TURN = np.eye(3), np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
AT = np.array([0, 7, 3 * SECOND, SECOND, SECOND // 3])


def scattered(seed=0):
    """Return random bodies (diagonal, full, thin or out of range), and their starts."""
    random = np.random.default_rng(seed)
    turns = np.stack([np.linalg.qr(one)[0] for one in random.normal(size=(COUNT, 3, 3))])
    moments = np.array([[1.0, 2.0, 2.5], [1e-6, 1.0, 1.0], [1.0, 1.0 + 1e-13, 1.5]])
    tensors = moments[np.arange(COUNT) % 3] * (1.0 + 1e-3 * random.normal(size=(COUNT, 1)))
    tensors = (turns * tensors[:, None]) @ turns.transpose(0, 2, 1)
    tensors[3] = np.diag([1.0, 2.0, 3.0])
    tensors[4], tensors[5] = np.diag([1.0, 2.0, 9.0]), np.nan
    tensors[6] *= 1e-150
    rates = random.normal(size=(COUNT, 3))
    rates[7], rates[8] = 2e9, 0.0
    return tensors, rates, random.normal(size=(COUNT, 4))


def random_log(interpolation='hold', frame='body'):
    random = np.random.default_rng(5)
    torques = random.normal(size=(20, 3))
    torques[6:9] = 0.0
    return TorqueLog(np.arange(20) * 123_456_789, torques, frame, interpolation)


def alone(tensor, start, log, **options):
    """Return the attitude and the rates of one motion, or its error."""
    try:
        motion = propagate(RigidBody(tensor, options.pop('damping', None)), State(*start), log,
                           at=AT, **options)
    except ValueError as error:
        return str(error)
    return motion.attitude.tobytes() + motion.angular_velocity.tobytes()


def rows(motions):
    return [message or attitude.tobytes() + rates.tobytes() for attitude, rates, message
            in zip(motions.attitude, motions.angular_velocity, motions.messages)]


OPTIONS = [{'tolerance': 1e-4}, {'torque_timeout': 0.05}, {'solver': 'rk4', 'max_step': 0.01},
           {'solver': 'strang', 'max_step': 0.02}]
#: Options with which motions under torques that vary between samples take seconds.
SLOW_OPTIONS = [{}, {'solver': 'taylor', 'max_step': 0.1}]
PLAIN_LOGS = [None, random_log()]
LOGS = [random_log(*way) for way in (('hold', 'space'), ('linear', 'body'), ('cubic', 'space'))]


@pytest.mark.slow
@pytest.mark.parametrize(('options', 'log'), [
    *product(OPTIONS, PLAIN_LOGS + LOGS),
    *at_night(*product(SLOW_OPTIONS, PLAIN_LOGS + LOGS))])
def test_each_motion_has_the_bits_of_the_motion_alone(log, options):
    tensors, rates, attitudes = scattered()
    found = propagate_many(RigidBodies(tensors), States(0, attitudes, rates), log, at=AT,
                           **options)
    expected = [alone(tensor, (0, q, w), log, **options)
                for tensor, q, w in zip(tensors, attitudes, rates)]
    assert rows(found) == expected
    assert {4, 5} <= set(np.flatnonzero(found.failed)) < set(range(COUNT))
    assert np.isnan(found.attitude[found.failed]).all()


@pytest.mark.slow
def test_damping_gains_and_logs_of_each_run_give_the_same_bits():
    tensors, rates, attitudes = scattered(1)
    tensors[5:7] = np.diag([1.0, 2.0, 3.0])
    damping = np.zeros_like(tensors)
    damping[::2] = 0.01 * np.eye(3)
    log, gains = random_log(), np.linspace(0.5, 1.5, COUNT)
    logs = [log.with_torques(gain * log.torques) for gain in gains]
    bodies, starts = RigidBodies(tensors, damping), States(0, attitudes, rates)
    expected = [alone(tensor, (0, q, w), each, damping=drag) for tensor, q, w, each, drag
                in zip(tensors, attitudes, rates, logs, damping)]
    assert rows(propagate_many(bodies, starts, log, at=AT, torque_gains=gains)) == expected
    assert rows(propagate_many(bodies, starts, logs, at=AT)) == expected


def together(interval_ns, samples, moments=(1.0, 2.0, 2.5), turn=STRAIGHT):
    """Return bodies, starts and a log for runs that take many of their steps together in lanes."""
    random = np.random.default_rng(3)
    scales = 1.0 + 0.02 * random.normal(size=(COUNT, 1))
    tensors = turn @ (np.eye(3) * (np.array(moments) * scales)[:, None]) @ turn.T
    rates = 0.3 + 0.2 * random.normal(size=(COUNT, 3))
    rates[1], rates[2] = 30.0 * rates[1], 0.0
    return (RigidBodies(0.5 * (tensors + tensors.transpose(0, 2, 1))),
            States(0, random.normal(size=(COUNT, 4)), rates),
            TorqueLog(np.arange(samples) * interval_ns, 0.1 * random.normal(size=(samples, 3))))


@pytest.mark.slow
@pytest.mark.parametrize('tolerance', [1e-15, *at_night(1e-6, 1e-3)])
@pytest.mark.parametrize(('moments', 'turn'), [
    ((1.0, 2.0, 2.5), TURN), ((1e-3, 1.0, 1.0), STRAIGHT),
    *at_night(((1.0, 2.0, 2.5), STRAIGHT), ((1e-3, 1.0, 1.0), TURN))])
@pytest.mark.parametrize(('interval_ns', 'samples', 'at'), [
    (60 * SECOND, 2, [90 * SECOND]), (7 * SECOND, 12, [0, 20 * SECOND, SECOND, 80 * SECOND]),
    (SECOND // 100, 900, [9 * SECOND]), (SECOND // 1000, 3000, [SECOND, 2 * SECOND + 7]),
    (SECOND // 10, 100, [10 * SECOND])])
def test_runs_that_step_together_have_the_bits_of_each_alone(tolerance, moments, turn,
                                                             interval_ns, samples, at):
    bodies, starts, log = together(interval_ns, samples, moments, turn)
    found = propagate_many(bodies, starts, log, at=at, tolerance=tolerance)
    for k in range(COUNT):
        alone = propagate(bodies[k], starts[k], log, at=at, tolerance=tolerance)
        assert found.attitude[k].tobytes() == alone.attitude.tobytes()
        assert found.angular_velocity[k].tobytes() == alone.angular_velocity.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize('gain', [1.0, 0.0])
@pytest.mark.parametrize(('interval_ns', 'samples'), [(7 * SECOND, 12), (SECOND // 500, 3000)])
def test_runs_that_step_together_have_torques_of_their_own_gains(gain, interval_ns, samples):
    bodies, starts, log = together(interval_ns, samples)
    gains, at = np.linspace(-1.0, 2.0, COUNT), [int(log.times_ns[-1]) + 5]
    gains[3] = gain
    found = propagate_many(bodies, starts, log, at=at, torque_gains=gains)
    for k in range(COUNT):
        alone = propagate(bodies[k], starts[k], log.with_torques(gains[k] * log.torques), at=at)
        assert found.attitude[k].tobytes() == alone.attitude.tobytes()
        assert found.angular_velocity[k].tobytes() == alone.angular_velocity.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(('interval_ns', 'samples'), [(7 * SECOND, 12), (SECOND // 500, 3000)])
def test_runs_with_torques_of_their_own_have_the_bits_of_each_alone(interval_ns, samples):
    bodies, starts, log = together(interval_ns, samples)
    random, at = np.random.default_rng(4), [int(log.times_ns[-1]) + 5]
    noisy = [log.with_torques(log.torques + 0.02 * random.normal(size=log.torques.shape))
             for _ in range(COUNT)]
    noisy[3] = log.with_torques(0.0 * log.torques)
    noisy[5] = TorqueLog(log.times_ns + 1, noisy[5].torques)
    noisy[6] = TorqueLog(log.times_ns, noisy[6].torques, 'space')
    biased = [[log, TorqueLog([0], 0.01 * random.normal(size=(1, 3)))] for _ in range(COUNT)]
    biased[8] = noisy[8]
    for logs in (noisy, biased):
        found = propagate_many(bodies, starts, logs, at=at)
        assert rows(found) == [motion_of(bodies[k], starts[k], logs[k], at) for k in range(COUNT)]
    gains, pair = np.linspace(-1.0, 2.0, COUNT), [log, noisy[0]]
    found = propagate_many(bodies, starts, [pair] * COUNT, at=at, torque_gains=gains)
    assert rows(found) == [
        motion_of(bodies[k], starts[k], [one.with_torques(gains[k] * one.torques) for one in pair],
                  at) for k in range(COUNT)]


@pytest.mark.slow
def test_a_run_that_becomes_too_fast_does_not_disturb_those_beside_it():
    bodies, starts, _ = together(SECOND, 1)
    tensors = bodies.inertia.copy()
    tensors[0] *= 1e-6
    bodies = RigidBodies(tensors)
    log = TorqueLog(np.arange(5000) * 2000, np.tile([0.0, 0.0, 1e9], (5000, 1)))
    options = {'at': [SECOND // 200_000]}
    found = propagate_many(bodies, starts, log, **options)
    assert np.flatnonzero(found.failed).tolist() == [0]
    with pytest.raises(ValueError, match='faster than') as error:
        propagate(bodies[0], starts[0], log, **options)
    assert found.messages[0] == str(error.value)
    alone = propagate(bodies[1], starts[1], log, **options)
    assert found.attitude[1].tobytes() == alone.attitude.tobytes()


def unlike(count, turn=STRAIGHT):
    """Return bodies and starts for runs, some of which take twenty times the steps of others."""
    random = np.random.default_rng(9)
    moments = np.array([1.0, 2.0, 2.5]) * (1.0 + 0.02 * random.normal(size=(count, 1)))
    tensors = turn @ (np.eye(3) * moments[:, None]) @ turn.T
    rates = random.normal(size=(count, 3)) * 20.0 ** random.uniform(-1.0, 0.0, (count, 1))
    return (RigidBodies(0.5 * (tensors + tensors.transpose(0, 2, 1))),
            States(0, random.normal(size=(count, 4)), rates))


@pytest.mark.slow
@pytest.mark.parametrize('turn', [STRAIGHT, TURN], ids=['diagonal', 'full'])
@pytest.mark.parametrize('timeout', [0.0, 15.0])
@pytest.mark.parametrize(('tolerance', 'at'), [
    (1e-15, [70 * SECOND]), (1e-9, [0, 20 * SECOND, 20 * SECOND, 45 * SECOND, SECOND]),
    (1e-4, np.arange(0, 80 * SECOND, SECOND // 3))])
def test_runs_unlike_each_other_have_the_bits_of_each_alone(tolerance, at, timeout, turn):
    bodies, starts = unlike(3 * LANES, turn)
    torques = np.random.default_rng(10).normal(size=(4, 3)) * 0.02
    options = {'at': at, 'tolerance': tolerance, 'torque_timeout': timeout}
    log = TorqueLog(np.arange(4) * 20 * SECOND, torques)
    found = propagate_many(bodies, starts, log, **options)
    assert rows(found) == [motion_of(bodies[k], starts[k], log, **options)
                           for k in range(len(bodies))]


@pytest.mark.slow
@pytest.mark.parametrize('timeout', [0.05, *at_night(0.0)])
def test_several_logs_of_each_run_add_up_in_the_same_bits(timeout):
    tensors, rates, attitudes = scattered(2)
    tensors[5:7] = np.diag([1.0, 2.0, 3.0])
    damping = np.zeros_like(tensors)
    damping[::2] = 0.01 * np.eye(3)
    one, empty = random_log(), TorqueLog([], [])
    logs = [[one, one], [one, random_log('hold', 'space')], [one, random_log('cubic')],
            [random_log('linear', 'space'), one], [one, TorqueLog([0], [[0.1, 0.0, 0.2]])],
            [one, empty], [], [empty], one, [one, one, one], [one, one], [one, one]]
    found = propagate_many(RigidBodies(tensors, damping), States(0, attitudes, rates), logs, at=AT,
                           torque_timeout=timeout)
    assert rows(found) == [
        alone(tensor, (0, q, w), each, damping=drag, torque_timeout=timeout)
        for tensor, q, w, each, drag in zip(tensors, attitudes, rates, logs, damping)]
    gained = propagate_many(RigidBodies(tensors, damping), States(0, attitudes, rates), logs,
                            at=AT, torque_gains=np.full(COUNT, 0.5))
    half = one.with_torques(0.5 * one.torques)
    assert rows(gained)[9] == alone(tensors[9], (0, attitudes[9], rates[9]), [half] * 3)


def motion_of(body, start, log, at=AT, **options):
    """Return attitude and rates of one motion as bytes."""
    motion = propagate(body, start, log, at=at, **options)
    return motion.attitude.tobytes() + motion.angular_velocity.tobytes()


def with_rotors(seed=4, equal=False):
    """Return bodies, some damped, and starts, some with rotors of equal or different momenta."""
    random = np.random.default_rng(seed)
    moments = np.array([1.0, 2.0, 2.5]) * (1.0 + 0.1 * random.random((COUNT, 1)))
    tensors = np.eye(3) * moments[:, None]
    tensors[::5] = TURN @ tensors[0] @ TURN.T
    tensors = 0.5 * (tensors + tensors.transpose(0, 2, 1))
    rates, attitudes = random.normal(size=(COUNT, 3)), random.normal(size=(COUNT, 4))
    momenta = random.normal(size=(1 if equal else COUNT, 3)) * np.ones((COUNT, 1))
    if not equal:
        momenta[::3] = 0.0
    damping = np.zeros_like(tensors)
    damping[::2] = 0.01 * np.eye(3)
    return RigidBodies(tensors, damping), States(0, attitudes, rates, momenta)


def some_wheels(seed=6):
    torques = 0.1 * np.random.default_rng(seed).normal(size=(30, 3))
    torques[3:5] = 0.0
    return TorqueLog(np.arange(30) * 98_765_432, torques)


@pytest.mark.slow
@pytest.mark.parametrize('equal', [True, False], ids=['same', 'own'])
@pytest.mark.parametrize('timeout', [0.0, 0.05])
@pytest.mark.parametrize('wheels', [None, some_wheels(), TorqueLog([SECOND], [[0.0, 0.0, 0.0]])],
                         ids=['still', 'wheels', 'idle'])
@pytest.mark.parametrize('logs', [
    [], [random_log()], [random_log('cubic')], [random_log('linear', 'space')],
    [random_log(), random_log()], [random_log(), random_log('hold', 'space')],
    [random_log('cubic'), TorqueLog([SECOND], [[0.1, 0.0, 0.2]])]],
    ids=['free', 'held', 'cubic', 'space', 'two', 'two frames', 'cubic and held'])
def test_rotors_damping_and_shared_sources_give_the_same_bits(logs, wheels, timeout, equal):
    bodies, starts = with_rotors(equal=equal)
    shared = logs[0] if len(logs) == 1 else [logs] * COUNT
    found = propagate_many(bodies, starts, shared, at=AT, wheels=wheels, torque_timeout=timeout)
    assert rows(found) == [motion_of(bodies[k], starts[k], logs, wheels=wheels,
                                     torque_timeout=timeout) for k in range(COUNT)]


@pytest.mark.slow
def test_gains_and_starts_and_wheels_of_each_run_give_the_same_bits():
    bodies, starts = with_rotors()
    one, other, gains = random_log(), random_log('linear'), np.linspace(-0.5, 1.5, COUNT)
    begins = np.array([0, 1, 0, 5 * SECOND] * 3)
    starts = States(begins, starts.attitude, starts.angular_velocity, starts.rotor_momentum)
    wheels = [some_wheels(), *[some_wheels(k % 3) for k in range(1, COUNT)]]
    wheels[1:6:2] = [wheels[0]] * 3
    at = [5 * SECOND, 7 * SECOND]
    for logs, motors in (([], wheels), ([one], wheels), ([one, other], wheels),
                         ([one, other], [None] * COUNT), ([other], [None] * COUNT)):
        found = propagate_many(bodies, starts, [logs] * COUNT, at=at, torque_gains=gains,
                               wheels=motors if motors[0] else None)
        assert rows(found) == [
            motion_of(bodies[k], starts[k], [log.with_torques(gains[k] * log.torques)
                                             for log in logs], at, wheels=motors[k])
            for k in range(COUNT)]


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(6))
def test_random_sources_and_rotors_give_the_same_bits(seed):
    random = np.random.default_rng(seed)
    bodies, starts = with_rotors(seed, bool(random.integers(2)))

    def log(interpolations=('hold',), frames=('body',)):
        count = int(random.integers(1, 400))
        stamps = np.cumsum(random.integers(1, 20_000_000, count)) - 50_000_000
        return TorqueLog(stamps, 0.1 * random.normal(size=(count, 3)), str(random.choice(frames)),
                         str(random.choice(interpolations)))

    several = [[log(('hold', 'hold', 'linear', 'cubic'), ('body', 'body', 'space'))
                for _ in range(random.integers(3))] for _ in range(3)]
    wheels = [None, log(), log()]
    chosen = random.integers(3, size=(2, COUNT))
    timeout = float(random.choice([0.0, 0.007]))
    found = propagate_many(bodies, starts, [several[k] for k in chosen[0]], at=AT,
                           wheels=[wheels[k] for k in chosen[1]], torque_timeout=timeout)
    assert rows(found) == [
        motion_of(bodies[k], starts[k], several[chosen[0, k]], wheels=wheels[chosen[1, k]],
                  torque_timeout=timeout) for k in range(COUNT)]


@pytest.mark.parametrize(('given', 'message'), [
    ({'wheels': [None]}, 'wheels: expected 2, one for each body, found 1'),
    ({'wheels': TorqueLog([0], [[0, 0, 1]], 'space')}, 'wheels: expected torques in body axes'),
    ({'wheels': TorqueLog([0], [[0, 0, 1]]), 'solver': 'strang', 'max_step': 0.1},
     "solver 'strang' handles neither rotors nor damping, found rotors"),
    ({'starts': States(0, np.ones((2, 4)), rotor_momentum=(0, 0, 1)), 'solver': 'exact'},
     "solver 'exact' handles neither rotors nor damping, found rotors"),
    ({'wheels': TorqueLog([0], [[0, 0, 1]]), 'solver': 'exact'}, "solver 'exact' handles")])
def test_rotors_that_do_not_fit_are_one_line(given, message):
    starts = given.pop('starts', States(0, np.ones((2, 4))))
    with pytest.raises(ValueError, match=message):
        propagate_many(RigidBodies([np.eye(3)] * 2), starts, at=[1], **given)


def test_states_and_bodies_are_those_of_their_rows():
    attitudes = np.random.default_rng(2).normal(size=(5, 4))
    attitudes[3] = 0.0
    momenta = np.outer([0.0, 1.0, 2.0, 3.0, np.inf], (0.3, 0.2, 0.1))
    states = States(7, attitudes, (0.1, 0.2, 0.3), momenta)
    for row in (0, 1, 2):
        assert np.array_equal(states.attitude[row], State(7, attitudes[row]).attitude)
        assert np.array_equal(states[row]._packed, states._packed[row])
        assert np.array_equal(states[row].rotor_momentum, momenta[row])
    assert [bool(message) for message in states.messages] == [False] * 3 + [True, True]
    assert states.messages[4].startswith('rotor momentum: expected 3 finite numbers')
    assert states.has_rotors.tolist() == [False] + [True] * 4
    with pytest.raises(ValueError, match='non-zero'):
        states[3]
    bodies = RigidBodies([np.eye(3), -np.eye(3)])
    assert not bodies.messages[0]
    assert 'positive definite' in bodies.messages[1]


@pytest.mark.parametrize(('change', 'message'), [
    ({'starts': States(0, np.ones((3, 4)))}, 'starts: expected 2, one for each body, found 3'),
    ({'log': [None]}, 'log: expected 2, one for each body, found 1'),
    ({'torque_gains': [1.0]}, r'torque_gains: expected shape \(2,\), found \(1,\)'),
    ({'torque_gains': 0.0}, r'torque_gains: expected shape \(2,\), found \(\)'),
    ({'at': [-1]}, 'at: expected no time before the start'),
    ({'bodies': RigidBodies(np.zeros((0, 3, 3)))}, 'starts: expected 0')])
def test_input_that_does_not_fit_is_one_line(change, message):
    given = {'bodies': RigidBodies([np.eye(3)] * 2), 'starts': States(0, np.ones((2, 4))),
             'at': [1], **change}
    with pytest.raises(ValueError, match=message):
        propagate_many(given.pop('bodies'), given.pop('starts'), given.pop('log', None), **given)
