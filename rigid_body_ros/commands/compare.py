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

"""The command `attitude_compare`."""

from __future__ import annotations

import argparse
from pathlib import Path

from rigid_body_ros.commands import arguments
from rigid_body_ros.commands.command import Command, Parser, positive
from rigid_body_ros.commands.outputs import checked
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.runtime.terminal import progress, report

#: The exit status if the model does not explain the measurements.
REJECTED = 4


def _run(options: argparse.Namespace) -> int:
    from rigid_body_ros.comparison.comparison import compare_recording, compare_sensors, write
    from rigid_body_ros.comparison.result import report_of
    from rigid_body_ros.inference.noise import FEWEST
    from rigid_body_ros.recording import suffix_of
    name = Path(options.recording).name
    with checked(options, (options.output, suffix_of(options.output or ''))) as outputs:
        scene = arguments.load_scene(options) if options.scene else None
        _check_use(options)
        align = {*options.align, *(['start'] if options.check else [])}
        if scene:
            arguments.warn_of_units(options, [options.recording])
        reading, track = arguments.reading_of(options), progress('comparing', ' steps')
        comparison = compare_recording(
            options.recording, scene, reading, motion=options.motion, align=align,
            horizons=options.horizon, track=track) if scene else \
            compare_sensors(options.recording, reading, align, track)
        arguments.warn_of_samples(options, options.recording, comparison.torques,
                                  comparison.measured)
        if options.check and not comparison.verdict:
            raise InputError(f'{options.recording}: --check: expected at least {FEWEST} samples '
                             f'during the motion, found {comparison.samples}')
        if options.output:
            with outputs.writing(options.output):
                write(options.output, comparison, scene.body_frame if scene else '')
        outputs.write_asked(scene, lambda: report_of(comparison, name, options.degrees),
                            comparison.as_dict)
    outputs.show(comparison.text(options.degrees), 17)
    if not options.check or not comparison.verdict or comparison.verdict.level != 'rejected':
        return 0
    report(f'{options.command}: the model does not explain the measurements')
    return REJECTED


def _check_use(options: argparse.Namespace) -> None:
    """Raise InputError if an option needs a scene, or a motion that is computed."""
    names, what = ['check', 'start', 'until'], 'a motion that is computed, found --motion'
    if not options.scene:
        names += ['horizon', 'motion', 'topic', 'wheel_torque', 'wheel_momentum', 'wheel_command',
                  'inertia', 'interpolation']
        what = '--scene, found none'
    for name in names if options.motion or not options.scene else ():
        if getattr(options, name):
            option = name.replace('start', 'from').replace('_', '-')
            raise InputError(f'--{option}: expected {what}')


def _add_arguments(parser: Parser) -> None:
    parser.add_argument('recording', metavar='RECORDING',
                        help='recording of torques and measurements, as for attitude_replay')
    parser.add_scene('. Without it, compare the measured topics with each other')
    parser.add_measured(
        'measured topic, or CSV file or TUM trajectory; may be repeated (default: the only topic '
        'of a type with attitudes)')
    parser.add_argument('--motion', metavar='FILE',
                        help='compare with this motion, such as the output of attitude_replay, '
                        'instead of computing one')
    parser.add_argument('--align', type=_names, default=(), metavar='NAMES',
                        help='what to fit, separated by commas: start (the initial state), clock '
                        '(a clock offset for each sensor), mount (the axes of each sensor, and '
                        'the space axes); clock@TOPIC and mount@TOPIC for one sensor (default: '
                        'nothing)')
    parser.add_argument('--horizon', type=positive, action='append', metavar='SECONDS',
                        help='restart the model from the measurement every SECONDS, and report '
                        'the error at the end; may be repeated (default: 0.1, 1 and 10)')
    parser.add_argument('--check', action='store_true',
                        help='fit the initial state, and exit with status 4 if the model does not '
                        'explain the measurements')
    parser.add_argument('-o', '--output', metavar='RESIDUALS',
                        help='write the errors and the residual torque to this MCAP file or, '
                        'without .mcap, rosbag2 folder')
    parser.add_degrees()
    parser.add_outputs('json', 'plot')


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(','))
    try:
        from rigid_body_ros.inference.align import check_names
        check_names(names)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return names


attitude_compare = Command(
    'attitude_compare',
    'Compare measured attitudes and angular velocities with the motion under '
    'recorded torques. Print how large the errors are, and what probably causes them.',
    ('test/recordings/flight.mcap --scene config/tumbler.yaml --horizon 1',
     'test/recordings/flight.mcap --scene config/tumbler.yaml --check '
     '--report errors.html'),
    _add_arguments, _run)
