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
from collections.abc import Callable, Iterable, Sequence
import sys
from typing import Any, NoReturn, TYPE_CHECKING

from rigid_body_ros.common.errors import InputError, printable
from rigid_body_ros.runtime import interrupts
from rigid_body_ros.runtime.terminal import progress, report, show

if TYPE_CHECKING:
    from rigid_body_ros.recording import Logged, Topics
    from rigid_body_ros.scene import Scene
    from rigid_body_ros.sensing.measured import Measured
    from rigid_body_ros.sensing.recorded import Reading


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


class _Version(argparse.Action):
    """Show the version of the package, and exit."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        """Show the version; raise InputError if it cannot be written."""
        from rigid_body_ros.runtime.fingerprint import build_info
        show(f"{parser.prog} {build_info()['version']}")
        parser.exit()


class Parser(argparse.ArgumentParser):
    """
    An argument parser that rejects repeated options and reports a failure to print its help.

    Parameters
    ----------
    prog, description : str
    examples : sequence of str
        Arguments to show at the end of the help; the files are those of the repository.

    """

    def __init__(self, prog: str, description: str, examples: Sequence[str]) -> None:
        super().__init__(prog=prog, description=description)
        self.register('action', None, _Once)
        self.add_argument('--version', action=_Version, nargs=0, default=argparse.SUPPRESS,
                          help='show the version and exit')
        self.set_defaults(command=prog)
        self.examples = [f'{prog} {arguments}' for arguments in examples]

    def error(self, message: str) -> NoReturn:
        """Report an error; unlike argparse, escape what a terminal would not print."""
        super().error(printable(message))

    def print_help(self, file: Any = None) -> None:
        """Print the help; unlike argparse, raise InputError if it cannot be written."""
        examples = '\n  '.join(['examples, in a clone of the repository:', *self.examples])
        show(f'{self.format_help()}\n{examples}')


def parsed(parser: argparse.ArgumentParser,
           arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options; raise InputError if standard output is closed."""
    if sys.stdout is None:
        raise InputError('cannot write to standard output: it is closed')
    options = parser.parse_args(arguments)
    options.arguments = [*(sys.argv[1:] if arguments is None else arguments)]
    return options


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


def warn_of_units(options: argparse.Namespace, paths: Iterable[str]) -> None:
    """Warn of torques that are not in N m."""
    from rigid_body_ros.recording import is_ulog
    for path in filter(is_ulog, paths):
        report(f'{options.command}: warning: {path}: the torques of a PX4 log are normalized, not '
               'in N m; attitude_identify --estimate start,torque_gains finds their gains if the '
               'inertia is known')


def topics_of(options: argparse.Namespace) -> Topics:
    """Return the topics of the torques that are given."""
    from rigid_body_ros import recording
    return recording.Topics.given(options.topic, options.wheel_torque,
                                  options.wheel_momentum, options.inertia,
                                  options.wheel_command)


def read_torques(options: argparse.Namespace, scene: Scene, may_command: bool = False) -> Logged:
    """Return the problem that the recording and a scene state, see `recording.chosen`."""
    from rigid_body_ros import recording
    warn_of_units(options, [options.recording])
    path, topics = options.recording, topics_of(options).found_in(options.recording, scene)
    epochs = recording.read_epochs(path, scene, topics, track=progress('reading', size=len))
    return recording.chosen(path, scene, epochs, may_command=may_command)


def reading_of(options: argparse.Namespace) -> Reading:
    """Return which torques and measurements to read, and how."""
    from rigid_body_ros.sensing.recorded import Reading
    return Reading(tuple(options.measured or ()), topics_of(options), options.interpolation,
                   options.time_source, options.frames and tuple(options.frames),
                   progress('reading', size=len))


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
    parser.add_argument('--wheel-command', metavar='TOPIC',
                        help='topic of the efforts of wheels with names (JointState; default: '
                        'wheel_command, if the recording has it); needs a scene with wheel_names')
    parser.add_argument('--inertia', metavar='TOPIC',
                        help='topic of the inertia of a body that changes (InertiaStamped; '
                        'default: inertia, if the recording has it); needs a scene with '
                        'inertia_topic: true')


def add_interpolation(parser: argparse.ArgumentParser) -> None:
    """Add the option for the interpolation of the torques."""
    parser.add_argument('--interpolation', choices=('hold', 'linear', 'cubic'),
                        help="interpolation of the torques between samples (default: the scene's)")


def add_measured(parser: argparse.ArgumentParser, topics: str) -> None:
    """Add the options for torques and measurements; the help describes the measured topics."""
    parser.add_argument('--measured', action='append', metavar='TOPIC', help=topics)
    parser.add_argument('--frames', nargs=2, metavar=('PARENT', 'CHILD'),
                        help='the two frames of measured transforms or odometry (default: those '
                        'of the scene)')
    add_torques(parser)
    add_interpolation(parser)
    parser.add_argument('--time-source', choices=('header', 'log', 'publish'), default='header',
                        help='time of torques and measurements: the stamp in the header, or when '
                        'the message was logged or published (default: header)')


def add_scheduler(parser: argparse._ActionsContainer) -> None:
    """Add the option for a Dask scheduler."""
    parser.add_argument('--scheduler', metavar='ADDRESS|FILE', help='compute on the workers of '
                        'this Dask scheduler: HOST:PORT, tcp://HOST:PORT, or the file that it '
                        'wrote; it does not change the results')


def add_outputs(parser: argparse.ArgumentParser, shows: str) -> None:
    """Add the option for the page, and the one that allows outputs to replace files."""
    parser.add_argument('--report', metavar='HTML', help=f'write a page for any browser, without '
                        f'network, that shows {shows}')
    parser.add_argument('--overwrite', action='store_true',
                        help='replace output files that exist; folders are never replaced')


def add_degrees(parser: argparse.ArgumentParser) -> None:
    """Add the option for the unit of angles."""
    parser.add_argument('--degrees', action='store_true', help='print angles in degrees, and show '
                        'them so on the page; JSON, and what the verdict says, stay in radians')


def within(low: float, high: float, what: str = 'a number',
           kind: Callable[[str], Any] = float) -> Callable[[str], Any]:
    """Return a function that reads a number between limits, as the type of an option."""
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
