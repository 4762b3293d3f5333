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
Rotations as unit quaternions.

Quaternions are stored as x, y, z, w. They have unit norm and map body vectors to space vectors:
`v_space = q v_body q*` with Hamilton's product. q and -q describe the same rotation. All functions
except `from_matrix` broadcast over leading axes.

The package does not use SciPy's `Rotation`, for two reasons: the last bits of SciPy's results
depend on the C library, and SciPy normalises its input, which changes components by up to 3e-16.
Accuracy is not a reason, because SciPy's exp and log are as accurate as those of this module
(errors up to 8e-16).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine.elementary import arctangents, sines_cosines


def multiply(p: ArrayLike, q: ArrayLike) -> Floats:
    """
    Return Hamilton's product p q: the rotation q followed by the rotation p.

    Parameters
    ----------
    p, q : array, shape (..., 4)
        x y z w, of any norm. The norm of p q is the norm of p times the norm of q.

    Returns
    -------
    array, shape (..., 4)
        x y z w.

    """
    p, q = np.asarray(p, float), np.asarray(q, float)
    px, py, pz, pw = (p[..., k] for k in range(4))
    qx, qy, qz, qw = (q[..., k] for k in range(4))
    product = np.empty(np.broadcast_shapes(p.shape, q.shape))
    product[..., 0] = pw * qx + px * qw + py * qz - pz * qy
    product[..., 1] = pw * qy + py * qw + pz * qx - px * qz
    product[..., 2] = pw * qz + pz * qw + px * qy - py * qx
    product[..., 3] = pw * qw - px * qx - py * qy - pz * qz
    return product


def conjugate(q: ArrayLike) -> Floats:
    """Return the inverses of unit quaternions x y z w, shape (..., 4)."""
    return np.asarray(q, float) * (-1.0, -1.0, -1.0, 1.0)


def normalize(q: ArrayLike) -> Floats:
    """Return `q / |q|` for nonzero vectors q, shape (..., n)."""
    q = np.asarray(q, float)
    # Scale q first, because the squares of small components, such as 1e-200, underflow.
    scaled = q / np.max(np.abs(q), axis=-1, keepdims=True)
    return scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)


def rotate(q: ArrayLike, vector: ArrayLike) -> Floats:
    """
    Rotate vectors from body axes to space axes.

    Parameters
    ----------
    q : array, shape (..., 4)
        x y z w, body to space, unit norm.
    vector : array, shape (..., 3)
        The vectors in body axes.

    Returns
    -------
    array, shape (..., 3), space axes

    """
    q, vector = np.asarray(q, float), np.asarray(vector, float)
    imaginary = q[..., :3]
    twice = 2.0 * _cross(imaginary, vector)
    return vector + q[..., 3:] * twice + _cross(imaginary, twice)


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the bits of `numpy.cross`, which takes twice as long for many vectors."""
    ax, ay, az = (a[..., k] for k in range(3))
    bx, by, bz = (b[..., k] for k in range(3))
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def matrix(q: ArrayLike) -> Floats:
    """
    Return the rotation matrices R of unit quaternions, shape (..., 3, 3).

    The matrices map body vectors to space vectors: `v_space = R v_body`.
    """
    columns = rotate(np.asarray(q, float)[..., None, :], np.eye(3))
    return np.swapaxes(columns, -1, -2)


def from_matrix(rotation: ArrayLike) -> Floats:
    """
    Return the quaternion of a rotation matrix.

    Each row of 4 q q^T is a multiple of the quaternion q. The function normalises the row with the
    largest diagonal entry, because no digits cancel in that row (Shepperd, "Quaternion from
    rotation matrix", 1978).

    Parameters
    ----------
    rotation : array, shape (3, 3)
        An orthogonal matrix with determinant 1.

    Returns
    -------
    array, shape (4,)
        x y z w, with either sign.

    """
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, float)
    rows = np.array([[1 + a - e - i, b + d, c + g, h - f],
                     [b + d, 1 - a + e - i, f + h, c - g],
                     [c + g, f + h, 1 - a - e + i, d - b],
                     [h - f, c - g, d - b, 1 + a + e + i]])
    return normalize(rows[np.argmax(np.diag(rows))])


def exp(rotation_vector: ArrayLike) -> Floats:
    """
    Return the quaternions of rotation vectors (axis times angle).

    Parameters
    ----------
    rotation_vector : array, shape (..., 3)
        The rotation vectors, rad. Their angles may exceed 2 pi. The quaternion is a continuous
        function of the angle: an angle of 2 pi gives (0, 0, 0, -1).

    Returns
    -------
    array, shape (..., 4)
        x y z w.

    """
    rotation_vector = np.asarray(rotation_vector, float)
    half = 0.5 * np.linalg.norm(rotation_vector, axis=-1, keepdims=True)
    sine, cosine = sines_cosines(half)
    sinc = np.divide(sine, half, out=np.ones_like(half), where=half > 0.0)
    imaginary = 0.5 * sinc * rotation_vector
    return np.concatenate([imaginary, cosine], axis=-1)


def log(q: ArrayLike) -> Floats:
    """
    Return the shortest rotation vectors of unit quaternions.

    Parameters
    ----------
    q : array, shape (..., 4)
        x y z w, unit norm. q and -q give the same vector, except for half turns, where they give
        opposite vectors.

    Returns
    -------
    array, shape (..., 3), rad
        Rotation vectors of length 0 to pi.

    """
    q = np.asarray(q, float)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * arctangents(sine, q[..., 3:])
    factor = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    return factor * q[..., :3]


def difference(p: ArrayLike, q: ArrayLike) -> Floats:
    """Return the rotation vector from one attitude to another, rad, in the body axes of `p`."""
    return log(multiply(conjugate(p), q))


def right_jacobian(rotation_vector: ArrayLike) -> Floats:
    """Return the matrix A, shape (3, 3), with exp(v + dv) = exp(v) exp(A dv) for a small dv."""
    v = np.asarray(rotation_vector, float)
    angle = float(np.linalg.norm(v))
    # Both factors of small angles are those of the series.
    one, two = (0.5 - angle ** 2 / 24.0, 1.0 / 6.0 - angle ** 2 / 120.0) if angle < 1e-2 else (
        (1.0 - np.cos(angle)) / angle ** 2, (angle - np.sin(angle)) / angle ** 3)
    cross = np.cross(v, np.eye(3)).T
    return np.eye(3) - one * cross + two * cross @ cross


def angle_between(p: ArrayLike, q: ArrayLike) -> Floats:
    """
    Return the angle of the rotation between two attitudes.

    The angle is computed from the chords `|p - q|` and `|p + q|`, which resolve even the smallest
    angles. A scalar product does not resolve angles below 3e-8 rad, and a quaternion product does
    not resolve angles below 1e-16 rad.

    Parameters
    ----------
    p, q : array, shape (..., 4)
        x y z w, unit norm.

    Returns
    -------
    array, shape (...), rad
        Angles from 0 to pi.

    """
    p, q = np.asarray(p, float), np.asarray(q, float)
    chord = np.linalg.norm(p - q, axis=-1)
    antipodal = np.linalg.norm(p + q, axis=-1)
    return np.asarray(4.0 * arctangents(np.minimum(chord, antipodal),
                                        np.maximum(chord, antipodal)))
