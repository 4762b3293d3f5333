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

"""The errors of an IMU depend only on seed and stamp, with the statistics in the scene."""


from conftest import at_night, CONFIG, RECORDINGS, SECOND
import numpy as np
import pytest
from rigid_body_ros import messages, recording, scene
from rigid_body_ros.mechanics import draws, so3
from rigid_body_ros.mechanics.imu import ImuErrors
from rigid_body_ros.replay import replay
from rigid_body_ros.scene import InputError, Scene

ALL = ImuErrors(2e-3, 1e-3, (0.01, -0.02, 0.0), 3e-3, seed=7)
#: All errors except the delay.
KEYS = {'imu.gyro_noise_density': 2e-3, 'imu.gyro_random_walk': 1e-3, 'imu.gyro_bias.x': 0.01,
        'imu.gyro_bias.y': -0.02, 'imu.attitude_noise': 3e-3, 'imu.seed': 7}
MOMENTS = dict.fromkeys(('inertia.ixx', 'inertia.iyy', 'inertia.izz'), 1.0)


def noise(errors, stamps_ns):
    """Return measurements of a body at rest: rotation vectors, and angular velocities."""
    count = len(stamps_ns)
    attitude, rates = errors.measured(stamps_ns, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
                                      np.zeros((count, 3)))
    return so3.log(attitude), rates


def at_rate(rate, seconds):
    """Return stamps at a rate, Hz, that begin at a wall-clock time."""
    return 1_767_225_600 * SECOND + np.arange(int(rate * seconds)) * (SECOND // rate)


def allan_variance(rates, count):
    """Return the overlapping Allan variance of means of `count` samples, over all axes."""
    angles = np.cumsum(np.vstack([np.zeros(3), rates]), axis=0)
    change = (angles[2 * count:] - 2.0 * angles[count:-count] + angles[:-2 * count]) / count
    return 0.5 * np.mean(change ** 2)


@pytest.mark.slow
@pytest.mark.parametrize('rate', [100, *at_night(250)])
def test_the_allan_deviation_of_an_hour_is_that_of_the_parameters(rate):
    errors = ImuErrors(2e-4, 8e-4, seed=3)
    rates = noise(errors, at_rate(rate, 3600))[1]
    counts = np.unique(np.geomspace(0.05 * rate, 5.0 * rate, 15).astype(int))
    times = counts / rate
    # The variance is N^2 / time + K^2 time / 3.
    terms = np.column_stack([1.0 / times, times / 3.0])
    found = np.array([allan_variance(rates, count) for count in counts])
    squares = np.linalg.lstsq(terms / found[:, None], np.ones(len(found)), rcond=None)[0]
    np.testing.assert_allclose(np.sqrt(squares), [2e-4, 8e-4], rtol=0.05)
    # The two terms cross within these times, so both are visible.
    assert times[0] < 3 ** 0.5 * 2e-4 / 8e-4 < times[-1]


@pytest.mark.slow
def test_at_100_hz_the_noise_is_white_and_independent_on_each_axis():
    stamps = at_rate(100, 1000)
    errors = ImuErrors(1e-3, attitude_noise=2e-3, seed=1)
    vectors, rates = noise(errors, stamps)
    columns = np.hstack([vectors / 2e-3, rates / 1e-2])
    assert (errors.attitude_variance, errors.rate_variance) == pytest.approx((4e-6, 1e-4))
    np.testing.assert_allclose(columns.std(axis=0), 1.0, rtol=5.0 * (2 * len(stamps)) ** -0.5)
    assert abs(columns.mean(axis=0)).max() < 5.0 * len(stamps) ** -0.5
    assert abs((columns ** 4).mean(axis=0) - 3.0).max() < 5.0 * (96 / len(stamps)) ** 0.5
    both = np.hstack([columns[1:], columns[:-1]])
    others = np.corrcoef(both.T) - np.eye(12)
    assert abs(others).max() < 5.0 * len(stamps) ** -0.5


def test_the_bias_is_a_wiener_process_that_begins_at_zero():
    walk = noise(ImuErrors(0.0, 1.0), np.arange(0, 3000 * SECOND, SECOND // 10))[1]
    assert not walk[0].any()
    for lag in (1, 10, 100):
        steps = (walk[lag:] - walk[:-lag])[::lag]
        np.testing.assert_allclose(steps.std(), (0.1 * lag) ** 0.5,
                                   rtol=5.0 * (2 * steps.size) ** -0.5)
        assert abs(np.corrcoef(steps[1:].ravel(), steps[:-1].ravel())[0, 1]) < (
            5.0 * steps.size ** -0.5)
    # It stays within its size after hours, whatever the stamps, without a jump when it restarts.
    period = 2 ** 25 * SECOND // 1000
    later = 50_000 * period + np.arange(-5, 6) * SECOND // 1000
    around = noise(ImuErrors(0.0, 1.0), later)[1]
    assert not around[5].any()
    assert abs(np.diff(around, axis=0)).max() < 5.0 * 1e-3 ** 0.5
    many = noise(ImuErrors(0.0, 1.0), np.arange(1, 2001) * (997 * SECOND))[1]
    np.testing.assert_allclose(many.std(), (period / 6e9) ** 0.5, rtol=0.1)


@pytest.mark.slow
def test_the_noise_at_a_stamp_depends_on_neither_order_nor_rate():
    stamps = np.sort(np.random.default_rng(2).integers(0, 2 ** 31 * SECOND, 9000))
    stamps[:4000] = at_rate(1000, 4)
    together = np.hstack(noise(ALL, stamps))
    order = np.random.default_rng(3).permutation(len(stamps))
    np.testing.assert_array_equal(np.hstack(noise(ALL, stamps[order])), together[order])
    np.testing.assert_array_equal(np.hstack(noise(ALL, stamps[:4000:20])), together[:4000:20])
    alone = [np.hstack(noise(ALL, stamps[row:row + 1]))[0] for row in order[:300]]
    np.testing.assert_array_equal(alone, together[order[:300]])


def test_the_noise_has_the_same_bits_on_every_machine():
    bits = draws.hashed(np.array([0], np.uint64), np.arange(2, dtype=np.uint64))
    assert [*map(hex, bits.tolist())] == ['0xe220a8397b1dcdaf', '0x6e789e6aa1b965f4']
    vectors, rates = noise(ALL, np.array([1_767_225_600_123_456_789]))
    assert [number.hex() for number in [*vectors[0].tolist(), *rates[0].tolist()]] == [
        '0x1.89d0d849de971p-10', '-0x1.135951f8980a9p-9', '-0x1.5d335252499e4p-8',
        '-0x1.05d88bc572ed9p-3', '-0x1.ef32f9fdda77fp-3', '-0x1.f76e42c28d93fp-4']


def test_seeds_give_other_noise():
    stamps = at_rate(100, 100)
    one, two, again = (np.hstack(noise(ImuErrors(1.0, attitude_noise=0.01, seed=seed), stamps))
                       for seed in (0, 1, 0))
    np.testing.assert_array_equal(one, again)
    assert all(abs(np.corrcoef(one[:, k], two[:, k])[0, 1]) < 0.05 for k in range(6))
    assert np.isfinite(noise(ImuErrors(1.0, 1.0, seed=2 ** 63 - 1), stamps)[1]).all()


def test_odometry_states_variances_of_what_it_measures():
    state = scene.load(CONFIG / 'tumbler.yaml').start
    values = messages.ODOMETRY.decode(messages.odometry(state, 'w', 'b', 1e-4, 2e-6)).values
    np.testing.assert_array_equal(values[7:43].reshape(6, 6),
                                  np.diag([1e6, 1e6, 1e6, 1e-4, 1e-4, 1e-4]))
    np.testing.assert_array_equal(values[49:].reshape(6, 6),
                                  np.diag([1e6, 1e6, 1e6, 2e-6, 2e-6, 2e-6]))
    values[7:43] = values[49:] = 0.0
    plain = messages.ODOMETRY.decode(messages.odometry(state, 'w', 'b')).values
    np.testing.assert_array_equal(plain, values)


def replayed(tmp_path, keys, **options):
    """Replay the tumbler, and return the motion and the IMU data that it writes."""
    loaded = scene.load(CONFIG / 'tumbler.yaml')
    loaded = Scene.from_values({**loaded.values, **keys})
    output = tmp_path / 'out.mcap'
    replay(RECORDINGS / 'tumbler.mcap', loaded, output, also=('imu',), **options)
    attitude, rates, imu = (recording.read(output, topic, kind) for topic, kind in (
        ('/attitude', messages.QUATERNION), ('/angular_velocity', messages.VECTOR3),
        ('/imu/data', messages.IMU)))
    np.testing.assert_array_equal(imu.stamps_ns, attitude.stamps_ns)
    return np.hstack([attitude.values, rates.values]), imu


@pytest.mark.slow
def test_a_replay_writes_the_errors_to_imu_data_alone(tmp_path):
    exact, plain = replayed(tmp_path, {})
    motion, imu = replayed(tmp_path, KEYS)
    np.testing.assert_array_equal(motion, exact)
    attitude, rates = ALL.measured(imu.stamps_ns, exact[:, :4], exact[:, 4:])
    np.testing.assert_array_equal(imu.values[:, :4], attitude)
    np.testing.assert_array_equal(imu.values[:, 13:16], rates)
    for first, variance in ((4, ALL.attitude_variance), (16, ALL.rate_variance)):
        assert (imu.values[:, first:first + 9] == variance * np.eye(3).ravel()).all()
    assert not plain.values[:, 4:13].any()
    np.testing.assert_array_equal(plain.values[:, :4], exact[:, :4])
    np.testing.assert_array_equal(plain.values[:, 13:16], exact[:, 4:])


@pytest.mark.slow
@pytest.mark.parametrize('rate', [None, 4000.0])
def test_a_late_imu_has_the_motion_from_before_its_stamp(tmp_path, rate):
    exact, imu = replayed(tmp_path, {'imu.delay': 0.05, **KEYS}, rate=rate, until=20.0)
    loaded = scene.load(CONFIG / 'tumbler.yaml')
    problem = recording.read_problem(RECORDINGS / 'tumbler.mcap', loaded)
    start_ns = problem.start.time_ns
    motion = problem.propagate(at=np.maximum(imu.stamps_ns - SECOND // 20, start_ns))
    attitude, rates = ALL.measured(imu.stamps_ns, motion.attitude, motion.angular_velocity)
    np.testing.assert_array_equal(imu.values[:, :4], attitude)
    np.testing.assert_array_equal(imu.values[:, 13:16], rates)
    assert abs(motion.attitude - exact[:, :4]).max() > 1e-3
    assert len(imu.stamps_ns) > (2 ** 16 if rate else 100)


@pytest.mark.parametrize(('key', 'value'), [
    ('imu.gyro_noise_density', -1e-3), ('imu.attitude_noise', 4.0), ('imu.delay', -0.1),
    ('imu.seed', -1), ('odometry.rate_variance', -1.0)])
def test_impossible_errors_are_refused(key, value):
    with pytest.raises(InputError, match=f'{key}: expected .*found {value}'):
        Scene.from_values({**MOMENTS, key: value})
