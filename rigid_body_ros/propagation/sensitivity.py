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

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import torque_logs, TorqueLog
from rigid_body_ros.propagation.integration import propagate
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.trajectory import Trajectory

#: How often each kind of change is tried.
_ROUNDS = 2


def last_digit_effect(body: RigidBody, start: State,
                      log: TorqueLog | Sequence[TorqueLog] | None = None, *,
                      at: ArrayLike, wheels: TorqueLog | None = None,
                      torque_timeout: float = Options.torque_timeout) -> float:
    """
    Return how far a motion moves if its inputs change in the last digit.

    The function computes up to six changed motions: two with changes of inertia and damping, two
    of the torques, and two of all these and the start. A change moves every entry by one unit in
    the last place, up or down at random; the random numbers are the same in every call. Zeros stay
    zero, and the tensors stay symmetric. The rounding error of the solver, `auto`, adds to the
    result. The function skips a change if its tensor is not that of a rigid body, or if the body
    then spins faster than 1e9 rad/s.

    Parameters
    ----------
    body, start, log, wheels, torque_timeout
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
    inputs = _Inputs(body.inertia, body.damping, start, torque_logs(log), torque_logs(wheels))
    attitude = inputs.motion(at, torque_timeout).attitude
    found = []
    for changed in _changes(inputs):
        try:
            motion = changed.motion(at, torque_timeout)
        except ValueError:
            continue
        found.append(float(so3.angle_between(motion.attitude, attitude).max()))
    return max(found, default=0.0)


class _Inputs(NamedTuple):
    """The inputs of a motion."""

    inertia: Floats
    damping: Floats
    start: State
    logs: list[TorqueLog]
    #: The torque on the rotors, or nothing.
    wheels: list[TorqueLog]

    def motion(self, at: ArrayLike, torque_timeout: float) -> Trajectory:
        return propagate(RigidBody(self.inertia, self.damping), self.start, self.logs, at=at,
                         wheels=next(iter(self.wheels), None), torque_timeout=torque_timeout)


def _changes(inputs: _Inputs) -> Iterator[_Inputs]:
    """Yield the inputs with some or all of them changed."""
    random = np.random.default_rng(0)
    has_torque = any(log.torques.any() for log in (*inputs.logs, *inputs.wheels))
    for _ in range(_ROUNDS):
        yield _with_changed_tensors(inputs, random)
        if has_torque:
            yield _with_changed_torques(inputs, random)
        changed = _with_changed_tensors(inputs, random)
        changed = changed._replace(start=_changed_start(inputs.start, random))
        yield _with_changed_torques(changed, random) if has_torque else changed


def _with_changed_tensors(inputs: _Inputs, random: np.random.Generator) -> _Inputs:
    changed = inputs._replace(inertia=_changed_tensor(inputs.inertia, random))
    return changed._replace(damping=_changed_tensor(inputs.damping, random)) \
        if inputs.damping.any() else changed


def _with_changed_torques(inputs: _Inputs, random: np.random.Generator) -> _Inputs:
    def changed(logs: list[TorqueLog]) -> list[TorqueLog]:
        return [log.with_torques(_changed(log.torques, random)) for log in logs]
    return inputs._replace(logs=changed(inputs.logs), wheels=changed(inputs.wheels))


def _changed_start(start: State, random: np.random.Generator) -> State:
    attitude, rates = (_changed(start.attitude, random), _changed(start.angular_velocity, random))
    rotors = start.rotor_momentum
    return State(start.time_ns, attitude, rates,
                 _changed(rotors, random) if rotors.any() else rotors)


def _changed_tensor(tensor: Floats, random: np.random.Generator) -> Floats:
    upper = np.triu(_changed(tensor, random))
    return upper + np.triu(upper, 1).T


def _changed(values: Floats, random: np.random.Generator) -> Floats:
    # By one unit in the last place; zeros stay.
    target = np.where(random.random(values.shape) < 0.5, -np.inf, np.inf)
    return np.where(values == 0.0, values, np.nextafter(values, target))
