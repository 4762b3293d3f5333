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

"""The commands that run a node until a signal ends it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime import interrupts


def attitude_node(arguments: Sequence[str] | None) -> int:
    """Run the node until a signal ends it."""
    with _needs_ros('attitude_node'):
        from rigid_body_ros.node import main
    main(arguments)
    return 0


def attitude_lifecycle_node(arguments: Sequence[str] | None) -> int:
    """Run the managed node until a signal ends it."""
    with _needs_ros('attitude_lifecycle_node'):
        from rigid_body_ros.node.lifecycle import main
    main(arguments)
    return 0


def attitude_controller(arguments: Sequence[str] | None) -> int:
    """Run the controller until the end of the maneuver, or until a signal ends it."""
    with _needs_ros('attitude_controller'):
        from rigid_body_ros.node.attitude_controller import main
    main(arguments)
    return 0


@contextmanager
def _needs_ros(command: str) -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as error:
        raise InputError(f"{command} needs ROS 2, but the module '{error.name}' is not "
                         'installed: source a ROS 2 installation, or run '
                         'pip install "rigid_body_ros[ros]"') from error
    interrupts.check()  # the import takes long
