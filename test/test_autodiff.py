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

"""Gradients by the inputs of a motion: in NumPy, in JAX and in PyTorch."""

import subprocess
import sys

from conftest import SECOND
from derivatives_truth import FULL
import numpy as np
import pytest
from rigid_body_ros import (
    Actuator,
    autodiff,
    EffortLog,
    Problem,
    RigidBody,
    State,
    TorqueLog,
    Wheel,
)
from test_derivatives import WEIGHTS

AT = np.array([9, 2, 5, 9]) * SECOND + 7
INPUTS = {'inertia': FULL, 'damping': np.diag([0.02, 0.03, 0.01]) + 0.005,
          'attitude': [0.2, -0.8, 0.5, 1.0], 'angular_velocity': [0.5, -0.7, 0.9],
          'rotor_momentum': [0.3, -0.2, 0.1]}


def problem(count=40, start_ns=3 * SECOND // 2, **options):
    """Return a problem that begins between samples, with another log in space axes and rotors."""
    random = np.random.default_rng(5)
    logs = [TorqueLog(np.arange(count) * SECOND // 4, 0.2 * random.normal(size=(count, 3)),
                      frame, interpolation)
            for frame, interpolation in (('body', 'hold'), ('space', 'linear'), ('body', 'cubic'))]
    return Problem(RigidBody(FULL, INPUTS['damping']),
                   State(start_ns, (0.0, 0.0, 0.0, 1.0), INPUTS['angular_velocity']),
                   logs[:2], wheels=logs[2], **options)


def with_named_wheels():
    wheels = [Wheel('a', (1.0, 0.0, 0.0), 0.1, 20.0), Wheel('b', (0.6, 0.0, 0.8), 0.05)]
    return Problem(RigidBody(FULL, INPUTS['damping']), State(wheel_speeds=(9.0, -5.0)),
                   problem().logs, wheels=wheels,
                   efforts=EffortLog([0, SECOND], [[0.1, -0.2], [0.0, 0.3]]))


def pulls(count, *leading):
    random = np.random.default_rng(3)
    return random.normal(size=(*leading, count, 4)), random.normal(size=(*leading, count, 3))


@pytest.mark.parametrize('given', [
    problem(), problem(start_ns=-SECOND), problem(torque_timeout=0.1), with_named_wheels()],
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
    given = problem()
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
    given = problem()
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
    inputs = {**INPUTS, 'torques': problem().logs[0].torques}
    _, pull = autodiff.vjp(problem(), inputs, at=AT)
    return inputs, pull(np.ones((len(AT), 4)), np.ones((len(AT), 3)))


@pytest.mark.slow
def test_torch_has_these_gradients(torch, of_numpy):
    inputs, known = of_numpy
    tensors = {name: torch.tensor(np.array(values), requires_grad=True)
               for name, values in inputs.items()}
    attitude, rate = autodiff.torch_motion(problem(), at=AT)(tensors)
    (attitude.sum() + rate.sum()).backward()
    for name in known:
        assert np.array_equal(tensors[name].grad.numpy(), known[name])
    with pytest.raises(ValueError, match='^attitude: expected a tensor of torch.float64, found '
                                         'torch.float32$'):
        autodiff.torch_motion(problem(), at=AT)({'attitude': torch.ones(4)})


@pytest.mark.slow
def test_torch_finds_the_gradients_right(torch):
    given = problem(count=12)
    inputs = {**INPUTS, 'torques': given.logs[0].torques}
    motion = autodiff.torch_motion(given, at=[4 * SECOND, 2 * SECOND])

    def outputs(*values):
        named = dict(zip(inputs, values))
        return motion({**named, **{name: 0.5 * (named[name] + named[name].T)
                                   for name in ('inertia', 'damping')}})
    tensors = [torch.tensor(np.array(values), requires_grad=True) for values in inputs.values()]
    assert torch.autograd.gradcheck(outputs, tensors, eps=1e-5, atol=1e-8, rtol=1e-7)


@pytest.mark.slow
def test_jax_has_these_gradients(jax, of_numpy):
    inputs, known = of_numpy
    motion = autodiff.jax_motion(problem(), at=AT)

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
    motion = autodiff.jax_motion(problem(), at=AT)
    found = jax.jit(jax.vmap(lambda rate: motion({'angular_velocity': rate})[0]))(rates)
    for attitude, rate in zip(found, rates):
        known, _ = autodiff.vjp(problem(), {'angular_velocity': rate}, at=AT)
        assert np.array_equal(attitude, known.attitude)


@pytest.mark.slow
def test_jax_needs_floats_of_64_bits_and_the_right_shapes(jax):
    motion = autodiff.jax_motion(problem(), at=AT)
    with pytest.raises(ValueError, match=r'^inertia: expected shape \(3, 3\), found \(6,\)'):
        jax.jit(motion)({'inertia': np.ones(6)})
    with pytest.raises(jax.errors.JaxRuntimeError, match='ValueError: inertia: not physical'):
        motion({'inertia': np.diag([1.0, 1.0, 5.0])})
    jax.config.update('jax_enable_x64', False)
    with pytest.raises(ValueError, match='^jax_enable_x64: expected jax.config.update'):
        motion({'attitude': np.ones(4)})
