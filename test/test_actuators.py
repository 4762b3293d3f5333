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

"""Actuators: the torques that act, in scenes, replays, comparisons and ensembles."""

import re

import mpmath
import numpy as np
from numpy.testing import assert_array_equal
from parts import BODY, START
import pytest
from rigid_body_ros import (
    Actuator,
    compare,
    Measured,
    messages,
    Problem,
    propagate,
    read,
    recording,
    State,
    TorqueLog,
)
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.replay import replay
from rigid_body_ros.scene import load
from rigid_body_ros.tradeoff.problem import Case
from terms import numbers

SECOND = 10 ** 9


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
def test_a_replay_applies_the_actuator_of_the_scene_to_its_topics(recorded, tmp_path,
                                                                  interpolation):
    path, scene, (thrust, drag) = recorded
    result = replay(path, load(scene), interpolation=interpolation, keep=True)
    drag = TorqueLog(drag.times_ns, drag.torques, interpolation=interpolation)
    run, at = load(scene), result.trajectory.times_ns
    expected = numbers(Problem(run.body, run.start, [thrust, drag], actuator=[
        Actuator(0.05, 0.2, (0.1, 0.0, 0.3)), None]).propagate(at=at))
    assert_array_equal(numbers(result.trajectory), expected)
    assert np.any(expected != numbers(propagate(run.body, run.start, [thrust, drag], at=at)))
    # The check integrates the torques that act, not the commands.
    assert float(re.search(r'differ by (\S+)', str(result.check))[1]) < 1e-9
    assert_array_equal(numbers(read(path, scene, interpolation=interpolation).propagate(at=at)),
                       expected)
    # Without memory of the motion, the file has the same.
    replay(path, load(scene), tmp_path / 'motion.mcap', interpolation=interpolation)
    written = recording.read(tmp_path / 'motion.mcap', '/attitude', messages.QUATERNION)
    assert_array_equal(written.values, expected[:, :4])


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
    assert_array_equal(later.problem.torque(times_ns, attitude), torques)


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
    stamps, random = np.arange(-3, 20) * 50_000_000, np.random.default_rng(13)
    logs = [TorqueLog(stamps + k, random.normal(size=(23, 3))) for k in range(3)]
    problem = Problem(BODY, START, logs[0], actuator=Actuator(0.03, 0.1))
    assert_array_equal(*(numbers(one.propagate(at=[SECOND])) for one in (
        problem.replaced(log=logs), Problem(BODY, START, logs, actuator=Actuator(0.03, 0.1)))))


def test_a_torque_of_the_actuators_is_what_the_residual_is_measured_against():
    rng = np.random.default_rng(10)
    log = TorqueLog(np.arange(30) * 50_000_000, rng.normal(size=(30, 3)), rng.random(30) < 0.5)
    problem = Problem(BODY, START, log, actuator=Actuator(0.03, 0.07, (0.9, 0.9, 0.0)))
    times_ns = np.arange(150) * 10_000_000
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
