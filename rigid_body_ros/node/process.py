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

"""Run a node as a command: its arguments, its executor, its timers, and the end by a signal."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
import gc
import inspect
import os
from pathlib import Path
import signal
import sys
import time
from typing import Any, TypeVar

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime import interrupts

#: How often the main loop checks for signals, in seconds.
_SIGNAL_PERIOD = 0.1
#: Number of new objects after which Python looks for unused ones. The default of 700 takes a tenth
#: of the time that a torque takes.
_YOUNG = 20_000
_NO_ARGUMENTS = inspect.Signature()
_SCENE = 'Pass the scene as ROS parameters: --ros-args --params-file FILE'
_Node = TypeVar('_Node', bound=Node)


def run(kind: Callable[[], _Node], command: str, arguments: Sequence[str] | None = None,
        epilog: str = _SCENE, is_done: Callable[[_Node], bool] = lambda node: False) -> None:
    """
    Run a node until it is done, or until it receives SIGINT or SIGTERM.

    The first line of the documentation of `kind` describes the command in its help.

    Raises
    ------
    InputError
        The arguments or parameters are not valid.

    """
    command_line = sys.argv if arguments is None else [command, *arguments]
    try:
        with one_line_errors():
            argparse.ArgumentParser(
                command, description=(inspect.getdoc(kind) or '').partition('\n')[0],
                epilog=epilog).parse_args(remove_ros_args(command_line)[1:])
            # Do not install rclpy's signal handlers, because they would shut ROS down before the
            # last states are published.
            rclpy.init(args=[*command_line, *_without_log_file()],
                       signal_handler_options=SignalHandlerOptions.NO)
        node = kind()
        spin(executor_of(), node, lambda: is_done(node))
    finally:
        rclpy.try_shutdown()


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


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Convert rclpy errors, for example about a name or a QoS override, to InputErrors."""
    try:
        yield
    except NameValidationException as error:
        text, name, _ = str(error).splitlines()  # the last line marks a character in the name
        raise InputError(f'{text} {name.strip()}') from error
    except (RuntimeError, AssertionError, ParameterException) as error:
        raise InputError(' '.join(str(error).split())) from error


def executor_of(context: Context | None = None) -> Executor:
    """Return an executor, of the kind that uses the least processor time per message."""
    try:  # EventsExecutor uses half as much time as SingleThreadedExecutor
        from rclpy.experimental import EventsExecutor
    except ImportError:  # before Jazzy
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Executor, node: Node, is_done: Callable[[], bool] = lambda: False) -> None:
    """Spin a node until it is done or a SIGINT or SIGTERM arrives, and then destroy it."""
    stop: list[int] = []
    executor.add_node(node)
    # From now on, signals only end the loop, and do not interrupt callbacks.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stop.append(number))
    interrupts.check()
    # Freeze the objects that exist now. Otherwise, a garbage collection would visit the objects of
    # all modules, and would delay the outputs by 0.05 to 0.2 s.
    gc.freeze()
    gc.set_threshold(_YOUNG)
    while not (stop or is_done()):
        # The timeout gives the loop a chance to notice signals. Without the timeout,
        # EventsExecutor may hang.
        executor.spin_once(timeout_sec=_SIGNAL_PERIOD)
    node.destroy_node()


class Observer(AbstractContextManager['Observer']):
    """
    A node in a context of its own, which sees who is connected to topics.

    Use this class as a context manager, which ends the node on exit.

    Parameters
    ----------
    connections : object
        The first connections to compare others with; see `_are_lasting`.

    """

    #: The name of the node.
    NAME = 'attitude_regress'

    def __init__(self, connections: Any) -> None:
        self._context = rclpy.Context()
        # Do not write log files, and do not repeat warnings about the scene, because the command
        # prints them itself.
        rclpy.init(args=['--ros-args', '--log-level', 'error', '--disable-external-lib-logs'],
                   context=self._context)
        self._observer = rclpy.create_node(self.NAME, context=self._context)
        #: The connections, and when they last changed, in seconds on the monotonic clock.
        self._connections, self._since = connections, time.monotonic()

    def __exit__(self, *error: object) -> None:
        self._observer.destroy_node()
        rclpy.shutdown(context=self._context)

    def _are_lasting(self, connections: Any, seconds: float) -> bool:
        """Keep what is connected now, and return whether it has been the same for some seconds."""
        if connections != self._connections:
            self._connections, self._since = connections, time.monotonic()
        return time.monotonic() - self._since > seconds


def timer(node: Node, period: float, callback: Callable[[], None],
          clock: Clock | None = None) -> Timer:
    """Create a timer with a period in seconds, which uses a steady clock unless one is given."""
    def tick() -> None:
        callback()
    # In each period, rclpy inspects the signature of the callback, which takes 20 us otherwise.
    vars(tick)['__signature__'] = _NO_ARGUMENTS
    # Give each timer its own clock. When a timer is reset, EventsExecutor calls the overdue timers
    # on the same clock twice, and these timers then pause to make up for the extra calls.
    return node.create_timer(period, tick,
                             clock=clock or Clock(clock_type=ClockType.STEADY_TIME))
