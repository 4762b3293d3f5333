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
from pathlib import Path
from typing import TYPE_CHECKING

from rigid_body_ros.commands import arguments
from rigid_body_ros.commands.command import Command, Parser, positive, within
from rigid_body_ros.commands.outputs import checked
from rigid_body_ros.common.errors import listed, located
from rigid_body_ros.runtime.terminal import report

if TYPE_CHECKING:
    from rigid_body_ros.identification import Identification
    from rigid_body_ros.propagation import Problem
    from rigid_body_ros.scene import Scene

#: The exit statuses of the command, which are explained in docs/commands.md.
OK, PARTIAL, REJECTED = 0, 3, 4


def _run(options: argparse.Namespace) -> int:
    from rigid_body_ros.identification.recorded import fitted_scene, fitted_urdf
    from rigid_body_ros.identification.result import report_of
    with checked(options, (options.output, _suffix(options.output))) as outputs:
        scene = arguments.load_scene(options)
        fit, first = _identified(options, scene)
        status, text = _status(fit)
        is_good = status == OK or options.force
        if options.output and is_good:
            fitted = fitted_urdf if _suffix(options.output) == '.urdf' else fitted_scene
            outputs.write_text(options.output, fitted(scene, fit))
        name = Path(options.recording[0]).name
        outputs.write_asked(scene, lambda: report_of(fit, first, name, options.degrees),
                            fit.as_dict)
    outputs.show(fit.text(options.degrees), 17,
                 [name for name in outputs.names if is_good or name != options.output])
    if status != OK:
        if options.output and not is_good:
            text += '; no scene was written (--force writes it)'
        report(f'{options.command}: {text}')
    return status


def _status(fit: Identification) -> tuple[int, str]:
    """Return the exit status, and a text that describes the problem ('' if all is well)."""
    if fit.verdict.level == 'rejected':  # then it does not matter what the data determines
        return REJECTED, 'the model does not explain the measurements'
    names = [name for name, estimate in fit.estimates.items() if not estimate.identifiable]
    if names:
        return PARTIAL, f'the data does not determine {listed(names)}'
    return (OK, '') if fit.is_complete else (PARTIAL, 'the fit did not converge')


def _identified(options: argparse.Namespace,
                scene: Scene) -> tuple[Identification, Problem]:
    """Identify parameters from all recordings; return the result and the first problem."""
    from rigid_body_ros.identification import identify
    from rigid_body_ros.identification.recorded import read_experiments
    from rigid_body_ros.inference.coordinates import GRAVITY
    if not {'torque_gain', 'torque_gains'} & {*options.estimate}:
        arguments.warn_of_units(options, options.recording)
    experiments = read_experiments(options.recording, scene, arguments.reading_of(options))
    for path, (_, observed) in zip(options.recording, experiments):
        arguments.warn_of_samples(options, path, observed.torques, observed.sensors)
    with located(options.recording[0]):
        fit = identify(
            scene.body, experiments, estimate=options.estimate,
            attitude_noise=options.attitude_noise, rate_noise=options.rate_noise,
            validate=options.validate, priors=dict(options.prior),
            gravity=options.gravity or GRAVITY, accept=options.accept)
    return fit, experiments[0][0]


def _suffix(output: str | None) -> str:
    """Return the suffix that stands for the format of an output."""
    return '.urdf' if output and output.lower().endswith('.urdf') else '.yaml'


def _add_arguments(parser: Parser) -> None:
    parser.add_argument('recording', metavar='RECORDING', nargs='+',
                        help='recording of torques and measurements, as for attitude_replay; '
                        'several recordings of the same body are fitted together')
    parser.add_scene()
    parser.add_measured('measured topic, or CSV file or TUM trajectory; may be repeated (default: '
                        'the only topic of a type with attitudes)')
    parser.add_argument('--estimate', type=arguments.estimate, default=('inertia', 'start'),
                        metavar='NAMES',
                        help='what to estimate, separated by commas (default: inertia,start): '
                        'inertia or inertia_diagonal, start, weight, damping, rotor_momentum, '
                        'NAME.moment of a field; torque_gain or torque_gains, torque_bias, '
                        'torque_delay or torque_lag; of sensors clock_offset, clock_drift, mount, '
                        'gyro_bias, gyro_scale, or of one sensor clock_offset@TOPIC')
    parser.add_argument('--prior', type=arguments.prior, action='append', default=[],
                        metavar='NAME=SIGMA',
                        help='standard deviation of the guess of a parameter, in its unit or in '
                        'percent of the guess, which is the value in the scene or has no effect; '
                        'of a parameter that is not estimated, its plausible size as a suspect; '
                        'may be repeated')
    parser.add_argument('--gravity', type=float, nargs=3, metavar=('X', 'Y', 'Z'),
                        help='gravity for weight, m/s^2, space axes (default: 0 0 -9.80665)')
    parser.add_argument('--accept', type=positive, metavar='PART',
                        help='reject the fit if the half-width of an interval exceeds this part '
                        'of its estimate or, for the inertia, of the mean moment of inertia '
                        '(default: any width)')
    parser.add_argument('--attitude-noise', type=positive, metavar='RAD',
                        help='standard deviation of each component of a measured attitude '
                        '(default: estimated)')
    parser.add_argument('--rate-noise', type=positive, metavar='RAD/S',
                        help='standard deviation of each component of a measured angular velocity '
                        '(default: estimated)')
    parser.add_argument('--validate', type=within(0.0, 0.9, 'a fraction'), default=0.0,
                        metavar='FRACTION', help='leave this part at the end of each recording '
                        'out of the fit, and report the prediction errors there')
    parser.add_argument('-o', '--output', metavar='FITTED', help='write the scene with the '
                        'estimates, or the inertia as a one-link URDF (.urdf)')
    parser.add_argument('--force', action='store_true', help='write the scene even if the data '
                        'does not determine all estimates, or the fit is rejected')
    parser.add_degrees()
    parser.add_outputs('json', 'plot')


attitude_identify = Command(
    'attitude_identify',
    'Estimate the inertia of a body, and other parameters, from measured attitudes and angular '
    'velocities under recorded torques. Print the estimates with their uncertainty, and whether '
    'the model explains the measurements. The exit status is 3 if the data does not determine all '
    'estimates, and 4 if the model is rejected; -o then needs --force.',
    ('test/recordings/flight.mcap --scene config/tumbler.yaml --measured /mocap '
     '-o fitted.yaml',
     'test/recordings/flight.mcap --scene config/tumbler.yaml --measured /mocap '
     '--measured /gyro --estimate inertia,start,mount@/gyro --validate 0.3'),
    _add_arguments, _run)
