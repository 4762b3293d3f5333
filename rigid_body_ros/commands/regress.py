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
from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
import shutil
import sys
from tempfile import TemporaryDirectory
from typing import Any, TYPE_CHECKING

from rigid_body_ros.commands.arguments import (
    add_outputs,
    add_scene,
    load_scene,
    parsed,
    Parser,
    positive,
    within,
)
from rigid_body_ros.commands.nodes import imported
from rigid_body_ros.commands.outputs import checked
from rigid_body_ros.common.errors import InputError, reason
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.terminal import report

if TYPE_CHECKING:
    from rigid_body_ros.regress import Regression
    from rigid_body_ros.regress.session import Span
    from rigid_body_ros.scene import Scene

#: Exit status if the loop is not that of the reference.
DIFFERENT = 1
_SUFFIX = '.mcap'


def attitude_regress(arguments: Sequence[str] | None) -> int:
    """Run a controller again, and compare its closed loop with a recorded one."""
    given = [*(sys.argv[1:] if arguments is None else arguments)]
    end = given.index('--') if '--' in given else len(given)
    options = parsed(regress_parser(), given[:end])
    options.arguments, command = given, given[end + 1:]
    _check(options, command)
    with TemporaryDirectory(prefix='attitude_regress.') as folder:
        with files.reading(options.reference), checked(options) as outputs:
            scene = load_scene(options)
            result = _run(options, scene, command, Path(folder))
            if options.json:
                outputs.write_json(result.as_dict())
            if options.report:
                from rigid_body_ros.regress.page import page
                name = Path(options.reference).name
                outputs.write_page(lambda line: page(result, name, scene, line))
        written = options.update and result.is_same
        if written:
            with files.protected('scene', options.scene), \
                    files.atomic_output(options.reference, _SUFFIX) as path:
                shutil.copyfile(result.path, path)
    outputs.show(result.text(), 14, [*([options.reference] if written else []), *outputs.names])
    if result.is_same:
        return 0
    report(f'{options.command}: {result.verdict}')
    return DIFFERENT


def _check(options: argparse.Namespace, command: Sequence[str]) -> None:
    """Raise InputError if the options contradict each other, or would replace another file."""
    if not command:
        raise InputError("expected the command of a controller after '--', found none")
    if options.duration and not options.update:
        raise InputError('--duration: expected --update, found none')
    if options.update:
        with files.protected('scene', options.scene):
            files.check((options.reference, _SUFFIX))
        if Path(options.reference).exists():
            from rigid_body_ros.regress.loop import committed
            committed(options.reference)  # nothing but a reference is replaced


def _run(options: argparse.Namespace, scene: Scene, command: list[str],
         folder: Path) -> Regression:
    from rigid_body_ros.regress import compare, Session, update
    from rigid_body_ros.regress.domain import private_domain
    wheels = tuple(wheel.name for wheel in scene.named_wheels)
    session = Session(command, partial(_node, options.command, scene), options.timeout, wheels)
    with private_domain():
        if options.update:
            return update(session, _span(options, wheels), folder, options.tolerance)
        return compare(session, options.reference, folder, options.tolerance)


def _node(command: str, scene: Scene, logs: Collection[str]) -> Any:
    """Return the node, in the process that runs it."""
    try:
        return imported(command, 'rigid_body_ros.node.recorded').RecordedNode(scene, logs)
    except RuntimeError as error:  # of the middleware
        raise InputError(reason(error)) from error


def _span(options: argparse.Namespace, wheels: tuple[str, ...]) -> Span:
    """Return how long the loop of a new reference runs."""
    from rigid_body_ros.regress import read, Span
    if options.duration:
        return Span(round(options.duration * 1e9))
    if not Path(options.reference).exists():
        raise InputError(f'{options.reference}: expected a reference, over whose time the loop '
                         'runs, or --duration, found neither')
    return Span.of(read(options.reference, wheels))


def regress_parser() -> argparse.ArgumentParser:
    """Return the argument parser of `attitude_regress`; the command is not among its arguments."""
    parser = Parser(
        prog='attitude_regress',
        description='Run a controller and the node in lockstep, in a ROS domain of their own, and '
        'compare the closed loop with a recorded one, bit for bit.',
        examples=('examples/slew.mcap --scene examples/slew.yaml -- attitude_controller',
                  'mine.mcap --scene examples/slew.yaml --update --duration 2 '
                  '-- attitude_controller'))
    parser.add_argument('reference', metavar='REFERENCE',
                        help='recording of the loop, as --update writes it, or any recording '
                        'with accepted_torque and committed of a node')
    add_scene(parser)
    parser.add_argument('--tolerance', type=within(0.0, 3.15), metavar='RAD',
                        help='accept attitudes that differ by this angle at the most, at the same '
                        'stamps (default: no bit may differ)')
    parser.add_argument('--update', action='store_true',
                        help='run the controller twice and, if the loops are the same, write the '
                        'reference, or replace it')
    parser.add_argument('--duration', type=positive, metavar='SECONDS',
                        help='with --update: how long the loop runs, in its own time (default: as '
                        'long as the reference)')
    parser.add_argument('--timeout', type=positive, default=60.0, metavar='SECONDS',
                        help='longest wall time of a loop (default: 60)')
    parser.add_argument('--json', metavar='OUT', help='write the result to this file')
    add_outputs(parser, 'both loops, their difference, and the moving body')
    usage = parser.format_usage().removeprefix('usage: ').rstrip()
    parser.usage = f'{usage} -- COMMAND [ARGUMENT ...]'
    return parser
