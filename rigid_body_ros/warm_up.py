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
Compile all kernels in advance: `python3 -m rigid_body_ros.warm_up`.

After an installation, the first start of a node or a command compiles the kernels that it needs
and stores them in the cache of numba. Run this once, as the user who runs the nodes, to do so in
advance: after `colcon build`, or while a container image is built.
"""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory

import numpy as np
from rigid_body_ros.identification.triangles import triangle
from rigid_body_ros.mechanics import euler
from rigid_body_ros.mechanics.bodies import RigidBodies
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import States
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.messages import QUATERNION
from rigid_body_ros.propagation import propagate, propagate_many, Propagator, warm_up
from rigid_body_ros.recording import read
from rigid_body_ros.replay import replay
from rigid_body_ros.runtime.terminal import show
from rigid_body_ros.scene import Scene
from rigid_body_ros.tradeoff import measure

_SCENE = {'inertia.ixx': 1.0, 'inertia.iyy': 2.0, 'inertia.izz': 2.5}
_TORQUES = 'time,tx,ty,tz\n' + ''.join(f'{0.1 * row},1e-3,0,0\n' for row in range(5))
#: Torques of every kind.
_LOGS = {(frame, interpolation): TorqueLog(range(5), [[1.0, 0.0, 0.0]] * 5, frame, interpolation)
         for frame in ('body', 'space') for interpolation in ('hold', 'cubic')}
_WHEELS = _LOGS['body', 'hold']
_IN_TWO_FRAMES = [[_LOGS['body', interpolation], _LOGS['space', interpolation]]
                  for interpolation in ('hold', 'cubic')]


def main() -> None:
    """Use every kernel once, those for many motions in a process of their own."""
    if sys.argv[1:]:
        _use_for_many()
        return
    show('compiling the kernels: usually about a minute, once after each installation')
    with subprocess.Popen([sys.executable, '-m', 'rigid_body_ros.warm_up', 'many']) as beside:
        _use_for_one()
    if beside.returncode:
        sys.exit(beside.returncode)
    _use_for_files()
    show('all kernels are compiled')


def _use_for_one() -> None:
    warm_up()
    body, start = RigidBody.from_moments(1.0, 2.0, 2.5), State(rotor_momentum=(1.0, 0.0, 0.0))
    Propagator(body, start).at(1)
    propagate(body, start, at=[1])
    propagate(body, start, at=[0, 5], wheels=_WHEELS)
    for logs in _IN_TWO_FRAMES:
        propagate(body, State(), logs, at=[5])
        motion = propagate(body, start, logs, at=[0, 5], wheels=_WHEELS)
    motion.euler_angles(continuous=True)
    motion.rotor_momentum  # noqa: B018
    euler.to_quaternion([[0.1, 0.2, 0.3]], 'zxz')


def _use_for_many() -> None:
    triangle(np.eye(3))
    bodies = RigidBodies([np.eye(3)] * 2, [np.eye(3), np.zeros((3, 3))])
    starts = States(0, np.ones((2, 4)))
    propagate_many(bodies, starts, at=[5])
    for logs in _IN_TWO_FRAMES:
        propagate_many(bodies, starts, [logs] * 2, at=[5])
        for some in (logs, logs[:1]):
            propagate_many(bodies, starts, [some] * 2, at=[5], wheels=_WHEELS)


def _use_for_files() -> None:
    scene = Scene.from_values(_SCENE)
    with TemporaryDirectory() as folder:
        torques, recording = Path(folder, 'torques.csv'), Path(folder, 'motion.mcap')
        torques.write_text(_TORQUES)
        replay(torques, scene, recording)
        read(recording, '/attitude', QUATERNION)
    measure(scene.problem(start=State(angular_velocity=(0.1, 0.2, 0.3))), seconds=0.0)


if __name__ == '__main__':
    main()
else:  # `rigid_body_ros.warm_up` is a function
    sys.modules[__name__] = warm_up  # type: ignore[assignment]
