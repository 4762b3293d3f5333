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

"""Align measurements with a motion: fit clock offsets, mountings and the start of the motion."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rigid_body_ros.common.arrays import as_json, Floats
from rigid_body_ros.common.errors import InputError, listed
from rigid_body_ros.inference.evidence import certainty, noises_of, weighted, widened
from rigid_body_ros.inference.fit import Solution
from rigid_body_ros.inference.growth import solved_whole
from rigid_body_ros.inference.guess import guess, IDENTITY
from rigid_body_ros.inference.motion import inside, Motion, no_overlap_error, Recorded
from rigid_body_ros.inference.setup import setup_of_sensors
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.scene.quantities import SPACE, START

CLOCK, MOUNT = 'clock', 'mount'
#: The names of the alignments that can be fitted.
ALIGNMENTS = (START, CLOCK, MOUNT)
#: The samples of a recorded motion that are used begin and end this long, ns, after its start and
#: before its end if clock offsets are fitted.
_MARGIN_NS = 10_000_000


@dataclass(frozen=True, eq=False)
class Alignment:
    """
    The clock offset and the rotations that relate the measurements of a sensor to a motion.

    The measured attitude equals `space` * (attitude of the motion) * `mount`.

    Attributes
    ----------
    clock_offset_s : float, s
        The time to add to the measured stamps to convert them to the clock of the motion.
    mount, space : array, shape (4,)
        Quaternions x y z w. `mount` rotates vectors from the axes of the sensor to the body axes.
        `space` rotates vectors from the space axes of the motion to the space axes of the
        measurements. All sensors share the same `space`.
    start : State, optional
        The fitted start; None if the start was not fitted.
    sigma : dict, optional
        Standard deviations of the fitted values. A standard deviation is infinite if the
        measurement does not determine the value. The entry 'clock_offset_s' is a number, s. The
        other entries are arrays of shape (3,): 'mount_rad', about the axes of the sensor;
        'space_rad', about the space axes of the measurements; 'initial_attitude_rad', about the
        body axes; and 'initial_angular_velocity_rad_s'.

    """

    clock_offset_s: float = 0.0
    mount: Floats = field(default_factory=IDENTITY.copy)
    space: Floats = field(default_factory=IDENTITY.copy)
    start: State | None = None
    sigma: dict[str, Any] | None = None

    def of_sensor(self) -> dict[str, Any]:
        """Return the clock offset and the mounting of the sensor as JSON types."""
        return {'clock_offset_s': self.clock_offset_s, 'mount_xyzw': _upper(self.mount).tolist()}

    def as_dict(self) -> dict[str, Any]:
        """Return the alignment as JSON types, with None for infinite standard deviations."""
        result: dict[str, Any] = {
            **self.of_sensor(), 'space_xyzw': _upper(self.space).tolist(),
            'start': 'fitted' if self.start else 'scene'}
        if self.start:
            result['initial_attitude_xyzw'] = self.start.attitude.tolist()
            result['initial_angular_velocity_rad_s'] = self.start.angular_velocity.tolist()
        if self.sigma:
            result['sigma'] = {name: as_json(value) for name, value in self.sigma.items()}
        return result

    def applied(self, sensor: Measured) -> Measured:
        """Convert the measurements of a sensor to the clock and the axes of the motion."""
        attitude, rate = sensor.attitude, sensor.angular_velocity
        if attitude is not None:
            attitude = so3.multiply(so3.multiply(so3.conjugate(self.space), attitude),
                                    so3.conjugate(self.mount))
        if rate is not None:
            rate = so3.rotate(self.mount, rate)
        turn = so3.matrix(self.mount)

        def turned(covariance: Floats | None) -> Floats | None:
            return None if covariance is None else turn @ covariance @ turn.T
        return replace(sensor, stamps_ns=sensor.stamps_ns + round(1e9 * self.clock_offset_s),
                       attitude=attitude, angular_velocity=rate,
                       attitude_covariance=turned(sensor.attitude_covariance),
                       rate_covariance=turned(sensor.rate_covariance))


def _upper(quaternion: Floats) -> Floats:
    return -quaternion if quaternion[3] < 0.0 else quaternion


def align(motion: Motion, sensors: Sequence[Measured],
          names: Collection[str]) -> tuple[Alignment, ...]:
    """
    Align measurements with a motion by a least-squares fit that ignores outliers.

    Parameters
    ----------
    motion : Problem or Recorded
        The motion to align the sensors with.
    sensors : sequence of Measured
        The measurements. Each sensor has its own clock and its own mounting. All sensors share the
        same start of the motion, and the same rotation between the space axes of the measurements
        and those of the motion.
    names : collection of str
        What to fit: names in `ALIGNMENTS`. Use 'clock@TOPIC' or 'mount@TOPIC' to fit the clock or
        the mounting of a single sensor.

    Returns
    -------
    tuple of Alignment
        One alignment for each sensor.

    Raises
    ------
    InputError
        A name is unknown, or no sample lies within the time span of the motion.

    """
    check_names(names, [sensor.topic for sensor in sensors])
    fits_start = START in names
    if fits_start and isinstance(motion, Recorded):
        raise InputError('align: expected no start, because a recorded motion has its own, '
                         'found start')
    if not names:
        return tuple(Alignment() for _ in sensors)
    clocks, mounts = ([not {kind, f'{kind}@{sensor.topic}'}.isdisjoint(names)
                       for sensor in sensors] for kind in (CLOCK, MOUNT))
    guesses = guess(motion, sensors, clocks, mounts)
    values: dict[str, Floats] = {}
    channels = []
    for k, (sensor, (offset, mount, _)) in enumerate(zip(sensors, guesses)):
        if clocks[k]:
            values[f'clock_offset@{k}'] = np.array([offset])
        if mounts[k]:
            values[f'mount@{k}'] = so3.log(mount)
        within = inside(motion, sensor.stamps_ns + round(1e9 * offset),
                        _MARGIN_NS if clocks[k] else 0)
        channels += [replace(channel, topic=str(k)) for channel in sensor.rows(within).channels()
                     if len(channel) > 1]
    if not channels:
        raise no_overlap_error(motion, sensors)
    # Rotating the space axes has the same effect as rotating the initial attitude, so only one of
    # the two is fitted.
    if any(mount and sensor.attitude is not None for mount, sensor in zip(mounts, sensors)):
        values[SPACE] = so3.log(guesses[0][2])
    setup = setup_of_sensors(motion, channels, values, fits_start)
    solution = solved_whole(setup)
    return _alignments(weighted(solution, noises_of(widened(solution))), len(sensors), motion)


def check_names(names: Collection[str], topics: Sequence[str] | None = None) -> None:
    """Raise InputError if a name is not a known alignment, or if its topic is not in `topics`."""
    for name in names:
        kind, at, topic = name.partition('@')
        if kind not in ALIGNMENTS or (at and (kind == START or not topic)):
            raise InputError(f'align: expected some of {", ".join(ALIGNMENTS)}, or '
                             f'{CLOCK}@TOPIC or {MOUNT}@TOPIC of one sensor, found {name!r}')
        if at and topics is not None and topic not in topics:
            raise InputError(f'align: {name}: expected a topic among {listed(topics)}, found '
                             f'{topic}')


def _alignments(solution: Solution, count: int, motion: Motion) -> tuple[Alignment, ...]:
    """Return the alignment of each sensor, with standard deviations."""
    problem, physics, start = solution.problem, solution.physics, None
    parameters, unknown = problem.parameters, problem.unknowns[0]
    names = [*parameters.names, *(f'start[{k}]' for k in unknown)]
    scales = np.append(parameters.scales, np.where(unknown < 3, 1.0, problem.setup.rate))
    covariance, identifiable, _ = certainty(
        problem.information(physics), names, np.append(
            parameters.values(physics) / parameters.scales, np.zeros(len(unknown))))
    deviations = np.where(identifiable, np.sqrt(np.diag(covariance)) * scales, np.inf)
    by_group = {group: deviations[parameters.columns([group])] for group in parameters.groups}
    shared = {'space_rad': by_group[SPACE]} if SPACE in by_group else {}
    if len(unknown):
        first, (attitude, rate) = motion.start, problem.reference.rows(0)
        start = State(first.time_ns, so3.normalize(attitude), rate, first.rotor_momentum)
        own = deviations[parameters.size:]
        shared['initial_angular_velocity_rad_s'] = own[-3:]
        if len(unknown) > 3:
            shared['initial_attitude_rad'] = own[:3]
    space = so3.exp(physics.value(SPACE))
    result = []
    for k in range(count):
        sigma: dict[str, Any] = dict(shared)
        if (clock := by_group.get(f'clock_offset@{k}')) is not None:
            sigma['clock_offset_s'] = float(clock[0])
        if (mount := by_group.get(f'mount@{k}')) is not None:
            sigma['mount_rad'] = mount
        result.append(Alignment(physics.number('clock_offset', str(k)),
                                so3.exp(physics.value('mount', str(k))), space, start, sigma))
    return tuple(result)
