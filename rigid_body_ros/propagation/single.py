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

"""Compute a motion under torque logs."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike
from rigid_body_ros.mechanics.actuator import Actuators
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import BodyLog
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import Logs
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.problem import Problem, Rotors
from rigid_body_ros.propagation.trajectory import Trajectory


def propagate(body: RigidBody, start: State, log: Logs = None, *, at: ArrayLike,
              wheels: Rotors = None, efforts: EffortLog | None = None,
              fields: Sequence[Field] = (), changes: BodyLog | None = None,
              actuator: Actuators = None,
              solver: str = Options.solver, tolerance: float = Options.tolerance,
              max_step: float | None = Options.max_step,
              torque_timeout: float = Options.torque_timeout) -> Trajectory:
    """
    Integrate Euler's equations under torque logs, and return the motion at given times.

    Parameters
    ----------
    at : array of int, shape (m,), ns
        The times, in any order, none before the start.
    body, start, log, wheels, efforts, fields, changes, actuator
        See `Problem`.
    solver, tolerance, max_step, torque_timeout
        See `Problem`.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError
        A time lies before the start or is not an integer that fits in int64, an option is out of
        its range, torques are given to the solver 'exact', or the torques accelerate the body
        beyond 1e9 rad/s.

    """
    return Problem(
        body, start, log, wheels=wheels, efforts=efforts, fields=fields, changes=changes,
        actuator=actuator, solver=solver, tolerance=tolerance, max_step=max_step,
        torque_timeout=torque_timeout).propagate(at=at)
