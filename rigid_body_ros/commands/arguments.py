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

"""What the commands share: their parser, the scene, and the torques of a recording."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
import os
import shlex
import sys
from typing import Any, NoReturn, TYPE_CHECKING

from rigid_body_ros.common.errors import InputError, printable
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.terminal import report, show

if TYPE_CHECKING:
    from rigid_body_ros.comparison import Measured
    from rigid_body_ros.scene import Scene


class _Once(argparse.Action):
    """Store the value of an option, and reject a second value."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        """
        Store a value.

        Raises
        ------
        InputError
            The option already has a value.

        """
        given = vars(namespace).setdefault('given', {})
        if self.dest in given:
            raise InputError(f'{option_string}: expected the option at most once, found '
                             f'{given[self.dest]!r} and {values!r}')
        given[self.dest] = values
        setattr(namespace, self.dest, values)


class Parser(argparse.ArgumentParser):
    """An argument parser that rejects repeated options and reports a failure to print its help."""

    def __init__(self, prog: str, description: str) -> None:
        super().__init__(prog=prog, description=description)
        self.register('action', None, _Once)
        self.set_defaults(command=prog)

    def error(self, message: str) -> NoReturn:
        """Report an error; unlike argparse, escape what a terminal would not print."""
        super().error(printable(message))

    def print_help(self, file: Any = None) -> None:
        """Print the help; unlike argparse, raise InputError if it cannot be written."""
        show(self.format_help(), end='')


def parsed(parser: argparse.ArgumentParser,
           arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options; raise InputError if standard output is closed."""
    if sys.stdout is None:
        raise InputError('cannot write to standard output: it is closed')
    options = parser.parse_args(arguments)
    options.arguments = [*(sys.argv[1:] if arguments is None else arguments)]
    return options


def command_line(options: argparse.Namespace, *names: str) -> str:
    """
    Return the command line, with file names in place of paths.

    Parameters
    ----------
    options : Namespace
        From `parsed`.
    names : str
        The options that are paths.

    """
    given = [value for name in names if (value := getattr(options, name))]
    paths = [os.fspath(path) for value in given
             for path in (value if isinstance(value, list) else [value])]
    return shlex.join([options.command, *(_without_folder(os.fspath(text), paths)
                                          for text in options.arguments)])


def _without_folder(argument: str, paths: Sequence[str]) -> str:
    for path in paths:
        option = argument.removesuffix(path)
        if option != argument and (not option or option.startswith('-')):
            return option + os.path.basename(os.path.abspath(path))
    return argument


def load_scene(options: argparse.Namespace) -> Scene:
    """Return the scene of the options, and report its notes and warnings."""
    from rigid_body_ros.scene import load
    interrupts.check()  # the import takes long
    scene = load(options.scene)
    for text in scene.notes:
        note(options, f'{options.scene}: {text}')
    for warning in scene.warnings:
        report(f'{options.command}: warning: {options.scene}: {warning}')
    return scene


def note(options: argparse.Namespace, text: str) -> None:
    """Print a note of the command."""
    report(f'{options.command}: note: {text}')


def warn_of_frames(options: argparse.Namespace, path: str, measured: Iterable[Measured]) -> None:
    """Warn of measurements in other frames than those of the scene."""
    for one in measured:
        if one.frames:
            report(f'{options.command}: warning: {path}: {one.topic}: {one.frames}')


def show_summary(summary: str, width: int, outputs: Iterable[str]) -> None:
    """Print a summary, and the names of the outputs below, in a column of the same width."""
    names = ', '.join(outputs)
    show(summary + (f'\n{"wrote":{width}}{printable(names)}' if names else ''))


def torque_options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options that choose the torques, as keyword arguments of `replay`."""
    return {'topic': options.topic, 'wheel_torque': options.wheel_torque,
            'wheel_momentum': options.wheel_momentum, 'interpolation': options.interpolation}


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the option for the scene."""
    parser.add_argument('--scene', required=True, metavar='FILE',
                        help='ROS 2 parameter file with the inertia and the initial state, as for '
                        'attitude_node')


def add_torques(parser: argparse.ArgumentParser) -> None:
    """Add the options for the topics of the torques."""
    parser.add_argument('--topic', action='append', help='topic of the torques; repeat it for '
                        'torques that add up (default: the torque_topics of the scene; if scene '
                        'and recording have one topic each, the names may differ)')
    parser.add_argument('--wheel-torque', metavar='TOPIC',
                        help='topic of the torque of the motors on the rotors (default: '
                        'wheel_torque, if the recording has it); needs a scene with wheels: true')
    parser.add_argument('--wheel-momentum', metavar='TOPIC',
                        help='topic of the measured momentum of the rotors (Vector3Stamped, N m '
                        's, body axes), linear between samples; needs a scene with wheels: true')


def add_scheduler(parser: argparse._ActionsContainer) -> None:
    """Add the option for a Dask scheduler."""
    parser.add_argument('--scheduler', metavar='ADDRESS|FILE', help='compute on the workers of '
                        'this Dask scheduler: HOST:PORT, tcp://HOST:PORT, or the file that it '
                        'wrote; it does not change the results')


def add_report(parser: argparse.ArgumentParser, shows: str) -> None:
    """Add the option for the page."""
    parser.add_argument('--report', metavar='HTML', help=f'write a page for any browser, without '
                        f'network, that shows {shows}')


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Add the option that allows outputs to replace files."""
    parser.add_argument('--overwrite', action='store_true',
                        help='replace output files that exist; folders are never replaced')


def positive(text: str) -> float:
    """Return a number from 1e-9 to 1e9, as the type of an option."""
    return _number(text, 1e-9, 1e9)


def angle(text: str) -> float:
    """Return an angle from 1e-15 to 1 rad, as the type of an option."""
    return _number(text, 1e-15, 1.0)


def _number(text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f'expected a number from {low:g} to {high:g}, '
                                         f'found {text!r}')
    return value
