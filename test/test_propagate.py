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

"""The time loop: neither the requested times nor their order change a number."""

from conftest import chord, EPOCH_NS, Reference, SECOND
from hypothesis import given, settings, strategies
import numpy as np
import pytest
from rigid_body_ros import propagate, Propagator, RigidBody, State, TorqueLog
from rigid_body_ros.engine import kernels, layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.torque import INTERPOLATIONS
from rigid_body_ros.propagation import timeline
import truth

BODY = RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05)
START = State(EPOCH_NS, (0.1, -0.3, 0.2, 0.9), (0.5, -0.7, 0.9))
HISTORY_NS = SECOND


def random_log(seed, count=40, seconds=4.0):
    """Return stamps that begin before the start, torques (some zero or repeated) and frames."""
    random = np.random.default_rng(seed)
    offsets = random.choice(int(seconds * SECOND), count, replace=False)
    stamps = EPOCH_NS - SECOND // 2 + np.sort(offsets)
    torques = random.normal(size=(count, 3)) * (random.random((count, 1)) > 0.4)
    repeated = np.flatnonzero(random.random(count - 1) > 0.7) + 1
    for row in repeated:
        torques[row] = torques[row - 1]
    frames = np.where(random.random(count) > 0.5, 'space', 'body').tolist()
    return stamps, torques, frames


def same(state, motion, row):
    return (np.array_equal(state.attitude, motion.attitude[row])
            and np.array_equal(state.angular_velocity, motion.angular_velocity[row]))


@pytest.mark.slow
@settings(max_examples=60)
@given(seed=strategies.integers(0, 2 ** 32 - 1), timeout=strategies.sampled_from([0.0, 0.03, 0.4]))
def test_any_order_of_arrival_and_any_questions_give_the_states_of_the_log(seed, timeout):
    random = np.random.default_rng(seed)
    stamps, torques, frames = random_log(seed)
    after = stamps[stamps >= EPOCH_NS]
    motion = propagate(BODY, START, TorqueLog(stamps, torques, frames), at=after,
                       torque_timeout=timeout)
    propagator = Propagator(BODY, START, torque_timeout=timeout, history=HISTORY_NS * 1e-9)
    newest, states = EPOCH_NS, {}
    arrival = np.argsort(stamps + random.integers(0, HISTORY_NS, len(stamps)), kind='stable')
    for row in arrival:
        newest = max(newest, int(stamps[row]))
        # A torque that arrives now cannot change states that are older than `history`.
        for stamp in after[(after <= newest - HISTORY_NS)].tolist():
            if stamp not in states:
                states[stamp] = propagator.at(stamp)
        assert propagator.apply(int(stamps[row]), torques[row], frames[row])
        for asked in newest + random.integers(-HISTORY_NS, HISTORY_NS, random.integers(0, 4)):
            propagator.at(max(int(asked), propagator.earliest_ns))
    for row, stamp in enumerate(after.tolist()):
        assert same(states.get(stamp) or propagator.at(stamp), motion, row)


@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
def test_one_call_for_each_sample_gives_the_numbers_of_one_call_for_all(interpolation):
    stamps, torques, _ = random_log(1)
    log = TorqueLog(stamps, torques, interpolation=interpolation)
    times = EPOCH_NS + np.random.default_rng(2).integers(0, 5 * SECOND, 60)
    together = propagate(BODY, START, log, at=times)
    for row, time_ns in enumerate(times):
        alone = propagate(BODY, START, log, at=[time_ns])
        np.testing.assert_array_equal(alone.attitude[0], together.attitude[row])
        np.testing.assert_array_equal(alone.angular_velocity[0], together.angular_velocity[row])


@pytest.mark.parametrize('interpolation', ['linear', 'cubic'])
def test_a_log_longer_than_a_chunk_has_no_seam(monkeypatch, interpolation):
    stamps, torques, _ = random_log(3)
    log = TorqueLog(stamps, torques, interpolation=interpolation)
    whole = propagate(BODY, START, log, at=stamps[stamps >= EPOCH_NS], torque_timeout=0.05)
    for size in (1, 2, 7):
        monkeypatch.setattr(timeline, '_CHUNK', size)
        cut = propagate(BODY, START, log, at=whole.times_ns, torque_timeout=0.05)
        np.testing.assert_array_equal(cut.attitude, whole.attitude)


@pytest.mark.slow
@settings(max_examples=40)
@given(seed=strategies.integers(0, 2 ** 32 - 1), timeout=strategies.sampled_from([0.0, 0.05]),
       solver=strategies.sampled_from(['auto', 'taylor', 'rk4']))
def test_a_run_restarted_at_any_time_goes_on_bit_for_bit(seed, timeout, solver):
    random = np.random.default_rng(seed)
    stamps, torques, frames = random_log(seed, count=12, seconds=60.0)
    torques *= 0.1  # or the body would spin too fast for rk4 after 60 s
    options = {'solver': solver, 'torque_timeout': timeout, 'max_step': 0.1}
    whole = Propagator(BODY, START, history=100.0, **options)
    for stamp, torque, frame in zip(stamps.tolist(), torques, frames):
        whole.apply(stamp, torque, frame)
    middle = whole.at(int(random.integers(EPOCH_NS, stamps[-1] + SECOND)))
    for _ in range(random.integers(0, 3)):  # a restarted motion may be restarted again
        middle = whole.at(int(middle.time_ns + random.integers(0, SECOND)))
    since = max(np.searchsorted(stamps, middle.time_ns, side='right') - 1, 0)
    resumed = Propagator(BODY, middle, history=100.0, **options)
    for stamp, torque, frame in list(zip(stamps.tolist(), torques, frames))[since:]:
        resumed.apply(stamp, torque, frame)
    log = TorqueLog(stamps[since:], torques[since:], frames[since:])
    times = middle.time_ns + random.integers(0, 90 * SECOND, 20)
    replayed = propagate(BODY, middle, log, at=times, **options)
    for row, time_ns in enumerate(times.tolist()):
        assert same(whole.at(time_ns), replayed, row)
        assert same(resumed.at(time_ns), replayed, row)


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


@settings(max_examples=40)
@given(seed=strategies.integers(0, 2 ** 32 - 1), tolerance=strategies.sampled_from([1e-15, 1e-6]),
       max_step=strategies.sampled_from([None, 2e-4, 1e-3, 5e-3]))
def test_questions_change_nothing_at_any_tolerance_and_step(seed, tolerance, max_step):
    random = np.random.default_rng(seed)
    options = {'tolerance': tolerance, 'max_step': max_step}
    start = State(0, so3.normalize(random.normal(size=4)), random.normal(size=3) * 10)
    stamps = np.arange(0, 10) * (SECOND // 1000)
    torques = random.normal(size=(10, 3))
    motion = propagate(BODY, start, TorqueLog(stamps, torques), at=stamps, **options)
    propagator = Propagator(BODY, start, history=1.0, **options)
    for stamp, torque in zip(stamps.tolist(), torques):
        for asked in random.integers(max(0, stamp - 10 ** 6), stamp + 3 * 10 ** 6, 3).tolist():
            propagator.at(asked)
        propagator.apply(stamp, torque)
    for row, stamp in enumerate(stamps.tolist()):
        assert same(propagator.at(stamp), motion, row)


def test_zero_samples_change_no_bit_of_a_coast():
    times = EPOCH_NS + np.arange(0, 60 * SECOND, SECOND // 10)
    free = propagate(BODY, START, at=times)
    stamps = EPOCH_NS + np.arange(0, 60 * SECOND, SECOND // 1000)
    sampled = propagate(BODY, START, TorqueLog(stamps, np.zeros((len(stamps), 3))), at=times)
    np.testing.assert_array_equal(sampled.attitude, free.attitude)
    np.testing.assert_array_equal(sampled.angular_velocity, free.angular_velocity)


def test_splitting_a_held_torque_changes_rounding_only():
    times = EPOCH_NS + np.arange(1, 11) * SECOND
    once = propagate(BODY, START, TorqueLog([EPOCH_NS], [[0.1, 0.2, -0.1]]), at=times)
    stamps = EPOCH_NS + np.arange(0, 10 * SECOND, 7_654_321)
    split = propagate(BODY, START, TorqueLog(stamps, np.tile([0.1, 0.2, -0.1], (len(stamps), 1))),
                      at=times)
    assert chord(once.attitude, split.attitude).max() < 1e-15 * (10 + 20)


def test_body_and_space_torque_agree_on_a_body_that_does_not_turn_away():
    # Along a principal axis that is fixed in space, both are the same torque.
    body = RigidBody.from_moments(1.0, 2.0, 2.5)
    start = State(0, angular_velocity=(0.0, 0.0, 1.0))
    ends = [propagate(body, start, TorqueLog([0], [[0.0, 0.0, 0.3]], frame), at=[20 * SECOND])
            for frame in ('body', 'space')]
    assert chord(ends[0].attitude, ends[1].attitude).max() < 1e-15 * (10 + 80)


def test_space_torque_adds_to_the_space_momentum():
    torque = np.array([0.02, -0.05, 0.03])
    times = EPOCH_NS + np.arange(0, 101) * SECOND
    motion = propagate(BODY, START, TorqueLog([EPOCH_NS], [torque], 'space'), at=times)
    expected = motion.angular_momentum_space[0] + np.outer((times - EPOCH_NS) * 1e-9, torque)
    scale = np.linalg.norm(expected, axis=1).max()
    assert np.abs(motion.angular_momentum_space - expected).max() < 1e-14 * scale


@pytest.mark.parametrize('interpolation', ['linear', 'cubic'])
def test_interpolated_space_torque_adds_its_integral_to_the_momentum(interpolation):
    # Both interpolations are exact for a straight line, whose integral is a parabola.
    stamps = EPOCH_NS + np.cumsum(np.random.default_rng(5).integers(SECOND // 50, SECOND, 30))
    seconds = (stamps - EPOCH_NS) * 1e-9
    slope = np.array([0.01, 0.02, -0.015])
    log = TorqueLog(stamps, np.outer(seconds, slope), 'space', interpolation)
    motion = propagate(BODY, START, log, at=stamps)
    momentum = motion.angular_momentum_space
    expected = momentum[0] + np.outer(0.5 * (seconds ** 2 - seconds[0] ** 2), slope)
    assert np.abs(momentum - expected).max() < 1e-14 * np.linalg.norm(expected, axis=1).max()


def test_free_motion_keeps_momentum_and_energy():
    motion = propagate(BODY, START, at=EPOCH_NS + np.arange(0, 1000, 10) * SECOND)
    momentum, energy = motion.angular_momentum_space, motion.kinetic_energy
    assert np.abs(momentum - momentum[0]).max() < 1e-15 * 1000 * np.linalg.norm(momentum[0])
    assert np.abs(energy / energy[0] - 1.0).max() < 1e-14


def test_turned_space_axes_give_the_turned_motion():
    turn = so3.normalize([0.3, -0.1, 0.7, 0.4])
    stamps, torques, _ = random_log(6)
    stamps = stamps[stamps >= EPOCH_NS]
    torques = torques[:len(stamps)]
    turned = State(EPOCH_NS, so3.multiply(turn, START.attitude), START.angular_velocity)
    there = propagate(BODY, turned, TorqueLog(stamps, so3.rotate(turn, torques), 'space'),
                      at=stamps)
    here = propagate(BODY, START, TorqueLog(stamps, torques, 'space'), at=stamps)
    assert chord(so3.multiply(turn, here.attitude), there.attitude).max() < 3e-15


def test_renamed_axes_give_the_renamed_motion():
    cycle = so3.normalize([1.0, 1.0, 1.0, 1.0])  # x to y to z to x
    body = RigidBody(so3.matrix(cycle) @ BODY.inertia @ so3.matrix(cycle).T)
    start = State(EPOCH_NS, so3.multiply(START.attitude, so3.conjugate(cycle)),
                  so3.rotate(cycle, START.angular_velocity))
    times = EPOCH_NS + np.arange(0, 30) * SECOND
    renamed = propagate(body, start, at=times).attitude
    assert chord(so3.multiply(renamed, cycle), propagate(BODY, START, at=times).attitude
                 ).max() < 1e-15 * (10 + 40)


def test_attitude_is_the_continuous_lift():
    body = RigidBody.from_moments(1.0, 2.0, 2.5)
    turn = round(2 * np.pi * 1e9)
    motion = propagate(body, State(0, angular_velocity=(0, 0, 1.0)), at=[0, turn, 2 * turn])
    np.testing.assert_allclose(motion.attitude[:, 3], [1.0, -1.0, 1.0], rtol=1e-15)
    fine = propagate(BODY, START, at=EPOCH_NS + np.arange(0, 100 * SECOND, SECOND // 10))
    assert np.sum(fine.attitude[1:] * fine.attitude[:-1], axis=1).min() > 0.9


@pytest.mark.parametrize('budget', [1, 2, 5])
def test_a_kernel_that_returns_midway_goes_on_with_the_same_bits(monkeypatch, budget):
    stamps, torques, frames = random_log(8)
    log = TorqueLog(stamps, torques, frames)
    times = EPOCH_NS + np.arange(0, 30 * SECOND, SECOND // 3)
    whole = propagate(BODY, START, log, at=times)
    monkeypatch.setattr(layout, 'BUDGET', budget)
    np.testing.assert_array_equal(propagate(BODY, START, log, at=times).attitude, whole.attitude)
    propagator = Propagator(BODY, START, history=100.0)
    for stamp, torque, frame in zip(stamps.tolist(), torques, frames):
        propagator.apply(stamp, torque, frame)
    assert same(propagator.at(int(times[-1])), whole, -1)


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


def test_a_body_at_rest_stays_for_a_day_and_for_thirty_years():
    times = [0, 86400 * SECOND, 30 * 365 * 86400 * SECOND]
    motion = propagate(BODY, State(), at=times)
    np.testing.assert_array_equal(motion.attitude, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))


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
        np.testing.assert_allclose(motion.angular_velocity[:, 2], rate, atol=1e-14)
        assert chord(so3.exp(np.outer(angle, [0, 0, 1])), motion.attitude).max() < 2e-14
    assert motion.angular_velocity[-1, 2] > 5.0


def test_torque_before_the_first_sample_is_zero():
    log = TorqueLog([EPOCH_NS + SECOND], [[1.0, 0.0, 0.0]])
    times = EPOCH_NS + np.arange(0, SECOND + 1, SECOND // 4)
    np.testing.assert_array_equal(propagate(BODY, START, log, at=times).attitude,
                                  propagate(BODY, START, at=times).attitude)


def test_the_torque_in_force_at_the_start_counts():
    early = TorqueLog([EPOCH_NS - 2, EPOCH_NS - 1], [[5.0, 0, 0], [1.0, 0.0, 0.0]])
    prompt = TorqueLog([EPOCH_NS], [[1.0, 0.0, 0.0]])
    ends = [propagate(BODY, START, log, at=[EPOCH_NS + SECOND]) for log in (early, prompt)]
    np.testing.assert_array_equal(ends[0].attitude, ends[1].attitude)


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


def test_a_looser_tolerance_is_kept():
    reference = Reference('torque_free_asymmetric')
    phase = reference.phase()
    for tolerance in (1e-4, 1e-6, 1e-9, 1e-12):
        apart = chord(reference.attitude, reference.propagate(tolerance=tolerance).attitude)
        assert np.all(apart <= tolerance * (10.0 + phase))
        assert apart.max() > 1e-5 * tolerance  # a looser tolerance does save work


def test_a_smaller_step_changes_rounding_only():
    reference = Reference('constant_space_torque')
    fine = reference.propagate(max_step=0.01)
    assert chord(fine.attitude, reference.propagate().attitude).max() < 2e-14


class TestPropagator:

    def test_a_late_torque_is_put_in_its_place_and_one_too_late_is_dropped(self):
        propagator = Propagator(BODY, START, history=1.0)
        assert propagator.apply(EPOCH_NS + 5 * SECOND, [1, 0, 0])
        assert not propagator.apply(EPOCH_NS + 4 * SECOND, [0, 1, 0])
        assert propagator.apply(EPOCH_NS + 4 * SECOND + 1, [0, 1, 0])
        log = TorqueLog(EPOCH_NS + np.array([4 * SECOND + 1, 5 * SECOND]), [[0, 1, 0], [1, 0, 0]])
        end = EPOCH_NS + 9 * SECOND
        assert same(propagator.at(end), propagate(BODY, START, log, at=[end]), 0)

    @pytest.mark.parametrize('history', [0.0, 1.0])
    def test_of_equal_stamps_the_last_to_come_counts(self, history):
        propagator = Propagator(BODY, START, history=history)
        for torque in ([9, 9, 9], [0, 0, 0], [0, 0.5, 0]):
            assert propagator.apply(EPOCH_NS + SECOND, torque)
            propagator.at(EPOCH_NS + 2 * SECOND)
        log = TorqueLog([EPOCH_NS + SECOND], [[0, 0.5, 0]])
        end = EPOCH_NS + 3 * SECOND
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

    @pytest.mark.slow
    def test_an_open_segment_costs_only_what_is_new(self, monkeypatch):
        # A coast of an hour, requested at 10 Hz: each call continues from the previous state.
        spans, run = [], kernels.run

        def recorded(progress, *rest):
            before_ns = int(progress['grid_ns'][0])
            result = run(progress, *rest)
            spans.append(int(progress['grid_ns'][0]) - before_ns)
            return result
        monkeypatch.setattr(kernels, 'run', recorded)
        propagator = Propagator(BODY, START, solver='taylor', history=1.0)
        for number in range(0, 36_000, 3):
            propagator.at(EPOCH_NS + number * SECOND // 10)
        assert max(spans) < 2 * SECOND
        assert len(propagator._history.changes[0].motions[0].segment._grid_ns) < 20


@pytest.mark.parametrize(('arguments', 'message'), [
    ({'at': [EPOCH_NS - 1]},
     rf'at: expected no time before the start \({EPOCH_NS} ns\), found {EPOCH_NS - 1} ns'),
    ({'at': [0.5]}, 'at: expected integer nanoseconds'),
    ({'at': [True]}, 'at: expected integer nanoseconds'),
    ({'at': np.array([2 ** 63], np.uint64)}, f'at: .* int64 nanoseconds, found {2 ** 63}'),
    ({'solver': 'euler'}, "solver: expected one of auto, taylor, exact, .* found 'euler'"),
    ({'tolerance': 1e-16}, 'tolerance: .* 1e-15 to 1, found 1e-16'),
    ({'max_step': 0.0}, 'max_step: expected seconds greater than zero, found 0'),
    ({'torque_timeout': -1.0}, r'torque_timeout: expected seconds from 0 to 1e\+09, found -1'),
    ({'torque_timeout': 1e10}, r'torque_timeout: expected seconds from 0 to 1e\+09, found 1'),
    ({'at': [2 ** 63 - 1]}, f'at: expected times before {2 ** 63 - 1} ns, found {2 ** 63 - 1}')])
def test_impossible_requests_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        propagate(BODY, START, **{'at': [EPOCH_NS], **arguments})


@pytest.mark.parametrize(('arguments', 'message'), [
    ((2 ** 70, [1, 2, 3]), 'expected a time in int64 nanoseconds'),
    ((np.uint64(2 ** 63), [1, 2, 3]), 'expected a time in int64 nanoseconds'),
    ((0, [1, 2]), 'expected 3 finite numbers, found'), ((0, [1, 2, np.inf]), 'torque at 0 ns'),
    ((0, [1, 2, 3], 'map'), "'body' or 'space', found 'map'")])
def test_impossible_torques_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Propagator(BODY, State()).apply(*arguments)


@pytest.mark.parametrize('time_ns', [1.5, np.float64(3.0), True, np.True_, '3', None], ids=repr)
def test_a_time_that_is_not_an_integer_is_refused(time_ns):
    propagator = Propagator(BODY, State())
    for call in (State, propagator.at, lambda time_ns: propagator.apply(time_ns, [1, 2, 3])):
        with pytest.raises(TypeError):
            call(time_ns)


@pytest.mark.parametrize('time_ns', [2 ** 63, -2 ** 63, np.uint64(2 ** 63 + 5)])
def test_a_time_beyond_int64_is_refused(time_ns):
    propagator = Propagator(BODY, State())
    for call in (State, propagator.at, lambda time_ns: propagator.apply(time_ns, [1, 2, 3])):
        with pytest.raises(ValueError, match='expected a time in int64 nanoseconds, found'):
            call(time_ns)


def test_a_time_as_far_from_the_start_as_no_int64_can_tell_is_refused():
    start, late = State(-2 ** 62 - 2), 2 ** 62
    propagator = Propagator(BODY, start)
    for call in (lambda: propagate(BODY, start, at=[late]), lambda: propagator.at(late),
                 lambda: propagator.apply(late, [1, 2, 3])):
        with pytest.raises(ValueError, match='within 292 years of the start'):
            call()


@pytest.mark.slow
@pytest.mark.parametrize('torque', [1e12, 1e100, 1e308])
def test_a_motion_that_no_step_resolves_is_refused_not_returned(torque):
    log = TorqueLog([EPOCH_NS], [[torque, 0.0, 0.0]])
    with np.errstate(all='ignore'), pytest.raises(ValueError, match=r'faster than 1e\+09 rad/s'):
        propagate(BODY, START, log, at=[EPOCH_NS + SECOND])
    propagator = Propagator(BODY, START)
    propagator.apply(EPOCH_NS + 1, [torque, 0.0, 0.0])
    assert propagator.at(EPOCH_NS + 1).time_ns == EPOCH_NS + 1
    with np.errstate(all='ignore'), pytest.raises(ValueError, match=r'faster than 1e\+09 rad/s'):
        propagator.at(EPOCH_NS + SECOND)


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


@pytest.mark.parametrize('seconds', [1, 10, 25, 60, 3600])
def test_auto_is_no_less_accurate_than_the_series(seconds):
    start = State(EPOCH_NS, (0.0, 0.0, 0.0, 1.0), (0.5, -0.75, 0.875))
    body = RigidBody.from_moments(1.0, 2.0, 2.5)
    span_ns = seconds * SECOND
    q, _ = truth.free(body.inertia.tolist(), start.attitude.tolist(),
                      start.angular_velocity.tolist(), span_ns)
    errors = {solver: truth.chord(q, propagate(body, start, at=[EPOCH_NS + span_ns],
                                               solver=solver).attitude[0].tolist())
              for solver in ('auto', 'taylor')}
    assert errors['auto'] <= errors['taylor'] + 1e-15


def test_trajectories_give_euler_angles():
    motion = Reference('through_gimbal_lock').propagate()
    assert motion.degenerate().tolist() == [row % 8 == 0 for row in range(33)]
    np.testing.assert_allclose(np.abs(np.diff(motion.euler_angles(continuous=True)[:, 1])),
                               np.diff(motion.times_ns) * 1e-9, atol=1e-14)


@pytest.mark.slow
def test_work_may_be_done_in_parts_and_gives_the_same_bits():
    # A million steps in one segment, followed by a thousand segments.
    torques = [(EPOCH_NS + 10 * SECOND + k * SECOND // 1000, (1e-3 * k, 0.0, 1e-3))
               for k in range(1000)]
    whole, parts = (Propagator(BODY, START, history=100.0, max_step=1e-5) for _ in range(2))
    for propagator in (whole, parts):
        propagator.apply(EPOCH_NS, (0.01, 0.02, 0.03))
        for stamp_ns, torque in torques:
            propagator.apply(stamp_ns, torque)
    given_up = 0
    for time_ns in (EPOCH_NS + 10 * SECOND - 5, EPOCH_NS + 12 * SECOND):
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
    assert given_up > 1000
