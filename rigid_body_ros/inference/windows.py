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
Windows of a recording, and predictions of what the sensors measure in them.

A sensor has a clock and axes of its own, and a gyro also a bias and a scale. A channel is one
quantity that a sensor measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros.common.arrays import Floats, Ints
from rigid_body_ros.inference.coordinates import Physics
from rigid_body_ros.inference.motion import Motion, poses_of, Recorded, span_of
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.actuator import Actuator
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.states import Poses
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.derivatives import START_NAMES, with_derivatives
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.scene.quantities import (
    components_of,
    is_of_sensor,
    MOMENT,
    SPACE,
    split_topic,
    START,
    WEIGHT,
)

#: Lags shorter than this, s, are ignored.
_SHORTEST = 1e-6
#: The parameters of a problem that contain some parameters of a fit.
_OF_PROBLEM = {'inertia_diagonal': 'inertia', WEIGHT: f'{WEIGHT}.{MOMENT}'}
Stamps = Sequence[Ints]
#: Parameters of clocks.
CLOCKS = 'clock_offset', 'clock_drift'


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
    _times: tuple[Stamps, list[NDArray[np.intp]], Ints] | None = field(
        init=False, default=None)

    @property
    def anchor_ns(self) -> int:
        """Return the beginning of the window, ns."""
        return self.problem.start.time_ns

    def predict(self, physics: Physics, state: Poses) -> list[Floats]:
        """
        Return what each channel would contain if its sensor had no noise.

        Parameters
        ----------
        physics : Physics
            The parameters.
        state : Poses
            The state at the beginning of the window: arrays of shape (4,) and (3,).

        Returns
        -------
        list of array, shape (n, 4) or (n, 3)

        Raises
        ------
        ValueError
            `propagate` rejects the motion.

        """
        sensors = sensors_of(self.channels, physics, self.origin_ns)
        rows, times_ns = self._instants(sensors)
        poses = self._poses(physics, state, times_ns)
        return [sensor.measured(poses.rows(here)) for sensor, here in zip(sensors, rows)]

    def linearize(self, physics: Physics, state: Poses,
                  groups: Sequence[str]) -> tuple[list[Floats], list[Floats]]:
        """
        Return what `predict` returns, and how it changes.

        Parameters
        ----------
        physics, state
            See `predict`.
        groups : sequence of str
            The names of parameters.

        Returns
        -------
        predicted : list of array, shape (n, 4) or (n, 3)
        slopes : list of array, shape (6 + p, n, 3)
            The derivatives with respect to the state, which are those with respect to a rotation
            vector in body axes and to the angular velocity, and to the p components of the
            parameters. The change of an attitude is a rotation vector.

        """
        sensors = sensors_of(self.channels, physics, self.origin_ns)
        rows, times_ns = self._instants(sensors)
        poses, of_motion = self._derivatives(physics, state, groups, times_ns)
        if any(split_topic(group)[0] in CLOCKS for group in groups):
            of_motion[CLOCKS[0]] = self._flow(physics, state, poses, times_ns)
        predicted, slopes = [], []
        for sensor, here in zip(sensors, rows):
            at = poses.rows(here)
            changes = {name: motion.rows(here) for name, motion in of_motion.items()}
            blocks = [sensor.by_motion(changes[START])]
            for group in groups:
                if not is_of_sensor(group):
                    blocks.append(sensor.by_motion(changes[group]))
                elif applies(group, sensor.channel, physics, self.channels):
                    blocks.append(sensor.slopes(split_topic(group)[0], at,
                                                changes.get(CLOCKS[0])))
                else:
                    blocks.append(np.zeros((len(components_of(group)), len(here), 3)))
            predicted.append(sensor.measured(at))
            slopes.append(np.concatenate(blocks))
        return predicted, slopes

    def state_at(self, physics: Physics, state: Poses, time_ns: int) -> Poses:
        """Propagate a state from the beginning of the window to a given time."""
        return self._poses(physics, state, np.array([time_ns])).rows(0)

    def _moved(self, physics: Physics, state: Poses, end_ns: int, groups: Sequence[str] = ()
               ) -> Problem:
        """Return the problem with given parameters from a state, until a time."""
        assert isinstance(self.problem, Problem)
        momentum = physics.value('rotor_momentum') + self.problem.start.rotor_momentum
        if self.axial is not None:
            momentum = momentum + state.angular_velocity @ self.axial
        return self._acting(physics, end_ns).replaced(
            body=physics.body, start=State(self.anchor_ns, *state, momentum),
            fields=physics.acting(self.problem.fields, groups) or None)

    def _poses(self, physics: Physics, state: Poses, times_ns: Ints) -> Poses:
        """
        Return the motion at given times.

        At times before the beginning of the window, the motion is at its initial state.
        """
        times_ns = np.clip(times_ns, *span_of(self.problem))
        if isinstance(self.problem, Recorded):
            return self.problem.propagate(at=times_ns)
        return poses_of(self._moved(physics, state, int(times_ns[-1])).propagate(at=times_ns))

    def _derivatives(self, physics: Physics, state: Poses, groups: Sequence[str],
                     times_ns: Ints) -> tuple[Poses, dict[str, MotionSlopes]]:
        """Return the motion and its derivatives with respect to the start and parameters."""
        if isinstance(self.problem, Recorded):
            none: Floats = np.zeros((len(times_ns), 3, 6))
            return self._poses(physics, state, times_ns), {START: MotionSlopes(none, none)}
        times_ns = np.clip(times_ns, *span_of(self.problem))
        own = [group for group in groups if not is_of_sensor(group)]
        needed = [START, *own, *['rotor_momentum'] * (self.axial is not None)]
        poses, derivatives = with_derivatives(
            self._moved(physics, state, int(times_ns[-1]), groups),
            [*{_OF_PROBLEM.get(name, name): None for name in needed}], times_ns,
            physics.value('torque_bias'))
        changes = {}
        for name in needed:
            components = START_NAMES if name == START else components_of(
                f'{WEIGHT}.{MOMENT}' if name == WEIGHT else name)
            columns = [*map(derivatives.names.index, components)]
            changes[name] = MotionSlopes(derivatives.attitude[..., columns],
                                         derivatives.angular_velocity[..., columns])
        if self.axial is not None:  # the rotors turn with the body at the start
            for whole, rotors in zip(changes[START], changes['rotor_momentum']):
                whole[..., 3:] += rotors @ self.axial.T
        for name in ('torque_gain', 'torque_gains'):  # the torques are already multiplied
            if name in changes:
                changes[name] = MotionSlopes(*(
                    slopes / physics.value(name) for slopes in changes[name]))
        return poses, changes

    def _flow(self, physics: Physics, state: Poses, poses: Poses, times_ns: Ints) -> MotionSlopes:
        """Return how the motion changes with time, or zeros where it is not known."""
        first_ns, last_ns = span_of(self.problem)
        inside = ((times_ns >= first_ns) & (times_ns <= last_ns))[:, None]
        if isinstance(self.problem, Recorded):
            acceleration = self.problem.angular_acceleration(times_ns)
        else:
            acceleration = self._moved(physics, state, int(times_ns[-1])).angular_acceleration(
                np.clip(times_ns, first_ns, last_ns), *poses)
        return MotionSlopes(*((flow * inside)[..., None]
                              for flow in (poses.angular_velocity, acceleration)))

    def _instants(self, sensors: Sequence[Sensor]) -> tuple[list[NDArray[np.intp]], Ints]:
        """
        Return where the samples of each channel lie in the union of all sample times.

        The first result holds the indices of each channel. The second is the union, ns.
        """
        stamps = [sensor.stamps_ns for sensor in sensors]
        if self._times is None or not all(map(np.array_equal, stamps, self._times[0])):
            union = np.unique(np.concatenate(stamps))
            self._times = stamps, [np.searchsorted(union, own) for own in stamps], union
        return self._times[1:]

    def _acting(self, physics: Physics, end_ns: int) -> Problem:
        """
        Return the problem of this window with the torques that act on the body.

        The torques include the torque bias, which acts until `end_ns`.
        """
        assert isinstance(self.problem, Problem)
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
    constants = [lag + (actuator.time_constant if actuator else 0.0)
                 for actuator in problem.actuators or [None] * len(logs)]
    if max(constants, default=0.0) <= _SHORTEST:
        return problem.replaced(log=logs)
    actuators = [Actuator(time_constant=constant) if constant > _SHORTEST else None
                 for constant in constants]
    if problem.actuators:
        return problem.replaced(log=logs, actuator=actuators)
    first_ns = min(problem.start.time_ns, *(int(log.times_ns[0]) for log in logs))
    return problem.replaced(start=replace(problem.start, time_ns=first_ns), log=logs,
                            actuator=actuators)


class MotionSlopes(NamedTuple):
    """
    How a motion changes with p numbers, in body axes.

    The attitude changes by rotation vectors, shape (n, 3, p), as does the angular velocity.
    """

    attitude: Floats
    angular_velocity: Floats

    def rows(self, chosen: NDArray[np.intp]) -> MotionSlopes:
        """Return the changes at the chosen times."""
        return MotionSlopes(self.attitude[chosen], self.angular_velocity[chosen])


@dataclass(frozen=True, eq=False)
class Sensor:
    """
    A sensor with given parameters.

    Attributes
    ----------
    channel : Measured
        The samples of the sensor.
    physics : Physics
        The parameters.
    mount : array, shape (3,), rad
        The rotation vector from body axes to the axes of the sensor.
    origin_ns : int
        The time at which the drift of the clock is zero.

    """

    channel: Measured
    physics: Physics
    mount: Floats
    origin_ns: int

    @cached_property
    def stamps_ns(self) -> Ints:
        """Return the stamps, ns, corrected for clock offset and clock drift."""
        return clocked(self.channel, self.physics, self.origin_ns)

    def measured(self, poses: Poses) -> Floats:
        """Return what the sensor would measure without noise, shape (n, 4) or (n, 3)."""
        if self.channel.is_attitude:
            attitude, space = poses.attitude, self.physics.value(SPACE)
            attitude = so3.multiply(so3.exp(space), attitude) if space.any() else attitude
            return so3.multiply(attitude, self._axes) if self.mount.any() else attitude
        return self._value('gyro_scale') * self._rates(poses) + self._value('gyro_bias')

    def by_motion(self, motion: MotionSlopes) -> Floats:
        """Return how a measurement changes with the motion, shape (p, n, 3)."""
        change = np.moveaxis(motion[0 if self.channel.is_attitude else 1], 2, 0)
        if self.mount.any():
            change = change @ so3.matrix(self._axes)
        return change if self.channel.is_attitude else self._value('gyro_scale') * change

    def slopes(self, kind: str, poses: Poses, flow: MotionSlopes | None) -> Floats:
        """
        Return how a measurement changes with a parameter of the sensor.

        Parameters
        ----------
        kind : str
            The name of the parameter, without a topic.
        poses : Poses
            The n states at the stamps.
        flow : MotionSlopes, optional
            How the motion changes with time, for a clock.

        Returns
        -------
        array, shape (k, n, 3)
            One block for each component of the parameter.

        """
        if kind in CLOCKS:
            assert flow is not None
            slopes = self.by_motion(flow)
            since = 1e-9 * (self.channel.stamps_ns - self.origin_ns)
            return slopes * since[:, None] if kind == 'clock_drift' else slopes
        count, turn = len(self.channel), so3.right_jacobian(self.mount).T
        if self.channel.is_attitude:
            if kind == SPACE:
                turn = so3.right_jacobian(self.physics.value(SPACE)).T
                back = so3.conjugate(so3.multiply(poses.attitude, self._axes))
                return so3.rotate(back, turn[:, None])
            return np.repeat(turn[:, None] * (kind == 'mount'), count, axis=1)
        if kind == 'mount':
            return self._value('gyro_scale') * np.cross(self._rates(poses), turn[:, None])
        if kind == 'gyro_scale':
            return self._rates(poses) * np.eye(3)[:, None]
        return np.repeat(np.eye(3)[:, None] * (kind == 'gyro_bias'), count, axis=1)

    @cached_property
    def _axes(self) -> Floats:
        return so3.exp(self.mount)

    def _rates(self, poses: Poses) -> Floats:
        if not self.mount.any():
            return poses.angular_velocity
        return so3.rotate(so3.conjugate(self._axes), poses.angular_velocity)

    def _value(self, kind: str) -> Floats:
        return self.physics.value(kind, self.channel.topic)


def sensors_of(channels: Sequence[Measured], physics: Physics, origin_ns: int) -> list[Sensor]:
    """
    Return the sensors of channels.

    If any topic contains attitudes, the parameter `mount` applies only to topics with attitudes.
    The angular velocities on all other topics are then assumed to be in body axes, unless
    `mount@TOPIC` is fitted.
    """
    return [Sensor(channel, physics, mount_of(channel.topic, physics, channels), origin_ns)
            for channel in channels]


def applies(name: str, channel: Measured, physics: Physics, channels: Sequence[Measured]) -> bool:
    """Return whether a parameter of sensors changes what a channel measures."""
    kind, topic = split_topic(name)
    if topic:
        return topic == channel.topic
    is_own = f'{kind}@{channel.topic}' in physics.values
    return not is_own and (kind != 'mount' or channel.topic in _mounted(channels))


def _mounted(channels: Sequence[Measured]) -> set[str]:
    """Return the topics to which the parameter `mount` applies."""
    return {channel.topic for channel in channels if channel.is_attitude} or {
        channel.topic for channel in channels}


def topics_of(kind: str, channels: Sequence[Measured]) -> list[str]:
    """
    Return the topics to which a sensor parameter applies.

    Gyro parameters apply only to topics with angular velocities.
    """
    return [*{channel.topic: None for channel in channels
              if not (kind.startswith('gyro') and channel.is_attitude)}]


def clocked(channel: Measured, physics: Physics, origin_ns: int) -> Ints:
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


def mount_of(topic: str, physics: Physics, channels: Sequence[Measured]) -> Floats:
    """
    Return the rotation vector from body axes to the axes of a sensor.

    The vector is the parameter `mount@TOPIC` or, if this parameter is not fitted, `mount`. The
    vector is zero if neither parameter applies to the sensor.
    """
    is_own = f'mount@{topic}' in physics.values
    if topic and topic not in _mounted(channels) and not is_own:
        return np.zeros(3)
    return physics.value('mount', topic)


def corrected(channels: Sequence[Measured], physics: Physics, origin_ns: int) -> list[Measured]:
    """
    Return the channels with all fitted sensor errors removed.

    The stamps are converted to the torque clock and the values to body axes, and the bias and
    scale of each gyro are removed.
    """
    result, space = [], so3.exp(-physics.value(SPACE))
    for sensor in sensors_of(channels, physics, origin_ns):
        channel, axes = sensor.channel, so3.exp(sensor.mount)
        moved = replace(channel, stamps_ns=sensor.stamps_ns)
        if channel.angular_velocity is not None:
            rates = (channel.angular_velocity - physics.value('gyro_bias', channel.topic)) \
                / physics.value('gyro_scale', channel.topic)
            moved = replace(moved, angular_velocity=so3.rotate(axes, rates))
        elif channel.attitude is not None:
            moved = replace(moved, attitude=so3.multiply(
                so3.multiply(space, channel.attitude), so3.conjugate(axes)))
        result.append(moved)
    return result
