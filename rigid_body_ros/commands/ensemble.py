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

"""The command `attitude_ensemble`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
import os
from pathlib import Path
from typing import TYPE_CHECKING

from rigid_body_ros.commands.arguments import load_scene, note, read_torques
from rigid_body_ros.commands.command import Command, Parser, positive, within
from rigid_body_ros.commands.outputs import checked
from rigid_body_ros.common.errors import InputError, listed, located
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.runtime import files
from rigid_body_ros.runtime.terminal import progress

if TYPE_CHECKING:
    from rigid_body_ros.ensemble.driver import Pool
    from rigid_body_ros.ensemble.requirements import Requirement
    from rigid_body_ros.ensemble.runs import Ensemble
    from rigid_body_ros.propagation import Problem
    from rigid_body_ros.report.report import Report
    from rigid_body_ros.scene import Scene

#: If --times has this value, the command keeps only the final state.
FINAL = 'final'


def _run(options: argparse.Namespace) -> int:
    from rigid_body_ros.ensemble import driver, report, summary, worst
    from rigid_body_ros.ensemble.folder import opened
    from rigid_body_ros.ensemble.requirements import Requirement
    with located('--require', InputError):
        requirements = [Requirement.read(text) for text in options.require]
    with checked(options) as outputs:
        scene = load_scene(options)
        ensemble = _ensemble(options, scene, requirements)
        identity = driver.identity_of(ensemble, scene, options.times)
        with opened(options.output, identity, ensemble.columns, options.runs, ensemble.times,
                    note=partial(note, options)) as folder:
            driver.compute(ensemble, folder, _pool(options, ensemble), progress(
                'runs', ' runs', lambda rows: len(rows['run'])))
            results = summary.summarized(ensemble, folder, requirements)
            worst.write(folder.path / worst.FOLDER, ensemble, scene, {
                run['run'] for judged in results.get('requirements', ())
                for run in judged['worst']})
            replay = partial(worst.command, ensemble)
            shown = report.report_of(results, Path(options.recording or options.scene).name,
                                     partial(replay, folder.path.name))
            if shown.panels:  # not all runs failed
                _draw(options, folder.picture, shown)
            folder.finish({**identity, **results})
            outputs.write_asked(scene, lambda: shown)
    outputs.show(report.text_of(results, partial(replay, options.output)), 17,
                 [options.output, *outputs.names])
    if results['failed'] == results['runs']:
        raise InputError(f'{options.output}: expected runs that can be computed, found that all '
                         f'{results["runs"]} failed')
    return 0


def _draw(options: argparse.Namespace, path: Path, report: Report) -> None:
    try:
        from rigid_body_ros.report.picture import draw  # matplotlib is slow to import
    except ModuleNotFoundError as error:
        package = str(error.name).split('.')[0]
        note(options, f'{path}: not drawn: Python module {package!r} is not installed')
        return
    with files.atomic_output(path, '.png') as temporary:
        draw(temporary, report)


def _pool(options: argparse.Namespace, ensemble: Ensemble) -> Pool:
    from rigid_body_ros.runtime.cluster import connected
    from rigid_body_ros.runtime.pool import Processes, Workers
    if options.scheduler:
        return connected(options.scheduler, partial(note, options))
    # Other runs release the global interpreter lock.
    return (Processes if ensemble.in_python else Workers)(options.workers or os.cpu_count() or 1)


def _ensemble(options: argparse.Namespace, scene: Scene,
              requirements: Sequence[Requirement]) -> Ensemble:
    from rigid_body_ros.ensemble.controller import Controller, ControllerError
    from rigid_body_ros.ensemble.dispersions import load_varied
    from rigid_body_ros.ensemble.motions import times_of
    from rigid_body_ros.ensemble.runs import Ensemble
    varied, estimates = load_varied(options.vary, scene.values['fields'], options.force)
    if estimates and estimates.ignored:
        note(options, f'{options.vary}: {listed(estimates.ignored)}: no effect on the motion')
    problem, end_ns = _problem(options, scene)
    seconds = (end_ns - problem.start.time_ns) / 1e9
    lasting = tuple(one for one in requirements if one.after is not None)
    for one in lasting:
        if (one.after or 0.0) >= seconds:
            raise InputError(f'--require: {one} {one.unit}: expected a time before the end of the '
                             f'runs ({seconds:g} s), found after {one.after:g} s')
    times_ns = None if options.times == FINAL else \
        times_of(problem.start.time_ns, end_ns, options.times)
    controller = None
    with located(options.vary, InputError):
        if options.controller:
            for log in problem.logs:
                if log.interpolation != 'hold':
                    raise InputError(f"{options.scene}: interpolation: expected 'hold', as in "
                                     'lockstep, with a controller, found '
                                     f'{log.interpolation!r}')
            actuator = next(filter(None, scene.actuators or ()), None)  # the same for all topics
            controller = Controller.load(options.controller,
                                         max(1, duration_ns(scene.step, 'step')), actuator)
        ensemble = Ensemble(problem, end_ns, varied, options.seed, estimates, times_ns, controller,
                            lasting)
    try:
        ensemble.check()
    except ControllerError as error:
        raise InputError(f'nominal run: {error}') from error
    except ValueError as error:
        raise InputError(f'{options.vary if estimates else options.scene}: {error}') from error
    return ensemble


def _problem(options: argparse.Namespace, scene: Scene) -> tuple[Problem, int]:
    """Return the problem for the nominal motion, and the time at which that motion ends, ns."""
    problem, end_ns = scene.problem(), None
    if options.recording is not None:
        logged = read_torques(options, scene)
        problem, end_ns = logged.problem, int(logged.times_ns[-1])
    start_ns = problem.start.time_ns
    if options.until:
        end_ns = start_ns + round(options.until * 1e9)
    if end_ns is None:
        raise InputError('--until: expected the end of the motion, or a --recording, found '
                         'neither')
    return problem, max(end_ns, start_ns)


def _add_arguments(parser: Parser) -> None:
    parser.add_scene()
    parser.add_argument('--vary', required=True, metavar='FILE', help='YAML file with the '
                        'distributions, or JSON file of attitude_identify, whose estimates vary '
                        'jointly')
    parser.add_argument('--force', action='store_true', help='use the JSON file even if its fit '
                        'is rejected')
    parser.add_argument('--runs', required=True, metavar='N', help='number of runs',
                        type=within(1, 10 ** 9, 'an integer', int))
    parser.add_argument('--recording', metavar='IN',
                        help='torque recording, as for attitude_replay (default: no torque)')
    parser.add_torques()
    parser.add_argument('--controller', metavar='MODULE:FUNCTION', help='Python function, or '
                        'class with an instance for each run, that is called at every step of the '
                        'scene with the state and the time since the start (s), and returns a '
                        'torque (N m, body axes)')
    parser.add_argument('--require', action='append', default=[], metavar='EXPRESSION',
                        help="limit on the final state, such as 'rate < 0.05', or from a time on, "
                        "such as 'angle < 1 deg after 60 s': rate (rad/s), angle (rad, between "
                        'body and space axes) or angle_from_nominal (rad); report how many runs '
                        'meet it, which parameters matter, and the worst runs; may be repeated')
    parser.add_argument('--until', type=positive, metavar='SECONDS',
                        help='end SECONDS after the start (default: at the last torque stamp); '
                        'required without a recording')
    parser.add_argument('--times', type=_times, default=FINAL, metavar=f'HZ|{FINAL}',
                        help='states of each run to store: HZ per second and the final one, in '
                        'motion.zarr, or only the final one (default: final)')
    parser.add_argument('--seed', type=within(0, 2 ** 63 - 1, 'an integer', int), default=0,
                        metavar='S', help='seed of the random numbers (default: 0)')
    pool = parser.add_mutually_exclusive_group()
    pool.add_argument('--workers', type=within(1, 1024, 'an integer', int), metavar='K',
                      help="number of threads or, with --controller or 'after', processes, which "
                      'does not change the results (default: one per processor)')
    pool.add_argument('--scheduler', metavar='ADDRESS|FILE', help='compute on the workers of '
                      'this Dask scheduler, HOST:PORT or the file that it wrote, with the same '
                      'results')
    parser.add_argument('-o', '--output', required=True, metavar='FOLDER',
                        help='folder for the results: new, or with results of the same ensemble')
    parser.add_outputs()


def _times(text: str) -> float | str:
    try:
        return FINAL if text == FINAL else positive(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(str(error).replace(
            'expected', f'expected {FINAL} or', 1)) from error


attitude_ensemble = Command(
    'attitude_ensemble',
    'Compute many runs with dispersed parameters, and write the values and the final state of '
    'each. Print how far the runs end from the nominal run, and which parameters matter. Start it '
    'again to continue, or with a larger --runs to add runs.',
    ('--scene config/tumbler.yaml --vary examples/vary.yaml '
     '--recording test/recordings/tumbler.mcap --runs 1000 -o runs',
     '--scene config/tumbler.yaml --vary examples/vary.yaml --until 20 '
     '--recording test/recordings/flight.mcap --runs 100 --times 10 -o runs'),
    _add_arguments, _run)
