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

"""Draw random numbers for many runs at once, with a separate stream for each run and key."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats

#: Philox produces this many random numbers for each value of its counter.
_AT_ONCE = 4


def uniforms(seed: int, runs: NDArray[np.int64], key: str, count: int) -> Floats:
    """
    Return uniform random numbers for each run, strictly between 0 and 1.

    The generator, Philox, computes random numbers directly from a key and a counter. Each run has
    its own range of the counter, so that the random numbers of a run can be computed without those
    of earlier runs.

    Parameters
    ----------
    seed : int
        The seed, from 0 to 2**64 - 1.
    runs : array of int, shape (n,)
        The run numbers. They should be close together, because random numbers are computed for all
        runs from the lowest to the highest number.
    key : str
        The name of the stream, for example the key of a parameter.
    count : int
        Number of random numbers for each run.

    Returns
    -------
    array, shape (n, count)
        Row i depends only on the seed, `runs[i]`, the key and the count.

    """
    first, counters = int(runs.min()), -(-count // _AT_ONCE)
    generator = np.random.Philox(key=zlib.crc32(key.encode()) << 64 | seed,
                                 counter=first * counters)
    bits = generator.random_raw((int(runs.max()) + 1 - first) * counters * _AT_ONCE)
    chosen = bits.reshape(-1, counters * _AT_ONCE)[runs - first, :count]
    return ((chosen >> np.uint64(12)).astype(float) + 0.5) * 2.0 ** -52


def normals(seed: int, runs: NDArray[np.int64], key: str, count: int) -> Floats:
    """Return standard normal random numbers for each run; see `uniforms` for the arguments."""
    from scipy.special import ndtri  # slow to import
    return np.asarray(ndtri(uniforms(seed, runs, key, count)))
