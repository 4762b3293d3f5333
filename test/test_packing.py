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

"""The kernels unpack exactly what Python packs: bodies, states, motions, options and progress."""

import numpy as np
import pytest
from rigid_body_ros import propagate, Propagator, RigidBody
from rigid_body_ros.kernels import body_layout, layout, motion_layout, state_layout
from rigid_body_ros.propagation import Options, Problem
from rigid_body_ros.propagation.options import RECORDS

BODY = RigidBody.from_moments(1.1, 2.0, 2.7, 0.15, -0.2, 0.05)


def coefficients(constants):
    high, low, products, torques, _ = body_layout.coefficients(
        constants, layout.form_of(constants))
    found, diagonals = np.zeros((2, 3, 9)), np.zeros((2, 3))
    for k in range(3):
        diagonals[0, k], diagonals[1, k] = products[k], torques[k]
        for column in range(9):
            found[0, k, column], found[1, k, column] = high[column][k], low[column][k]
    return found, diagonals


def principal(constants):
    moments, lost_moments, axes, lost_axes = body_layout.principal_frame(constants)
    found, directions = np.zeros((2, 3)), np.zeros((2, 3, 3))
    for k in range(3):
        found[0, k], found[1, k] = moments[k], lost_moments[k]
        for axis in range(3):
            directions[0, k, axis], directions[1, k, axis] = axes[axis][k], lost_axes[axis][k]
    return found, directions


def test_a_kernel_reads_the_constants_of_a_body():
    constants = BODY._constants
    assert len(constants) == body_layout.SIZE
    found, diagonals = coefficients(constants)
    np.testing.assert_array_equal(found, BODY._coefficients)
    for k in range(3):
        assert diagonals[0, k] == BODY._coefficients[0, k, k]
        assert diagonals[1, k] == BODY._coefficients[0, k, 6 + k]
    for found, given in zip(principal(constants), BODY._principal):
        np.testing.assert_array_equal(found, given)


def test_what_rounding_took_from_the_inverse_is_where_its_name_says():
    np.testing.assert_array_equal(
        BODY._constants[body_layout.LOST_INVERSE].reshape(3, 4)[:, :3].T,
        BODY._coefficients[1, :, 6:])


def copied(states, out, motion):
    state = state_layout.load(states, state_layout.WITH_WHEELS)
    state_layout.store(state, out, 0)
    motion_layout.store(state, 1, motion)


def test_a_kernel_reads_and_writes_states_and_motions():
    rates, attitude, lost = [1.0, 2.0, 3.0], [0.1, 0.2, 0.3, 0.9], [1e-17, 2e-17, 3e-17]
    packed = state_layout.pack(rates, attitude, lost)
    states, out = np.concatenate([np.zeros_like(packed), packed]), np.zeros(len(packed))
    motion = motion_layout.allocate(3)
    copied(states, out, motion)
    np.testing.assert_array_equal(out, packed)
    np.testing.assert_array_equal(state_layout.angular_velocity(out), rates)
    np.testing.assert_array_equal(state_layout.attitude(out), attitude)
    np.testing.assert_array_equal(motion_layout.attitude(motion)[1], attitude)
    np.testing.assert_array_equal(motion_layout.angular_velocity(motion)[1], rates)
    assert motion_layout.attitude(motion).shape == (3, 4)
    assert motion_layout.angular_velocity(motion).shape == (3, 3)


@pytest.mark.parametrize('solver', RECORDS, ids=lambda solver: solver.name)
@pytest.mark.parametrize('max_step', [1e-9, 0.3, 1e6 + 1e-9, 1e300])
def test_a_kernel_reads_the_options_exactly(solver, max_step):
    options = Options(solver.name, 1e-7, max_step, 1e9 - 1e-9)
    method = layout.load_method(options.method)
    assert method.solver == solver.code
    assert method.fixed_step == solver.fixed_step
    assert method.closed_form_beyond == solver.closed_form_beyond
    assert method.tolerance == 1e-7
    assert method.max_step_ns == options.max_step_ns


def test_a_kernel_reads_and_writes_progress():
    states = np.random.default_rng(0).normal(size=(2, state_layout.WITH_WHEELS))
    given = layout.begun(states[0], 2 ** 62 + 1, states[1], -5, -1, 7)
    assert layout.load_place(given) == (2 ** 62 + 1, -5, -1, 0)
    progress = np.zeros(1, layout.PROGRESS)
    layout.store_place(layout.load_place(given), progress)
    layout.store_states(layout.load_states(given), progress)
    for name in ('grid_ns', 'begin_ns', 'row', 'done'):
        np.testing.assert_array_equal(progress[name], given[name])
    for name in ('grid', 'begin', 'latest'):  # the kernels write the momenta of wheels separately
        np.testing.assert_array_equal(*(each[name][:, :state_layout.SIZE]
                                        for each in (progress, given)))
    assert (given['stop'], given['budget']) == (7, layout.BUDGET)


def test_the_options_are_frozen_and_their_defaults_are_those_of_every_entry():
    with pytest.raises(AttributeError):
        Options().solver = 'rk4'
    for entry in (propagate, Propagator.__init__, Problem.__init__):
        defaults = entry.__kwdefaults__
        assert Options(*(defaults[name] for name in (
            'solver', 'tolerance', 'max_step', 'torque_timeout'))) == Options()
