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

"""
Measure the error and the cost of this package and of its alternatives.

    python benchmarks/peers.py [--plot PNG] [--page docs/tradeoff.md] [PROBLEM ...]

Each contender runs each problem with a ladder of settings, from coarse to fine, until a run takes
half a second. For each error level, the settings below this error that may be the fastest are
timed in turns. This measurement gives all times and ratios of a problem. Errors are angles, rad,
between the final attitude and a reference with 30 digits. All runs use one thread, and compilation
is not timed. The tables show two levels, and --plot all of them. With --page, the tables are
written into that file, between the lines that say so.
"""

import argparse
import importlib
from importlib.metadata import version
import math
from pathlib import Path
import platform
import time
from typing import Any, NamedTuple

from contenders import Equations
from matplotlib.figure import Figure
import numpy as np
from pairs import in_turns, quick, ratio
from problems import error, PROBLEMS
from rigid_body_ros import propagate
from tables import header, row, write_into
from tqdm import tqdm

#: Names of the peers by module.
PEERS = {'heyoka': 'heyoka', 'cyrk': 'CyRK', 'rk4': 'RK4, numba', 'scipy': 'scipy',
         'numpy': 'RK4, numpy', 'mujoco': 'MuJoCo', 'drake': 'Drake', 'basilisk': 'Basilisk'}
US = 'rigid_body_ros'
LEVELS = tuple(float(f'1e-{k}') for k in range(3, 14))
#: The levels that have a table.
SHOWN = LEVELS[0], LEVELS[-2]
#: s; a ladder ends at the first rung that takes longer.
LONGEST = 0.5
#: s; a run that takes longer need not be repeated for a first estimate.
LONG = 0.1
PATIENCE = 3.0
#: A setting may be the fastest if its first estimate is at most this many times the smallest.
NEAR = 1.5
TITLES = {
    'P1': 'no torque, intermediate axis, 100 s',
    'P1f': 'P1 with ten times the rates',
    'P2': 'no torque, 1000 s',
    'P3': 'constant body torque, 100 s',
    'P4': 'torque held for 1 ms each, 60 s',
    'P5': 'no torque, moments 1e-9 apart, 1000 s',
    'P6': 'no torque, rod 1e-6 : 1 : 1, 10 s',
}
COLOURS = ('#000000', '#0072b2', '#d55e00', '#009e73', '#cc79a7', '#56b4e9', '#e69f00',
           '#999999', '#7b3294')
MARKERS = 'osD^vPX<>'


class Rung(NamedTuple):
    """A contender with one setting, the error, rad, and the time, s, of a run."""

    contender: Any
    setting: str
    error: float
    #: An estimate, or the median of `times` once there are any.
    seconds: float
    #: s, by round; NaN in rounds that the contender skipped.
    times: Any = ()


def our_ladder(problem):
    """Return the settings of this package, from coarse to fine."""
    span = problem.hold_ns * 1e-9
    # At most one step per sample or, without samples, about a radian, as the coarsest peers have.
    longest = span if len(problem.torques) > 1 else span / 2 ** np.ceil(
        np.log2(span * np.linalg.norm(problem.rates)))
    return [{'solver': 'auto', 'tolerance': 10.0 ** -k} for k in range(1, 16)] + [
        {'solver': 'rk4', 'max_step': float(longest) / 2 ** k} for k in range(8)]


class Ours(Equations):
    """The package itself, labelled with its setting; it returns only the state at the end."""

    def __init__(self, problem, **options):
        """Take the options of `propagate`."""
        self._scene, self._options = problem.scene, {'at': problem.at[-1:], **options}
        self.label = ' '.join(f'{value:.0e}' if name == 'tolerance' else
                              f'{value:.3g} s' if name == 'max_step' else value
                              for name, value in options.items())

    def run(self):
        """Propagate."""
        self._motion = propagate(*self._scene, **self._options)

    def attitude(self):
        """Return x y z w at the end."""
        return self._motion.attitude[-1]


def ladders(problem, peers):
    """Yield the name, the class and the settings of each contender."""
    ours = our_ladder(problem)
    for solver in ('auto', 'rk4'):
        yield US, Ours, [options for options in ours if options['solver'] == solver]
    stream = len(problem.torques) > 1
    for name, module in peers.items():
        yield (name, *((module.Stream, module.STREAM_LADDER) if stream else
                       (module.Final, module.LADDER)))


def climb(name, make, ladder):
    """Return the rungs of a ladder that are fast enough, and why the others failed."""
    rungs, failed = [], []
    for options in ladder:
        try:
            contender = make(PROBLEMS[name], **options)
            contender.reset()
            contender.run()
        except (RuntimeError, ValueError) as problem:
            failed.append(f'{options}: {str(problem).splitlines()[0]}')
            continue
        attitude = np.asarray(contender.attitude())
        if not np.all(np.isfinite(attitude)):
            failed.append(f'{contender.label}: the attitude is not finite')
            continue
        # Some peers cannot distinguish q from -q.
        off = min(error(name, sign * attitude) for sign in (1.0, -1.0))
        seconds = cost(contender)
        rungs.append(Rung(contender, contender.label, off, seconds))
        if seconds > LONGEST:
            break
    return rungs, failed


def cost(contender):
    """Estimate the time of a run, s."""
    contender.reset()
    began = time.process_time()
    contender.run()
    seconds = time.process_time() - began
    return seconds if seconds > LONG else quick(contender)


def measure(name, peers):
    """Return the rungs of all contenders for a problem, and why others failed."""
    rungs, failed = {}, []
    for who, make, ladder in tqdm([*ladders(PROBLEMS[name], peers)], desc=name, leave=False):
        found, why = climb(name, make, ladder)
        rungs.setdefault(who, []).extend(found)
        failed += [f'{who}, {reason}' for reason in why]
    return rungs, failed


def cheapest(rungs, level):
    """Return the fastest rung with an error up to a level, or None."""
    return min((rung for rung in rungs if rung.error <= level),
               key=lambda rung: rung.seconds, default=None)


def candidates(rungs, level):
    """Return the rungs with an error up to a level that may be the fastest."""
    able = [rung for rung in rungs if rung.error <= level]
    least = min((rung.seconds for rung in able), default=math.inf)
    return [rung for rung in able if rung.seconds <= NEAR * least]


def timed(rungs):
    """Time the candidates of all levels in turns, and return them by contender."""
    chosen = {who: [*{id(rung): rung for level in LEVELS for rung in candidates(some, level)
                      }.values()] for who, some in rungs.items()}
    every = [rung for some in chosen.values() for rung in some]
    times = iter(in_turns([rung.contender for rung in every], [rung.seconds for rung in every],
                          PATIENCE).T)
    return {who: [rung._replace(times=column, seconds=float(np.nanmedian(column)))
                  for rung, column in zip(some, times)] for who, some in chosen.items()}


def verdict(rungs, level):
    """Return the table cell of a level: the best peer's time divided by ours."""
    ours = cheapest(rungs[US], level)
    peer = cheapest([rung for who, some in rungs.items() if who != US for rung in some], level)
    if not (ours and peer):
        return 'alone' if ours else '-'
    value, low, high = ratio(ours.times, peer.times)
    word = '' if low > 1.0 else ' (level)' if high >= 1.0 else ' (behind)'
    return f'{value:.3g}{word}'


def table(level, results):
    """Return the table of a level: times, us, by contender and problem, and the ratios."""
    lines = [f'### Time of a run with an error below {level:.0e} rad', '', *header('us', *results)]
    for who in dict.fromkeys(who for rungs, *_ in results.values() for who in rungs):
        best = [cheapest(rungs.get(who, ()), level) for rungs, *_ in results.values()]
        lines.append(row(who, *(f'{1e6 * rung.seconds:.3g}' if rung else '-' for rung in best)))
    lines.append(row('best peer / ours', *(verdict(rungs, level)
                                           for rungs, *_ in results.values())))
    return [*lines, '']


def draw(path, results):
    """Plot error and time of every contender, in one panel for each problem."""
    figure = Figure(figsize=(11.0, 6.4), layout='constrained')
    panels = figure.subplots(2, 4).ravel()
    names = dict.fromkeys(who for rungs, *_ in results.values() for who in rungs)
    for panel, (name, (rungs, *_)) in zip(panels, results.items()):
        panel.set_title(f'{name}: {TITLES[name]}', fontsize=8, loc='left')
        for number, who in enumerate(names):
            front = [(level, rung.seconds * 1e6) for level in LEVELS
                     if (rung := cheapest(rungs.get(who, ()), level))]
            if front:
                panel.loglog(*zip(*front), marker=MARKERS[number], color=COLOURS[number],
                             linewidth=2.2 if who == US else 1.0, markersize=4, label=who,
                             zorder=3 if who == US else 2)
        panel.set_xlim(0.5 * LEVELS[-1], 2.0 * LEVELS[0])
        panel.grid(alpha=0.25)
        panel.tick_params(labelsize=8)
    for panel in panels[len(results):]:
        panel.set_axis_off()
    handles = {label: handle for panel in panels
               for handle, label in zip(*panel.get_legend_handles_labels())}
    figure.legend(handles.values(), handles, loc='lower right', fontsize=9, frameon=False)
    figure.supxlabel('final attitude error at most (rad)', fontsize=9)
    figure.supylabel('time of a run (us)', fontsize=9)
    figure.savefig(path, dpi=150)


def installed():
    """Return the modules of the installed peers by name; print which are missing."""
    modules, missing = {}, []
    for name, label in PEERS.items():
        try:
            modules[label] = importlib.import_module(f'{name}_peer')
        except ImportError as problem:
            missing.append(f'Left out: {label}: {problem}')
    return modules, missing


def described(modules, missing):
    """Return lines that describe the machine and the versions."""
    processors = [line.split(':')[1].strip()
                  for line in Path('/proc/cpuinfo').read_text().splitlines()
                  if line.startswith('model name')]
    versions = [f'{US} {version(US)}', *(module.NAME for module in modules.values())]
    return [f'{len(processors)} x {processors[0]}, Python {platform.python_version()}; '
            f'{", ".join(versions)}.', *missing, '']


def main():
    """Measure the given problems, or all, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('problems', nargs='*', metavar='PROBLEM', default=[*PROBLEMS],
                        help=f'any of {", ".join(PROBLEMS)}; all if none is named')
    parser.add_argument('--plot', type=Path, help='draw the fronts')
    parser.add_argument('--page', type=Path, help='write the tables into a page')
    arguments = parser.parse_args()
    if unknown := set(arguments.problems) - set(PROBLEMS):
        parser.error(f'no problem {", ".join(sorted(unknown))}; there are {", ".join(PROBLEMS)}')
    modules, missing = installed()
    results = {}
    for name in arguments.problems:
        rungs, failed = measure(name, modules)
        results[name] = timed(rungs), failed
    text = '\n'.join([*described(modules, missing), *(
        line for level in SHOWN for line in table(level, results))])
    print(text)
    for name, (_, failed) in results.items():
        for reason in failed:
            print(f'* {name}, failed: {reason}')
    if arguments.plot:
        draw(arguments.plot, results)
    if arguments.page:
        write_into(arguments.page, __file__, text)


if __name__ == '__main__':
    main()
