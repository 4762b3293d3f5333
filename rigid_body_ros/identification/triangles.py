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

"""QR decomposition of tall matrices without LAPACK, whose threads would slow down a fit."""

from __future__ import annotations

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.engine import kernels


def triangle(columns: Floats) -> Floats:
    """
    Return the triangular factor of the QR decomposition of a matrix.

    Parameters
    ----------
    columns : array, shape (n, m)
        The transpose of the matrix. This array is overwritten.

    Returns
    -------
    array, shape (n, n)
        An upper triangular matrix. Some rows are zero if m is less than n.

    """
    result = np.zeros((len(columns), len(columns)))
    kernels.fill_triangle(columns, result)
    return result
