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

"""Turn torques into attitude: the rotation of one rigid body, exact to rounding."""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from rigid_body_ros.bodies import RigidBodies
    from rigid_body_ros.body import RigidBody
    from rigid_body_ros.identification import Experiment, identify
    from rigid_body_ros.measurement import compare, Measured, read_measured
    from rigid_body_ros.propagation import (
        propagate,
        propagate_many,
        Propagator,
        Trajectories,
        Trajectory,
        warm_up,
    )
    from rigid_body_ros.state import State
    from rigid_body_ros.states import States
    from rigid_body_ros.torque import TorqueLog
else:
    # Importing the engine takes most of a second, and commands must handle signals before.
    _SUBMODULES = ('bodies', 'body', 'common', 'euler', 'identification', 'kernels', 'measurement',
                   'propagation', 'so3', 'state', 'states', 'torque', 'urdf')
    #: The submodule of each public name.
    _HOMES = {'RigidBodies': 'bodies', 'States': 'states', 'propagate_many': 'propagation',
              'Trajectories': 'propagation', 'RigidBody': 'body', 'State': 'state',
              'TorqueLog': 'torque',
              'Propagator': 'propagation', 'Trajectory': 'propagation',
              'propagate': 'propagation', 'warm_up': 'propagation', 'Measured': 'measurement',
              'compare': 'measurement', 'read_measured': 'measurement',
              'Experiment': 'identification', 'identify': 'identification'}

    def __getattr__(name: str) -> Any:
        """Import a submodule or a public name when it is first used."""
        if name in _SUBMODULES:
            return import_module(f'{__name__}.{name}')
        if name not in _HOMES:
            raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
        value = getattr(import_module(f'{__name__}.{_HOMES[name]}'), name)
        return globals().setdefault(name, value)

    def __dir__() -> list[str]:
        return sorted({*globals(), *_SUBMODULES, *_HOMES})

__all__ = ['Experiment', 'Measured', 'Propagator', 'RigidBodies', 'RigidBody', 'State', 'States',
           'TorqueLog', 'Trajectories', 'Trajectory', 'compare', 'identify', 'propagate',
           'propagate_many', 'read_measured', 'warm_up']
