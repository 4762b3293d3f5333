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

"""Actuators: the torques that act, to rounding, and the same bits in any order of arrival."""

import re

from conftest import at_night
import mpmath
import numpy as np
import pytest
from rigid_body_ros import (
    Actuator,
    compare,
    Measured,
    messages,
    Problem,
    propagate,
    Propagator,
    read,
    recording,
    RigidBody,
    State,
    TorqueLog,
)
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.ensemble.dispersions import Dispersion
from rigid_body_ros.ensemble.runs import Ensemble
from rigid_body_ros.replay import replay
from rigid_body_ros.scene import load
from rigid_body_ros.tradeoff.problem import Case
import terms

SECOND = 10 ** 9
BODY = RigidBody([[2.0, 0.1, -0.2], [0.1, 3.0, 0.05], [-0.2, 0.05, 4.0]])
START = State(0, (0.1, -0.3, 0.2, 0.9), (0.3, 0.5, -0.2))


def of_source(given):
    """Return the log and the actuator of a source in a file of the truth."""
    rows = given['t_ns_x_y_z']
    log = TorqueLog([row[0] for row in rows], [row[1:] for row in rows], given['frame'])
    found = given.get('actuator')
    return log, found and Actuator(found['delay'], found['time_constant'], found['limit'])


@pytest.mark.parametrize('solver', ['auto', 'taylor'])
@pytest.mark.parametrize('name', ['actuator_lag', 'actuator_delay_limit'])
def test_motions_agree_with_fifty_digits(name, solver, fifty_digits):
    body, start, values = terms.reference(name)
    logs, actuators = zip(*map(of_source, values['sources']))
    terms.assert_agrees(Problem(body, start, logs, actuator=actuators, solver=solver), values)


ACTUATORS = {
    'delay': Actuator(0.07), 'limit': Actuator(limit=(0.8, 0.0, 0.3)), 'lag': Actuator(0.0, 0.08),
    'short': Actuator(0.013, 2e-4, (0.8, 0.5, 0.3)), 'long': Actuator(0.013, 30.0),
    'each': (Actuator(0.05, 0.02), None, Actuator(0.02, 0.1, (1.0, 1.0, 0.0))),
    'same': (Actuator(0.05, 0.02), Actuator(0.0, 0.02), None)}


def commands(rng):
    """Return three logs: with repeated zeros, with long gaps, and in both body and space axes."""
    stamps = np.arange(-3, 57) * 50_000_000
    zeros = rng.normal(size=(60, 3)) * (rng.random(60) < 0.5)[:, None]
    silent = np.sort(rng.choice(stamps, 20, replace=False))
    return [TorqueLog(stamps, zeros), TorqueLog(silent + 12_345, rng.normal(size=(20, 3))),
            TorqueLog(stamps[::3], rng.normal(size=(20, 3)), rng.random(20) < 0.5)]


def same(one, other):
    """Return whether two motions have the same bits."""
    return (np.array_equal(one.attitude, other.attitude)
            and np.array_equal(one.angular_velocity, other.angular_velocity))


@pytest.mark.slow
@pytest.mark.parametrize('timeout', [0.3, *at_night(0.0, 0.04)])
@pytest.mark.parametrize('name', ACTUATORS)
def test_any_order_of_arrival_gives_the_bits_of_the_whole_log(name, timeout):
    rng = np.random.default_rng(5)
    logs, options = commands(rng), {'actuator': ACTUATORS[name], 'torque_timeout': timeout}
    times_ns = np.unique(np.concatenate(
        [rng.integers(0, 3 * SECOND, 40), *(log.times_ns[log.times_ns > 0] for log in logs)]))
    expected = propagate(BODY, START, logs, at=times_ns, **options)
    sent = [(int(stamp), torque, 'space' if in_space else 'body', source)
            for source, log in enumerate(logs)
            for stamp, torque, in_space in zip(log.times_ns, log.torques, log.in_space)]
    for _ in range(3):
        propagator = Propagator(BODY, START, history=10.0, **options)
        for k in rng.permutation(len(sent)):
            stamp, torque, frame, source = sent[k]
            propagator.apply(stamp, torque + rng.normal(), frame, source)  # replaced
            assert propagator.apply(*sent[k])
            propagator.at(int(rng.integers(0, 3 * SECOND)))
        states = [propagator.at(int(time_ns)) for time_ns in times_ns]
        assert all(np.array_equal(state.attitude, attitude) and np.array_equal(
            state.angular_velocity, rates) for state, attitude, rates in zip(
                states, expected.attitude, expected.angular_velocity))
        assert propagator.stamps(0, 3 * SECOND) == sorted(
            {stamp for stamp, *_ in sent if stamp > 0})


@pytest.mark.parametrize('name', ACTUATORS)
def test_a_restart_under_the_whole_log_goes_on_with_the_same_bits(name):
    rng = np.random.default_rng(6)
    logs, options = commands(rng), {'actuator': ACTUATORS[name], 'torque_timeout': 0.3}
    propagator = Propagator(BODY, START, history=10.0, **options)
    for source, log in enumerate(logs):
        for stamp, torque, in_space in zip(log.times_ns, log.torques, log.in_space):
            propagator.apply(int(stamp), torque, 'space' if in_space else 'body', source)
    times_ns = np.linspace(0, 3 * SECOND, 50).astype(np.int64)
    expected = propagate(BODY, START, logs, at=times_ns, **options)
    for begin_ns in [*rng.integers(0, 3 * SECOND, 10).tolist(), *logs[0].times_ns[9:12].tolist()]:
        start, later = propagator.at(begin_ns), times_ns >= begin_ns
        motion = propagate(BODY, start, logs, at=times_ns[later], **options)
        assert np.array_equal(motion.attitude, expected.attitude[later])
        assert np.array_equal(motion.angular_velocity, expected.angular_velocity[later])


SCENE = """
/**:
  ros__parameters:
    inertia: {ixx: 2.0, iyy: 3.0, izz: 4.0, ixy: 0.1}
    initial_angular_velocity: {x: 0.3, y: 0.5}
    torque_topics: [thrust, drag]
    start_time: 1000000000
"""
ACTUATOR = """
    actuator: {topics: [/thrust], delay: 0.05, time_constant: 0.2, limit: {x: 0.1, z: 0.3}}
"""


@pytest.fixture
def recorded(tmp_path):
    """Return a recording of two topics, its scene with an actuator, and the two logs."""
    rng, path = np.random.default_rng(7), tmp_path / 'run.mcap'
    stamps = SECOND + np.arange(60) * 50_000_000
    logs = [TorqueLog(stamps, torques) for torques in rng.normal(size=(2, 60, 3))]
    with recording.Writer(path) as writer:
        for topic, log in zip(('/thrust', '/drag'), logs):
            writer.add_topic(topic, messages.WRENCH)
            for stamp, torque in zip(log.times_ns.tolist(), log.torques):
                writer.write(topic, stamp, messages.wrench(stamp, 'base_link', torque))
    scene = tmp_path / 'scene.yaml'
    scene.write_text(SCENE + ACTUATOR)
    return path, scene, logs


@pytest.mark.parametrize('interpolation', ['hold', 'cubic'])
def test_a_replay_applies_the_actuator_of_the_scene_to_its_topics(recorded, interpolation):
    path, scene, (thrust, drag) = recorded
    result = replay(path, load(scene), interpolation=interpolation, keep=True)
    drag = TorqueLog(drag.times_ns, drag.torques, interpolation=interpolation)
    run = load(scene)
    expected = Problem(run.body, run.start, [thrust, drag], actuator=[
        Actuator(0.05, 0.2, (0.1, 0.0, 0.3)), None]).propagate(at=result.trajectory.times_ns)
    assert same(result.trajectory, expected)
    assert not same(expected, propagate(run.body, run.start, [thrust, drag],
                                        at=result.trajectory.times_ns))
    # The check integrates the torques that act, not the commands.
    assert float(re.search(r'differ by (\S+)', str(result.check))[1]) < 1e-9
    assert same(read(path, scene, interpolation=interpolation).propagate(
        at=result.trajectory.times_ns), expected)


def test_a_replay_without_memory_of_the_motion_writes_the_same(recorded, tmp_path):
    path, scene, _ = recorded
    kept = replay(path, load(scene), keep=True)
    replay(path, load(scene), tmp_path / 'motion.mcap')
    written = recording.read(tmp_path / 'motion.mcap', '/attitude', messages.QUATERNION)
    np.testing.assert_array_equal(written.values, kept.trajectory.attitude)


def test_a_start_between_two_commands_does_not_change_the_lag(recorded):
    path, scene, _ = recorded
    run = load(scene)
    topics = recording.Topics().found_in(path, run)
    (whole,), (later,) = (
        recording.read_epochs(path, run, recording.Reading(topics=topics, start=start))
        for start in (0.0, 0.512))
    times_ns = later.problem.start.time_ns + np.arange(50) * 10_000_000
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (50, 1))
    torques = whole.problem.torque(times_ns, attitude)
    assert np.abs(torques - sum(log.at(times_ns)[0] for log in whole.problem.acting_logs)
                  ).max() > 1e-3
    np.testing.assert_array_equal(later.problem.torque(times_ns, attitude), torques)


def test_the_topics_of_an_actuator_may_be_named_in_any_order(recorded):
    path, scene, _ = recorded
    one = read(path, scene, topic=['/drag', '/thrust'])
    assert [each and each.delay for each in one.actuators] == [None, 0.05]
    assert read(path, scene, topic='/drag').actuators == ()


@pytest.mark.parametrize(('line', 'words'), [
    ('actuator: {topics: [wind]}', 'actuator.topics: expected topics among torque_topics '
     "(thrust, drag), found 'wind'"),
    ('actuator: {topics: [thrust, /thrust]}', 'actuator.topics: expected each topic once, found '
     "'/thrust' twice"),
    ('actuator: {delay: 0.1}', 'actuator.topics: expected at least one topic, because '
     'actuator.delay is 0.1, found an empty list'),
    ('actuator: {topics: [drag], time_constant: 1.0e-12}', 'actuator.time_constant: '
     'time_constant of an actuator: expected 0 or 1e-09 to 1e+09 s, found 1e-12')])
def test_a_scene_with_an_impossible_actuator_is_an_error(tmp_path, line, words):
    (tmp_path / 'scene.yaml').write_text(f'{SCENE}    {line}\n')
    with pytest.raises(InputError, match=re.escape(words)):
        load(tmp_path / 'scene.yaml')


@pytest.mark.parametrize(('arguments', 'words'), [
    ({'delay': -1.0}, 'delay of an actuator: expected seconds from 0 to 1e+09, found -1.0'),
    ({'time_constant': np.nan}, 'time_constant of an actuator: expected 0 or 1e-09 to 1e+09 s, '
     'found nan'),
    ({'limit': (1.0, -1.0, 0.0)}, 'limit of an actuator: expected 3 finite numbers from 0 on'),
    ({'limit': 1.0}, 'limit of an actuator: expected 3 finite numbers from 0 on, found 1.0')])
def test_an_impossible_actuator_is_an_error(arguments, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        Actuator(**arguments)


def test_what_does_not_fit_the_sources_is_an_error():
    log, linear = TorqueLog([0], [[1, 0, 0]]), TorqueLog([0], [[1, 0, 0]], interpolation='linear')
    with pytest.raises(ValueError, match='expected commands that are held'):
        Problem(BODY, START, linear, actuator=Actuator(0.1))
    with pytest.raises(ValueError, match='expected 2, one or None for each source, found 1'):
        Problem(BODY, START, [log, log], actuator=[Actuator(0.1)])
    with pytest.raises(ValueError, match='at most 4 different time constants, found 5'):
        Problem(BODY, START, [log] * 5, actuator=[
            Actuator(0.0, k) for k in range(1, 6)]).propagate(at=[SECOND])
    propagator = Propagator(BODY, START, actuator=[Actuator(0.1), None])
    with pytest.raises(ValueError, match='expected a number from 0 to 1'):
        propagator.apply(0, (1, 0, 0), source=2)


@pytest.mark.slow
def test_outputs_do_not_accumulate_errors():
    # A thousand commands within a time constant, compared with the sum in exact fractions.
    rng, count, lag = np.random.default_rng(8), 3000, 1.0
    commands = rng.normal(size=(count, 3)) + 1.0
    log = TorqueLog(np.arange(count) * 1_000_000, commands)
    problem = Problem(BODY, State(0), log, actuator=Actuator(0.0, lag))
    found = problem.torque(np.array([count * 1_000_000]), np.array([[0.0, 0.0, 0.0, 1.0]]))[0]
    with mpmath.workdps(40):
        decay = mpmath.exp(-mpmath.mpf(1) / 1000)
        exact = [mpmath.fsum((1 - decay) * decay ** (count - 1 - k) * mpmath.mpf(float(u))
                             for k, u in enumerate(column)) for column in commands.T]
        errors = [float(abs(mpmath.mpf(float(one)) - other)) for one, other in zip(found, exact)]
    assert max(errors) < 4e-16


def test_a_part_of_a_motion_begins_with_what_the_actuator_has_reached():
    rng = np.random.default_rng(9)
    log = TorqueLog(np.arange(200) * 20_000_000, rng.normal(size=(200, 3)))
    problem = Problem(BODY, START, log, actuator=Actuator(0.03, 0.1))
    times_ns = np.array([2 * SECOND, 3 * SECOND])
    motion = problem.propagate(at=times_ns)
    middle = State(int(times_ns[0]), motion.attitude[0], motion.angular_velocity[0])
    part = problem.between(middle, int(times_ns[1]))
    assert len(part.logs[0]) < 200
    end = part.propagate(at=times_ns[1:])
    np.testing.assert_allclose(end.attitude[0], motion.attitude[1], rtol=0.0, atol=1e-14)
    attitude = np.array([[0.0, 0.0, 0.0, 1.0]] * 2)
    np.testing.assert_allclose(part.torque(times_ns, attitude), problem.torque(times_ns, attitude),
                               rtol=1e-13)


def test_the_actuator_of_every_log_is_that_of_other_logs_too():
    logs = commands(np.random.default_rng(13))
    problem = Problem(BODY, START, logs[0], actuator=Actuator(0.03, 0.1))
    assert same(problem.replaced(log=logs).propagate(at=[SECOND]),
                propagate(BODY, START, logs, at=[SECOND], actuator=Actuator(0.03, 0.1)))


def test_a_torque_of_the_actuators_is_what_the_residual_is_measured_against():
    rng = np.random.default_rng(10)
    log = TorqueLog(np.arange(60) * 50_000_000, rng.normal(size=(60, 3)), rng.random(60) < 0.5)
    problem = Problem(BODY, START, log, actuator=Actuator(0.03, 0.07, (0.9, 0.9, 0.0)))
    times_ns = np.arange(300) * 10_000_000
    motion = problem.propagate(at=times_ns)
    measured = Measured('pose', times_ns, motion.attitude, motion.angular_velocity)
    found, ideal = (compare(BODY, START, log, measured=measured, actuator=actuator, causes=False,
                            horizons=[0.5]) for actuator in (problem.actuators, None))
    assert found.horizons[0].angles.max() < 1e-9
    assert ideal.horizons[0].angles.max() > 1e-3
    residual, missed = (np.linalg.norm(each.residual_torque.torques, axis=1).mean()
                        for each in (found, ideal))
    assert residual < 1e-3 * missed


def test_limits_are_those_of_the_axes_of_the_body_in_principal_axes_too():
    log = TorqueLog(np.arange(60) * 50_000_000, np.random.default_rng(11).normal(size=(60, 3)))
    problem = Problem(BODY, START, log, actuator=Actuator(0.03, 0.07, (0.9, 0.4, 0.0)))
    case = Case(problem, log.times_ns)
    np.testing.assert_allclose(case.in_principal_axes(0.01),
                               problem.propagate(at=log.times_ns).attitude, rtol=0, atol=1e-14)


def test_each_run_of_an_ensemble_is_the_motion_under_the_actuator():
    log = TorqueLog(np.arange(60) * 50_000_000, np.random.default_rng(12).normal(size=(60, 3)))
    problem = Problem(BODY, START, log, actuator=Actuator(0.03, 0.07))
    ensemble = Ensemble(problem, 3 * SECOND, tuple(
        Dispersion(key, 'normal', (0.1,)) for key in ('torque_gain', 'torque_bias.x')), 1)
    runs = ensemble.rows(0, 3)
    for k, gain in enumerate(runs['torque_gain']):
        one = problem.replaced(log=log.with_torques(gain * log.torques)).biased(
            np.array([runs['torque_bias.x'][k], 0.0, 0.0]), 3 * SECOND)
        assert [runs[f'attitude.{axis}'][k] for axis in 'xyzw'] == one.propagate(
            at=[3 * SECOND]).attitude[0].tolist()


@pytest.mark.parametrize('actuator', [Actuator(0.1, 0.2), (Actuator(0.1, 0.2), None)])
def test_a_constant_torque_without_commands_has_no_actuator(actuator):
    found, expected = (Problem(BODY, START, **given).biased(np.array([1e-3, 0.0, 0.0]), SECOND)
                       for given in ({'actuator': actuator}, {}))
    np.testing.assert_array_equal(found.propagate(at=[SECOND]).attitude,
                                  expected.propagate(at=[SECOND]).attitude)
