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

"""The derivatives of a motion: against motions with fifty digits, and against differences."""

from derivatives_truth import CASES, FULL, SECOND, TRUTH
import numpy as np
import pytest
from rigid_body_ros import (
    Actuator,
    EffortLog,
    Problem,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
    Wheel,
)
from rigid_body_ros.engine import layout

NAMES = ['inertia', 'start', 'torque_gains', 'torque_bias', 'damping', 'rotor_momentum']
#: Weights of a central difference of order six.
WEIGHTS = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}


@pytest.mark.parametrize('name', CASES)
def test_derivatives_have_the_digits_of_a_double(name):
    case = CASES[name]
    found = case.problem().derivatives(case.names(), at=[case.end_ns])
    assert {*found.names} == {*TRUTH[name]}
    # After ten thousand turns, the series of the motion itself is off by 2e-10 rad.
    limit = 1e-13 if case.seconds < 100.0 else 1e-8
    for component, (turn, rate) in TRUTH[name].items():
        k = found.names.index(component)
        for derivative, truth in ((found.attitude, turn), (found.angular_velocity, rate)):
            truth = np.array(truth, float)
            if np.linalg.norm(truth) > 1e-15:
                error = np.linalg.norm(derivative[0, :, k] - truth)
                assert error < limit * np.linalg.norm(truth)
            else:
                assert not derivative[0, :, k].any()


def problem(component='', change=0.0, interpolation='hold', has_wheels=True, in_space=False):
    """Return a problem that begins between samples, with a component of a parameter changed."""
    values = {'inertia': FULL.copy(), 'damping': np.diag([0.02, 0.03, 0.01]) + 0.005,
              'initial_angular_velocity': np.array([0.5, -0.7, 0.9]),
              'initial_rotor_momentum': np.array([0.3, -0.2, 0.1]),
              'torque_gains': np.ones(3), 'torque_bias': np.zeros(3)}
    if component:
        kind, entry = component.split('.')
        axes = ['xyz'.index(axis) for axis in entry if axis in 'xyz']
        values[kind][tuple(axes)] += change
        if len(set(axes)) == 2:
            values[kind][tuple(axes[::-1])] += change
    random, start_ns = np.random.default_rng(5), 3 * SECOND // 2
    stamps_ns, torques = np.arange(40) * SECOND // 4, 0.2 * random.normal(size=(40, 3))
    logs = [TorqueLog(stamps_ns, torques * values['torque_gains'],
                      'space' if in_space else 'body', interpolation)]
    if values['torque_bias'].any():
        logs.append(TorqueLog([start_ns], [values['torque_bias']]))
    wheels = TorqueLog(stamps_ns + SECOND // 10, 0.1 * random.normal(size=(40, 3)),
                       interpolation=interpolation)
    return Problem(RigidBody(values['inertia'], values['damping']),
                   State(start_ns, (0.0, 0.0, 0.0, 1.0), values['initial_angular_velocity'],
                         values['initial_rotor_momentum']), logs,
                   wheels=wheels if has_wheels else None)


@pytest.mark.parametrize(('interpolation', 'has_wheels', 'in_space'), [
    ('hold', True, False), ('hold', False, False), ('hold', True, True), ('linear', True, False),
    ('linear', False, True), ('cubic', True, False), ('cubic', False, False)])
def test_derivatives_are_the_limits_of_differences(interpolation, has_wheels, in_space):
    kinds, at = (interpolation, has_wheels, in_space), np.array([2, 5, 9, 12]) * SECOND
    names = [name for name in NAMES if not (in_space and name == 'torque_gains')]
    found, motion = problem('', 0.0, *kinds).derivatives(names, at=at), problem(
        '', 0.0, *kinds).propagate(at=at)
    step, compared = 2e-4, 0
    for k, name in enumerate(found.names):
        if name.startswith('initial_attitude'):
            continue
        turn = rate = 0.0
        for places, weight in WEIGHTS.items():
            other = problem(name, places * step, *kinds).propagate(at=at)
            turn = turn + weight / step * (motion.rotation.inv() * other.rotation).as_rotvec()
            rate = rate + weight / step * other.angular_velocity
        for derivative, difference in ((found.attitude, turn), (found.angular_velocity, rate)):
            assert np.abs(derivative[..., k] - difference).max() < 1e-10 * np.abs(difference).max()
        compared += 1
    assert compared >= 18


@pytest.mark.parametrize('name', ['inertia.ixz', 'initial_angular_velocity.x'])
def test_wheels_that_turn_with_the_body_and_actuators_have_derivatives(name):
    wheels = [Wheel('a', (1.0, 0.0, 0.0), 0.1, 20.0), Wheel('b', (0.6, 0.0, 0.8), 0.05)]
    efforts = EffortLog([0, SECOND], [[0.1, -0.2], [0.0, 0.3]])
    log = TorqueLog([0, SECOND], [[0.3, -0.2, 0.1], [0.0, 0.1, -0.4]])

    def changed(change):
        inertia, rates = FULL.copy(), np.array([0.5, -0.7, 0.9])
        if name.startswith('inertia'):
            inertia[0, 2] = inertia[2, 0] = inertia[0, 2] + change
        else:
            rates[0] += change
        return Problem(RigidBody(inertia), State(0, angular_velocity=rates), log, wheels=wheels,
                       efforts=efforts, actuator=Actuator(delay=0.35, limit=(0.25, 0.25, 0.25)))
    at, step = [5 * SECOND], 2e-4
    found = changed(0.0).derivatives(['inertia', 'start'], at=at)
    rate = sum(weight / step * changed(places * step).propagate(at=at).angular_velocity
               for places, weight in WEIGHTS.items())
    np.testing.assert_allclose(found.angular_velocity[..., found.names.index(name)], rate,
                               rtol=1e-10)


def test_the_gain_of_all_axes_is_the_sum_of_the_gains():
    at = [5 * SECOND]
    one, each = (problem().derivatives([name], at=at) for name in ('torque_gain', 'torque_gains'))
    np.testing.assert_allclose(one.attitude[..., 0], each.attitude.sum(axis=2), rtol=1e-13)


def test_derivatives_do_not_depend_on_what_else_is_asked():
    at = np.array([9, 2, 5, 12]) * SECOND
    whole = problem().derivatives(NAMES, at=at)
    assert whole.attitude.shape == whole.angular_velocity.shape == (4, 3, len(whole.names))
    # Steps end at the requested times, so other times round otherwise.
    one = problem().derivatives(['damping'], at=at[::-1])
    k = whole.names.index('damping.dxx')
    assert np.array_equal(one.attitude[::-1], whole.attitude[..., k:k + 6])
    alone = problem().derivatives(['damping'], at=at[:1])
    np.testing.assert_allclose(alone.attitude, one.attitude[-1:], rtol=1e-12)


def test_every_solver_has_the_derivatives_of_the_series():
    at = [5 * SECOND]
    fixed = problem().solved_by(solver='rk4', max_step=0.01).derivatives(NAMES, at=at)
    assert np.array_equal(fixed.attitude, problem().derivatives(NAMES, at=at).attitude)


def test_no_times_have_no_derivatives():
    assert problem().derivatives(['start'], at=[]).attitude.shape == (0, 3, 6)


def test_a_long_motion_is_computed_in_several_calls(monkeypatch):
    at = [300 * SECOND]
    whole = problem().derivatives(['inertia'], at=at)
    monkeypatch.setattr(layout, 'BUDGET', 64)
    assert np.array_equal(problem().derivatives(['inertia'], at=at).attitude, whole.attitude)


def test_the_start_has_the_derivative_one():
    found = problem().derivatives(['start'], at=[problem().start.time_ns])
    assert np.array_equal(found.attitude[0], np.eye(3, 6))
    assert np.array_equal(found.angular_velocity[0], np.eye(3, 6, 3))


@pytest.mark.parametrize(('names', 'expected'), [
    (['mass'], 'expected names among inertia, .*, found .mass.'),
    ([], 'expected at least one name, found none'),
    (['start', 'start'], 'expected each name once, found .start. twice')])
def test_wrong_names_are_named(names, expected):
    with pytest.raises(ValueError, match=f'^derivatives: {expected}$'):
        problem().derivatives(names, at=[5 * SECOND])


@pytest.mark.parametrize(('inputs', 'expected'), [
    ({'fields': [UniformField((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))]}, 'fields'),
    ({'wheels': [Wheel('a', (1.0, 0.0, 0.0), 0.1, friction=0.1)]}, 'wheels with friction'),
    ({'actuator': Actuator(delay=0.1), 'log': TorqueLog([0], [[0.0, 0.1, 0.0]])},
     'gains of actuators'),
    ({'log': TorqueLog([0], [[0.0, 0.1, 0.0]], 'space')}, 'gains of torques in space axes')])
def test_what_has_no_derivatives_yet_is_named(inputs, expected):
    given = Problem(RigidBody(FULL), State(), **inputs)
    with pytest.raises(ValueError, match=f'^derivatives: expected a problem without {expected}'):
        given.derivatives(['torque_gain'], at=[SECOND])
