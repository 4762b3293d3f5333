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
Euler angles: the twelve sequences, as data.

A sequence is named as in SciPy: three axes, upper case for intrinsic rotations (each about an
axis of the turned body), lower case for extrinsic ones (about the axes fixed in space). 'ZXZ' is
3-1-3: phi about space Z, theta about the line of nodes, psi about body z. All angles are active,
in rad: they take vectors from body to space components.

Attitude and angles are converted with 65 bits or more and rounded once: there and back they differ
by less than 1e-15 rad, at the poles as anywhere. Rounding itself, half the 4.4e-16 to 8.9e-16
between neighbouring doubles, is nearly all of that. All results have the same bits on every
machine.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import euler_angles as kernels
from rigid_body_ros.kernels.elementary import sines_cosines
from rigid_body_ros.kernels.jit import njit

#: sin(theta), or cos(theta) for three different axes, below which the outer two angles are
#: reported as not determined apart.
DEGENERATE = 1e-7
_TURN = 2.0 * np.pi
#: Divided by less, a rate would overflow.
_VANISHING = 1e-290
#: The same within rounding: the attitude says nothing of one of their combinations.
_UNDETERMINED = 1e-15


class _Axes(NamedTuple):
    """A sequence as intrinsic rotations about body axes i, j, k."""

    i: int
    j: int
    k: int
    proper: bool
    #: +1 where i, j and the third axis are right-handed, else -1.
    parity: int
    #: Whether the angles stand in reverse order: extrinsic x y z is intrinsic z y x.
    extrinsic: bool


@lru_cache
def _axes(sequence: str) -> _Axes:
    letters = [*sequence.lower()] if sequence in (sequence.lower(), sequence.upper()) else []
    if (len(letters) != 3 or not set(letters) <= set('xyz') or letters[0] == letters[1]
            or letters[1] == letters[2]):
        raise ValueError("Euler sequence: expected three of X, Y, Z such as 'ZXZ' (intrinsic) or "
                         f"'xyz' (extrinsic), no two neighbours alike, found {sequence!r}")
    extrinsic = sequence.islower()
    i, j, k = ('xyz'.index(letter) for letter in (reversed(letters) if extrinsic else letters))
    return _Axes(i, j, k, i == k, 1 if (j - i) % 3 == 1 else -1, extrinsic)


def check_sequence(sequence: str) -> None:
    """Raise ValueError if a sequence is none of the twelve."""
    _axes(sequence)


def to_quaternion(angles: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Return the attitude of Euler angles.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        In the order of the sequence, of any size: one turn more of one of them gives -q.
    sequence : str
        Three axes, no two neighbours alike: upper case intrinsic, lower case extrinsic.

    Returns
    -------
    array, shape (..., 4)
        x y z w, body to space.

    Raises
    ------
    ValueError
        The sequence is none of the twelve.

    """
    axes = _axes(sequence)
    rows = np.array(_intrinsic(angles, axes), order='C')
    attitude = np.empty((*rows.shape[:-1], 4))
    kernels.fill_attitudes(rows.reshape(-1, 3), attitude.reshape(-1, 4), axes.i, axes.j,
                           axes.proper, float(axes.parity))
    return attitude


def from_quaternion(attitude: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Return the Euler angles of an attitude.

    Half-sum and half-difference of the outer angles come from one arctangent each, without
    thresholds (Bernardes and Viollet, "Quaternion to Euler angles conversion", PLoS ONE 2022;
    for 'ZXZ': `theta = 2 atan2(|x, y|, |w, z|)`, (phi + psi) / 2 = atan2(z, w), (phi - psi) / 2
    = atan2(y, x)). Where only one of the two is determined, it is kept exact and split evenly.
    The rounded first and third turn have nearly one axis near a pole, where their errors would
    add up: so the third takes back as much of the first one's as lies along its own axis.

    Parameters
    ----------
    attitude : array, shape (..., 4)
        x y z w, body to space; unit norm is not needed. If it is zero or not finite, the angles
        are NaN.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3), rad
        In the order of the sequence. First and last axis alike: [0, 2 pi), [0, pi], [0, 2 pi).
        All different: (-pi, pi], [-pi/2, pi/2], (-pi, pi].

    Raises
    ------
    ValueError
        The sequence is none of the twelve.

    """
    axes = _axes(sequence)
    rows = np.array(attitude, float, order='C')
    angles = np.empty((*rows.shape[:-1], 3))
    kernels.fill_angles(rows.reshape(-1, 4), angles.reshape(-1, 3), axes.i, axes.j,
                        axes.proper, float(axes.parity))
    return angles[..., ::-1] if axes.extrinsic else angles


def degenerate(angles: ArrayLike, sequence: str = 'ZXZ') -> NDArray[np.bool_]:
    """
    Return where only the sum or the difference of the outer two angles is determined.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        In the order of the sequence. Only the middle one tells.
    sequence : str
        As for `to_quaternion`. Where all axes differ the poles are at +-pi/2, else at 0 and pi.

    Returns
    -------
    array of bool, shape (...)
        Whether the line of nodes is shorter than `DEGENERATE`.

    """
    middle = np.asarray(angles, float)[..., 1]
    sine, _ = _sine_cosine(middle, _axes(sequence))
    return np.asarray(np.abs(sine) < DEGENERATE)


def rotation_axes(angles: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Return the unit axes that the three angles turn about, in body components.

    For 'ZXZ' they are space Z, the line of nodes n and body z. The middle one is perpendicular
    to both others, which lie along one line where the angles are degenerate.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        In the order of the sequence, of any size.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3, 3)
        One axis a row, in the order of the sequence.

    """
    axes = _axes(sequence)
    outer, node, across, sine, cosine = _triad(angles, axes)
    first = cosine[..., None] * outer + sine[..., None] * across
    rows = np.stack([first, node, outer], axis=-2)
    return rows[..., ::-1, :] if axes.extrinsic else rows


def angular_velocity(angles: ArrayLike, rates: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Return the body angular velocity of Euler rates: each rate about its axis, summed.

    For 'ZXZ' (Goldstein, equation 4.87):
    w1 = phi' sin theta sin psi + theta' cos psi,
    w2 = phi' sin theta cos psi - theta' sin psi, w3 = phi' cos theta + psi'.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        In the order of the sequence, of any size.
    rates : array, shape (..., 3), rad/s
        In the order of the sequence.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3), rad/s, body axes

    """
    return np.sum(np.asarray(rates, float)[..., None] * rotation_axes(angles, sequence), axis=-2)


def rates(angles: ArrayLike, angular_velocity: ArrayLike, sequence: str = 'ZXZ') -> Floats:
    """
    Return the Euler rates of a body angular velocity.

    For 'ZXZ': phi' = (w1 sin psi + w2 cos psi) / sin theta, theta' = w1 cos psi - w2 sin psi,
    psi' = w3 - phi' cos theta. Near the poles phi' and psi' grow without bound, their sum (at
    theta = 0) or difference (at pi) does not; `degenerate` tells where. Where the line of nodes
    vanishes altogether, that sum or difference is returned, split evenly, and the part of the
    angular velocity that no finite rates give is left out.

    Parameters
    ----------
    angles : array, shape (..., 3), rad
        In the order of the sequence, of any size.
    angular_velocity : array, shape (..., 3), rad/s, body axes
        Broadcast against `angles`.
    sequence : str
        As for `to_quaternion`.

    Returns
    -------
    array, shape (..., 3), rad/s
        In the order of the sequence; always finite.

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
    Return a trajectory's angles without jumps.

    Of all triples that name the same attitude, (a, b, c) + 2 pi k and (a + pi, -b, c + pi) +
    2 pi k (with pi - b for three different axes), each sample takes the one nearest to the
    sample before. So the middle angle may leave its domain: where theta passes through zero it
    goes on to negative values while phi stays. Exactly at a pole, what the attitude leaves open
    is taken from the sample before (from the one after, at the beginning).

    Parameters
    ----------
    angles : array, shape (m, 3), rad
        Close enough in time for the nearest triple to be the right one.
    sequence : str
        Of these angles: it tells which triples name the same attitude.

    Returns
    -------
    array, shape (m, 3), rad

    """
    result, axes = np.array(angles, float, order='C'), _axes(sequence)
    sine, cosine = _sine_cosine(result[:, 1], axes)
    free = np.abs(sine) < _UNDETERMINED
    if free.size:
        _chain(result, int(np.argmin(free)), np.where(free, np.sign(cosine), 0.0), axes.proper)
    return result


@njit
def _chain(angles: Floats, anchor: int, poles: Floats, proper: bool) -> None:
    # Rows after the anchor follow the one before them, rows before it the one after them.
    for row in range(anchor + 1, len(angles)):
        _follow(angles[row], angles[row - 1], poles[row], proper)
    for row in range(anchor - 1, -1, -1):
        _follow(angles[row], angles[row + 1], poles[row], proper)


@njit
def _follow(triple: Floats, last: Floats, pole: float, proper: bool) -> None:
    a, b, c = triple
    if pole != 0.0:  # a + pole c is determined, a - pole c is free to stay as it was
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


@njit
def _nearest(angle: float, last: float) -> float:
    return angle + _TURN * np.rint((last - angle) / _TURN)


@njit
def _distance(triple: tuple[float, float, float], last: Floats) -> float:
    a, b, c = triple[0] - last[0], triple[1] - last[1], triple[2] - last[2]
    return a * a + b * b + c * c


def _intrinsic(angles: ArrayLike, axes: _Axes) -> Floats:
    values = np.asarray(angles, float)
    return values[..., ::-1] if axes.extrinsic else values


def _triad(angles: ArrayLike, axes: _Axes) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    # Body axis of the last turn, line of nodes, and the unit vector across: right-handed or
    # left-handed, such that the first axis is cosine * outer + sine * across.
    _, middle, last = np.moveaxis(_intrinsic(angles, axes), -1, 0)
    unit = np.eye(3)
    sine, cosine = _sine_cosine(middle, axes)
    outer = unit[axes.k]
    start = np.cross(unit[axes.i], unit[axes.j]) if axes.proper else unit[axes.i]
    s, c = (values[..., None] for values in sines_cosines(last))
    node, across = (c * axis + s * np.cross(axis, outer) for axis in (unit[axes.j], start))
    return np.broadcast_to(outer, node.shape), node, across, sine, cosine


def _sine_cosine(middle: Floats, axes: _Axes) -> tuple[Floats, Floats]:
    # Of the angle between the first and the last axis.
    sine, cosine = sines_cosines(middle)
    return (sine, cosine) if axes.proper else (cosine, axes.parity * sine)
