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

"""The command `attitude_tradeoff`."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rigid_body_ros.commands.arguments import length_of, load_scene, read_torques, topics_of
from rigid_body_ros.commands.command import Command, Parser, within
from rigid_body_ros.commands.outputs import checked
from rigid_body_ros.common.errors import InputError, listed, located
from rigid_body_ros.runtime.terminal import progress, show

if TYPE_CHECKING:
    from rigid_body_ros.propagation import Problem
    from rigid_body_ros.scene import Scene


def _run(options: argparse.Namespace) -> int:
    from rigid_body_ros.tradeoff import measure, TARGET
    from rigid_body_ros.tradeoff.result import report_of
    with checked(options) as outputs:
        scene = load_scene(options)
        problem, name = _problem(options, scene)
        source, length = options.recording or options.scene, length_of(options)
        end_ns = None if length is None else problem.start.time_ns + round(1e9 * length)
        with located(f'{source}: {name}' if options.recording else source):
            # The problem that is measured has rotors in place of the named wheels, and its body
            # does not include the axial inertia of the wheels.
            result = measure(problem.carried(), targets=options.target or [TARGET],
                             track=progress('measuring', ' runs'), end_ns=end_ns)
        # The title names the recording and its topic, or the scene.
        outputs.write_asked(scene, lambda: report_of(result, f'{Path(source).name}: {name}'),
                            result.as_dict)
    show(result.text(all_rows=options.all))
    return 0


def _problem(options: argparse.Namespace, scene: Scene) -> tuple[Problem, str]:
    """Return the problem to solve, and a text that names its torque topics."""
    # All solvers are measured. Replace the one that the scene sets, because some solvers do not
    # support torques.
    scene = replace(scene, values={**scene.values, 'solver': 'auto'})
    topics_of(options).check(scene)
    if options.recording is None:
        if options.start:
            raise InputError('--from: expected a --recording, found none')
        return scene.problem(), 'fields, no logged torque' if scene.fields else 'no torque'
    logged = read_torques(options, scene, options.start)
    return logged.problem, listed(logged.topics)


def _add_arguments(parser: Parser) -> None:
    parser.add_scene()
    parser.add_argument('--recording', metavar='IN', help='torque recording, as for '
                        'attitude_replay (default: 50 turns without torque)')
    parser.add_torques()
    parser.add_span()
    parser.add_argument('--target', type=within(1e-15, 1.0), action='append', metavar='RAD',
                        help='largest attitude error of the solver at any time, without the '
                        'interpolation error of the torques; may be repeated (default: 1e-06)')
    parser.add_argument('--all', action='store_true', help='print all settings, not only the '
                        'Pareto-optimal ones')
    parser.add_outputs('json', 'plot')


attitude_tradeoff = Command(
    'attitude_tradeoff',
    'Measure the cost and the error of every solver on your own motion, and '
    'recommend a setting.',
    ('--scene config/tumbler.yaml --recording test/recordings/tumbler.mcap '
     '--target 1e-6',
     '--scene config/tumbler.yaml --plot tradeoff.png'),
    _add_arguments, _run)
