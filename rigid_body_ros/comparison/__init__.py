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

`comparison` aligns the measurements, computes their errors, and judges the model, all with the
fits of `inference`. It also estimates for how long a motion can be predicted at all. Later errors
say nothing about the model. `result` is what a comparison found, with its text and its report.
"""

from rigid_body_ros.comparison.comparison import compare
from rigid_body_ros.comparison.result import Comparison, Errors
from rigid_body_ros.inference.align import Alignment
from rigid_body_ros.inference.horizons import Horizon
from rigid_body_ros.inference.residual_torque import ResidualTorque
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.recording.measurements import read_measured

__all__ = ['Alignment', 'Comparison', 'Errors', 'Horizon', 'Measured', 'ResidualTorque',
           'compare', 'read_measured']
