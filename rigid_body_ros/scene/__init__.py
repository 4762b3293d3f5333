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
Scenes: a body, its initial state and the options for a run, read from a ROS 2 parameter file.

The node and the commands use the same table of parameters, so that a scene file means the same to
all of them. The table is in `parameters`. The module `parts` creates the body, the fields, the
wheels and the actuators from it, `scene` reads and checks scene files, and `quantities` is what
scenes, fits and ensembles have in common.
"""

from rigid_body_ros.scene.parameters import PARAMETERS
from rigid_body_ros.scene.scene import InputError, load, NODE, Scene

__all__ = ['NODE', 'PARAMETERS', 'InputError', 'Scene', 'load']
