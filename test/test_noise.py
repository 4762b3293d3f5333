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

"""The noise of errors, how long it lasts, and how certain it leaves an estimate."""

from dataclasses import replace

import numpy as np
import pytest
from rigid_body_ros.identification.estimation import too_wide
from rigid_body_ros.identification.result import Estimate
from rigid_body_ros.inference import reasons
from rigid_body_ros.inference.noise import noise_of, NoiseLevel, NORMAL_95
from scipy.signal import lfilter


@pytest.mark.parametrize(('coefficient', 'lasting'), [(0.0, 1.0), (0.5, np.sqrt(3.0)), (0.8, 3.0)])
def test_the_noise_of_an_autoregression(coefficient, lasting):
    white = np.random.default_rng(1).standard_normal((20_000, 3)) * [1.0, 2.0, 0.5]
    noise = lfilter([np.sqrt(1.0 - coefficient ** 2)], [1.0, -coefficient], white, axis=0)
    found = noise_of([noise], 1.0)
    np.testing.assert_allclose(found.sizes, [1.0, 2.0, 0.5], rtol=0.03)
    assert found.lasting == pytest.approx(lasting, rel=0.05)
    left = found.innovations(noise)
    assert abs(np.mean(left[1:] * left[:-1])) < 0.02 * np.mean(left ** 2)


@pytest.mark.parametrize('colour', [0.0, 0.5, 0.8])
def test_the_noise_is_found_whatever_the_model(colour):
    random, level = np.random.default_rng(2), NoiseLevel(2e-3)
    for _ in range(200):
        white = random.normal(size=(250, 3)) * 2e-3 * np.sqrt(1.0 - colour ** 2)
        errors = lfilter([1.0], [1.0, -colour], white, axis=0)
        level.add(errors + np.linspace(0.0, 1.0, 250)[:, None] ** 2)  # a wrong model
    assert abs(level.size / 2e-3 - 1.0) < 0.05
    expected = (1.0 + colour) / (1.0 - colour)
    assert abs(level.factor / expected - 1.0) < 0.1


@pytest.mark.parametrize(('coefficient', 'count'), [(0.0, 1.0), (0.9, 19.0), (0.98, 99.0)])
def test_correlated_errors_tell_as_much_as_fewer_independent_ones(coefficient, count):
    # The mean of n errors of an autoregression varies as that of n (1 - c) / (1 + c) errors.
    white = np.random.default_rng(0).normal(size=(200_000, 3))
    errors = lfilter([1.0], [1.0, -coefficient], white, axis=0)
    found = reasons._persistence(errors, np.ones(len(errors), bool))
    assert count <= found + 0.02 * count
    assert found < 1.4 * count + 0.6  # the largest of several estimates is somewhat too large


def test_a_small_error_that_lasts_shows_beside_noise():
    random, seconds = np.random.default_rng(1), np.linspace(0.0, 1.0, 20_000)
    errors = random.normal(size=(20_000, 3)) + 0.3 * np.sin(2.0 * np.pi * seconds)[:, None]
    assert reasons._persistence(errors, np.ones(20_000, bool)) > 30.0


def test_a_systematic_error_counts_as_one_between_bounds():
    one = Estimate('inertia.ixx', 'kg m^2', 1.0, 1.0, 0.03, True, 0.04 * np.sqrt(3.0))
    assert one.uncertainty == pytest.approx(0.05, rel=1e-15)
    np.testing.assert_allclose(one.interval_95, (1.0 - 0.05 * NORMAL_95, 1.0 + 0.05 * NORMAL_95),
                               rtol=1e-15)
    assert replace(one, systematic=0.0).uncertainty == one.sigma
    assert replace(one, sigma=np.inf).uncertainty == np.inf


def test_an_interval_of_a_moment_may_not_contain_zero():
    unknown = [Estimate(f'inertia.i{axis}{axis}', 'kg m^2', 1.0, 1.0, np.inf, False)
               for axis in 'xyz']
    product = Estimate('inertia.ixy', 'kg m^2', 1e-3, 0.0, 0.1, True)
    assert too_wide([*unknown, product], {}, None) == []
    assert too_wide([*unknown, product], {}, 0.1) == [
        'inertia.ixy: the interval is wider than the accepted 0.1']
    for sigma, texts in ((0.5, []), (0.52, ['inertia.ixx: the interval contains 0'])):
        known = replace(unknown[0], sigma=sigma, identifiable=True)
        assert too_wide([known, *unknown[1:]], {}, None) == texts
