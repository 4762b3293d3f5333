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

"""Interpolate a motion between samples of attitude and angular velocity."""

from __future__ import annotations

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import so3


def between(first: tuple[Floats, Floats], last: tuple[Floats, Floats], spans: Floats,
            parts: Floats) -> tuple[Floats, Floats]:
    """
    Interpolate attitudes and angular velocities between pairs of samples.

    The rotation since the first sample of a pair is described by a rotation vector that is a cubic
    polynomial in time. The polynomial matches the given attitudes and angular velocities at both
    samples.

    Parameters
    ----------
    first, last : tuple of arrays, shapes (n, 4) and (n, 3)
        The first and last sample of each pair: attitudes x y z w, body to space, and angular
        velocities in body axes, rad/s.
    spans : array, shape (n,), s
        Time from the first to the last sample of each pair, greater than zero.
    parts : array, shape (n,)
        Where to interpolate, as a fraction of each span.

    Returns
    -------
    attitude : array, shape (n, 4)
    angular_velocity : array, shape (n, 3), rad/s, body axes

    """
    span, part = spans[:, None], parts[:, None]
    step = so3.difference(first[0], last[0])
    begin, end = first[1] * span, _vector_rate(step, last[1]) * span
    square, cube = part * part, part ** 3
    vector = (3 * square - 2 * cube) * step + (part - 2 * square + cube) * begin \
        + (cube - square) * end
    change = (6 * (part - square) * step + (1 - 4 * part + 3 * square) * begin
              + (3 * square - 2 * part) * end) / span
    return so3.multiply(first[0], so3.exp(vector)), _body_rate(vector, change)


def _vector_rate(vector: Floats, rate: Floats) -> Floats:
    """Convert angular velocities in body axes to the derivatives of rotation vectors."""
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    half = np.maximum(0.5 * angle, 1e-9)
    factor = np.where(angle < 1e-3, 1.0 / 12.0,
                      (1.0 - half / np.tan(half)) / np.maximum(angle, 1e-9) ** 2)
    cross = np.cross(vector, rate)
    return rate + 0.5 * cross + factor * np.cross(vector, cross)


def _body_rate(vector: Floats, change: Floats) -> Floats:
    """Convert the derivatives of rotation vectors to angular velocities in body axes."""
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    safe = np.maximum(angle, 1e-9)
    first = np.where(angle < 1e-3, 0.5, (1.0 - np.cos(angle)) / safe ** 2)
    second = np.where(angle < 1e-3, 1.0 / 6.0, (angle - np.sin(angle)) / safe ** 3)
    cross = np.cross(vector, change)
    return change - first * cross + second * np.cross(vector, cross)
