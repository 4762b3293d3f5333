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

"""Compute the motion of a replay batch by batch."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
import time
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import duration_ns, NEVER_NS
from rigid_body_ros.mechanics.efforts import EffortLog
from rigid_body_ros.mechanics.torque import stamps_of, TorqueLog
from rigid_body_ros.mechanics.wheels import Wheels
from rigid_body_ros.propagation import AtLimit, Integration, Problem, Trajectory
from rigid_body_ros.recording import Logged, Reading
from rigid_body_ros.recording.gaps import announce, Gaps
from rigid_body_ros.recording.problem import Stream
from rigid_body_ros.scene import Scene

#: The names by which you request additional output topics of a replay.
IMU, TF, MARKERS, INPUT = 'imu', 'tf', 'markers', 'input'
#: Largest number of outputs in a batch.
_LARGEST = 2 ** 16
#: Largest number of outputs in a replay; a larger number would fill the disk.
_MOST_OUTPUTS = 10 ** 8


@dataclass(frozen=True)
class Request:
    """What to replay, and how; see `replay`."""

    path: str | Path
    scene: Scene
    output: str | Path | None
    #: The topics, the interpolation, the source of the stamps, and the part of the recording.
    reading: Reading
    rate: float | None = None
    also: Collection[str] = ()
    keep: bool | None = None
    collect: Callable[[], Collector] | None = None
    logged: Logged | None = None

    @property
    def interpolation(self) -> str:
        """Return how to interpolate between samples."""
        return self.reading.interpolation or self.scene.interpolation

    @property
    def is_kept(self) -> bool:
        """Return whether to keep the problem and the trajectory in the result."""
        return self.output is None if self.keep is None else self.keep

    @property
    def sensor_delay_ns(self) -> int:
        """Return the IMU delay, ns: the time between a measurement and its stamp."""
        return self.scene.imu.delay_ns if IMU in self.also else 0


class Collector(Protocol):
    """An object to which each batch of a motion is passed."""

    def add(self, batch: Batch) -> None:
        """Receive a batch."""


class Batch(NamedTuple):
    """
    A part of the motion, the problem with the torques for this part, and the computing time, s.

    `sensed` is the motion that the IMU reports at the times of the trajectory. The reported motion
    lags behind the motion of the body by the IMU delay.
    """

    problem: Problem
    trajectory: Trajectory
    sensed: Trajectory
    seconds: float

    @property
    def last_ns(self) -> int:
        """Return the last stamp of torques and wheel commands, ns; 0 if there are no stamps."""
        logs = [log.times_ns for log in (*self.problem.sources, self.problem.efforts) if log]
        return max((int(times_ns[-1]) for times_ns in logs), default=0)


class Batches:
    """
    Compute a motion in batches, while its torques are read piece by piece.

    Iterate over an object of this class to get the batches.

    Parameters
    ----------
    request : Request
    topics : str
        The names of the topics, for error messages.
    streams : sequence of Stream
    problem : Problem
        The problem. The torques of `streams` replace those of the problem, but the start state of
        the problem is used. If the torques are a single piece, the body changes and efforts of the
        problem are used, too.
    is_epoch : bool
        Whether the motion is an epoch of a node, which may have no torques.

    Attributes
    ----------
    start : State
    first_ns : int
        Stamp of the first torque or wheel command; the start time if there are neither torques nor
        wheel commands.
    gaps : tuple of Gaps
        For each log, the gaps in the part that has been read so far.
    saturation : Saturation, optional
        The speeds and efforts that have exceeded the limits of named wheels so far; None if there
        are no named wheels.

    """

    def __init__(self, request: Request, topics: str, streams: Sequence[Stream], problem: Problem,
                 is_epoch: bool) -> None:
        self._problem, start = problem, problem.start
        #: The stamps of the inertia messages and of the commands to named wheels, if these
        #: messages are read.
        self._others = [log.times_ns for log in (problem.changes, problem.efforts) if log]
        self._where, self._request = f'{request.path}: {topics}', request
        self.streams, self.start = streams, start
        self._delay_ns = request.sensor_delay_ns
        stamps = [int(stream.piece.times_ns[0]) for stream in streams
                  if len(stream.piece.times_ns)]
        if problem.efforts:
            stamps.append(int(problem.efforts.times_ns[0]))
        self.first_ns = min(stamps, default=start.time_ns)
        #: The motion computed so far; None before the first piece.
        self._motion: Integration[Problem] | None = None
        self._outputs = _OutputTimes(request, start.time_ns, is_epoch)
        until = request.reading.until
        self._end_ns = NEVER_NS if until is None else \
            end_of(request.path, 0, start.time_ns, until)
        self.gaps = tuple(Gaps(start.time_ns, self._end_ns, request.scene.timeout_ns)
                          for _ in streams)
        self.saturation = Saturation(problem.named_wheels) if problem.named_wheels else None
        #: How fast the body rotates at the end of the motion computed so far, rad/s.
        self._speed = _speed(start.angular_velocity)

    def __iter__(self) -> Iterator[Batch]:
        while True:
            ends = [stream.end_ns for stream in self.streams if stream.end_ns is not None]
            until_ns = min(ends, default=None)
            if until_ns is not None and until_ns >= self._end_ns:
                until_ns = None
            yield from self._advance(until_ns)
            if until_ns is None:
                return
            for stream in self.streams:
                if stream.end_ns == until_ns:
                    stream.advance()

    def _advance(self, until_ns: int | None) -> Iterator[Batch]:
        began = time.perf_counter()
        begin_ns = self._outputs.done_ns
        try:
            logs = [stream.log() for stream in self.streams]
            if until_ns is not None and len(logs) > 1:
                logs = [log.between(begin_ns, until_ns) for log in logs]
            stamps_ns = stamps_of(logs)
            for others_ns in self._others:
                stamps_ns = np.union1d(stamps_ns, others_ns)
            numbers, times_of = self._outputs.up_to(stamps_ns, until_ns)
            for gaps, log in zip(self.gaps, logs):
                gaps.add(log)
            span_ns = begin_ns, self._outputs.done_ns
            announce(self._where, logs, span_ns, self._speed, self._request.scene)
            motion = self._motion = self._continued(self._motion, logs)
            # If the IMU has a delay, the torques are always a single piece.
            earlier = self._continued(None, logs) if self._delay_ns else None
            for first in range(0, max(len(numbers), 1), _LARGEST):
                times_ns = times_of(numbers[first:first + _LARGEST])
                trajectory = sensed = motion.advance(
                    times_ns, until_ns if first + _LARGEST >= len(numbers) else None)
                if earlier:
                    sensed = earlier.advance(
                        np.maximum(times_ns - self._delay_ns, self.start.time_ns))
                if trajectory.times_ns.size:
                    self._speed = _speed(trajectory.angular_velocity[-1])
                if self.saturation:
                    self.saturation.add(trajectory, self._problem.efforts)
                yield Batch(motion.problem, trajectory, sensed, time.perf_counter() - began)
                began = time.perf_counter()
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f'{self._where}: {error}') from error

    def _continued(self, motion: Integration[Problem] | None,
                   logs: Sequence[TorqueLog]) -> Integration[Problem]:
        """Continue a motion with the next pieces of its torques, or begin it."""
        body = [log for log, stream in zip(logs, self.streams) if not stream.on_rotors]
        wheels = [log for log, stream in zip(logs, self.streams) if stream.on_rotors]
        problem = self._problem.replaced(log=body, wheels=next(iter(wheels), None))
        if not motion:
            return Integration(problem)
        motion.extend(problem)
        return motion


class Saturation:
    """
    Speeds and efforts of named wheels, compared with `max_speed` and `max_torque`.

    Parameters
    ----------
    wheels : Wheels

    Attributes
    ----------
    speeds : array, shape (n,), rad/s
        The largest speed of each wheel at any output; zeros if no wheel has a `max_speed`.
    clipped : int
        How many efforts were clipped to `max_torque`.
    at_limit : list of AtLimit
        When wheels were at their `max_speed` although their commands drove them.

    """

    def __init__(self, wheels: Wheels) -> None:
        self._wheels = wheels
        self.speeds: Floats = np.zeros(len(wheels))
        self.clipped, self.at_limit = 0, list[AtLimit]()
        #: The number of rows of the log that have been counted.
        self._counted = 0

    def add(self, motion: Trajectory, log: EffortLog | None) -> None:
        """
        Add a part of the motion.

        Parameters
        ----------
        motion : Trajectory
            The part.
        log : EffortLog, optional
            All commands to the wheels, for the whole motion.

        """
        if self._wheels.is_limited:
            speeds = np.abs(motion.wheel_speeds).max(axis=0, initial=0.0)
            self.speeds = np.maximum(self.speeds, speeds)
            self.at_limit += motion.at_limit
        if log and motion.times_ns.size:
            stop = int(np.searchsorted(log.times_ns, motion.times_ns[-1], 'right'))
            self.clipped += self._wheels.count_clipped(log.efforts[self._counted:stop])
            self._counted = stop

    @property
    def warnings(self) -> list[str]:
        """Return warnings about wheels that were too fast and about efforts that were changed."""
        warnings = [f'{wheel.name}: the motion of the body drove the wheel to {speed:.6g} rad/s, '
                    f'beyond its max_speed of {wheel.max_speed:.9g} rad/s'
                    for wheel, speed in zip(self._wheels.wheels, self.speeds.tolist())
                    if 0.0 < wheel.max_speed * (1.0 + 1e-9) < speed]
        for wheel in self._wheels.wheels:
            if spans := [span for span in self.at_limit if span.wheel == wheel.name]:
                warnings.append(
                    f'{wheel.name}: at its max_speed of {wheel.max_speed:.9g} rad/s for '
                    f'{sum(span.seconds for span in spans):.9g} s, first at '
                    f'{spans[0].begin_ns} ns, last until {spans[-1].end_ns} ns')
        if self.clipped:
            warnings.append(f'efforts clipped to max_torque: {self.clipped}')
        return warnings


class _OutputTimes:
    """
    Determine the output times piece by piece; `end_of` says when the motion ends.

    In an epoch of a node, the first output is at the start of the epoch, because the node commits
    its start state. This holds even if all torques of the epoch are older than its start, or if
    the epoch has no torques.
    """

    def __init__(self, request: Request, start_ns: int, is_epoch: bool) -> None:
        self._request, self._start_ns, self._is_epoch = request, start_ns, is_epoch
        #: The end of the motion computed so far, ns, and the number of outputs so far.
        self.done_ns, self._count = start_ns, 0

    def up_to(self, stamps_ns: NDArray[np.int64], until_ns: int | None
              ) -> tuple[range, Callable[[range], NDArray[np.int64]]]:
        """
        Return the indices of the next outputs, and a function that converts indices to times, ns.

        The next outputs are those up to `until_ns` or, if `until_ns` is None, up to the end of the
        motion. The times are computed by a function because, at a high rate, the times of all
        outputs would not fit in memory.
        """
        start_ns, rate, end_ns = self._start_ns, self._request.rate, until_ns
        if end_ns is None:
            last_ns = int(stamps_ns[-1]) if stamps_ns.size else start_ns
            end_ns = end_of(self._request.path,
                            max(last_ns, start_ns) if self._is_epoch else last_ns, start_ns,
                            self._request.reading.until)
        if rate is None:
            first = np.searchsorted(stamps_ns, self.done_ns, 'right' if self._count else 'left')
            times = stamps_ns[first:np.searchsorted(stamps_ns, end_ns, 'right')]
            more = [start_ns] if self._is_epoch and not self._count and end_ns >= start_ns else []
            more += [end_ns] if until_ns is None else []
            times = np.union1d(times, np.array(more, np.int64)) if more else times
            numbers = range(len(times))

            def times_of(part: range) -> NDArray[np.int64]:
                return times[part.start:part.stop]
        else:
            step_ns = 1e9 / rate
            count = int((end_ns - start_ns) / step_ns * (1.0 + 1e-15)) + 1
            if count > _MOST_OUTPUTS:
                raise InputError(
                    f'--rate: expected at most {_MOST_OUTPUTS} outputs, found {rate} Hz '
                    f'over {(end_ns - start_ns) * 1e-9:.9g} s')
            numbers = range(self._count, max(count, self._count))

            def times_of(part: range) -> NDArray[np.int64]:
                offsets = np.round(np.arange(part.start, part.stop) * step_ns)
                return start_ns + offsets.astype(np.int64)
            while numbers and times_of(numbers[-1:])[0] > end_ns:
                numbers = numbers[:-1]
        self._count += len(numbers)
        self.done_ns = max(self.done_ns, end_ns)
        return numbers, times_of


def end_of(path: str | Path, last_ns: int, start_ns: int, until: float | None = None) -> int:
    """
    Return the time at which a replay ends, ns.

    A replay ends `until` seconds after the start or, by default, at the last stamp.

    Raises
    ------
    InputError
        The end is before the start, or later than the latest ROS stamp.
    ValueError
        `until` is negative or longer than 1e9 s.

    """
    end_ns = last_ns if until is None else start_ns + duration_ns(until, 'until')
    if end_ns > messages.LAST_NS:
        where = path if until is None else '--until'
        raise InputError(f'{where}: expected an end at or before the latest ROS stamp, '
                         f'{messages.LAST_NS} ns, found {end_ns} ns')
    if end_ns < start_ns:
        raise InputError(f'{path}: expected the last torque at or after the start of the motion '
                         f'(--from or start_time), {start_ns} ns, found it at {end_ns} ns')
    return end_ns


def _speed(angular_velocity: Floats) -> float:
    return float(np.linalg.norm(angular_velocity))
