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

"""Draw an identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rigid_body_ros.identification.experiment import Experiment
from rigid_body_ros.identification.result import Identification
from rigid_body_ros.report import figures
from rigid_body_ros.report.labels import literal


def draw(path: str | Path, found: Identification, experiment: Experiment, name: str) -> None:
    """
    Draw the errors of the first recording over time, with its torques, into a PNG file.

    Outliers are left out. The errors of the training come first, then those of the validation.

    Parameters
    ----------
    path : str or Path
        The PNG file, with any suffix; an existing file is overwritten.
    found : Identification
        The result.
    experiment : Experiment
        The first recording.
    name : str
        Its name, for the title.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    parts: dict[str, list[figures.Series]] = {}
    for one in found.residuals:
        if one.recording == 0 and one.inliers.any():
            quantity, unit = ('attitude', 'rad') if one.is_attitude else ('rate', 'rad/s')
            parts.setdefault(one.name, []).append(figures.Series(
                f'{literal(one.topic)}:\n{quantity} error', unit, one.stamps_ns[one.inliers],
                one.kept))
    panels = [figures.Series(each[0].label, each[0].unit,
                             np.concatenate([one.times_ns for one in each]),
                             np.concatenate([one.values for one in each]))
              for each in parts.values()]
    figures.errors(path, panels, None, experiment.logs, {}, name)
