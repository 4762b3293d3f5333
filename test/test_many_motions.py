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

from conftest import at_night, SECOND
import numpy as np
from parts import FIELDS
import pytest
from rigid_body_ros import (
    GravityGradient,
    propagate,
    propagate_many,
    RigidBodies,
    State,
    States,
    TorqueLog,
    UniformField,
)
from rigid_body_ros.engine.binding import LANES

COUNT = 12
STRAIGHT, TURN = np.eye(3), np.linalg.qr(np.random.default_rng(8).normal(size=(3, 3)))[0]
AT = np.array([0, 7, 3 * SECOND, SECOND, SECOND // 3])
GAINS = np.linspace(-0.5, 1.5, COUNT)


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
    damping = np.zeros_like(tensors)
    damping[::2] = 0.01 * seed * np.eye(3)
    return tensors, damping, random.normal(size=(COUNT, 4)), rates


def alike(count=COUNT, moments=(1.0, 2.0, 2.5), turn=STRAIGHT, spread=0.02, seed=3):
    """Return bodies and starts for runs that take many of their steps together in lanes."""
    random = np.random.default_rng(seed)
    scales = 1.0 + spread * random.normal(size=(count, 1))
    tensors = turn @ (np.eye(3) * (np.array(moments) * scales)[:, None]) @ turn.T
    rates = 0.3 + 0.2 * random.normal(size=(count, 3))
    rates[1], rates[2] = 30.0 * rates[1], 0.0
    return (RigidBodies(0.5 * (tensors + tensors.transpose(0, 2, 1))),
            States(0, random.normal(size=(count, 4)), rates))


def unlike(count, turn=STRAIGHT):
    """Return bodies and starts for runs, some of which take twenty times the steps of others."""
    random = np.random.default_rng(9)
    rates = random.normal(size=(count, 3)) * 20.0 ** random.uniform(-1.0, 0.0, (count, 1))
    bodies, _ = alike(count, turn=turn, seed=9)
    return bodies, States(0, random.normal(size=(count, 4)), rates)


def with_rotors(seed=4, equal=False, begins=0):
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
    return RigidBodies(tensors, damping), States(begins, attitudes, rates, momenta)


def random_log(interpolation='hold', frame='body', size=1.0, seed=5, step_ns=123_456_789,
               count=20):
    random = np.random.default_rng(seed)
    torques = size * random.normal(size=(count, 3))
    torques[6:9] = 0.0
    return TorqueLog(np.arange(count) * step_ns, torques, frame, interpolation)


def motor(seed=6):
    return random_log(size=0.1, seed=seed, step_ns=98_765_432, count=30)


def check(bodies, starts, logs, at=AT, gains=None, wheels=None, fields=(), **options):
    """Check the runs, of which each may have its own log or logs, gain, wheels and fields."""
    found = propagate_many(bodies, starts, logs, at=at, torque_gains=gains, wheels=wheels,
                           fields=fields, **options)
    for k, message in enumerate(found.messages):
        own = logs[k] if isinstance(logs, list) else logs
        if gains is not None:
            own = [log.with_torques(gains[k] * log.torques)
                   for log in (own if isinstance(own, list) else [own])]
        given = {'wheels': wheels[k] if isinstance(wheels, list) else wheels,
                 'fields': fields[k] if fields and isinstance(fields[0], list) else fields}
        try:
            motion = propagate(bodies[k], starts[k], own, at=at, **given, **options)
        except ValueError as error:
            assert message == str(error)
        else:
            assert not message
            assert found.attitude[k].tobytes() == motion.attitude.tobytes()
            assert found.angular_velocity[k].tobytes() == motion.angular_velocity.tobytes()
    return found


#: Torques that are small, because some bodies are thin.
PLAIN_LOGS = [None, random_log(size=0.05)]
LOGS = [random_log(*way, size=0.05) for way in (
    ('hold', 'space'), ('linear', 'body'), ('cubic', 'space'))]


@pytest.mark.slow
@pytest.mark.parametrize(('options', 'log'), [
    ({}, None), ({'tolerance': 1e-4}, PLAIN_LOGS[1]), ({'torque_timeout': 0.05}, LOGS[1]),
    ({'tolerance': 1e-4}, LOGS[2]), ({'solver': 'strang', 'max_step': 0.02}, LOGS[0]),
    ({'solver': 'rk4', 'max_step': 0.02}, LOGS[2]),
    *at_night(*(({}, log) for log in [PLAIN_LOGS[1], *LOGS]), *(
        ({'solver': 'taylor', 'max_step': 0.1}, log) for log in PLAIN_LOGS + LOGS))])
def test_each_motion_has_the_bits_of_the_motion_alone(log, options):
    tensors, _, attitudes, rates = scattered()
    found = check(RigidBodies(tensors), States(0, attitudes, rates), log, **options)
    assert {4, 5} <= set(np.flatnonzero(found.failed)) < set(range(COUNT))
    assert np.isnan(found.attitude[found.failed]).all()


@pytest.mark.slow
@pytest.mark.parametrize('timeout', [0.05, *at_night(0.0)])
def test_damping_gains_and_logs_of_each_run_give_the_same_bits(timeout):
    tensors, damping, attitudes, rates = scattered(1)
    tensors[5:7] = np.diag([1.0, 2.0, 3.0])
    bodies, starts = RigidBodies(tensors, damping), States(0, attitudes, rates)
    one, empty = PLAIN_LOGS[1], TorqueLog([], [])
    logs = [[one, one], [one, LOGS[0]], [one, LOGS[2]], [LOGS[1], one],
            [one, TorqueLog([0], [[1e-3, 0.0, 2e-3]])], [one, empty], [], [empty], one,
            [one, one, one], [one, one], [one, one]]
    check(bodies, starts, logs, torque_timeout=timeout)
    check(bodies, starts, logs, gains=np.full(COUNT, 0.5))
    check(bodies, starts, one, gains=GAINS)


#: Stamps and requested times with which runs take long steps, short steps, and coasts.
STREAMS = [(60 * SECOND, 2, [90 * SECOND]), (7 * SECOND, 6, [0, 20 * SECOND, SECOND, 40 * SECOND]),
           (SECOND // 100, 600, [6 * SECOND]), (SECOND // 1000, 1200, [SECOND, SECOND + 7])]


@pytest.mark.slow
@pytest.mark.parametrize(('tolerance', 'moments', 'turn'), [
    (1e-15, (1.0, 2.0, 2.5), TURN), (1e-15, (1e-3, 1.0, 1.0), STRAIGHT),
    *at_night((1e-6, (1.0, 2.0, 2.5), STRAIGHT), (1e-3, (1e-3, 1.0, 1.0), TURN))])
@pytest.mark.parametrize(('interval_ns', 'samples', 'at'), STREAMS)
def test_runs_that_step_together_have_the_bits_of_each_alone(tolerance, moments, turn,
                                                             interval_ns, samples, at):
    torques = 0.1 * moments[0] * np.random.default_rng(2).normal(size=(samples, 3))
    log = TorqueLog(np.arange(samples) * interval_ns, torques)
    bodies, starts = alike(moments=moments, turn=turn)
    check(bodies, starts, log, at, tolerance=tolerance)
    if moments[0] == 1.0:
        gains = np.array([*GAINS[:3], 0.0, *GAINS[4:]])
        check(bodies, starts, log, at, gains=gains, tolerance=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize(('interval_ns', 'samples'), [(7 * SECOND, 12), (SECOND // 500, 1000)])
def test_runs_with_torques_of_their_own_have_the_bits_of_each_alone(interval_ns, samples):
    random = np.random.default_rng(4)
    log = TorqueLog(np.arange(samples) * interval_ns, 0.1 * random.normal(size=(samples, 3)))
    (bodies, starts), at = alike(), [int(log.times_ns[-1]) + 5]
    noisy = [log.with_torques(log.torques + 0.02 * random.normal(size=log.torques.shape))
             for _ in range(COUNT)]
    noisy[3] = log.with_torques(0.0 * log.torques)
    noisy[5] = TorqueLog(log.times_ns + 1, noisy[5].torques)
    noisy[6] = TorqueLog(log.times_ns, noisy[6].torques, 'space')
    biased = [[log, TorqueLog([0], 0.01 * random.normal(size=(1, 3)))] for _ in range(COUNT)]
    biased[8] = noisy[8]
    for logs, gains in ((noisy, None), (biased, None), ([[log, noisy[0]]] * COUNT, GAINS)):
        check(bodies, starts, logs, at, gains=gains)


def test_a_run_that_becomes_too_fast_does_not_disturb_those_beside_it():
    bodies, starts = alike()
    tensors = bodies.inertia.copy()
    tensors[0] *= 1e-6
    log = TorqueLog(np.arange(2000) * 5000, np.tile([0.0, 0.0, 1e9], (2000, 1)))
    found = check(RigidBodies(tensors), starts, log, [SECOND // 200_000])
    assert np.flatnonzero(found.failed).tolist() == [0]
    assert 'faster than' in found.messages[0]


@pytest.mark.slow
@pytest.mark.parametrize(('tolerance', 'at', 'timeout', 'turn'), [
    (1e-15, [70 * SECOND], 0.0, TURN), (1e-4, np.arange(0, 80 * SECOND, SECOND), 0.0, STRAIGHT),
    (1e-9, [0, 20 * SECOND, 20 * SECOND, 45 * SECOND, SECOND], 15.0, STRAIGHT)])
def test_runs_unlike_each_other_have_the_bits_of_each_alone(tolerance, at, timeout, turn):
    torques = np.random.default_rng(10).normal(size=(4, 3)) * 0.02
    check(*unlike(3 * LANES, turn), TorqueLog(np.arange(4) * 20 * SECOND, torques), at,
          tolerance=tolerance, torque_timeout=timeout)


IDLE = TorqueLog([SECOND], [[0.0, 0.0, 0.0]])


@pytest.mark.slow
@pytest.mark.parametrize(('logs', 'wheels', 'timeout', 'equal'), [
    ([], None, 0.0, False), ([], motor(), 0.05, True), ([random_log()], motor(), 0.0, False),
    ([random_log('cubic')], None, 0.05, True), ([random_log('cubic')], IDLE, 0.0, False),
    ([random_log('linear', 'space')], motor(), 0.05, False),
    ([random_log(), random_log()], IDLE, 0.05, True),
    ([random_log(), random_log('hold', 'space')], motor(), 0.05, False),
    ([random_log('cubic'), TorqueLog([SECOND], [[0.1, 0.0, 0.2]])], motor(), 0.0, True)])
def test_rotors_damping_and_shared_sources_give_the_same_bits(logs, wheels, timeout, equal):
    check(*with_rotors(equal=equal), logs[0] if len(logs) == 1 else [logs] * COUNT, wheels=wheels,
          torque_timeout=timeout)


@pytest.mark.slow
def test_gains_and_starts_and_wheels_of_each_run_give_the_same_bits():
    given, at = with_rotors(begins=np.array([0, 1, 0, 5 * SECOND] * 3)), [5 * SECOND, 7 * SECOND]
    one, other = random_log(), random_log('linear')
    wheels = [motor(), *[motor(k % 3) for k in range(1, COUNT)]]
    wheels[1:6:2] = [wheels[0]] * 3
    for logs, motors in (([], wheels), ([one, other], wheels), ([other], None)):
        check(*given, [logs] * COUNT, at, gains=GAINS, wheels=motors)


@pytest.mark.slow
@pytest.mark.parametrize(('options', 'logs', 'own'), [
    ({}, [], False), ({}, random_log(), True), ({'torque_timeout': 0.07}, LOGS[0], False),
    ({'solver': 'taylor', 'max_step': 0.04}, [random_log(), LOGS[0]], True),
    ({'solver': 'rk4', 'max_step': 0.02}, random_log(), True),
    ({'solver': 'explicit_euler', 'max_step': 0.02}, [random_log(), LOGS[0]], False),
    ({'solver': 'strang', 'max_step': 0.02}, random_log(), True)])
def test_fields_of_all_and_of_each_give_the_same_bits(options, logs, own):
    bodies, starts = with_rotors(begins=-SECOND // 3 * (np.arange(COUNT) % 2))
    wheels = motor()
    if options.get('solver') == 'strang':
        wheels, (bodies, starts) = None, alike()
    fields = [[UniformField((0.1, -0.02 * k, 0.3), (0.4, -0.2, -2.5)), FIELDS[2],
               GravityGradient(0.4 + 0.01 * k)][k % 2:] for k in range(COUNT)] if own else FIELDS
    each = [logs] * COUNT if isinstance(logs, list) else logs
    check(bodies, starts, each, wheels=wheels, fields=fields, **options)
    if isinstance(logs, TorqueLog):
        check(bodies, starts, logs, gains=GAINS, wheels=wheels, fields=fields, **options)


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
