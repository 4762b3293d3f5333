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

"""Percentiles over time of the angle from the nominal motion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.ensemble.folder import Folder
from rigid_body_ros.ensemble.percentiles import of_columns, of_rows
from rigid_body_ros.mechanics import so3

_PERCENTILES = (5, 25, 50, 75, 95)
#: Largest number of times, enough for a picture: the percentiles need 80 kB for each.
_TIMES = 500
#: Largest number of angles that are kept in memory, 8 bytes each.
_KEPT = 2 ** 24


def bands(folder: Folder, nominal: Floats) -> dict[str, Any]:
    """
    Return percentiles of the angle between the attitudes of the runs and the nominal one, as JSON.

    Parameters
    ----------
    folder : Folder
        Complete, with times; at least one run did not fail.
    nominal : array, shape (m, 7)
        The nominal motion at the times of the folder.

    Returns
    -------
    dict
        'times_s', some of the times of the folder, among them the first and the last; and for
        each percentile k 'pk_rad', of the same length.

    """
    assert folder.times is not None
    rows = np.unique(np.linspace(0, len(folder.times) - 1, _TIMES).astype(int))

    def angles() -> Iterator[tuple[int, Floats]]:
        for first, motions in folder.motions():
            with np.errstate(invalid='ignore'):  # failed runs
                yield first, np.asarray(
                    so3.angle_between(motions[:, rows, :4], nominal[rows, :4]))
    if len(rows) * folder.runs > _KEPT:
        found = of_columns(lambda: (chunk for _, chunk in angles()), _PERCENTILES, len(rows))
    else:
        kept = np.empty((len(rows), folder.runs))
        for first, chunk in angles():
            kept[:, first:first + len(chunk)] = chunk.T
        found = of_rows(kept, _PERCENTILES)
    return {'times_s': folder.times[rows].tolist(),
            **{f'p{k}_rad': column.tolist() for k, column in zip(_PERCENTILES, found)}}
