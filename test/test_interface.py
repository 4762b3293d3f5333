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

"""The public Python interface: every name, with its parameters and defaults."""

import inspect

import numpy as np
import pytest
import rigid_body_ros
from rigid_body_ros import (
    autodiff,
    BodyLog,
    build_info,
    EffortLog,
    Experiment,
    GravityGradient,
    identify,
    Problem,
    propagate,
    propagate_many,
    Propagator,
    read,
    RigidBody,
    State,
    States,
    TorqueLog,
    UniformField,
    warm_up,
    Wheel,
)
from rigid_body_ros.mechanics import euler, so3, urdf
from rigid_body_ros.propagation import Options

OPTIONS = "solver='auto', tolerance=1e-15, max_step=None, torque_timeout=0.0"
#: Callables, with their parameters as callers may use them.
SIGNATURES = [
    (RigidBody, 'tensor, damping=None'),
    (RigidBody.from_moments, 'ixx, iyy, izz, ixy=0.0, ixz=0.0, iyz=0.0'),
    (RigidBody.from_point_masses, 'masses, positions'),
    (RigidBody.from_urdf, "text, link=''"),
    (urdf.fixed_frames, "text, link=''"),
    (State, 'time_ns=0, attitude=(0.0, 0.0, 0.0, 1.0), angular_velocity=(0.0, 0.0, 0.0), '
            'rotor_momentum=(0.0, 0.0, 0.0), wheel_speeds=()'),
    (Wheel, 'name, axis, inertia, initial_speed=0.0, friction=0.0, max_torque=0.0, '
            'max_speed=0.0'),
    (EffortLog, 'times_ns, efforts'),
    (TorqueLog, "times_ns, torques, frame='body', interpolation='hold'"),
    (UniformField, "moment, field, name=''"),
    (GravityGradient, 'mean_motion, position=(1.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), '
                      'time_ns=None'),
    (TorqueLog.from_momentum, 'times_ns, momenta'),
    (Problem, 'body, start, log=None, *, wheels=None, efforts=None, fields=(), changes=None, '
              f'actuator=None, {OPTIONS}'),
    (Problem.propagate, 'self, *, at'),
    (Problem.derivatives, 'self, names, *, at'),
    (autodiff.vjp, 'problem, inputs, *, at'),
    (autodiff.jax_motion, 'problem, *, at'),
    (autodiff.torch_motion, 'problem, *, at'),
    (read, 'path, scene, *, topic=None, wheel_torque=None, wheel_momentum=None, '
           "wheel_command=None, inertia=None, interpolation=None, time_source='header', "
           'columns=None'),
    (propagate, 'body, start, log=None, *, at, wheels=None, efforts=None, fields=(), '
                f'changes=None, actuator=None, {OPTIONS}, derivatives=()'),
    (propagate_many, 'bodies, starts, log=None, *, at, wheels=None, fields=(), torque_gains=None, '
                     f'{OPTIONS}'),
    (States, 'time_ns=0, attitude=(0.0, 0.0, 0.0, 1.0), angular_velocity=(0.0, 0.0, 0.0), '
             'rotor_momentum=(0.0, 0.0, 0.0)'),
    (Propagator, 'body, start, *, wheels=None, fields=(), actuator=None, '
                 f'{OPTIONS}, history=1.0'),
    (Propagator.apply, "self, time_ns, torque, frame='body', source=0"),
    (Propagator.apply_wheels, 'self, time_ns, torque'),
    (Propagator.torque, 'self, state'),
    (Propagator.apply_body, "self, time_ns, body, keep='rate'"),
    (Propagator.apply_efforts, 'self, time_ns, efforts'),
    (BodyLog, "times_ns, bodies, keep='rate'"),
    (build_info, ''),
    (warm_up, ''),
    (Experiment, 'start, log, measured, wheels=None, fields=(), efforts=None, torques=None'),
    (identify, "body, experiments, *, estimate=('inertia', 'start'), attitude_noise=None, "
               'rate_noise=None, validate=0.0, priors=None, gravity=(0.0, 0.0, -9.80665), '
               'accept=None, torque_timeout=0.0'),
]
#: Attributes of a trajectory over m times, with shape and type.
TRAJECTORY = {
    'times_ns': ((2,), np.int64), 'attitude': ((2, 4), float), 'angular_velocity': ((2, 3), float),
    'rotor_momentum': ((2, 3), float), 'angular_momentum_space': ((2, 3), float),
    'kinetic_energy': ((2,), float), 'wheel_speeds': ((2, 0), float),
}


@pytest.mark.parametrize(('function', 'parameters'), SIGNATURES,
                         ids=[function.__qualname__ for function, _ in SIGNATURES])
def test_parameters_and_defaults_are_those_documented(function, parameters):
    signature = inspect.signature(function)
    plain = signature.replace(return_annotation=inspect.Signature.empty, parameters=[
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in signature.parameters.values()])
    assert str(plain) == f'({parameters})'


def test_the_top_level_has_these_names():
    assert sorted(rigid_body_ros.__all__) == [
        'Actuator', 'BodyLog', 'EffortLog', 'Experiment', 'GravityGradient', 'Measured', 'Problem',
        'Propagator', 'RigidBodies', 'RigidBody', 'State', 'States', 'TorqueLog', 'Trajectories',
        'Trajectory', 'UniformField', 'Wheel', 'build_info', 'compare', 'identify', 'propagate',
        'propagate_many', 'read', 'read_measured', 'warm_up']
    assert (rigid_body_ros.mechanics.so3, rigid_body_ros.mechanics.euler) == (so3, euler)


def test_a_trajectory_has_these_attributes():
    log = TorqueLog([0], [[0.0, 0.0, 1.0]], frame='space')
    motion = propagate(RigidBody(np.diag([1.0, 2.0, 2.5])), State(), log, at=[0, 10 ** 9])
    found = {name: (getattr(motion, name).shape, getattr(motion, name).dtype)
             for name in TRAJECTORY}
    assert found == TRAJECTORY
    assert motion.rotation.as_quat().shape == (2, 4)
    assert motion.euler_angles('ZXZ', continuous=False).shape == (2, 3)
    assert motion.degenerate('ZXZ').tolist() == [True, True]
    assert [model.solver for model in motion.models] == ['taylor']
    np.testing.assert_allclose(motion.rotation.as_quat(), motion.attitude, rtol=0, atol=4e-16)
    assert repr(motion) == 'Trajectory(2 states from 0 ns on, over 1 s)'
    assert repr(propagate(RigidBody(np.eye(3)), State(), at=[])) == 'Trajectory(no states)'


def test_the_options_are_frozen_and_their_defaults_are_those_of_every_entry():
    with pytest.raises(AttributeError):
        Options().solver = 'rk4'
    for entry in (propagate, Propagator.__init__, Problem.__init__):
        defaults = entry.__kwdefaults__
        assert Options(*(defaults[name] for name in (
            'solver', 'tolerance', 'max_step', 'torque_timeout'))) == Options()
