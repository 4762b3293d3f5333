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

"""The command `attitude_regress`."""

from __future__ import annotations

import argparse
from contextlib import suppress
from functools import partial
import math
from pathlib import Path
import shutil
from tempfile import TemporaryDirectory
from typing import Any, TYPE_CHECKING

from rigid_body_ros.commands.arguments import load_scene
from rigid_body_ros.commands.command import Command, imported, Parser, positive, within
from rigid_body_ros.commands.outputs import checked, Outputs
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.terminal import report

if TYPE_CHECKING:
    from rigid_body_ros.regress import Regression, Span
    from rigid_body_ros.regress.open_loop import Answer

#: The exit status if the controller's loop differs from the reference.
DIFFERENT = 1
_SUFFIX = '.mcap'


def _run(options: argparse.Namespace) -> int:
    return _run_open_loop(options) if options.open_loop else _run_closed_loop(options)


def _run_closed_loop(options: argparse.Namespace) -> int:
    from rigid_body_ros.regress import compare, Session, update
    from rigid_body_ros.regress.processes import private_domain
    from rigid_body_ros.regress.report import report_of
    from rigid_body_ros.scene.parameters import LOCKSTEP
    with files.protected('scene', options.scene), \
            TemporaryDirectory(prefix='attitude_regress.') as folder:
        _check(options)
        with checked(options) as outputs:
            scene, place = load_scene(options, mode=LOCKSTEP), Path(folder)
            wheels = tuple(wheel.name for wheel in scene.named_wheels)
            start = partial(_node, options.command, 'recorded', 'RecordedNode', scene)
            session = Session(options.rest, start, options.timeout, wheels)
            with private_domain():
                result = update(session, _span(options, wheels), place, options.tolerance) \
                    if options.update else \
                    compare(session, options.reference, place, options.tolerance)
            name = Path(options.reference).name
            outputs.write_asked(scene, lambda: report_of(result, name, scene), result.as_dict)
        written = options.update and result.is_same
        if written:
            with files.atomic_output(options.reference, _SUFFIX) as path:
                shutil.copyfile(result.path, path)
    return _shown(options, result, outputs)


def _run_open_loop(options: argparse.Namespace) -> int:
    from rigid_body_ros.recording.all_messages import AllMessages
    from rigid_body_ros.regress import Session
    from rigid_body_ros.regress.open_loop import OpenLoop, WORDS
    from rigid_body_ros.regress.processes import private_domain
    from rigid_body_ros.report.report import Report
    _check_open_loop(options)
    with checked(options) as outputs, TemporaryDirectory(prefix='attitude_regress.') as folder:
        recorded = AllMessages(options.reference)
        node = imported(options.command, 'rigid_body_ros.node.open_loop')
        start = partial(_node, options.command, 'open_loop', 'OpenLoopNode', options.reference,
                        round(options.step * 1e9))
        loop = OpenLoop(recorded, Session(options.rest, start, options.timeout, words=WORDS),
                        node.fields_of, options.tolerance or {})
        with private_domain():
            result = (loop.update if options.update else loop.compare)(Path(folder), node.FED)
        title = f'{Path(options.reference).name}: open loop'
        outputs.write_asked(None, lambda: Report(title, result.verdict, result.rows()[1:]),
                            result.as_dict)
    if options.update and result.is_same:
        recorded.write(options.reference, result.messages)
    return _shown(options, result, outputs)


def _shown(options: argparse.Namespace, result: Regression | Answer,
           outputs: Outputs) -> int:
    """Print a result and the names of the outputs, and return the exit status."""
    written = [options.reference] if options.update and result.is_same else []
    outputs.show(result.text(), 14, [*written, *outputs.names])
    if result.is_same:
        return 0
    report(f'{options.command}: {result.verdict}')
    return DIFFERENT


def _check_open_loop(options: argparse.Namespace) -> None:
    """Raise InputError if options conflict, or if the recording cannot be replaced."""
    _check_command(options)
    for name in ('scene', 'duration'):
        if getattr(options, name) is not None:
            raise InputError(f'--{name}: expected no --open-loop, found it')
    if isinstance(options.tolerance, float):
        raise InputError('--tolerance: expected FIELD=VALUE,... with --open-loop, found '
                         f'{options.tolerance:g}')
    if options.update:
        with files.overwriting(options.overwrite):  # the recording is the user's
            files.check((options.reference, _SUFFIX))


def _check_command(options: argparse.Namespace) -> None:
    if not options.rest:
        name = 'node' if options.open_loop else 'controller'
        raise InputError(f"expected the command of a {name} after '--', found none")


def _check(options: argparse.Namespace) -> None:
    """Raise InputError if options conflict, or if the file to replace is not a reference."""
    _check_command(options)
    if options.step:
        raise InputError('--step: expected --open-loop, found none')
    if isinstance(options.tolerance, dict):
        raise InputError('--tolerance: expected an angle without --open-loop, found '
                         'FIELD=VALUE,...')
    if not options.scene:
        raise InputError('expected --scene or --open-loop, found neither')
    if options.duration and not options.update:
        raise InputError('--duration: expected --update, found none')
    if options.update:
        files.check((options.reference, _SUFFIX))
        if Path(options.reference).exists():
            from rigid_body_ros.regress.loop import committed
            committed(options.reference)  # only a reference may be replaced


def _node(command: str, module: str, name: str, *arguments: Any) -> Any:
    """Create a node; called in the process that runs it."""
    try:
        return getattr(imported(command, f'rigid_body_ros.node.{module}'), name)(*arguments)
    except RuntimeError as error:  # from the middleware
        raise InputError(reason(error)) from error


def _tolerance(text: str) -> float | dict[str, float]:
    if '=' not in text:
        return within(0.0, 3.15)(text)
    pairs = [part.rpartition('=') for part in text.split(',')]
    with suppress(ValueError):
        tolerances = {name.strip(): float(value) for name, _, value in pairs}
        if all(name and 0.0 <= value < math.inf for name, value in tolerances.items()):
            return tolerances
    raise argparse.ArgumentTypeError(f'expected FIELD=VALUE,..., found {text!r}')


def _span(options: argparse.Namespace, wheels: tuple[str, ...]) -> Span:
    """Return the time for which the loop must run when the command records a new reference."""
    from rigid_body_ros.regress import read, Span
    if options.duration:
        return Span(round(options.duration * 1e9))
    if not Path(options.reference).exists():
        raise InputError(f'{options.reference}: expected a reference, over whose time the loop '
                         'runs, or --duration, found neither')
    return Span.of(read(options.reference, wheels))


def _add_arguments(parser: Parser) -> None:
    parser.add_argument('reference', metavar='REFERENCE',
                        help='recording of the loop, made by --update or with the topics '
                        'accepted_torque and committed of a node; with --open-loop, an MCAP '
                        'recording of the inputs and outputs of a node')
    parser.add_scene('. Not with --open-loop')
    parser.add_argument('--open-loop', action='store_true',
                        help='feed the recording to any node, one message at a time, and compare '
                        'what it publishes')
    parser.add_argument('--step', type=positive, default=0.0, metavar='SECONDS',
                        help='with --open-loop, move /clock by SECONDS while no message is due, '
                        'for a node with timers (default: only with the messages)')
    parser.add_argument('--tolerance', type=_tolerance, metavar='RAD|FIELD=VALUE,...',
                        help='accept attitudes that differ by this angle at the same stamps or, '
                        'with --open-loop, numbers that differ by VALUE in a field, such as '
                        '/odometry:pose (default: no bit may differ)')
    parser.add_argument('--update', action='store_true',
                        help='run the command twice and, if both runs are the same, write the '
                        'reference or, with --open-loop and --overwrite, the outputs in the '
                        'recording')
    parser.add_argument('--duration', type=positive, metavar='SECONDS',
                        help='with --update, length of the loop by its stamps (default: that of '
                        'the reference)')
    parser.add_argument('--timeout', type=positive, default=60.0, metavar='SECONDS',
                        help='longest wall time of one loop (default: 60)')
    parser.add_outputs('json')


attitude_regress = Command(
    'attitude_regress',
    'Run a controller and the node in lockstep, in a ROS domain that no other process uses, and '
    'compare the closed loop with a recorded one, bit for bit.',
    ('examples/slew.mcap --scene examples/slew.yaml -- attitude_controller',
     'mine.mcap --scene examples/slew.yaml --update --duration 2 '
     '-- attitude_controller'),
    _add_arguments, _run, rest='COMMAND [ARGUMENT ...]')
