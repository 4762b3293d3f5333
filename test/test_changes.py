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

"""Bodies that change: what is kept, when a body starts, and recordings of bodies."""

import re

import numpy as np
from numpy.testing import assert_array_equal
from parts import BODY, SMALLER, START
import pytest
from rigid_body_ros import (
    BodyLog,
    messages,
    propagate,
    Propagator,
    read,
    recording,
    RigidBody,
    State,
    TorqueLog,
)
from rigid_body_ros import scene as scene_file
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics.changes import changed
from rigid_body_ros.propagation import Integration, Problem
from rigid_body_ros.replay import replay
from terms import numbers
import truth

SECOND = 10 ** 9
LARGER = RigidBody.from_moments(3.0, 3.2, 5.0, 0.2, -0.3, 0.1)


def test_a_change_at_the_end_of_a_piece_at_time_zero_is_not_lost():
    changes, start = BodyLog([0], [SMALLER], 'momentum'), State(-SECOND, START.attitude,
                                                                START.angular_velocity)
    run = Integration(Problem(BODY, start, TorqueLog([-SECOND, 0], np.eye(3)[:2]),
                              changes=changes))
    run.advance([-SECOND // 2], until_ns=0)
    after = run.advance([SECOND])
    assert np.array_equal(after.attitude, run.problem.propagate(at=[SECOND]).attitude)


def test_the_momentum_of_the_rotors_goes_on_after_a_change():
    at = np.arange(0, 3 * SECOND, 10 ** 8)
    wheels = TorqueLog(at, 0.1 * np.random.default_rng(6).normal(size=(30, 3)))
    problem = Problem(BODY, START, wheels=wheels, changes=BodyLog(
        [SECOND, 2 * SECOND + 7], [SMALLER, LARGER], 'rate'))
    np.testing.assert_allclose(problem.rotor_momentum(at), problem.propagate(at=at).rotor_momentum,
                               rtol=0, atol=1e-15)


@pytest.mark.parametrize(('keep', 'kept', 'other', 'bound'), [
    ('rate', 'angular_velocity', 'angular_momentum_space', 1e-9),  # a nanosecond passes
    ('momentum', 'angular_momentum_space', 'angular_velocity', 1e-15)])
def test_kept_momentum_is_the_same_in_space_and_a_kept_rate_is_the_same(keep, kept, other,
                                                                        bound):
    start = State(0, START.attitude, START.angular_velocity, (0.2, -0.1, 0.4))
    motion = propagate(BODY, start, at=[SECOND - 1, SECOND],
                       changes=BodyLog([SECOND], [LARGER], keep))
    assert np.linalg.norm(np.diff(getattr(motion, kept), axis=0)) < bound
    assert np.linalg.norm(np.diff(getattr(motion, other), axis=0)) > 0.1


def test_a_change_to_a_thin_rod_and_back_loses_no_digit():
    # The smallest moment is a millionth of the others, which costs a solver six digits.
    rod = RigidBody([[0.5, 0.4999995, 0.0], [0.4999995, 0.5, 0.0], [0.0, 0.0, 1.0]])
    spun = changed(START, BODY, rod, 'momentum')
    momentum = truth.exact(rod.inertia) @ truth.exact(spun.angular_velocity)
    assert np.linalg.norm(spun.angular_velocity) > 1e5
    expected = truth.exact(BODY.inertia) @ truth.exact(START.angular_velocity)
    assert np.max(abs(momentum - expected)) < 1e-15 * np.max(abs(expected)) * 1e6
    back = changed(spun, rod, BODY, 'momentum')
    assert np.array_equal(back.angular_velocity, START.angular_velocity)


def test_a_body_from_before_the_start_starts():
    changes = BodyLog([0, -5, 0], [LARGER, LARGER, SMALLER], 'momentum')
    assert len(changes) == 2  # of two bodies with one stamp, the later is used
    at = np.arange(0, SECOND, 10 ** 8)
    expected = numbers(propagate(SMALLER, START, at=at))
    assert_array_equal(numbers(propagate(BODY, START, at=at, changes=changes)), expected)
    propagator = Propagator(BODY, START)
    propagator.apply_body(0, SMALLER, 'momentum')
    propagator.apply_body(-5, LARGER, 'momentum')
    assert_array_equal(numbers(propagator.at(int(at[5]))), expected[5])


def test_a_body_that_is_too_old_is_dropped():
    propagator = Propagator(BODY, START, history=0.5)
    propagator.apply(2 * SECOND, (0.0, 0.0, 0.1))
    assert not propagator.apply_body(SECOND + SECOND // 2, SMALLER)
    assert propagator.apply_body(SECOND + SECOND // 2 + 1, SMALLER)


def recorded(path, torques, inertias):
    """Write a recording with torques (stamp, torque) and inertias (stamp, entries)."""
    with recording.Writer(path) as writer:
        writer.add_topic('/torque', messages.WRENCH)
        writer.add_topic('/inertia', messages.INERTIA)
        for stamp_ns, torque in torques:
            writer.write('/torque', stamp_ns, messages.wrench(stamp_ns, '', torque))
        for stamp_ns, entries in inertias:
            writer.write('/inertia', stamp_ns, messages.inertia(stamp_ns, 'base_link', entries))


SCENE = {'inertia.ixx': 2.0, 'inertia.iyy': 3.0, 'inertia.izz': 4.0, 'damping.dxx': 0.01,
         'initial_angular_velocity.x': 0.3, 'initial_angular_velocity.y': 0.5,
         'inertia_topic': True, 'inertia_change': 'keep_momentum'}
TORQUES = [(SECOND + k * 10 ** 8, (0.1 * k, 0.0, -0.2)) for k in range(20)]
INERTIAS = [(SECOND + 750_000_001, SMALLER.entries), (2 * SECOND, LARGER.entries)]


def test_a_replay_has_the_bodies_of_the_recording(tmp_path):
    path, run = tmp_path / 'in.mcap', scene_file.Scene.from_values(SCENE)
    recorded(path, TORQUES, INERTIAS[::-1])
    problem = read(path, run)
    damping = run.body.damping
    changes = BodyLog([stamp for stamp, _ in INERTIAS],
                      [RigidBody(body.inertia, damping) for body in (SMALLER, LARGER)], 'momentum')
    log = TorqueLog([stamp for stamp, _ in TORQUES], [torque for _, torque in TORQUES])
    # Outputs at the stamps of both torques and bodies.
    at = np.union1d(log.times_ns, changes.times_ns)
    expected = propagate(run.body, State(SECOND, angular_velocity=(0.3, 0.5, 0.0)), log, at=at,
                         changes=changes)
    assert_array_equal(numbers(problem.propagate(at=at)), numbers(expected))
    result = replay(path, run, tmp_path / 'out.mcap', keep=True)
    assert np.array_equal(result.trajectory.times_ns, at)
    assert_array_equal(numbers(result.trajectory), numbers(expected))
    written = recording.read(tmp_path / 'out.mcap', '/attitude', messages.QUATERNION)
    assert np.array_equal(written.values, expected.attitude)


@pytest.mark.parametrize(('values', 'inertias', 'options', 'message'), [
    ({'inertia_topic': False}, INERTIAS, {'inertia': '/inertia'},
     '--inertia: expected a scene with inertia_topic: true, found inertia_topic: false'),
    ({}, [*INERTIAS, (3 * SECOND, (1.0, 1.0, 3.0, 0.0, 0.0, 0.0))], {},
     '/inertia: message 3 at 3000000000 ns: '),
    ({}, [(0, SMALLER.entries), (1_767_225_600 * SECOND, LARGER.entries)], {},
     '/inertia: message 1: expected a stamp in the header'),
    ({'checkpoint': '/tmp/state.json'}, INERTIAS, {}, 'checkpoint: expected none with'),
    ({'solver': 'exact', 'damping.dxx': 0.0}, [], {}, "solver 'exact' handles torque-free"),
])
def test_mistakes_with_bodies_are_reported_in_one_line(tmp_path, values, inertias, options,
                                                       message):
    recorded(tmp_path / 'in.mcap', TORQUES, inertias)
    with pytest.raises(InputError, match=re.escape(message)) as error:
        replay(tmp_path / 'in.mcap', scene_file.Scene.from_values({**SCENE, **values}), **options)
    assert '\n' not in str(error.value)


def test_a_replay_is_checked_up_to_the_first_change(tmp_path):
    coasting = [(SECOND, (0.0, 0.0, 0.0)), (4 * SECOND, (0.0, 0.0, 0.0))]
    recorded(tmp_path / 'in.mcap', coasting, INERTIAS)
    run = scene_file.Scene.from_values({**SCENE, 'damping.dxx': 0.0})
    result = replay(tmp_path / 'in.mcap', run)
    assert result.check.total == 3.0
    assert result.check.covered == pytest.approx(0.75)
    name, lost = result.check.finding.rsplit(' ', 1)
    assert name == 'relative drift of the space angular momentum'
    assert float(lost) < 1e-15


@pytest.mark.parametrize('command', ['compare', 'identify', 'tradeoff', 'ensemble'])
def test_commands_that_compute_with_one_body_refuse_one_that_changes(tmp_path, refusal, command):
    recorded(tmp_path / 'in.mcap', TORQUES, INERTIAS)
    lines = [f'    {name}: {value}' for name, value in SCENE.items()]
    (tmp_path / 'scene.yaml').write_text('/**:\n  ros__parameters:\n' + '\n'.join(lines))
    replay(tmp_path / 'in.mcap', scene_file.load(tmp_path / 'scene.yaml'), tmp_path / 'out.mcap',
           also=['input'])
    (tmp_path / 'vary.yaml').write_text('torque_gain: {normal: 0.01}')
    path = tmp_path / 'out.mcap'
    options = {'compare': [path, '--measured', '/attitude'],
               'identify': [path, '--measured', '/attitude', '-o', tmp_path / 'fit.yaml'],
               'tradeoff': ['--recording', path],
               'ensemble': ['--recording', path, '--runs', 2, '-o', tmp_path / 'runs',
                            '--vary', tmp_path / 'vary.yaml']}[command]
    assert 'expected a body that does not change, found 2 changes' in refusal(
        f'attitude_{command}', *options, '--scene', tmp_path / 'scene.yaml')
