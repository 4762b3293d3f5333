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
Measure how often you can trust the verdict of `identify`.

There are 20 kinds of correct models, 40 of incorrect models, and 10 that are a little wrong.
Run `python benchmarks/campaign.py [--seeds N] [--levels 0.1,1,10]`. It prints one line for each
recording of `simulated.py`, which shares no code with the package, then the table of
`docs/validation.md`, and the recordings with a wrong verdict.
"""

import argparse
from multiprocessing import Pool
import os
from typing import NamedTuple

os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np  # noqa: E402
import rigid_body_ros as ros  # noqa: E402
from rigid_body_ros.common.arrays import ENTRIES  # noqa: E402
from simulated import INERTIA, LITTLE, named, recordings, RIGHT, WRONG  # noqa: E402
from tables import header, row  # noqa: E402

#: The true inertia by component name.
TRUE = {f'inertia.i{name}': float(INERTIA[place]) for name, place in ENTRIES.items()}
#: Minimum number of the six intervals that must cover the true value.
ENOUGH = 5


def experiment(kind, recording):
    """Return what was logged of a recording."""
    measured = []
    if kind.has_attitude:
        measured.append(ros.Measured('/mocap', recording.attitude_ns, recording.attitude, None))
    if kind.has_rates:
        measured.append(ros.Measured('/imu', recording.rate_ns, None, recording.rates))
    return ros.Experiment(ros.State(0, *recording.start),
                          ros.TorqueLog(recording.torque_ns, recording.torques), measured)


def fit(kind, recording, **options):
    """Fit a recording with `identify` and these options, and return the result."""
    guess = ros.RigidBody.from_moments(*(kind.guess or (0.03, 0.03, 0.03)))
    return ros.identify(guess, experiment(kind, recording),
                        **{'estimate': kind.estimate, **options})


class Outcome(NamedTuple):
    """The outcome for one recording; `cover` counts the intervals that cover the true value."""

    name: str
    level: float
    verdict: str
    cover: int
    suspects: list
    #: The half-widths of the intervals divided by the true errors.
    widths: list

    @property
    def is_good(self):
        """Return whether the model is rejected, or enough intervals cover the true value."""
        return self.verdict == 'rejected' or self.cover >= ENOUGH

    @property
    def is_named(self):
        """Return whether the true cause is among the first two suspects."""
        return bool({*self.suspects[:2]} & {*named(self.name).causes})


def outcome(job):
    """Fit one recording, and return the outcome."""
    name, level, seed = job
    kind = named(name)
    recording, = recordings(kind, [seed], level)
    result = fit(kind, recording)
    intervals = {one: result.estimates[one].interval_95 for one in TRUE}
    cover = sum(limits is not None and limits[0] <= TRUE[one] <= limits[1]
                for one, limits in intervals.items())
    return Outcome(name, level, result.verdict.level, cover,
                   [one.name for one in result.verdict.suspects],
                   [0.5 * (limits[1] - limits[0]) / max(abs(result.estimates[one].value
                                                            - TRUE[one]), 1e-12)
                    for one, limits in intervals.items() if limits])


def main():
    """Print a line for each recording, and the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--levels', type=lambda text: [float(one) for one in text.split(',')],
                        default=[0.1, 1.0, 10.0])
    options = parser.parse_args()
    jobs = [(kind.name, level, seed) for kind in (*RIGHT, *WRONG, *LITTLE)
            for level in options.levels for seed in range(options.seeds)]
    found = []
    with Pool(os.cpu_count()) as pool:
        for one in pool.imap(outcome, jobs):
            found.append(one)
            print(f'{one.name}, noise {one.level:g}: {one.verdict}, {one.cover} of 6 cover, '
                  f'{", ".join(one.suspects) or "no suspects"}', flush=True)
    shares(options.levels, found)
    misses(found)


def is_of(group, one):
    """Return whether a recording is of one of the kinds of a group."""
    return any(kind.name == one.name for kind in group)


def shares(levels, found):
    """Print how often the verdict is right, and how useful intervals are, at each noise level."""
    columns = [_shares([one for one in found if one.level == level]) for level in levels]
    print('', *header('share', *(f'noise {level:g}' for level in levels)), sep='\n')
    for name in columns[0]:
        print(row(name, *(column[name] for column in columns)))


def _shares(found):
    """Return the shares of the table by name, for the recordings of one noise level."""
    right, wrong, little = ([one for one in found if is_of(group, one)]
                            for group in (RIGHT, WRONG, LITTLE))
    widths = [width for one in little for width in one.widths]
    return {
        'correct models called *explained*': share([one.verdict == 'explained' for one in right]),
        'intervals of correct models that cover the true value': _covering(right),
        'incorrect models that are harmless: rejected, or at least five of the six intervals of '
        'the inertia cover': share([one.is_good for one in wrong]),
        'incorrect models with the true cause among the first two suspects, where one can be '
        'named': share([one.is_named for one in wrong if named(one.name).causes]),
        'intervals of models a little wrong that cover': _covering(little),
        'their median half-width / true error (2.9 if errors are normal and sigmas exact)':
            f'{np.median(widths) if widths else np.nan:.2g}',
        'models a little wrong that are rejected': share([one.verdict == 'rejected'
                                                          for one in little]),
    }


def _covering(found):
    """Return the share of the intervals of the inertia that cover the true value."""
    return share([place < one.cover for one in found for place in range(6)])


def share(values):
    """Return the fraction of values that are true, as text."""
    return f'{100.0 * sum(values) / len(values):.1f} % ({sum(values)} of {len(values)})' \
        if values else 'none'


def misses(found):
    """Print the recordings with a wrong verdict."""
    wrong = [one for one in found if is_of(WRONG, one)]
    for text, missed in (
            ('right models not called explained',
             [one for one in found if is_of(RIGHT, one) and one.verdict != 'explained']),
            ('wrong models not rejected, of which fewer than five intervals cover',
             [one for one in wrong if not one.is_good]),
            ('wrong models called explained', [one for one in wrong
                                               if one.verdict == 'explained']),
            ('true cause not among the first two suspects',
             [one for one in wrong if named(one.name).causes and not one.is_named])):
        print(f'\n{text}:', '; '.join(f'{one.name}, noise {one.level:g}' for one in missed)
              or 'none')


if __name__ == '__main__':
    main()
