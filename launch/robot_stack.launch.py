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
Start the node with config/robot_stack.yaml; after a restart, it continues from its checkpoint.

Copy this file and the scene into the folders launch and config of your package.
"""

from pathlib import Path

from launch import LaunchDescription
from rigid_body_ros import launching

#: Relative to this file, so that a copy of this file uses the scene beside the copy.
SCENE = Path(__file__).absolute().parents[1] / 'config' / 'robot_stack.yaml'
CHECKPOINT = Path.home() / '.ros' / 'robot_stack.json'


def generate_launch_description():
    return LaunchDescription([launching.scoped(
        lambda context: [launching.attitude_node(context)],
        scene=str(SCENE), checkpoint=str(CHECKPOINT), respawn='true')])
