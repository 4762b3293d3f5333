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
Kernels that convert between attitudes and Euler angles.

The kernels compute each result to 65 bits, and round it only once.

A sequence consists of intrinsic rotations about the body axes i, j and k. It is passed to a kernel
as four arguments: i, j, whether the sequence is proper (k = i), and a parity. The parity is 1 if
the axes i, j and the remaining body axis form a right-handed system, and -1 otherwise.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import double_double as dd
from rigid_body_ros.kernels.double_double import DoubleDouble
from rigid_body_ros.kernels.elementary import arctangent_pair, scale_of, sine_cosine_pairs
from rigid_body_ros.kernels.jit import internal, njit, WRITTEN

#: The range of the first and the third angle, given by the smallest and the largest double in the
#: range. Proper and Tait-Bryan sequences have different ranges.
_PROPER = 0.0, math.nextafter(2.0 * math.pi, 0.0)
_TAIT_BRYAN = math.nextafter(-math.pi, 0.0), math.pi
_TURN = 2.0 * np.pi


@njit
def fill_attitudes(angles: Annotated[Floats, 'm 3'], attitudes: Annotated[Floats, 'm 4', WRITTEN],
                   i: int, j: int, proper: bool, parity: float) -> None:
    """
    Convert Euler angles to attitudes.

    Parameters
    ----------
    angles : float64 (m, 3), rad
        The angles in the order of the intrinsic rotations.
    attitudes : float64 (m, 4)
        The output: quaternions x y z w, body to space.
    i, j, proper, parity : int, int, bool, float
        The sequence of rotations, as described in the module docstring.

    """
    for row in range(len(angles)):
        s1, c1 = sine_cosine_pairs(0.5 * float(angles[row, 0]))
        s2, c2 = sine_cosine_pairs(0.5 * float(angles[row, 1]))
        s3, c3 = sine_cosine_pairs(0.5 * float(angles[row, 2]))
        # Multiply the first two rotations, and then multiply their product by the third. Here x, y
        # and z are the components along i, j and i x j.
        w, x = dd.multiply(c1, c2), dd.multiply(s1, c2)
        y, z = dd.multiply(c1, s2), dd.multiply(s1, s2)
        if proper:
            w, x = _rotated(w, x, s3, c3)
            z, y = _rotated(z, y, s3, c3)
        else:
            s3 = (parity * s3[0], parity * s3[1])
            w, z = _rotated(w, z, s3, c3)
            y, x = _rotated(y, x, s3, c3)
        # Adding zero turns -0.0 into 0.0.
        attitudes[row, 3], attitudes[row, i] = w[0] + 0.0, x[0] + 0.0
        attitudes[row, j], attitudes[row, 3 - i - j] = y[0] + 0.0, parity * z[0] + 0.0


@njit
def fill_angles(attitudes: Annotated[Floats, 'm 4'], angles: Annotated[Floats, 'm 3', WRITTEN],
                i: int, j: int, proper: bool, parity: float) -> None:
    """
    Convert attitudes to Euler angles.

    If an attitude is zero or not finite, its angles are NaN.

    Parameters
    ----------
    attitudes : float64 (m, 4)
        Quaternions x y z w, body to space, which need not be normalized.
    angles : float64 (m, 3), rad
        The output: the angles in the order of the intrinsic rotations.
    i, j, proper, parity : int, int, bool, float
        The sequence of rotations, as described in the module docstring.

    """
    low, high = _PROPER if proper else _TAIT_BRYAN
    for row in range(len(attitudes)):
        w, x = float(attitudes[row, 3]), float(attitudes[row, i])
        y, z = float(attitudes[row, j]), parity * float(attitudes[row, 3 - i - j])
        size = max(abs(w), abs(x), abs(y), abs(z))
        if size == 0.0 or 0.0 * w + 0.0 * x + 0.0 * y + 0.0 * z != 0.0:
            angles[row, 0] = angles[row, 1] = angles[row, 2] = math.nan
            continue
        scale = scale_of(size)
        first, middle, third, cosine = _angles(scale * w, scale * x, scale * y, scale * z, proper)
        if not proper:
            middle = dd.subtract(middle, (0.5 * dd.PI[0], 0.5 * dd.PI[1]))
            third, cosine = (-parity * third[0], -parity * third[1]), -parity * cosine
        rounded = _rounded(first, low, high)
        change = cosine * _wrapped(dd.subtract((rounded, 0.0), first), 0.0)[0]
        angles[row, 0], angles[row, 1] = rounded, middle[0]
        angles[row, 2] = _rounded(dd.subtract(third, (change, 0.0)), low, high)


@internal
def _rotated(a: DoubleDouble, b: DoubleDouble, sine: DoubleDouble,
             cosine: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    return (dd.subtract(dd.multiply(a, cosine), dd.multiply(b, sine)),
            dd.add(dd.multiply(b, cosine), dd.multiply(a, sine)))


@internal
def _angles(w: float, x: float, y: float, z: float,
            proper: bool) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble, float]:
    # Return the three angles of a proper sequence for the quaternion (w, x, y, z), and the cosine
    # of the middle angle.
    a, b, c, d = (w, 0.0), (x, 0.0), (y, 0.0), (z, 0.0)
    if not proper:  # a quarter turn about the middle axis makes the sequence proper
        a, b, c, d = (dd.two_sum(w, -y), dd.two_sum(x, -z), dd.two_sum(w, y), dd.two_sum(x, z))
    half_sum, half_difference = arctangent_pair(b, a), arctangent_pair(d, c)
    along, across = _hypotenuse(a, b), _hypotenuse(c, d)
    half = arctangent_pair(across, along)
    cosine = (along[0] - across[0]) * (along[0] + across[0]) / (
        along[0] * along[0] + across[0] * across[0])
    return (dd.add(half_sum, half_difference), (2.0 * half[0], 2.0 * half[1]),
            dd.subtract(half_sum, half_difference), cosine)


@internal
def _hypotenuse(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    scale = scale_of(max(abs(a[0]), abs(b[0])))
    a, b = (scale * a[0], scale * a[1]), (scale * b[0], scale * b[1])
    root = dd.sqrt(dd.add(dd.multiply(a, a), dd.multiply(b, b)))
    return root[0] / scale, root[1] / scale


@internal
def _rounded(angle: DoubleDouble, low: float, high: float) -> float:
    # Return the double from `low` to `high` that is nearest to the angle, modulo whole turns. The
    # result is never -0.0.
    return min(max(_wrapped(angle, 0.5 * (low + high))[0], low), high) + 0.0


@internal
def _wrapped(angle: DoubleDouble, centre: float) -> DoubleDouble:
    # Shift the angle by whole turns so that the result is within half a turn of the centre.
    turns = 2.0 * float(round((angle[0] - centre) / (2.0 * dd.PI[0])))
    return dd.subtract(angle, (turns * dd.PI[0], turns * dd.PI[1]))


@njit
def make_rows_continuous(angles: Annotated[Floats, 'm 3', WRITTEN], anchor: int,
                         poles: Annotated[Floats, 'm'], proper: bool) -> None:
    """
    Make a series of Euler angles continuous from row to row.

    Several triples of angles describe the same attitude. The kernel starts at the row `anchor`,
    works outwards in both directions, and gives each row the triple that is closest to the
    neighbouring row, which it has just processed.

    Parameters
    ----------
    angles : float64 (m, 3), rad
        The angles, which are modified in place.
    anchor : int
        The row to start from, which is not modified.
    poles : float64 (m,)
        0 for a row that is not at a pole, 1 for a row in which the attitude determines only a + c,
        and -1 for a row in which the attitude determines only a - c. Here a and c are the first
        and the third angle.
    proper : bool
        See `fill_angles`.

    """
    for row in range(anchor + 1, len(angles)):
        _make_continuous(angles[row], angles[row - 1], poles[row], proper)
    for row in range(anchor - 1, -1, -1):
        _make_continuous(angles[row], angles[row + 1], poles[row], proper)


@internal
def _make_continuous(triple: Floats, last: Floats, pole: float, proper: bool) -> None:
    a, b, c = triple
    if pole != 0.0:  # the attitude determines only a + pole c, so copy a - pole c
        free = last[0] - pole * last[2]
        determined = _nearest(a + pole * c, last[0] + pole * last[2])
        triple[0] = 0.5 * (determined + free)
        triple[1] = _nearest(b, last[1])
        triple[2] = 0.5 * pole * (determined - free)
        return
    same = _nearest(a, last[0]), _nearest(b, last[1]), _nearest(c, last[2])
    other = (_nearest(a + np.pi, last[0]), _nearest(-b if proper else np.pi - b, last[1]),
             _nearest(c + np.pi, last[2]))
    triple[0], triple[1], triple[2] = (
        other if _distance(other, last) < _distance(same, last) else same)


@internal
def _nearest(angle: float, last: float) -> float:
    return angle + _TURN * np.rint((last - angle) / _TURN)


@internal
def _distance(triple: tuple[float, float, float], last: Floats) -> float:
    a, b, c = triple[0] - last[0], triple[1] - last[1], triple[2] - last[2]
    return a * a + b * b + c * c
