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

"""The motion at the requested times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.common.times import instant
from rigid_body_ros.engine import motion_layout
from rigid_body_ros.mechanics import euler, so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.propagation.crossings import Crossings, crossings, Function, maximum, Restart
from rigid_body_ros.propagation.models import at_limit, AtLimit, Model, SolverUsage
from rigid_body_ros.propagation.wheels import WheelTimeline

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


class Derivatives(NamedTuple):
    """
    The derivatives of a motion with respect to parameters of its problem.

    Attributes
    ----------
    names : tuple of str
        The components of the parameters, such as 'inertia.ixx', as `attitude_identify` names them.
    attitude : array, shape (m, 3, p), rad per unit of the parameter
        The derivatives of the attitude at m times, each as a rotation vector in body axes.
    angular_velocity : array, shape (m, 3, p), rad/s per unit of the parameter
        The derivatives of the angular velocity in body axes.

    """

    names: tuple[str, ...]
    attitude: Floats
    angular_velocity: Floats

    @property
    def both(self) -> Floats:
        """Return the derivatives of the attitude and the angular velocity, shape (m, 6, p)."""
        return np.concatenate([self.attitude, self.angular_velocity], axis=1)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    The motion at the requested times.

    Attributes
    ----------
    times_ns : array of int64, shape (m,)
    derivatives : Derivatives, optional
        Those that `propagate` was asked for.

    """

    times_ns: NDArray[np.int64]
    #: The motion, in the layout that `motion_layout` defines. The array may have more rows than
    #: there are times.
    _motion: Floats
    #: The parts of the motion, in order. A new part begins at each change of the body.
    _parts: tuple[SolverUsage, ...]
    #: The axial momenta of wheels that are coupled to the motion, N m s, and their efforts, N m,
    #: with one row for each time. None if there are no such wheels.
    _momenta: Floats | None = None
    derivatives: Derivatives | None = None
    #: Returns an `Integration` from the start of the motion on; None in a piece of a motion.
    _restart: Restart | None = None

    def __repr__(self) -> str:
        if not self.times_ns.size:
            return 'Trajectory(no states)'
        first_ns, last_ns = int(self.times_ns.min()), int(self.times_ns.max())
        states = '1 state' if self.times_ns.size == 1 else f'{self.times_ns.size} states'
        return (f'Trajectory({states} from {first_ns} ns on, '
                f'over {(last_ns - first_ns) / 1e9:g} s)')

    @property
    def body(self) -> RigidBody:
        """Return the body, or the first body if the body changes."""
        return self._parts[0].body

    @cached_property
    def attitude(self) -> Floats:
        """
        Quaternions x y z w, body to space, shape (m, 4).

        The quaternions change continuously from the start of the motion, so their sign never
        flips.
        """
        return motion_layout.attitude(self._motion)[:self.times_ns.size]

    @cached_property
    def angular_velocity(self) -> Floats:
        """Angular velocity, rad/s, body axes, shape (m, 3)."""
        return motion_layout.angular_velocity(self._motion)[:self.times_ns.size]

    @cached_property
    def rotation(self) -> Rotation:
        """Attitudes, body to space, as a SciPy Rotation, which normalises the quaternions."""
        # Import SciPy only here, because this takes as long as importing the rest of the package.
        from scipy.spatial.transform import Rotation
        return Rotation.from_quat(self.attitude)

    def euler_angles(self, sequence: str = 'ZXZ', continuous: bool = False) -> Floats:
        """
        Return Euler angles, rad, shape (m, 3).

        Parameters
        ----------
        sequence : str
            See `euler.to_quaternion`.
        continuous : bool
            Whether to remove jumps, as `euler.unwrap` does. Otherwise the angles are in the ranges
            of `euler.from_quaternion`.

        Raises
        ------
        ValueError
            The sequence does not name three axes in which neighbours differ, all in upper case or
            all in lower case.

        """
        angles = euler.from_quaternion(self.attitude, sequence)
        return euler.unwrap(angles, sequence) if continuous else angles

    def degenerate(self, sequence: str = 'ZXZ') -> NDArray[np.bool_]:
        """
        Return whether the Euler angles are degenerate at each time, shape (m,).

        See `euler.degenerate`.

        Raises
        ------
        ValueError
            The sequence does not name three axes in which neighbours differ, all in upper case or
            all in lower case.

        """
        return euler.degenerate(euler.from_quaternion(self.attitude, sequence), sequence)

    @cached_property
    def models(self) -> tuple[Model, ...]:
        """Return which solver computed each span of the motion, and why."""
        spans = list[Model]()
        for before, part in zip((None, *self._parts), self._parts):
            models = part.models()
            if before and before.body is part.body and spans[-1][::3] == models[0][::3]:
                models = (spans.pop()._replace(end_ns=models[0].end_ns), *models[1:])
            spans.extend(models)
        return tuple(spans)

    @cached_property
    def rotor_momentum(self) -> Floats:
        """
        Momentum of the rotors relative to the body, N m s, body axes, shape (m, 3).

        The momentum of the rotors includes that of named wheels.
        """
        def of_part(part: SolverUsage, rows: Any) -> Floats:
            momentum = part.timeline.momentum(self.times_ns[rows])[:, 0]
            if part.wheels:
                momentum = part.wheels.wheels.relative(
                    momentum, self._axial(part.wheels, rows), self.angular_velocity[rows])
            return momentum
        return self._by_part(of_part)

    @cached_property
    def wheel_speeds(self) -> Floats:
        """Speeds of named wheels relative to the body, rad/s, shape (m, wheels)."""
        return self._by_part(
            lambda part, rows: part.wheels.wheels.speeds(
                self._axial(part.wheels, rows), self.angular_velocity[rows])
            if part.wheels else np.empty((len(self.times_ns[rows]), 0)))

    def _axial(self, wheels: WheelTimeline, rows: Any) -> Floats:
        """Return the axial momenta of the wheels of a part, N m s, shape (n, wheels)."""
        if wheels.wheels.is_coupled:
            return self._coupled(rows)[:, :len(wheels.wheels)]
        return wheels.momenta(self.times_ns[rows])[:, 0]

    def _coupled(self, rows: Any) -> Floats:
        """Return the momenta of coupled wheels, N m s, followed by their efforts, N m."""
        assert self._momenta is not None
        return self._momenta[:self.times_ns.size][rows]

    @cached_property
    def wheel_efforts(self) -> Floats:
        """
        Motor torques on named wheels, N m, shape (m, wheels).

        At a jump, these are the torques after the jump.
        """
        def of_part(part: SolverUsage, rows: Any) -> Floats:
            if not part.wheels:
                return np.empty((len(self.times_ns[rows]), 0))
            commands, wheels = part.wheels.efforts(self.times_ns[rows]), part.wheels.wheels
            if not wheels.is_limited:
                return commands
            before = np.split(self._coupled(rows), 2, axis=1)[1]
            return wheels.applied(commands, before[:, :len(wheels)], self.wheel_speeds[rows])
        return self._by_part(of_part)

    @cached_property
    def at_limit(self) -> tuple[AtLimit, ...]:
        """Return when named wheels are at their largest speed although commands drive them."""
        return at_limit([part for part in self._parts if part.wheels])

    def crossings(self, function: Function, level: float = 0.0,
                  period: float = math.inf) -> Crossings:
        """
        Return when a function of the state crosses a level.

        The times do not depend on the times of this trajectory, except that the last of these
        times ends the search, which begins with the motion.

        Parameters
        ----------
        function : function
            Takes a `Trajectory` and returns a number for each of its times. The function must be
            as smooth as the motion. Where it jumps, or bends abruptly, times are rounded to a
            nanosecond or so. Features that pass while the body turns by much less than a radian
            and no torque changes may be missed.
        level : float
            The level. If the motion begins or ends at this level, it does not cross it there.
        period : float
            The period of a function that jumps by its period, such as 2 pi for Euler angles. The
            level is then that modulo the period.

        Raises
        ------
        ValueError
            The function does not return a finite number for each time, or is not smooth; the level
            is not finite, or the period not above 0; or this trajectory is a piece of a motion.

        """
        return crossings(self._whole, function, self._breaks_ns, level, period)

    def maximum(self, function: Function,
                from_ns: int | None = None) -> float:
        """
        Return the largest value of a function of the state, up to the last time.

        Parameters
        ----------
        function : function
            See `crossings`.
        from_ns : int, optional, ns
            When to begin; by default, at the start of the motion.

        Raises
        ------
        ValueError
            See `crossings`; also if `from_ns` is before the start or not before the last time.

        """
        breaks_ns = self._breaks_ns
        begin_ns = breaks_ns[0] if from_ns is None else instant(from_ns, 'from_ns')
        if not breaks_ns[0] <= begin_ns < breaks_ns[-1]:
            raise ValueError(f'from_ns: expected a time from the start ({breaks_ns[0]} ns) to '
                             f'before the last time ({breaks_ns[-1]} ns), found {begin_ns} ns')
        return maximum(self._whole, function, np.append(
            begin_ns, breaks_ns[breaks_ns > begin_ns]))

    @property
    def _breaks_ns(self) -> Ints:
        """Return the start, the end, and all times at which the motion is not smooth, ns."""
        begins_ns = [part.start_ns for part in self._parts]
        limits_ns = [time_ns for span in self.at_limit for time_ns in (span.begin_ns, span.end_ns)]
        times_ns = np.unique(np.concatenate([
            begins_ns, np.subtract(begins_ns, 1), limits_ns, np.add(limits_ns, 1),
            *(part.timeline.times_ns for part in self._parts), [self._parts[-1].end_ns],
        ]).astype(np.int64))
        return times_ns[(times_ns >= begins_ns[0]) & (times_ns <= self._parts[-1].end_ns)]

    @property
    def _whole(self) -> Restart:
        restart = self._restart
        if restart is None or restart().problem.start.time_ns != self._parts[0].start_ns:
            raise ValueError('trajectory: expected a whole motion, such as that of propagate, '
                             'found a piece of one')
        return restart

    @cached_property
    def angular_momentum_space(self) -> Floats:
        """Angular momentum in space axes, N m s, shape (m, 3), including the rotors."""
        momentum = self._by_part(
            lambda part, rows: part.body.angular_momentum(self.angular_velocity[rows]))
        if any(part.wheels or part.timeline.has_rotors for part in self._parts):
            momentum = momentum + self.rotor_momentum
        return so3.rotate(self.attitude, momentum)

    @cached_property
    def kinetic_energy(self) -> Floats:
        """Kinetic energy w . J w / 2 of the body without the rotors, in joules, shape (m,)."""
        return self._by_part(
            lambda part, rows: part.body.kinetic_energy(self.angular_velocity[rows]))

    def _by_part(self, value: Callable[[SolverUsage, Any], Floats]) -> Floats:
        """Return a quantity at all times, given a function that computes it for one part."""
        if len(self._parts) == 1:
            return value(self._parts[0], slice(None))
        begins_ns = [part.start_ns for part in self._parts[1:]]
        of_row = np.searchsorted(begins_ns, self.times_ns, 'right')
        values = [value(part, of_row == k) for k, part in enumerate(self._parts)]
        result = np.empty((self.times_ns.size, *values[0].shape[1:]))
        for k, rows in enumerate(values):
            result[of_row == k] = rows
        return result


def joined(times_ns: NDArray[np.int64], parts: Sequence[Trajectory]) -> Trajectory:
    """Join the parts of a motion, each of which covers the times in its own span."""
    motion = motion_layout.allocate(times_ns.size)
    begins_ns = [part._parts[0].start_ns for part in parts[1:]]
    of_row = np.searchsorted(begins_ns, times_ns, 'right')
    for k, part in enumerate(parts):
        motion_layout.attitude(motion)[of_row == k] = part.attitude
        motion_layout.angular_velocity(motion)[of_row == k] = part.angular_velocity
    momenta = None
    if found := [part._momenta for part in parts if part._momenta is not None]:
        momenta = np.empty((times_ns.size, found[0].shape[1]))
        for k, part in enumerate(parts):
            if part._momenta is not None:
                momenta[of_row == k] = part._momenta[:part.times_ns.size]
    return Trajectory(times_ns, motion, tuple(use for part in parts for use in part._parts),
                      momenta, _restart=parts[0]._restart)
