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

"""The inputs of a motion: a body, its start, its torques, and the solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.mechanics.actuator import Actuator, Actuators, actuators_of
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import BodyLog
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.fields import beginning_at, Field, packed
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import Logs, stamps_of, torque_logs, TorqueLog
from rigid_body_ros.mechanics.wheels import Wheel, Wheels
from rigid_body_ros.propagation.lags import LaggingSources
from rigid_body_ros.propagation.options import Options, validated
from rigid_body_ros.propagation.origin import rest_ns_of
from rigid_body_ros.propagation.timeline import on_body
from rigid_body_ros.propagation.wheels import check_named, without_wheels

#: A log of the torque on the rotors, or a sequence of named wheels.
Rotors = TorqueLog | Sequence[Wheel] | None
Same = TypeVar('Same', bound='MotionInputs')


class MotionInputs:
    """Everything that determines a motion; see `Problem`, which computes it."""

    #: The time at which lagging torques are zero; None if this time is the start.
    _rest_ns: int | None = None

    def __init__(self, body: RigidBody, start: State, log: Logs = None, *,
                 wheels: Rotors = None, efforts: EffortLog | None = None,
                 fields: Sequence[Field] = (),
                 changes: BodyLog | None = None, actuator: Actuators = None,
                 solver: str = Options.solver, tolerance: float = Options.tolerance,
                 max_step: float | None = Options.max_step,
                 torque_timeout: float = Options.torque_timeout) -> None:
        self.fields: tuple[Field, ...] = ()
        #: The fields in the form that the kernels need; None if there are no fields.
        self._fields: NDArray[Any] | None = None
        if fields:
            self.fields = beginning_at(fields, start.time_ns)
            self._fields = packed(self.fields)
        self.changes, self.efforts = changes or None, efforts or None
        self.named_wheels: Wheels | None = None
        #: The argument as given: one actuator for all logs, or one actuator for each log.
        self._actuator = actuator
        self._set(body, start, log, wheels,
                  validated(solver, tolerance, max_step, torque_timeout))

    def _set(self, body: RigidBody, start: State, log: Logs, wheels: Rotors,
             options: Options) -> None:
        self.body, self.start, self.options = body, start, options
        self.wheels: TorqueLog | None = None
        self.actuators: tuple[Actuator | None, ...] = ()
        sources = torque_logs(log)
        self.logs = self.acting_logs = tuple([source for source in sources if len(source)])
        if self._actuator and sources:
            self._set_actuators(sources)
        if isinstance(wheels, TorqueLog):
            self.wheels = wheels if len(wheels) else None
            if wheels.in_space.any():
                raise ValueError('wheels: expected torques in body axes, found torques in space '
                                 'axes')
        elif wheels:
            self.named_wheels = Wheels(wheels)
        if start._axial is not None and not self.named_wheels:
            self.start = without_wheels(start)
        if self.named_wheels or self.efforts:
            check_named(self.named_wheels, self.efforts, self.fields)
        is_damped = body.is_damped or (
            self.changes is not None and any(after.is_damped for after in self.changes.bodies))
        options.check_terms(is_damped, self.has_rotors, bool(self.fields), self.is_coupled)
        if not options.record.takes_torque:
            for source in self.sources:
                options.check_torque_free(source)

    def _set_actuators(self, sources: Sequence[TorqueLog]) -> None:
        actuators = actuators_of(self._actuator, len(sources))
        kept = tuple([actuator for actuator, log in zip(actuators, sources) if len(log)])
        if not isinstance(self._actuator, Actuator):
            self._actuator = kept
        if any(kept):
            self.actuators = kept
            self.acting_logs = tuple([actuator.acting(log) if actuator else log
                                      for actuator, log in zip(kept, self.logs)])

    def lagging(self) -> LaggingSources | None:
        """Return the sources that lag; None if no source lags."""
        if not self.actuators:
            return None
        return LaggingSources.of(self.acting_logs, self.actuators, self.options.timeout_ns,
                                 self._lags_from_ns)

    @property
    def _lags_from_ns(self) -> int:
        """Return the time at which lagging torques are zero, ns."""
        return rest_ns_of(self.start) if self._rest_ns is None else self._rest_ns

    @property
    def has_rotors(self) -> bool:
        """Return whether there are named wheels, rotors that turn, or torques on rotors."""
        return bool(self.start._has_rotors or self.named_wheels
                    or (self.wheels and self.wheels.torques.any()))

    @property
    def is_coupled(self) -> bool:
        """Return whether the momenta of named wheels depend on the motion; see `Wheels`."""
        return self.named_wheels is not None and self.named_wheels.is_coupled

    @property
    def has_torque(self) -> bool:
        """Return whether any torque is not zero, including torques on the rotors."""
        return any(log.torques.any() for log in self.sources) or bool(
            self.efforts and np.nan_to_num(self.efforts.efforts).any())

    @property
    def sources(self) -> tuple[TorqueLog, ...]:
        """Return the torques on the body, followed by the torque on the rotors if there is one."""
        return (*self.logs, self.wheels) if self.wheels else self.logs

    @property
    def acting_sources(self) -> tuple[TorqueLog, ...]:
        """Return `sources` with the actuator delays and limits applied, but without the lags."""
        return (*self.acting_logs, self.wheels) if self.wheels else self.acting_logs

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Return the distinct stamps of all torques, efforts and changes, ns, ascending."""
        stamps_ns = stamps_of(self.sources)
        for others in (self.changes, self.efforts):
            if others:
                stamps_ns = np.union1d(stamps_ns, others.times_ns)
        return stamps_ns

    def replaced(self: Same, *, body: RigidBody | None = None, start: State | None = None,
                 log: Logs = None, wheels: Rotors = None, efforts: EffortLog | None = None,
                 fields: Sequence[Field] | None = None,
                 changes: BodyLog | None = None, actuator: Actuators = None,
                 options: Options | None = None) -> Same:
        """Return this problem with some parts replaced; raise ValueError as `Problem` does."""
        other = type(self).__new__(type(self))
        other.fields, other._fields = self.fields, self._fields
        other.changes = changes or self.changes
        other.named_wheels = self.named_wheels
        other.efforts = (self.efforts if efforts is None else efforts) or None
        if isinstance(wheels, TorqueLog):  # rotors replace the named wheels
            other.named_wheels = other.efforts = None
        other._actuator = actuator or self._actuator
        other._rest_ns = self._rest_ns
        if self.actuators and start:
            other._rest_ns = min(self._lags_from_ns, start.time_ns)
        if fields is not None:
            other.fields = beginning_at(fields, self.start.time_ns)
            other._fields = packed(other.fields)
        other._set(body or self.body, start or self.start, self.logs if log is None else log,
                   self.wheels if wheels is None else wheels, options or self.options)
        return other

    def solved_by(self: Same, **options: Any) -> Same:
        """Return this problem with other `Options`, but with the same torque timeout."""
        return self.replaced(options=Options(torque_timeout=self.options.torque_timeout,
                                             **options))

    def between(self: Same, start: State, end_ns: int, memory_ns: int = 0) -> Same:
        """
        Return the problem from another start, with only the torques that matter until `end_ns`.

        Parameters
        ----------
        start : State
            The start of the returned problem.
        end_ns : int, ns
            Later torques are left out.
        memory_ns : int, ns
            Torques that act within this time before the start are kept, too.

        """
        begin_ns = start.time_ns - memory_ns
        reach_ns = [actuator.delay_ns + actuator.expiry_ns if actuator else 0
                    for actuator in self.actuators] or [0] * len(self.logs)
        return self.replaced(start=start,
                             log=[log.between(begin_ns - before_ns, end_ns)
                                  for log, before_ns in zip(self.logs, reach_ns)],
                             wheels=self.wheels and self.wheels.between(begin_ns, end_ns),
                             efforts=self.efforts and self.efforts.between(begin_ns, end_ns))

    def body_at(self, time_ns: int) -> RigidBody:
        """Return the body at a given time. At a change, this is the body after the change."""
        row = self.changes.in_force(time_ns) if self.changes else -1
        return self.changes.bodies[row] if self.changes and row >= 0 else self.body

    @property
    def next_change_ns(self) -> int:
        """Return the time of the first change of the body after the start, ns, or NEVER_NS."""
        return self.changes.next_ns(self.start.time_ns) if self.changes else NEVER_NS

    def with_first_body(self: Same) -> Same:
        """Return this problem without changes of the body: the body at the start remains."""
        other = self.replaced(body=self.body_at(self.start.time_ns))
        other.changes = None
        return other

    def torque(self, times_ns: NDArray[np.int64], attitude: Floats) -> Floats:
        """
        Return the torque on the body at given times.

        At a jump, this is the value after the jump.

        Parameters
        ----------
        times_ns : array of int, shape (m,), ns
            The times, in any order.
        attitude : array, shape (m, 4)
            The attitudes at these times, x y z w, used to convert torques in space axes to body
            axes.

        Returns
        -------
        array, shape (m, 3), N m, body axes
            The result includes the torque of the fields, but not the torque on the rotors.

        """
        total = on_body([log.at(times_ns, self.options.timeout_ns) for log in self.acting_logs],
                        self.lagging(), times_ns, attitude)
        return total + self.field_torque(times_ns, attitude) if self.fields else total

    def field_torque(self, times_ns: NDArray[np.int64], attitude: Floats) -> Floats:
        """Return the torque of the fields alone, N m, body axes, shape (m, 3); see `torque`."""
        total = np.zeros((len(times_ns), 3))
        bodies = (self.body, *(self.changes.bodies if self.changes else ()))
        in_force = self.changes.times_ns.searchsorted(times_ns, 'right') if self.changes \
            else np.zeros(len(times_ns), int)
        for k, body in enumerate(bodies):
            rows = np.flatnonzero(in_force == k)
            for field in self.fields:
                total[rows] += field.torque(body, times_ns[rows], attitude[rows])
        return total

    def biased(self: Same, torque: Floats, end_ns: int) -> Same:
        """
        Return this problem with an additional constant torque, N m, in body axes.

        The additional torque acts from the start at least until `end_ns`.
        """
        bias = TorqueLog.constant(torque, self.start.time_ns, end_ns, self.options.timeout_ns)
        actuator = [*(self.actuators or [None] * len(self.logs)), None] if self._actuator else None
        return self.replaced(log=[*self.logs, bias], actuator=actuator)
