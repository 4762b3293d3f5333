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

"""Put the page of a comparison together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.comparison.errors import Comparison, QUANTITIES
from rigid_body_ros.comparison.horizons import Horizon
from rigid_body_ros.comparison.summary import rows
from rigid_body_ros.propagation import Problem
from rigid_body_ros.report import moving_body, style
from rigid_body_ros.report.charts import Curves, Panel
from rigid_body_ros.report.page import Page
from rigid_body_ros.report.panels import error_panel, field_panels, SINCE_FIRST, torque_panels
from rigid_body_ros.scene import Scene


def page(comparison: Comparison, name: str, scene: Scene, command: str) -> Page:
    """
    Return the page of a comparison.

    Parameters
    ----------
    comparison : Comparison
        The comparison; a computed motion is shown.
    name : str
        Name of the recording.
    scene : Scene
        The scene of the motion.
    command : str
        The command line.

    """
    stamps_ns = np.unique(np.concatenate([errors.times_ns for errors in comparison.errors]))
    topics = ', '.join(errors.topic for errors in comparison.errors)
    motion = comparison.motion
    body = _body(motion, stamps_ns) if isinstance(motion, Problem) else None
    shown = [('moving body', 'the computed motion')] if body else []
    return Page(f'{name}: {topics}', [('recording', name), *rows(comparison), *shown],
                [*_panels(comparison, stamps_ns)], body, scene.warnings, scene=scene,
                command=command)


def _panels(comparison: Comparison, stamps_ns: NDArray[np.int64]) -> Iterator[Panel]:
    start_ns, end_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    for label, unit, attribute in QUANTITIES:
        for errors in comparison.of(attribute):
            yield error_panel(f'{errors.topic}: {label}, body axes', unit, errors.times_ns,
                              getattr(errors, attribute), start_ns)
    motion = comparison.motion
    if isinstance(motion, Problem):
        yield from torque_panels(motion.logs, start_ns, end_ns, motion.options.timeout_ns)
        yield from field_panels(motion, stamps_ns, start_ns)
    torque = comparison.residual_torque
    if torque:
        yield Panel('residual torque, body axes', 'N m', [Curves.thinned(
            torque.times_ns, torque.torques, style.TORQUES, start_ns)], SINCE_FIRST)
    horizons = sorted((horizon for horizon in comparison.horizons if len(horizon.angles)),
                      key=lambda horizon: horizon.seconds)
    if horizons:
        yield _horizon_panel(horizons)


def _horizon_panel(horizons: Sequence[Horizon]) -> Panel:
    seconds = np.array([horizon.seconds for horizon in horizons])
    errors = np.maximum([np.percentile(horizon.angles, [50.0, 95.0]) for horizon in horizons],
                        1e-16)
    names = 'median', '95 %'
    texts = [[f'{error:.3g} rad {horizon.seconds:g} s after a restart, in '
              f'{len(horizon.angles)} windows' for horizon, error in zip(horizons, column)]
             for column in errors.T]
    return Panel('attitude error after a restart', 'rad', [Curves(seconds, errors, errors, names)],
                 'time since the restart from the measurement (s)', 'loglog', texts=texts)


def _body(problem: Problem, stamps_ns: NDArray[np.int64]) -> dict[str, Any]:
    """Return the propagated motion at some of the measured stamps."""
    step = -(-len(stamps_ns) // moving_body.MOST)
    times_ns = np.union1d(stamps_ns[::step], stamps_ns[-1:])
    motion = problem.propagate(at=times_ns)
    torque = problem.torque(times_ns, motion.attitude)
    return moving_body.as_data(problem.body, times_ns, np.hstack([
        motion.attitude, motion.angular_velocity, torque, motion.rotor_momentum]))
