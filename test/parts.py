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

"""Bodies, a start, fields and wheels that tests in several files use."""

from dataclasses import replace

import numpy as np
from rigid_body_ros import GravityGradient, RigidBody, State, UniformField, Wheel

BODY = RigidBody([[1.1, 0.15, -0.2], [0.15, 2.0, 0.05], [-0.2, 0.05, 2.7]])
DAMPED = RigidBody(BODY.inertia, np.diag([0.01, 0.02, 0.03]))
SMALLER = RigidBody.from_moments(0.9, 1.6, 1.9, 0.05, -0.1)
START = State(0, (0.1, -0.3, 0.2, 0.9), (0.5, -0.7, 0.9))
FIELDS = [UniformField((0.1, -0.2, 0.3), (0.4, -0.2, -2.5)),
          GravityGradient(0.4, (1.0, 2.0, 3.0), (3.0, 0.0, -1.0)),
          UniformField((-0.3, 0.4, 0.1), (1.5, 0.5, 0.25))]
#: Four wheels in a pyramid. Those of LIMITED have largest speeds, which one of them exceeds. Those
#: of SLOWED also have friction, except for one.
FREE = [Wheel(name, axis, 0.05, speed, max_torque=0.3) for name, axis, speed in (
    ('a', (1, 1, 1), 0.0), ('b', (-1, 1, 1), 12.0), ('c', (-1, -1, 1), -3.0),
    ('d', (1, -1, 1), 9.0))]
LIMITED = [replace(wheel, max_speed=10.0) for wheel in FREE]
SLOWED = [replace(wheel, friction=friction)
          for wheel, friction in zip(LIMITED, (0.02, 0.05, 0.0, 0.01))]
