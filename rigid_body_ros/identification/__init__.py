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

The entry point is `identify`, in `estimation`, which fits with `inference`. It returns an
`Identification`, which `result` defines with its report. The command `attitude_identify` uses
`recorded` to read and write files.
"""

from rigid_body_ros.identification.estimation import Experiment, identify
from rigid_body_ros.identification.result import Estimate, Identification
from rigid_body_ros.inference.errors import Misfit, Residuals
from rigid_body_ros.inference.evidence import Direction, Suspect
from rigid_body_ros.inference.verdict import Verdict

__all__ = ['Direction', 'Estimate', 'Experiment', 'Identification', 'Misfit', 'Residuals',
           'Suspect', 'Verdict', 'identify']
