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
Random numbers of many runs at once, with the bits of numpy.

Each run has a generator of its own for each key, `stream`. To construct one takes as long as a
torque-free motion, so this module does the arithmetic of numpy for all runs by array operations:
the hash of `SeedSequence` (Melissa O'Neill's seed_seq_fe), the generator PCG64 (XSL RR 128/64,
O'Neill 2014) and the ziggurat of `standard_normal` (Marsaglia and Tsang 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
import zlib

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats

Words = NDArray[np.uint64]
#: An unsigned integer of 128 bits: its high and its low half.
Wide = tuple[Words, Words]

#: Constants of the hash.
_POOL, _BITS = 4, np.uint64(0xffffffff)
_INITIAL_A, _FACTOR_A = 0x43b0d7e5, 0x931e8875
_INITIAL_B, _FACTOR_B = 0x8b51f9dd, 0x58f38ded
_LEFT, _RIGHT = np.uint64(0xca01f9dd), np.uint64(0x4973f715)
#: The multiplier of PCG64, its high and its low half.
_MULTIPLIER = 0x2360ed051fc65da4, 0x4385df649fccf645
#: Number of layers of the ziggurat, and of bits of a random number that it scales.
_LAYERS, _MANTISSA = 256, 52
#: Relative margin, far above rounding, by which a number has to lie within its layer.
_MARGIN = 1e-12


def stream(seed: int, run: int, key: str) -> np.random.Generator:
    """Return the random numbers of a key in a run."""
    sequence = np.random.SeedSequence(seed, spawn_key=(run, zlib.crc32(key.encode())))
    return np.random.Generator(np.random.PCG64(sequence))


def uniforms(seed: int, runs: NDArray[np.int64], key: str) -> Floats:
    """Return the first `stream(seed, run, key).random()` of each run, shape (n,)."""
    bits, = _outputs(seed, runs, key, 1)
    return (bits >> np.uint64(11)).astype(float) * 2.0 ** -53


def normals(seed: int, runs: NDArray[np.int64], key: str, count: int) -> Floats:
    """
    Return the first normal numbers of each run.

    Parameters
    ----------
    seed : int
        From 0 to 2**64 - 1.
    runs : array of int, shape (n,)
        From 0 to 2**32 - 1.
    key : str
        The key that is drawn.
    count : int
        Number of numbers for each run.

    Returns
    -------
    array, shape (n, count)
        In row i `stream(seed, runs[i], key).standard_normal(count)`.

    """
    bits = np.stack(_outputs(seed, runs, key, count), axis=-1)
    widths, bounds = _ziggurat()
    layer = bits % np.uint64(_LAYERS)
    mantissa = bits >> np.uint64(9) & np.uint64(2 ** _MANTISSA - 1)
    sign = 1.0 - 2.0 * (bits >> np.uint64(8) & np.uint64(1))
    result = sign * (mantissa * widths[layer])
    # A rejected number takes more than one output of the generator.
    for row in np.flatnonzero((mantissa >= bounds[layer]).any(axis=-1)).tolist():
        result[row] = stream(seed, int(runs[row]), key).standard_normal(count)
    return result


@cache
def _ziggurat() -> tuple[Floats, NDArray[np.uint64]]:
    """
    Return the factor of each layer, and the mantissas below which numpy accepts a number.

    The factors are read from numpy: it draws from a state whose output selects a layer and has the
    mantissa 1. Layer 1 accepts nothing at once. A layer accepts numbers up to the width of the one
    before; before layer 0 is the last one.
    """
    generator = np.random.PCG64()
    random, widths = np.random.Generator(generator), np.empty(_LAYERS)
    for layer in range(_LAYERS):
        output = layer | 1 << 9  # of the state with this low half and the high half 0
        generator.state = {**generator.state, 'state': {'state': output, 'inc': 1}}
        generator.advance(-1)
        widths[layer] = random.standard_normal()
    widths[1] = 0.0
    with np.errstate(divide='ignore'):
        bounds = 2.0 ** _MANTISSA * (1.0 - _MARGIN) * np.roll(widths, 1) / widths
    bounds[1] = 0.0
    return widths, bounds.astype(np.uint64)


def _outputs(seed: int, runs: NDArray[np.int64], key: str, count: int) -> list[Words]:
    """Return the first outputs of PCG64 of each run, each shape (n,)."""
    high, low, sequence_high, sequence_low = _seeds(seed, runs, zlib.crc32(key.encode()))
    one = np.uint64(1)
    increment = (sequence_high << one | sequence_low >> np.uint64(63), sequence_low << one | one)
    state = _sum(_product(_sum(increment, (high, low))), increment)
    outputs: list[Words] = []
    for _ in range(count):
        state = _sum(_product(state), increment)
        mixed, turn = state[0] ^ state[1], state[0] >> np.uint64(58)
        outputs.append(np.right_shift(mixed, turn) | np.left_shift(mixed, -turn % np.uint64(64)))
    return outputs


def _sum(a: Wide, b: Wide) -> Wide:
    low = a[1] + b[1]
    return a[0] + b[0] + (low < a[1]).astype(np.uint64), low


def _product(a: Wide) -> Wide:
    """Return the product with the multiplier."""
    high, low = map(np.uint64, _MULTIPLIER)
    half = np.uint64(32)
    (top, bottom), (upper, lower) = ((x >> half, x & _BITS) for x in (a[1], low))
    cross, other = top * lower, bottom * upper
    middle = (bottom * lower >> half) + (cross & _BITS) + (other & _BITS)
    carried = top * upper + (cross >> half) + (other >> half) + (middle >> half)
    return carried + a[0] * low + a[1] * high, a[1] * low


def _seeds(seed: int, runs: NDArray[np.int64], key: int) -> list[Words]:
    """Return `SeedSequence(seed, spawn_key=(run, key)).generate_state(4, uint64)` of each run."""
    pool = _pool([np.array([seed >> 32 * k & 0xffffffff], np.uint64) for k in range(_POOL)],
                 [runs.astype(np.uint64), np.array([key], np.uint64)])
    constant, words = _INITIAL_B, []
    for k in range(8):
        word, constant = _hashed(pool[k % _POOL], constant, _FACTOR_B)
        words.append(word)
    return [words[k] | words[k + 1] << np.uint64(32) for k in range(0, 8, 2)]


def _pool(entropy: Sequence[Words], keys: Sequence[Words]) -> list[Words]:
    """Return the pool of the hash, words of 32 bits."""
    constant, pool = _INITIAL_A, []
    for word in entropy:
        word, constant = _hashed(word, constant, _FACTOR_A)
        pool.append(word)
    for source in range(_POOL):
        for target in range(_POOL):
            if source != target:
                word, constant = _hashed(pool[source], constant, _FACTOR_A)
                pool[target] = _mixed(pool[target], word)
    for key in keys:
        for target in range(_POOL):
            word, constant = _hashed(key, constant, _FACTOR_A)
            pool[target] = _mixed(pool[target], word)
    return pool


def _hashed(word: Words, constant: int, factor: int) -> tuple[Words, int]:
    """Return a hashed word, and the constant for the next one."""
    following = constant * factor & 0xffffffff
    word = (word ^ np.uint64(constant)) * np.uint64(following) & _BITS
    return word ^ word >> np.uint64(16), following


def _mixed(x: Words, y: Words) -> Words:
    result = _LEFT * x - _RIGHT * y & _BITS
    return result ^ result >> np.uint64(16)
