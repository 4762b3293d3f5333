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

`motion` defines the motions that measurements can be compared with. `align` takes an initial
guess from `coarse` and fits the clock offsets, the mountings and the start of the motion. Then
`comparison` computes the errors of the measurements, and `horizons` computes how far the motion
drifts after a restart from measured states. `predictable` estimates how long a motion can be
predicted at all. Errors after this time say nothing about the model.

`causes` looks for likely causes of the errors. This module takes one possible fault at a time from
`sensor_faults` and `torque_faults`, removes the effect of the fault, and checks whether the errors
that remain look like noise. `channels` describes the errors and their noise.

The command `attitude_compare` reads and writes recordings with `recorded`. The text that it prints
comes from `result`, and the page and the picture from `page`.
"""

from rigid_body_ros.comparison.comparison import compare
from rigid_body_ros.comparison.result import Comparison, Errors
from rigid_body_ros.inference.align import ALIGNMENTS
from rigid_body_ros.inference.alignment import Alignment
from rigid_body_ros.inference.horizons import Horizon
from rigid_body_ros.inference.residual_torque import ResidualTorque
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.recording.measurements import read_measured

__all__ = ['ALIGNMENTS', 'Alignment', 'Comparison', 'Errors', 'Horizon',
           'Measured', 'ResidualTorque', 'compare', 'read_measured']
