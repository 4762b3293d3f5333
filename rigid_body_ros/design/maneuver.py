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

"""The maneuvers of a vehicle: motions within its limits, and the torques that cause them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem

#: The names of the limits. Those of a torque have a number for each axis, or each named wheel.
TORQUE, TORQUE_RATE, RATE, ANGLE, WHEEL_SPEED = LIMITS = (
    'torque', 'torque_rate', 'rate', 'angle', 'wheel_speed')
NO_LIMITS = dict.fromkeys(LIMITS, np.full(1, np.inf))
#: Number of waves whose sum is the angular velocity about each axis, and the range of their
#: shapes, from sines to triangles, which need a torque that jumps.
_WAVES, _SHAPES = 2, (0.02, 0.995)
#: The angular velocity rises from rest, and falls to rest, within this fraction of the time.
_RAMP = 0.05
#: Minimum number of samples of the torque in a period of a wave, and minimum number of periods.
_SAMPLES, _PERIODS = 8.0, 1.5
#: The amplitude of a maneuver is corrected at most so often, until its largest load is nearly 1.
_CORRECTIONS, _NEARLY = 8, 0.02
#: The limits are checked at this many times in each sample of the torque. If a limit is exceeded,
#: the maneuver becomes smaller by the excess and this fraction.
FINE, _MARGIN = 20, 1e-6


@dataclass(frozen=True, eq=False)
class Maneuvers:
    """
    The maneuvers of a vehicle.

    A maneuver is described by its *motion*: the angular velocity at the beginning of each sample
    of the torque, and at the end, shape (n + 1, 3), rad/s, body axes. If no torque may act, this
    is the initial angular velocity alone, shape (1, 3).

    Attributes
    ----------
    problem : Problem
        The vehicle and its initial state, without torques.
    limits : dict of str to array, shape (k,)
        The limits, by name, as in `NO_LIMITS`: the torque about each body axis or of each named
        wheel, N m, its change per time, N m/s, and the magnitudes of the angular velocity, rad/s,
        of the angle from the initial attitude, rad, and of the speeds of wheels, rad/s. If the
        torque is zero, only the initial angular velocity can be chosen.
    seconds : float, s
        The duration.
    hz : float, Hz
        The sample rate of the torque.

    """

    problem: Problem
    limits: Mapping[str, Floats]
    seconds: float
    hz: float

    @property
    def is_free(self) -> bool:
        """Return whether no torque may act."""
        return not self.limits[TORQUE].any()

    @cached_property
    def times_ns(self) -> Ints:
        """Return the stamps of the torque, and the end, ns, shape (n + 1,)."""
        steps = np.arange(round(self.seconds * self.hz) + 1)
        return self.problem.start.time_ns + np.round(steps * (1e9 / self.hz)).astype(np.int64)

    @cached_property
    def _times(self) -> Floats:
        return np.asarray(1e-9 * (self.times_ns - self.times_ns[0]), np.float64)

    @cached_property
    def band(self) -> Floats:
        """
        Return the lowest and the highest frequency of the waves, Hz.

        At twice the frequency at which the torque begins to limit the motion more than its rate or
        angle, little of the motion is left.
        """
        fastest = self.limits[TORQUE].max() / self.problem.body.principal_moments.min()
        corner = max(fastest / self.limits[RATE][0], np.sqrt(fastest / self.limits[ANGLE][0]))
        low, high = _PERIODS / self.seconds, self.hz / _SAMPLES
        return np.array([low, max(2.0 * low, min(high, corner / np.pi or high))])

    @property
    def bounds(self) -> Floats:
        """
        Return the bounds of the numbers that `motion` takes, shape (n, 2).

        They are the amplitude, the logarithm of the frequency and the phase of each wave about
        each axis, and the shape of the waves about each axis, or the components of the initial
        angular velocity.
        """
        wave = [(0.0, 1.0), np.log(self.band), (0.0, 2.0 * np.pi)]
        return np.array([(-1.0, 1.0)] * 3 if self.is_free else 3 * _WAVES * wave + 3 * [_SHAPES])

    @cached_property
    def _initial_momentum(self) -> Floats:
        # In space axes; a motion of one row has no torques.
        at_rest = self.flown(np.zeros((1, 3)))
        return at_rest.propagate(at=self.times_ns[:1]).angular_momentum_space

    def motion(self, numbers: Floats) -> Floats:
        """Return the motion of a maneuver, scaled to the limits, but only nearly within them."""
        if self.is_free:
            return self._scaled(numbers[None])
        waves, shape = numbers[:-3].reshape(3, _WAVES, 3), numbers[-3:, None, None]
        size, frequency, phase = np.moveaxis(waves, 2, 0)[..., None]
        sines = np.sin(2.0 * np.pi * np.exp(frequency) * self._times + phase)
        rates = np.sum(size * np.arcsin(shape * sines) / np.arcsin(shape), axis=1).T
        return self._scaled(self._ramps(self._times, self.seconds) * rates)

    def _scaled(self, motion: Floats) -> Floats:
        for _ in range(_CORRECTIONS):
            largest = max(self.loads(self.flown(motion)).values())
            motion = motion / largest
            if abs(largest - 1.0) < _NEARLY:
                break
        return motion

    @staticmethod
    def _ramps(times: Floats, seconds: float) -> Floats:
        """Return a factor from 0 to 1, which vanishes smoothly at 0 and `seconds`, and outside."""
        share = times / seconds
        ramp = np.clip(np.minimum(share, 1.0 - share) / _RAMP, 0.0, 1.0).reshape(len(times), -1)
        return np.asarray(ramp ** 3 * (10.0 - 15.0 * ramp + 6.0 * ramp ** 2))

    def usual(self) -> Iterator[tuple[str, Floats]]:
        """
        Generate the names and motions of the usual maneuvers, in several bands.

        Doublets and chirps turn the body about one axis after another, and a multisine about all
        at once. Each axis is scaled to the limits alone, and then all together.
        """
        if self.is_free:
            yield from ((f'spin about {axis}', self._scaled(unit[None]))
                        for axis, unit in zip('xyz', np.eye(3)))
            return
        third = self.seconds / 3.0
        own = self._times[:, None] - third * np.arange(3)
        low = self.band[0]
        for top in np.geomspace(low, self.band[1], 5)[1:]:
            phase = max(2.0 * top, 4.0 / third) * (own - 0.5 * third)[..., None]
            doublet = np.maximum(0.0, 1.0 - np.abs(phase - [-1.0, 1.0])) @ [1.0, -1.0]
            chirp = self._ramps(own, third) * np.sin(
                2.0 * np.pi * own * (low + 0.5 * (top - low) / third * own))
            lines = np.arange(max(2, round(top * self.seconds) // 3))[:, None]
            phases = np.pi * lines ** 2 / len(lines)  # Schroeder's
            multisine = self._ramps(self._times, self.seconds) * np.cos(
                2.0 * np.pi / self.seconds * self._times[:, None, None]
                * (3 * lines + np.arange(1, 4)) - phases).sum(axis=1)
            for name, motion in (('doublet', doublet), ('multisine', multisine), ('chirp', chirp)):
                yield name, self._scaled(np.sum([self._scaled(axis * motion)
                                                 for axis in np.eye(3)], axis=0))

    def commands(self, motion: Floats) -> Floats:
        """
        Return the torques that make the body follow a motion, or the efforts of its named wheels.

        Each is the mean over its sample, N m, shape (n, 3) or (n, wheels).
        """
        problem, step, wheels = self.problem, 1.0 / self.hz, self.problem.named_wheels
        middle = 0.5 * (motion[1:] + motion[:-1])
        attitude = _joined(problem.start.attitude, so3.exp(step * middle))
        between = so3.multiply(attitude[:-1], so3.exp(0.5 * step * middle))
        others = problem.field_torque(self.times_ns[:-1], between) - middle @ problem.body.damping
        if not wheels:
            momenta = so3.rotate(attitude, motion @ problem.body.inertia
                                 + problem.start.rotor_momentum)
            return np.asarray(so3.rotate(so3.conjugate(between), np.diff(momenta, axis=0) / step)
                              - others)
        impulses = np.vstack([np.zeros(3), step * so3.rotate(between, others)])
        whole = self._initial_momentum + np.cumsum(impulses, axis=0)
        momenta = so3.rotate(so3.conjugate(attitude), whole) \
            - motion @ wheels.carrier(problem.body).inertia
        axes = wheels.torque(np.eye(len(wheels)))
        return np.asarray(np.diff(momenta, axis=0) / step @ np.linalg.pinv(axes))

    def flown(self, motion: Floats) -> Problem:
        """Return the vehicle with the torques, and the initial angular velocity, of a motion."""
        problem = self.problem.replaced(start=replace(self.problem.start,
                                                      angular_velocity=motion[0]))
        if len(motion) == 1:
            return problem
        commands = np.vstack([self.commands(motion), 0.0 * self.limits[TORQUE]])
        return problem.replaced(efforts=EffortLog(self.times_ns, commands)) \
            if problem.named_wheels else problem.replaced(log=TorqueLog(self.times_ns, commands))

    def loads(self, flown: Problem, fine: int = 1) -> dict[str, float]:
        """
        Return the largest value of each limited quantity of a flight, divided by its limit.

        With `fine` above 1, the motion is computed at so many times in each sample, and the loads
        hold for all instants: between two times, no quantity exceeds the larger of its values
        there by more than half of the largest change from one time to the next.
        """
        begin_ns, end_ns = self.times_ns[[0, -1]].tolist()
        times_ns = self.times_ns if fine == 1 else np.linspace(
            begin_ns, end_ns, fine * len(self.times_ns)).astype(np.int64)
        motion = flown.propagate(at=times_ns)
        found = {RATE: np.linalg.norm(motion.angular_velocity, axis=1)[:, None],
                 ANGLE: so3.angle_between(motion.attitude[:1], motion.attitude)[:, None],
                 WHEEL_SPEED: motion.wheel_speeds}
        if not self.is_free:
            held = commands_of(flown)
            found |= {TORQUE: held, TORQUE_RATE: self.hz * np.diff(
                held, axis=0, prepend=0.0 * held[:1])}
        loads = {}
        for name, values in found.items():
            is_bound = fine > 1 and not name.startswith(TORQUE)
            change = 0.5 * np.abs(np.diff(values, axis=0)).max(axis=0) if is_bound else 0.0
            loads[name] = float(((np.abs(values).max(axis=0) + change)
                                 / self.limits[name]).max(initial=0.0))
        return loads

    def held(self, motion: Floats, bodies: Sequence[RigidBody]) -> Problem:
        """Return the flight of a motion that is within the limits at all times with any body."""
        while True:
            flown = self.flown(motion)
            largest = max(max(self.loads(flown.replaced(body=body), FINE).values())
                          for body in bodies)
            if largest <= 1.0:
                return flown
            motion = motion / (largest * (1.0 + _MARGIN))


def commands_of(flown: Problem) -> Floats:
    """Return the torques of a flight, or the efforts of its named wheels, N m, shape (n, k)."""
    return flown.efforts.efforts if flown.efforts else flown.logs[0].torques


def _joined(start: Floats, turns: Floats) -> Floats:
    """Return the attitudes after each of several turns, and before the first, shape (n + 1, 4)."""
    reach = 1
    while reach < len(turns):  # products of 1, 2, 4 ... turns
        turns = np.concatenate([turns[:reach], so3.multiply(turns[:-reach], turns[reach:])])
        reach *= 2
    return so3.normalize(np.concatenate([start[None], so3.multiply(start, turns)]))
