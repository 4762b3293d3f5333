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

First, `processes` reserves a ROS domain, and starts two processes in this domain: the controller's
command, and a node that the caller provides. `regression` connects the two processes in a closed
loop, records the loop, and decides which loops to compare. `loop` reads a recording, and compares
two loops. `report` prepares their page. `open_loop` feeds a recording to any node instead, and
compares what the node publishes.
"""

from rigid_body_ros.regress.loop import Differences, differences, Loop, read, Signal
from rigid_body_ros.regress.regression import compare, Regression, Session, Span, update

__all__ = ['Differences', 'Loop', 'Regression', 'Session', 'Signal', 'Span', 'compare',
           'differences', 'read', 'update']
