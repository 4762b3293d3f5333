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

"""A live check of a model: true and false alarms, and any order of arrival."""

from functools import cache

from conftest import at_night, EPOCH_NS, SECOND
import monitor as campaign
import numpy as np
import pytest
from rigid_body_ros import Actuator, Problem, RigidBody, State, TorqueLog
from rigid_body_ros.inference.monitor import ERROR, Monitor, monitored, Settings
from rigid_body_ros.recording.measured import Measured
from scipy.stats import chi2

pytestmark = pytest.mark.slow
BODY = RigidBody(campaign.INERTIA)
#: The error of the model that is tested in every run, and the others.
FIRST, *LATER = campaign.ERRORS
#: Settings with a history that is long enough for messages in any order.
PATIENT = Settings(5.0, campaign.HISTORY, campaign.ATTITUDE_NOISE, campaign.RATE_NOISE, 24.0)


@cache
def messages(seconds=120, error=None, **options):
    """Return torques and measurements: time, method of `Monitor`, and its arguments."""
    found = []
    for torques, mocap, gyro in campaign.pieces(3, seconds, **campaign.ERRORS.get(
            error, options)):
        found += [(time_ns, 'torque', torque) for time_ns, torque in zip(*torques)]
        found += [(time_ns, '/mocap', attitude) for time_ns, attitude in zip(*mocap)]
        found += [(time_ns, '/gyro', rate) for time_ns, rate in zip(*gyro)]
    return [(EPOCH_NS + int(time_ns), name, values) for time_ns, name, values in found]


def late(found):
    """Return messages that arrive up to half a second late, in the order of arrival."""
    random = np.random.default_rng(5)
    return sorted(found, key=lambda message: message[0] + int(random.integers(0, SECOND // 2)))


def ascending(found, without=(0, 0)):
    """Return messages in the order of their times, without the torques between two times."""
    begin_ns, end_ns = without
    return sorted((message for message in found
                   if message[1] != 'torque' or not begin_ns < message[0] < end_ns),
                  key=lambda message: message[0])


def put(monitor, time_ns, name, values):
    """Put a message of `messages` into a monitor; return whether it is accepted."""
    if name == 'torque':
        return monitor.apply([time_ns], values[None])
    none = np.full((1, 4), np.nan)
    return monitor.measure(name, [time_ns], *(
        (values[None], none[:, :3]) if name == '/mocap' else (none, values[None])))


def judged(found, settings=PATIENT, problem=None, step=1000, actuators=()):
    """Return the judgements of messages in their order."""
    monitor, result = Monitor(problem or Problem(BODY, State(0)), settings, actuators), []
    for number, message in enumerate(found):
        assert put(monitor, *message)
        if not number % step:
            result += monitor.judgements()
    return [*result, *monitor.judgements()]


def numbers(judgements):
    return np.array([np.concatenate([[one.error.end_ns], one.error.attitude, one.error.rate,
                                     one.error.torque, [one.sigma]]) for one in judgements])


def windows(judgements):
    """Return the numbers of the judged windows of 5 s; messages begin in the first window."""
    return [(one.error.end_ns - EPOCH_NS) // (5 * SECOND) + 1 for one in judgements]


def test_an_attitude_that_nobody_fills_is_no_error_of_the_model():
    monitor = Monitor(Problem(BODY, State(0)), PATIENT)
    for time_ns, name, values in messages(120):
        if name == 'torque':
            monitor.apply([time_ns], values[None])
        elif name == '/gyro':
            monitor.measure('/imu', [time_ns], np.array([[0.0, 0.0, 0.0, 1.0]]), values[None])
    levels = [one.level for one in monitor.judgements()]
    assert len(levels) > 5
    assert ERROR not in levels
    assert monitor.notes['/imu'].startswith('the attitude is not used: it is [0.0, 0.0, 0.0, 1.0]')


def test_the_errors_of_a_right_model_have_the_stated_covariance_and_give_no_alarm():
    judgements = judged(messages(660))
    assert not any(one.level == ERROR for one in judgements)
    found = [one.error for one in judgements]
    squares = [change @ np.linalg.solve(one.covariance, change) for one in found
               for change in [np.concatenate([one.attitude, one.rate])]]
    torques = [one.torque @ np.linalg.solve(one.torque_covariance, one.torque) for one in found]
    assert len(found) > 100
    # The sum of chi-squares. The first windows are left out, because they assume more noise.
    for sums, count in ((squares[40:], 6), (torques[40:], 3)):
        share = chi2.cdf(np.sum(sums), count * len(sums))
        assert 1e-3 < share < 1.0 - 1e-3


@pytest.mark.parametrize('name', [FIRST, *at_night(*LATER)])
def test_an_error_of_the_model_is_found(name):
    assert any(one.level == ERROR for one in judged(messages(420, name)))


def test_the_residual_torque_is_the_torque_that_is_not_logged():
    bias = np.array([1e-4, -5e-5, 2e-5])
    found = judged(messages(120, bias=tuple(bias.tolist())))
    torques = np.array([one.error.torque for one in found])
    sigma = np.sqrt([np.diag(one.error.torque_covariance) for one in found])
    # The inertia is right, so each window finds the torque within a few standard deviations.
    assert np.abs((torques - bias) / sigma).max() < 5.0


def test_the_order_of_arrival_changes_no_bit():
    found = ascending(messages(60))
    settings = PATIENT._replace(history=1.0)
    expected = judged(found, settings)
    assert len(expected) >= 10
    for order, step in ((late(found), 1), (late(found), 333), (found, 7)):
        np.testing.assert_array_equal(numbers(judged(order, settings, step=step)),
                                      numbers(expected))


def test_a_message_of_a_window_that_was_judged_is_rejected():
    found = ascending(messages(60))
    monitor = Monitor(Problem(BODY, State(0)), PATIENT._replace(history=1.0))
    for message in found:
        if message[1] == '/gyro':
            assert put(monitor, *message)
    count = len([*monitor.judgements()])
    assert count >= 10
    assert not put(monitor, EPOCH_NS + 3 * SECOND, '/mocap', np.array([0, 0, 0, 1.0]))
    assert not put(monitor, EPOCH_NS + 3 * SECOND, 'torque', np.ones(3))


def test_memory_is_bounded():
    monitor = Monitor(Problem(BODY, State(0)), PATIENT._replace(history=1.0))
    sizes, aside = [], []
    for message in ascending(messages(180)):
        put(monitor, *message)
        [*monitor.judgements()]
        rows = (*monitor._torques.values(), *monitor._sensors.values())
        sizes.append(sum(len(each._all()[0]) for each in rows))
        aside.append(sum(len(stamps_ns) for each in rows for stamps_ns, _ in each._aside))
    assert max(sizes[-6000:]) <= max(sizes[:6000])
    per_second = campaign.TORQUE_HZ + campaign.MOCAP_HZ + campaign.GYRO_HZ
    assert max(aside) == max(aside[-6000:]) == 120 * per_second


def test_a_torque_that_is_not_known_is_no_error_of_the_model():
    found = ascending(messages(120), (EPOCH_NS + 32 * SECOND, EPOCH_NS + 48 * SECOND))
    settings = PATIENT._replace(history=1.0)
    # If the last torque is held for long, it is not the torque that really acts.
    assert any(one.level == ERROR for one in judged(found, settings, step=1))
    for order, step in ((found, 1), (found, 777)):
        judgements = judged(order, settings._replace(stale_after=1.0), step=step)
        assert not any(one.level == ERROR for one in judgements)
        # All complete windows, except for those from 29.9 s to 49.9 s.
        assert windows(judgements) == [2, 3, 4, 5, 6, *range(11, 24)]


def test_a_window_waits_until_it_is_known_whether_the_last_torque_was_followed():
    # The sixth window ends at 29.9 s. The next torque follows 0.9 s or 1.1 s after its last.
    for next_s, is_judged in ((30.4, True), (30.6, False)):
        found = ascending(messages(60), (EPOCH_NS + 29_500_000_000,
                                         EPOCH_NS + round(next_s * SECOND)))
        settings = PATIENT._replace(history=0.0, stale_after=1.0)
        assert windows(judged(found, settings, step=1)) == [
            2, 3, 4, 5, *[6] * is_judged, *[7] * is_judged, 8, 9, 10, 11, 12]


def test_windows_in_which_torques_begin_or_are_lost_are_skipped():
    # Before the first torque, no torque acts, or the torque is unknown.
    for awaited, judged_first in ((), [1, 2]), ({0}, []):
        monitor = Monitor(Problem(BODY, State(0)), PATIENT._replace(history=0.0))
        monitor.awaited.update(awaited)
        monitor.skip(EPOCH_NS + 31 * SECOND, EPOCH_NS + 32 * SECOND, 'lost')
        for message in messages(60):
            if message[1] != 'torque' or message[0] >= EPOCH_NS + 12 * SECOND:
                put(monitor, *message)
        assert windows([*monitor.judgements()]) == [*judged_first, 4, 5, 6, *range(8, 13)]
        assert monitor.skipped == {'lost': 1, 'torque not known yet': 3 - len(judged_first)}


def test_the_lag_of_an_actuator_is_part_of_the_model_with_the_bits_of_the_offline_twin():
    # The limit matters, and the lag lasts longer than a window.
    actuator, settings = Actuator(0.04, 0.3, (5e-3, 5e-3, 4e-3)), PATIENT._replace(history=1.0)
    (torques, mocap, gyro), = campaign.pieces(3, 60, actuator=actuator)
    log = TorqueLog(EPOCH_NS + torques[0], torques[1])
    twin = [*monitored(Problem(BODY, State(EPOCH_NS), log, actuator=actuator), [
        Measured('/mocap', EPOCH_NS + mocap[0], mocap[1], None),
        Measured('/gyro', EPOCH_NS + gyro[0], None, gyro[1])], settings)]
    assert len(twin) >= 10
    assert not any(one.level == ERROR for one in twin)
    found = late(messages(60, actuator=actuator))
    scene = Problem(BODY, State(0), actuator=[actuator])
    for step in (1, 555):
        live = judged(found, settings, scene, step, [actuator])
        np.testing.assert_array_equal(numbers(live), numbers(twin)[:len(live)])
    assert any(one.level == ERROR for one in judged(found, settings))  # without the actuator


def test_a_silent_sensor_is_no_error_of_the_model():
    found = [message for message in messages(180)
             if message[1] != '/mocap' or message[0] < EPOCH_NS + 60 * SECOND]
    judgements = judged(found)
    assert judgements[-1].error.end_ns > EPOCH_NS + 100 * SECOND  # the gyro suffices
    assert np.isnan(judgements[-1].error.attitude).all()
    assert not any(one.level == ERROR for one in judgements)
