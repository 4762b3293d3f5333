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

"""Compare a measured motion with a propagated or recorded motion."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import duration_ns
from rigid_body_ros.comparison.causes import find_causes
from rigid_body_ros.comparison.channels import channels_of
from rigid_body_ros.comparison.horizons import horizon, usual_horizons
from rigid_body_ros.comparison.motion import Motion, Recorded
from rigid_body_ros.comparison.predictable import predictable_s
from rigid_body_ros.comparison.result import compared, Comparison
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.runtime.terminal import no_progress, Track
from rigid_body_ros.sensing.residual_torque import residual_torque


def compare(body: RigidBody, start: State, log: TorqueLog | Sequence[TorqueLog] | None = None, *,
            measured: Measured | Sequence[Measured], align: Collection[str] = (),
            horizons: Sequence[float] | None = (), causes: bool = True,
            **others: Any) -> Comparison:
    """
    Compare a measured motion with the motion computed from torques.

    The motion is computed exactly at the stamps of the measurements, so nothing is interpolated.

    Parameters
    ----------
    body, start, log
        The body, the initial state and the torques, as for `Problem`.
    measured : Measured or sequence of Measured
        The measurements of one or more sensors.
    align : collection of str
        What to fit before the comparison. 'start' fits the initial attitude and angular velocity.
        'clock' fits a constant clock offset for each sensor, up to 10 s. 'mount' fits a constant
        rotation between the axes of each sensor and the body axes, and another between the space
        axes of the measurements and the space axes of the motion. Use 'clock@TOPIC' or
        'mount@TOPIC' to fit a single sensor. If 'mount' applies to a sensor with attitudes,
        'start' fits only the angular velocity, because rotating the space axes has the same effect
        as changing the initial attitude.
    horizons : sequence of float or None, s
        For each horizon, the motion is restarted from measured states at intervals of this length,
        and the error at the end of each interval is returned. If None, the horizons are 0.1, 1 and
        10 s, except those that are shorter than the time between two samples or longer than the
        measurement.
    causes : bool
        Whether to look for likely causes of the errors. The search computes about ten more
        motions.
    others
        Other keyword arguments of `Problem`, such as the wheels or the solver options. `changes`
        is not allowed.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        No sample lies within the time span of the motion, or a name in `align` is unknown.
    ValueError
        `propagate` or `Measured.check` rejects an argument; a horizon is not positive; or
        `changes` are given.

    """
    sensors = [measured] if isinstance(measured, Measured) else measured
    for sensor in sensors:
        sensor.check()
    problem = Problem(body, start, log, **others)
    if problem.changes:
        raise ValueError(f'changes: expected a body that does not change, found '
                         f'{len(problem.changes)} changes, which only `propagate` computes')
    # Replace named wheels by rotors, because restarts set rotor momenta, not wheel speeds.
    return compare_motion(problem.carried(), sensors, align, horizons, causes)


def compare_motion(motion: Motion, measured: Sequence[Measured],
                   align: Collection[str] = (), horizons: Sequence[float] | None = (),
                   causes: bool = True, track: Track = no_progress) -> Comparison:
    """
    Compare measurements with a motion that is given as a problem or as a recorded motion.

    The comparison is the same as in `compare`. The function `track` shows the progress.
    """
    for seconds in horizons or ():
        if not duration_ns(seconds, 'horizons'):
            raise ValueError(f'horizons: expected positive seconds, found {seconds}')
    if horizons and isinstance(motion, Recorded):
        raise InputError('horizons: expected a model that can restart, found a recorded motion')
    comparison = compared(motion, measured, align)
    problem, aligned = comparison.motion, comparison.aligned
    if isinstance(problem, Problem):
        best = max(aligned, key=lambda sensor: (sensor.angular_velocity is not None, len(sensor)))
        comparison = replace(
            comparison, residual_torque=residual_torque(problem, best),
            horizons=tuple(horizon(problem, aligned, seconds, track) for seconds in (
                usual_horizons(aligned) if horizons is None else horizons)),
            predictable_s=predictable_s(problem, [*channels_of(comparison)]))
    return replace(comparison, causes=find_causes(motion, comparison, align, track)) \
        if causes else comparison
