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
Compare measured motions with the propagated one.

`motion` has the motion to compare with. `align` starts from the guess of `coarse`, and brings both
into one time and one pair of frames. `comparison` returns the errors, `horizons` the errors after
restarts, and `predictable` the time over which errors are meaningful. Each of the `causes` is one
of `sensor_faults` or `torque_faults`, judged by the errors of the `channels` that remain if it is
undone. The command reads with `recorded`, and writes with `outputs`; the `result` prints itself.
"""

from rigid_body_ros.comparison.align import ALIGNMENTS
from rigid_body_ros.comparison.alignment import Alignment
from rigid_body_ros.comparison.causes import Cause
from rigid_body_ros.comparison.comparison import compare
from rigid_body_ros.comparison.errors import Errors
from rigid_body_ros.comparison.horizons import Horizon
from rigid_body_ros.comparison.result import Comparison
from rigid_body_ros.sensing.measured import Measured
from rigid_body_ros.sensing.reading import KINDS, read_all, read_measured
from rigid_body_ros.sensing.residual_torque import ResidualTorque

__all__ = ['ALIGNMENTS', 'KINDS', 'Alignment', 'Cause', 'Comparison', 'Errors', 'Horizon',
           'Measured', 'ResidualTorque', 'compare', 'read_all', 'read_measured']
