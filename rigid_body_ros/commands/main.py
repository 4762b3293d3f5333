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
The entry points of the commands: handle signals, run the command, and return the exit status.

This module can be imported within a few milliseconds, but importing a command takes about a
second. The command is therefore imported only after the signal handlers have been installed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
import signal
import sys
from typing import Any

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.terminal import report, show

#: The exit status if the user made a mistake. All exit statuses are explained in docs/commands.md.
USER_ERROR = 2
#: If a command is ended by a signal, its exit status is SIGNALLED plus the number of the signal.
SIGNALLED = 128
#: The number of SIGPIPE, a signal that ends a program when the reader of its output exits.
_BROKEN_PIPE = 13


def _run(name: str, load: Callable[[], Callable[..., int | None]],
         arguments: Sequence[str] | None = None) -> int:
    """Run the command that `load` imports, and return its exit status."""
    def command() -> int:
        import logging
        run = load()
        # If the home folder is not writable, matplotlib warns that it uses a temporary one.
        logging.getLogger('matplotlib').setLevel(logging.ERROR)
        interrupts.check()
        return run(arguments) or 0
    status = _guarded(name, command, arguments)
    return status if arguments is not None else interrupts.end(status)


def _guarded(name: str, command: Callable[[], int], arguments: Sequence[str] | None) -> int:
    """Run a command, report an error or a signal in one line, and return the exit status."""
    try:
        # If no arguments are passed, the process runs only this command and then exits.
        with interrupts.deferred(until_exit=arguments is None):
            return _called(command)
    except InputError as error:
        report(f'{name}: error: {error}')
        return USER_ERROR
    except ModuleNotFoundError as error:
        package = str(error.name).split('.')[0]
        if package == __package__.split('.')[0]:
            raise
        report(f'{name}: error: Python module {package!r} is not installed; '
               f'run python3 -m pip install {package}')
        return USER_ERROR
    except BrokenPipeError:
        sys.stdout = None  # otherwise Python flushes it again at exit
        return SIGNALLED + _BROKEN_PIPE
    except KeyboardInterrupt as interrupt:
        details: list[Any] = [*interrupt.args] or [signal.SIGINT]  # Python's handler passes none
        number, *kept = details
        report(f'{name}: interrupted{"".join(kept) or "; no partial output was left"}')
        return SIGNALLED + int(number)


def _called(command: Callable[[], int]) -> int:
    try:
        return command()
    except InputError:
        raise
    except Exception:  # C code that imports a module may turn KeyboardInterrupt into another error
        interrupts.check()
        raise
    except SystemExit:  # after --help, whose text may still be in the buffer
        if sys.stdout is not None:
            show('', end='')
        raise


def __getattr__(name: str) -> Callable[..., int]:
    """Return the entry point of a command; the module NAME contains `attitude_NAME`."""
    module = name.removeprefix('attitude_')
    if module == name or not find_spec(f'{__package__}.{module}'):
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return partial(_run, name, lambda: getattr(import_module(f'{__package__}.{module}'), name))


def _node(name: str, module: str) -> Callable[..., int]:
    """Return the entry point of a node, whose module has the function `main`."""
    def load() -> Callable[..., None]:
        from rigid_body_ros.commands.command import imported
        return imported(name, f'rigid_body_ros.node.{module}').main
    return partial(_run, name, load)


attitude_node = _node('attitude_node', 'attitude_node')
attitude_lifecycle_node = _node('attitude_lifecycle_node', 'lifecycle')
attitude_monitor = _node('attitude_monitor', 'attitude_monitor')
attitude_controller = _node('attitude_controller', 'attitude_controller')
