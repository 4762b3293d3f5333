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

"""Provide `main`, which runs a node as a command."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import inspect
import os
from pathlib import Path
import sys

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.node.attitude_node import AttitudeNode
from rigid_body_ros.node.spinning import executor_of, spin


def main(arguments: Sequence[str] | None = None, kind: Callable[[], Node] = AttitudeNode,
         command: str = 'attitude_node') -> None:
    """
    Run a node until it receives SIGINT or SIGTERM.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    try:
        _initialize(sys.argv if arguments is None else [command, *arguments], command,
                    inspect.getdoc(kind) or '')
        spin(executor_of(), kind())
    finally:
        rclpy.try_shutdown()


def _initialize(command_line: Sequence[str], command: str, described: str) -> None:
    try:
        others = remove_ros_args(command_line)[1:]
        argparse.ArgumentParser(
            command, description=described.partition('\n')[0],
            epilog='Pass the scene as ROS parameters: --ros-args --params-file FILE',
        ).parse_args(others)
        # Do not install rclpy's signal handlers, because they would shut ROS down before the last
        # states are published.
        rclpy.init(args=[*command_line, *_without_log_file()],
                   signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InputError(' '.join(str(error).split())) from error


def _without_log_file() -> list[str]:
    """Return arguments that disable rcl's log file if its folder is not writable, else none."""
    home = Path(os.environ.get('ROS_HOME') or '~/.ros')
    folder = Path(os.environ.get('ROS_LOG_DIR') or home / 'log').expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        writable = False
    else:
        writable = os.access(folder, os.W_OK)
    return [] if writable else ['--ros-args', '--disable-external-lib-logs', '--']
