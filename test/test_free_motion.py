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

"""Exact torque-free motion at any time, compared with 50 digits."""

from conftest import chord, EPOCH_NS, SECOND
from mpmath import mp
import numpy as np
import pytest
from rigid_body_ros import propagate, RigidBody, State
from rigid_body_ros.kernels import state_layout
from rigid_body_ros.mechanics import so3
import truth

ASYMMETRIC = np.diag([1.0, 2.0, 3.0])
DAY = 86400 * SECOND


def error(tensor, attitude, rates, span_ns, solver='exact'):
    """Return the error of the attitude, rad, and that of the rates, relative to the largest."""
    start = State(EPOCH_NS, attitude, rates)
    motion = propagate(RigidBody(tensor), start, at=[EPOCH_NS + span_ns], solver=solver)
    assert {model.solver for model in motion.models} == {solver}
    q, w = truth.free(np.asarray(tensor, float).tolist(), start.attitude.tolist(),
                      start.angular_velocity.tolist(), span_ns, digits=60)
    apart = [mp.mpf(float(a)) - b for a, b in zip(motion.angular_velocity[0], w)]
    return (float(truth.chord(q, motion.attitude[0].tolist())),
            float(mp.norm(apart)) / max(np.abs(motion.angular_velocity).max(), 1e-300))


@pytest.mark.slow
@pytest.mark.parametrize('span_ns', [SECOND, DAY, 365 * DAY])
@pytest.mark.parametrize(('moments', 'rates'), [
    ((1, 2, 3), (1.0, 0.4, 2.0)), ((1, 2, 3), (2.0, 0.4, -0.3)), ((1, 2, 3), (-2.0, 0.4, -0.3)),
    ((3, 1, 2), (-2.0, 0.4, -1.3)), ((1, 1 + 1e-9, 1 + 2e-9), (1.0, 0.4, 2.0)),
    ((1, 1 + 1e-12, 1), (1.0, 0.4, 2.0)), ((1e-6, 1, 1.0000005), (50.0, 1.0, 1.0)),
    ((1e-6, 1, 1.0000005), (0.5, 1.0, 1.0)), ((2, 2, 3), (1.0, 0.4, 2.0)),
    ((3, 3, 2), (1.0, 0.4, 2.0)), ((3, 2, 2), (1e-9, 0.4, 2.0)), ((2, 2, 2), (1.0, 0.4, 2.0)),
    ((1, 2, 3), (0.0, 0.0, 2.0)), ((1, 2, 3), (1.0, 2.0, 0.0)), ((1, 2, 3), (0.0, 0.0, 0.0)),
    ((1, 2, 3), (1e-200, 0.0, 0.0)), ((1, 2, 3), (3e-5, 4e-5, 1e-5))])
def test_motion_is_that_of_fifty_digits_however_late(moments, rates, span_ns):
    attitude, speed = error(np.diag(np.array(moments, float)), (0.0, 0.0, 0.0, 1.0), rates,
                            span_ns)
    assert attitude < 2e-15
    assert speed < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(60))
def test_any_tensor_and_any_start(seed):
    random = np.random.default_rng(seed)
    spread = random.normal(size=(3, 3)) * 10.0 ** random.uniform(-2, 2, 3)
    masses = spread @ spread.T
    tensor = np.trace(masses) * np.eye(3) - masses
    rates = random.normal(size=3) * 10.0 ** random.uniform(-3, 3)
    attitude, speed = error(tensor, so3.normalize(random.normal(size=4)), rates,
                            int(10.0 ** random.uniform(6, 17)))
    assert attitude < 3e-15
    assert speed < 1e-15


@pytest.mark.parametrize('tiny', [5e-324, 1e-160, 1e-40, 1e-20])
@pytest.mark.parametrize('moments', [(1, 2, 3), (1, 1.9, 1.9), (1, 1, 2), (2, 1, 3)])
@pytest.mark.parametrize('shape', [(1, 0, 2), (2, 0, 1), (1, 2, 0), (0, 1, 1)])
def test_rates_that_almost_vanish(shape, moments, tiny):
    # In `shape`, 2 means a rate of 1, and 1 a tiny rate. About the intermediate axis, the phase of
    # the closed form is about ln(1 / tiny), and rounded.
    rates = np.array([0.0, tiny, 1.0])[list(shape)] if max(shape) == 2 else tiny * np.array(shape)
    body, start = RigidBody(np.diag(np.array(moments, float))), State(0, angular_velocity=rates)
    motion = propagate(body, start, at=[SECOND, 20 * SECOND], solver='exact')
    series = propagate(body, start, at=[SECOND, 20 * SECOND], solver='taylor')
    assert chord(series.attitude, motion.attitude).max() < (1e-10 if tiny > 1e-22 else 2e-13)
    assert np.all(np.isfinite(motion.angular_velocity))


@pytest.mark.parametrize('scale', [2.0 ** -900, 1e-105, 1e150])
def test_the_scale_of_the_moments_does_not_matter(scale):
    start = State(0, angular_velocity=(1.0, 0.4, 2.0))
    times = [SECOND, 100 * SECOND]
    scaled = propagate(RigidBody(ASYMMETRIC * scale), start, at=times, solver='exact')
    plain = propagate(RigidBody(ASYMMETRIC), start, at=times, solver='exact')
    assert chord(plain.attitude, scaled.attitude).max() < 1e-13  # the scale is rounded


@pytest.mark.slow
@pytest.mark.parametrize(('moments', 'rates', 'seconds', 'bounds'), [
    # Exactly on the separatrix without an offset: 9 (9 - 5) w3^2 = 4 (5 - 4) w1^2. The phase is up
    # to K = ln(4 / sqrt(m_c)), and rounded.
    *(((4, 5, 9), (3.0, 0.1, 1.0 + offset), (5, 1000), (2e-14, 1e-14))
      for offset in (-1e-3, 1e-3, -1e-11, 1e-11, -2.0 ** -53, 2.0 ** -52)),
    *(((4, 5, 9), rates, (20,), (1e-14, 1e-14))
      for rates in ((3.0, 0.1, 1.0), (-3.0, -2.0, -1.0), (3.0, 0.0, -1.0))),
    # The body leaves the axis after ln(2 / offset) / 1.15 s, and rounding does not affect this.
    *(((1, 2, 3), (offset, 2.0, 0.0), (30, 100, 1000), (3e-14, 3e-14))
      for offset in (1e-10, 1e-20, 1e-30))])
def test_digits_last_up_to_the_separatrix_and_the_intermediate_axis(moments, rates, seconds,
                                                                    bounds):
    for time in seconds:
        found = error(np.diag(np.array(moments, float)), (0, 0, 0, 1), rates, time * SECOND)
        assert np.all(np.array(found) < bounds)


def test_where_the_closed_form_has_no_digits_the_series_takes_over_and_says_so():
    # Exactly about the intermediate axis. But this axis lies along (-4, 3, 0) / 5, and the closed
    # form knows 3/5 and 4/5 only to 32 digits.
    tensor = np.array([[41.0, -12.0, 0.0], [-12.0, 34.0, 0.0], [0.0, 0.0, 75.0]])
    start = State(0, angular_velocity=(-4.0, 3.0, 0.0))
    motion = propagate(RigidBody(tensor), start, at=[SECOND], solver='exact')
    series = propagate(RigidBody(tensor), start, at=[SECOND], solver='taylor')
    np.testing.assert_array_equal(motion.attitude, series.attitude)
    model, = motion.models
    assert model.solver == 'taylor'
    assert 'separatrix' in model.reason


def test_what_rounding_took_from_the_start_counts():
    # A state in the middle of a run carries more digits than its doubles show.
    body, low = RigidBody(ASYMMETRIC), np.array([3e-17, -2e-17, 5e-17])
    start = State._as_computed(0, state_layout.pack([1.0, 0.4, 2.0], [0.0, 0.0, 0.0, 1.0], low))
    span_ns = 10 ** 6 * SECOND
    motion = propagate(body, start, at=[span_ns], solver='exact')
    with mp.workdps(60):
        rates = [mp.mpf(a) + mp.mpf(b) for a, b in zip((1.0, 0.4, 2.0), low.tolist())]
        q, _ = truth.free(ASYMMETRIC.tolist(), [0.0, 0.0, 0.0, 1.0], rates, span_ns)
    assert truth.chord(q, motion.attitude[0].tolist()) < 2e-15
