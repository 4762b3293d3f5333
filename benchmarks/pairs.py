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
Time contenders in turns, so that other load on the machine slows all of them equally.

A contender has three methods: `reset()`, which is not timed, `run()`, which is timed, and
`attitude()`, which returns the result.
"""

import math
import time

import numpy as np
from scipy.stats import binom

#: Number of rounds, and minimum number of rounds in which a contender runs.
ROUNDS, FEWEST = 301, 6
#: s; each timing repeats a run for at least this long.
LEAST = 1e-3
#: s; the time of a shorter run depends on what ran before (caches), so it first runs once untimed.
_SHORT = 0.1


def ratio(ours, peers):
    """
    Return how many times faster ours is: the ratio of the median times, with a 95 % interval.

    The interval is for the median of the ratios of single rounds.

    Parameters
    ----------
    ours, peers : array, shape (n,), s
        The times of two contenders in the same rounds; NaN in rounds that one of them skipped.

    """
    ratios = peers / ours
    ratios = np.sort(ratios[np.isfinite(ratios)])
    # Order statistics bound the median, whatever the distribution is.
    rank = max(1, int(binom.ppf(0.025, len(ratios), 0.5)))
    return (float(np.nanmedian(peers) / np.nanmedian(ours)), float(ratios[rank - 1]),
            float(ratios[-rank]))


def in_turns(contenders, seconds, patience=math.inf):
    """
    Return the time of a run, s, by round and contender, shape (ROUNDS, n).

    Every second round runs the contenders in reverse order.

    Parameters
    ----------
    contenders : sequence
        The n contenders.
    seconds : sequence of n float
        Estimated time of a run of each contender.
    patience : float, s
        Time for all runs of one contender. A contender that needs longer skips evenly spread
        rounds; its times in these rounds are NaN.

    """
    times = np.full((ROUNDS, len(contenders)), np.nan)
    repeats = [1 + int(LEAST / each) for each in seconds]
    every = [min(math.ceil(ROUNDS * many * each / patience) or 1, ROUNDS // FEWEST)
             for many, each in zip(repeats, seconds)]
    for number in range(ROUNDS):
        for column in range(len(contenders))[::1 if number % 2 else -1]:
            if number % every[column] == 0:
                if seconds[column] < _SHORT:
                    _mean(contenders[column], 1)
                times[number, column] = _mean(contenders[column], repeats[column])
    return times


def quick(contender):
    """Estimate the time of a run, s, to choose between settings of one peer."""
    _mean(contender, 1)
    repeats = 1 + int(LEAST / _mean(contender, 2))
    return min(_mean(contender, repeats) for _ in range(3))


def _mean(contender, repeats):
    # Processor time of this process, because other processes share the cores.
    total = 0.0
    for _ in range(repeats):
        contender.reset()
        start = time.process_time()
        contender.run()
        total += time.process_time() - start
    return total / repeats
