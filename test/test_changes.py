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

"""Bodies that change: conservation to rounding, and the same bits in any order of arrival."""

import re

import numpy as np
import pytest
from rigid_body_ros import (
    BodyLog,
    GravityGradient,
    messages,
    propagate,
    Propagator,
    read,
    recording,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
)
from rigid_body_ros import scene as scene_file
from rigid_body_ros.commands import main
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.mechanics.changes import changed
from rigid_body_ros.propagation import Integration, Problem
from rigid_body_ros.replay import replay
import terms
import truth

SECOND = 10 ** 9
BODY = RigidBody([[2.0, 0.1, -0.2], [0.1, 3.0, 0.05], [-0.2, 0.05, 4.0]])
SMALLER = RigidBody.from_moments(1.5, 2.2, 2.6, 0.05, -0.1)
LARGER = RigidBody.from_moments(3.0, 3.2, 5.0, 0.2, -0.3, 0.1)
DAMPED = RigidBody(LARGER.inertia, damping=np.diag([0.01, 0.02, 0.03]))
START = State(0, (0.1, -0.3, 0.2, 0.9), (0.3, 0.5, -0.2))
ROTORS = (0.2, -0.1, 0.4)


def same(one, other):
    """Return whether two motions have the same bits."""
    return (np.array_equal(one.attitude, other.attitude)
            and np.array_equal(one.angular_velocity, other.angular_velocity)
            and np.array_equal(one.rotor_momentum, other.rotor_momentum))


def scene(rng, keep, count=4):
    """Return logs, motor torques, and changes at and between the stamps of the logs."""
    stamps = np.arange(60) * 50_000_000
    logs = [TorqueLog(stamps, rng.normal(size=(60, 3))),
            TorqueLog(stamps[::3] + 12_345, rng.normal(size=(20, 3)), frame='space')]
    wheels = TorqueLog(stamps[::2] + 777, 0.1 * rng.normal(size=(30, 3)))
    when = [stamps[7], stamps[21] + 12_345, *rng.integers(0, 3 * SECOND, count - 2)]
    bodies = [SMALLER, LARGER, DAMPED, BODY][:count]
    return logs, wheels, BodyLog(when, bodies, keep)


@pytest.mark.parametrize('name', ['payload_dropped', 'arm_deployed'])
def test_motions_agree_with_fifty_digits(name, fifty_digits):
    body, start, values = terms.reference(name)
    rows = values['bodies_t_ns_six']
    terms.assert_agrees(Problem(body, start, changes=BodyLog(
        [row[0] for row in rows], [RigidBody.from_moments(*row[1:]) for row in rows],
        values['keep'])), values)


@pytest.mark.slow
@pytest.mark.parametrize('solver', ['auto', 'taylor', 'rk4', 'explicit_euler'])
@pytest.mark.parametrize('keep', ['rate', 'momentum'])
def test_any_order_of_arrival_gives_the_same_bits(keep, solver):
    rng = np.random.default_rng(36)
    logs, wheels, changes = scene(rng, keep)
    fields = [UniformField((0.0, 0.1, -0.4), (0.0, 0.0, -9.81)), GravityGradient(0.2)]
    options = {'solver': solver, 'max_step': None if solver in ('auto', 'taylor') else 0.01,
               'fields': fields, 'torque_timeout': 0.12}
    start = State(0, START.attitude, START.angular_velocity, ROTORS)
    at = np.sort(np.append(rng.integers(0, 3 * SECOND, 40), changes.times_ns))
    expected = propagate(BODY, start, logs, at=at, wheels=wheels, changes=changes, **options)
    events = [('apply', int(stamp), torque, 'space' if in_space else 'body', source)
              for source, log in enumerate(logs)
              for stamp, torque, in_space in zip(log.times_ns, log.torques, log.in_space)]
    events += [('apply_wheels', int(stamp), torque)
               for stamp, torque in zip(wheels.times_ns, wheels.torques)]
    events += [('apply_body', int(stamp), body, keep)
               for stamp, body in zip(changes.times_ns, changes.bodies)]
    for _ in range(3):
        propagator = Propagator(BODY, start, history=10.0, **options)
        for number in rng.permutation(len(events)):
            name, *values = events[number]
            assert getattr(propagator, name)(*values)
            if not number % 7:
                propagator.at(int(rng.integers(0, 3 * SECOND)))  # a prediction changes no bit
        for row, time_ns in enumerate(at.tolist()):
            state = propagator.at(time_ns)
            assert np.array_equal(state.attitude, expected.attitude[row])
            assert np.array_equal(state.angular_velocity, expected.angular_velocity[row])
            assert np.array_equal(state.rotor_momentum, expected.rotor_momentum[row])


@pytest.mark.parametrize('interpolation', ['hold', 'linear', 'cubic'])
def test_a_motion_in_pieces_has_the_same_bits(interpolation):
    rng = np.random.default_rng(3)
    stamps = np.arange(40) * 100_000_000
    log = TorqueLog(stamps, rng.normal(size=(40, 3)), interpolation=interpolation)
    changes = BodyLog([stamps[11], stamps[20], 2_345_678_901], [SMALLER, LARGER, BODY], 'momentum')
    at = np.arange(0, 4 * SECOND, 12_345_678)
    whole = propagate(BODY, START, log, at=at, changes=changes)
    run, attitude = None, []
    for begin, end in zip([0, 13, 20, 27], [13, 20, 27, None]):
        piece = log.rows(slice(max(begin - 4, 0), None if end is None else end + 4))
        problem = Problem(BODY, START, piece, changes=changes)
        if run is None:
            run = Integration(problem)
        else:
            run.extend(problem)
        until_ns = None if end is None else int(stamps[end])
        inside = (at >= stamps[begin]) & (at < (until_ns or 2 ** 62))
        attitude.append(run.advance(at[inside], until_ns).attitude)
    assert np.array_equal(np.concatenate(attitude), whole.attitude)


def test_a_change_at_the_end_of_a_piece_at_time_zero_is_not_lost():
    changes, start = BodyLog([0], [SMALLER], 'momentum'), State(-SECOND, START.attitude,
                                                                START.angular_velocity)
    run = Integration(Problem(BODY, start, TorqueLog([-SECOND, 0], np.eye(3)[:2]),
                              changes=changes))
    run.advance([-SECOND // 2], until_ns=0)
    after = run.advance([SECOND])
    assert np.array_equal(after.attitude, run.problem.propagate(at=[SECOND]).attitude)


def test_the_momentum_of_the_rotors_goes_on_after_a_change():
    logs, wheels, changes = scene(np.random.default_rng(6), 'rate')
    problem = Problem(BODY, START, logs, wheels=wheels, changes=changes)
    at = np.arange(0, 3 * SECOND, 10 ** 8)
    np.testing.assert_allclose(problem.rotor_momentum(at), problem.propagate(at=at).rotor_momentum,
                               atol=1e-15)


def test_requested_times_change_no_bit():
    rng = np.random.default_rng(4)
    logs, wheels, changes = scene(rng, 'momentum')
    at = rng.integers(0, 3 * SECOND, 50)
    together = propagate(BODY, START, logs, at=at, wheels=wheels, changes=changes)
    for row, time_ns in enumerate(at):
        alone = propagate(BODY, START, logs, at=[time_ns], wheels=wheels, changes=changes)
        assert np.array_equal(alone.attitude[0], together.attitude[row])
        assert np.array_equal(alone.angular_velocity[0], together.angular_velocity[row])


def test_a_state_between_changes_restarts_with_the_same_bits():
    changes = scene(np.random.default_rng(5), 'momentum')[2]
    propagator = Propagator(BODY, START, history=10.0)
    for stamp, body in zip(changes.times_ns.tolist(), changes.bodies):
        propagator.apply_body(stamp, body, 'momentum')
    at = np.arange(1_500_000_000, 3 * SECOND, 100_000_000)
    whole = propagate(BODY, START, at=at, changes=changes)
    middle = propagator.at(1_400_000_000)
    rest = propagate(BODY, middle, at=at, changes=changes)
    assert same(rest, whole)


def test_kept_momentum_is_the_same_in_space_and_a_kept_rate_is_the_same():
    start = State(0, START.attitude, START.angular_velocity, ROTORS)
    at = [SECOND - 1, SECOND]
    for keep in ('rate', 'momentum'):
        motion = propagate(BODY, start, at=at, changes=BodyLog([SECOND], [LARGER], keep))
        jump = motion.angular_velocity[1] - motion.angular_velocity[0]
        change = motion.angular_momentum_space[1] - motion.angular_momentum_space[0]
        if keep == 'rate':  # a nanosecond passes
            assert np.linalg.norm(jump) < 1e-9
            assert np.linalg.norm(change) > 0.1
        else:
            assert np.linalg.norm(jump) > 0.1
            assert np.linalg.norm(change) < 1e-15


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
    changes = BodyLog([-5, 0], [LARGER, SMALLER], 'momentum')
    at = np.arange(0, SECOND, 10 ** 8)
    assert same(propagate(BODY, START, at=at, changes=changes), propagate(SMALLER, START, at=at))
    propagator = Propagator(BODY, START)
    propagator.apply_body(0, SMALLER, 'momentum')
    propagator.apply_body(-5, LARGER, 'momentum')
    assert np.array_equal(propagator.at(SECOND // 2).attitude,
                          propagate(SMALLER, START, at=[SECOND // 2]).attitude[0])


def test_the_later_of_two_bodies_with_one_stamp_is_used():
    at = np.arange(0, 2 * SECOND, 10 ** 8)
    twice = BodyLog([SECOND, SECOND], [LARGER, SMALLER])
    once = BodyLog([SECOND], [SMALLER])
    assert len(twice) == 1
    assert same(propagate(BODY, START, at=at, changes=twice),
                propagate(BODY, START, at=at, changes=once))


def test_a_body_that_is_too_old_is_dropped():
    propagator = Propagator(BODY, START, history=0.5)
    propagator.apply(2 * SECOND, (0.0, 0.0, 0.1))
    assert not propagator.apply_body(SECOND + SECOND // 2, SMALLER)
    assert propagator.apply_body(SECOND + SECOND // 2 + 1, SMALLER)


def test_a_body_without_change_changes_only_the_last_digits():
    at = np.arange(0, 3 * SECOND, 10 ** 8)
    changes = BodyLog([SECOND], [BODY], 'momentum')
    one, other = propagate(BODY, START, at=at, changes=changes), propagate(BODY, START, at=at)
    assert abs(one.attitude - other.attitude).max() < 1e-15
    assert abs(one.angular_velocity - other.angular_velocity).max() < 1e-15


@pytest.mark.parametrize(('arguments', 'message'), [
    (([0, 1], [BODY]), 'bodies: expected 2, one for each stamp, found 1'),
    (([0], [BODY], 'energy'), "keep: expected 'rate' or 'momentum', found 'energy'"),
    (([0.5], [BODY]), 'times_ns: expected integer nanoseconds of shape (n,), found float64'),
])
def test_mistakes_are_reported(arguments, message):
    with pytest.raises(ValueError, match=f'^{re.escape(message)}'):
        BodyLog(*arguments)


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
    assert same(problem.propagate(at=at), expected)
    result = replay(path, run, tmp_path / 'out.mcap', keep=True)
    assert np.array_equal(result.trajectory.times_ns, at)
    assert same(result.trajectory, expected)
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
def test_commands_that_compute_with_one_body_refuse_one_that_changes(tmp_path, capsys, command):
    recorded(tmp_path / 'in.mcap', TORQUES, INERTIAS)
    lines = [f'    {name}: {value}' for name, value in SCENE.items()]
    (tmp_path / 'scene.yaml').write_text('/**:\n  ros__parameters:\n' + '\n'.join(lines))
    replay(tmp_path / 'in.mcap', scene_file.load(tmp_path / 'scene.yaml'), tmp_path / 'out.mcap',
           also=['input'])
    (tmp_path / 'vary.yaml').write_text('torque_gain: {normal: 0.01}')
    path = str(tmp_path / 'out.mcap')
    options = {'compare': [path, '--measured', '/attitude'],
               'identify': [path, '--measured', '/attitude', '-o', str(tmp_path / 'fit.yaml')],
               'tradeoff': ['--recording', path],
               'ensemble': ['--recording', path, '--runs', '2', '-o', str(tmp_path / 'runs'),
                            '--vary', str(tmp_path / 'vary.yaml')]}[command]
    run = getattr(main, f'attitude_{command}')
    status = run([*options, '--scene', str(tmp_path / 'scene.yaml')])
    assert status == 2
    assert 'expected a body that does not change, found 2 changes' in capsys.readouterr().err
