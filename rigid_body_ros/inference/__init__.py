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

`motion` defines what measurements can be compared with. `coordinates` holds the values and charts
of all that can be fitted. `guess` guesses where a fit begins. `windows` are parts of a recording,
and predict what the sensors measure. `setup` checks and holds all inputs of a fit, and divides
recordings into windows. `fit` is the least-squares problem of some windows and its solution, and
`growth` solves it in longer and longer windows. `align` is a fit of clocks, mountings and the
start.

After a fit, `errors` holds what is left. `evidence` linearizes the fit with its `noise`: what does
the data not determine, and which other parameters explain the errors? `findings` judges the
errors: `reasons` tests them, and `hypotheses` undoes faults of a recording. `verdict` says whether
the model explains the measurements.

`residual_torque` is the torque that a model lacks. `horizons` restarts a motion from measured
states, and `monitor`, with `window_error`, does so while messages arrive.
"""
