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

"""The parameters that the runs of an ensemble use, and bounds on how far their bodies turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math

import numpy as np
from rigid_body_ros.common.arrays import COLUMNS, Floats, Ints, ROWS, symmetric
from rigid_body_ros.engine import body_layout
from rigid_body_ros.engine.elementary import exponentials
from rigid_body_ros.ensemble.dispersions import ATTITUDE, INERTIA
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.bodies import RigidBodies
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.efforts import filled
from rigid_body_ros.mechanics.fields import Field
from rigid_body_ros.mechanics.states import States
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.scene.parts import values_of, with_values
from rigid_body_ros.scene.quantities import along, components_of

#: The entry, in the order of scene files, at each row and column of a symmetric tensor.
_PLACES = symmetric(np.arange(6)).astype(int)
#: The largest angle through which the body may turn in a run that is computed in steps, rad.
#: Propagating a motion takes about a microsecond per radian.
FARTHEST = 1e7
#: In every run, the body may turn by at least this many times the angle of the nominal run.
_TIMES_NOMINAL = 10.0
#: The torque noise is assumed to be at most this many standard deviations.
_NOISE = 5.0


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


@dataclass(frozen=True)
class Reach:
    """
    Upper bounds on the angles through which the bodies turn in the runs of an ensemble.

    A run whose body turns too far would take days to compute. The bounds make it possible to
    reject such a run before it starts.

    The bounds follow from the energy E of the body, which limits the body's angular speed. Torques
    can change sqrt(2 E) by at most the impulse of the torques divided by the square root of the
    smallest moment of inertia. Damping only lowers the energy, and the momentum of rotors does not
    change the energy. The energy that a field can add is limited by the potential of the field.
    The bounds depend only on the parameters of a run, not on the machine.

    Parameters
    ----------
    problem : Problem
        The nominal motion.
    end_ns : int, ns
        The end of every run.
    noise : float, N m
        Standard deviation of the noise in each component of the torque.
    nominal : Applied
        The parameters of the nominal run.

    """

    problem: Problem
    end_ns: int
    noise: float
    nominal: Applied

    def messages(self, applied: Applied) -> list[str]:
        """Return a message for each run whose body would turn too far, and '' for the others."""
        farthest = self._farthest
        text = 'the body may turn by {:.3g} rad, too far to be computed (limit {:.3g} rad): ' \
            'check the dispersions'
        return [text.format(turned, farthest) if farthest < turned < math.inf else ''
                for turned in self.turned(applied).tolist()]

    def turned(self, applied: Applied) -> Floats:
        """
        Return an upper bound on the angle through which the body turns in each run.

        The bound covers only those parts of a motion in which the solver chooses its steps.

        Returns
        -------
        array, shape (n,), rad
            The bound for each run. Computing a run takes about one step per radian. The bound is
            zero for motions in closed form and for fixed steps. The bound is not finite if a body,
            a state or a torque is impossible. Other functions report such impossible values.

        """
        impossible = [bool(body or start) for body, start in zip(applied.bodies.messages,
                                                                 applied.starts.messages)]
        with np.errstate(all='ignore'):
            turned = self._rates(applied) * self._seconds(applied)
            too_fast = _norm(applied.starts.angular_velocity) > FASTEST
        return np.where(impossible | too_fast, np.nan, turned)

    @cached_property
    def _farthest(self) -> float:
        """
        Return the largest angle through which a body may turn in a run, rad.

        This limit is larger than usual if the body turns far in the nominal run.
        """
        turned, = replace(self, noise=0.0).turned(self.nominal).tolist()
        return max(FARTHEST, _TIMES_NOMINAL * turned)

    def _rates(self, applied: Applied) -> Floats:
        """Return bounds on the rates that determine the number of steps, rad/s, shape (n,)."""
        moments = applied.bodies._constants[:, body_layout.MOMENTS:body_layout.MOMENTS + 3]
        least = moments.min(-1)
        rates = applied.starts.angular_velocity
        energy = (applied.bodies.inertia * rates[:, :, None] * rates[:, None]).sum((1, 2))
        span = self._span
        body, motors, largest, _ = self._of_logs
        late = largest * np.minimum(np.abs(applied.clock_offset), span)
        impulse = (np.abs(applied.torque_gain) * (body + late) + motors
                   + (_norm(applied.torque_bias) + _NOISE * self.noise) * span)
        terms = (_norm(applied.starts.rotor_momentum) + motors
                 + np.trace(applied.bodies.damping, axis1=1, axis2=2))
        return np.sqrt(energy / least) + (impulse + terms) / least \
            + [sum(field.speed(*moments) for field in fields)
               for fields, *moments in zip(applied.fields, least, moments.max(-1))]

    def _seconds(self, applied: Applied) -> Floats:
        """
        Return the duration of those parts of each motion in which the solver chooses its steps, s.

        The rest of the motion is computed in closed form or in fixed steps.
        """
        solver = self.problem.options.record
        if solver.fixed_step:
            return np.zeros(len(applied.runs))
        *_, acting = self._of_logs
        always = (applied.bodies.is_damped | applied.starts.has_rotors
                  | bool(self.problem.wheels or self.problem.named_wheels or self.problem.fields)
                  | applied.torque_bias.any(axis=1) | (solver.closed_form_beyond == math.inf))
        return np.where(always, self._span,
                        np.minimum(acting + np.abs(applied.clock_offset), self._span))

    @property
    def _span(self) -> float:
        """Return the duration of the motion, s."""
        return (self.end_ns - self.problem.start.time_ns) / 1e9

    @cached_property
    def _of_logs(self) -> tuple[float, float, float, float]:
        """
        Return bounds on the recorded torques, which are the same for all runs.

        Returns
        -------
        body, motors : float, N m s
            The total impulse of the torques on the body, and that of the torques on the rotors.
        largest : float, N m
            The largest torque on the body.
        acting : float, s
            The total time during which torques act on the body.

        """
        sources = list(self.problem.sources)
        if self.problem.named_wheels and self.problem.efforts:
            wheels, efforts = self.problem.named_wheels, self.problem.efforts
            sources.append(TorqueLog(efforts.times_ns, wheels.torque(
                filled(wheels.clipped(efforts.efforts), np.zeros(len(wheels))))))
        pieces = [self._pieces(log) for log in sources]
        on_body, on_rotors = pieces[:len(self.problem.logs)], pieces[len(self.problem.logs):]
        body, motors = (sum(float((strengths * spans).sum()) for strengths, spans in pieces)
                        for pieces in (on_body, on_rotors))
        return (body, motors, sum(float(strengths.max(initial=0.0)) for strengths, _ in on_body),
                sum(float(spans[(strengths > 0.0) | (self.noise > 0.0)].sum())
                    for strengths, spans in on_body))

    def _pieces(self, log: TorqueLog) -> tuple[Floats, Floats]:
        """
        Return two values for each interval between the samples of a log.

        The first value is an upper bound on the torque, in N m. The second is the duration, in s.
        """
        strengths = _norm(log.torques)
        if log.interpolation != 'hold':
            strengths = np.maximum(strengths, np.append(strengths[1:], 0.0))
        start_ns, longest = self.problem.start.time_ns, self.problem.options.torque_timeout
        ends = np.clip(np.append(log.times_ns, self.end_ns), start_ns, self.end_ns)
        return strengths, np.minimum(np.diff(ends) / 1e9, longest or math.inf)


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


def _norm(vectors: Floats) -> Floats:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))
