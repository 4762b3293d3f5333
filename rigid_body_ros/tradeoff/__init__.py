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
Speed against accuracy: every solver over a ladder of settings, on the user's own motion.

All settings run over a *stretch*: the motion, or its beginning of up to about ten thousand radians
or samples. They are compared with a reference there: the Taylor series at its tightest tolerance
with shorter steps. The *rounding floor* is the largest difference between the reference and
motions that round differently: the series with other steps and in principal axes, and, without
torque, the closed form. If a change of the last digits of inertia, torques and start moves the
motion by more than the floor, no solver guarantees a smaller error than that. A setting that meets
a target on the stretch is recommended only if it also meets the target on the whole motion.
"""

from rigid_body_ros.tradeoff.choices import Choice, Error, Measurement, recommend
from rigid_body_ros.tradeoff.result import Tradeoff
from rigid_body_ros.tradeoff.settings import Setting
from rigid_body_ros.tradeoff.trade import measure, TARGET

__all__ = ['TARGET', 'Choice', 'Error', 'Measurement', 'Setting', 'Tradeoff', 'measure',
           'recommend']
