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

"""Compute the motion of a replay in batches of outputs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Thread
import time
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from rigid_body_ros import messages
from rigid_body_ros.common.arrays import Floats
from rigid_body_ros.common.errors import InputError
from rigid_body_ros.common.times import duration_ns, NEVER_NS
from rigid_body_ros.mechanics import so3
from rigid_body_ros.mechanics.state import State
from rigid_body_ros.mechanics.torque import INTERPOLATIONS, torque_logs, TorqueLog
from rigid_body_ros.propagation import Integration, Options, Trajectory
from rigid_body_ros.propagation.combined import CombinedMotion
from rigid_body_ros.recording import NotInOrderError, Piece
from rigid_body_ros.replay.gaps import announce, computing_time, Gaps
from rigid_body_ros.replay.sources import Sources
from rigid_body_ros.scene import Scene

#: Largest number of outputs in a batch.
_LARGEST = 2 ** 16
#: Largest number of outputs of a replay; more would fill the disk.
_MOST_OUTPUTS = 10 ** 8


@dataclass(frozen=True)
class Request:
    """The arguments of `replay` that determine the motion."""

    path: str | Path
    scene: Scene
    interpolation: str
    rate: float | None
    until: float | None
    also: Collection[str] = ()
    #: Returns what takes each batch besides the output; None for nothing.
    collect: Callable[[], Collector] | None = None


class Collector(Protocol):
    """Takes each batch of a motion."""

    def add(self, batch: Batch) -> None:
        """Take a batch."""


class Batch(NamedTuple):
    """A part of the motion, its piece of the torque log, and the wall time to compute it, s."""

    #: Of a motion with several topics, rotors or damping: all logs as a whole.
    log: TorqueLog | Sequence[TorqueLog]
    trajectory: Trajectory
    seconds: float
    #: Torque on the rotors.
    wheels: TorqueLog | None = None

    @property
    def last_ns(self) -> int:
        """Return the last stamp of the logs, ns; 0 without torques."""
        logs = [self.log] if isinstance(self.log, TorqueLog) else [*self.log, self.wheels]
        return max((int(log.times_ns[-1]) for log in logs if log), default=0)


class Batches:
    """
    The motion under a torque log that is read piece by piece; iteration yields each `Batch`.

    Parameters
    ----------
    request : Request
    topic : str
    pieces : iterator of Piece
    start : State, optional
        Start of an epoch of a node, which may have no torques; otherwise that of the scene.

    Attributes
    ----------
    start : State
    first_ns : int
        Stamp of the first torque; that of the start if there is none.
    gaps : tuple of Gaps
        Those of the log as far as it was read.

    """

    def __init__(self, request: Request, topic: str, pieces: Iterator[Piece],
                 start: State | None = None) -> None:
        self._where = f'{request.path}: {topic}'
        self._request, self._pieces = request, pieces
        self._piece = next(pieces)
        first = self._piece.times_ns[:1].tolist() or ([start.time_ns] if start else [])
        if not first:
            raise InputError(f'{self._where}: expected torques, found no messages')
        self.first_ns = first[0]
        self.start = start or replace(
            request.scene.start, time_ns=request.scene.start.time_ns or self.first_ns)
        self._integration = Integration(request.scene.body, self.start, **request.scene.options)
        names = [name for name in INTERPOLATIONS if name != request.interpolation]
        #: Motions with the other interpolations; removed if the body spins too fast.
        self._alternatives = {
            name: Integration(request.scene.body, self.start, **request.scene.options)
            for name in names}
        #: Their final attitudes; None if the body spins too fast.
        self._final_attitudes: dict[str, Floats | None] = {}
        #: The frames of the torques so far: whether in space axes.
        self._frames: set[bool] = set()
        #: Advances the alternatives. A daemon thread does not delay the end of the program.
        self._thread: Thread | None = None
        #: The exception that the thread raised.
        self._failure: BaseException | None = None
        self._outputs = _OutputTimes(request, self.start.time_ns, start is not None)
        self._end_ns = NEVER_NS if request.until is None else \
            end_of(request.path, 0, self.start.time_ns, request.until)
        self.gaps = Gaps(self.start.time_ns, self._end_ns, request.scene.timeout_ns),
        #: rad/s; at the end of the motion so far.
        self._speed = _speed(self.start.angular_velocity)

    def __iter__(self) -> Iterator[Batch]:
        piece: Piece | None = self._piece
        while piece is not None:
            stop = piece.stop
            if stop is not None and piece.times_ns[stop] >= self._end_ns:
                stop = None
            yield from self._advance(piece, stop)
            piece = next(self._pieces) if stop is not None else None

    def differences(self, end: Floats) -> dict[str, float | None]:
        """
        Return how far from the attitude `end` the motion ends with each other interpolation, rad.

        The value is None if the body spins too fast.
        """
        self._wait()
        return {name: None if other is None else float(so3.angle_between(other, end))
                for name, other in self._final_attitudes.items()}

    def _advance(self, piece: Piece, stop: int | None) -> Iterator[Batch]:
        began = time.perf_counter()
        self._wait()
        self._frames |= set(np.unique(piece.in_space).tolist())
        if len(self._frames) > 1:
            if self._request.interpolation != 'hold' and piece.dropped:
                raise NotInOrderError  # the log as a whole is rejected
            self._alternatives.clear()
            self._final_attitudes.clear()
        begin_ns = self._outputs.done_ns
        numbers, times_of = self._outputs.up_to(piece.times_ns, stop)
        limits = (begin_ns, self._outputs.done_ns), self._speed, self._request.scene
        try:
            log = piece.log(self._request.interpolation)
            self.gaps[0].add(log)
            announce(self._where, computing_time(log, *limits))
            self._thread = Thread(target=self._advance_alternatives,
                                  args=(piece, stop, times_of(numbers[-1:]), limits), daemon=True)
            self._thread.start()
            for first in range(0, max(len(numbers), 1), _LARGEST):
                trajectory = self._integration.advance(
                    log, times_of(numbers[first:first + _LARGEST]),
                    dropped=0 if first else piece.dropped,
                    stop=stop if first + _LARGEST >= len(numbers) else None)
                if trajectory.times_ns.size:
                    self._speed = _speed(trajectory.angular_velocity[-1])
                yield Batch(log, trajectory, time.perf_counter() - began)
                began = time.perf_counter()
        except ValueError as error:
            raise InputError(f'{self._where}: {error}') from error

    def _wait(self) -> None:
        if self._thread:
            self._thread.join()
        if self._failure:
            raise self._failure

    def _advance_alternatives(self, piece: Piece, stop: int | None, last: NDArray[np.int64],
                              limits: tuple[tuple[int, int], float, Scene]) -> None:
        """Advance the motions with the other interpolations to the end of the piece."""
        try:
            for name, run in [*self._alternatives.items()]:
                self._final_attitudes[name] = None
                try:
                    log = piece.log(name)
                    computing_time(log, *limits)
                    motion = run.advance(log, last if stop is None else [],
                                         dropped=piece.dropped, stop=stop)
                except ValueError:  # the body spins too fast, or too long
                    del self._alternatives[name]
                else:
                    self._final_attitudes[name] = motion.attitude[-1] if stop is None else None
        except BaseException as error:  # raised in the main thread by `_wait`
            self._failure = error


class CombinedBatches:
    """
    The motion of a scene with several topics, rotors or damping; iteration yields each `Batch`.

    Attributes
    ----------
    start : State
    first_ns : int
        Stamp of the first torque; that of the start if there is none.
    gaps : tuple of Gaps
        Those of the log as far as it was read.

    """

    def __init__(self, request: Request, topics: str, sources: Sources) -> None:
        self._where, self._request, self._sources = f'{request.path}: {topics}', request, sources
        self.start, self._stamps_ns = sources.start, sources.times_ns
        self.first_ns = int(self._stamps_ns[0])
        self._outputs = _OutputTimes(request, self.start.time_ns, sources.is_epoch)
        self._end_ns = self._outputs.end_ns(self._stamps_ns)
        self._logs = [*sources.logs, *torque_logs(sources.wheels)]
        self.gaps = tuple(Gaps(self.start.time_ns, self._end_ns, request.scene.timeout_ns)
                          for _ in self._logs)

    def __iter__(self) -> Iterator[Batch]:
        began = time.perf_counter()
        numbers, times_of = self._outputs.up_to(self._stamps_ns, None)
        try:
            for gaps, log in zip(self.gaps, self._logs):
                gaps.add(log)
            announce(self._where, self._computing_time(self._sources))
            motion = self._motion(self._sources)
            for first in range(0, max(len(numbers), 1), _LARGEST):
                trajectory = motion.advance(times_of(numbers[first:first + _LARGEST]))
                yield Batch(self._sources.logs, trajectory, time.perf_counter() - began,
                            self._sources.wheels)
                began = time.perf_counter()
        except ValueError as error:
            raise InputError(f'{self._where}: {error}') from error

    def differences(self, end: Floats) -> dict[str, float | None]:
        """Return the angles, rad, of the other final attitudes from `end`, by interpolation."""
        if any(np.unique(log.in_space).size > 1 for log in self._sources.logs):
            return {}
        found: dict[str, float | None] = {}
        for name in INTERPOLATIONS:
            if name != self._request.interpolation:
                found[name] = None
                with suppress(ValueError):  # the body spins too fast, or too long
                    sources = self._sources.interpolated(name)
                    self._computing_time(sources)
                    motion = self._motion(sources)
                    attitude = motion.advance([self._end_ns]).attitude[0]
                    found[name] = float(so3.angle_between(attitude, end))
        return found

    def _computing_time(self, sources: Sources) -> float:
        """Return the longest `computing_time` of a source, with its errors."""
        span_ns, speed = (self.start.time_ns, self._end_ns), _speed(self.start.angular_velocity)
        return max((computing_time(log, span_ns, speed, self._request.scene)
                    for log in (*sources.logs, *torque_logs(sources.wheels))), default=0.0)

    def _motion(self, sources: Sources) -> CombinedMotion:
        scene = self._request.scene
        return CombinedMotion(scene.body, self.start, sources.logs,
                              sources.wheels or TorqueLog([], []), Options(**scene.options))


class _OutputTimes:
    """
    The times of the outputs, from one piece of the log to the next.

    Those of an epoch of a node begin at its start, like the states that a node commits. Its
    torques may all be older than the start, or there may be none.
    """

    def __init__(self, request: Request, start_ns: int, is_epoch: bool) -> None:
        self._request, self._start_ns, self._is_epoch = request, start_ns, is_epoch
        #: End of the motion so far, and number of its outputs.
        self.done_ns, self._count = start_ns, 0

    def end_ns(self, stamps_ns: NDArray[np.int64]) -> int:
        """Return the end of the motion under a log with these stamps, with errors of `end_of`."""
        last_ns = int(stamps_ns[-1]) if stamps_ns.size else self._start_ns
        if self._is_epoch:
            last_ns = max(last_ns, self._start_ns)
        return end_of(self._request.path, last_ns, self._start_ns, self._request.until)

    def up_to(self, stamps_ns: NDArray[np.int64], stop: int | None
              ) -> tuple[range, Callable[[range], NDArray[np.int64]]]:
        """
        Return the numbers of the next outputs and a function that returns their times.

        The outputs end at the end of the piece or of the motion. At a high rate the times of all
        of them would not fit in memory.
        """
        start_ns, rate = self._start_ns, self._request.rate
        end_ns = self.end_ns(stamps_ns) if stop is None else int(stamps_ns[stop])
        if rate is None:
            first = np.searchsorted(stamps_ns, self.done_ns, 'right' if self._count else 'left')
            times = stamps_ns[first:np.searchsorted(stamps_ns, end_ns, 'right')]
            more = [start_ns] if self._is_epoch and not self._count and end_ns >= start_ns else []
            more += [end_ns] if stop is None else []
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
    Return the end of a replay, ns: `until` seconds after the start, by default the last stamp.

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
        raise InputError(f'{path}: expected the last torque at or after the start_time of the '
                         f'scene, {start_ns} ns, found it at {end_ns} ns')
    return end_ns


def _speed(angular_velocity: Floats) -> float:
    return float(np.linalg.norm(angular_velocity))
