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
Compute motions from a start state and torque logs, with the time loop in `kernels.loop`.

A *segment* runs from one torque change to the next. Consecutive samples of zero torque form one
segment, a *coast*. Within a segment, steps end on a grid, which begins with the segment and
depends only on the state at the beginning of the segment, the torque and the options. To get the
motion at a time between two grid points, the loop takes an extra step from the last grid point
before that time. No later state depends on this extra step. Therefore the results are the same,
bit for bit, whichever times are requested and in whatever order. `propagate` and `Propagator`
agree bit for bit for the same reason.
"""

from rigid_body_ros.common.times import LONGEST
from rigid_body_ros.propagation.crossings import Crossings
from rigid_body_ros.propagation.integration import Integration
from rigid_body_ros.propagation.many import propagate_many, Trajectories
from rigid_body_ros.propagation.models import AtLimit, Model
from rigid_body_ros.propagation.options import Options, Solver, SOLVERS, TOLERANCES
from rigid_body_ros.propagation.problem import Problem, propagate
from rigid_body_ros.propagation.propagator import Propagator
from rigid_body_ros.propagation.trajectory import Derivatives, Trajectory

__all__ = ['LONGEST', 'SOLVERS', 'TOLERANCES', 'AtLimit', 'Crossings', 'Derivatives',
           'Integration', 'Model', 'Options', 'Problem', 'Propagator', 'Solver', 'Trajectories',
           'Trajectory', 'propagate', 'propagate_many']
