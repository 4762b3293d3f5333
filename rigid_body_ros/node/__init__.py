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
The ROS node that receives torques on a topic and publishes the attitude.

There are two versions of the node: the plain node in `attitude_node`, and the managed node in
`lifecycle`. Both are built on `AttitudeComponent` in `attitude_node`, which ties the other modules
together. `process` runs a node as a command.

`parameters` reads the scene, `sources` lists the topics to read, and `intake` receives messages,
for `attitude_monitor`, too. `clocks` compares stamps with clocks. `mode` applies the torques in
short slices of work. Its subclasses in `realtime`, `clock_mode` and `lockstep` decide which
torques to accept, and when to publish a state. `outputs` publishes the states and the log, and
`diagnostics` reports problems. Work that does not need ROS is done in the package `live`.

`attitude_controller` is an example of a controller for lockstep mode. `attitude_regress` uses two
modules: `recorded` runs the node in lockstep and keeps its log, and `open_loop` feeds recorded
messages to any other node.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from rigid_body_ros.node.attitude_node import AttitudeNode, main
else:
    def __getattr__(name: str) -> Any:
        """Import a name on first use, so that `attitude_controller` starts without the engine."""
        if name not in __all__:
            raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
        return getattr(import_module(f'{__name__}.attitude_node'), name)

__all__ = ['AttitudeNode', 'main']
