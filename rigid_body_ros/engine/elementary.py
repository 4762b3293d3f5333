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

"""Elementary functions of arrays, which give exactly the same results on every machine."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels


def sines_cosines(angles: ArrayLike) -> tuple[Floats, Floats]:
    """
    Compute correctly rounded sines and cosines.

    The sine and the cosine are NaN if the angle is infinite or NaN.

    Parameters
    ----------
    angles : array, shape (...)
        The angles, rad.

    Returns
    -------
    sines, cosines : array, shape (...)

    """
    flat = np.array(angles, float, order='C')
    sines, cosines = np.empty(flat.shape), np.empty(flat.shape)
    kernels.fill_sines_cosines(flat.reshape(-1), sines.reshape(-1), cosines.reshape(-1))
    return sines, cosines


def arctangents(y: ArrayLike, x: ArrayLike) -> Floats:
    """
    Compute the correctly rounded polar angles of points (x, y); see `kernels.elementary`.

    Parameters
    ----------
    y, x : array, shape (...)
        The coordinates of the points, which are broadcast against each other.

    Returns
    -------
    array, shape (...), rad

    """
    points = np.array(np.broadcast_arrays(y, x), float)
    angles = np.empty(points.shape[1:])
    kernels.fill_arctangents(points.reshape(2, -1), angles.reshape(-1))
    return angles


def exponentials(x: ArrayLike) -> Floats:
    """Compute correctly rounded e^x for an array of any shape; see `kernels.elementary`."""
    flat = np.array(x, float, order='C')
    results = np.empty(flat.shape)
    kernels.fill_exponentials(flat.reshape(-1), results.reshape(-1))
    return results
