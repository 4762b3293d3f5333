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
Windows of a recording, and predictions of the measurements in them.

A sensor has a clock and axes of its own, and a gyro also a bias and a scale.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.motion import Motion, Recorded, span_of
from rigid_body_ros.inference.parameters import SPACE, split_topic
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.bodies import RigidBodies
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import Poses, States
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem, propagate_many
from rigid_body_ros.recording.measured import Measured

#: Lags shorter than this, s, are ignored.
_SHORTEST = 1e-6
Stamps = Sequence[NDArray[np.int64]]


@dataclass(frozen=True, eq=False)
class AxialInertia:
    """
    Axial inertia of the named wheels.

    A fit treats named wheels as rotors, so the fitted inertia does not include their axial
    inertia. At the start, the wheel speeds are known relative to the body. The axial momenta of
    the wheels therefore depend on the angular velocity of the body, which is fitted.

    Attributes
    ----------
    tensor : array, shape (3, 3), kg m^2
        The sum of I a a^T over the wheels, where I is the axial inertia and a is the axis.
    rate : array, shape (3,), rad/s
        A guess of the body's initial angular velocity. It is used to compute the rotor momentum in
        windows that begin later.
    start : State
        The initial state given by the user, with the wheel speeds.

    """

    tensor: Floats
    rate: Floats
    start: State


@dataclass(eq=False)
class Window:
    """
    A part of a recording, whose motion is computed from the state at its beginning.

    Attributes
    ----------
    experiment : int
        Index of the recording.
    is_first : bool
        Whether the window begins at the start of the recording.
    problem : Problem or Recorded
        The torques that act in the window, and the rotor momentum at its beginning. Each
        prediction replaces the body, attitude and angular velocity of this problem.
    channels : list of Measured
        The samples in the window.
    rows : list of slice
        Which samples of each channel of the recording are in the window.
    origin_ns : int
        The start of the recording. Clock drift is zero at this time.
    axial : array, shape (3, 3), kg m^2, optional
        Axial inertia of the named wheels, if the wheel speeds at the beginning of the window are
        known. The rotor momentum in `problem` is then relative to the rotating body.

    """

    experiment: int
    is_first: bool
    problem: Motion
    channels: list[Measured]
    rows: list[slice]
    origin_ns: int
    axial: Floats | None = None
    #: A cache of the torques: the gain, delay and lag of the latest prediction as bytes, and the
    #: problem with the torques that result from them.
    _applied: tuple[bytes, Problem] | None = field(init=False, default=None)
    #: A cache of the sample times: the times of all channels in the latest prediction, the indices
    #: of each channel's times in the union of all times, and the union itself.
    _times: tuple[Stamps, list[NDArray[np.intp]], NDArray[np.int64]] | None = field(
        init=False, default=None)

    @property
    def anchor_ns(self) -> int:
        """Return the beginning of the window, ns."""
        return self.problem.start.time_ns

    @property
    def has_state(self) -> bool:
        """Return whether the motion depends on the state at the beginning of the window."""
        return isinstance(self.problem, Problem)

    def predict(self, physics: Sequence[Physics], states: Poses) -> list[Floats]:
        """
        Return what each channel would contain if its sensor had no noise.

        Parameters
        ----------
        physics : sequence of Physics, length c
            The parameters to use for each prediction.
        states : Poses
            The c states at the beginning of the window.

        Returns
        -------
        list of array, shape (c, n, 4) or (c, n, 3)

        Raises
        ------
        ValueError
            `propagate` rejects the motion.

        """
        found = [np.empty((len(physics), len(channel), 4 if channel.is_attitude else 3))
                 for channel in self.channels]
        for which, rows, motions in self._motions(physics, states):
            for channel, values, here in zip(self.channels, found, rows):
                values[which] = motions[0 if channel.is_attitude else 1][:, here]
        space = space_axes(physics)
        return [_attitudes(values, mount, space) if channel.is_attitude
                else _rates(values, mount, physics, channel.topic)
                for channel, values, mount
                in zip(self.channels, found, mounts(physics, self.channels))]

    def state_at(self, physics: Physics, attitude: Floats, velocity: Floats,
                 time_ns: int) -> tuple[Floats, Floats]:
        """Propagate a state from the beginning of the window to a given time."""
        found = self._moved([self._acting(physics, time_ns)], [physics], Poses(
            attitude[None], velocity[None]), np.array([time_ns]))
        return found.attitude[0, 0], found.angular_velocity[0, 0]

    def _motions(self, physics: Sequence[Physics], states: Poses
                 ) -> Iterator[tuple[list[int], list[NDArray[np.intp]], Poses]]:
        """
        Generate the motions that have the same times, and can be computed together.

        The first two items are the indices of these motions, and where the samples of each channel
        lie in them.
        """
        instants = [self._instants(one) for one in physics]
        acting = [self._acting(one, int(times_ns[-1]))
                  for one, (_, times_ns) in zip(physics, instants)]
        groups: dict[tuple[int, bool], list[int]] = {}
        for i, (_, times_ns) in enumerate(instants):
            groups.setdefault((id(times_ns), bool(acting[i].actuators)), []).append(i)
        for which in groups.values():
            # Parameters of the sensors do not change the motion.
            keys = [(physics[i].of_motion(), *(each[i].tobytes() for each in states))
                    for i in which]
            own = dict(zip(keys, which))
            rows, times_ns = instants[which[0]]
            found = self._moved([acting[i] for i in own.values()],
                                [physics[i] for i in own.values()],
                                states.rows([*own.values()]), times_ns)
            places = dict(zip(own, range(len(own))))
            yield which, rows, found.rows([places[key] for key in keys])

    def _moved(self, problems: Sequence[Motion], physics: Sequence[Physics], states: Poses,
               times_ns: NDArray[np.int64]) -> Poses:
        """
        Return the motions of c problems at n times, each array of shape (c, n, 3 or 4).

        At times before the beginning of the window, a motion is at its initial state.
        """
        times_ns, problem = np.clip(times_ns, *span_of(self.problem)), problems[0]
        if isinstance(problem, Recorded):
            poses = problem.propagate(at=times_ns)
            return Poses(poses.attitude[None], poses.angular_velocity[None])
        momenta = np.array([one.value('rotor_momentum') for one in physics]) \
            + self.problem.start.rotor_momentum
        if self.axial is not None:
            momenta += states.angular_velocity @ self.axial
        fields = [one.acting(self.problem.fields) for one in physics]
        if len(problems) == 1 or problem.actuators or len({*map(len, fields)}) > 1:
            motions = [each.replaced(body=one.body, start=State(self.anchor_ns, *own),
                                     fields=field or None).propagate(at=times_ns)
                       for each, one, field, *own in zip(problems, physics, fields, *states,
                                                         momenta)]
            return Poses(*(np.array([getattr(one, name) for one in motions])
                           for name in Poses._fields))
        bodies = RigidBodies([one.inertia for one in physics], np.array(
            [one.damping for one in physics]))
        found = propagate_many(
            bodies, States(self.anchor_ns, *states, momenta), [each.logs for each in problems],
            at=times_ns, wheels=problem.wheels, fields=fields if fields[0] else (),
            **asdict(problem.options))
        if any(found.messages):
            raise ValueError(next(filter(None, found.messages)))
        return Poses(found.attitude, found.angular_velocity)

    def _instants(self, physics: Physics) -> tuple[list[NDArray[np.intp]], NDArray[np.int64]]:
        """
        Return where the samples of each channel lie in the union of all sample times.

        The first result holds the indices of each channel. The second is the union, ns.
        """
        stamps = [clocked(channel, physics, self.origin_ns) for channel in self.channels]
        if self._times is None or not all(map(np.array_equal, stamps, self._times[0])):
            union = np.unique(np.concatenate(stamps))
            self._times = stamps, [np.searchsorted(union, each) for each in stamps], union
        return self._times[1:]

    @property
    def size(self) -> int:
        """Return the total number of samples in all channels."""
        return sum(len(channel) for channel in self.channels)

    def _acting(self, physics: Physics, end_ns: int) -> Motion:
        """
        Return the problem of this window with the torques that act on the body.

        The torques include the torque bias, which acts until `end_ns`.
        """
        if isinstance(self.problem, Recorded):
            return self.problem
        key = b''.join(physics.value(name).tobytes() for name in (
            'torque_gain', 'torque_gains', 'torque_delay', 'torque_lag'))
        if not self._applied or key != self._applied[0]:
            self._applied = key, acted(self.problem, physics)
        problem, bias = self._applied[1], physics.value('torque_bias')
        return problem.biased(bias, end_ns) if bias.any() else problem


def acted(problem: Problem, physics: Physics) -> Problem:
    """
    Return a problem with the fitted gain, delay and lag of its actuators, but without the bias.

    The gain multiplies the torques after their limits, the delay adds to the delay of each source,
    and the lag to its time constant. If only the fitted lag acts, the returned problem starts at
    its first torque, because the lag remembers the torques before the start of a window.
    """
    gains = physics.number('torque_gain') * physics.value('torque_gains')
    delay_ns = round(physics.number('torque_delay') * 1e9)
    lag = physics.number('torque_lag')
    logs = [TorqueLog(log.times_ns + delay_ns, gains * log.torques, log.in_space,
                      log.interpolation) for log in problem.acting_logs]
    constants = [lag + (one.time_constant if one else 0.0)
                 for one in problem.actuators or [None] * len(logs)]
    if max(constants, default=0.0) <= _SHORTEST:
        return problem.replaced(log=logs)
    actuators = [Actuator(time_constant=one) if one > _SHORTEST else None for one in constants]
    if problem.actuators:
        return problem.replaced(log=logs, actuator=actuators)
    first_ns = min(problem.start.time_ns, *(int(log.times_ns[0]) for log in logs))
    return problem.replaced(start=replace(problem.start, time_ns=first_ns), log=logs,
                            actuator=actuators)


def _attitudes(attitude: Floats, mount: Floats | None, space: Floats | None) -> Floats:
    attitude = attitude if space is None else so3.multiply(space, attitude)
    return attitude if mount is None else so3.multiply(attitude, mount)


def _rates(velocity: Floats, mount: Floats | None, physics: Sequence[Physics],
           topic: str) -> Floats:
    if mount is not None:
        velocity = so3.rotate(so3.conjugate(mount), velocity)
    scale, bias = (np.array([one.value(name, topic) for one in physics])[:, None]
                   for name in ('gyro_scale', 'gyro_bias'))
    return scale * velocity + bias


def topics_of(kind: str, channels: Sequence[Measured]) -> list[str]:
    """
    Return the topics to which a sensor parameter applies.

    Gyro parameters apply only to topics with angular velocities.
    """
    return [*{channel.topic: None for channel in channels
              if not (kind.startswith('gyro') and channel.is_attitude)}]


def clocked(channel: Measured, physics: Physics, origin_ns: int) -> NDArray[np.int64]:
    """
    Return the stamps of a channel, ns, corrected for clock offset and clock drift.

    The drift is zero at `origin_ns`.
    """
    offset_ns = round(1e9 * physics.number('clock_offset', channel.topic))
    drift = physics.number('clock_drift', channel.topic)
    stamps_ns = channel.stamps_ns + offset_ns if offset_ns else channel.stamps_ns
    if not drift:
        return stamps_ns
    return stamps_ns + np.round(drift * (channel.stamps_ns - origin_ns)).astype(np.int64)


def mounts(physics: Sequence[Physics], channels: Sequence[Measured]) -> list[Floats | None]:
    """
    Return the rotation from sensor axes to body axes for each channel.

    If any topic contains attitudes, the parameter `mount` applies only to topics with attitudes.
    The angular velocities on all other topics are then assumed to be in body axes, unless
    `mount@TOPIC` is fitted.

    Returns
    -------
    list of array, shape (c, 1, 4), or None
        One entry for each channel. The entry contains a quaternion for each of the c elements of
        `physics`, or is None if there is no rotation.

    """
    result: list[Floats | None] = []
    for channel in channels:
        vectors = np.array([mount_of(f'mount@{channel.topic}', one, channels) for one in physics])
        result.append(so3.exp(vectors)[:, None] if vectors.any() else None)
    return result


def space_axes(physics: Sequence[Physics]) -> Floats | None:
    """
    Return the rotation from the space axes of the motion to those of the measurements.

    The result has shape (c, 1, 4), or is None if there is no rotation.
    """
    vectors = np.array([one.value(SPACE) for one in physics])
    return so3.exp(vectors)[:, None] if vectors.any() else None


def mount_of(name: str, physics: Physics, channels: Sequence[Measured]) -> Floats:
    """
    Return the rotation vector from body axes to the axes of a sensor.

    The vector is the parameter `mount@TOPIC` or, if this parameter is not fitted, `mount`. The
    vector is zero if neither parameter applies to the sensor.
    """
    topic = split_topic(name)[1]
    attitudes = {channel.topic for channel in channels if channel.is_attitude}
    if topic and attitudes and topic not in attitudes and name not in physics.values:
        return np.zeros(3)
    return physics.value('mount', topic)


def corrected(channels: Sequence[Measured], physics: Physics, origin_ns: int) -> list[Measured]:
    """
    Return the channels with all fitted sensor errors removed.

    The stamps are converted to the torque clock and the values to body axes, and the bias and
    scale of each gyro are removed.
    """
    result, space = [], space_axes([physics])
    for channel, mount in zip(channels, mounts([physics], channels)):
        moved = replace(channel, stamps_ns=clocked(channel, physics, origin_ns))
        if channel.angular_velocity is not None:
            rates = (channel.angular_velocity - physics.value('gyro_bias', channel.topic)) \
                / physics.value('gyro_scale', channel.topic)
            moved = replace(moved, angular_velocity=rates if mount is None
                            else so3.rotate(mount[0], rates))
        elif channel.attitude is not None:
            attitude = channel.attitude
            if space is not None:
                attitude = so3.multiply(so3.conjugate(space[0]), attitude)
            moved = replace(moved, attitude=attitude if mount is None
                            else so3.multiply(attitude, so3.conjugate(mount[0])))
        result.append(moved)
    return result
