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

"""The classical fixed-step solvers: orders, conserved quantities, and too long steps."""

from conftest import chord, SECOND
from known import lost_momentum, ODE_LOSSES
import numpy as np
from parts import BODY, FIELDS, START
import pytest
from rigid_body_ros import propagate, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import so3
from rigid_body_ros.propagation.options import solver_named

END = 5 * SECOND
STAMPS = np.arange(6) * SECOND
TORQUES = np.random.default_rng(1).normal(scale=0.4, size=(6, 3))
LOGS = [TorqueLog(STAMPS, TORQUES, interpolation='linear'),
        TorqueLog(STAMPS + SECOND // 2, TORQUES[::-1], 'space', 'cubic')]
SCENES = {
    'free': {},
    'body torque': {'log': TorqueLog(STAMPS, TORQUES)},
    'space torque': {'log': TorqueLog(STAMPS, TORQUES, 'space')},
    'cubic body torque': {'log': TorqueLog(STAMPS, TORQUES, interpolation='cubic')},
    'torques in two frames': {'log': LOGS},
    'fields': {'fields': FIELDS, 'log': TorqueLog(STAMPS, TORQUES)},
}
#: Scenes with terms that `strang` does not take.
MORE = {
    'rotors and damping': {
        'log': LOGS, 'wheels': TorqueLog(STAMPS, TORQUES),
        'body': RigidBody(BODY.inertia, np.diag([0.3, 0.2, 0.1])),
        'start': State(0, START.attitude, START.angular_velocity, (0.2, 0.4, -0.3))}}
MORE['everything'] = {**MORE['rotors and damping'], 'fields': FIELDS}
#: The order of each solver, and its steps: a second divided by powers of two, in whole
#: nanoseconds, and coarse enough for errors far above rounding.
LADDERS = {'explicit_euler': (1, 2.0 ** -np.arange(5, 10)),
           'strang': (2, 2.0 ** -np.arange(4, 10)),
           'rk4': (4, 2.0 ** -np.arange(3, 9))}
SOLVERS = list(LADDERS)


def moved(solver, step, at=(END,), **scene):
    return propagate(**{'body': BODY, 'start': START, **scene}, at=at, solver=solver,
                     max_step=step)


def slope(steps, errors):
    """Return the order of the errors in the step, and the correlation with a power law."""
    x, y = np.log(steps), np.log(errors)
    return np.polyfit(x, y, 1)[0], np.corrcoef(x, y)[0, 1]


def drift(values):
    """Return the largest relative difference of values from the first of them."""
    apart = (values - values[0]).reshape(len(values), -1)
    return np.linalg.norm(apart, axis=1).max() / np.linalg.norm(values[0])


@pytest.mark.parametrize(('solver', 'scene'), [
    (solver, name) for solver in SOLVERS for name in {**SCENES, **MORE}
    if solver != 'strang' or name in SCENES])
def test_the_order_is_the_one_promised(solver, scene):
    (order, steps), given = LADDERS[solver], {**SCENES, **MORE}[scene]
    assert solver_named(solver).order == order
    truth = moved('taylor', None, **given)
    motions = [moved(solver, step, **given) for step in steps]
    attitude = [chord(truth.attitude, motion.attitude)[0] for motion in motions]
    rates = [np.linalg.norm(motion.angular_velocity - truth.angular_velocity)
             for motion in motions]
    for errors in (attitude, rates):
        found, correlation = slope(steps, errors)
        assert abs(found - order) < 0.2
        assert correlation > 0.999


@pytest.mark.parametrize('solver', SOLVERS)
def test_no_torque_acts_on_a_turned_rod_after_the_timeout(solver):
    # For a rod, the kernels also use the rounding errors of the coefficients of the torque.
    axis = so3.normalize([0.3, -0.1, 0.7])
    body = RigidBody(np.eye(3) - (1.0 - 1e-6) * np.outer(axis, axis))
    across = TORQUES - np.outer(TORQUES @ axis, axis)
    log = TorqueLog(STAMPS, across, interpolation='cubic')
    options = {'solver': solver, 'max_step': 1e-3}
    times = [3 * SECOND + SECOND // 2, 4 * SECOND - 1]
    motion = propagate(body, START, log, at=times, torque_timeout=0.5, **options)
    silent = State(times[0], motion.attitude[0], motion.angular_velocity[0])
    coast = propagate(body, silent, at=times[1:], **options)
    np.testing.assert_array_equal(motion.attitude[1:], coast.attitude)
    np.testing.assert_array_equal(motion.angular_velocity[1:], coast.angular_velocity)


@pytest.mark.parametrize('step', ODE_LOSSES)
def test_explicit_euler_loses_the_momentum_that_ode_loses(step):
    # ODE turns the attitude by the rates after the step, and this method by those before, which
    # explains the 3 %.
    assert lost_momentum('explicit_euler', step) == pytest.approx(ODE_LOSSES[step], rel=0.03)


@pytest.mark.parametrize('body', [RigidBody.from_moments(1.1, 2.0, 2.7), BODY])
def test_strang_keeps_the_momentum_in_space_and_bounds_the_energy(body):
    # 160 000 steps. The momentum changes by less than half a rounding unit per step, most for a
    # full tensor, which is turned to its axes and back each time. The energy must not drift at
    # all.
    motion = moved('strang', 1 / 16, at=np.arange(0, 10_001) * SECOND, body=body)
    size = np.linalg.norm(body.angular_momentum(motion.angular_velocity), axis=1)
    assert drift(motion.angular_momentum_space) < 1e-16 * 160_000
    assert drift(size) < 1e-16 * 160_000
    error = np.abs(motion.kinetic_energy / motion.kinetic_energy[0] - 1.0)
    assert 1e-5 < error.max() < 1.01 * error[:1000].max()


@pytest.mark.parametrize('solver', ['explicit_euler', 'rk4'])
def test_a_run_that_blows_up_is_refused(solver):
    with pytest.raises(ValueError, match=f'steps of 10 s may be too long for {solver}'):
        moved(solver, 10.0, at=[200 * SECOND])


def test_strang_never_blows_up():
    # The conserved momentum limits the energy: it is largest for a spin about the smallest moment.
    smallest, _, largest = BODY.principal_moments
    for step in (0.5, 5.0, 1e3):
        motion = moved('strang', step, at=np.arange(0, 200) * round(step * SECOND))
        assert drift(motion.angular_momentum_space) < 1e-13
        assert motion.kinetic_energy.max() < largest / smallest * motion.kinetic_energy[0]
