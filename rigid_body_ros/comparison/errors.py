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

"""The errors of a measured motion: what was measured minus what was computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats

#: The quantities that are compared. Each has a name, a unit, and an attribute of `Errors`.
QUANTITIES = ('attitude error', 'rad', 'rotation_vectors'), ('rate error', 'rad/s', 'rates')


@dataclass(frozen=True, eq=False)
class Errors:
    """
    The errors of one sensor after alignment: measured minus computed values.

    Attributes
    ----------
    topic : str
    times_ns : array of int64, shape (n,)
        The times of the measurements on the clock of the motion: their stamps plus the clock
        offset.
    rotation_vectors : array, shape (n, 3), rad, body axes, optional
        Rotations from the computed to the measured attitudes; None if the sensor does not measure
        attitudes.
    rates : array, shape (n, 3), rad/s, body axes, optional
        Errors of the angular velocity; None if the sensor does not measure angular velocities.

    """

    topic: str
    times_ns: NDArray[np.int64]
    rotation_vectors: Floats | None
    rates: Floats | None


def statistics(vectors: Floats | None, final: bool = False) -> dict[str, Any]:
    """
    Return statistics of the lengths of some vectors, and the rms value of each component.

    Parameters
    ----------
    vectors : array, shape (n, 3), optional
        The vectors. All statistics are None if this array is None or has no rows.
    final : bool
        Whether to include 'final', the length of the last vector.

    """
    names = ['rms', 'median', 'p95', 'max', *(['final'] if final else []), 'axes_rms']
    if vectors is None or not len(vectors):
        return dict.fromkeys(names)
    lengths = np.linalg.norm(vectors, axis=1)
    values = [float(np.sqrt(np.mean(lengths ** 2))), float(np.median(lengths)),
              float(np.percentile(lengths, 95.0)), float(lengths.max()),
              *([float(lengths[-1])] if final else []),
              np.sqrt(np.mean(vectors ** 2, axis=0)).tolist()]
    return dict(zip(names, values))
