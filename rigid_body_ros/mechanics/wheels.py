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
Named wheels, each driven by a motor about an axis that is fixed to the body.

Consider a wheel with axis a, axial inertia I and speed Omega relative to the body. Its axial
momentum is H = I (Omega + a . w), where w is the angular velocity of the body, and it changes
under the motor torque tau: dH/dt = tau. A body with wheels therefore moves like a different body,
here called the carrier, that has rotors instead of wheels. Its inertia is J' = J - sum of I a a^T.
The momentum of its rotors is the sum of H a, and the torque on these rotors is the sum of tau a
(Hughes, Spacecraft Attitude Dynamics, chapter 3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache, reduce
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.times import NEVER_NS
from rigid_body_ros.engine import MOST_WHEELS, state_layout
from rigid_body_ros.mechanics.body import FASTEST_DAMPING, RigidBody
from rigid_body_ros.mechanics.fields import direction
from rigid_body_ros.mechanics.state import State

#: The momentum of the unnamed rotors is the given rotor momentum minus the momentum of the wheels.
#: If this difference is at most this fraction of the sum of the two magnitudes, the difference
#: counts as zero.
_ROUNDED = 8.0 * np.finfo(float).eps
#: A wheel with at least this fraction of its largest speed is at its limit.
_AT_LIMIT = 1.0 - 1e-12


@dataclass(frozen=True, eq=False)
class Wheel:
    """
    A named wheel, which turns about an axis that is fixed to the body.

    Parameters
    ----------
    name : str
        Name of the wheel, which must not be empty.
    axis : array, shape (3,), body axes
        The axis about which the wheel turns, as a vector of any nonzero length.
    inertia : float, kg m^2
        The moment of inertia about the axis, greater than zero. The inertia of the body must
        include this moment.
    initial_speed : float, rad/s
        The speed relative to the body at the start of the motion.
    friction : float, N m s/rad
        The coefficient of viscous friction. The friction torque on the wheel is -`friction` times
        the wheel's speed relative to the body, and the body feels the opposite torque.
    max_torque : float, N m
        The limit to which torque commands are clipped, or 0 for no limit.
    max_speed : float, rad/s
        The limit on the speed relative to the body, or 0 for no limit. A command does not drive
        the wheel beyond this speed: at the limit, the motor gives what holds the speed, up to the
        command. If the motion of the body drives the wheel beyond the limit, such a command acts
        as zero until the wheel is slower.

    Raises
    ------
    ValueError
        The name is empty, the axis is zero, or a number is not finite or is out of its range.

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
        for name in ('friction', 'max_torque', 'max_speed'):
            if not 0.0 <= float(getattr(self, name)) < math.inf:
                raise ValueError(f'{name} of wheel {self.name!r}: expected zero or more, found '
                                 f'{getattr(self, name)}')


class Axial(NamedTuple):
    """
    The efforts and momenta of the wheels in a span from one command to the next.

    A timeout of the commands ends a span, too.
    """

    #: `since_ns` is the time at which this span begins, and `stamp_ns` is the stamp of the last
    #: command. Before the first command, this stamp is -NEVER_NS.
    since_ns: int
    stamp_ns: int
    #: The axial momenta H at the beginning of the span, N m s, and their low-order parts, shape
    #: (2, n). None if the wheels are coupled to the motion; H is then stored in each state.
    momenta: Floats | None
    #: The commands in force, clipped to the torque limits, N m, shape (n,).
    commanded: Floats
    #: Whether the commands have timed out.
    is_silent: bool = False

    @property
    def efforts(self) -> Floats:
        """Return the commands, or zeros if they have timed out, N m, shape (n,)."""
        return np.zeros(len(self.commanded)) if self.is_silent else self.commanded


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
    is_limited, is_coupled : bool
        Whether any wheel has a `max_speed`, and whether the momenta depend on the motion, because
        any wheel has a `max_speed` or friction.

    Raises
    ------
    ValueError
        Two wheels have the same name, or there are more than `MOST_WHEELS` wheels and one of them
        has friction or a `max_speed`.

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
        self._friction = self._column('friction')
        self.is_coupled = self.is_limited or bool(self._friction.any())
        if self.is_coupled and len(self) > MOST_WHEELS:
            raise ValueError(f'wheels: expected at most {MOST_WHEELS} if one of them has '
                             f'friction or a max_speed, found {len(self)}')

    def __len__(self) -> int:
        return len(self.wheels)

    def _column(self, name: str) -> Floats:
        return np.array([getattr(wheel, name) for wheel in self.wheels], float)

    @cached_property
    def constants(self) -> Floats:
        """Return the constants that the kernels need; see `layout.Friction`."""
        inverse = [1 / Fraction(inertia) for inertia in self._inertia.tolist()]
        largest = np.where(np.isfinite(self._max_speed), self._max_speed, 0.0)
        rows = np.concatenate([self._axes.T, _pair(inverse), [self._friction, largest]])
        packed = self.padded(rows).reshape(len(rows), -1, 4).swapaxes(0, 1).ravel()
        packed.flags.writeable = False
        return packed

    def padded(self, rows: Floats) -> Floats:
        """Append zeros to rows of one number per wheel, up to a multiple of four numbers."""
        return np.ascontiguousarray(np.pad(rows, [(0, 0), (0, -len(self) % 4)]))

    # The exact sums take milliseconds, and one motion after another has the same carrier.
    @lru_cache(maxsize=16)  # noqa: B019
    def carrier(self, body: RigidBody) -> RigidBody:
        """
        Return the carrier, which is the body without the axial inertia of the wheels.

        Raises
        ------
        ValueError
            The axial inertia of the wheels leaves no valid inertia for the carrier, or the
            friction of the wheels is too strong for the carrier.

        """
        # Represent each entry as a sum of two doubles, so that no digits are lost when moments are
        # subtracted.
        exact = np.array([[_two_doubles(Fraction(entry) - axial) for entry, axial in zip(*rows)]
                          for rows in zip(body.inertia.tolist(), self._axial_inertia())])
        try:
            carrier = RigidBody(exact.astype(float), body.damping)
        except ValueError as error:
            raise ValueError('wheels: expected axial inertia that the body can have, found that '
                             f'the rest is impossible: {error}') from None
        carrier._set_exact(exact)
        rate = self.decay_rate(carrier)
        if rate > FASTEST_DAMPING:
            raise ValueError('wheels: expected friction whose quotients by the moments of inertia '
                             f'are at most {FASTEST_DAMPING:g} 1/s, found {rate:.6g} 1/s')
        return carrier

    def decay_rate(self, carrier: RigidBody) -> float:
        """Return an upper bound on the rate at which friction slows the wheels, 1/s."""
        return float((self._friction / self._inertia).max()
                     + self._friction.sum() / carrier.principal_moments[0])

    def _axial_inertia(self) -> list[list[Fraction]]:
        axes = [[Fraction(entry) for entry in axis] for axis in self._axes.tolist()]
        return [[sum((Fraction(inertia) * axis[i] * axis[j]
                      for inertia, axis in zip(self._inertia.tolist(), axes)), Fraction(0))
                 for j in range(3)] for i in range(3)]

    def clipped(self, efforts: Floats) -> Floats:
        """Clip commands, N m, shape (..., n), to the torque limits of the motors."""
        return np.clip(efforts, -self._max_torque, self._max_torque)

    def slowed(self, efforts: Floats, speeds: Floats) -> Floats:
        """Return the net torque on each wheel, motor torque plus friction, N m, shape (..., n)."""
        return efforts - self._friction * speeds

    def count_clipped(self, efforts: Floats) -> int:
        """Return how many commands exceed the torque limit of their motor; NaN does not count."""
        return int((np.abs(efforts) > self._max_torque).sum())

    def torque(self, efforts: Floats) -> Floats:
        """Return the total motor torque on the wheels in body axes, N m, shape (..., 3)."""
        return _sum_along(efforts, self._axes)

    def speeds(self, momenta: Floats, rates: Floats) -> Floats:
        """Compute wheel speeds, rad/s, shape (..., n), from axial momenta and body rates."""
        return momenta[..., :len(self)] / self._inertia - self._axial_rates(rates)

    def of_body(self, rates: Floats) -> Floats:
        """Return the momentum of wheels with zero speed: the sum of I a (a . w), N m s."""
        return _sum_along(self._inertia * self._axial_rates(rates), self._axes)

    def relative(self, rotors: Floats, momenta: Floats, rates: Floats) -> Floats:
        """
        Return the momentum of all rotors relative to the body, N m s, body axes, shape (..., 3).

        Parameters
        ----------
        rotors : array, shape (..., 3), N m s, body axes
            The rotor momentum of the carrier; see `begun`.
        momenta : array, shape (..., n), N m s
            The axial momenta.
        rates : array, shape (..., 3), rad/s, body axes
            The angular velocity of the body.

        """
        if self.is_coupled:
            rotors = rotors + self.torque(momenta)
        return rotors - self.of_body(rates)

    def _axial_rates(self, rates: Floats) -> Floats:
        # Sum in a fixed order. In BLAS the order depends on the processor.
        return reduce(np.add, (rates[..., k:k + 1] * self._axes[:, k] for k in range(3)))

    def begun(self, start: State) -> tuple[State, Axial]:
        """
        Split the start of a motion into the state of the carrier and the state of the wheels.

        The rotor momentum of the returned state is the sum of H a plus the momentum of the unnamed
        rotors. If the wheels are coupled to the motion, it is the momentum of the unnamed rotors
        alone, and the packed state contains the momenta H.

        Raises
        ------
        ValueError
            The number of `wheel_speeds` in the start state is not zero and differs from the number
            of wheels.

        """
        of_start = start._axial
        if isinstance(of_start, Axial) and len(of_start.commanded) == len(self) and (
                (of_start.momenta is None) == self.is_coupled):
            return start, of_start
        speeds = start.wheel_speeds if len(start.wheel_speeds) else self._column('initial_speed')
        if len(speeds) != len(self):
            raise ValueError(f'start: expected the speeds of {len(self)} wheels, found '
                             f'{len(speeds)}')
        high, low = start._packed[:state_layout.SIZE].reshape(4, 4)[[0, 2], :3].tolist()
        rates = [Fraction(a) + Fraction(b) for a, b in zip(high, low)]
        others = [Fraction(value) for value in self.others(start).tolist()]
        exact = []
        for wheel, speed, axis in zip(self.wheels, speeds.tolist(), self._axes.tolist()):
            turn = sum((Fraction(a) * rate for a, rate in zip(axis, rates)), Fraction(speed))
            exact.append(Fraction(float(wheel.inertia)) * turn)
            if not self.is_coupled:
                others = [other + exact[-1] * Fraction(a) for other, a in zip(others, axis)]
        packed, momenta, none = start._packed, _pair(exact), np.zeros(len(self))
        if self.is_coupled:
            packed = packed.copy()
            state_layout.momenta(packed)[:, :len(self)] = momenta
        axial = Axial(start.time_ns, -NEVER_NS, None if self.is_coupled else momenta, none)
        return State._as_computed(start.time_ns, packed, None, _pair(others)), axial

    def others(self, start: State) -> Floats:
        """Return the momentum of the unnamed rotors, N m s, body axes, shape (3,)."""
        if not (len(start.wheel_speeds) and start.rotor_momentum.any()):
            return start.rotor_momentum
        momenta = start.wheel_speeds * self._inertia
        others = start.rotor_momentum - self.torque(momenta)
        size = np.abs(start.rotor_momentum) + _sum_along(np.abs(momenta), np.abs(self._axes))
        return np.where(np.abs(others) <= _ROUNDED * size, 0.0, others)

    def shown(self, state: State, axial: Axial, momenta: Floats) -> State:
        """
        Add the wheel speeds, wheel efforts and rotor momentum to a state of the carrier.

        The state is modified in place and returned.

        Parameters
        ----------
        state : State
            A state of the carrier.
        axial : Axial
            The efforts in force at the time of the state.
        momenta : array, shape (2, n), N m s
            The axial momenta at this time, and their low-order parts.

        """
        rates = state.angular_velocity
        speeds = self.speeds(momenta[0], rates)
        momentum = self.relative(state._rotors[0], momenta[0], rates)
        for array in (speeds, momentum):
            array.flags.writeable = False
        efforts = axial.efforts.copy()
        if self.is_limited:
            efforts = self.applied(efforts, state_layout.efforts(state._packed)[:len(self)],
                                   speeds)
        state.__dict__.update(wheel_speeds=speeds, wheel_efforts=efforts,
                              rotor_momentum=momentum, _axial=axial)
        return state

    def applied(self, commands: Floats, efforts: Floats, speeds: Floats) -> Floats:
        """
        Return the torques that the motors apply, N m, shape (..., n).

        Parameters
        ----------
        commands : array, shape (..., n), N m
            The commands in force, within the torque limits.
        efforts : array, shape (..., n), N m
            The torques just before, which matter for wheels at their largest speed.
        speeds : array, shape (..., n), rad/s
            The speeds of the wheels.

        """
        at_limit = (np.abs(speeds) >= _AT_LIMIT * self._max_speed) & (speeds * commands > 0.0)
        return np.where(at_limit, np.clip(efforts, np.minimum(commands, 0.0),
                                          np.maximum(commands, 0.0)), commands)

    def row(self, efforts: Mapping[str, float]) -> Floats:
        """
        Convert commands keyed by wheel name to an array, N m, shape (n,).

        The entries of wheels without a command are NaN.

        Raises
        ------
        ValueError
            A name belongs to no wheel, or an effort is not finite.

        """
        commands = np.full(len(self), np.nan)
        for name, effort in efforts.items():
            if name not in self.names:
                raise ValueError(f'efforts: expected names of wheels ({", ".join(self.names)}), '
                                 f'found {name!r}')
            if not math.isfinite(effort):
                raise ValueError(f'effort of wheel {name!r}: expected a finite number, found '
                                 f'{effort}')
            commands[self.names.index(name)] = effort
        return commands


def _sum_along(amounts: Floats, axes: Floats) -> Floats:
    # Sum in a fixed order; see `Wheels._axial_rates`.
    return reduce(np.add, (amounts[..., k:k + 1] * axis for k, axis in enumerate(axes)))


def _two_doubles(exact: Fraction) -> Fraction:
    high = Fraction(float(exact))
    return high + Fraction(float(exact - high))


def _pair(exact: Sequence[Fraction]) -> Floats:
    """Split exact numbers into doubles and their low-order parts, shape (2, n)."""
    high = [float(value) for value in exact]
    pair = np.array([high, [float(value - Fraction(rounded))
                            for value, rounded in zip(exact, high)]])
    pair.flags.writeable = False
    return pair
