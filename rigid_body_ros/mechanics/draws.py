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
Random numbers that depend only on a key and a counter, not on earlier draws.

The numbers are the same on every machine, bit for bit, because this module calls no functions from
the C library or from SciPy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine.elementary import sines_cosines

#: The counter increment of SplitMix64, and the multipliers of its finalizer (Steele, Lea, Flood
#: 2014, "Fast splittable pseudorandom number generators").
_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
#: Number of terms in the series for the logarithm. Further terms would be too small to change the
#: result.
_TERMS = 12
_LN_2 = 0.6931471805599453


def hashed(keys: NDArray[np.uint64], counters: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """
    Return the random numbers at given positions of SplitMix64 streams.

    Parameters
    ----------
    keys, counters : array of uint64, shape (...)
        The seed of each stream, and the position in the stream. The two arrays are broadcast
        against each other.

    Returns
    -------
    array of uint64, shape (...)

    """
    bits = keys + (counters + np.uint64(1)) * _STEP
    bits = (bits ^ (bits >> np.uint64(30))) * _FIRST
    bits = (bits ^ (bits >> np.uint64(27))) * _SECOND
    return bits ^ (bits >> np.uint64(31))


def normals(bits: NDArray[np.uint64]) -> Floats:
    """
    Convert random bits to standard normal numbers (Box and Muller, 1958).

    Parameters
    ----------
    bits : array of uint64, shape (..., 2 n)
        Random bits.

    Returns
    -------
    array, shape (..., 2 n)

    """
    uniforms = ((bits >> np.uint64(12)).astype(float) + 0.5) * 2.0 ** -52  # never 0 or 1
    first, second = np.split(uniforms, 2, axis=-1)
    radii = np.sqrt(-2.0 * logarithms(first))
    sines, cosines = sines_cosines(2.0 * np.pi * second)
    return np.concatenate([radii * cosines, radii * sines], axis=-1)


def logarithms(numbers: Floats) -> Floats:
    """Return the natural logarithms of positive numbers, with a relative error of up to 2**-51."""
    fractions, exponents = np.frexp(numbers)
    is_small = fractions < 0.5 ** 0.5
    fractions, exponents = np.where(is_small, 2.0 * fractions, fractions), exponents - is_small
    # ln x = 2 artanh s = 2 (s + s^3 / 3 + s^5 / 5 ...), |s| < 0.172
    s = (fractions - 1.0) / (fractions + 1.0)
    square, series = s * s, np.zeros(s.shape)
    for k in reversed(range(_TERMS)):
        series *= square
        series += 1.0 / (2 * k + 1)
    return 2.0 * s * series + exponents * _LN_2
