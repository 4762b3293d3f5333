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

`estimation` has the public function and `result` what it returns. `experiment` has the recordings,
`names` and `parameters` the parameters, `clock` a first guess of the clock offset, `windows` the
predictions, `actuator` and `sensors` the models of torques and measurements, `setup` the inputs of
a fit, `problem` the least-squares problem, `solve` the fit, `residuals` its errors, and
`identifiability` the parameters that the data does not determine. `findings` tests the remaining
errors, with their `noise` and the `evidence` close to the solution; `suspects` are parameters that
were not estimated, and `verdict` says whether the model explains the measurements. The command
reads and writes with `recorded`, and prints with `summary`.
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
