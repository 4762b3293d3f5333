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

"""The commands: arguments in, exit status out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import json
from pathlib import Path
import signal
import sys
from typing import Any, TYPE_CHECKING

from rigid_body_ros.common.errors import InputError, shortened
from rigid_body_ros.runtime import files, interrupts
from rigid_body_ros.scene import load, Scene

if TYPE_CHECKING:
    from rigid_body_ros.tradeoff import Tradeoff

#: Exit statuses; docs/nodes.md has their meaning.
OK, DIFFERENT, USER_ERROR = 0, 1, 2
#: What a shell adds to the number of a signal that ended a command.
SIGNALLED = 128
#: The number of SIGPIPE, which ends other commands when the reader of their output is gone.
_BROKEN_PIPE = 13


def attitude_replay(arguments: Sequence[str] | None = None) -> int:
    """Run `attitude_replay` and return its exit status."""
    return _parsed(replay_parser(), _replay, arguments)


def attitude_tradeoff(arguments: Sequence[str] | None = None) -> int:
    """Run `attitude_tradeoff` and return its exit status."""
    return _parsed(tradeoff_parser(), _tradeoff, arguments)


def attitude_node(arguments: Sequence[str] | None = None) -> int:
    """Run `attitude_node` and return its exit status."""
    return _guarded('attitude_node', lambda: _node(arguments), arguments)


def _parsed(parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int],
            arguments: Sequence[str] | None) -> int:
    def run() -> int:
        if sys.stdout is None:
            raise InputError('cannot write to standard output: it is closed')
        return command(parser.parse_args(arguments))
    return _guarded(parser.prog, run, arguments)


def _guarded(name: str, command: Callable[[], int], arguments: Sequence[str] | None) -> int:
    try:
        # Without arguments from elsewhere they are those of the process, which ends with this.
        with interrupts.listening(to_the_end=arguments is None):
            return _flushed(command)
    except InputError as error:
        _report(f'{name}: error: {error}')
        return USER_ERROR
    except ModuleNotFoundError as error:
        package = str(error.name).split('.')[0]
        if package == __package__:
            raise
        _report(f'{name}: error: there is no Python module {package!r}, which this needs: '
                f'python3 -m pip install {package}')
        return USER_ERROR
    except BrokenPipeError:
        sys.stdout = None  # or Python tries again at its end
        return SIGNALLED + _BROKEN_PIPE
    except KeyboardInterrupt as interrupt:
        told: list[Any] = [*interrupt.args] or [signal.SIGINT]  # without: Python's own handler
        number, *kept = told
        _report(f'{name}: interrupted; nothing incomplete has its final name{"".join(kept)}')
        return SIGNALLED + int(number)


def _flushed(command: Callable[[], int]) -> int:
    try:
        return command()
    except SystemExit:  # after --help, whose text is still to be written
        if sys.stdout is not None:
            _print('', end='')
        raise


def _report(text: str) -> None:
    """Print a line of bounded length to standard error, if it can be written."""
    if sys.stderr is None:
        return
    try:
        print(shortened(text), file=sys.stderr, flush=True)
    except OSError:
        sys.stderr = None  # or Python tries again at its end


def _node(arguments: Sequence[str] | None) -> int:
    try:
        from rigid_body_ros import node
    except ModuleNotFoundError as error:
        raise InputError(f"attitude_node needs ROS 2, and there is no module '{error.name}': "
                         'source a ROS 2 installation, or pip install "rigid_body_ros[ros]"') \
            from error
    node.main(arguments)
    return OK


def _replay(options: argparse.Namespace) -> int:
    with files.reading(*options.input), files.protected('scene', options.scene):
        if options.verify:
            return _verify(options)
        return _replay_many(options) if len(options.input) > 1 else _replay_one(options)


def _replay_one(options: argparse.Namespace) -> int:
    from rigid_body_ros import replay
    from rigid_body_ros.replay.report import summary
    path, = options.input
    files.check((options.output, replay.suffix_of(options.output)),
                *([(options.plot, '.png')] if options.plot else []))
    result = replay.replay(path, _scene(options), options.output, keep=bool(options.plot),
                           **_replay_options(options))
    if options.plot:
        with files.protected('output', options.output):
            replay.plot(options.plot, result, Path(path).name)
    written = [options.output, *filter(None, [options.plot])]
    _print(f'{summary(result)}\n{"wrote":14}{", ".join(written)}')
    return OK


def _scene(options: argparse.Namespace) -> Scene:
    scene = load(options.scene)
    for warning in scene.warnings:
        _report(f'{options.command}: warning: {options.scene}: {warning}')
    return scene


def _replay_options(options: argparse.Namespace) -> dict[str, Any]:
    return {'topic': options.topic, 'interpolation': options.interpolation, 'rate': options.rate,
            'until': options.until, 'start': options.start, 'time_source': options.time_source,
            'also': options.also}


def _replay_many(options: argparse.Namespace) -> int:
    from rigid_body_ros.replay.many import outputs_in, replay_many, table
    if options.plot:
        raise InputError(f'--plot: expected one recording, found {len(options.input)}')
    outputs_in(options.output, options.input)
    outcomes = replay_many(options.input, _scene(options), options.output,
                           **_replay_options(options))
    _print(table(outcomes))
    failed = [outcome.path for outcome in outcomes if outcome.error]
    if failed:
        raise InputError(f'{len(failed)} of {len(outcomes)} recordings failed: '
                         f'{", ".join(failed)}')
    return OK


def _verify(options: argparse.Namespace) -> int:
    from rigid_body_ros.replay.verify import summary, verify
    if len(options.input) > 1:
        raise InputError(f'--verify: expected one recording, found {len(options.input)}')
    idle = [name for name in ('rate', 'until', 'start', 'also', 'plot') if getattr(options, name)]
    if idle:
        raise InputError(f'--verify: compares at the stamps of the motion, found --{idle[0]}, '
                         'which chooses others')
    result = verify(options.input[0], _scene(options), options.verify,
                    topic=options.topic, interpolation=options.interpolation)
    _print(summary(result))
    return OK if result.same.all() else DIFFERENT


def _tradeoff(options: argparse.Namespace) -> int:
    from rigid_body_ros.tradeoff import report
    outputs = (options.json, '.json'), (options.plot, '.png')
    with files.reading(options.recording), files.protected('scene', options.scene):
        files.check(*(output for output in outputs if output[0]))
        result = _measured(options)
        if options.json:
            with files.whole(options.json, '.json') as part:
                text = json.dumps(report.figures(result), indent=1)
                part.write_text(f'{text}\n', encoding='utf-8')
        if options.plot:
            with files.protected('output', options.json):
                _plot_tradeoff(options.plot, result, Path(options.recording or options.scene).name)
    _print(report.summary(result))
    return OK


def _measured(options: argparse.Namespace) -> Tradeoff:
    from rigid_body_ros import replay
    from rigid_body_ros.tradeoff import measure
    loaded = _scene(options)
    log, start, end_ns, where = None, loaded.start, None, options.scene
    if options.recording:
        recorded, log, start = replay.read(options.recording, loaded, options.topic)
        end_ns = replay.end_of(options.recording, int(log.times_ns[-1]), start.time_ns)
        where = f'{options.recording}: {recorded.topic}'
    try:
        return measure(loaded.body, start, log, end_ns=end_ns, target=options.target,
                       torque_timeout=loaded.values['torque_timeout'],
                       track=replay.bar('measuring', ' runs'))
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error


def _plot_tradeoff(path: str, result: Tradeoff, title: str) -> None:
    from rigid_body_ros.report import figures
    from rigid_body_ros.tradeoff import report
    lines = {'rounding floor': result.floor, 'last digits': result.last_digits,
             'target': result.target}
    if result.reading:
        lines[f'{result.reading.interpolation} between samples'] = result.reading.estimate
    with files.whole(path, '.png') as part:
        figures.work_precision(part, report.curves(result), title, lines)


def _print(text: str, end: str = '\n') -> None:
    encoding = sys.stdout.encoding or 'utf-8'  # a file name need not be text
    try:
        print(text.encode(encoding, 'backslashreplace').decode(encoding), end=end, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        sys.stdout = None  # or Python tries again at its end
        raise InputError(f'cannot write to standard output: {error.strerror}') from error


class _Once(argparse.Action):
    """Store the value of an option, and refuse a second one, which would replace it."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace,
                 values: Any, option_string: str | None = None) -> None:
        """
        Store a value.

        Raises
        ------
        InputError
            The option was given before.

        """
        given = vars(namespace).setdefault('given', {})
        if self.dest in given:
            raise InputError(f'{option_string}: expected once, found with {given[self.dest]!r} '
                             f'and with {values!r}')
        given[self.dest] = values
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    """A parser that takes no option twice, and raises if its help cannot be written."""

    def __init__(self, prog: str, description: str) -> None:
        super().__init__(prog=prog, description=description)
        self.register('action', None, _Once)
        self.set_defaults(command=prog)

    def print_help(self, file: Any = None) -> None:
        """Print the help; unlike argparse, raise an exception if it cannot be written."""
        _print(self.format_help(), end='')


def replay_parser() -> argparse.ArgumentParser:
    """Return what reads the arguments of `attitude_replay`."""
    parser = _Parser(
        prog='attitude_replay', description='Turn recorded torques into recorded motion.')
    parser.add_argument('input', metavar='INPUT', nargs='+',
                        help='recording of torques: an MCAP file, a bag of rosbag2, or a CSV file '
                        'of time (s), tx, ty, tz (N m), or with names and units in its first line')
    parser.add_argument('--scene', required=True, metavar='FILE',
                        help='ROS 2 parameter file with inertia and start, as for attitude_node')
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument('-o', '--output', metavar='OUTPUT',
                        help='where to write attitude, euler_angles and angular_velocity: an MCAP '
                        'file, or, if the name does not end in .mcap, a new folder of rosbag2; '
                        'for several recordings a folder of MCAP files')
    target.add_argument('--verify', metavar='MOTION',
                        help='recording of a motion to compare with, bit for bit: the states that '
                        'a node committed, or the attitude of a replay; exit status 1 if they '
                        'differ')
    parser.add_argument('--topic', help='of the torques; needed where there are several')
    parser.add_argument('--interpolation', choices=('hold', 'linear', 'cubic'),
                        help="what a torque does between its samples, instead of the scene's")
    parser.add_argument('--rate', type=_positive, metavar='HZ',
                        help='of the output; otherwise at the stamps of the torques')
    parser.add_argument('--start', type=_positive, default=0.0, metavar='SECONDS',
                        help='leave out torques from before this long after the first')
    parser.add_argument('--also', nargs='+', choices=('imu', 'tf', 'markers', 'input'), default=(),
                        help='write /imu/data, /tf or what rviz and Foxglove draw (/marker/...), '
                        'too, or copy the messages of the input')
    parser.add_argument('--until', '--duration', type=_positive, metavar='SECONDS',
                        help='end, counted from the start; otherwise the last stamp')
    parser.add_argument('--time-source', choices=('header', 'log', 'publish'), default='header',
                        help='where the time of a torque is taken from (default: header)')
    parser.add_argument('--plot', metavar='PNG', help='draw angles, rates and torque over time')
    return parser


def tradeoff_parser() -> argparse.ArgumentParser:
    """Return what reads the arguments of `attitude_tradeoff`."""
    parser = _Parser(
        prog='attitude_tradeoff',
        description='Measure what every solver costs, and how far off it is, on your own motion.')
    parser.add_argument('--scene', required=True, metavar='FILE',
                        help='ROS 2 parameter file with inertia and start, as for attitude_node')
    parser.add_argument('--recording', metavar='IN', help='recording of torques, as for '
                        'attitude_replay; otherwise 50 turns without torque')
    parser.add_argument('--topic', help='of the torques; needed where there are several')
    parser.add_argument('--target', type=_angle, default=1e-6, metavar='RAD',
                        help='attitude error that is allowed (default: 1e-6)')
    parser.add_argument('--json', metavar='OUT', help='write all figures, with their units')
    parser.add_argument('--plot', metavar='PNG', help='draw cost over error, a curve a solver')
    return parser


def _positive(text: str) -> float:
    return _number(text, 1e-9, 1e9)


def _angle(text: str) -> float:
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
