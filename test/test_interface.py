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

"""
The public Python interface: every name, with its parameters and defaults, is in interface.txt.

After an intended change, write the file again: python test/test_interface.py > test/interface.txt
"""

import inspect
from pathlib import Path
from types import FunctionType

import numpy as np
import pytest
import rigid_body_ros
from rigid_body_ros import autodiff, Problem, propagate, Propagator, RigidBody, State, TorqueLog
from rigid_body_ros.mechanics import euler, so3, urdf
from rigid_body_ros.propagation import Options

#: Attributes of a trajectory over m times, with shape and type.
TRAJECTORY = {
    'times_ns': ((2,), np.int64), 'attitude': ((2, 4), float), 'angular_velocity': ((2, 3), float),
    'rotor_momentum': ((2, 3), float), 'angular_momentum_space': ((2, 3), float),
    'kinetic_energy': ((2,), float), 'wheel_speeds': ((2, 0), float),
}


def signature(function):
    """Return the parameters and defaults of a function, without annotations."""
    found = inspect.signature(function)
    return str(found.replace(return_annotation=inspect.Signature.empty, parameters=[
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in found.parameters.values()]))


def members(name, cls):
    """Generate a class with its parameters, and its public methods and attributes."""
    yield f'{name}{signature(cls)}'
    for member, value in sorted(vars(cls).items()):
        function = getattr(value, '__func__', value)
        if not member.startswith('_'):
            yield f'{name}.{member}' + (
                signature(function) if isinstance(function, FunctionType) else '')


def interface():
    """Return the public names of the package, and of its modules of functions."""
    found = []
    for name in rigid_body_ros.__all__:
        value = getattr(rigid_body_ros, name)
        found += members(name, value) if isinstance(value, type) else [f'{name}{signature(value)}']
    for module in (autodiff, euler, so3, urdf):
        place = module.__name__.removeprefix('rigid_body_ros.')
        found += [f'{place}.{name}{signature(value)}' for name, value in vars(module).items()
                  if isinstance(value, FunctionType) and value.__module__ == module.__name__
                  and not name.startswith('_')]
    return sorted(found)


def test_names_parameters_and_defaults_are_those_of_the_file():
    assert interface() == Path(__file__).with_name('interface.txt').read_text().splitlines()
    assert (rigid_body_ros.so3, rigid_body_ros.euler) == (so3, euler)


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


if __name__ == '__main__':
    print(*interface(), sep='\n')
