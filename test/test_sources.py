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

"""Several sources of torque: their sum, and terms that are absent."""

from conftest import chord, EPOCH_NS, SECOND
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from terms import numbers

FULL = [[1.1, 0.15, -0.2], [0.15, 2.0, 0.05], [-0.2, 0.05, 2.7]]
DAMPING = [[0.3, 0.05, 0.0], [0.05, 0.2, -0.02], [0.0, -0.02, 0.1]]
PLAIN = RigidBody(FULL)
START = State(EPOCH_NS, (0.1, -0.3, 0.2, 0.9), (0.5, -0.7, 0.9))
LOADED = State(EPOCH_NS, START.attitude, START.angular_velocity, (0.2, 0.4, -0.3))
EMPTY = TorqueLog([], [])
STEPS = {'auto': None, 'taylor': None, 'rk4': 0.01, 'strang': 0.01, 'explicit_euler': 0.001}


def random_log(random, count=15, seconds=4.0, frame=None):
    """Return a log that begins before the start: multiples of 1/1024 N m, some zero or equal."""
    offsets = random.choice(int(seconds * SECOND), count, replace=False)
    torques = random.integers(-1024, 1024, (count, 3)) / 1024 * (random.random((count, 1)) > 0.4)
    for row in np.flatnonzero(random.random(count - 1) > 0.7) + 1:
        torques[row] = torques[row - 1]
    frames = np.where(random.random(count) > 0.5, 'space', 'body').tolist()
    return TorqueLog(EPOCH_NS - SECOND // 2 + np.sort(offsets), torques, frame or frames)


def coasting_log(seed, frame='body'):
    """Return a log with torques for some seconds, then zeros and a coast of minutes, twice."""
    random = np.random.default_rng(seed)
    log = random_log(random, frame=frame)
    stamps = np.concatenate([log.times_ns, log.times_ns + 500 * SECOND])
    torques = np.tile(log.torques, (2, 1))
    torques[[len(log) - 1, -1]] = 0.0
    return TorqueLog(stamps, torques, frame)


def split(log):
    """Return two logs in the same frame whose exact sum is a log."""
    part = np.random.default_rng(3).integers(-512, 512, (len(log), 3)) / 1024
    return [log.with_torques(part), log.with_torques(log.torques - part)]


def silent(log, frame):
    return TorqueLog(log.times_ns, np.zeros((len(log), 3)), frame)


#: Ways, by name, to add terms without effect to a scene with a log.
ABSENT = {
    'no damping': lambda log: (RigidBody(FULL, np.zeros((3, 3))), START, log, None),
    'no rotors': lambda log: (PLAIN, State(EPOCH_NS, START.attitude, START.angular_velocity,
                                           np.zeros(3)), log, None),
    'an empty second log': lambda log: (PLAIN, START, [log, EMPTY], None),
    'an empty first log': lambda log: (PLAIN, START, [EMPTY, log], None),
    'a list of one': lambda log: (PLAIN, START, [log], None),
    'no torque on the rotors': lambda log: (PLAIN, START, log, EMPTY),
    'a torque of zero on the rotors': lambda log: (PLAIN, START, log, silent(log, 'body')),
    'two logs with an exact sum': lambda log: (PLAIN, START, split(log), None),
    'a silent log in body axes': lambda log: (PLAIN, START, [silent(log, 'body'), log], None),
    'a silent log in space axes': lambda log: (PLAIN, START, [log, silent(log, 'space')], None),
}


@pytest.mark.parametrize(('frame', 'timeout'), [('body', 0.0), ('space', 0.1)])
@pytest.mark.parametrize('written', ABSENT)
def test_an_absent_term_changes_no_bit(written, frame, timeout):
    log = coasting_log(11, frame)
    body, start, logs, wheels = ABSENT[written](log)
    # In a coast, the closed form is used from some length on.
    times = EPOCH_NS + np.concatenate([np.arange(0, 6000, 99) * SECOND // 1000,
                                       np.arange(6, 700, 37) * SECOND])
    for solver, max_step in STEPS.items():
        options = {'solver': solver, 'max_step': max_step, 'torque_timeout': timeout}
        at = times[:40] if max_step else times
        plain = propagate(PLAIN, START, log, at=at, **options)
        motion = propagate(body, start, logs, at=at, wheels=wheels, **options)
        np.testing.assert_array_equal(numbers(motion), numbers(plain))
        np.testing.assert_array_equal(motion.angular_momentum_space, plain.angular_momentum_space)
        models = [model.solver for model in plain.models]
        assert [model.solver for model in motion.models] == models
        assert ('exact' in models) == (solver == 'auto')


@pytest.mark.parametrize(('frame', 'interpolation'), [('body', 'linear'), ('space', 'cubic')])
def test_an_absent_term_changes_no_bit_between_samples(frame, interpolation):
    held = random_log(np.random.default_rng(12), frame=frame)
    log = TorqueLog(held.times_ns, held.torques, frame, interpolation)
    times = EPOCH_NS + np.arange(0, 6000, 77) * SECOND // 1000
    plain = propagate(PLAIN, START, log, at=times)
    for logs, wheels in (([log, EMPTY], None), ([log], EMPTY)):
        motion = propagate(PLAIN, START, logs, at=times, wheels=wheels)
        np.testing.assert_array_equal(numbers(motion), numbers(plain))


def test_each_source_times_out_on_its_own():
    # The second source times out at 0.5 s; from there on, the first one acts alone.
    first = TorqueLog(EPOCH_NS + np.arange(0, 20) * SECOND // 10, np.full((20, 3), [0.5, 0, 0]))
    second = TorqueLog([EPOCH_NS], [[0.0, 0.25, 0.0]])
    body, start = RigidBody(np.eye(3)), State(EPOCH_NS)
    motion = propagate(body, start, [first, second], at=[EPOCH_NS + 2 * SECOND],
                       torque_timeout=0.5)
    np.testing.assert_allclose(motion.angular_velocity, [[1.0, 0.125, 0.0]], rtol=1e-14)


def interpolated(count, seconds, frame, interpolation, phase):
    times = np.linspace(0.0, seconds, count)
    torques = 0.4 * np.sin(times[:, None] * [1.0, 1.7, 0.6] + [phase, 1.0, 2.0])
    return TorqueLog(EPOCH_NS + (times * SECOND).astype(np.int64), torques, frame, interpolation)


def resampled(log, step):
    """Return a piecewise linear log through the values of a log at steps, ns, and its samples."""
    times = np.union1d(log.times_ns, np.arange(log.times_ns[0], log.times_ns[-1], step))
    torques, in_space = log.at(times)
    return TorqueLog(times, torques, in_space, 'linear')


@pytest.mark.parametrize('frames', [('body', 'body'), ('body', 'space'), ('space', 'space')])
def test_each_source_is_interpolated_on_its_own(frames):
    # The stamps of the two do not coincide, and neither log begins at the start.
    linear = interpolated(23, 4.1, frames[0], 'linear', 0.0)
    cubic = interpolated(17, 4.7, frames[1], 'cubic', 0.5)
    body, at = RigidBody(FULL, DAMPING), EPOCH_NS + np.arange(1, 6) * SECOND
    motion = propagate(body, LOADED, [linear, cubic], at=at)
    errors = [np.abs(chord(motion.attitude, propagate(
        body, LOADED, [linear, resampled(cubic, step)], at=at).attitude)).max()
        for step in (SECOND // 50, SECOND // 100, SECOND // 1000)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)  # second order
    assert errors[2] < 2e-7
    held = propagate(body, LOADED, [linear, TorqueLog(cubic.times_ns, cubic.torques, frames[1])],
                     at=at)
    assert chord(motion.attitude, held.attitude).max() > 1e-3


@pytest.mark.parametrize('frame', ['body', 'space'])
def test_straight_lines_of_two_sources_are_those_of_their_sum(frame):
    logs = [interpolated(count, 4.0, frame, 'linear', 0.03 * count) for count in (23, 17)]
    stamps = np.union1d(logs[0].times_ns, logs[1].times_ns)
    total = TorqueLog(stamps, logs[0].at(stamps)[0] + logs[1].at(stamps)[0], frame, 'linear')
    at = EPOCH_NS + np.arange(1, 6) * SECOND
    motions = [propagate(PLAIN, START, given, at=at) for given in (logs, total)]
    assert chord(motions[0].attitude, motions[1].attitude).max() < 1e-14


@pytest.mark.parametrize('interpolation', ['linear', 'cubic'])
def test_torque_on_the_rotors_is_interpolated(interpolation):
    wheels = interpolated(17, 4.0, 'body', interpolation, 0.5)
    motion = propagate(PLAIN, LOADED, at=wheels.times_ns, wheels=wheels)
    # Three-point Gauss quadrature is exact for cubics.
    nodes, weights = np.polynomial.legendre.leggauss(3)
    spans = np.diff(wheels.times_ns)
    pieces = sum(weight / 2 * wheels.at(wheels.times_ns[:-1] + (spans * (node + 1) / 2).astype(
        np.int64))[0] for node, weight in zip(nodes, weights)) * spans[:, None] / 1e9
    expected = LOADED.rotor_momentum + np.vstack([np.zeros(3), np.cumsum(pieces, axis=0)])
    np.testing.assert_allclose(motion.rotor_momentum, expected, atol=1e-8)
    np.testing.assert_allclose(motion.angular_momentum_space,
                               np.tile(motion.angular_momentum_space[0], (17, 1)), rtol=1e-13)


def test_zero_torques_in_space_axes_do_not_stop_a_damped_body():
    times = EPOCH_NS + np.arange(20) * SECOND // 1000
    body, zeros = RigidBody(FULL, DAMPING), np.zeros((20, 3))
    found, expected = (propagate(body, START, TorqueLog(times, zeros, frame), at=times)
                       for frame in ('space', 'body'))
    np.testing.assert_array_equal(numbers(found), numbers(expected))


def test_a_coast_before_the_rotors_turn_is_in_closed_form():
    body, start = RigidBody(np.diag([1.0, 1.5, 2.0])), State(0, angular_velocity=(1.0, 2.0, 3.0))
    wheels = TorqueLog([50 * SECOND], [[0.1, 0.0, 0.0]])
    motion = propagate(body, start, wheels=wheels, at=[20 * SECOND, 60 * SECOND])
    free = propagate(body, start, at=[20 * SECOND])
    assert motion.attitude[0].tolist() == free.attitude[0].tolist()
    assert [(model.solver, model.end_ns) for model in motion.models] \
        == [('exact', 50 * SECOND), ('taylor', 60 * SECOND)]
