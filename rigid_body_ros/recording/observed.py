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

"""Read the torques of a recording, and the measurements taken during the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rigid_body_ros import recording
from rigid_body_ros.common.errors import InputError, located
from rigid_body_ros.common.times import duration_ns, NEVER_NS
from rigid_body_ros.propagation import Problem
from rigid_body_ros.recording.account import Account
from rigid_body_ros.recording.gaps import announce, Gaps
from rigid_body_ros.recording.measured import Measured
from rigid_body_ros.recording.selection import Reading, Topics
from rigid_body_ros.recording.ulog_file import is_ulog, UlogFile
from rigid_body_ros.scene import Scene


@dataclass(frozen=True, eq=False)
class Measurements:
    """
    The measurements taken during a motion.

    Attributes
    ----------
    sensors : list of Measured
        The measurements, including all samples of the recording.
    end_ns : int
        The time at which the motion ends, because the node begins another epoch or because only a
        part of the recording is read.
    torques : Account, optional
        What became of the torques.

    """

    sensors: list[Measured]
    end_ns: int = NEVER_NS // 2
    torques: Account | None = None

    @property
    def has_end(self) -> bool:
        """Return whether the motion may end before the last sample."""
        return self.end_ns < Measurements.end_ns

    def until_end(self, offsets: Sequence[float] = ()) -> list[Measured]:
        """
        Return the samples taken before the end of the motion.

        `offsets` may contain one offset, in seconds, for each sensor. The offset is added to the
        sensor's stamps before they are compared with the end of the motion. The returned stamps do
        not include the offsets.

        Raises
        ------
        InputError
            A sensor has no samples before the end of the motion.

        """
        ends = [self.end_ns - round(1e9 * offset)
                for offset in offsets or [0.0] * len(self.sensors)]
        for sensor, end_ns in zip(self.sensors, ends):
            if sensor.stamps_ns[0] >= end_ns:
                raise InputError(f'{sensor.topic}: expected measurements before the end of the '
                                 f'motion (--until or the next epoch), which is at {end_ns} ns on '
                                 f'their clock, found them from {sensor.stamps_ns[0]} ns on')
        return [sensor.rows(sensor.stamps_ns < end_ns)
                for sensor, end_ns in zip(self.sensors, ends)]


def read_observed(path: str | Path, scene: Scene, reading: Reading,
                  largest_offset: float = 0.0) -> tuple[Problem, Measurements]:
    """
    Read the torques of a recording, and the measurements taken during the motion.

    If the recording contains no torques, no torques are applied to the body. If the recording
    contains several epochs of a node, the scene's start_time selects one of these epochs.

    Parameters
    ----------
    path : str or Path
        The recording.
    scene : Scene
        The scene. If the start_time of the scene is 0, the motion starts at the first sample: the
        earliest torque stamp or, if there are no torques, the earliest stamp of the measurements.
    reading : Reading
        What to read, and how. If `reading.start` is positive, the motion starts that long after
        the first sample, whatever the start_time, and earlier torques are kept, because a torque
        that is held at the start acts. By default, only the longest flight of a PX4 log is read,
        if the log says when the vehicle was in the air.
    largest_offset : float, s
        Largest possible offset between the torque clock and the measurement clock.

    Raises
    ------
    InputError
        The recording cannot be read or does not fit the scene, torques and measurements do not
        overlap in time, a torque acts for so long that the computation would practically never
        end, or `reading.start` is positive for the log of a node.

    """
    sensors, later_ns, account = reading.sensors(path, scene), list[int](), None
    if replace(reading.topics, columns=None) == Topics() and not (
            recording.topics(path, recording.TORQUES) or reading.topics.command_in(path, scene)):
        first_ns = min(int(sensor.stamps_ns[0]) for sensor in sensors)
        problem = scene.problem(scene.starting_at(first_ns, reading.start))
    else:
        topics = reading.topics.found_in(path, scene)
        epochs = recording.read_epochs(path, scene, replace(reading, topics=topics))
        logged = recording.chosen(path, scene, epochs)
        problem, account = logged.problem, logged.account
        begins_ns = [epoch.problem.start.time_ns for epoch in epochs]
        later_ns = [time_ns for time_ns in begins_ns if time_ns > problem.start.time_ns]
    if reading.until is not None:  # the sample at the end is part of the motion
        later_ns.append(problem.start.time_ns + duration_ns(reading.until, 'until') + 1)
    measurements = Measurements(sensors, min(later_ns, default=Measurements.end_ns), account)
    _check_overlap(path, problem, measurements, round(1e9 * largest_offset), reading)
    is_whole = reading.start == 0.0 and reading.until is None and not scene.start.time_ns
    if is_whole and is_ulog(path) and (flight_ns := UlogFile(Path(path)).flight_ns):
        start = max(0.0, 1e-9 * (flight_ns[0] - problem.start.time_ns))
        until = 1e-9 * (flight_ns[1] - flight_ns[0])
        problem, measurements = read_observed(path, scene, replace(
            reading, start=start, until=until), largest_offset)
        measurements.sensors[0].account.notes.append(
            f'only the flight is used, from {start:.6g} s to {start + until:.6g} s after the '
            'first sample (vehicle_land_detected); --from and --until choose another part')
    elif account:
        _check_gaps(path, problem, measurements, scene, account)
    return problem, measurements


def _check_gaps(path: str | Path, problem: Problem, measurements: Measurements, scene: Scene,
                account: Account) -> None:
    """Warn about torques that act for much longer than usual; announce a long computing time."""
    last_ns = max(int(sensor.stamps_ns[-1]) for sensor in measurements.sensors)
    begin_ns, speed = problem.start.time_ns, float(np.linalg.norm(problem.start.angular_velocity))
    span_ns = begin_ns, max(begin_ns, min(last_ns, measurements.end_ns))
    for log in problem.logs:
        gaps = Gaps(*span_ns, scene.timeout_ns)
        gaps.add(log)
        if gaps.warning:
            account.doubts.append(gaps.warning)
    with located(path):
        announce(str(path), problem.logs, span_ns, speed, scene)


def _check_overlap(path: str | Path, problem: Problem, measurements: Measurements,
                   margin_ns: int, reading: Reading) -> None:
    """Raise InputError if torques and measurements do not overlap in time."""
    first = problem.start.time_ns
    torque = max((int(log.times_ns[-1]) for log in problem.logs), default=NEVER_NS)
    last = min(torque, measurements.end_ns - 1)
    is_part = reading.start or reading.until
    advice = 'check --from and --until' if is_part else \
        'are the clocks the same (--time-source log)?'
    for sensor in measurements.sensors:
        begin, end = int(sensor.stamps_ns[0]), int(sensor.stamps_ns[-1])
        if end + margin_ns < first or begin - margin_ns > last:
            raise InputError(
                f'{path}: {sensor.topic}: expected measurements during the motion, from {first} '
                f'ns to the last torque or the end at {last} ns, found them from {begin} ns to '
                f'{end} ns; {advice}')
