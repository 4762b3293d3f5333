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

"""Measure how much a change in the last digit of the inputs affects a motion."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation.problem import Problem

#: Number of times that each kind of change is tried.
_ROUNDS = 2


def last_digit_effect(problem: Problem, at: ArrayLike) -> float:
    """
    Return how much a motion changes if its inputs change in the last digit.

    The function computes up to six changed motions: two with changed inertia and damping, two with
    changed torques, and two in which the inertia, the damping, the torques and the start all
    change. Every changed entry moves by one unit in the last place, up or down at random. The
    random numbers are the same in every call. Zeros stay zero, and tensors stay symmetric. A
    change is skipped if no rigid body can have the changed tensor, or if the body turns faster
    than 1e9 rad/s in the changed motion.

    All motions are computed by `auto` at its tightest tolerance, whatever solver the problem uses.
    The rounding error of `auto` adds to the result.

    Parameters
    ----------
    problem : Problem
        The body, the start and the torques.
    at : array of int, shape (m,), ns
        Times at which to compare, at least one, in any order, none before the start.

    Returns
    -------
    float, rad
        The largest angle between the attitudes of the motion and of a changed motion.

    Raises
    ------
    ValueError
        See `propagate`.

    """
    problem = problem.solved_by()
    attitude, random = problem.propagate(at=at).attitude, np.random.default_rng(0)
    kinds = [{'tensors'}, {'tensors', 'start'}]
    if problem.has_torque:
        kinds = [{'tensors'}, {'torques'}, {'tensors', 'start', 'torques'}]
    errors = []
    for kind in kinds * _ROUNDS:
        try:
            motion = _changed_problem(problem, kind, random).propagate(at=at)
        except ValueError:
            continue
        errors.append(float(so3.angle_between(motion.attitude, attitude).max()))
    return max(errors, default=0.0)


def _changed_problem(problem: Problem, kinds: Collection[str],
                     random: np.random.Generator) -> Problem:
    """
    Return a problem with the given kinds of inputs changed in the last digit.

    The function raises ValueError if a changed tensor is not valid.
    """
    start, logs, wheels = problem.start, problem.logs, problem.wheels
    inertia, damping = problem.body.inertia, problem.body.damping
    if 'tensors' in kinds:
        inertia = _changed_tensor(inertia, random)
        damping = _changed_tensor(damping, random) if damping.any() else damping
    if 'start' in kinds:
        start = _changed_start(start, random)
    if 'torques' in kinds:
        logs = tuple([_changed_log(log, random) for log in logs])
        wheels = wheels and _changed_log(wheels, random)
    # Build the body last, so that all random numbers of this change are drawn even if the body is
    # invalid. Otherwise, later changes would get different random numbers.
    return problem.replaced(body=RigidBody(inertia, damping), start=start, log=logs,
                            wheels=wheels)


def _changed_log(log: TorqueLog, random: np.random.Generator) -> TorqueLog:
    return log.with_torques(_changed(log.torques, random))


def _changed_start(start: State, random: np.random.Generator) -> State:
    attitude, rates = (_changed(start.attitude, random), _changed(start.angular_velocity, random))
    rotors = start.rotor_momentum
    return State(start.time_ns, attitude, rates,
                 _changed(rotors, random) if rotors.any() else rotors,
                 _changed(start.wheel_speeds, random))


def _changed_tensor(tensor: Floats, random: np.random.Generator) -> Floats:
    upper = np.triu(_changed(tensor, random))
    return upper + np.triu(upper, 1).T


def _changed(values: Floats, random: np.random.Generator) -> Floats:
    # Change all values except zeros by one unit in the last place.
    target = np.where(random.random(values.shape) < 0.5, -np.inf, np.inf)
    return np.where(values == 0.0, values, np.nextafter(values, target))
