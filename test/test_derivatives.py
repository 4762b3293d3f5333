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

"""The derivatives of a motion: against fifty digits, against differences, in JAX and PyTorch."""

import subprocess
import sys

from conftest import SECOND
from derivatives_truth import CASES, FULL, TRUTH
import numpy as np
import pytest
from rigid_body_ros import (
    Actuator,
    autodiff,
    BodyLog,
    EffortLog,
    GravityGradient,
    Problem,
    propagate,
    RigidBody,
    State,
    TorqueLog,
    UniformField,
    Wheel,
)
from rigid_body_ros.common.arrays import entries, symmetric
from rigid_body_ros.engine import layout
from rigid_body_ros.mechanics import so3
from rigid_body_ros.scene.quantities import components_of

NAMES = ['inertia', 'start', 'torque_gains', 'torque_bias', 'torque_delay', 'damping',
         'rotor_momentum']
DAMPING = np.diag([0.02, 0.03, 0.01]) + 0.005
#: Weights of a central difference of order six.
WEIGHTS = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}


@pytest.mark.slow
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


#: What may act on a body together, by name; the truth has each alone.
KINDS = ['hold wheels space', 'linear wheels', 'two cubic space', 'lag space two wheels',
         'many fields lag', 'change momentum field lag', 'change lag gradient two']


#: Values of the parameters of `problem`.
VALUES = {'inertia': entries(FULL), 'damping': entries(DAMPING), 'initial_attitude': np.zeros(3),
          'initial_angular_velocity': (0.5, -0.7, 0.9), 'initial_rotor_momentum': (0.3, -0.2, 0.1),
          'torque_gains': np.ones(3), 'torque_bias': np.zeros(3), 'torque_delay': (0.0,),
          'torque_lag': (0.0,), 'weight.moment': (0.3, -0.2, 0.5)}


def problem(component='', change=0.0, kind='hold wheels'):
    """Return a problem that begins between samples, with a component of a parameter changed."""
    inertia, damping, turn, rates, momentum, gains, bias, (delay,), (lag,), moment = (
        numbers + change * (np.array(components_of(name)) == component)
        for name, numbers in VALUES.items())
    random, start_ns = np.random.default_rng(5), 3 * SECOND // 2 + 12345678
    stamps_ns, torques = np.arange(40) * SECOND // 4, 0.2 * random.normal(size=(40, 3))
    interpolation = next((one for one in ('linear', 'cubic') if one in kind), 'hold')
    late_ns = stamps_ns + round(delay * SECOND)
    logs = [TorqueLog(late_ns, torques * gains, 'space' if 'space' in kind else 'body',
                      interpolation)]
    wheels = TorqueLog(stamps_ns + SECOND // 10, 0.1 * random.normal(size=(40, 3)),
                       interpolation=interpolation)
    if 'two' in kind:
        logs.append(TorqueLog(late_ns + SECOND // 7, torques[::-1] * gains))
    actuators = [Actuator(time_constant=constant + lag)
                 for constant in (0.15, 0.6)[:len(logs)]] if 'lag' in kind else None
    if bias.any():
        logs.append(TorqueLog([start_ns], [bias]))
        actuators = actuators and [*actuators, None]
    fields = [UniformField(moment, (0.2, 0.4, -0.9), 'weight')] if 'field' in kind else []
    if 'many' in kind:
        fields += [UniformField((0.1 * k, 0.2, -0.1), (0.2, 0.4 * k, -0.9)) for k in range(3)]
    if 'gradient' in kind:
        fields.append(GravityGradient(0.4))
    changes = BodyLog([3 * SECOND + 7654321, 5 * SECOND + 17000000], [
        RigidBody(1.3 * FULL + np.diag([0.1, 0.2, 0.0])), RigidBody(0.7 * FULL)],
        'momentum' if 'momentum' in kind else 'rate')
    attitude = so3.multiply(np.array([2.0, -4.0, 5.0, 6.0]) / 9.0, so3.exp(turn))
    return Problem(RigidBody(symmetric(inertia), symmetric(damping)),
                   State(start_ns, attitude, rates, momentum), logs, fields=fields,
                   wheels=wheels if 'wheels' in kind else None, actuator=actuators,
                   changes=changes if 'change' in kind else None)


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
def test_derivatives_are_the_limits_of_differences(kind):
    at, step = np.array([2, 4, 6, 9]) * SECOND + SECOND // 9, 2e-4
    names = [*NAMES, *['torque_lag'] * ('lag' in kind), *['weight.moment'] * ('field' in kind)]
    found, motion = problem(kind=kind).derivatives(names, at=at), problem(
        kind=kind).propagate(at=at)
    for k, name in enumerate(found.names):
        turn = rate = 0.0
        for places, weight in WEIGHTS.items():
            other = problem(name, places * step, kind).propagate(at=at)
            turn = turn + weight / step * (motion.rotation.inv() * other.rotation).as_rotvec()
            rate = rate + weight / step * other.angular_velocity
        for derivative, difference in ((found.attitude, turn), (found.angular_velocity, rate)):
            error = np.abs(derivative[..., k] - difference).max()
            assert error < 1e-9 * max(np.abs(difference).max(), 1e-3), name


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


def test_derivatives_at_the_start_and_of_what_acts_alike():
    given, at = problem(), [5 * SECOND]
    assert given.derivatives(['start'], at=[]).attitude.shape == (0, 3, 6)
    found = given.derivatives(['start'], at=[given.start.time_ns])
    assert np.array_equal(found.attitude[0], np.eye(3, 6))
    assert np.array_equal(found.angular_velocity[0], np.eye(3, 6, 3))
    one, each, delay, lag = (given.derivatives([name], at=at).attitude for name in (
        'torque_gain', 'torque_gains', 'torque_delay', 'torque_lag'))
    np.testing.assert_allclose(one[..., 0], each.sum(axis=2), rtol=1e-13)
    assert np.array_equal(delay, lag)  # without a lag, a lag acts like a delay
    fixed = given.solved_by(solver='rk4', max_step=0.01).derivatives(NAMES, at=at)
    assert np.array_equal(fixed.attitude, given.derivatives(NAMES, at=at).attitude)


def test_a_long_motion_is_computed_in_several_calls(monkeypatch):
    at = [60 * SECOND]
    whole = problem().derivatives(['inertia'], at=at)
    monkeypatch.setattr(layout, 'BUDGET', 64)
    assert np.array_equal(problem().derivatives(['inertia'], at=at).attitude, whole.attitude)


@pytest.mark.parametrize(('names', 'expected'), [
    (['mass'], 'names among inertia, .*, found .mass.'), ([], 'at least one name, found none'),
    (['start', 'start'], 'each name once, found .start. twice'),
    (['start'], 'a problem without wheels with friction or a largest speed, which have no .*')])
def test_what_has_no_derivatives_is_named(names, expected):
    given = problem() if 'friction' not in expected else Problem(
        RigidBody(FULL), State(), wheels=[Wheel('a', (1.0, 0.0, 0.0), 0.1, friction=0.1)])
    with pytest.raises(ValueError, match=f'^derivatives: expected {expected}$'):
        given.derivatives(names, at=[5 * SECOND])


def test_a_lag_of_all_logs_delays_those_without_one():
    torques, at = np.random.default_rng(3).normal(size=(2, 4, 3)), [4 * SECOND]

    def motion(lag):
        logs = [TorqueLog(np.arange(4) * SECOND + first_ns, rows)
                for first_ns, rows in zip((0, SECOND // 3), torques)]
        return Problem(RigidBody(FULL), State(0, angular_velocity=(0.5, -0.7, 0.9)), logs,
                       actuator=[Actuator(time_constant=0.3 + lag), Actuator(time_constant=lag)])
    found = motion(0.0).derivatives(['torque_lag'], at=at).angular_velocity[0, :, 0]
    one, two = ((motion(lag).propagate(at=at).angular_velocity[0]
                 - motion(0.0).propagate(at=at).angular_velocity[0]) / lag
                for lag in (1e-4, 2e-4))
    np.testing.assert_allclose(found, 2.0 * one - two, rtol=1e-5)


def test_a_motion_has_the_derivatives_that_it_is_asked_for():
    given, at = problem(kind='hold'), [5 * SECOND, 3 * SECOND]
    motion = propagate(given.body, given.start, given.logs, at=at, derivatives=['inertia'])
    assert np.array_equal(motion.attitude, given.propagate(at=at).attitude)
    assert np.array_equal(motion.derivatives.attitude,
                          given.derivatives(['inertia'], at=at).attitude)
    assert given.propagate(at=at).derivatives is None


AT = np.array([9, 2, 5, 9]) * SECOND + 7
INPUTS = {'inertia': FULL, 'damping': DAMPING,
          'attitude': [0.2, -0.8, 0.5, 1.0], 'angular_velocity': [0.5, -0.7, 0.9],
          'rotor_momentum': [0.3, -0.2, 0.1]}


def mixed(count=40, start_ns=3 * SECOND // 2, **options):
    """Return a problem that begins between samples, with another log in space axes and rotors."""
    random = np.random.default_rng(5)
    logs = [TorqueLog(np.arange(count) * SECOND // 4, 0.2 * random.normal(size=(count, 3)),
                      frame, interpolation)
            for frame, interpolation in (('body', 'hold'), ('space', 'linear'), ('body', 'cubic'))]
    return Problem(RigidBody(FULL, DAMPING),
                   State(start_ns, (0.0, 0.0, 0.0, 1.0), INPUTS['angular_velocity']),
                   logs[:2], wheels=logs[2], **options)


def with_named_wheels():
    wheels = [Wheel('a', (1.0, 0.0, 0.0), 0.1, 20.0), Wheel('b', (0.6, 0.0, 0.8), 0.05)]
    return Problem(RigidBody(FULL, DAMPING), State(wheel_speeds=(9.0, -5.0)),
                   mixed().logs, wheels=wheels,
                   efforts=EffortLog([0, SECOND], [[0.1, -0.2], [0.0, 0.3]]))


def pulls(count, *leading):
    random = np.random.default_rng(3)
    return random.normal(size=(*leading, count, 4)), random.normal(size=(*leading, count, 3))


@pytest.mark.parametrize('given', [
    mixed(), mixed(start_ns=-SECOND), mixed(torque_timeout=0.1), with_named_wheels()],
    ids=['held', 'before the log', 'timed out', 'named wheels'])
@pytest.mark.parametrize('name', [*INPUTS, 'torques'])
def test_gradients_are_the_limits_of_differences(given, name):
    inputs = {**INPUTS, 'torques': given.logs[0].torques}
    direction = np.random.default_rng(4).normal(size=np.shape(inputs[name]))
    if name in ('inertia', 'damping'):
        direction += direction.T
    attitude, rate = pulls(len(AT))

    def loss(places):
        changed = {**inputs, name: inputs[name] + places * 2e-4 * direction}
        motion, _ = autodiff.vjp(given, changed, at=AT)
        return np.sum(attitude * motion.attitude) + np.sum(rate * motion.angular_velocity)
    difference = sum(weight / 2e-4 * loss(places) for places, weight in WEIGHTS.items())
    _, pull = autodiff.vjp(given, inputs, at=AT)
    found = pull(attitude, rate)
    assert {key: found[key].shape for key in found} == {
        key: np.shape(inputs[key]) for key in inputs}
    assert np.sum(found[name] * direction) == pytest.approx(difference, rel=1e-10)


def jacobian(given, inputs, at):
    """Return the derivatives of the angular velocity at one time, shape (3, ...)."""
    _, pull = autodiff.vjp(given, inputs, at=[at])
    return pull(np.zeros((3, 1, 4)), np.eye(3)[:, None])


@pytest.mark.parametrize(('damping', 'rates', 'torque'), [
    (0.5, (0.5, -0.7, 0.9), 0.2), (0.0, (0.5, -0.7, 0.9), 0.2), (0.0, (1e-6, 3.0, 1e-6), 0.0)],
    ids=['damped', 'tumbling', 'unstable'])
def test_gradients_of_a_long_motion_have_the_digits_of_short_ones(damping, rates, torque):
    count, end = 1000, 100 * SECOND
    stamps, random = np.arange(count) * SECOND // 10, np.random.default_rng(0)
    log, wheels = (TorqueLog(stamps, torque * random.normal(size=(count, 3))) for _ in range(2))
    given = Problem(RigidBody(FULL, damping * np.eye(3)), State(angular_velocity=rates), log,
                    wheels=wheels)
    found = jacobian(given, {'torques': log.torques}, end)['torques']
    motion = given.propagate(at=[*stamps, end])
    for k in (0, 500, 998):
        before, after = (given.replaced(start=State(
            int(motion.times_ns[j]), motion.attitude[j], motion.angular_velocity[j],
            motion.rotor_momentum[j])) for j in (k, k + 1))
        change = before.derivatives(['torque_bias'], at=[stamps[k + 1]])
        rest = after.derivatives(['start'], at=[end]).angular_velocity[0]
        known = rest @ np.concatenate([change.attitude[0], change.angular_velocity[0]])
        assert np.abs(found[:, k] - known).max() < 1e-10 * np.abs(known).max()


def test_gradients_have_the_axes_of_what_they_are_of_and_the_symmetries_of_the_inputs():
    given = mixed()
    _, pull = autodiff.vjp(given, {**INPUTS, 'torques': given.logs[0].torques}, at=AT)
    many = pulls(len(AT), 2, 3)
    whole, one = pull(*many), pull(*(values[1, 2] for values in many))
    for name in whole:
        np.testing.assert_allclose(whole[name][1, 2], one[name], rtol=1e-12, atol=1e-14)
    for name in ('inertia', 'damping'):
        assert np.array_equal(one[name], one[name].T)
    assert abs(one['attitude'] @ INPUTS['attitude']) < 1e-14 * np.abs(one['attitude']).sum()
    given = with_named_wheels()
    inputs = {'inertia': FULL, 'attitude': given.start.attitude, 'torques': given.logs[0].torques}
    for some in ({}, inputs):
        motion, _ = autodiff.vjp(given, some, at=AT)
        assert np.array_equal(motion.attitude, given.propagate(at=AT).attitude)


def test_torques_that_do_not_act_and_no_times_have_no_gradients():
    given = mixed()
    found = jacobian(given, {'torques': given.logs[0].torques}, 3 * SECOND)['torques']
    assert found[:, 6:12].any(axis=(0, 2)).all()
    assert not found[:, :6].any()
    assert not found[:, 12:].any()
    for at in ([], [given.start.time_ns]):
        _, pull = autodiff.vjp(given, {'torques': given.logs[0].torques}, at=at)
        assert not pull(*pulls(len(at)))['torques'].any()


HELD = TorqueLog([0], [[0.0, 0.1, 0.0]])


@pytest.mark.parametrize(('log', 'options', 'inputs', 'expected'), [
    (None, {}, {'mass': 1.0}, 'inputs: expected names among inertia, .*, found .mass.'),
    (None, {}, {'inertia': np.ones(3)}, r'inertia: expected shape \(3, 3\), found \(3,\)'),
    (HELD, {}, {'torques': np.ones(3)}, r'torques: expected shape \(1, 3\), found \(3,\)'),
    (None, {}, {'torques': np.ones((0, 3))}, 'torques: .*, found none'),
    (TorqueLog([0], [[0.0, 0.1, 0.0]], 'space'), {}, {'torques': np.ones((1, 3))},
     'torques: .*, found torques in space axes'),
    (TorqueLog([0], [[0.0, 0.1, 0.0]], interpolation='linear'), {}, {'torques': np.ones((1, 3))},
     'torques: .*, found interpolated torques'),
    (HELD, {'actuator': Actuator(delay=0.1)}, {'torques': np.ones((1, 3))},
     'torques: .*, found an actuator')])
def test_what_cannot_be_an_input_is_named(log, options, inputs, expected):
    with pytest.raises(ValueError, match=f'^{expected}$'):
        autodiff.vjp(Problem(RigidBody(FULL), State(), log, **options), inputs, at=[SECOND])


@pytest.mark.slow
def test_neither_library_is_imported_before_it_is_used():
    script = ('import sys, rigid_body_ros.autodiff; '
              "print([name for name in ('jax', 'torch') if name in sys.modules])")
    assert subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                          check=True).stdout == '[]\n'


@pytest.fixture
def torch():
    return pytest.importorskip('torch', reason='PyTorch (torch) is not installed')


@pytest.fixture
def jax():
    module = pytest.importorskip('jax', reason='JAX (jax) is not installed')
    before = module.config.jax_enable_x64
    module.config.update('jax_enable_x64', True)
    yield module
    module.config.update('jax_enable_x64', before)


@pytest.fixture
def of_numpy():
    """Return all inputs, and the gradients of the sum of the outputs."""
    inputs = {**INPUTS, 'torques': mixed().logs[0].torques}
    _, pull = autodiff.vjp(mixed(), inputs, at=AT)
    return inputs, pull(np.ones((len(AT), 4)), np.ones((len(AT), 3)))


@pytest.mark.slow
def test_torch_has_these_gradients(torch, of_numpy):
    inputs, known = of_numpy
    tensors = {name: torch.tensor(np.array(values), requires_grad=True)
               for name, values in inputs.items()}
    attitude, rate = autodiff.torch_motion(mixed(), at=AT)(tensors)
    (attitude.sum() + rate.sum()).backward()
    for name in known:
        assert np.array_equal(tensors[name].grad.numpy(), known[name])
    with pytest.raises(ValueError, match='^attitude: expected a tensor of torch.float64, found '
                                         'torch.float32$'):
        autodiff.torch_motion(mixed(), at=AT)({'attitude': torch.ones(4)})


@pytest.mark.slow
def test_jax_has_these_gradients(jax, of_numpy):
    inputs, known = of_numpy
    motion = autodiff.jax_motion(mixed(), at=AT)

    def loss(values):
        attitude, rate = motion(values)
        return attitude.sum() + rate.sum()
    for gradient in (jax.grad(loss), jax.jit(jax.grad(loss))):
        found = gradient(inputs)
        for name in known:
            assert np.array_equal(found[name], known[name])


@pytest.mark.slow
def test_jax_computes_many_motions(jax):
    rates = np.random.default_rng(2).normal(size=(5, 3))
    motion = autodiff.jax_motion(mixed(), at=AT)
    found = jax.jit(jax.vmap(lambda rate: motion({'angular_velocity': rate})[0]))(rates)
    for attitude, rate in zip(found, rates):
        known, _ = autodiff.vjp(mixed(), {'angular_velocity': rate}, at=AT)
        assert np.array_equal(attitude, known.attitude)


@pytest.mark.slow
def test_jax_needs_floats_of_64_bits_and_the_right_shapes(jax):
    motion = autodiff.jax_motion(mixed(), at=AT)
    with pytest.raises(ValueError, match=r'^inertia: expected shape \(3, 3\), found \(6,\)'):
        jax.jit(motion)({'inertia': np.ones(6)})
    with pytest.raises(jax.errors.JaxRuntimeError, match='ValueError: inertia: not physical'):
        motion({'inertia': np.diag([1.0, 1.0, 5.0])})
    jax.config.update('jax_enable_x64', False)
    with pytest.raises(ValueError, match='^jax_enable_x64: expected jax.config.update'):
        motion({'attitude': np.ones(4)})
