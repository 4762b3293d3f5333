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
Time two contenders in turns, so that what slows the machine slows both.

A contender has `reset()`, which is not timed, `run()`, which is, and `attitude()`, its answer.
"""

from dataclasses import dataclass
import time

import numpy as np
from scipy.stats import binom

PAIRS = 301
#: A sample repeats a run until it has taken so long, s: the clock's own cost is a microsecond.
LEAST = 1e-3


@dataclass
class Comparison:
    """
    The times, s, of two contenders, run alternately.

    Attributes
    ----------
    ours, peers : array, shape (n,)

    """

    ours: np.ndarray
    peers: np.ndarray

    @property
    def ratio(self):
        """How many times faster ours is: the median of the pairs and its 95 % interval."""
        ratios = np.sort(self.peers / self.ours)
        # Order statistics: the median lies between these two whatever the distribution.
        rank = int(binom.ppf(0.025, len(ratios), 0.5))
        return np.median(ratios), ratios[rank - 1], ratios[-rank]


def compare(ours, peer):
    """Return the times of PAIRS pairs, of which each contender is first in every second one."""
    repeats = {contender: _repeats(contender) for contender in (ours, peer)}
    times = {ours: [], peer: []}
    for pair in range(PAIRS):
        for contender in (ours, peer) if pair % 2 else (peer, ours):
            times[contender].append(_mean(contender, repeats[contender]))
    return Comparison(np.array(times[ours]), np.array(times[peer]))


def quick(contender):
    """Return about how long a run takes, s: to choose between settings of one peer."""
    repeats = _repeats(contender)
    return min(_mean(contender, repeats) for _ in range(3))


def _repeats(contender):
    _mean(contender, 1)
    return 1 + int(LEAST / _mean(contender, 2))


def _mean(contender, repeats):
    # Time of this process: the cores are shared with others.
    total = 0.0
    for _ in range(repeats):
        contender.reset()
        start = time.process_time()
        contender.run()
        total += time.process_time() - start
    return total / repeats
