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

"""Torque logs: the torque between samples."""

from conftest import EPOCH_NS, SECOND
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics.torque import INTERPOLATIONS

RANDOM = np.random.default_rng(23)
TIMES = EPOCH_NS + np.cumsum(RANDOM.integers(SECOND // 20, SECOND // 5, 40))
TORQUES = RANDOM.normal(size=(40, 3))


def smooth(times_ns):
    seconds = (np.asarray(times_ns) - EPOCH_NS)[:, None] * 1e-9
    return np.sin(seconds * [1.0, 1.7, 0.6] + [0.0, 1.0, 2.0])


@pytest.mark.parametrize('interpolation', INTERPOLATIONS)
def test_samples_are_met_and_the_last_is_held(interpolation):
    log = TorqueLog(TIMES, TORQUES, interpolation=interpolation)
    np.testing.assert_allclose(log.at(TIMES)[0], TORQUES, rtol=1e-15)
    np.testing.assert_array_equal(log.at([TIMES[-1] + 10 ** 12])[0], TORQUES[-1:])
    np.testing.assert_array_equal(log.at([TIMES[0] - 1])[0], [[0.0, 0.0, 0.0]])


def test_cubic_is_of_fourth_order():
    counts = np.array([80, 160, 320, 640, 1280])
    worst = []
    for count in counts:
        stamps = EPOCH_NS + np.arange(count + 1) * (10 * SECOND // count)
        between = stamps[2:-3] + 3 * SECOND // count
        log = TorqueLog(stamps, smooth(stamps), interpolation='cubic')
        worst.append(np.abs(log.at(between)[0] - smooth(between)).max())
    slope, _ = np.polyfit(np.log(1.0 / counts), np.log(worst), 1)
    assert abs(slope - 4.0) < 0.2


@pytest.mark.parametrize('count', [1, 2, 3, 4])
def test_cubic_takes_the_samples_there_are(count):
    log = TorqueLog(TIMES[:count], TORQUES[:count], interpolation='cubic')
    # Relative times, because adjacent doubles are 238 ns apart for absolute times.
    past = TIMES[:count] - TIMES[0]
    times = np.linspace(0, past[-1], 7).astype(np.int64)
    degree = np.polynomial.Polynomial.fit(past, TORQUES[:count, 0], count - 1, domain=[0.0, 1e9])
    np.testing.assert_allclose(log.at(TIMES[0] + times)[0][:, 0], degree(times), rtol=0,
                               atol=1e-12)


def test_of_equal_stamps_the_later_sample_counts():
    log = TorqueLog([5, 7, 5, 6, 5], np.arange(15.0).reshape(5, 3))
    assert log.times_ns.tolist() == [5, 6, 7]
    assert log.torques[:, 0].tolist() == [12.0, 9.0, 3.0]


def test_times_may_be_asked_for_in_any_order():
    log = TorqueLog([0, 10, 40], np.eye(3), interpolation='linear')
    at = log.at([40, -1, 10, 0, 25])[0]
    np.testing.assert_array_equal(at, [[0, 0, 1], [0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0.5, 0.5]])


def test_timeout_ends_a_torque_that_is_not_renewed():
    log = TorqueLog([0, 10, 40], np.ones((3, 3)))
    starts, samples = log.segments(20)
    assert starts.tolist() == [0, 10, 30, 40, 60]
    assert samples.tolist() == [0, 1, -1, 2, -1]
    assert log.at([29, 30, 39, 40, 59, 60], 20)[0][:, 0].tolist() == [1, 0, 0, 1, 1, 0]
    assert log.at([9, 10, 11], 1)[0][:, 0].tolist() == [0, 1, 0]
    # A torque that is renewed just in time does not time out.
    assert log.segments(10)[0].tolist() == [0, 10, 20, 40, 50]


@pytest.mark.parametrize('frame', ['body', 'space', ['space', 'body', 'space']])
def test_rows_of_a_log_keep_their_frames(frame):
    log = TorqueLog([9, 4, 6], np.eye(3), frame)
    for rows in (slice(1, None), np.array([0, 2]), slice(0, 0)):
        cut = log.rows(rows)
        np.testing.assert_array_equal(cut.times_ns, log.times_ns[rows])
        np.testing.assert_array_equal(cut.torques, log.torques[rows])
        np.testing.assert_array_equal(cut.in_space, log.in_space[rows])
    other = log.with_torques(2.0 * log.torques)
    np.testing.assert_array_equal(other.in_space, log.in_space)
    np.testing.assert_array_equal(other.torques, 2.0 * log.torques)
    flagged = TorqueLog(log.times_ns, log.torques, log.in_space)
    np.testing.assert_array_equal(flagged.in_space, log.in_space)
    assert not np.shares_memory(flagged.in_space, log.in_space)


# Near the ends, cubics depend on more samples on one side.
@pytest.mark.parametrize(('first', 'last'), [(11, 19), (0, 1), (38, 39), (39, 39)])
@pytest.mark.parametrize('interpolation', INTERPOLATIONS)
def test_the_samples_between_two_times_determine_the_torque_there(interpolation, first, last):
    log = TorqueLog(TIMES, TORQUES, 'space', interpolation)
    begin_ns, end_ns = int(TIMES[first]) + 7, int(TIMES[last]) - 7 + 14 * (first == last)
    piece = log.between(begin_ns, end_ns)
    assert len(piece) < len(log)
    assert piece.in_space.all()
    times = np.linspace(0, end_ns - begin_ns, 101).astype(np.int64) + begin_ns
    np.testing.assert_array_equal(piece.at(times)[0], log.at(times)[0])


@pytest.mark.parametrize(('log', 'text'), [
    (TorqueLog([], []), 'TorqueLog(no samples)'),
    (TorqueLog([0, SECOND // 2], [[0.03, 0, 0.04], [0, 0, 0]], ['body', 'space']),
     'TorqueLog(2 samples over 0.5 s, mixed axes, hold, up to 0.05 N m)'),
    (TorqueLog([3], [[0, 1.23456, 0]], 'space', 'cubic'),
     'TorqueLog(1 sample over 0 s, space axes, cubic, up to 1.23 N m)')])
def test_a_log_is_printed_with_units(log, text):
    assert repr(log) == text


def test_the_samples_of_a_log_cannot_be_changed():
    log = TorqueLog(TIMES, TORQUES)
    for array in (log.times_ns, log.torques, log.in_space):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = array[1]


def test_unsigned_times_that_fit_are_taken():
    log = TorqueLog(np.array([5, 2 ** 63 - 2], np.uint64), np.eye(3)[:2])
    assert log.times_ns.tolist() == [5, 2 ** 63 - 2]
    np.testing.assert_array_equal(log.at(np.array([7], np.uint64))[0], [[1.0, 0.0, 0.0]])


def test_rotors_follow_the_measured_momentum():
    random = np.random.default_rng(4)
    stamps = EPOCH_NS + np.cumsum(random.integers(SECOND // 2000, SECOND // 500, 60_000))
    momenta = np.cumsum(random.normal(scale=0.01, size=(60_000, 3)), axis=0)  # of both signs
    wheels = TorqueLog.from_momentum(stamps, momenta)
    assert not wheels.in_space.any()
    assert not wheels.torques[-1].any()
    at = np.append(stamps, stamps[-1] + [SECOND, 3600 * SECOND])
    motion = propagate(RigidBody(np.diag([10.0, 20.0, 25.0])),
                       State(int(stamps[0]), rotor_momentum=momenta[0]), at=at, wheels=wheels)
    # A torque in double precision reproduces the change from one sample to the next to half an ulp
    # of this change, which is more than an ulp of a sample close to zero.
    rows = np.append(np.arange(60_000), [-1, -1])
    change = np.abs(np.diff(momenta, axis=0, prepend=momenta[:1]))
    ulps = np.spacing(np.maximum(np.abs(momenta), change))[rows]
    assert np.all(np.abs(motion.rotor_momentum - momenta[rows]) <= 2.0 * ulps)


def test_measured_momenta_may_come_in_any_order():
    wheels = TorqueLog.from_momentum([2 * SECOND, 0, 2 * SECOND, SECOND],
                                     [[9, 9, 9], [0, 0, 1], [0, 4, 1], [1, 0, 1]])
    assert wheels.times_ns.tolist() == [0, SECOND, 2 * SECOND]
    assert wheels.torques.tolist() == [[1.0, 0.0, 0.0], [-1.0, 4.0, 0.0], [0.0, 0.0, 0.0]]


@pytest.mark.parametrize('count', [0, 1])
def test_rotors_with_one_measured_momentum_keep_theirs(count):
    wheels = TorqueLog.from_momentum(TIMES[:count], TORQUES[:count])
    assert len(wheels) == count
    assert not wheels.torques.any()
