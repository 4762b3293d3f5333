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

All settings run over one *stretch*, from the start to as far as a thousand or so radians and
samples reach, and are compared with a reference there: the series at its tightest tolerance in
shorter steps. The *floor* is the largest difference between it and motions that round otherwise:
the series with other steps and in principal axes, and, without torque, the closed form. If a
change of the last digits of inertia, torques and start moves the motion by more than that, no
solver can be right for certain by less. A setting that meets the target on the stretch is
recommended only when it meets it on the whole log.
"""

from rigid_body_ros.tradeoff.trade import Choice, Error, measure, recommend, Run, Setting, Tradeoff

__all__ = ['Choice', 'Error', 'Run', 'Setting', 'Tradeoff', 'measure', 'recommend']
