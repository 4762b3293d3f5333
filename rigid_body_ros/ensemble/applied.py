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

"""The parameter values and fields that the runs of an ensemble use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rigid_body_ros.common.arrays import COLUMNS, Floats, Ints, ROWS, symmetric
from rigid_body_ros.engine.elementary import exponentials
from rigid_body_ros.ensemble.dispersions import ATTITUDE, INERTIA
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.bodies import RigidBodies
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.states import States
from rigid_body_ros.propagation import Problem
from rigid_body_ros.scene.parts import values_of, with_values
from rigid_body_ros.scene.quantities import along, components_of

#: The entry, in the order of scene files, at each row and column of a symmetric tensor.
_PLACES = symmetric(np.arange(6)).astype(int)


@dataclass(frozen=True, eq=False)
class Applied:
    """
    The parameter values that n runs use.

    Attributes
    ----------
    runs : array of int, shape (n,)
        The run numbers.
    bodies : RigidBodies
        The body of each run.
    starts : States
        The initial state of each run.
    torque_gain : array, shape (n,)
        The factor that multiplies the torque in each run.
    torque_bias : array, shape (n, 3), N m, body axes
        The constant torque that is added in each run.
    clock_offset : array, shape (n,), s
        The time that is added to the torque stamps in each run, rounded to whole nanoseconds.
    fields : sequence of n tuples of Field
        The fields of each run. If the values drawn for a run are impossible, the nominal fields
        take the place of the run's fields.
    messages : sequence of n str
        For each run, a message that explains why the fields of the run are impossible. The message
        is empty if the fields are possible.
    field_values : dict
        The values that define the fields, as columns of shape (n,), by key.

    """

    runs: Ints
    bodies: RigidBodies
    starts: States
    torque_gain: Floats
    torque_bias: Floats
    clock_offset: Floats
    fields: Sequence[tuple[Field, ...]]
    messages: Sequence[str]
    field_values: Mapping[str, Floats]

    @classmethod
    def nominal(cls, problem: Problem) -> Applied:
        """Return the parameters of a single run, without any dispersion."""
        body, start = problem.body, problem.start
        return cls(np.zeros(1, np.int64), RigidBodies([body.inertia], body.damping),
                   States(start.time_ns, start.attitude, start.angular_velocity,
                          start.rotor_momentum), np.ones(1), np.zeros((1, 3)), np.zeros(1),
                   *_fields(problem.fields, {}, 1))

    @classmethod
    def with_values(cls, problem: Problem, runs: Ints, values: Mapping[str, Floats],
                    of_fields: Sequence[str]) -> Applied:
        """
        Return the parameters of some runs of a problem.

        Parameters
        ----------
        problem : Problem
            The nominal motion.
        runs : array of int, shape (n,)
            The run numbers.
        values : mapping
            The value of each key of `columns`, shape (n,). If the inertia or the attitude as a
            whole varies, `values` also contains the numbers that were drawn for it, shape (n, 3).
        of_fields : list of str
            The keys of the values that replace those of the nominal fields.

        """
        inertia = _relative_inertia(problem.body, values[INERTIA]) if INERTIA in values \
            else _tensors(values, 'inertia')
        attitude = _stacked(values, along(ATTITUDE, 'xyzw'))
        if ATTITUDE in values:
            attitude = so3.multiply(attitude, so3.exp(values[ATTITUDE]))
        starts = States(np.full(len(runs), problem.start.time_ns), attitude,
                        _stacked(values, along('initial_angular_velocity')),
                        _stacked(values, along('initial_rotor_momentum')))
        return cls(runs, RigidBodies(inertia, _tensors(values, 'damping')), starts,
                   values['torque_gain'], _stacked(values, along('torque_bias')),
                   np.rint(values['clock_offset'] * 1e9) / 1e9,
                   *_fields(problem.fields, {key: values[key] for key in of_fields}, len(runs)))

    def columns(self) -> dict[str, Floats]:
        """Return the parameter values as columns of shape (n,), one column for each key."""
        return {**dict(zip(components_of('inertia'), self.bodies.inertia[:, ROWS, COLUMNS].T)),
                **dict(zip(components_of('damping'), self.bodies.damping[:, ROWS, COLUMNS].T)),
                **components('initial_attitude', self.starts.attitude),
                **components('initial_angular_velocity', self.starts.angular_velocity),
                **components('initial_rotor_momentum', self.starts.rotor_momentum),
                **components('torque_bias', self.torque_bias),
                'torque_gain': self.torque_gain, 'clock_offset': self.clock_offset,
                **self.field_values}


def _fields(nominal: tuple[Field, ...], values: Mapping[str, Floats], count: int
            ) -> tuple[list[tuple[Field, ...]], list[str], dict[str, Floats]]:
    """Return the last attributes of `Applied`; `values`, shape (count,), replace nominal ones."""
    columns = {key: np.full(count, value) for field in nominal
               for key, value in values_of(field).items()} | dict(values)
    fields, messages = [nominal] * count, [''] * count
    for row in range(count if values else 0):
        own = {key: float(column[row]) for key, column in values.items()}
        try:
            fields[row] = tuple([with_values(field, own) for field in nominal])
        except ValueError as error:
            messages[row] = str(error)
    return fields, messages, columns


def components(prefix: str, vectors: Floats) -> dict[str, Floats]:
    """Return the components of vectors, shape (n, 3 or 4), as columns with keys PREFIX.AXIS."""
    return dict(zip(along(prefix, 'xyzw'), vectors.T))


def _stacked(values: Mapping[str, Floats], keys: Sequence[str]) -> Floats:
    return np.stack([values[key] for key in keys], axis=-1)


def _tensors(values: Mapping[str, Floats], name: str) -> Floats:
    return _stacked(values, components_of(name)).take(_PLACES, axis=1)


def _relative_inertia(body: RigidBody, drawn: Floats) -> Floats:
    """
    Vary the principal moments of inertia of a body, without changing its principal axes.

    Along each principal axis, the second moment of the mass is multiplied by the exponential of a
    number in `drawn`, shape (n, 3). The results are never negative, so the moments of inertia
    always satisfy the triangle inequality.
    """
    moments = body.principal_moments
    second = np.maximum(0.5 * moments.sum() - moments, 0.0) * exponentials(drawn)
    varied = second.sum(axis=-1, keepdims=True) - second
    axes = body.principal_axes
    # Do not use BLAS here. Its order of summation depends on the processor, so the rounding errors
    # would be different on another processor.
    return (axes[:, None] * axes * varied[:, None, None]).sum(axis=-1)
