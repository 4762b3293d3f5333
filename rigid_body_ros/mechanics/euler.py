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
Euler angles, in any of the 24 sequences.

A sequence is named by its three axes, as in SciPy. Upper case means intrinsic rotations, each
about an axis of the rotated body. Lower case means extrinsic rotations, about axes fixed in space.
Twelve orders of axes are possible, such as z x z, and each may be intrinsic or extrinsic.
For example, 'ZXZ' is the 3-1-3 sequence: phi about space Z, theta about the line of nodes, and psi
about body z. All angles are in rad. They describe active rotations, which map body vectors to
space vectors. The poles are the attitudes at which the first and third axes are parallel (gimbal
lock).

Conversions are computed to at least 65 bits and rounded once. Converting an attitude to angles and
back changes it by less than 1e-15 rad, even at the poles. Nearly all of this change comes from
rounding the angles, because neighbouring doubles are 4.4e-16 to 8.9e-16 apart. All results are the
same on every machine, bit for bit.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels
from rigid_body_ros.engine.elementary import sines_cosines

#: Euler angles with middle angle theta count as degenerate if |sin(theta)| is below this value.
#: For sequences of three different axes, |cos(theta)| is used instead. The attitude of degenerate
#: angles determines only the sum or the difference of the first and third angles.
DEGENERATE = 1e-7
#: If |sin(theta)| is below this value, a rate divided by sin(theta) may overflow.
_VANISHING = 1e-290
#: If |sin(theta)| is below this value, theta is at a pole within rounding. Either the sum or the
#: difference of the first and third angles is then completely undetermined.
_UNDETERMINED = 1e-15


class _Axes(NamedTuple):
    """An Euler sequence, expressed as intrinsic rotations about the body axes i, j, k."""

    i: int
    j: int
    k: int
    #: Whether the first and third axes are the same.
    proper: bool
    #: 1 if i, j and the remaining body axis form a right-handed system, else -1.
    parity: int
    #: Whether the sequence was given as extrinsic. Its angles are then in reverse order, because
    #: extrinsic x y z is intrinsic z y x.
    extrinsic: bool


@lru_cache
def _axes(sequence: str) -> _Axes:
    letters = [*sequence.lower()] if sequence in (sequence.lower(), sequence.upper()) else []
    if (len(letters) != 3 or not set(letters) <= set('xyz') or letters[0] == letters[1]
            or letters[1] == letters[2]):
        raise ValueError("Euler sequence: expected three axes such as 'ZXZ' (intrinsic) or 'xyz' "
                         f'(extrinsic), in which neighbours differ, found {sequence!r}')
    extrinsic = sequence.islower()
    i, j, k = ('xyz'.index(letter) for letter in (reversed(letters) if extrinsic else letters))
    return _Axes(i, j, k, i == k, 1 if (j - i) % 3 == 1 else -1, extrinsic)


def check_sequence(sequence: str) -> None:
    """Raise ValueError if a string does not name one of the 24 Euler sequences."""
    _axes(sequence)


def to_quaternion(angles: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Convert Euler angles to quaternions.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        The angles in the order of the sequence. They may exceed a full turn. Adding 2 pi to one
        angle changes the sign of the quaternion.
    sequence : str
        Three axes, in upper case for intrinsic rotations and in lower case for extrinsic
        rotations. Neighbouring axes must differ.

    Returns
    -------
    array, shape (..., 4)
        x y z w, body to space.

    Raises
    ------
    ValueError
        The sequence does not name three axes in which neighbours differ, all in upper case or all
        in lower case.

    """
    axes = _axes(sequence)
    rows = np.array(_intrinsic(angles, axes), order='C')
    attitude = np.empty((*rows.shape[:-1], 4))
    kernels.fill_attitudes(rows.reshape(-1, 3), attitude.reshape(-1, 4), axes.i, axes.j,
                           axes.proper, float(axes.parity))
    return attitude


def from_quaternion(attitude: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Convert quaternions to Euler angles.

    One arctangent gives half the sum of the first and third angles, and another gives half their
    difference. No thresholds are needed. The method is that of Bernardes and Viollet, "Quaternion
    to Euler angles conversion", PLoS ONE 2022. For 'ZXZ', this means (phi + psi) / 2 = atan2(z,
    w), (phi - psi) / 2 = atan2(y, x), and `theta = 2 atan2(|x, y|, |w, z|)`. At a pole, the
    attitude determines only the sum or only the difference. This sum or difference is still exact,
    and is split evenly between the first and third angles.

    Near a pole, the first and third rotations have nearly the same axis, so their rounding errors
    would add up. To avoid this, the third angle compensates for the part of the first angle's
    rounding error that is a rotation about the third axis.

    Parameters
    ----------
    attitude : array, shape (..., 4)
        Quaternions x y z w, body to space, of any norm. If a quaternion is zero or not finite, its
        angles are NaN.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3), rad
        The angles in the order of the sequence. The ranges are [0, 2 pi), [0, pi], [0, 2 pi) if
        the first and third axes are the same, and (-pi, pi], [-pi/2, pi/2], (-pi, pi] if all axes
        differ.

    Raises
    ------
    ValueError
        The sequence does not name three axes in which neighbours differ, all in upper case or all
        in lower case.

    """
    axes = _axes(sequence)
    rows = np.array(attitude, float, order='C')
    angles = np.empty((*rows.shape[:-1], 3))
    kernels.fill_angles(rows.reshape(-1, 4), angles.reshape(-1, 3), axes.i, axes.j,
                        axes.proper, float(axes.parity))
    return angles[..., ::-1] if axes.extrinsic else angles


def degenerate(angles: ArrayLike, sequence: str = 'ZXZ') -> NDArray[np.bool_]:
    """
    Return whether Euler angles are within 1e-7 rad of gimbal lock.

    At gimbal lock, the first and third rotations have the same axis, so the attitude determines
    only the sum or the difference of their angles.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        The angles in the order of the sequence. Only the middle angle matters.
    sequence : str
        As for `to_quaternion`. Gimbal lock occurs at a middle angle of +-pi/2 if all axes differ,
        otherwise at 0 and pi.

    Returns
    -------
    array of bool, shape (...)
        Whether |sin(theta)| of the middle angle theta is below `DEGENERATE`, which is 1e-7. If
        all axes differ, |cos(theta)| is used instead.

    Raises
    ------
    ValueError
        The sequence does not name three axes in which neighbours differ, all in upper case or all
        in lower case.

    """
    middle = np.asarray(angles, float)[..., 1]
    sine, _ = _sine_cosine(middle, _axes(sequence))
    return np.asarray(np.abs(sine) < DEGENERATE)


def rotation_axes(angles: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Return the axes of the three rotations as unit vectors in body axes.

    For 'ZXZ', the axes are space Z, the line of nodes and body z. The middle axis is perpendicular
    to the other two. If the angles are degenerate, the first and last axes are parallel.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        The angles in the order of the sequence. They may exceed a full turn.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3, 3)
        One axis per row, in the order of the sequence.

    Raises
    ------
    ValueError
        The sequence does not name three axes in which neighbours differ, all in upper case or all
        in lower case.

    """
    axes = _axes(sequence)
    outer, node, across, sine, cosine = _triad(angles, axes)
    first = cosine[..., None] * outer + sine[..., None] * across
    rows = np.stack([first, node, outer], axis=-2)
    return rows[..., ::-1, :] if axes.extrinsic else rows


def angular_velocity(angles: ArrayLike, rates: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Convert Euler rates to an angular velocity.

    The angular velocity is the sum of the three rotation axes, each times its Euler rate.

    For 'ZXZ' (Goldstein, equation 4.87):
    w1 = phi' sin theta sin psi + theta' cos psi,
    w2 = phi' sin theta cos psi - theta' sin psi, w3 = phi' cos theta + psi'.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        The angles in the order of the sequence. They may exceed a full turn.
    rates : array, shape (..., 3), rad/s
        The Euler rates in the order of the sequence.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3), rad/s, body axes

    Raises
    ------
    ValueError
        The sequence does not name three axes in which neighbours differ, all in upper case or all
        in lower case.

    """
    return np.sum(np.asarray(rates, float)[..., None] * rotation_axes(angles, sequence), axis=-2)


def rates(angles: ArrayLike, angular_velocity: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Convert an angular velocity to Euler rates.

    For 'ZXZ', phi' = (w1 sin psi + w2 cos psi) / sin theta, theta' = w1 cos psi - w2 sin psi, and
    psi' = w3 - phi' cos theta.

    Near gimbal lock, phi' and psi' become very large, because sin theta is small. Their sum (near
    theta = 0) or their difference (near theta = pi) stays moderate. Exactly at gimbal lock, this
    sum or difference is split evenly between phi' and psi'. The component of the angular velocity
    perpendicular to all three rotation axes is then ignored, because no finite rates produce it.
    Of the doubles, only theta = 0 is exactly there; the rounded pi / 2 and pi are near it.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        The angles in the order of the sequence. They may exceed a full turn.
    angular_velocity : array, shape (..., 3), rad/s, body axes
        The angular velocity, which is broadcast against `angles`.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3), rad/s
        The rates in the order of the sequence. They are always finite.

    Raises
    ------
    ValueError
        The sequence does not name three axes in which neighbours differ, all in upper case or all
        in lower case.

    """
    axes = _axes(sequence)
    outer, node, across, sine, cosine = _triad(angles, axes)
    w = np.asarray(angular_velocity, float)
    along, second, third = (np.sum(w * axis, axis=-1) for axis in (across, node, outer))
    regular = np.abs(sine) > _VANISHING
    even = 0.5 * third * np.sign(cosine)
    first = np.divide(along, sine, out=np.broadcast_to(even, np.shape(along)).copy(),
                      where=regular)
    result = np.stack([first, second, third - cosine * first], axis=-1)
    return result[..., ::-1] if axes.extrinsic else result


def unwrap(angles: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Remove the jumps from the Euler angles of a trajectory.

    Many triples of angles describe the same attitude: (a, b, c) + 2 pi k and (a + pi, -b, c + pi)
    + 2 pi k, where k is any triple of integers. If all three axes differ, -b becomes pi - b. For
    each sample, `unwrap` chooses the triple closest to that of the previous sample. The middle
    angle may therefore leave its usual range: where theta passes through zero, it becomes negative
    and phi does not jump. Exactly at a pole, the attitude determines only the sum or only the
    difference of the first and third angles. There, `unwrap` takes the undetermined sum or
    difference from the previous sample or, if the trajectory begins at a pole, from the first
    sample that is not at a pole.

    Parameters
    ----------
    angles : array, shape (m, 3), rad
        The angles in the order of the sequence. The samples must be close enough in time that the
        closest triple is the correct one.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (m, 3), rad

    Raises
    ------
    ValueError
        The sequence does not name three axes in which neighbours differ, all in upper case or all
        in lower case.

    """
    result, axes = np.array(angles, float, order='C'), _axes(sequence)
    sine, cosine = _sine_cosine(result[:, 1], axes)
    free = np.abs(sine) < _UNDETERMINED
    if free.size:
        poles = np.where(free, np.sign(cosine), 0.0)
        kernels.make_rows_continuous(result, int(np.argmin(free)), poles, axes.proper)
    return result


def _intrinsic(angles: ArrayLike, axes: _Axes) -> Floats:
    values = np.asarray(angles, float)
    return values[..., ::-1] if axes.extrinsic else values


def _triad(angles: ArrayLike, axes: _Axes) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    # Return five values: the body axis of the last rotation (outer), the line of nodes, the unit
    # vector perpendicular to these two (across), and the sine and cosine of the angle between the
    # first and last axes. The first axis is cosine * outer + sine * across.
    _, middle, last = np.moveaxis(_intrinsic(angles, axes), -1, 0)
    unit = np.eye(3)
    sine, cosine = _sine_cosine(middle, axes)
    outer = unit[axes.k]
    start = np.cross(unit[axes.i], unit[axes.j]) if axes.proper else unit[axes.i]
    s, c = (values[..., None] for values in sines_cosines(last))
    node, across = (c * axis + s * np.cross(axis, outer) for axis in (unit[axes.j], start))
    return np.broadcast_to(outer, node.shape), node, across, sine, cosine


def _sine_cosine(middle: Floats, axes: _Axes) -> tuple[Floats, Floats]:
    # Return the sine and cosine of the angle between the first and last axes.
    sine, cosine = sines_cosines(middle)
    return (sine, cosine) if axes.proper else (cosine, axes.parity * sine)
