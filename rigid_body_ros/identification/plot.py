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

"""Plot the errors and torques of an identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rigid_body_ros.identification.experiment import Experiment
from rigid_body_ros.identification.result import Identification


def draw(path: str | Path, fit: Identification, experiment: Experiment, name: str) -> None:
    """
    Plot the errors and torques of the first recording over time, and save the plot as a PNG file.

    Outliers are left out. Each error plot shows the fitted samples, followed by the samples held
    back for validation.

    Parameters
    ----------
    path : str or Path
        The PNG file. The name can have any suffix. An existing file is overwritten.
    fit : Identification
        The result.
    experiment : Experiment
        The first recording.
    name : str
        Name of the first recording, used in the title.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    from rigid_body_ros.report import figures  # matplotlib is slow to load
    panels = []
    for parts in fit.first_errors():
        quantity, unit = ('attitude', 'rad') if parts[0].is_attitude else ('rate', 'rad/s')
        panels.append(figures.Series(f'{figures.literal(parts[0].topic)}:\n{quantity} error', unit,
                                     np.concatenate([part.kept_ns for part in parts]),
                                     np.concatenate([part.kept for part in parts])))
    figures.errors(path, panels, (), experiment.logs, {}, name)
