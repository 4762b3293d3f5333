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
Run a controller again in lockstep, and compare its closed loop with a recorded loop.

First, `domain` reserves a ROS domain. Two processes run in this domain: `controller` starts the
controller's command, and `node_process` runs a node that the caller provides. `session` connects
the two processes in a closed loop and records the loop. Then `loop` reads the recording, and
compares two loops. `regression` decides which loops to compare, and `page` shows the loops on an
HTML page.
"""

from rigid_body_ros.regress.loop import Differences, differences, Loop, read, Signal
from rigid_body_ros.regress.regression import compare, Regression, update
from rigid_body_ros.regress.session import Session, Span

__all__ = ['Differences', 'Loop', 'Regression', 'Session', 'Signal', 'Span', 'compare',
           'differences', 'read', 'update']
