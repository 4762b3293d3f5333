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

"""Compile the kernels before they are needed."""

import numpy as np
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation.problem import propagate
from rigid_body_ros.propagation.propagator import Propagator


def warm_up() -> None:
    """Compile every kernel, or load the code that an earlier process compiled."""
    body, start = RigidBody(np.eye(3)), State()
    propagate(body, start, TorqueLog([0], [[1.0, 0.0, 0.0]]), at=[1, 2]).euler_angles()
    Propagator(body, start).at(1)
