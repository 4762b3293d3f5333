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
import os
from pathlib import Path
import signal
import sys
from typing import Any, TYPE_CHECKING

from rigid_body_ros import files, interrupts
from rigid_body_ros.errors import shortened
from rigid_body_ros.scene import InputError, load, Scene

if TYPE_CHECKING:
    from rigid_body_ros.tradeoff import Tradeoff

OK, USER_ERROR = 0, 2
#: What a shell adds to the number of a signal that ended a command.
SIGNALLED = 128


def attitude_replay(arguments: Sequence[str] | None = None) -> int:
    """Run `attitude_replay` and return its exit status."""
    options = replay_parser().parse_args(arguments)
    return _guarded(options.command, lambda: _replay(options), arguments)


def attitude_tradeoff(arguments: Sequence[str] | None = None) -> int:
    """Run `attitude_tradeoff` and return its exit status."""
    options = tradeoff_parser().parse_args(arguments)
    return _guarded(options.command, lambda: _tradeoff(options), arguments)


def attitude_node(arguments: Sequence[str] | None = None) -> int:
    """Run `attitude_node` and return its exit status."""
    return _guarded('attitude_node', lambda: _node(arguments), arguments)


def _guarded(name: str, command: Callable[[], None], arguments: Sequence[str] | None) -> int:
    try:
        # Without arguments from elsewhere they are those of the process, which ends with this.
        with interrupts.listening(to_the_end=arguments is None):
            command()
    except InputError as error:
        print(shortened(f'{name}: error: {error}'), file=sys.stderr)
        return USER_ERROR
    except ModuleNotFoundError as error:
        package = str(error.name).split('.')[0]
        if package == __package__:
            raise
        print(f'{name}: error: there is no Python module {package!r}, which this needs: '
              f'python3 -m pip install {package}', file=sys.stderr)
        return USER_ERROR
    except KeyboardInterrupt as interrupt:
        told: list[Any] = [*interrupt.args] or [signal.SIGINT]  # without: Python's own handler
        number, *kept = told
        print(f'{name}: interrupted; nothing incomplete has its final name{"".join(kept)}',
              file=sys.stderr)
        return SIGNALLED + int(number)
    return OK


def _node(arguments: Sequence[str] | None) -> None:
    try:
        from rigid_body_ros import node
    except ModuleNotFoundError as error:
        raise InputError(f"attitude_node needs ROS 2, and there is no module '{error.name}': "
                         'source a ROS 2 installation, or pip install "rigid_body_ros[ros]"') \
            from error
    node.main(arguments)


def _replay(options: argparse.Namespace) -> None:
    if options.verify:
        _verify(options)
        return
    if len(options.input) > 1:
        _replay_many(options)
        return
    from rigid_body_ros import replay
    from rigid_body_ros.replay.report import summary
    options.input, = options.input
    _check_apart(options, 'input', 'scene', 'output', 'plot')
    result = replay.replay(options.input, _scene(options), options.output,
                           keep=bool(options.plot), **_replay_options(options))
    if options.plot:
        replay.plot(options.plot, result, Path(options.input).name)
    written = [options.output, *filter(None, [options.plot])]
    _print(f'{summary(result)}\n{"wrote":14}{", ".join(written)}')


def _scene(options: argparse.Namespace) -> Scene:
    scene = load(options.scene)
    for doubt in scene.doubts:
        print(shortened(f'{options.command}: warning: {options.scene}: {doubt}'), file=sys.stderr)
    return scene


def _replay_options(options: argparse.Namespace) -> dict[str, Any]:
    return {'topic': options.topic, 'interpolation': options.interpolation, 'rate': options.rate,
            'until': options.until, 'start': options.start, 'time_source': options.time_source,
            'also': options.also}


def _replay_many(options: argparse.Namespace) -> None:
    from rigid_body_ros.replay.many import replay_many, table
    if options.plot:
        raise InputError(f'--plot: expected one recording, found {len(options.input)}')
    outcomes = replay_many(options.input, _scene(options), options.output,
                           **_replay_options(options))
    _print(table(outcomes))
    failed = [outcome.path for outcome in outcomes if outcome.error]
    if failed:
        raise InputError(f'{len(failed)} of {len(outcomes)} recordings failed: '
                         f'{", ".join(failed)}')


def _verify(options: argparse.Namespace) -> None:
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


def _tradeoff(options: argparse.Namespace) -> None:
    from rigid_body_ros import replay
    from rigid_body_ros.tradeoff import measure, report
    _check_apart(options, 'recording', 'scene', 'json', 'plot')
    loaded = _scene(options)
    log, start, end_ns, where = None, loaded.start, None, options.scene
    if options.recording:
        recorded, log, start = replay.read(options.recording, loaded, options.topic)
        end_ns = replay.end_of(options.recording, int(log.times_ns[-1]), start.time_ns)
        where = f'{options.recording}: {recorded.topic}'
    try:
        result = measure(loaded.body, start, log, end_ns=end_ns, target=options.target,
                         torque_timeout=loaded.values['torque_timeout'],
                         track=replay.bar('measuring', ' runs'))
    except ValueError as error:
        raise InputError(f'{where}: {error}') from error
    if options.json:
        with files.whole(options.json) as part:
            part.write_text(json.dumps(report.figures(result), indent=1) + '\n', encoding='utf-8')
    if options.plot:
        _plot_tradeoff(options.plot, result, Path(options.recording or options.scene).name)
    _print(report.summary(result))


def _plot_tradeoff(path: str, result: Tradeoff, title: str) -> None:
    from rigid_body_ros import plots
    from rigid_body_ros.tradeoff import report
    lines = {'series with other steps': result.floor, 'target': result.target}
    if result.reading:
        lines[f'{result.reading.interpolation} between samples'] = result.reading.estimate
    with files.whole(path) as part:
        plots.work_precision(part, report.curves(result), title, lines)


def _print(text: str) -> None:
    try:
        print(text, flush=True)
    except OSError as error:
        sys.stdout = None  # or Python tries again at its end
        raise InputError(f'cannot write to standard output: {error.strerror}') from error


def _check_apart(options: argparse.Namespace, *names: str) -> None:
    known: dict[Path, str] = {}
    for what in names:
        name = getattr(options, what)
        if name is not None:
            other = known.setdefault(Path(os.path.realpath(name)), what)
            if other != what:
                raise InputError(f'{name}: expected another file for the {what} than for the '
                                 f'{other}')


def replay_parser() -> argparse.ArgumentParser:
    """Return what reads the arguments of `attitude_replay`."""
    parser = argparse.ArgumentParser(
        prog='attitude_replay', description='Turn recorded torques into recorded motion.')
    parser.set_defaults(command=parser.prog)
    parser.add_argument('input', metavar='INPUT', nargs='+',
                        help='recording of torques: an MCAP file, a bag of rosbag2, or a CSV file '
                        'of time (s), tx, ty, tz (N m), or with names and units in its first line')
    parser.add_argument('--scene', required=True, metavar='FILE',
                        help='ROS 2 parameter file with inertia and start, as for attitude_node')
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument('-o', '--output', metavar='OUTPUT',
                        help='to write attitude, euler_angles and angular_velocity to: an MCAP '
                        'file, or without that ending a folder of rosbag2; for several recordings '
                        'a folder of MCAP files')
    target.add_argument('--verify', metavar='MOTION',
                        help='recording of a motion to compare with, bit for bit: the states that '
                        'a node committed, or the attitude of a replay')
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
    parser = argparse.ArgumentParser(
        prog='attitude_tradeoff',
        description='Measure what every solver costs, and how far off it is, on your own motion.')
    parser.set_defaults(command=parser.prog)
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
