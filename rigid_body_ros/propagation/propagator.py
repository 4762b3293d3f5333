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

"""The motion under torques that arrive sample by sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
import operator
import time

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import duration_ns, instant, NEVER_NS
from rigid_body_ros.mechanics.actuator import Actuator, Actuators, time_constants
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.changes import checked_keep, RATE
from rigid_body_ros.mechanics.fields import beginning_at, Field, packed
from rigid_body_ros.mechanics.state import all_finite, State
from rigid_body_ros.mechanics.torque import FRAMES
from rigid_body_ros.mechanics.wheels import Wheel, Wheels
from rigid_body_ros.propagation.history import History, NewBody
from rigid_body_ros.propagation.options import Options
from rigid_body_ros.propagation.origin import with_rest
from rigid_body_ros.propagation.sources import COMMANDS, Sample, WHEELS
from rigid_body_ros.propagation.timeline import on_body
from rigid_body_ros.propagation.wheels import check_named, Commands, momenta_of, without_wheels


class Propagator:
    """
    The motion under torques that arrive sample by sample.

    Each torque and each change of the body commits the state at its stamp. This state is computed
    with the torque that acts before the stamp. A state between stamps is only a prediction; no
    later state depends on it. A torque that arrives less than `history` late is inserted in stamp
    order, and the later torques are applied again. If several torques of a source have the same
    stamp, the last one to arrive is used. As a result, the states at the stamps equal those that
    `propagate` computes from the whole log, bit for bit, whatever the order in which the torques
    of each source arrive.

    Parameters
    ----------
    wheels : sequence of Wheel, optional
        Named wheels, whose motor torques `apply_efforts` sets.
    history : float, s
        How late a torque may arrive. A torque is dropped if its stamp is older than the newest
        stamp by this time or more. States that are this old are discarded, too.
    body, start, fields, actuator, solver, tolerance, max_step, torque_timeout
        See `Problem`.

    Raises
    ------
    ValueError
        An option is out of its range, there are two gravity gradients, or the wheels do not fit
        the body or the start.

    """

    def __init__(self, body: RigidBody, start: State, *,
                 wheels: Sequence[Wheel] | None = None, fields: Sequence[Field] = (),
                 actuator: Actuators = None, solver: str = Options.solver,
                 tolerance: float = Options.tolerance, max_step: float | None = Options.max_step,
                 torque_timeout: float = Options.torque_timeout,
                 history: float = 1.0) -> None:
        self._options = Options(solver, tolerance, max_step, torque_timeout)
        #: The `history` in ns, at least 1.
        self.history_ns = max(1, duration_ns(history, 'history'))
        self._wheels = Wheels(wheels) if wheels else None
        self._options.check_terms(body.is_damped, bool(start._has_rotors or wheels), bool(fields),
                                  bool(self._wheels and self._wheels.is_coupled))
        self._start_ns = start.time_ns
        if self._wheels:
            check_named(self._wheels, None, fields)
        else:
            start = without_wheels(start)
        actuators = [actuator] if isinstance(actuator, Actuator) else [*(actuator or ())]
        self._actuator = actuator if any(actuators) else None
        self._longest_delay_ns = max((unit.delay_ns for unit in actuators if unit), default=0)
        self._time_constants = time_constants(actuators)
        self._history = History(body, start, self._options, self._time_constants, self._wheels,
                                packed(beginning_at(fields, start.time_ns)), self.history_ns)

    @property
    def earliest_ns(self) -> int:
        """Return the earliest time that `at` accepts."""
        return self._history.changes[0].time_ns

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp of all torques and bodies, ns; None before the first stamp."""
        return self._history.newest_ns

    def held(self, time_ns: int) -> Mapping[int, Sample]:
        """Return the latest sample of each source at a time, even a sample that has timed out."""
        return self._history.changes[max(self._history.index_of(time_ns), 0)].samples

    def delay_ns(self, source: int) -> int:
        """Return the delay between the stamp of a source's torque and its effect, ns."""
        actuator = self._actuator_of(source)
        return actuator.delay_ns if actuator else 0

    def _actuator_of(self, source: int) -> Actuator | None:
        """Return the actuator of a source, or None; raise ValueError for an unknown source."""
        actuators = self._actuator
        if source >= COMMANDS or actuators is None:
            return None
        if isinstance(actuators, Actuator):
            return actuators
        if source >= len(actuators):
            raise ValueError(f'source: expected a number from 0 to {len(actuators) - 1}, because '
                             f'there are {len(actuators)} actuators, found {source}')
        return actuators[source]

    def body_at(self, time_ns: int) -> NewBody:
        """Return the body at a given time. The first body has the stamp -NEVER_NS."""
        return self._history.changes[max(self._history.index_of(time_ns), 0)].body

    def bodies_since(self, time_ns: int) -> list[NewBody]:
        """Return the body at a time and all later bodies, except the first body of the motion."""
        index = max(self._history.index_of(time_ns), 0)
        bodies = dict.fromkeys(change.body for change in self._history.changes[index:])
        return [body for body in bodies if body.stamp_ns != -NEVER_NS]

    def stamps(self, after_ns: int, until_ns: int) -> list[int]:
        """
        Return the stamps of torques and bodies in (after_ns, until_ns], ascending, in ns.

        Stamps before `earliest_ns` have been discarded and are not returned.
        """
        delay_ns = self._longest_delay_ns
        changes = self._history.between(after_ns, until_ns + delay_ns)
        if not delay_ns:
            return [change.time_ns for change in changes]
        stamps_ns = {stamp_ns for change in changes for stamp_ns in change.stamps_ns}
        return sorted(stamp_ns for stamp_ns in stamps_ns if after_ns < stamp_ns <= until_ns)

    def samples_since(self, time_ns: int) -> list[tuple[int, Sample]]:
        """Return all torques in force at a given time or later, as pairs of source and sample."""
        index = max(self._history.index_of(time_ns), 0)
        return [*self._history.changes[index].samples.items(), *(
            (source, sample) for change in self._history.changes[index + 1:]
            for source, sample in change.samples.items()
            if sample.begins_ns == change.time_ns)]

    def commands_at(self, time_ns: int) -> Commands:
        """
        Return the wheel commands in force at a given time.

        A wheel without a command has the stamp -NEVER_NS.
        """
        return self._history.changes[max(self._history.index_of(time_ns), 0)].commands

    def commands_since(self, time_ns: int) -> list[tuple[int, dict[str, float]]]:
        """
        Return the wheel commands that are in force at `time_ns`, and all later ones.

        The result is sorted by stamp, ns. Each stamp comes with a mapping of wheel names to
        efforts, N m, in the form that `apply_efforts` accepts.
        """
        index, commands = max(self._history.index_of(time_ns), 0), dict[int, dict[str, float]]()
        for change in self._history.changes[index:]:
            for name, stamp_ns, effort in zip(self._wheels.names if self._wheels else (),
                                              *change.commands):
                if stamp_ns != -NEVER_NS:
                    commands.setdefault(stamp_ns, {})[name] = effort
        return sorted(commands.items())

    def apply(self, time_ns: int, torque: ArrayLike, frame: str = 'body',
              source: int = 0) -> bool:
        """
        Apply a torque from its stamp until the next stamp.

        Parameters
        ----------
        time_ns : int
            The stamp, ns. Stamps may arrive in any order. A torque with a stamp before the start
            acts from the start until the next stamp.
        torque : array, shape (3,), N m
            The torque about the centre of mass.
        frame : str
            The axes of the torque, 'body' or 'space'.
        source : int
            The number of the source. The torques of different sources add up. Each source holds
            its last torque and times out independently of the other sources.

        Returns
        -------
        bool
            False if the torque was dropped because it is older than the newest stamp by `history`
            or more.

        Raises
        ------
        ValueError
            The torque is not finite; the frame is unknown; the source is negative, or there are
            actuators but none for this source; the time does not fit in int64 or lies 292 years or
            more from the start; the solver is 'exact' and the torque is not zero; or earlier
            torques accelerate the body beyond 1e9 rad/s. In each of these cases, the torque is not
            applied.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        values = self._checked_torque(time_ns, torque)
        if frame not in FRAMES:
            raise ValueError(f"frame: expected 'body' or 'space', found {frame!r}")
        if not 0 <= operator.index(source) < COMMANDS:
            raise ValueError(f'source: expected a number from 0 on, found {source}')
        return self._apply(time_ns, source, values, frame == 'space')

    def apply_wheels(self, time_ns: int, torque: ArrayLike) -> bool:
        """
        Apply a motor torque to the rotors, from its stamp until the next stamp.

        Parameters
        ----------
        time_ns : int
            See `apply`.
        torque : array, shape (3,), N m, body axes
            The torque on the rotors. The body feels the opposite torque.

        Returns
        -------
        bool
            See `apply`.

        Raises
        ------
        ValueError
            See `apply`; also if the solver does not handle rotors.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        values = self._checked_torque(time_ns, torque)
        self._options.check_terms(False, bool(values.any()))
        return self._apply(time_ns, WHEELS, values, False)

    def apply_body(self, time_ns: int, body: RigidBody, keep: str = RATE) -> bool:
        """
        Replace the body, from a stamp until the next change.

        Parameters
        ----------
        time_ns : int
            See `apply`. A body with a stamp before the start replaces the first body at the
            start.
        body : RigidBody
            The new body, with its damping.
        keep : str
            The quantity that the change does not affect, 'rate' or 'momentum'; see `BodyLog`.

        Returns
        -------
        bool
            See `apply`.

        Raises
        ------
        ValueError
            See `apply`; also if `keep` is neither 'rate' nor 'momentum', or if the solver does not
            handle damping.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        self._options.check_terms(body.is_damped, False)
        new = self._history.new_body(time_ns, body, checked_keep(keep))
        index = self._history.inserted(time_ns)
        if index is None:
            return False
        self._history.put(index, new)
        return True

    def apply_efforts(self, time_ns: int, efforts: Mapping[str, float]) -> bool:
        """
        Apply motor torques to named wheels.

        Each torque acts from its stamp until the next effort of the same wheel.

        Parameters
        ----------
        time_ns : int
            See `apply`.
        efforts : mapping of str to float, N m
            The efforts, keyed by wheel name. Wheels without an entry keep their efforts. If
            several efforts of a wheel have the same stamp, the last one to arrive is used.

        Returns
        -------
        bool
            See `apply`.

        Raises
        ------
        ValueError
            See `apply`; also if a name belongs to no wheel, or if there are no wheels.
        TypeError
            The time is not an integer.

        """
        time_ns = self._checked_time(time_ns)
        if not self._wheels:
            raise ValueError('efforts: expected named wheels, found none')
        row = self._wheels.row(efforts)
        index = self._history.inserted(time_ns) if efforts else None
        if index is None:
            return not efforts
        self._history.take(index, time_ns, row)
        return True

    def at(self, time_ns: int, within: float = math.inf) -> State:
        """
        Return the state at a time, computed with the torques known so far.

        Parameters
        ----------
        time_ns : int
            The time, ns, not before `earliest_ns`. After the newest stamp, the torque is held
            until it times out.
        within : float, s
            Limit on the computing time.

        Returns
        -------
        State

        Raises
        ------
        ValueError
            The time lies before `earliest_ns`, does not fit in int64 or lies 292 years or more
            from the start, or the torques accelerate the body beyond 1e9 rad/s.
        TypeError
            The time is not an integer.
        TimeoutError
            The computing time reached its limit. The next call continues the computation.

        """
        time_ns, until = self._checked_time(time_ns), time.monotonic() + within
        index = self._history.index_of(time_ns)
        if index < 0:
            raise ValueError(f'time_ns: expected {self.earliest_ns} ns or later, '
                             f'found {time_ns} ns')
        segment, axial = self._history.active(index, time_ns, until)
        state = segment.state_at(time_ns, until)
        if self._time_constants:
            state = with_rest(state, self._start_ns)
        if self._wheels and axial:
            return self._wheels.shown(state, axial, momenta_of(axial, state))
        return state

    def torque(self, state: State) -> Floats:
        """
        Return the total torque of all sources on the body at a state that `at` returned.

        Returns
        -------
        array, shape (3,), N m, body axes
            The torque as the actuators apply it. The torques on the rotors and the torques of
            fields are not included.

        """
        time_ns = state.time_ns
        index = max(self._history.index_of(time_ns), 0)
        segment, _ = self._history.active(index, time_ns, math.inf)
        torques = [(sample.applied, np.array([sample.in_space]))
                   for source, sample in sorted(self._history.changes[index].samples.items())
                   if source != WHEELS and not sample.is_over(time_ns, self._options.timeout_ns)]
        return on_body(torques, segment.others.lagging, np.array([time_ns]), state.attitude)[0]

    def _checked_torque(self, time_ns: int, torque: ArrayLike) -> Floats:
        values = np.array(torque, float).reshape(1, -1)
        numbers, = values.tolist()
        if len(numbers) != 3 or not all_finite(numbers):
            raise ValueError(f'torque at {time_ns} ns: expected 3 finite numbers, '
                             f'found {numbers}')
        if not self._options.record.takes_torque and values.any():
            raise ValueError(f'solver {self._options.solver!r} handles torque-free motion only, '
                             f'found a torque of {numbers} N m at {time_ns} ns')
        return values

    def _checked_time(self, time_ns: int) -> int:
        checked_ns = instant(time_ns)
        if abs(checked_ns - self._start_ns) >= NEVER_NS:
            raise ValueError('time_ns: expected a time within 292 years of the start '
                             f'({self._start_ns} ns), found {checked_ns} ns')
        return checked_ns

    def _apply(self, time_ns: int, source: int, torque: Floats, in_space: bool) -> bool:
        actuator, begins_ns, applied = None, time_ns, torque
        if self._actuator and (actuator := self._actuator_of(source)):
            begins_ns, applied = time_ns + actuator.delay_ns, actuator.limited(torque)
        index = self._history.inserted(time_ns, begins_ns - time_ns)
        if index is None:
            return False
        self._history.put(
            index, Sample(time_ns, torque, in_space, begins_ns, applied, actuator), source)
        return True
