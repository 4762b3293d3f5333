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

"""A live check of a model: what it finds, what it does not, in any order of arrival."""

import sys

from conftest import at_night, EPOCH_NS, ROOT, SECOND
import numpy as np
import pytest
from rigid_body_ros import Problem, RigidBody, State
from rigid_body_ros.sensing.alarms import ERROR, NoiseLevel
from rigid_body_ros.sensing.monitor import Monitor, Settings
from scipy.signal import lfilter
from scipy.stats import chi2

sys.path.insert(0, str(ROOT / 'benchmarks'))
import monitor as campaign  # noqa: E402, I100

BODY = RigidBody(campaign.INERTIA)
#: Errors of the model.
FIRST, LATER = [*campaign.ERRORS][:2], [*campaign.ERRORS][2:]
#: Late enough for messages in any order.
PATIENT = Settings(5.0, campaign.HISTORY, campaign.ATTITUDE_NOISE, campaign.RATE_NOISE, 24.0)


def messages(seconds=120, seed=3, **wrong):
    """Return torques and measurements: time, method of `Monitor`, and its arguments."""
    found = []
    for torques, mocap, gyro in campaign.pieces(seed, seconds, **wrong):
        found += [(time_ns, 'torque', torque) for time_ns, torque in zip(torques[0], torques[1])]
        found += [(time_ns, '/mocap', attitude) for time_ns, attitude in zip(*mocap)]
        found += [(time_ns, '/gyro', rate) for time_ns, rate in zip(*gyro)]
    return [(EPOCH_NS + int(time_ns), name, values) for time_ns, name, values in found]


def put(monitor, time_ns, name, values):
    """Put a message of `messages` into a monitor; return whether it fits."""
    if name == 'torque':
        return monitor.apply([time_ns], values[None])
    none = np.full((1, 4), np.nan)
    return monitor.measure(name, [time_ns], *(
        (values[None], none[:, :3]) if name == '/mocap' else (none, values[None])))


def judged(found, settings=PATIENT, problem=None, step=1000):
    """Return the judgements of messages in their order."""
    monitor, result = Monitor(problem or Problem(BODY, State(0)), settings), []
    for number, message in enumerate(found):
        assert put(monitor, *message)
        if not number % step:
            result += monitor.judgements()
    return [*result, *monitor.judgements()]


def numbers(judgements):
    return np.array([np.concatenate([[one.error.end_ns], one.error.attitude, one.error.rate,
                                     one.error.torque, [one.sigma]]) for one in judgements])


def test_the_errors_of_a_right_model_have_the_covariance_that_is_stated():
    found = [one.error for one in judged(messages(660))]
    squares = [change @ np.linalg.solve(one.covariance, change) for one in found
               for change in [np.concatenate([one.attitude, one.rate])]]
    torques = [one.torque @ np.linalg.solve(one.torque_covariance, one.torque) for one in found]
    assert len(found) > 100
    # The sum of chi-squares; the factors of the noise, which begin with caution, widen them.
    for sums, count in ((squares[40:], 6), (torques[40:], 3)):
        share = chi2.cdf(np.sum(sums), count * len(sums))
        assert 1e-3 < share < 1.0 - 1e-3


@pytest.mark.parametrize('name', [*FIRST, *at_night(*LATER)])
def test_an_error_of_the_model_is_found(name):
    assert any(one.level == ERROR for one in judged(messages(420, **campaign.ERRORS[name])))


def test_a_right_model_gives_no_alarm():
    assert not any(one.level == ERROR for one in judged(messages(420)))


def test_the_residual_torque_is_the_torque_that_is_not_logged():
    bias = np.array([1e-4, -5e-5, 2e-5])
    found = judged(messages(120, bias=tuple(bias)))
    torques = np.array([one.error.torque for one in found])
    sigma = np.sqrt([np.diag(one.error.torque_covariance) for one in found])
    # The inertia is right, so each window has the torque within a few standard deviations.
    assert np.abs((torques - bias) / sigma).max() < 5.0


def test_the_order_of_arrival_changes_no_bit():
    found = sorted(messages(120), key=lambda message: message[0])
    random = np.random.default_rng(5)
    late = sorted(found, key=lambda message: message[0] + int(random.integers(0, SECOND // 2)))
    settings = PATIENT._replace(history=1.0)
    expected = judged(found, settings)
    assert len(expected) > 20
    for order, step in ((late, 1), (late, 333), (found, 7)):
        np.testing.assert_array_equal(numbers(judged(order, settings, step=step)),
                                      numbers(expected))


def test_a_message_of_a_window_that_was_judged_is_rejected():
    found = sorted(messages(60), key=lambda message: message[0])
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
    sizes = []
    for message in sorted(messages(180), key=lambda message: message[0]):
        put(monitor, *message)
        [*monitor.judgements()]
        rows = (*monitor._torques.values(), *monitor._sensors.values())
        sizes.append(sum(len(each._all()[0]) for each in rows))
    assert max(sizes[-6000:]) <= max(sizes[:6000])


def test_a_silent_sensor_is_no_error_of_the_model():
    found = [message for message in messages(180)
             if message[1] != '/mocap' or message[0] < EPOCH_NS + 60 * SECOND]
    judgements = judged(found)
    assert judgements[-1].error.end_ns > EPOCH_NS + 100 * SECOND  # the gyro suffices
    assert np.isnan(judgements[-1].error.attitude).all()
    assert not any(one.level == ERROR for one in judgements)


@pytest.mark.parametrize('colour', [0.0, 0.5, 0.8])
def test_the_noise_is_found_whatever_the_model(colour):
    random, level = np.random.default_rng(2), NoiseLevel(2e-3)
    for _ in range(200):
        white = random.normal(size=(250, 3)) * 2e-3 * np.sqrt(1.0 - colour ** 2)
        errors = lfilter([1.0], [1.0, -colour], white, axis=0)
        level.add(errors + np.linspace(0.0, 1.0, 250)[:, None] ** 2)  # of a wrong model
    assert abs(level.found / 2e-3 - 1.0) < 0.05
    expected = (1.0 + colour) / (1.0 - colour)
    assert abs(level.factor / expected - 1.0) < 0.1
