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
Trade speed against accuracy by running every solver, at a series of settings, on a given motion.

All settings run over a *stretch*, which is the whole motion or, if the motion is long, its first
half, quarter and so on. A stretch contains at most twenty thousand samples, and the body turns by
at most ten thousand radians in it. Every setting is compared with a reference on the stretch: the
Taylor series at its tightest tolerance, with shorter steps.

The *rounding floor* is the largest difference between solutions that differ only in their rounding
errors. One of these solutions is the reference. The others come from the series with other steps,
the series in principal axes and, without torque, the closed form. Changing the last digits of
inertia, torques and start may change the motion by more than the floor. In that case, no solver
can guarantee an error smaller than this change.

A setting that meets a target on the stretch is recommended only if it also meets the target on the
whole motion.
"""

from rigid_body_ros.tradeoff.choices import Choice, Error, Measurement, recommend, Setting
from rigid_body_ros.tradeoff.result import Tradeoff
from rigid_body_ros.tradeoff.trade import measure, TARGET

__all__ = ['TARGET', 'Choice', 'Error', 'Measurement', 'Setting', 'Tradeoff', 'measure',
           'recommend']
