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
Identify the parameters of a body from measurements.

`estimation` defines the public function `identify`. `result` defines the class that `identify`
returns.

These modules prepare the inputs: `experiment` defines recordings. `names` and `parameters` define
the parameters to fit. `clock` guesses the clock offset. `setup` combines the inputs of a fit.

These modules compute the fit: `windows` predicts the measurements, and uses the models of torques
and sensors in `actuator` and `sensors`. `problem` defines the least-squares problem, and `solve`
solves it. `residuals` defines the remaining errors. `identifiability` finds the parameters that
the data does not determine.

These modules judge the model: `findings` tests the remaining errors, and uses the linearized fit
of `evidence`. `suspects` tries parameters that were not estimated. `verdict` decides whether the
model explains the measurements.

The command `attitude_identify` reads and writes files with `recorded`, and reports the result with
`result`, `page` and `plot`.
"""

from rigid_body_ros.identification.estimation import identify
from rigid_body_ros.identification.experiment import Experiment
from rigid_body_ros.identification.identifiability import Direction
from rigid_body_ros.identification.residuals import Misfit, Residuals
from rigid_body_ros.identification.result import Estimate, Identification
from rigid_body_ros.identification.suspects import Suspect
from rigid_body_ros.identification.verdict import Verdict

__all__ = ['Direction', 'Estimate', 'Experiment', 'Identification', 'Misfit', 'Residuals',
           'Suspect', 'Verdict', 'identify']
