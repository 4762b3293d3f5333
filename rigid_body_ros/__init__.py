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

"""Compute the attitude of a rigid body from torques, exact to rounding."""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from rigid_body_ros.comparison import compare, Measured, read_measured
    from rigid_body_ros.identification import Experiment, identify
    from rigid_body_ros.mechanics.actuator import Actuator
    from rigid_body_ros.mechanics.bodies import RigidBodies
    from rigid_body_ros.mechanics.body import RigidBody
    from rigid_body_ros.mechanics.changes import BodyLog
    from rigid_body_ros.mechanics.efforts import EffortLog
    from rigid_body_ros.mechanics.fields import GravityGradient, UniformField
    from rigid_body_ros.mechanics.state import State
    from rigid_body_ros.mechanics.states import States
    from rigid_body_ros.mechanics.torque import TorqueLog
    from rigid_body_ros.mechanics.wheels import Wheel
    from rigid_body_ros.propagation import (
        Problem,
        propagate,
        propagate_many,
        Propagator,
        Trajectories,
        Trajectory,
    )
    from rigid_body_ros.recording.problem import read
    from rigid_body_ros.runtime.deprecated import warm_up
    from rigid_body_ros.runtime.fingerprint import build_info
else:
    # Importing the engine takes a while, and the commands must be able to handle signals before
    # the engine is loaded. Each public name is therefore imported only when it is first used.
    #: The module that defines each public name. Public modules are listed under their own names.
    _HOMES = {'RigidBodies': 'mechanics.bodies', 'RigidBody': 'mechanics.body',
              'Actuator': 'mechanics.actuator', 'BodyLog': 'mechanics.changes',
              'State': 'mechanics.state', 'States': 'mechanics.states',
              'GravityGradient': 'mechanics.fields', 'UniformField': 'mechanics.fields',
              'TorqueLog': 'mechanics.torque', 'EffortLog': 'mechanics.efforts',
              'Wheel': 'mechanics.wheels', 'euler': 'mechanics.euler',
              'frames': 'mechanics.frames', 'so3': 'mechanics.so3', 'urdf': 'mechanics.urdf',
              'Propagator': 'propagation', 'Trajectories': 'propagation',
              'Trajectory': 'propagation', 'propagate': 'propagation',
              'propagate_many': 'propagation', 'build_info': 'runtime.fingerprint',
              'warm_up': 'runtime.deprecated',
              'Problem': 'propagation', 'read': 'recording.problem',
              'Measured': 'comparison', 'compare': 'comparison', 'read_measured': 'comparison',
              'Experiment': 'identification', 'identify': 'identification',
              **{package: package for package in (
                  'common', 'comparison', 'identification', 'kernels', 'mechanics',
                  'propagation')}}

    def __getattr__(name: str) -> Any:
        """Import a module or a public name when it is first used."""
        if name not in _HOMES:
            raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
        found = import_module(f'{__name__}.{_HOMES[name]}')
        value = found if found.__name__.endswith(f'.{name}') else getattr(found, name)
        return globals().setdefault(name, value)

    def __dir__() -> list[str]:
        return sorted({*globals(), *_HOMES})

__all__ = ['Actuator', 'BodyLog', 'EffortLog', 'Experiment', 'GravityGradient', 'Measured',
           'Problem', 'Propagator', 'RigidBodies', 'RigidBody', 'State', 'States', 'TorqueLog',
           'Trajectories', 'Trajectory', 'UniformField', 'Wheel', 'build_info', 'compare',
           'identify', 'propagate', 'propagate_many', 'read', 'read_measured', 'warm_up']
