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

"""Define a command by its options and the function that runs it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
import sys
from types import ModuleType
from typing import Any, NoReturn

from rigid_body_ros.common.errors import InputError, printable
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.terminal import show


@dataclass(frozen=True)
class Command:
    """
    A command that users run from a shell.

    Parameters
    ----------
    name, description : str
    examples : sequence of str
        The arguments in the examples at the end of the help. Examples use files in the repository.
    add_arguments : callable
        Adds the options of the command to a parser.
    run : callable
        Runs the command with the parsed options, and returns the exit status.
    rest : str
        The usage text for arguments after '--', or '' if the command accepts none. `parsed` stores
        these arguments in `options.rest`.

    """

    name: str
    description: str
    examples: Sequence[str]
    add_arguments: Callable[[Parser], None]
    run: Callable[[argparse.Namespace], int]
    rest: str = ''

    def __call__(self, arguments: Sequence[str] | None) -> int:
        """Run the command; if `arguments` is None, use the arguments of the process."""
        return self.run(self.parsed(arguments))

    def parsed(self, arguments: Sequence[str] | None) -> argparse.Namespace:
        """Parse the arguments; raise InputError if standard output is closed."""
        if sys.stdout is None:
            raise InputError('cannot write to standard output: it is closed')
        words = [*(sys.argv[1:] if arguments is None else arguments)]
        end = words.index('--') if self.rest and '--' in words else len(words)
        options = self.parser().parse_args(words[:end])
        options.arguments, options.rest = words, words[end + 1:]
        return options

    def parser(self) -> Parser:
        """Return the parser for the arguments."""
        parser = Parser(self)
        self.add_arguments(parser)
        if self.rest:
            usage = parser.format_usage().removeprefix('usage: ').rstrip()
            parser.usage = f'{usage} -- {self.rest}'
        return parser


class Parser(argparse.ArgumentParser):
    """An argument parser that rejects repeated options; its methods add options to commands."""

    def __init__(self, command: Command) -> None:
        super().__init__(prog=command.name, description=command.description)
        self.register('action', None, _Once)
        self.add_argument('--version', action=_Version, nargs=0, default=argparse.SUPPRESS,
                          help='show the version and exit')
        self.set_defaults(command=command.name)
        self._examples = [f'{command.name} {arguments}' for arguments in command.examples]

    def error(self, message: str) -> NoReturn:
        """Report an error and exit. Unlike argparse, escape nonprintable characters."""
        super().error(printable(message))

    def print_help(self, file: Any = None) -> None:
        """Print the help. Unlike argparse, raise InputError if the help cannot be written."""
        examples = '\n  '.join(['examples, in a clone of the repository:', *self._examples])
        show(f'{self.format_help()}\n{examples}')

    def add_scene(self, without: str = '') -> None:
        """Add the option that selects the scene; `without` says what is done if it is missing."""
        self.add_argument('--scene', required=not without, metavar='FILE',
                          help=f'scene: the parameter file of attitude_node{without}')

    def add_torques(self) -> None:
        """Add the options that select the topics for torques and for a changing inertia."""
        self.add_argument('--topic', action='append',
                          help='torque topic; repeat it to add up torques (default: the '
                          'torque_topics of the scene; a single topic may have another name in '
                          'the recording)')
        self.add_argument('--wheel-torque', metavar='TOPIC',
                          help='topic of the motor torques on the rotors (default: wheel_torque, '
                          'if recorded); needs wheels: true')
        self.add_argument('--wheel-momentum', metavar='TOPIC',
                          help='topic of the measured rotor momentum (Vector3Stamped, N m s, body '
                          'axes), interpolated linearly; needs wheels: true')
        self.add_argument('--wheel-command', metavar='TOPIC',
                          help='topic of the efforts of named wheels (JointState; default: '
                          'wheel_command, if recorded); needs wheel_names')
        self.add_argument('--inertia', metavar='TOPIC',
                          help='topic of the changing inertia (InertiaStamped; default: inertia, '
                          'if recorded); needs inertia_topic: true')
        self.add_argument('--columns', type=_columns, metavar='NAME=COLUMN,...',
                          help='number, from 1, or name of the columns of CSV files, as in '
                          "time_ms=1,'wx (deg/s)=gx',wy=3,wz=4 (default: as the heading says)")

    def add_interpolation(self) -> None:
        """Add the option that selects how torques are interpolated."""
        self.add_argument('--interpolation', choices=('hold', 'linear', 'cubic'),
                          help='torque between samples (default: the interpolation of the scene)')

    def add_span(self, *aliases: str) -> argparse._ActionsContainer:
        """
        Add the options for the start and the end of the motion.

        `aliases` are other names of --from. Return a group for other options that set the end.
        """
        self.add_argument('--from', *aliases, dest='start', type=positive, default=0.0,
                          metavar='SECONDS', help='start the motion SECONDS after the first '
                          'sample, in the initial state of the scene; not for the log of a node')
        ends = self.add_mutually_exclusive_group()
        ends.add_argument('--until', type=positive, metavar='SECONDS',
                          help='end the motion SECONDS after the first sample or, if the scene '
                          'sets start_time or a node recorded the log, after the start')
        return ends

    def add_time_source(self) -> None:
        """Add the option that selects where times come from."""
        self.add_argument('--time-source', choices=('header', 'log', 'publish'), default='header',
                          help='time of a torque or measurement: its stamp, or when its message '
                          'was recorded or published (default: header)')

    def add_measured(self, topics: str) -> None:
        """Add the options for torques and measurements; `topics` is the help for --measured."""
        self.add_argument('--measured', action='append', metavar='TOPIC', help=topics)
        self.add_argument('--frames', nargs=2, metavar=('PARENT', 'CHILD'),
                          help='frames of measured transforms or odometry (default: those of the '
                          'scene)')
        self.add_torques()
        self.add_span()
        self.add_interpolation()
        self.add_time_source()

    def add_outputs(self, *outputs: str) -> None:
        """Add --report, --overwrite, and the named ones of --json and --plot."""
        if 'json' in outputs:
            self.add_argument('--json', metavar='OUT', help='write the result, with units')
        if 'plot' in outputs:
            self.add_argument('--plot', metavar='PNG', help='draw the charts of --report')
        self.add_argument('--report', metavar='HTML', help='write the result as a page that any '
                          'browser opens without a network')
        self.add_argument('--overwrite', action='store_true',
                          help='replace output files that exist, but never folders')

    def add_degrees(self) -> None:
        """Add the option that selects the unit of angles."""
        self.add_argument('--degrees', action='store_true',
                          help='degrees in the summary and on the page; JSON and verdict stay in '
                          'radians')


class _Once(argparse.Action):
    """Store the value of an option, but reject the option if it is given twice."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        """
        Store a value.

        Raises
        ------
        InputError
            The option already has a value.

        """
        earlier = vars(namespace).setdefault('given', {})
        if self.dest in earlier:
            raise InputError(f'{option_string}: expected the option at most once, found '
                             f'{earlier[self.dest]!r} and {values!r}')
        earlier[self.dest] = values
        setattr(namespace, self.dest, values)


class _Version(argparse.Action):
    """Show the version of the package, and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        """Show the version; raise InputError if standard output cannot be written."""
        from rigid_body_ros.runtime.fingerprint import build_info
        show(f"{parser.prog} {build_info()['version']}")
        parser.exit()


def imported(command: str, module: str) -> ModuleType:
    """Import a module that needs ROS; raise InputError if ROS is not installed."""
    try:
        loaded = import_module(module)
    except ModuleNotFoundError as error:
        raise InputError(f"{command} needs ROS 2, but the module '{error.name}' is not "
                         'installed: source a ROS 2 installation, or run '
                         "pip install '.[ros]' in a clone of rigid_body_ros") from error
    interrupts.check()  # the import is slow
    return loaded


def _columns(text: str) -> dict[str, str]:
    pairs = [part.rpartition('=') for part in text.split(',')]
    columns = {name.strip(): column.strip() for name, _, column in pairs}
    if len(columns) < len(pairs) or not all(map(all, columns.items())):
        raise argparse.ArgumentTypeError(f'expected NAME=COLUMN,..., each once, found {text!r}')
    return columns


def within(low: float, high: float, what: str = 'a number',
           kind: Callable[[str], Any] = float) -> Callable[[str], Any]:
    """Return a function that reads a number within limits, for use as the `type` of an option."""
    def read(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            limits = f'{low} to {high}' if kind is int else f'{low:g} to {high:g}'
            raise argparse.ArgumentTypeError(f'expected {what} from {limits}, found {text!r}')
        return value
    return read


positive = within(1e-9, 1e9)
