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
Fit models to measurements, and judge them.

`motion` defines what measurements can be compared with. `parameters` is the table of all that can
be fitted, and `coordinates` its values and charts. `inputs` checks the inputs of a fit, `guess`
guesses where it begins, and `setup` holds all inputs and divides recordings into `windows`, which
predict what the sensors measure. `fit` is the least-squares problem of some windows, and
`growth` solves it in longer and longer windows, and `solution` is the result. `align` is a fit of
clocks, mountings and the start.

After a fit, `errors` holds what is left and `certainty` what the data does not determine.
`evidence` linearizes the fit, with its `noise`. `findings` judges the errors: `reasons` tests
them, `hypotheses` undoes faults of a recording, and `suspects` are parameters that were not
estimated. `misfit` assesses a model that is a little wrong, and `verdict` says whether the model
explains the measurements.

`residual_torque` is the torque that a model lacks. `horizons` restarts a motion from measured
states, and `monitor`, with `window_error` and `alarms`, does so while messages arrive.
"""
