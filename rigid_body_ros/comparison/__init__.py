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
Compare measured motions with a propagated or recorded motion.

`motion` defines the motion to compare with. `align` starts from the guess of `coarse`, and fits
clock offsets, mountings and the start of the motion. `comparison` computes the errors. `horizons`
computes the errors after restarts. `predictable` computes the time over which errors are
meaningful.

`causes` looks for likely causes of the errors among the `sensor_faults` and the `torque_faults`.
It undoes each possible cause, and judges the cause by the errors that remain in the `channels`.

The command `attitude_compare` reads its files with `recorded`, and writes files with `outputs`.
`result` generates the text that the command prints.
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
