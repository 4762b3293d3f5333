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

"""Compute how percentiles of the angle from the nominal motion develop over time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.percentiles import percentiles
from rigid_body_ros.mechanics import so3

_PERCENTILES = (5, 25, 50, 75, 95)
#: Maximum number of points in time for which percentiles are computed. A picture needs no more.
_TIMES = 500
#: Maximum number of angles to hold in memory, at 8 bytes each. If an ensemble has more runs than
#: this, each pass through the motions covers only one point in time.
_KEPT = 2 ** 24


def bands(folder: Folder, nominal: Floats, runs: int) -> dict[str, Any]:
    """
    Return percentiles of the angle between the attitude of a run and the nominal attitude.

    Parameters
    ----------
    folder : Folder
        A folder that is complete and that keeps the motions of the runs.
    nominal : array, shape (m, 7)
        The nominal motion at the times of the folder.
    runs : int
        Number of runs that did not fail, at least one.

    Returns
    -------
    dict
        The percentiles as JSON types. 'times_s' contains some of the times of the folder,
        including the first and the last. For each percentile k, 'pk_rad' contains the percentile
        at each of these times.

    """
    assert folder.times is not None
    rows = np.unique(np.linspace(0, len(folder.times) - 1, _TIMES).astype(int))
    passes = math.ceil(len(rows) / max(_KEPT // runs, 1))
    found = np.concatenate([percentiles(_angles(folder, nominal, some, runs), _PERCENTILES)
                            for some in np.array_split(rows, passes)])
    return {'times_s': folder.times[rows].tolist(),
            **{f'p{k}_rad': column.tolist() for k, column in zip(_PERCENTILES, found.T)}}


def _angles(folder: Folder, nominal: Floats, rows: NDArray[np.int64], runs: int) -> Floats:
    """
    Return the angles from the nominal motion at some times, shape (times, runs).

    Only the runs that did not fail are included.
    """
    angles, end = np.empty((len(rows), runs)), 0
    for motions in folder.motions():
        attitudes = motions[np.isfinite(motions[:, 0, 0])][:, rows, :4]
        first, end = end, end + len(attitudes)
        angles[:, first:end] = so3.angle_between(attitudes, nominal[rows, :4]).T
    return angles
