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

"""Apply the functions of `elementary` to every element of an array."""

from __future__ import annotations

from typing import Annotated

from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.kernels import elementary
from rigid_body_ros.kernels.jit import njit, WRITTEN


@njit
def fill_sines_cosines(angles: Annotated[Floats, 'n'], sines: Annotated[Floats, 'n', WRITTEN],
                       cosines: Annotated[Floats, 'n', WRITTEN]) -> None:
    """Compute the sines and cosines of angles with `elementary.sine_cosine`."""
    for row in range(len(angles)):
        sines[row], cosines[row] = elementary.sine_cosine(float(angles[row]))


@njit
def fill_arctangents(points: Annotated[Floats, '2 n'],
                     angles: Annotated[Floats, 'n', WRITTEN]) -> None:
    """
    Compute the polar angles of points with `elementary.arctangent`.

    The points are an array of shape (2, n), with y in the first row and x in the second.
    """
    for row in range(len(angles)):
        angles[row] = elementary.arctangent(float(points[0, row]), float(points[1, row]))


@njit
def fill_exponentials(x: Annotated[Floats, 'n'], results: Annotated[Floats, 'n', WRITTEN]) -> None:
    """Compute e^x for each x with `elementary.exponential`."""
    for row in range(len(x)):
        results[row] = elementary.exponential(float(x[row]))
