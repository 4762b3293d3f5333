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

"""The inputs of a fit: check them, guess the parameters, and divide recordings into windows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from types import MappingProxyType
from typing import cast

import numpy as np
from rigid_body_ros.common.arrays import entries, Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.inference.coordinates import (
    GRAVITY,
    lifted,
    LONGEST_DELAY,
    Magnitudes,
    moments_of,
    Parameters,
    Physics,
    SHIFTS,
    SHORT_LAG,
)
from rigid_body_ros.inference.guess import likely_offset, local_state
from rigid_body_ros.inference.motion import Motion, Recorded, span_of
from rigid_body_ros.inference.noise import FEWEST, rms
from rigid_body_ros.inference.residual_torque import measured_rates
from rigid_body_ros.inference.windows import AxialInertia, clocked, mount_of, topics_of, Window
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.body import RigidBody
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import TorqueLog
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report.thinning import thinned
from rigid_body_ros.scene.quantities import MOMENT, OF_SENSORS, SPACE, split_topic, START, WEIGHT

#: Approximate angle through which the body turns in each window of the first fit, rad.
_FIRST = 8.0
#: Minimum and maximum number of samples per channel in a window.
_SHORTEST, _LONGEST = 20, 60_000
#: Time by which a window begins before the first of its samples, ns, if a parameter shifts stamps.
_LEAD_NS = 200_000_000
#: Time for which torques from before a window are kept if a lag is fitted, ns, in addition to the
#: longest delay. A lag of a quarter of a second remembers a torque for this long.
_MEMORY_OF_LAG_NS = 10_000_000_000
#: Minimum number of samples in a channel.
_FEWEST = 8
#: An angular velocity is estimated from two attitudes that are about this far apart, s.
_LAG = 0.1
#: A model is judged in at most this many windows, and by at most this many samples of each sensor.
WINDOWS, _SAMPLES = 24, 2000


@dataclass(frozen=True, eq=False)
class Setup:
    """
    All inputs of a fit, derived from the arguments of `identify`.

    If the windows share no parameters, `most` may limit the number of windows, to save time.
    """

    problems: Sequence[Problem]
    channels: list[list[Measured]]
    parameters: Parameters
    rate: float
    fits_start: bool
    attitude_noise: float | None
    rate_noise: float | None
    axial: Sequence[AxialInertia | None]
    most: int | None = None

    @property
    def given(self) -> Physics:
        """
        Return the guess given by the user.

        The fit may start from a different inertia if the given body is too flat.
        """
        return self.parameters.guess.with_value('inertia', entries(
            self.problems[0].body.inertia))

    @property
    def axial_tensor(self) -> Floats:
        """
        Return the axial inertia of the named wheels, as a tensor.

        The fitted inertia does not include this tensor.
        """
        return self.axial[0].tensor if self.axial[0] else np.zeros((3, 3))

    def body(self, physics: Physics) -> RigidBody:
        """Return the fitted body including its wheels."""
        return RigidBody(physics.inertia + self.axial_tensor, physics.damping) \
            if self.axial[0] else physics.body

    def start(self, number: int) -> State:
        """Return the initial state given by the user for a recording."""
        axial = self.axial[number]
        return axial.start if axial else self.problems[number].start

    @property
    def logs(self) -> list[TorqueLog]:
        """Return the torques of all recordings."""
        return [log for problem in self.problems for log in problem.logs]

    def noise_of(self, is_attitude: bool) -> float | None:
        """Return the noise of attitudes, rad, or of rates, rad/s, that the user gave."""
        return self.attitude_noise if is_attitude else self.rate_noise

    @property
    def is_computed(self) -> bool:
        """Return whether the motion is computed, from states that may be unknown."""
        return isinstance(self.problems[0], Problem)

    @property
    def fits_attitude(self) -> list[bool]:
        """
        Return, for each recording, whether the initial attitude is fitted.

        It is not fitted if no attitude is measured, or if `space` is, which has the same effect.
        """
        return [SPACE not in self.parameters.groups and any(
            channel.is_attitude for channel in channels) for channels in self.channels]

    @property
    def span_ns(self) -> int:
        """Return the length of the longest recording, ns."""
        return max(max(int(channel.stamps_ns[-1]) for channel in channels)
                   - min(int(channel.stamps_ns[0]) for channel in channels)
                   for channels in self.channels) + 1

    @property
    def longest_ns(self) -> int:
        """Return the maximum length of a window, ns."""
        most = max(map(len, chain(*self.channels)))
        return max(int(self.span_ns * min(1.0, _LONGEST / most)), 1)

    @property
    def shortest_ns(self) -> int:
        """Return the length of the windows of the first fit, ns; all of a recorded motion."""
        if not self.is_computed:
            return self.longest_ns
        spacing = max(float(np.median(np.diff(channel.stamps_ns)))
                      for channel in chain(*self.channels))
        return int(min(max(1e9 * _FIRST / self.rate, _SHORTEST * spacing), self.longest_ns))

    def windows(self, length_ns: int, physics: Physics, parts: int = 1,
                few: int | None = None) -> list[Window]:
        """Divide all recordings into windows, and return at most `most` of them, or `few`."""
        shifts = any(split_topic(name)[0] in SHIFTS for name in self.parameters.groups)
        makers = [make for number, channels in enumerate(self.channels) for make in self.makers_of(
            number, channels, length_ns, physics, shifts * _LEAD_NS, parts)]
        for most in (self.most, few):
            makers = makers[thinned(len(makers), most)] if most else makers
        return [make() for make in makers]

    def makers_of(self, number: int, channels: Sequence[Measured], length_ns: int,
                  physics: Physics, lead_ns: int = 0, parts: int = 1
                  ) -> list[Callable[[], Window]]:
        """
        Divide a recording into windows.

        Parameters
        ----------
        number : int
            Index of the recording.
        channels : sequence of Measured
            The channels of the recording.
        length_ns : int
            Approximate length of a window.
        physics : Physics
            The parameters, including the clocks of the sensors.
        lead_ns : int
            How long each window except the first begins before its samples.
        parts : int
            Number of windows to make from each `length_ns` of the recording.

        Returns
        -------
        list of callable
            A function for each window with samples, in chronological order, that makes the window.

        """
        problem, axial = self.problems[number], self.axial[number]
        start_ns = problem.start.time_ns
        stamps = [clocked(channel, physics, start_ns) for channel in channels]
        first_ns = max(start_ns, min(int(stamps_ns[0]) for stamps_ns in stamps))
        last_ns = min(max(int(stamps_ns[-1]) for stamps_ns in stamps), span_of(problem)[1])
        count = parts * max(1, round((last_ns - first_ns) / length_ns))
        edges = first_ns + np.arange(count + 1) * ((last_ns - first_ns) // count + 1)
        anchors = np.append(start_ns, np.maximum(edges[1:-1] - lead_ns, start_ns))
        momenta = problem.rotor_momentum(anchors)
        if axial:
            momenta = momenta + np.where(anchors > start_ns, 1.0, 0.0)[:, None] * (
                axial.tensor @ axial.rate)
        memory_ns = round(1e9 * LONGEST_DELAY) \
            + _MEMORY_OF_LAG_NS * ('torque_lag' in self.parameters.groups)
        ends = np.array([np.searchsorted(stamps_ns, edges) for stamps_ns in stamps])

        def made(k: int) -> Window:
            rows = [slice(*of_channel[k:k + 2].tolist()) for of_channel in ends]
            start = State(int(anchors[k]), rotor_momentum=momenta[k])
            near = problem.between(start, int(edges[k + 1]) + _LEAD_NS, memory_ns)
            return Window(number, k == 0, near,
                          [channel.rows(part) for channel, part in zip(channels, rows)], rows,
                          start_ns, axial.tensor if axial and anchors[k] == start_ns else None)
        filled = np.flatnonzero((np.diff(ends, axis=1) > 0).any(axis=0))
        return [partial(made, k) for k in filled.tolist()]

    def candidates(self) -> list[str]:
        """Return the names of the parameters that could be estimated but were not."""
        groups = self.parameters.groups
        names = [name for name in self._of_body() if name not in groups]
        for kind in OF_SENSORS:
            topics = topics_of(kind, [*chain(*self.channels)])
            own = [kind] if len(topics) == 1 else [f'{kind}@{topic}' for topic in topics]
            names += [name for name in own if name not in groups]
        return names

    def _of_body(self) -> list[str]:
        """Return the names of candidates that no sensor has; of a recorded motion, its axes."""
        if not self.is_computed:
            return [SPACE] if any(channel.is_attitude for channel in self.channels[0]) else []
        names = ['inertia', 'damping', 'rotor_momentum', *self.parameters.magnitudes.strengths]
        if all(self.fits_attitude) and f'{WEIGHT}.{MOMENT}' not in names:
            names.append(WEIGHT)
        names.append('torque_bias')
        if any(log.torques.any() for log in self.logs):
            names += ['torque_delay', 'torque_gains']
            if all(log.interpolation == 'hold' for log in self.logs):
                names.append('torque_lag')
            if {'inertia', 'inertia_diagonal', 'torque_gains'}.isdisjoint(self.parameters.groups):
                names.append('torque_gain')
        return names

    def extended(self, physics: Physics, names: Sequence[str]) -> Setup:
        """Return a setup that also fits the parameters `names`, with these values as the guess."""
        old = self.parameters
        groups = [name for name in old.groups
                  if not (name == 'inertia_diagonal' and 'inertia' in names)]
        mounts = {name: mount_of(topic, physics, self.channels[0])
                  for name, (kind, topic) in zip(names, map(split_topic, names))
                  if kind == 'mount'}
        guess = replace(physics, values={
            **moments_of(names, self.problems[0].fields), **mounts, **physics.values})
        return replace(self, parameters=Parameters([*groups, *names], guess, old.magnitudes,
                                                   old.priors))


def channels_of(sensors: Sequence[Measured], start_ns: int) -> list[Measured]:
    """
    Return the channels of a recording: each quantity of each sensor, from the start of the motion.

    Raises
    ------
    InputError
        The recording has no measured topic, or a topic has too few finite samples after the start.

    """
    if not sensors:
        raise InputError('expected at least one measured topic, found none')
    return [_checked(channel, start_ns) for sensor in sensors for channel in sensor.channels()]


def _checked(channel: Measured, start_ns: int) -> Measured:
    what = 'attitudes' if channel.is_attitude else 'angular velocities'
    finite = np.atleast_1d((np.abs(channel.values) <= FASTEST).all(axis=1))
    if channel.is_attitude:
        finite &= channel.values.any(axis=1)
    if not finite.any():
        raise InputError(f'{channel.topic}: expected finite {what}, found none among '
                         f'{len(finite)} samples')
    channel = channel.rows(finite & (channel.stamps_ns >= start_ns))
    if not len(channel):
        raise InputError(f'{channel.topic}: expected {what} from the start of the motion '
                         f'({start_ns} ns) on, found only earlier ones')
    if len(channel) < _FEWEST:
        raise InputError(f'{channel.topic}: expected at least {_FEWEST} {what} from the start of '
                         f'the motion on, found {len(channel)}')
    return replace(channel, attitude=so3.normalize(channel.values)) if channel.is_attitude \
        else channel


def typical_rate(channels: Sequence[Measured]) -> float:
    """Return an outlier-resistant estimate of the root-mean-square angular velocity, rad/s."""
    rates = [1e-6]
    for channel in channels:
        spacing = 1e-9 * max(float(np.median(np.diff(channel.stamps_ns))), 1.0)
        lag = min(max(1, round(_LAG / spacing)), len(channel) - 1)
        squares = np.sum(measured_rates(channel, lag)[1] ** 2, axis=1)
        limited = np.minimum(squares, 25.0 * np.median(squares))
        rates.append(float(np.sqrt(np.mean(limited))))
    return max(rates)


def prepared(problem: Problem, channels: Sequence[Measured]
             ) -> tuple[Problem, AxialInertia | None]:
    """
    Replace the named wheels of a problem with rotors, and apply the delays and limits.

    Return the new problem, whose actuators only lag, and the axial inertia of the wheels. In the
    new problem, the initial rotor momentum is relative to the rotating body.
    """
    if problem.actuators:
        problem = problem.replaced(log=problem.acting_logs, actuator=[
            actuator and actuator.lag for actuator in problem.actuators])
    if not problem.named_wheels:
        return problem, None
    carried, start = problem.carried(), problem.start
    tensor = problem.body.inertia - carried.body.inertia
    _, rate = local_state(channels, start.time_ns, typical_rate(channels), start)
    momentum = carried.start.rotor_momentum - tensor @ start.angular_velocity
    return carried.replaced(start=State(start.time_ns, start.attitude, start.angular_velocity,
                                        momentum)), AxialInertia(tensor, rate, start)


def setup_of(problems: Sequence[Problem], channels: list[list[Measured]], names: Sequence[str],
             attitude_noise: float | None = None, rate_noise: float | None = None,
             gravity: Sequence[float] = GRAVITY) -> Setup:
    """
    Return the inputs of a fit with guesses of its parameters.

    The arguments are those of `identify`, except that there is a problem and a list of channels
    for each recording.
    """
    problems, axial = zip(*map(prepared, problems, channels))
    if len({wheels and wheels.tensor.tobytes() for wheels in axial}) > 1:
        raise InputError('experiments: expected the same wheels in all recordings, found others')
    every = [*chain(*channels)]
    values: dict[str, Floats] = {}
    for name in names:
        kind, topic = split_topic(name)
        topics = topics_of(kind, every)
        if topic and topic not in topics:
            raise InputError(f'estimate: {name}: expected a topic among {listed(topics)}, found '
                             f'{topic}')
        if kind == 'clock_offset':
            values[name] = np.array([_clock_offset(problems, channels, topic)])
        elif kind == 'torque_lag':
            values[name] = np.array([SHORT_LAG])
    kinds = {log.interpolation for problem in problems for log in problem.logs} - {'hold'}
    if 'torque_lag' in names and kinds:
        raise InputError('estimate: torque_lag: expected torques that are held between samples, '
                         f'found interpolation {kinds.pop()!r}')
    rate = max(map(typical_rate, channels))
    torques = [rms(log.torques) for problem in problems for log in problem.logs]
    span_ns = max(float(np.ptp(channel.stamps_ns)) for channel in every)
    body, fields = problems[0].body, problems[0].fields
    is_fitted = not {'inertia', 'inertia_diagonal'}.isdisjoint(names)
    inertia = lifted(body.inertia) if is_fitted else body.inertia
    guess = Physics({'inertia': entries(inertia), 'damping': entries(body.damping),
                     **moments_of(names, fields), **values}, gravity)
    strengths = {f'{field.name}.{MOMENT}': float(np.linalg.norm(field.field)) for field in fields
                 if isinstance(field, UniformField) and field.name and np.any(field.field)}
    magnitudes = Magnitudes(rate, max(torques, default=0.0), max(span_ns * 1e-9, 1e-9),
                            strengths)
    parameters = Parameters(names, guess, magnitudes)
    return Setup(problems, channels, parameters, rate, START in names, attitude_noise, rate_noise,
                 axial)


def setup_of_sensors(motion: Motion, channels: list[Measured],
                     values: Mapping[str, Floats] = MappingProxyType({}),
                     fits_start: bool = False) -> Setup:
    """
    Return the inputs of a fit in which only the sensors and the start may be wrong.

    Parameters
    ----------
    motion : Problem or Recorded
        The motion.
    channels : list of Measured
        The channels of the sensors.
    values : dict of str to array
        Guesses of the parameters to fit, by name.
    fits_start : bool
        Whether to fit the start of the motion.

    """
    problem = cast(Problem, motion)  # a recorded motion has what windows need of a problem
    inertia, damping = (np.eye(3), np.zeros((3, 3))) if isinstance(motion, Recorded) else (
        motion.body.inertia, motion.body.damping)
    guess = Physics({'inertia': entries(inertia), 'damping': entries(damping), **values})
    rate = typical_rate(channels)
    span_ns = max(int(np.ptp(channel.stamps_ns)) for channel in channels)
    parameters = Parameters([*values], guess, Magnitudes(rate, 0.0, 1e-9 * span_ns, {}))
    return Setup([problem], [channels], parameters, rate, fits_start, None, None, [None])


def setup_of_model(motion: Motion, sensors: Sequence[Measured]) -> Setup | None:
    """
    Return the inputs of a fit that judges a model, in which at most the start is free.

    Return None if no channel of the sensors has enough samples.
    """
    spacing_ns = motion.spacing_ns if isinstance(motion, Recorded) else 0
    channels = [channel for sensor in sensors
                for channel in _thinned(sensor, spacing_ns).channels() if len(channel) >= FEWEST]
    if not channels:
        return None
    setup = setup_of([motion], [channels], (START,)) if isinstance(motion, Problem) \
        else setup_of_sensors(motion, channels)
    return replace(setup, most=WINDOWS)


def _thinned(sensor: Measured, spacing_ns: int) -> Measured:
    """Return at most `_SAMPLES` samples, at least `spacing_ns` apart."""
    if len(sensor) < 2:
        return sensor
    apart = -(-spacing_ns // int(np.median(np.diff(sensor.stamps_ns)))) or 1
    return sensor.rows(thinned(len(sensor), min(_SAMPLES, len(sensor) // apart or 1)))


def _clock_offset(problems: Sequence[Problem], channels: list[list[Measured]],
                  topic: str) -> float:
    """Guess the clock offset, in seconds, from the recording with the most samples."""
    of_topic = [[channel for channel in every if topic in ('', channel.topic)]
                for every in channels]
    return likely_offset(*max(zip(problems, of_topic), key=lambda pair: sum(map(len, pair[1]))))
