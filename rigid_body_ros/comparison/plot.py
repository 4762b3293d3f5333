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

"""Draw the errors of a comparison into a PNG file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rigid_body_ros.comparison.errors import QUANTITIES
from rigid_body_ros.comparison.result import Comparison
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report.style import FIELDS


def draw(path: str | Path, comparison: Comparison, name: str) -> None:
    """
    Draw the errors of a comparison over time into a PNG file.

    Parameters
    ----------
    path : str or Path
        The PNG file, with any suffix. An existing file is overwritten.
    comparison : Comparison
        The comparison. For each quantity, the figure shows the errors of the first sensor that
        measures it.
    name : str
        Name of the recording, for the title.

    Raises
    ------
    OSError
        The file cannot be written.

    """
    from rigid_body_ros.report import figures  # matplotlib is slow to import
    panels = [figures.Series(label, unit, errors.times_ns, getattr(errors, attribute))
              for label, unit, attribute in QUANTITIES
              for errors in comparison.of(attribute)[:1]]
    torque = comparison.residual_torque
    motion, others = comparison.motion, list[figures.Series]()
    logs, timeout_ns = (motion.logs, motion.options.timeout_ns) \
        if isinstance(motion, Problem) else ((), 0)
    if isinstance(motion, Problem) and motion.fields:
        times_ns = panels[0].times_ns
        others.append(figures.Series(FIELDS, 'N m', times_ns, motion.field_torque(
            times_ns, motion.propagate(at=times_ns).attitude)))
    if torque:
        others.append(figures.Series('residual torque', 'N m', torque.times_ns, torque.torques))
    horizons = {horizon.seconds: np.percentile(horizon.angles, [50.0, 95.0])
                for horizon in comparison.horizons if len(horizon.angles)}
    topics = ', '.join(errors.topic for errors in comparison.errors)
    figures.errors(path, panels, others, logs, horizons, f'{name}: {topics}', timeout_ns)
