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

"""How far a change in the last digit of the inputs moves a motion, whatever the solver."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros import so3
from rigid_body_ros.body import RigidBody, State
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.propagation.integration import propagate
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.torque import TorqueLog

#: How often each kind of change is tried.
_ROUNDS = 2


def last_digit_effect(body: RigidBody, start: State, log: TorqueLog | None = None, *,
                      at: ArrayLike,
                      torque_timeout: float = Options.torque_timeout) -> float:
    """
    Return how far a motion moves if its inputs change in the last digit.

    The function computes up to six changed motions: two with changes of the inertia, two of the
    torques, and two of inertia, torques and start. A change moves every entry by one unit in the
    last place, up or down at random; the random numbers are the same in every call. Zeros stay
    zero, and the tensor stays symmetric. The rounding error of the solver, `auto`, adds to the
    result. The function skips a change if its tensor is not that of a rigid body, or if the body
    then spins faster than 1e9 rad/s.

    Parameters
    ----------
    body, start, log, torque_timeout
        As for `propagate`.
    at : array of int, shape (m,), ns
        Times to compare at, at least one, in any order, none before the start.

    Returns
    -------
    float, rad
        The largest angle between the attitudes of the motion and those of a changed motion.

    Raises
    ------
    ValueError
        As for `propagate`.

    """
    log = TorqueLog([], []) if log is None else log
    attitude = propagate(body, start, log, at=at, torque_timeout=torque_timeout).attitude
    found = []
    for tensor, changed_start, changed_log in _changes(body, start, log):
        try:
            motion = propagate(RigidBody(tensor), changed_start, changed_log, at=at,
                               torque_timeout=torque_timeout)
        except ValueError:
            continue
        found.append(float(so3.angle_between(motion.attitude, attitude).max()))
    return max(found, default=0.0)


def _changes(body: RigidBody, start: State,
             log: TorqueLog) -> Iterator[tuple[Floats, State, TorqueLog]]:
    """Yield tensors, starts and torques, some or all of them changed."""
    random = np.random.default_rng(0)
    has_torque = bool(log.torques.any())
    for _ in range(_ROUNDS):
        yield _changed_tensor(body.inertia, random), start, log
        if has_torque:
            yield body.inertia, start, log.with_torques(_changed(log.torques, random))
        yield (_changed_tensor(body.inertia, random),
               State(start.time_ns, _changed(start.attitude, random),
                     _changed(start.angular_velocity, random)),
               log.with_torques(_changed(log.torques, random)) if has_torque else log)


def _changed_tensor(tensor: Floats, random: np.random.Generator) -> Floats:
    upper = np.triu(_changed(tensor, random))
    return upper + np.triu(upper, 1).T


def _changed(values: Floats, random: np.random.Generator) -> Floats:
    # By one unit in the last place; zeros stay.
    target = np.where(random.random(values.shape) < 0.5, -np.inf, np.inf)
    return np.where(values == 0.0, values, np.nextafter(values, target))
