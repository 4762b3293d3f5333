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

"""The truth itself is tested: two independent computations with fifty digits agree."""

from mpmath import mp
import numpy as np
from parts import BODY
import pytest
from rigid_body_ros import TorqueLog
import truth

pytestmark = pytest.mark.slow

SECOND = 10 ** 9
START = (0.1, -0.3, 0.2, 0.9)
MOTIONS = {
    'round the largest moment': (np.diag([1.0, 2.0, 3.0]), (1.0, 0.4, -2.0)),
    'flipping': (np.diag([3.0, 1.0, 2.0]), (0.02, -0.01, -1.0)),
    'full tensor': (BODY.inertia, (0.5, -0.7, 0.9)),
    'prolate': (np.diag([2.0, 1.0, 2.0]), (0.5, -0.7, 0.9)),
    'oblique top': ([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]], (0.5, -0.7, 0.9)),
    'sphere': (np.diag([2.0, 2.0, 2.0]), (0.5, -0.7, 0.9)),
    'rod': (np.diag([1e-6, 1.0, 1.0000005]), (2.0, 1.0, 1.0)),
    'principal axis': (np.diag([1.0, 2.0, 3.0]), (0.0, -2.0, 0.0)),
    'at rest': (np.diag([1.0, 2.0, 3.0]), (0.0, 0.0, 0.0)),
    'separatrix, other side': (np.diag([3.0, 4.0, 6.0]), (-2.0, 0.3, 1.0)),
}


def apart(a, b):
    with mp.workdps(70):
        return max(abs(x - y).max() for x, y in zip(a, b))


@pytest.mark.parametrize('name', MOTIONS)
def test_closed_form_is_the_series(name):
    tensor, rates = MOTIONS[name]
    for a, b in zip((SECOND, 2 * SECOND), truth.series(
            tensor, START, rates, [(SECOND, (0, 0, 0), False), (SECOND, (0, 0, 0), True)])):
        assert apart(truth.free(tensor, START, rates, a), b) < 1e-50


@pytest.mark.parametrize('name', MOTIONS)
def test_a_million_turns_are_those_of_two_halves(name):
    tensor, rates = MOTIONS[name]
    whole, part = 5_000_000 * SECOND + 1, 1_234_567 * SECOND
    if 'separatrix' in name:  # where errors grow as exp(t)
        whole, part = 20 * SECOND, 7 * SECOND
    middle = truth.free(tensor, START, rates, part)
    assert apart(truth.free(tensor, START, rates, whole),
                 truth.free(tensor, *middle, whole - part)) < 1e-50


def test_a_turn_ends_on_the_other_cover():
    with mp.workdps(60):
        rate = 2 * mp.pi
    q, _ = truth.free(np.diag([1.0, 2.0, 3.0]), START, (0, 0, rate), SECOND)
    assert truth.chord(q, START) == pytest.approx(2 * np.pi)
    assert truth.chord(q, -np.array(START)) < 1e-45


@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
def test_polynomials_are_those_of_a_log(interpolation):
    random = np.random.default_rng(3)
    times = np.cumsum(random.integers(SECOND // 10, SECOND, 7))
    log = TorqueLog(times, random.normal(size=(7, 3)), interpolation=interpolation)
    found = truth.polynomials(times, log.torques, interpolation)
    assert len(found) == len(times)
    for start, end, rows in zip(times, times[1:], found):
        at = np.linspace(start, end, 7)[:-1].astype(np.int64)
        powers = ((at - start) / (end - start))[:, None] ** np.arange(len(rows))
        np.testing.assert_allclose(powers @ rows.astype(float), log.at(at)[0], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(found[-1].astype(float), log.torques[-1:])


def test_momentum_is_the_integral_of_a_linear_torque_in_space():
    torques = np.array([[0.02, -0.01, 0.03], [-0.05, 0.03, 0.01]])
    rise, _ = truth.polynomials([0, 2 * SECOND], torques, 'linear')
    q, w = truth.series(BODY.inertia, START, (0, 0, 0), [(2 * SECOND, rise, True)])[-1]
    with mp.workdps(70):
        momentum = truth.rotate(q, truth.exact(BODY.inertia) @ w)
        assert apart([momentum], [sum(truth.exact(torques))]) < 1e-50


def test_angle_under_a_torque_along_a_principal_axis():
    q, w = truth.series(np.diag([1.0, 2.0, 3.0]), (0, 0, 0, 1), (0, 1, 0),
                        [(2 * SECOND, (0, -0.5, 0), False), (SECOND, (0, 0.5, 0), False)])[-1]
    with mp.workdps(70):
        half = mp.mpf(2 - 0.5 + 0.5 + 0.125) / 2
        expected = truth.exact([0, mp.sin(half), 0, mp.cos(half)]), truth.exact([0, 0.75, 0])
    assert apart((q, w), expected) < 1e-50
