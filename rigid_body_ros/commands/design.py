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

"""The command `attitude_design`."""

from __future__ import annotations

import argparse
from dataclasses import replace
import math
from pathlib import Path
import re
from typing import TYPE_CHECKING

from rigid_body_ros.commands.arguments import estimate, load_scene, note, prior
from rigid_body_ros.commands.command import Command, Parser, positive, within
from rigid_body_ros.commands.outputs import checked
from rigid_body_ros.common.errors import InputError, located
from rigid_body_ros.runtime.terminal import progress

if TYPE_CHECKING:
    from rigid_body_ros.design.information import Instrument
    from rigid_body_ros.design.maneuver import Maneuvers
    from rigid_body_ros.scene import Scene

#: The exit statuses of the command, which are explained in docs/commands.md.
OK, PARTIAL = 0, 3
#: Minimum number of samples of the torque in a maneuver.
_SAMPLES = 24
#: A topic whose name contains one of these words measures rates by default.
_GYRO = re.compile('gyro|imu|rate|angular_velocity')
_SENSOR = re.compile(r'([^:@]+)(:attitude|:rates)?:([^:@]+)(?:@([^:@]+))?')


def _run(options: argparse.Namespace) -> int:
    from rigid_body_ros.design.information import Question
    from rigid_body_ros.design.search import design
    output = options.output or ''
    is_csv = output.lower().endswith('.csv')
    if output and not is_csv and Path(output).suffix.lower() != '.mcap':
        raise InputError(f'-o: expected a name ending in .mcap or .csv, found {output}')
    with checked(options, (output, '.csv' if is_csv else '.mcap')) as outputs:
        scene = load_scene(options)
        maneuvers = _maneuvers(options, scene)
        if output and (maneuvers.is_free or (is_csv and scene.named_wheels)):
            raise InputError('-o: expected none without torque, and .mcap for named wheels, '
                             f'found {output}')
        question = Question([name for name in options.estimate if name != 'start'],
                            options.sensors, dict(options.prior), options.criterion)
        with located(options.scene):
            result = design(maneuvers, question, progress('designing', ' maneuvers'))
        if not maneuvers.is_free and scene.start.angular_velocity.any():
            note(options, f'{options.scene}: the maneuver starts at rest, without the '
                          'initial_angular_velocity of the scene')
        if output:
            with outputs.writing(output):
                result.write(output, scene)
        outputs.write_asked(scene, lambda: result.report(Path(options.scene).name),
                            result.as_dict)
    outputs.show(result.text(), 17)
    return PARTIAL if result.expected.unknown_names else OK


def _maneuvers(options: argparse.Namespace, scene: Scene) -> Maneuvers:
    """Return the maneuvers within the given limits, and those of the motors of the scene."""
    import numpy as np
    from rigid_body_ros.design.maneuver import Maneuvers, NO_LIMITS
    from rigid_body_ros.report.text import numbers
    wheels, problem, limits = scene.named_wheels, scene.problem(), {**NO_LIMITS}
    if not wheels and 'wheel_speed' in dict(options.limit):
        raise InputError('--limit wheel_speed: expected wheel_names in the scene, found none')
    for name, values in options.limit:
        if [given for given, _ in options.limit].count(name) > 1:
            raise InputError(f'--limit {name}: expected once, found it several times')
        count = (len(wheels) or 3) if name.startswith('torque') else 1
        if len(values) not in (1, count):
            raise InputError(f'--limit {name}: expected {"1 number or " * (count > 1)}{count}, '
                             f'found {len(values)}')
        limits[name] = np.resize(values, count)
    for name, own in (('torque', 'max_torque'), ('wheel_speed', 'max_speed')):
        limits[name] = np.minimum(limits[name], [getattr(wheel, own) or math.inf
                                                 for wheel in wheels] or math.inf)
    if wheels:  # the limits of the motors are now among those of the maneuver
        problem = problem.replaced(wheels=[replace(wheel, max_torque=0.0, max_speed=0.0)
                                           for wheel in wheels])
    is_free = not limits['torque'].any() and np.isfinite(limits['rate'])
    if not is_free and not (np.isfinite(limits['torque']) & (limits['torque'] > 0.0)).all():
        found = f'torque={numbers(limits["torque"], 6, ",")}' \
            if np.isfinite(limits['torque']).any() else 'no torque'
        raise InputError('--limit: expected a torque greater than zero about all axes, or '
                         f'torque=0 and a rate, found {found}')
    if not is_free and options.duration * options.rate < _SAMPLES:
        raise InputError(f'--duration: expected at least {_SAMPLES} samples of the torque, found '
                         f'{options.duration:g} s at {options.rate:g} Hz; see --rate')
    for sensor in options.sensors:
        if options.duration * sensor.hz < 1.0:
            raise InputError(f'--sensors: {sensor.topic}: expected a measurement during the '
                             f'maneuver, found {sensor.hz:g} Hz in {options.duration:g} s')
    return Maneuvers(problem, limits, options.duration, options.rate)


def _limit(text: str) -> tuple[str, list[float]]:
    from rigid_body_ros.design.maneuver import LIMITS
    name, _, values = text.partition('=')
    is_angle = name in ('rate', 'angle')
    plain = values.removesuffix('deg') if is_angle else values
    if name not in LIMITS:
        raise argparse.ArgumentTypeError(
            f'expected NAME=VALUE with a name among {", ".join(LIMITS)}, found {text!r}')
    try:
        numbers = [0.0 if number == '0' and name == 'torque' else positive(number)
                   for number in plain.split(',')]
        numbers = numbers if plain == values else [*map(math.radians, numbers)]
        if name == 'angle' and max(numbers) > math.pi:
            raise argparse.ArgumentTypeError(f'expected at most pi rad, found {values!r}')
    except argparse.ArgumentTypeError as error:
        hint = '; degrees end in deg' if is_angle else ''
        raise argparse.ArgumentTypeError(f'{name}: {error}{hint}') from error
    return name, numbers


def _sensors(text: str) -> list[Instrument]:
    from rigid_body_ros.design.information import Instrument
    sensors = []
    for part in text.split(','):
        found = _SENSOR.fullmatch(part.strip())
        if not found:
            raise argparse.ArgumentTypeError(
                'expected TOPIC:attitude:RAD or TOPIC:rates:RAD/S, and @HZ if the sensor does '
                f'not measure at 100 Hz, found {part!r}')
        topic, quantity, noise, hz = found.groups()
        is_attitude = quantity == ':attitude' if quantity else not _GYRO.search(topic)
        sensors.append(Instrument(topic, is_attitude, positive(noise), positive(hz or '100')))
    return sensors


def _add_arguments(parser: Parser) -> None:
    parser.add_scene()
    parser.add_argument('--limit', type=_limit, action='append', required=True,
                        metavar='NAME=VALUE', help='torque (N m) or torque_rate (N m/s), for all '
                        'or for each axis or named wheel; rate (rad/s), angle from the start '
                        '(rad), as in angle=40deg, or wheel_speed (rad/s); may be repeated. With '
                        'torque=0, only the initial angular velocity is chosen')
    parser.add_argument('--duration', type=positive, required=True, metavar='SECONDS',
                        help='duration of the maneuver')
    parser.add_argument('--sensors', type=_sensors, required=True, metavar='TOPIC:NOISE,...',
                        help='sensors with their noise: TOPIC:attitude:RAD or TOPIC:rates:RAD/S, '
                        'and @HZ unless 100 Hz. By default, topics with imu, gyro, rate or '
                        'angular_velocity in their names measure rates, and others attitudes')
    parser.add_argument('--estimate', type=estimate, default=('inertia',), metavar='NAMES',
                        help='what to identify, as for attitude_identify (default: inertia); the '
                        'start is always estimated')
    parser.add_argument('--prior', type=prior, action='append', default=[], metavar='NAME=SIGMA',
                        help='what is known, as for attitude_identify; with a prior of the '
                        'inertia, the maneuver also suits three bodies drawn from it')
    parser.add_argument('--criterion', choices=('minmax', 'D', 'A'), default='minmax',
                        help='what to make small: the widest interval (minmax, the default), the '
                        'volume of all (D), or the sum of their squares (A), each relative to its '
                        'scale')
    parser.add_argument('--rate', type=within(1.0, 1000.0), default=50.0, metavar='HZ',
                        help='rate of the torque samples (default: 50)')
    parser.add_argument('-o', '--output', metavar='PROFILE', help='write the torques, and the '
                        'motion as a reference for a controller, as MCAP or CSV')
    parser.add_outputs('json', 'plot')


attitude_design = Command(
    'attitude_design',
    'Design the maneuver after which attitude_identify knows most. Print the expected intervals '
    'beside those after a doublet, a multisine and a chirp within the same limits, and what would '
    'make them narrower. If no maneuver determines all estimates, the exit status is 3.',
    ('--scene config/tumbler.yaml --limit torque=0.1 --limit rate=1 --limit angle=40deg '
     '--duration 20 --sensors /imu:0.002,/mocap:0.002 -o fly.mcap',
     '--scene config/tumbler.yaml --limit torque=0 --limit rate=1 --duration 30 '
     '--sensors /imu:rates:0.001 --prior inertia.ixx=1%'),
    _add_arguments, _run)
