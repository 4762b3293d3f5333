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

"""The time loop: what acts when, how much is computed at a time, and what answers."""

from conftest import chord, EPOCH_NS, Reference, SECOND
import numpy as np
from parts import BODY
import pytest
from rigid_body_ros import propagate, Propagator, RigidBody, State, TorqueLog
from rigid_body_ros.engine import kernels, layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.torque import INTERPOLATIONS
from rigid_body_ros.propagation import SOLVERS

START = State(EPOCH_NS, (0.1, -0.3, 0.2, 0.9), (0.5, -0.7, 0.9))


def same(state, motion, row):
    return (np.array_equal(state.attitude, motion.attitude[row])
            and np.array_equal(state.angular_velocity, motion.angular_velocity[row]))


@pytest.mark.parametrize('interpolation', ['linear', 'cubic'])
def test_a_run_restarted_from_a_coast_takes_what_lies_between_samples(interpolation):
    state = Propagator(BODY, START).at(EPOCH_NS + 5 * SECOND)
    bare = State._as_computed(state.time_ns, state._packed)
    log = TorqueLog(EPOCH_NS + np.array([4, 8]) * SECOND, [[0, 0, 0], [1, 0, 0]],
                    interpolation=interpolation)
    ends = [propagate(BODY, start, log, at=[EPOCH_NS + 6 * SECOND]) for start in (state, bare)]
    np.testing.assert_array_equal(ends[0].attitude, ends[1].attitude)


def test_a_run_restarted_long_after_its_torque_takes_that_torque():
    whole = Propagator(BODY, START)
    whole.apply(EPOCH_NS, [0.3, 0.1, 0.2])
    resumed = Propagator(BODY, whole.at(EPOCH_NS + 10 * SECOND))
    assert resumed.apply(EPOCH_NS, [0.3, 0.1, 0.2])  # far older than history, but the first one
    end_ns = EPOCH_NS + 11 * SECOND
    np.testing.assert_array_equal(resumed.at(end_ns).attitude, whole.at(end_ns).attitude)


def test_a_torque_at_the_restart_that_repeats_the_last_begins_anew():
    middle_ns, end_ns, torque = EPOCH_NS + 2 * SECOND + 77, EPOCH_NS + 4 * SECOND, [0.3, 0.1, 0.2]
    whole = Propagator(BODY, START)
    whole.apply(EPOCH_NS, torque)
    middle = whole.at(middle_ns)
    whole.apply(middle_ns, torque)
    resumed = Propagator(BODY, middle)
    resumed.apply(middle_ns, torque)
    replayed = propagate(BODY, middle, TorqueLog([middle_ns], [torque]), at=[end_ns])
    assert same(whole.at(end_ns), replayed, 0)
    assert same(resumed.at(end_ns), replayed, 0)


@pytest.mark.parametrize('solver', SOLVERS)
def test_attitude_is_the_continuous_lift(solver):
    body, turn = RigidBody.from_moments(1.0, 2.0, 2.5), round(2 * np.pi * 1e9)
    motion = propagate(body, State(0, angular_velocity=(0, 0, 1.0)), at=[0, turn, 2 * turn],
                       solver=solver, max_step=1e-3)
    np.testing.assert_allclose(motion.attitude[:, 3], [1.0, -1.0, 1.0], rtol=1e-10)


@pytest.mark.parametrize('case', ['stream', 'outputs of a stream', 'coast', 'segment', 'zeros'])
def test_a_kernel_returns_after_a_bounded_number_of_steps_and_outputs(monkeypatch, case):
    # However long the log is, and however many outputs there are, Python handles signals between
    # calls of the kernel.
    stamps = EPOCH_NS + np.arange(5000) * SECOND // 1000
    torques = np.tile([0.1, 0.2, -0.1], (5000, 1))
    span_ns = {'coast': 3600 * SECOND, 'segment': SECOND // 1000}.get(case, 5 * SECOND)
    log = {'coast': None, 'segment': TorqueLog(stamps[:1], torques[:1]),
           'zeros': TorqueLog(stamps, 0.0 * torques)}.get(case, TorqueLog(stamps, torques))
    at = EPOCH_NS + span_ns - np.arange(1 if case in ('stream', 'zeros') else 5000)[::-1] * 10
    whole = propagate(BODY, START, log, at=at)
    progress, run = [], kernels.run

    def recorded(reached, *rest):
        before = reached.copy()
        result = run(reached, *rest)
        progress.append([(reached[name] - before[name])[0] for name in ('row', 'done')])
        return result
    monkeypatch.setattr(layout, 'BUDGET', 1000)
    monkeypatch.setattr(kernels, 'run', recorded)
    cut = propagate(BODY, START, log, at=at)
    assert len(progress) > 1
    assert np.max(progress) <= 1000
    np.testing.assert_array_equal(cut.attitude, whole.attitude)
    np.testing.assert_array_equal(cut.angular_velocity, whole.angular_velocity)


def test_a_step_longer_than_what_is_left_of_int64_does_not_wrap():
    motion = propagate(RigidBody(np.eye(3)), State(0, angular_velocity=(0, 0, 1e-10)),
                       at=[9 * 10 ** 18])
    np.testing.assert_allclose(motion.attitude[0], [0, 0, np.sin(0.45), np.cos(0.45)], rtol=1e-14)


def test_norm_is_kept_over_many_loose_steps():
    times = EPOCH_NS + np.arange(0, 100_000, 1000) * SECOND
    for tolerance in (1e-3, 1e-15):
        motion = propagate(BODY, START, at=times, tolerance=tolerance)
        assert np.abs(np.linalg.norm(motion.attitude, axis=1) - 1.0).max() < 1e-15


@pytest.mark.parametrize('frame', ['body', 'space'])
@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
def test_a_torque_that_grows_from_nothing_starts_a_body_at_rest(interpolation, frame):
    # The first terms of the series vanish here; the smoother the torque, the more terms vanish.
    stamps = np.arange(0, 11) * SECOND
    seconds = np.arange(0.0, 11.0)
    body = RigidBody.from_moments(2.0, 3.0, 4.0)
    log = TorqueLog(stamps, np.outer(seconds ** 3, [0.0, 0.0, 0.01]), frame, interpolation)
    motion = propagate(body, State(), log, at=stamps)
    if interpolation == 'cubic':
        rate, angle = 0.01 * seconds ** 4 / 16.0, 0.01 * seconds ** 5 / 80.0
        np.testing.assert_allclose(motion.angular_velocity[:, 2], rate, rtol=0, atol=1e-14)
        assert chord(so3.exp(np.outer(angle, [0, 0, 1])), motion.attitude).max() < 2e-14
    assert motion.angular_velocity[-1, 2] > 5.0


def test_a_torque_is_zero_before_its_first_sample_and_counts_from_before_the_start():
    log = TorqueLog([EPOCH_NS + SECOND], [[1.0, 0.0, 0.0]])
    times = EPOCH_NS + np.arange(0, SECOND + 1, SECOND // 4)
    np.testing.assert_array_equal(propagate(BODY, START, log, at=times).attitude,
                                  propagate(BODY, START, at=times).attitude)
    early = TorqueLog([EPOCH_NS - 2, EPOCH_NS - 1], [[5.0, 0, 0], [1.0, 0.0, 0.0]])
    prompt = TorqueLog([EPOCH_NS], [[1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(*(propagate(BODY, START, log, at=times).attitude
                                    for log in (early, prompt)))


@pytest.mark.parametrize('interpolation', INTERPOLATIONS)
def test_torques_that_timed_out_before_the_start_do_not_act(interpolation):
    stamps, at = EPOCH_NS - np.array([20, 10]) * SECOND, [EPOCH_NS + SECOND]
    log = TorqueLog(stamps, np.eye(3)[:2], interpolation=interpolation)
    found, free = (propagate(BODY, START, each, at=at, torque_timeout=1.0) for each in (log, None))
    np.testing.assert_array_equal(found.attitude, free.attitude)


def test_timeout_is_a_zero_sample_at_its_end():
    stamps = EPOCH_NS + np.array([0, 1, 5]) * SECOND
    torques = np.array([[0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3]])
    times = EPOCH_NS + np.arange(0, 9) * SECOND
    cut = propagate(BODY, START, TorqueLog(stamps, torques), at=times, torque_timeout=1.5)
    ends = stamps[1:] + 3 * SECOND // 2
    explicit = TorqueLog([*stamps, *ends], [*torques, [0, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(cut.attitude,
                                  propagate(BODY, START, explicit, at=times).attitude)


class TestPropagator:

    def test_a_late_torque_is_put_in_its_place_and_one_too_late_is_dropped(self):
        propagator = Propagator(BODY, START, history=1.0)
        assert propagator.apply(EPOCH_NS + 5 * SECOND, [1, 0, 0])
        assert not propagator.apply(EPOCH_NS + 4 * SECOND, [0, 1, 0])
        assert propagator.apply(EPOCH_NS + 4 * SECOND + 1, [0, 1, 0])
        log = TorqueLog(EPOCH_NS + np.array([4 * SECOND + 1, 5 * SECOND]), [[0, 1, 0], [1, 0, 0]])
        end = EPOCH_NS + 9 * SECOND
        assert same(propagator.at(end), propagate(BODY, START, log, at=[end]), 0)

    def test_memory_does_not_grow_with_the_stream(self):
        propagator = Propagator(BODY, START, history=0.05)
        for number in range(2000):
            time_ns = EPOCH_NS + number * SECOND // 1000
            propagator.apply(time_ns, [0.1, 0.0, 0.1 * (number % 3)])
            propagator.at(time_ns + SECOND // 2000)
        assert len(propagator._history.changes) <= 52
        # What the newest torque made final is kept until the next torque.
        assert propagator.earliest_ns >= EPOCH_NS + 1948 * SECOND // 1000
        earliest = f'time_ns: expected {propagator.earliest_ns} ns or later, found'
        with pytest.raises(ValueError, match=earliest):
            propagator.at(EPOCH_NS)

    def test_an_open_segment_costs_only_what_is_new(self, monkeypatch):
        # A coast of an hour: each call continues from the previous state.
        spans, run = [], kernels.run

        def recorded(progress, *rest):
            before_ns = int(progress['grid_ns'][0])
            result = run(progress, *rest)
            spans.append(int(progress['grid_ns'][0]) - before_ns)
            return result
        monkeypatch.setattr(kernels, 'run', recorded)
        propagator = Propagator(BODY, START, solver='taylor', history=1.0)
        for number in range(0, 36_000, 15):
            propagator.at(EPOCH_NS + number * SECOND // 10)
        assert max(spans) < 3 * SECOND
        assert len(propagator._history.changes[0].motions[0].segment._grid_ns) < 20


def test_the_trajectory_says_what_answered_and_why():
    model, = propagate(BODY, START, at=[EPOCH_NS, EPOCH_NS + 5]).models
    assert model[:3] == ('taylor', EPOCH_NS, EPOCH_NS + 5)
    assert model.reason.startswith('auto: ')
    asked, = propagate(BODY, START, at=[EPOCH_NS + 5], solver='taylor').models
    assert asked == ('taylor', EPOCH_NS, EPOCH_NS + 5, 'as requested')


@pytest.mark.parametrize('timeout', [0.0, 2.0])
def test_the_trajectory_names_each_coast_that_was_taken_in_closed_form(timeout):
    # A torque at 0 s, and none from 2 s to 100 s (by one sample, or by the timeout and a sample).
    zero = 50 if timeout else 2
    stamps = EPOCH_NS + np.array([0, zero, zero + 1, 100, 101]) * SECOND
    log = TorqueLog(stamps, np.outer([1, 0, 0, 1, 1], [0.1, 0.2, 0.1]))
    motion = propagate(BODY, START, log, at=[stamps[-1]], torque_timeout=timeout)
    assert [(model.solver, (model.start_ns - EPOCH_NS) // SECOND) for model in motion.models] == [
        ('taylor', 0), ('exact', 2), ('taylor', 100)]
    assert motion.models[1].end_ns == stamps[3]
    assert 'asymmetric top' in motion.models[1].reason


def test_trajectories_give_euler_angles():
    motion = Reference('through_gimbal_lock').propagate()
    assert motion.degenerate().tolist() == [row % 8 == 0 for row in range(33)]
    np.testing.assert_allclose(np.abs(np.diff(motion.euler_angles(continuous=True)[:, 1])),
                               np.diff(motion.times_ns) * 1e-9, rtol=0, atol=1e-14)


def test_work_may_be_done_in_parts_and_gives_the_same_bits(monkeypatch):
    # A hundred thousand steps in one segment, followed by a hundred segments.
    monkeypatch.setattr(layout, 'BUDGET', 1000)
    whole, parts = (Propagator(BODY, START, history=100.0, max_step=1e-4) for _ in range(2))
    for propagator in (whole, parts):
        propagator.apply(EPOCH_NS, (0.01, 0.02, 0.03))
        for k in range(100):
            propagator.apply(EPOCH_NS + 10 * SECOND + k * SECOND // 1000, (1e-3 * k, 0.0, 1e-3))
    given_up = 0
    for time_ns in (EPOCH_NS + 10 * SECOND - 5, EPOCH_NS + 11 * SECOND):
        for _ in range(10_000):
            try:
                state = parts.at(time_ns, within=0.0)
                break
            except TimeoutError as error:
                assert 'of the motion: call again to continue from there' in str(error)
                given_up += 1
        expected = whole.at(time_ns)
        assert np.array_equal(state.attitude, expected.attitude)
        assert np.array_equal(state.angular_velocity, expected.angular_velocity)
    assert given_up > 150
