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

"""The command `attitude_identify`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import json
from pathlib import Path
from typing import TYPE_CHECKING

from rigid_body_ros.commands.arguments import (
    add_overwrite,
    add_report,
    add_scene,
    add_torques,
    command_line,
    load_scene,
    parsed,
    Parser,
    positive,
    show_summary,
    warn_of_frames,
)
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.terminal import progress, report

if TYPE_CHECKING:
    from rigid_body_ros.identification import Experiment, Identification
    from rigid_body_ros.scene import Scene

#: Exit statuses; docs/nodes.md has their meaning.
OK, PARTIAL = 0, 3


def attitude_identify(arguments: Sequence[str] | None) -> int:
    """Estimate parameters of a body from measured motions."""
    options = parsed(identify_parser(), arguments)
    with files.reading(*options.recording), files.protected('scene', options.scene), \
            files.overwriting(options.overwrite):
        files.check(*_outputs(options))
        scene = load_scene(options)
        fit, first = _identified(options, scene)
        written = _write(options, fit, first, scene) if fit.is_complete or options.force \
            else []
    from rigid_body_ros.identification.summary import summary
    show_summary(summary(fit), 17, written)
    if not fit.is_complete:
        report(f'{options.command}: {_incomplete(options, fit)}')
    return OK if fit.is_complete else PARTIAL


def _incomplete(options: argparse.Namespace, fit: Identification) -> str:
    names = [name for name, one in fit.estimates.items() if not one.identifiable]
    text = f'the data does not determine {listed(names)}' if names \
        else 'the fit did not converge'
    if [*_outputs(options)] and not options.force:
        text += '; nothing was written (--force writes it)'
    return text


def _outputs(options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    for name, suffix in ((options.output, '.yaml'), (options.json, '.json'),
                         (options.plot, '.png'), (options.report, '.html')):
        if name:
            yield name, suffix


def _identified(options: argparse.Namespace,
                scene: Scene) -> tuple[Identification, Experiment]:
    """Return the result, and the first recording."""
    from rigid_body_ros import replay
    from rigid_body_ros.comparison.recorded import Reading
    from rigid_body_ros.identification import identify
    from rigid_body_ros.identification.recorded import read_experiments
    reading = Reading(options.interpolation, options.time_source,
                      options.frames and tuple(options.frames),
                      progress('reading', size=len))
    topics = replay.topics_of(options.topic, options.wheel_torque, options.wheel_momentum)
    experiments = read_experiments(options.recording, scene, options.measured or (), topics,
                                   reading)
    for path, experiment in zip(options.recording, experiments):
        warn_of_frames(options, path, experiment.measured)
    try:
        fit = identify(scene.body, experiments, estimate=options.estimate,
                       attitude_noise=options.attitude_noise, rate_noise=options.rate_noise,
                       validate=options.validate,
                       torque_timeout=scene.torque_timeout)
    except ValueError as error:
        raise InputError(f'{options.recording[0]}: {error}') from error
    return fit, experiments[0]


def _write(options: argparse.Namespace, fit: Identification, first: Experiment,
           scene: Scene) -> list[str]:
    """Write the outputs, and return their names."""
    from rigid_body_ros.identification.recorded import fitted_scene
    written: list[str] = []
    for name, suffix, text in (
            (options.json, '.json', f'{json.dumps(fit.as_dict(), indent=1)}\n'),
            (options.output, '.yaml', fitted_scene(scene, fit))):
        if name:
            with files.protected('output', *written), files.atomic_output(name, suffix) as path:
                path.write_text(text, encoding='utf-8')
            written.append(name)
    if options.plot:
        from rigid_body_ros.identification import plot  # matplotlib takes long to load
        with files.protected('output', *written), \
                files.atomic_output(options.plot, '.png') as path:
            plot.draw(path, fit, first, Path(options.recording[0]).name)
        written.append(options.plot)
    if options.report:
        with files.protected('output', *written):
            _write_page(options, fit, first, scene)
        written.append(options.report)
    return written


def _write_page(options: argparse.Namespace, fit: Identification, first: Experiment,
                scene: Scene) -> None:
    from rigid_body_ros.identification.page import page
    from rigid_body_ros.report.page import write
    line = command_line(options, 'recording', 'scene', 'output', 'json', 'plot', 'report')
    write(options.report, page(fit, first, Path(options.recording[0]).name, scene, line))


def identify_parser() -> argparse.ArgumentParser:
    """Return the argument parser of `attitude_identify`."""
    parser = Parser(
        prog='attitude_identify',
        description='Estimate the inertia of a body, and other parameters, from measured '
        'attitudes and angular velocities under recorded torques. Print the estimates with their '
        'uncertainty; write a fitted scene. If the data does not determine all of them, write '
        'nothing; the exit status is then 3.')
    parser.add_argument('recording', metavar='RECORDING', nargs='+',
                        help='recording of torques and measurements, as for attitude_replay; '
                        'several of the same body are fitted together')
    add_scene(parser)
    parser.add_argument('--measured', action='append', metavar='TOPIC',
                        help='measured topic, as for attitude_compare; may be repeated (default: '
                        'the only topic of an attitude)')
    parser.add_argument('--frames', nargs=2, metavar=('PARENT', 'CHILD'),
                        help='the two frames of measured transforms or odometry (default: those '
                        'of the scene)')
    parser.add_argument('--estimate', type=_names, default=('inertia', 'start'), metavar='NAMES',
                        help='what to estimate, separated by commas: inertia or inertia_diagonal, '
                        'start, torque_gain, torque_bias, clock_offset, mount, gyro_bias, '
                        'damping, rotor_momentum (default: inertia,start)')
    parser.add_argument('--attitude-noise', type=positive, metavar='RAD',
                        help='standard deviation of each component of a measured attitude '
                        '(default: estimated for each topic)')
    parser.add_argument('--rate-noise', type=positive, metavar='RAD/S',
                        help='standard deviation of each component of a measured angular velocity '
                        '(default: estimated for each topic)')
    parser.add_argument('--validate', type=_fraction, default=0.0, metavar='FRACTION',
                        help='do not fit this fraction at the end of each recording, but predict '
                        'it, and report the errors')
    add_torques(parser)
    parser.add_argument('--interpolation', choices=('hold', 'linear', 'cubic'),
                        help="interpolation of the torques between samples (default: the scene's)")
    parser.add_argument('--time-source', choices=('header', 'log', 'publish'), default='header',
                        help='time of torques and measurements: the stamp in the header, or when '
                        'the message was logged or published (default: header)')
    parser.add_argument('-o', '--output', metavar='FITTED', help='write the scene with the '
                        'estimates to this YAML file')
    parser.add_argument('--force', action='store_true', help='write the outputs even if the data '
                        'does not determine all estimates')
    parser.add_argument('--json', metavar='OUT', help='write the result to this file')
    parser.add_argument('--plot', metavar='PNG', help='plot the errors of the first recording '
                        'over time, with its torques')
    add_report(parser, 'the estimates, these plots and the summary')
    add_overwrite(parser)
    return parser


def _names(text: str) -> tuple[str, ...]:
    from rigid_body_ros.identification.parameters import checked_names
    try:
        return checked_names([name.strip() for name in text.split(',')])
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix('estimate: ')) from error


def _fraction(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 0.9:
        raise argparse.ArgumentTypeError(f'expected a fraction from 0 to 0.9, found {text!r}')
    return value
