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
Measure the speed and accuracy of the engine, and compare them with required values and peers.

    python benchmarks/engine.py [--json FILE] [SECTION ...]

Errors are angles, rad, between the final attitude and a reference with 30 digits. A ratio is the
time of the peer divided by that of this package. It comes from the median times, with a 95 %
confidence interval from the ratios of single rounds, in which the package and the peer alternate.
The lower end of the interval must reach the required ratio. All runs use one thread. First calls,
in which some peers compile, are timed separately.
"""

import argparse
import contextlib
from dataclasses import asdict, dataclass
import importlib
from importlib.metadata import PackageNotFoundError, version
import itertools
import json
from pathlib import Path
import platform
import subprocess
import sys
import time

import numpy as np
from pairs import compare, quick
from problems import error, PROBLEMS
from rigid_body_ros import propagate

HERE = Path(__file__).resolve().parent
PACKAGES = ('rigid_body_ros', 'numpy', 'scipy', 'numba', 'mpmath', 'heyoka', 'cyrk')


@dataclass(frozen=True)
class Bar:
    """Required values for a problem: the error, rad, and the speed relative to a peer."""

    problem: str
    peer: str
    ratio: float
    error: float | None = None
    tolerance: float = 1e-15


BARS = (
    Bar('P2', 'heyoka', 40.0, 5e-13),
    Bar('P3', 'heyoka', 1 / 1.2, 1e-14),
    Bar('P4', 'rk4', 1 / 2.0, 5e-15),
    Bar('P4', 'rk4', 1 / 1.25, tolerance=1e-9),
    Bar('P4', 'heyoka', 12.0, 5e-15),
    Bar('P4', 'cyrk', 12.0, 5e-15),
    Bar('P5', 'heyoka', 1.0, 1e-13),
    Bar('P6', 'heyoka', 1.0, 3e-13),
)
LOOSE_PROBLEMS = ('P1', 'P1f', 'P2', 'P3', 'P5', 'P6')
LOOSE_TOLERANCES = (1e-4, 1e-6, 1e-9)
SAMPLES = (10_000, 100_000, 1_000_000, 10_000_000)
MEMORY_BAR = 64.0  # MiB
START_BAR = 1.5  # s
STARTS = 8
SECTIONS = (*dict.fromkeys(bar.problem for bar in BARS), 'loose', 'growth', 'start')


class Ours:
    """The package itself, through its public interface."""

    def __init__(self, problem, **options):
        """Take the options of `propagate`."""
        self._scene, self._options = problem.scene, {'at': problem.at, **options}

    def reset(self):
        """Do nothing: each run begins at the start."""

    def run(self):
        """Propagate."""
        self._motion = propagate(*self._scene, **self._options)

    def attitude(self):
        """Return x y z w at the end."""
        return self._motion.attitude[-1]


def bars(name, peers):
    """Compare one problem with its required values; return a row for each peer."""
    problem, rows = PROBLEMS[name], []
    for bar in BARS:
        if bar.problem != name or bar.peer not in peers:
            continue
        module = peers[bar.peer]
        peer_class = module.Stream if len(problem.torques) > 1 else module.Final
        ours, first = first_run(Ours, problem, tolerance=bar.tolerance)
        peer, peer_first = first_run(peer_class, problem)
        row = duel(name, ours, bar.peer, peer)
        met = (row['ratio'][1] >= bar.ratio
               and (bar.error is None or row['ours']['error'] < bar.error))
        print(f'{name:3} tolerance {bar.tolerance:.0e}: {told(row)} bar '
              + (f'{bar.error:.0e} rad, ' if bar.error else '')
              + f'{bar.ratio:.3g}  {verdict(met)}  '
              f'first calls {first:.2f} s, {peer_first:.2f} s')
        rows.append({**row, 'bar': asdict(bar), 'met': met,
                     'first_calls': [first, peer_first]})
    return rows


def loose(peers):
    """Compare, at loose tolerances, with the cheapest peer that is as accurate."""
    rows = []
    for name in LOOSE_PROBLEMS:
        rungs = [rung for peer in ('heyoka', 'cyrk') if peer in peers
                 for rung in ladder(name, peer, peers[peer])]
        for solver, tolerance in itertools.product(('auto', 'taylor'), LOOSE_TOLERANCES):
            ours, _ = first_run(Ours, PROBLEMS[name], solver=solver, tolerance=tolerance)
            row = cheapest(name, ours, rungs)
            print(f'{name:3} {solver:6} {tolerance:.0e}: {told(row)}')
            rows.append({'problem': name, 'solver': solver, 'tolerance': tolerance, **row})
    return rows


def ladder(name, peer_name, module):
    """Return the error, time, name and contender for each setting of a peer."""
    rungs = []
    for options in module.LADDER:
        peer, _ = first_run(module.Final, PROBLEMS[name], **options)
        rungs.append((error(name, peer.attitude()), quick(peer), peer_name, peer))
    return rungs


def cheapest(name, ours, rungs):
    """Return the comparison with the fastest peer whose error is not larger."""
    own = error(name, ours.attitude())
    able = [rung for rung in rungs if rung[0] <= own]
    if not able:
        return {'ours': {'error': own, 'seconds': quick(ours)}}
    return duel(name, ours, *min(able, key=lambda rung: rung[1])[2:])


def growth(_):
    """Print time and memory by length of the log, for both kinds of output."""
    rows = []
    for output, samples in itertools.product(('end', 'each'), SAMPLES):
        row = json.loads(child('growth.py', str(samples), output))
        met = row['motion_mib'] <= MEMORY_BAR
        print(f"{samples:8} samples, state at {output:4}: {row['ns_per_sample']:6.0f} ns each, "
              f"beyond input and output {row['motion_mib']:6.1f} MiB bar {MEMORY_BAR:.0f}  "
              f"{verdict(met)}  (making the log: {row['log_mib']:.1f} MiB)")
        rows.append({**row, 'met': met})
    return rows


def start(_):
    """Print the time from import to the first result."""
    times = [float(child('start.py')) for _ in range(STARTS)]
    met = bool(np.median(times) <= START_BAR)
    print(f'import to first result: {np.median(times):5.2f} s bar {START_BAR}  {verdict(met)}')
    return {'seconds': times, 'met': met, 'bar': START_BAR}


def first_run(make, problem, **options):
    """Create and run a contender; return it and the time, s, which may include compilation."""
    began = time.perf_counter()
    contender = make(problem, **options)
    contender.reset()
    contender.run()
    return contender, time.perf_counter() - began


def duel(name, ours, peer_name, peer):
    """Return the errors and times of both contenders for one problem."""
    comparison = compare(ours, peer)
    sides = [{'error': error(name, contender.attitude()), 'seconds': float(np.median(times)),
              'samples': times.tolist()}
             for contender, times in ((ours, comparison.ours), (peer, comparison.peers))]
    return {'ours': sides[0], 'peer': {'name': f'{peer_name} {peer.label}', **sides[1]},
            'ratio': [float(end) for end in comparison.ratio]}


def told(row):
    """Return a comparison as a line of text."""
    def side(row):
        return f"{row['error']:.1e} rad {1e6 * row['seconds']:9.1f} us"

    if 'peer' not in row:
        return f"{side(row['ours'])} | no peer is as accurate"
    return (f"{side(row['ours'])} | {row['peer']['name']:33} {side(row['peer'])} | "
            'ratio {:.3g} [{:.3g}, {:.3g}]'.format(*row['ratio']))


def verdict(met):
    """Return 'pass' or 'MISS'."""
    return 'pass' if met else 'MISS'


def child(script, *arguments):
    """Run a script of this folder in a new process, and return what it prints."""
    return subprocess.run([sys.executable, HERE / script, *arguments], check=True, text=True,
                          stdout=subprocess.PIPE).stdout


def installed_peers():
    """Return the modules of the installed peers by name; print which are missing."""
    peers = {}
    for name in ('heyoka', 'cyrk', 'rk4'):
        try:
            peers[name] = importlib.import_module(f'{name}_peer')
        except ImportError as problem:
            print(f'skipped: {problem}')
    return peers


def machine():
    """Return the platform, the processors and the versions of packages."""
    versions = {}
    for package in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            versions[package] = version(package)
    processors = [line.split(':')[1].strip()
                  for line in Path('/proc/cpuinfo').read_text().splitlines()
                  if line.startswith('model name')]
    return {'platform': platform.platform(), 'processors': processors,
            'python': platform.python_version(), 'versions': versions}


def main():
    """Run the given sections, or all."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('sections', nargs='*', metavar='SECTION',
                        help=f'any of {", ".join(SECTIONS)} (default: all)')
    parser.add_argument('--json', type=Path, metavar='FILE',
                        help='write all results and times to FILE')
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.sections) - set(SECTIONS))
    if unknown:
        parser.error(f'SECTION: expected any of {", ".join(SECTIONS)}, '
                     f'found {", ".join(unknown)}')
    report = {'machine': machine()}
    for name, value in report['machine'].items():
        print(f'{name}: {value}')
    peers = installed_peers()
    others = {'loose': loose, 'growth': growth, 'start': start}
    for section in arguments.sections or SECTIONS:
        report[section] = (others[section](peers) if section in others
                           else bars(section, peers))
        if arguments.json:
            arguments.json.write_text(json.dumps(report, indent=1) + '\n')


if __name__ == '__main__':
    main()
