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

"""
Wheels with names: each turns about an axis of the body, driven by a motor.

The torque of its motor changes the whole axial momentum H = I (Omega + a . w) of a wheel with the
axis a, the axial inertia I and the speed Omega relative to the body: dH/dt = tau. So a body with
wheels moves as one with the inertia J' = J - sum of I a a^T, here called the carrier, that has
rotors with the momentum sum of H a, on which the torque sum of tau a acts (Hughes, Spacecraft
Attitude Dynamics, chapter 3).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import instants, NEVER_NS
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import direction
from rigid_body_ros.mechanics.state import State

#: Momentum of rotors without a name, relative to that of the wheels, that is a rounding error.
_ROUNDED = 8.0 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class Wheel:
    """
    A wheel with a name, which turns about an axis of the body.

    Parameters
    ----------
    name : str
        Not empty.
    axis : array, shape (3,), body axes
        About which it turns; its length has no meaning.
    inertia : float, kg m^2
        About the axis, positive. The inertia of the body includes it.
    initial_speed : float, rad/s
        Relative to the body.
    friction : float, N m s/rad
        Only 0: a wheel without friction.
    max_torque : float, N m
        Of the motor; 0: no limit. A larger command is clipped.
    max_speed : float, rad/s
        Relative to the body; 0: no limit. A command that would speed up a wheel which is as fast
        or faster when the command takes effect acts as zero.

    Raises
    ------
    ValueError
        The name is empty, the axis is zero, a number is not finite or out of its range.

    """

    name: str
    axis: ArrayLike
    inertia: float
    initial_speed: float = 0.0
    friction: float = 0.0
    max_torque: float = 0.0
    max_speed: float = 0.0

    def __post_init__(self) -> None:
        if not self.name or not isinstance(self.name, str):
            raise ValueError(f'name of a wheel: expected a text, found {self.name!r}')
        object.__setattr__(self, 'axis', direction(self.axis, f'axis of wheel {self.name!r}'))
        if not 0.0 < float(self.inertia) < math.inf:
            raise ValueError(f'inertia of wheel {self.name!r}: expected kg m^2 greater than zero, '
                             f'found {self.inertia}')
        if not math.isfinite(self.initial_speed):
            raise ValueError(f'initial speed of wheel {self.name!r}: expected rad/s, found '
                             f'{self.initial_speed}')
        for name in ('max_torque', 'max_speed'):
            if not 0.0 <= float(getattr(self, name)) < math.inf:
                raise ValueError(f'{name} of wheel {self.name!r}: expected zero or more, found '
                                 f'{getattr(self, name)}')
        if self.friction != 0.0:
            raise ValueError(f'friction of wheel {self.name!r}: expected 0, because wheels with '
                             f'friction are not supported yet, found {self.friction}')


class EffortLog:
    """
    The commands of wheels with names: the torques of their motors, held.

    Before its first command a wheel has none. With a timeout, all commands end together: that long
    after the last of them, whichever wheel it was for.

    Parameters
    ----------
    times_ns : array of int, shape (n,), ns
        In any order. Of commands for one wheel with equal stamps, the later one in the array is
        used.
    efforts : array, shape (n, k), N m
        On k wheels, in their order. NaN: the wheel keeps its command.

    Attributes
    ----------
    times_ns : array of int64, shape (m,), ns
        Strictly ascending.
    efforts : array, shape (m, k), N m

    Raises
    ------
    ValueError
        The shapes do not match, a time is not an integer that fits int64, the times span 292 years
        or more, or an effort is infinite.

    """

    def __init__(self, times_ns: ArrayLike, efforts: ArrayLike) -> None:
        stamps_ns, values = instants(times_ns), np.array(efforts, float)
        if values.ndim != 2 or len(values) != stamps_ns.size:
            raise ValueError(f'efforts: expected shape ({stamps_ns.size}, wheels), found '
                             f'{values.shape}')
        if np.isinf(values).any():
            row = int(np.flatnonzero(np.isinf(values).any(axis=1))[0])
            raise ValueError(f'effort {row} at {stamps_ns[row]} ns: expected finite numbers, or '
                             f'NaN to keep a command, found {values[row].tolist()}')
        if stamps_ns.size and int(stamps_ns.max()) - int(stamps_ns.min()) >= NEVER_NS:
            raise ValueError('times_ns: expected times within 292 years of each other, found '
                             f'{stamps_ns.min()} ns and {stamps_ns.max()} ns')
        commands = ~np.isnan(values)
        found, rows = np.unique(stamps_ns[commands.any(axis=1)], return_inverse=True)
        values, commands = values[commands.any(axis=1)], commands[commands.any(axis=1)]
        merged = np.full((len(found), values.shape[1]), np.nan)
        for wheel in range(values.shape[1]):  # of repeated indices, numpy uses the last
            merged[rows[commands[:, wheel]], wheel] = values[commands[:, wheel], wheel]
        self.times_ns: NDArray[np.int64] = found
        self.efforts: Floats = merged
        self.times_ns.flags.writeable = self.efforts.flags.writeable = False

    def __len__(self) -> int:
        return len(self.times_ns)

    def __repr__(self) -> str:
        return f'EffortLog({len(self)} commands of {self.efforts.shape[1]} wheels)'

    def between(self, begin_ns: int, end_ns: int) -> EffortLog:
        """Return a log of the commands that are in force between two times, ns."""
        first = max(int(self.times_ns.searchsorted(begin_ns, 'right')) - 1, 0)
        stop = int(self.times_ns.searchsorted(end_ns, 'right'))
        begun = filled(self.efforts[:first + 1], np.full(self.efforts.shape[1], np.nan))[-1:]
        return EffortLog(self.times_ns[first:stop], np.concatenate(
            [begun, self.efforts[first + 1:stop]])[:max(stop - first, 0)])


def filled(rows: Floats, before: Floats) -> Floats:
    """Return rows, shape (n, m), with the last number of the same column in place of NaN."""
    if not np.isnan(rows).any():
        return rows
    rows = np.concatenate([before[None], rows])
    last = np.where(np.isnan(rows), 0, np.arange(len(rows))[:, None])
    return np.take_along_axis(rows, np.maximum.accumulate(last), axis=0)[1:]


class Axial(NamedTuple):
    """What the wheels do from a command on, up to the next one or its timeout."""

    #: ns; when it begins, and the stamp of the last command, -NEVER_NS before the first.
    since_ns: int
    stamp_ns: int
    #: N m s, shape (2, n): the axial momenta H where it begins, and their low-order parts.
    momenta: Floats
    #: N m, shape (n,): the commands in force, clipped, and what acts of them, but for a timeout.
    commanded: Floats
    acting: Floats
    #: Whether each command that takes effect here acts as zero, because the wheel is too fast.
    refused: NDArray[np.bool_]
    #: Whether the commands have timed out.
    is_silent: bool = False

    @property
    def efforts(self) -> Floats:
        """Return the torques that act, N m, shape (n,)."""
        return np.zeros(len(self.acting)) if self.is_silent else self.acting


class Wheels:
    """
    The wheels of a body.

    Parameters
    ----------
    wheels : sequence of Wheel
        At least one.

    Attributes
    ----------
    wheels : tuple of Wheel
    names : tuple of str
    is_limited : bool
        Whether a wheel has a largest speed.

    Raises
    ------
    ValueError
        Two wheels have the same name.

    """

    def __init__(self, wheels: Sequence[Wheel]) -> None:
        self.wheels = tuple(wheels)
        self.names = tuple(wheel.name for wheel in self.wheels)
        for number, name in enumerate(self.names):
            if name in self.names[:number]:
                raise ValueError(f'wheels: expected each name once, found {name!r} twice')
        self._axes: Floats = np.array([wheel.axis for wheel in self.wheels])
        self._inertia = self._column('inertia')
        self._max_torque, self._max_speed = self._column('max_torque'), self._column('max_speed')
        self._max_torque[self._max_torque == 0.0] = np.inf
        self._max_speed[self._max_speed == 0.0] = np.inf
        self.is_limited = bool(np.isfinite(self._max_speed).any())

    def __len__(self) -> int:
        return len(self.wheels)

    def _column(self, name: str) -> Floats:
        return np.array([getattr(wheel, name) for wheel in self.wheels], float)

    def carrier(self, body: RigidBody) -> RigidBody:
        """
        Return the body without the axial inertia of the wheels.

        Raises
        ------
        ValueError
            The wheels have more inertia than a body with this one can carry.

        """
        # As sums of two doubles: a difference of moments loses no digits.
        exact = np.array([[_two_doubles(Fraction(entry) - axial) for entry, axial in zip(*rows)]
                          for rows in zip(body.inertia.tolist(), self._axial_inertia())])
        try:
            carrier = RigidBody(exact.astype(float), body.damping)
        except ValueError as error:
            raise ValueError('wheels: expected axial inertia that the body can have, found that '
                             f'the rest is impossible: {error}') from None
        carrier._set_constants(exact)
        return carrier

    def _axial_inertia(self) -> list[list[Fraction]]:
        axes = [[Fraction(entry) for entry in axis] for axis in self._axes.tolist()]
        return [[sum((Fraction(inertia) * axis[i] * axis[j]
                      for inertia, axis in zip(self._inertia.tolist(), axes)), Fraction(0))
                 for j in range(3)] for i in range(3)]

    def clipped(self, efforts: Floats) -> Floats:
        """Return commands, N m, shape (..., n), within the limits of the motors."""
        return np.clip(efforts, -self._max_torque, self._max_torque)

    def count_clipped(self, efforts: Floats) -> int:
        """Return how many commands are beyond the limits of the motors; NaN does not count."""
        return int((np.abs(efforts) > self._max_torque).sum())

    def torque(self, efforts: Floats) -> Floats:
        """Return the torque of the motors on all wheels, N m, body axes, shape (..., 3)."""
        return _sum_along(efforts, self._axes)

    def speeds(self, momenta: Floats, rates: Floats) -> Floats:
        """Return speeds, rad/s, shape (m, n), from axial momenta (m, 2, n) and rates (m, 3)."""
        return momenta[:, 0] / self._inertia - self._axial_rates(rates)

    def of_body(self, rates: Floats) -> Floats:
        """Return the sum of I a (a . w), the momentum that wheels have as parts of the body."""
        return _sum_along(self._inertia * self._axial_rates(rates), self._axes)

    def _axial_rates(self, rates: Floats) -> Floats:
        # In BLAS the order of a sum depends on the processor.
        return reduce(np.add, (rates[..., k:k + 1] * self._axes[:, k] for k in range(3)))

    def refused(self, commands: Floats, speeds: Floats) -> NDArray[np.bool_]:
        """Return whether commands, shape (..., n), would speed up wheels that are too fast."""
        return np.asarray((np.abs(speeds) >= self._max_speed)
                          & (np.sign(commands) * np.sign(speeds) > 0.0))

    def begun(self, start: State) -> tuple[State, Axial]:
        """
        Return a start as the carrier has it, and what its wheels do.

        The momentum of the rotors of this start is that of the others, and the sum of H a.

        Raises
        ------
        ValueError
            The start has the speeds of another number of wheels.

        """
        found = start._axial
        if isinstance(found, Axial) and len(found.acting) == len(self):
            return start, found
        speeds = start.wheel_speeds if len(start.wheel_speeds) else self._column('initial_speed')
        if len(speeds) != len(self):
            raise ValueError(f'start: expected the speeds of {len(self)} wheels, found '
                             f'{len(speeds)}')
        high, low = start._packed.reshape(4, 4)[[0, 2], :3].tolist()
        rates = [Fraction(a) + Fraction(b) for a, b in zip(high, low)]
        others = [Fraction(value) for value in self.others(start).tolist()]
        exact = []
        for wheel, speed, axis in zip(self.wheels, speeds.tolist(), self._axes.tolist()):
            turn = sum((Fraction(a) * rate for a, rate in zip(axis, rates)), Fraction(speed))
            exact.append(Fraction(float(wheel.inertia)) * turn)
            others = [other + exact[-1] * Fraction(a) for other, a in zip(others, axis)]
        none = np.zeros(len(self))
        axial = Axial(start.time_ns, -NEVER_NS, _pair(exact), none, none, none > 0.0)
        return State._as_computed(start.time_ns, start._packed, None, _pair(others)), axial

    def others(self, start: State) -> Floats:
        """Return the momentum of the rotors without a name, N m s, body axes, shape (3,)."""
        if not (len(start.wheel_speeds) and start.rotor_momentum.any()):
            return start.rotor_momentum
        momenta = start.wheel_speeds * self._inertia
        others = start.rotor_momentum - self.torque(momenta)
        size = np.abs(start.rotor_momentum) + _sum_along(np.abs(momenta), np.abs(self._axes))
        return np.where(np.abs(others) <= _ROUNDED * size, 0.0, others)

    def shown(self, state: State, axial: Axial, momenta: Floats) -> State:
        """Return a state of the carrier with the speeds of the wheels, of momenta (2, n), too."""
        rates = state.angular_velocity
        speeds = self.speeds(momenta[None], rates[None])[0]
        momentum = state._rotors[0] - self.of_body(rates)
        for array in (speeds, momentum):
            array.flags.writeable = False
        state.__dict__.update(wheel_speeds=speeds, wheel_efforts=axial.efforts.copy(),
                              rotor_momentum=momentum, _axial=axial)
        return state

    def row(self, efforts: Mapping[str, float]) -> Floats:
        """
        Return commands by name as a row, N m, shape (n,), NaN for other wheels.

        Raises
        ------
        ValueError
            A name is not that of a wheel, or an effort is not finite.

        """
        found = np.full(len(self), np.nan)
        for name, effort in efforts.items():
            if name not in self.names:
                raise ValueError(f'efforts: expected names of wheels ({_listed(self.names)}), '
                                 f'found {name!r}')
            if not math.isfinite(effort):
                raise ValueError(f'effort of wheel {name!r}: expected a finite number, found '
                                 f'{effort}')
            found[self.names.index(name)] = effort
        return found


def _sum_along(amounts: Floats, axes: Floats) -> Floats:
    # In a fixed order, see `Wheels._axial_rates`.
    return reduce(np.add, (amounts[..., k:k + 1] * axis for k, axis in enumerate(axes)))


def _two_doubles(exact: Fraction) -> Fraction:
    high = Fraction(float(exact))
    return high + Fraction(float(exact - high))


def _pair(exact: Sequence[Fraction]) -> Floats:
    """Return numbers as doubles, and their low-order parts, shape (2, n)."""
    high = [float(value) for value in exact]
    pair = np.array([high, [float(value - Fraction(rounded))
                            for value, rounded in zip(exact, high)]])
    pair.flags.writeable = False
    return pair


def _listed(names: Collection[str]) -> str:
    return ', '.join(names)
