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

"""Check the inputs of a fit, and guess its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import cast

import numpy as np
from rigid_body_ros.common.arrays import entries, Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.inference.coordinates import (
    GRAVITY,
    lifted,
    Magnitudes,
    Parameters,
    Physics,
    SHORT_LAG,
)
from rigid_body_ros.inference.errors import rms
from rigid_body_ros.inference.guess import likely_offset, local_state
from rigid_body_ros.inference.motion import Motion, Recorded
from rigid_body_ros.inference.noise import FEWEST
from rigid_body_ros.inference.parameters import moments_of, split_topic, START
from rigid_body_ros.inference.residual_torque import measured_rates
from rigid_body_ros.inference.sensors import topics_of
from rigid_body_ros.inference.setup import Setup
from rigid_body_ros.inference.windows import AxialInertia
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.fields import UniformField
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.propagation import Problem
from rigid_body_ros.propagation.options import FASTEST
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.report.thinning import thinned
from rigid_body_ros.scene.fields import MOMENT

#: Minimum number of samples in a channel.
_FEWEST = 8
#: An angular velocity is estimated from two attitudes that are about this far apart, s.
_LAG = 0.1
#: A model is judged in at most this many windows, and by at most this many samples of each sensor.
WINDOWS, _SAMPLES = 24, 2000


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
    found = 1e-6
    for channel in channels:
        spacing = 1e-9 * max(float(np.median(np.diff(channel.stamps_ns))), 1.0)
        lag = min(max(1, round(_LAG / spacing)), len(channel) - 1)
        squares = np.sum(measured_rates(channel, lag)[1] ** 2, axis=1)
        limited = np.minimum(squares, 25.0 * np.median(squares))
        found = max(found, float(np.sqrt(np.mean(limited))))
    return found


def prepared(problem: Problem, channels: Sequence[Measured]
             ) -> tuple[Problem, AxialInertia | None]:
    """
    Replace the named wheels of a problem with rotors, and apply the delays and limits.

    Return the new problem, whose actuators only lag, and the axial inertia of the wheels. In the
    new problem, the initial rotor momentum is relative to the rotating body.
    """
    if problem.actuators:
        problem = problem.replaced(log=problem.acting_logs, actuator=[
            one and one.lag for one in problem.actuators])
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
    if len({one and one.tensor.tobytes() for one in axial}) > 1:
        raise InputError('experiments: expected the same wheels in all recordings, found others')
    _check_topics(names, [channel for every in channels for channel in every])
    kinds = {log.interpolation for problem in problems for log in problem.logs} - {'hold'}
    if 'torque_lag' in names and kinds:
        raise InputError('estimate: torque_lag: expected torques that are held between samples, '
                         f'found interpolation {kinds.pop()!r}')
    rate = max(typical_rate(one) for one in channels)
    torques = [rms(log.torques) for problem in problems for log in problem.logs]
    span_ns = max(float(one.stamps_ns[-1] - one.stamps_ns[0])
                  for every in channels for one in every)
    body, fields = problems[0].body, problems[0].fields
    values = moments_of(names, fields)
    for name in names:
        kind, topic = split_topic(name)
        if kind == 'clock_offset':
            values[name] = np.array([_clock_offset(problems, channels, topic)])
        elif kind == 'torque_lag':
            values[name] = np.array([SHORT_LAG])
    is_fitted = not {'inertia', 'inertia_diagonal'}.isdisjoint(names)
    inertia = lifted(body.inertia) if is_fitted else body.inertia
    guess = Physics({'inertia': entries(inertia), 'damping': entries(body.damping), **values},
                    gravity)
    strengths = {f'{one.name}.{MOMENT}': float(np.linalg.norm(one.field)) for one in fields
                 if isinstance(one, UniformField) and one.name and np.any(one.field)}
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
    span_ns = max(int(np.ptp(one.stamps_ns)) for one in channels)
    parameters = Parameters([*values], guess, Magnitudes(rate, 0.0, 1e-9 * span_ns, {}))
    return Setup([problem], [channels], parameters, rate, fits_start, None, None, [None])


def setup_of_model(motion: Motion, sensors: Sequence[Measured]) -> Setup | None:
    """
    Return the inputs of a fit that judges a model, in which at most the start is free.

    Return None if no channel of the sensors has enough samples.
    """
    spacing_ns = motion.spacing_ns if isinstance(motion, Recorded) else 0
    channels = [one for sensor in sensors for one in _thinned(sensor, spacing_ns).channels()
                if len(one) >= FEWEST]
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


def _check_topics(names: Sequence[str], channels: Sequence[Measured]) -> None:
    """Raise InputError if the topic in a name is unknown or lacks the required quantity."""
    for name in names:
        kind, topic = split_topic(name)
        known = topics_of(kind, channels)
        if topic and topic not in known:
            raise InputError(f'estimate: {name}: expected a topic among {listed(known)}, found '
                             f'{topic}')


def _clock_offset(problems: Sequence[Problem], channels: list[list[Measured]],
                  topic: str) -> float:
    """Guess the clock offset, in seconds, from the recording with the most samples."""
    of_topic = [[one for one in every if topic in ('', one.topic)] for every in channels]
    return likely_offset(*max(zip(problems, of_topic),
                              key=lambda pair: sum(len(channel) for channel in pair[1])))
