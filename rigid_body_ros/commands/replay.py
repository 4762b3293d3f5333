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

"""The command `attitude_replay`."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any, TYPE_CHECKING

from rigid_body_ros.commands.arguments import length_of, load_scene, note, topics_of, warn_of_units
from rigid_body_ros.commands.command import Command, Parser, positive
from rigid_body_ros.commands.outputs import checked
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.runtime.terminal import show

if TYPE_CHECKING:
    from rigid_body_ros.ensemble.band import Band
    from rigid_body_ros.recording import Logged
    from rigid_body_ros.scene import Scene

#: The exit statuses of the command, which are explained in docs/commands.md.
OK, DIFFERENT = 0, 1


def _run(options: argparse.Namespace) -> int:
    count = len(options.input)
    for name in ('verify', 'plot', 'report', 'uncertain'):
        if getattr(options, name) and count > 1:
            raise InputError(f'--{name}: expected one recording, found {count}')
    if options.verify:
        return _verify(options)
    warn_of_units(options, options.input)
    if count > 1:
        return _replay_many(options)
    return _replay_one(options)


def _replay_one(options: argparse.Namespace) -> int:
    from rigid_body_ros import replay
    from rigid_body_ros.replay.outputs import suffix_of
    path, = options.input
    name = Path(path).name
    if options.also and not options.output:
        raise InputError('--also: expected an output file or folder (-o), found none')
    with checked(options, (options.output, suffix_of(options.output or ''))) as outputs:
        scene, collect, band, logged = load_scene(options), None, None, None
        if options.uncertain:
            logged, band = _uncertain(options, path, scene)
            scene = band.scene_of(scene)
        if options.report or options.plot:  # otherwise, do not import what reports need
            from rigid_body_ros.replay.report import ReportCollector
            collect = partial(ReportCollector, scene)
        with outputs.writing(options.output):
            result = replay.replay(path, scene, options.output, keep=False, collect=collect,
                                   logged=logged, **_replay_options(options))
        result.uncertain = band.rows(Path(options.uncertain).name) if band else ()
        collected: Any = result.collected  # a `ReportCollector` if there is a report to write
        outputs.write_asked(scene, lambda: collected.report(
            result, name, band.panels if band else list))
    outputs.show(result.text(), 14)
    return OK


def _uncertain(options: argparse.Namespace, path: str, scene: Scene) -> tuple[Logged, Band]:
    """Return the torques with the mean values of --uncertain, and the band."""
    from rigid_body_ros import recording
    from rigid_body_ros.ensemble.band import band_of
    from rigid_body_ros.ensemble.dispersions import load_varied
    from rigid_body_ros.ensemble.runs import Ensemble
    from rigid_body_ros.replay.batches import end_of
    reading = recording.Reading(
        topics=topics_of(options).found_in(path, scene), interpolation=options.interpolation,
        time_source=options.time_source, start=options.start)
    logged = recording.chosen(path, scene, recording.read_epochs(path, scene, reading),
                              may_change=True)
    end_ns = end_of(path, int(logged.times_ns[-1]), logged.problem.start.time_ns,
                    _length(options))
    varied, estimates = load_varied(options.uncertain, scene.values['fields'])
    if estimates and estimates.ignored:
        note(options, f'{options.uncertain}: {listed(estimates.ignored)}: no effect on the motion')
    try:
        band = band_of(Ensemble(logged.problem, end_ns, varied, 0, estimates))
    except ValueError as error:
        raise InputError(f'{options.uncertain}: {error}; attitude_ensemble --vary '
                         f'{options.uncertain} does without derivatives') from error
    return logged._replace(problem=band.problem), band


def _replay_options(options: argparse.Namespace) -> dict[str, Any]:
    names = ('topic', 'wheel_torque', 'wheel_momentum', 'wheel_command', 'inertia',
             'interpolation', 'rate', 'start', 'time_source', 'also', 'columns')
    return {**{name: getattr(options, name) for name in names}, 'until': _length(options)}


def _length(options: argparse.Namespace) -> float | None:
    return length_of(options) if options.duration is None else float(options.duration)


def _replay_many(options: argparse.Namespace) -> int:
    from rigid_body_ros.replay.many import outputs_in, replay_many, table
    if not options.output:
        raise InputError('-o: expected a folder for several recordings, found none')
    with checked(options) as outputs, outputs.writing():
        outputs_in(options.output, options.input)
        outcomes = replay_many(options.input, load_scene(options), options.output,
                               **_replay_options(options))
    show(table(outcomes))
    failed = [outcome.path for outcome in outcomes if outcome.error]
    if failed:
        raise InputError(f'{len(failed)} of {len(outcomes)} recordings failed: '
                         f'{", ".join(failed)}')
    return OK


def _verify(options: argparse.Namespace) -> int:
    from rigid_body_ros.replay.verify import verify
    unused = [name for name in ('rate', 'start', 'also', 'plot', 'report', 'uncertain')
              if getattr(options, name)]
    if unused:
        name = unused[0].replace('start', 'from')
        raise InputError(f'--verify: cannot be combined with --{name}')
    result = verify(options.input[0], load_scene(options), options.verify,
                    topics_of(options), interpolation=options.interpolation,
                    until=_length(options))
    show(result.text())
    return OK if result.same.all() else DIFFERENT


def _add_arguments(parser: Parser) -> None:
    parser.add_argument('input', metavar='INPUT', nargs='+',
                        help='torque recording: MCAP file, rosbag2 bag, PX4 log (.ulg) or CSV '
                        'file with the columns time (s), tx, ty, tz (N m) or a heading')
    parser.add_scene()
    parser.add_torques()
    target = parser.add_mutually_exclusive_group()
    target.add_argument('-o', '--output', metavar='OUTPUT',
                        help='write the motion to this MCAP file, CSV file (.csv) or, without '
                        'suffix, rosbag2 folder; for several recordings, to a folder of MCAP '
                        'files')
    target.add_argument('--verify', metavar='MOTION',
                        help='compare the motion bit for bit with the committed states of a node, '
                        'or the attitudes of a replay (not CSV)')
    parser.add_interpolation()
    parser.add_argument('--rate', type=positive, metavar='HZ',
                        help='output rate (default: one output at each torque stamp)')
    parser.add_argument('--also', nargs='+', choices=('imu', 'tf', 'markers', 'input'), default=(),
                        help='with -o, also write /imu/data, /tf, markers for rviz and Foxglove, '
                        'or a copy of the input messages')
    parser.add_span('--start').add_argument(
        '--duration', type=positive, metavar='SECONDS',
        help='end the motion, or each epoch of the log of a node, SECONDS after its start '
        '(default: at the last torque stamp)')
    parser.add_argument('--uncertain', metavar='FILE',
                        help='compute the uncertainty of the motion, without sampling, from a '
                        'file as for attitude_ensemble --vary, whose mean values apply')
    parser.add_time_source()
    parser.add_outputs('plot')


attitude_replay = Command(
    'attitude_replay',
    'Compute the motion of a body from recorded torques, and print a summary. With -o, write '
    'the motion; with --plot, write a plot.',
    ('test/recordings/tumbler.mcap --scene config/tumbler.yaml --report motion.html',
     'test/recordings/iss.mcap --scene config/iss.yaml --rate 0.1 -o motion.mcap'),
    _add_arguments, _run)
