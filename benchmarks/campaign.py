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
How often the verdict of `identify` is right: recordings of 20 right and of 40 wrong models.

Run `python benchmarks/campaign.py [--seeds N] [--levels 0.1,1,10] [--kind NAME]`. Each line is one
recording of `simulated.py`, which shares no code with the package. The tables have the share of
verdicts, of intervals of the inertia that cover the truth (systematic part included), and of
recordings whose cause is among the first two suspects.
"""

import argparse
from collections import defaultdict
from multiprocessing import Pool
import os
import sys
import time

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np  # noqa: E402
from rigid_body_ros import (  # noqa: E402
    Experiment,
    identify,
    Measured,
    RigidBody,
    State,
    TorqueLog,  # noqa: E402
)
from simulated import INERTIA, named, recordings, RIGHT, WRONG  # noqa: E402

#: The truth by component name.
TRUE = {f'inertia.i{name}': float(INERTIA['xyz'.index(name[0]), 'xyz'.index(name[1])])
        for name in ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')}
#: Fewest of the six intervals that have to cover the truth.
ENOUGH = 5


def fit(kind, recording, **options):
    """Return the fit to a recording, with the options of `identify`."""
    measured = []
    if kind.has_attitude:
        measured.append(Measured('/mocap', recording.attitude_ns, recording.attitude, None))
    if kind.has_rates:
        measured.append(Measured('/imu', recording.rate_ns, None, recording.rates))
    experiment = Experiment(State(0, *recording.start),
                            TorqueLog(recording.torque_ns, recording.torques), measured)
    guess = RigidBody.from_moments(*(kind.guess or (0.03, 0.03, 0.03)))
    return identify(guess, experiment, **{'estimate': kind.estimate, **options})


def outcome(job):
    """Return what became of one recording: verdict, number of intervals that cover, and so on."""
    name, level, seed = job
    kind = named(name)
    recording, = recordings(kind, [seed], level)
    begin = time.perf_counter()
    result = fit(kind, recording)
    taken = time.perf_counter() - begin
    intervals = {one: result.estimates[one].interval_95 for one in TRUE}
    cover = sum(limits is not None and limits[0] <= TRUE[one] <= limits[1]
                for one, limits in intervals.items())
    suspects = [one.name for one in result.verdict.suspects]
    return name, level, result.verdict.level, cover, suspects, taken, result.verdict.reasons


def main():
    """Print a line for each recording, and the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--levels', type=lambda text: [float(one) for one in text.split(',')],
                        default=[0.1, 1.0, 10.0])
    parser.add_argument('--kind', help='only this kind; right or wrong for all of them')
    options = parser.parse_args()
    groups = {'right': RIGHT, 'wrong': WRONG, None: (*RIGHT, *WRONG)}
    kinds = groups[options.kind] if options.kind in groups else [named(options.kind)]
    jobs = [(kind.name, level, seed) for kind in kinds for level in options.levels
            for seed in range(options.seeds)]
    found = defaultdict(list)
    with Pool(os.cpu_count()) as pool:
        for job, one in zip(jobs, pool.imap(outcome, jobs)):
            name, level, verdict, cover, suspects, taken, reasons = one
            found[name, level].append(one)
            print(f'{name}, noise {level:g}, seed {job[2]}: {verdict}, {cover} of 6 cover, '
                  f'{", ".join(suspects) or "no suspects"}, {taken:.1f} s', flush=True)
            if named(name) in RIGHT and reasons:
                print('   ', '; '.join(reasons), flush=True)
    for level in options.levels:
        table(kinds, level, found)


def table(kinds, level, found):
    """Print what became of all kinds at one level of noise, and the shares."""
    print(f'\nnoise {level:g} times the nominal one\n')
    print('| kind | explained | approximate | rejected | intervals that cover | good | cause |')
    print('|---|---|---|---|---|---|---|')
    shares = defaultdict(list)
    for kind in kinds:
        results = found[kind.name, level]
        counts = [sum(one[2] == verdict for one in results)
                  for verdict in ('explained', 'approximate', 'rejected')]
        good = [is_good(one) for one in results]
        hits = [bool({*one[4][:2]} & {*kind.causes}) for one in results]
        is_right = kind in RIGHT
        shares['right' if is_right else 'wrong'] += [one[2] == 'explained' for one in results] \
            if is_right else good
        if is_right:
            shares['covered'] += [one[3] / 6.0 for one in results]
        elif kind.causes:
            shares['named'] += hits
        cause = f'{sum(hits)} of {len(hits)}' if kind.causes else ''
        print(f'| {kind.name} | {" | ".join(map(str, counts))} | '
              f'{sum(one[3] for one in results)} of {6 * len(results)} | '
              f'{sum(good)} of {len(good)} | {cause} |')
    texts = {'right': 'right models called explained', 'covered': 'their intervals that cover',
             'wrong': 'wrong models rejected, or at least five of six intervals cover',
             'named': 'causes among the first two suspects'}
    print()
    for name, values in shares.items():
        print(f'{texts[name]}: {100.0 * np.mean(values):.1f} % of {len(values)}')


def is_good(one):
    """Return whether a wrong model is rejected, or its intervals cover the truth."""
    return one[2] == 'rejected' or one[3] >= ENOUGH


if __name__ == '__main__':
    sys.exit(main())
