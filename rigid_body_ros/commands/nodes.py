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

"""The commands that run a node until the node finishes or a signal ends the command."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from importlib import import_module
from types import ModuleType

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime import interrupts


def imported(command: str, module: str) -> ModuleType:
    """Import a module that needs ROS; raise InputError if ROS is not installed."""
    try:
        found = import_module(module)
    except ModuleNotFoundError as error:
        raise InputError(f"{command} needs ROS 2, but the module '{error.name}' is not "
                         'installed: source a ROS 2 installation, or run '
                         "pip install '.[ros]' in a clone of rigid_body_ros") from error
    interrupts.check()  # the import is slow
    return found


def _run(command: str, module: str, arguments: Sequence[str] | None) -> int:
    imported(command, module).main(arguments)
    return 0


attitude_node = partial(_run, 'attitude_node', 'rigid_body_ros.node.process')
attitude_lifecycle_node = partial(_run, 'attitude_lifecycle_node', 'rigid_body_ros.node.lifecycle')
attitude_monitor = partial(_run, 'attitude_monitor', 'rigid_body_ros.node.attitude_monitor')
attitude_controller = partial(_run, 'attitude_controller',
                              'rigid_body_ros.node.attitude_controller')
